"""Damaged trial files: each is named, with its place and what would be right, and the others are used without it."""

import contextlib
import copy
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from dataset_writer import (
    AMOUNTS,
    body_asset,
    scaled_markers,
    synthetic_trials,
    trial_folder,
    write_synthetic,
    write_trial,
)
from hypothesis import given, settings, strategies as st
from imports import band_of, import_contents, imported, put

from gauge_envs import load_experiment
from gauge_envs.references.imported import load_imported
from gauge_envs.tools.dataset.findings import TrialError
from gauge_envs.tools.dataset.observation import driver_tracks, trial_trajectory
from gauge_envs.tools.dataset.trial import parse_trial

SLIDER, FOAM, PLATE = "SlopeSlider-1-wood", "FoamBending-soft", "Turntable-2-wood"

# --- hostile files ---------------------------------------------------------------------------------------------------


def text(change):
    """Changes the file's text."""
    return lambda content: change(json.dumps(content)).encode()


def raw(content):
    return lambda _: content


def cube(change, keys="xyz"):
    """Changes lists of the cube."""

    def edit(content):
        for key in keys.split() if " " in keys else keys:
            content["cube"][key] = change(content["cube"][key])
        return content

    return edit


def swapped_markers(content):
    foam = content["foam"]
    first, *_, last = sorted(foam, key=int)
    foam[first], foam[last] = foam[last], foam[first]
    return content


LISTS = "x y z qx qy qz qw ex ey ez"

# Variant, what is done to a trial, and the place, the fault and what would be right.
DAMAGES = [
    (SLIDER, raw(b" \n"), r"\(file\): it is not JSON: .*; a complete file"),
    (SLIDER, text(lambda line: line[: len(line) // 2]), r"\(file\): it is not JSON"),
    (SLIDER, raw(b"[1, 2]"), r"\(file\): it is not JSON: it is a list"),
    (SLIDER, raw(b'{"FPS": "\xff\xfe"}'), r"\(file\): it is not JSON"),
    (SLIDER, put("FPS", 60), "FPS: it is 60; 30 is expected"),
    (SLIDER, put("FPS"), "FPS: it is missing; 30 is expected"),
    (SLIDER, put("FPS", "30"), "FPS: it is '30'; 30 is expected"),
    (
        SLIDER,
        put("translation unit", "inch"),
        "translation unit: it is 'inch'; 'mm' is expected",
    ),
    (
        SLIDER,
        put("translation unit"),
        "translation unit: it is missing; 'mm' is expected",
    ),
    (
        SLIDER,
        cube(lambda values: [value / 1e3 for value in values]),
        "cube: .* mm from its calibrated start; .*in mm, is",
    ),
    (SLIDER, put("cube"), r"\(file\): it holds no asset; .*'cube'"),
    (
        SLIDER,
        text(lambda line: line.replace('"cube"', '"sphere"')),
        "cube: the rigid body is missing; the file has sphere",
    ),
    (SLIDER, put("cube.z"), "cube.z: it is missing; an asset has x, y, z"),
    (SLIDER, put("cube.qz"), "cube.qz: it is missing; .*qx, qy, qz, qw"),
    (SLIDER, put("cube.y", 1.0), "cube.y: it is 1.0; a list of numbers"),
    (SLIDER, put("cube.y", []), "cube.y: it is an empty list; a list of numbers"),
    (SLIDER, put("cube.qy", [0.0] * 3), "cube.qy: it has 3 samples; .*as in cube.x"),
    (SLIDER, put("cube.x.4", "12"), r"cube.x\[4\]: it is '12'; a number or null"),
    (SLIDER, put("cube.x.4", True), r"cube.x\[4\]: it is True; a number or null"),
    (
        SLIDER,
        put("cube.x.4", math.inf),
        r"cube.x\[4\]: it is infinite; a finite number",
    ),
    (SLIDER, put("cube.x.4", 10**400), "cube.x: a number is too large; finite numbers"),
    (SLIDER, put("cube.x.4", 1e9), r"cube.x\[4\]: it is 1e\+09 mm; .*a few metres"),
    (SLIDER, put("cube.qw.3", 0.9), r"cube.q\[3\]: .*norm is 0.9; 1 is expected"),
    (SLIDER, put("cube.qw.3", 1.4e154), r"cube.q\[3\]: .*norm is inf; 1 is expected"),
    (
        SLIDER,
        cube(lambda values: values[:5], LISTS),
        r"\(file\): it has 5 frames; 9 or more",
    ),
    (
        SLIDER,
        cube(lambda values: [None] * len(values)),
        "cube: it was never captured; samples are expected",
    ),
    (FOAM, put("foam"), "markers: the marker set is missing; the file has cube"),
    (FOAM, put("foam.5"), "foam: it has 13 markers; 14 are expected"),
    (FOAM, put("foam.5", 3), "foam.5: it is 3; .*an object with x, y, z"),
    (FOAM, put("foam.8.z"), "foam.8.z: it is missing; .*x, y, z"),
    (
        FOAM,
        swapped_markers,
        "markers.5: it starts where marker 13.*; .*the metadata's markers",
    ),
]


@pytest.mark.parametrize("name", [SLIDER, FOAM])
def test_damaged_files_are_named_and_the_others_are_used(name, tmp_path):
    write_synthetic(tmp_path, name)
    imported(tmp_path)
    undamaged = band_of(name)
    words = {}
    for number, (variant, change, expected) in enumerate(DAMAGES, start=99):
        if variant == name:
            (content,) = synthetic_trials(name, [0.3 + 1e-3 * number]).contents
            file = write_trial(tmp_path, name, number, change(content))
            words[file.relative_to(tmp_path).as_posix()] = expected
    one = imported(tmp_path)[name]
    found = {finding.file: finding for finding in one.findings}
    assert set(found) == set(words)
    for file, expected in words.items():
        assert re.search(f"^{re.escape(file)}: {expected}", str(found[file]))
        assert found[file].left_out
    assert (one.used, one.left_out) == (len(AMOUNTS), len(words))
    assert one.facts.left_out == len(words)
    np.testing.assert_array_equal(band_of(name).mean, undamaged.mean)
    np.testing.assert_array_equal(band_of(name).sigma, undamaged.sigma)


def copied(file):
    file.write_bytes(file.with_name("trial-2.json").read_bytes())


def linked(file):
    outside = file.parents[7] / "private.json"
    outside.write_bytes(file.with_name("trial-2.json").read_bytes())
    file.symlink_to(outside)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (Path.mkdir, "it cannot be read"),
        (copied, "is a copy of"),
        (linked, "it links to a file outside of the dataset"),
    ],
)
def test_a_file_that_is_no_trial_of_its_own_is_left_out(make, words, tmp_path):
    root = tmp_path / "set"
    write_synthetic(root, SLIDER)
    make(root / trial_folder(SLIDER) / "trial-7.json")
    one = imported(root)[SLIDER]
    assert (one.used, one.left_out) == (4, 1)
    (finding,) = one.findings
    assert finding.file.endswith("trial-7.json") and words in finding.problem


def test_what_an_experiment_does_not_ask_for_may_be_damaged(tmp_path):
    """A board that stands still may have one sample; a plate with a broken orientation costs the driver alone."""
    found = {}
    for name in (SLIDER, PLATE):
        contents = synthetic_trials(name).contents
        contents[0] |= {"note": "a remark", "board": body_asset(np.zeros((1, 3)))}
        contents[1]["lamp"] = {"x": [1.0]}
        if name == PLATE:
            contents[2]["plate"]["qw"][2] = 2.0
        found[name] = import_contents(tmp_path / name, name, contents)
        assert found[name].used == 4
    keys = {
        name: [(finding.key, finding.left_out) for finding in one.findings]
        for name, one in found.items()
    }
    lamp, plate = ("lamp.y", False), ("plate.q[2]", False)
    assert keys == {SLIDER: [lamp], PLATE: [lamp, plate]}
    assert found[PLATE].facts.drivers[0].trial_count == 3


def test_recorded_bodies_are_equally_long(tmp_path):
    contents = synthetic_trials("RopeWinding-rubber", [*AMOUNTS, 0.3]).contents
    ball = contents[-1]["ball-2"]
    contents[-1]["ball-2"] = {key: values[:-1] for key, values in ball.items()}
    one = import_contents(tmp_path, "RopeWinding-rubber", contents)
    assert (one.used, one.left_out) == (4, 1)
    assert "ball-2: it has 94 frames" in str(one.findings[0])


def test_marker_sets_of_several_bodies_are_joined(tmp_path):
    """The beam's markers under its four blocks instead of all together; one file has a block that is shorter."""
    name = "CantileverBeam-soft"
    contents = synthetic_trials(name).contents
    for number, content in enumerate(contents):
        markers = content.pop("markers")
        content |= {f"cube-{block + 1}": {} for block in range(4)}
        for place, marker in enumerate(sorted(markers, key=int)):
            end = -1 if (number, place % 4) == (3, 2) else None
            content[f"cube-{place % 4 + 1}"][marker] = {
                key: values[:end] for key, values in markers[marker].items()
            }
    one = import_contents(tmp_path, name, contents)
    assert (one.used, one.left_out) == (3, 1)
    assert "cube-3: it has 94 frames" in str(one.findings[0])
    start = scaled_markers(load_experiment(name), float(np.mean(AMOUNTS[:3])))
    np.testing.assert_allclose(band_of(name).mean[5], start.ravel(), rtol=0, atol=1e-9)


def test_two_trials_are_needed(tmp_path):
    write_synthetic(tmp_path, SLIDER, [0.0])
    one = imported(tmp_path)[SLIDER]
    assert one.facts is None and load_imported(SLIDER) is None
    assert "1 of its trials can be used; 2 or more" in str(one.findings[0])


def test_the_command_imports_the_rest_and_exits_with_1(tmp_path, gauge):
    for name in (SLIDER, PLATE):
        write_synthetic(tmp_path, name)
    write_trial(tmp_path, SLIDER, 99, b"{")
    result = gauge("data", "import", tmp_path)
    assert result.exit_code == 1
    assert f"left out: {trial_folder(SLIDER)}/trial-99.json: (file)" in result.stderr
    assert "8 trials of 2 experiments imported" in result.stderr
    assert SLIDER in result.stdout and PLATE in result.stdout
    assert load_imported(SLIDER).band.trial_count == 4
    lines = gauge("data", "import", tmp_path, "--json").stdout.splitlines()
    slider, plate, fault = map(json.loads, lines)
    assert (slider["id"], slider["left_out"]) == (f"GAUGE/{SLIDER}", 1)
    assert (plate["id"], plate["drivers"][0]["body"]) == (f"GAUGE/{PLATE}", "plate")
    assert (fault["finding"]["key"], fault["finding"]["left_out"]) == ("(file)", True)


# --- fuzz ------------------------------------------------------------------------------------------------------------


def read_all(content, name):
    """What an import does with a file; the trial, where it can be used. Any other error than a named one is a bug."""
    experiment = load_experiment(name)
    try:
        trial = parse_trial(content)
        trajectory = trial_trajectory(trial, experiment)
        assert (
            trajectory.shape[0] == experiment.frame_count
            and not np.isinf(trajectory).any()
        )
    except TrialError as error:
        assert error.key and error.problem and error.expected
        assert all(
            part.isprintable() for part in (error.key, error.problem, error.expected)
        )
        return None
    with contextlib.suppress(TrialError):
        driver_tracks(trial, experiment)
    return trial


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["x", "y", "qx", "1"]), inner, max_size=4)
    ),
    max_leaves=8,
)


def small_trial(name):
    """A trial of few markers' and frames' worth of numbers, quick to copy and to write."""
    (content,) = synthetic_trials(name, [0.3], frames_after=0).contents
    return content


SMALL = {name: small_trial(name) for name in (SLIDER, PLATE, FOAM)}


def places(value, path=()):
    """Paths to all that a file holds, samples of lists by the first and the last."""
    found = [path] if path else []
    if isinstance(value, Mapping):
        for key, inner in value.items():
            found += places(inner, (*path, key))
    elif isinstance(value, list):
        found += [(*path, 0), (*path, len(value) - 1)]
    return found


PLACES = {name: places(content) for name, content in SMALL.items()}


@given(data=st.data(), name=st.sampled_from(sorted(SMALL)))
@settings(max_examples=100)
def test_a_trial_with_changed_places_is_used_or_a_named_fault(data, name):
    content = copy.deepcopy(SMALL[name])
    for path in data.draw(
        st.lists(st.sampled_from(PLACES[name]), min_size=1, max_size=3)
    ):
        place = content
        try:
            for key in path[:-1]:
                place = place[key]
            if data.draw(st.booleans()):
                place[path[-1]] = data.draw(VALUES)
            else:
                del place[path[-1]]
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change took the place away
    read_all(json.dumps(content).encode(), name)


@given(
    cut=st.integers(0, 2000),
    flips=st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), max_size=3),
)
@settings(max_examples=100)
def test_a_trial_with_changed_bytes_is_used_or_a_named_fault(cut, flips):
    content = bytearray(json.dumps(SMALL[SLIDER]).encode())
    for place, byte in flips:
        content[place % len(content)] = byte
    read_all(bytes(content[: len(content) - cut] if cut < 20 else content), SLIDER)
