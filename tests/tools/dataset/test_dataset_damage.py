"""Damaged trial files: each is named, with its place and what would be right, and the others are used without it."""

import contextlib
import copy
import json
import re
from collections.abc import Mapping

import numpy as np
import pytest
from dataset_writer import (
    AMOUNTS,
    synthetic_trials,
    trial_folder,
    write_synthetic,
    write_trial,
)
from hypothesis import given, settings, strategies as st
from imports import band_of, import_contents, imported

from gauge_envs import load_experiment
from gauge_envs.references.imported import load_imported
from gauge_envs.tools.dataset.findings import TrialError
from gauge_envs.tools.dataset.observation import driver_tracks, trial_trajectory
from gauge_envs.tools.dataset.trial import Stated, parse_trial

SLIDER, FOAM, PLATE = "SlopeSlider-1-wood", "FoamBending-soft", "Turntable-2-wood"


def encoded(content):
    return json.dumps(content).encode()


def raw(content):
    return lambda _: content


def put(place, *values):
    """Puts a value at a place such as `cube.x.4`, or takes away what is there."""
    *path, last = place.split(".")

    def change(content):
        inner = content
        for key in path:
            inner = inner[key]
        key = int(last) if isinstance(inner, list) else last
        if values:
            (inner[key],) = values
        else:
            del inner[key]
        return content

    return change


def cube(change, keys="x y z"):
    """Changes lists of the cube."""

    def edit(content):
        for key in keys.split():
            content["cube"][key] = change(content["cube"][key])
        return content

    return edit


def exchanged(asset, first, second):
    def edit(content):
        lists = content[asset]
        lists[first], lists[second] = lists[second], lists[first]
        return content

    return edit


# Variant, what is done to a trial, and the place, the fault and what would be right.
DAMAGES = [
    (SLIDER, raw(b" \n"), r"\(file\): it is not JSON: .*; a complete file"),
    (SLIDER, lambda content: encoded(content)[:500], r"\(file\): it is not JSON"),
    (SLIDER, raw(b"[1, 2]"), r"\(file\): it is not JSON: it is a list"),
    (SLIDER, raw(bytes(range(256))), r"\(file\): it is not JSON"),
    (SLIDER, put("FPS", 60), "FPS: it is 60; 30 is expected"),
    (SLIDER, put("FPS"), "FPS: it is missing; 30 is expected; --rate 30"),
    (SLIDER, put("translation unit", "inch"), "translation unit: it is 'inch'; 'mm' is expected"),
    (SLIDER, put("translation unit"), "translation unit: it is missing; .*--unit mm"),
    (SLIDER, cube(lambda values: [value / 1e3 for value in values]), "cube: it starts .* mm from"),
    (SLIDER, exchanged("cube", "y", "z"), "cube: .*its axes look exchanged; its lists x, z, y hold"),
    (SLIDER, put("cube"), r"\(file\): it holds no asset; .*'cube'"),
    (SLIDER, lambda content: {"box": content.pop("cube")} | content, "cube: .* missing; the file has box"),
    (SLIDER, put("cube.z"), "cube.z: it is missing; an asset has x, y, z"),
    (SLIDER, put("cube.y", 1.0), "cube.y: it is 1.0; a list of numbers"),
    (SLIDER, put("cube.y", []), r"cube.y: it is \[\]; a list of numbers"),
    (SLIDER, put("cube.qy", [0.0] * 3), "cube.qy: it has 3 samples; .*as in cube.qx"),
    (SLIDER, put("cube.x.4", "east"), "cube.x: .*'east'; a list of numbers"),
    (SLIDER, put("cube.x.4", float("inf")), r"cube.x\[4\]: it is inf mm; .*a few metres"),
    (SLIDER, put("cube.qw.3", 0.9), r"cube.q\[3\]: .*norm is 0.9; 1 is expected"),
    (SLIDER, cube(lambda values: values[:5], "x y z qx qy qz qw"), r"\(file\): it has 5 frames; 9 or more"),
    (SLIDER, cube(lambda values: [None] * len(values)), "cube: it was never captured"),
    (FOAM, put("foam"), "markers: the marker set is missing; the file has cube"),
    (FOAM, put("foam.5"), "foam: it has 13 markers; 14 are expected"),
    (FOAM, put("foam.5", 3), "foam.5: it is 3; .*an object with x, y, z"),
    (FOAM, put("foam.8.x", [0.0]), "foam.8.y: it has .* samples; 1 are expected, as in foam.8.x"),
    (FOAM, exchanged("foam", "5", "44"), "markers.5: it starts where marker 13.*; .*the metadata's markers"),
]  # fmt: skip


@pytest.mark.parametrize("name", [SLIDER, FOAM])
def test_damaged_files_are_named_and_the_others_are_used(name, tmp_path):
    write_synthetic(tmp_path, name)
    imported(tmp_path)
    undamaged = band_of(name)
    expected = {}
    for number, (variant, change, words) in enumerate(DAMAGES, start=99):
        if variant == name:
            (content,) = synthetic_trials(name, [0.3 + 1e-3 * number]).contents
            damaged = change(content)
            if not isinstance(damaged, bytes):
                damaged = encoded(damaged)
            file = write_trial(tmp_path, name, number, damaged)
            expected[file.relative_to(tmp_path).as_posix()] = words
    file.with_name("trial-7.json").write_bytes(
        file.with_name("trial-2.json").read_bytes()
    )
    file.with_name("trial-8.json").mkdir()
    folder = trial_folder(name)
    expected[f"{folder}/trial-7.json"] = r"\(file\): it is a copy of .*trial-2"
    expected[f"{folder}/trial-8.json"] = r"\(file\): it cannot be read"
    outcome = imported(tmp_path)[name]
    findings = {finding.file: finding for finding in outcome.findings}
    assert set(findings) == set(expected)
    for file, words in expected.items():
        assert re.search(f"^{re.escape(file)}: {words}", str(findings[file]))
        assert findings[file].left_out
    assert (outcome.used, outcome.left_out) == (len(AMOUNTS), len(expected))
    np.testing.assert_array_equal(band_of(name).mean, undamaged.mean)
    np.testing.assert_array_equal(band_of(name).sigma, undamaged.sigma)


def test_a_damaged_driver_costs_the_driver_alone(tmp_path):
    contents = synthetic_trials(PLATE).contents
    del contents[0]["plate"]
    for key in ("qx", "qy", "qz", "qw"):
        del contents[1]["plate"][key]
    contents[2]["plate"]["x"][0] = None
    contents[2]["lamp"] = {"x": [1.0]}
    outcome = import_contents(tmp_path, PLATE, contents)
    assert (outcome.used, outcome.left_out) == (4, 0)
    keys = [finding.key for finding in outcome.findings if not finding.left_out]
    assert keys == ["plate", "plate.qx", "plate[0]", "lamp.y"]
    assert outcome.facts.drivers[0].trial_count == 1


def test_two_trials_are_needed(tmp_path):
    write_synthetic(tmp_path, SLIDER, [0.0])
    outcome = imported(tmp_path)[SLIDER]
    assert outcome.facts is None and load_imported(SLIDER) is None
    assert "1 of its trials can be used; 2 or more" in str(outcome.findings[0])


def test_the_command_imports_the_rest_and_exits_with_1(tmp_path, gauge):
    for name in (SLIDER, PLATE):
        write_synthetic(tmp_path, name)
    for number in (98, 99):
        write_trial(tmp_path, SLIDER, number, b"{%d" % number)
    result = gauge("data", "import", tmp_path)
    assert result.exit_code == 1
    (line,) = (line for line in result.stderr.splitlines() if "left out" in line)
    assert line.startswith(f"left out: {trial_folder(SLIDER)}/trial-98.json: (file)")
    assert "8 trials of 2 experiments imported" in result.stderr
    assert SLIDER in result.stdout and PLATE in result.stdout
    lines = gauge("data", "import", tmp_path, "--json").stdout.splitlines()
    slider, plate, *faults = map(json.loads, lines)
    assert (slider["id"], slider["left_out"]) == (f"GAUGE/{SLIDER}", 2)
    assert (plate["id"], plate["drivers"][0]["body"]) == (f"GAUGE/{PLATE}", "plate")
    assert [fault["finding"]["key"] for fault in faults] == ["(file)", "(file)"]


# --- CSV -------------------------------------------------------------------------------------------------------------

RATE, UNIT = "# fps: 30\n", "# unit: mm\n"


def csv_content(content, comments=RATE + UNIT, separator=",", end="\n"):
    """The lists of a trial as columns `cube.x`, `foam.17.x`, with one that nobody asked for."""
    columns = {}
    for name, asset in content.items():
        for key, entry in asset.items() if isinstance(asset, dict) else ():
            lists = entry if isinstance(entry, dict) else {"": entry}
            for axis, values in lists.items():
                columns[f"{name}.{key}.{axis}".strip(".")] = values
    columns["confidence"] = ["high"] * len(next(iter(columns.values())))
    rows = [columns, *zip(*columns.values(), strict=True)]
    lines = [separator.join(map(str, row)).replace("None", "") for row in rows]
    return (comments + "\n".join(lines) + "\n").replace("\n", end).encode()


@pytest.mark.parametrize("name", [PLATE, FOAM])
@pytest.mark.parametrize(
    ("encode", "suffix"),
    [
        (csv_content, ".csv"),
        (lambda content: b"\xef\xbb\xbf" + csv_content(content, end="\r\n"), ".csv"),
        (lambda content: csv_content(content, "", separator=";"), ".csv"),
        (lambda content: b"\xef\xbb\xbf" + encoded(content), ".json"),
    ],
)
def test_other_forms_hold_the_same_trial(name, encode, suffix):
    (content,) = synthetic_trials(name, [0.3]).contents
    content[load_experiment(name).scene.drivers[0].body]["x"][4] = None
    expected = parse_trial(encoded(content))
    stated = Stated(unit="mm", rate_hz=30.0)
    trial = parse_trial(encode(content), suffix, stated)
    for body, track in expected.poses.items():
        found = trial.poses[body]
        np.testing.assert_array_equal(found.positions_mm, track.positions_mm)
        np.testing.assert_array_equal(found.quaternions_xyzw, track.quaternions_xyzw)
    for body, markers in expected.markers.items():
        for marker, positions in markers.items():
            np.testing.assert_array_equal(trial.markers[body][marker], positions)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (lambda trial: csv_content(trial, UNIT), "FPS: it is missing; 30 is expected; --rate 30"),
        (lambda trial: csv_content(trial, RATE), "--unit mm states that of files without one"),
        (lambda trial: csv_content(trial).replace(b"cube.qx", b"cube.x"), "a column occurs twice"),
        (lambda trial: b"cube.x,cube.y\n1\n", "a header and rows of equal length are needed"),
        (lambda trial: b"\xff\xfe", "it is not CSV"),
        (lambda trial: b"", "it is not CSV"),
    ],
)  # fmt: skip
def test_a_damaged_table_is_an_error_that_says_what_to_do(content, words):
    (trial,) = synthetic_trials(SLIDER, [0.3]).contents
    with pytest.raises(TrialError, match=words):
        parse_trial(content(trial), ".csv")


# --- fuzz ------------------------------------------------------------------------------------------------------------


def read_all(content, name):
    """What an import does with a file: it is used, or a named error is raised. Any other error is a bug."""
    experiment = load_experiment(name)
    with contextlib.suppress(TrialError):
        trial = parse_trial(content)
        trajectory = trial_trajectory(trial, experiment)
        assert trajectory.shape[0] == experiment.frame_count
        assert not np.isinf(trajectory).any()
        driver_tracks(trial, experiment)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["x", "y", "qx", "1"]), inner, max_size=4)
    ),
    max_leaves=8,
)
SMALL = {
    name: synthetic_trials(name, [0.3], frames_after=0).contents[0]
    for name in (SLIDER, PLATE, FOAM)
}


def places(value, path=()):
    """Paths to all that a file holds, samples of lists by the first and the last."""
    yield from [path] if path else []
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from places(inner, (*path, key))
    elif isinstance(value, list):
        yield from ((*path, 0), (*path, len(value) - 1))


PLACES = {name: list(places(content)) for name, content in SMALL.items()}


@given(data=st.data(), name=st.sampled_from(sorted(SMALL)))
@settings(max_examples=100)
def test_a_trial_with_changed_places_is_used_or_a_named_fault(data, name):
    content = copy.deepcopy(SMALL[name])
    changes = st.lists(st.sampled_from(PLACES[name]), min_size=1, max_size=3)
    for path in data.draw(changes):
        place = content
        # An earlier change may have taken the place away.
        with contextlib.suppress(KeyError, IndexError, TypeError):
            for key in path[:-1]:
                place = place[key]
            if data.draw(st.booleans()):
                place[path[-1]] = data.draw(VALUES)
            else:
                del place[path[-1]]
    read_all(encoded(content), name)
