"""Damaged trial files: each is named, with its place and what would be right, and the others are used without it."""

from __future__ import annotations

import contextlib
import copy
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_writer import (
    AMOUNTS,
    body_asset,
    marker_asset,
    scaled_markers,
    synthetic_trials,
    trial_folder,
    write_synthetic,
    write_trial,
)
from hypothesis import given, settings, strategies as st
from typer.testing import CliRunner

from gauge_envs import load_experiment
from gauge_envs.cli.app import app
from gauge_envs.evaluation.reference import load_band
from gauge_envs.references.imported import load_imported
from gauge_envs.references.user_data import DataSource
from gauge_envs.tools.dataset.findings import TrialError
from gauge_envs.tools.dataset.importer import import_trials
from gauge_envs.tools.dataset.layout import find_trials
from gauge_envs.tools.dataset.observation import driver_tracks, trial_trajectory
from gauge_envs.tools.dataset.trial import Trial, parse_trial

SLIDER, FOAM, PLATE = "SlopeSlider-1-wood", "FoamBending-soft", "Turntable-2-wood"
NUMBER = 99

Change = Callable[[dict[str, Any]], Any]


def setting(*path: str, to: Any) -> Change:
    """Puts a value at a place; a frame's number picks a sample."""

    def change(content: dict[str, Any]) -> dict[str, Any]:
        place: Any = content
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = to
        return content

    return change


def without(*path: str) -> Change:
    def change(content: dict[str, Any]) -> dict[str, Any]:
        place: Any = content
        for key in path[:-1]:
            place = place[key]
        del place[path[-1]]
        return content

    return change


def text(change: Callable[[str], str]) -> Change:
    """Changes the file's text."""
    return lambda content: change(json.dumps(content)).encode()


def in_metres(content: dict[str, Any]) -> dict[str, Any]:
    cube = content["cube"]
    return content | {
        "cube": cube | {key: [value / 1e3 for value in cube[key]] for key in "xyz"}
    }


def shortened(content: dict[str, Any]) -> dict[str, Any]:
    return content | {
        "cube": {key: values[:5] for key, values in content["cube"].items()}
    }


def never_captured(content: dict[str, Any]) -> dict[str, Any]:
    cube = content["cube"]
    return content | {"cube": cube | {key: [None] * len(cube[key]) for key in "xyz"}}


def swapped_markers(content: dict[str, Any]) -> dict[str, Any]:
    first, *_, last = sorted(content["foam"], key=int)
    content["foam"][first], content["foam"][last] = (
        content["foam"][last],
        content["foam"][first],
    )
    return content


def nested(content: dict[str, Any]) -> bytes:
    return b'{"a":' * 100_000 + b"1" + b"}" * 100_000


# Experiment, how the file is damaged, where, what is wrong, what would be right.
DAMAGES: dict[str, tuple[str, Change, str, str, str]] = {
    "empty": (SLIDER, lambda content: b" \n", "(file)", "it is empty", "a JSON object"),
    "cut off": (
        SLIDER,
        text(lambda line: line[: len(line) // 2]),
        "(file)",
        "it is not JSON",
        "a complete JSON object",
    ),
    "not an object": (
        SLIDER,
        lambda content: b"[1, 2]",
        "(file)",
        "it is a JSON list",
        "a JSON object",
    ),
    "not text": (
        SLIDER,
        lambda content: b'{"FPS": "\xff\xfe"}',
        "(file)",
        "it is not text",
        "UTF-8",
    ),
    "too deep": (SLIDER, nested, "(file)", "nested too deeply", "lists of numbers"),
    "wrong rate": (SLIDER, setting("FPS", to=60), "FPS", "it is 60", "30 is expected"),
    "no rate": (SLIDER, without("FPS"), "FPS", "it is missing", "30 is expected"),
    "rate as text": (
        SLIDER,
        setting("FPS", to="30"),
        "FPS",
        "it is '30'",
        "30 is expected",
    ),
    "wrong unit": (
        SLIDER,
        setting("translation unit", to="inch"),
        "translation unit",
        "it is 'inch'",
        "'mm' is expected",
    ),
    "no unit": (
        SLIDER,
        without("translation unit"),
        "translation unit",
        "it is missing",
        "'mm' is expected",
    ),
    "in metres": (
        SLIDER,
        in_metres,
        "cube",
        "mm from its calibrated start",
        "in mm, is expected",
    ),
    "no asset": (SLIDER, without("cube"), "(file)", "it holds no asset", "'cube'"),
    "other asset": (
        SLIDER,
        text(lambda line: line.replace('"cube"', '"sphere"')),
        "cube",
        "the rigid body is missing",
        "the file has sphere",
    ),
    "no list": (
        SLIDER,
        without("cube", "z"),
        "cube.z",
        "it is missing",
        "an asset has x, y, z",
    ),
    "half a quaternion": (
        SLIDER,
        without("cube", "qz"),
        "cube.qz",
        "it is missing",
        "qx, qy, qz, qw",
    ),
    "not a list": (
        SLIDER,
        setting("cube", "y", to=1.0),
        "cube.y",
        "it is 1.0",
        "a list of numbers",
    ),
    "empty list": (
        SLIDER,
        setting("cube", "y", to=[]),
        "cube.y",
        "it is an empty list",
        "a list of numbers",
    ),
    "unequal lengths": (
        SLIDER,
        setting("cube", "qy", to=[0.0] * 3),
        "cube.qy",
        "it has 3 samples",
        "as in cube.x",
    ),
    "text as number": (
        SLIDER,
        setting("cube", "x", 4, to="12"),
        "cube.x[4]",
        "it is '12'",
        "a number or null",
    ),
    "truth as number": (
        SLIDER,
        setting("cube", "x", 4, to=True),
        "cube.x[4]",
        "it is True",
        "a number or null",
    ),
    "infinite": (
        SLIDER,
        setting("cube", "x", 4, to=math.inf),
        "cube.x[4]",
        "it is inf",
        "a finite number",
    ),
    "huge": (
        SLIDER,
        setting("cube", "x", 4, to=10**400),
        "cube.x",
        "a number is too large",
        "finite numbers",
    ),
    "far away": (
        SLIDER,
        setting("cube", "x", 4, to=1e9),
        "cube.x[4]",
        "it is 1e+09 mm",
        "a few metres",
    ),
    "quaternion norm": (
        SLIDER,
        setting("cube", "qw", 3, to=0.9),
        "cube.q[3]",
        "norm is 0.9",
        "1 is expected",
    ),
    "quaternion overflow": (
        SLIDER,
        setting("cube", "qw", 3, to=1.4e154),
        "cube.q[3]",
        "norm is inf",
        "1 is expected",
    ),
    "too short": (SLIDER, shortened, "(file)", "it has 5 frames", "9 or more"),
    "never captured": (
        SLIDER,
        never_captured,
        "cube",
        "it was never captured",
        "samples are expected",
    ),
    "twice": (
        SLIDER,
        text(lambda line: line.replace('"x"', '"y"', 1)),
        "y",
        "the key occurs twice",
        "unique names",
    ),
    "no markers": (
        FOAM,
        without("foam"),
        "markers",
        "the marker set is missing",
        "the file has cube",
    ),
    "marker missing": (
        FOAM,
        without("foam", "5"),
        "foam",
        "it has 13 markers",
        "14 are expected",
    ),
    "marker not one": (
        FOAM,
        setting("foam", "5", to=3),
        "foam.5",
        "it is 3",
        "an object with x, y, z",
    ),
    "marker without z": (
        FOAM,
        without("foam", "8", "z"),
        "foam.8.z",
        "it is missing",
        "x, y, z",
    ),
    "marker order": (
        FOAM,
        swapped_markers,
        "markers.5",
        "it starts where marker 13",
        "the metadata's markers",
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_named_and_the_others_are_used(
    damage: str, tmp_path: Path
) -> None:
    name, change, key, what, right = DAMAGES[damage]
    write_synthetic(tmp_path, name)
    list(import_trials(find_trials(tmp_path)))
    undamaged = load_band(name, DataSource.IMPORTED)
    (content,) = synthetic_trials(name, [0.3]).contents
    file = write_trial(tmp_path, name, NUMBER, change(content))
    (one,) = import_trials(find_trials(tmp_path))
    (finding,) = one.findings
    assert finding.left_out and finding.file == file.relative_to(tmp_path).as_posix()
    assert finding.key == key
    assert what in finding.problem
    assert right in finding.expected
    assert (one.used, one.left_out, one.record.left_out) == (len(AMOUNTS), 1, 1)
    band = load_band(name, DataSource.IMPORTED)
    np.testing.assert_array_equal(band.mean, undamaged.mean)
    np.testing.assert_array_equal(band.sigma, undamaged.sigma)


def test_what_an_experiment_does_not_ask_for_may_be_damaged(tmp_path: Path) -> None:
    """A board that stands still may have one sample; a plate with a broken orientation costs the driver alone."""
    for name in (SLIDER, PLATE):
        contents = synthetic_trials(name).contents
        contents[0]["note"] = "a remark"
        contents[0]["board"] = body_asset(np.zeros((1, 3)))
        contents[1]["lamp"] = {"x": [1.0]}
        if name == PLATE:
            contents[2]["plate"]["qw"][2] = 2.0
        for number, content in enumerate(contents):
            write_trial(tmp_path, name, number, content)
    slider, plate = import_trials(find_trials(tmp_path))
    assert [one.used for one in (slider, plate)] == [4, 4]
    assert [(finding.key, finding.left_out) for finding in slider.findings] == [
        ("lamp.y", False)
    ]
    assert [(finding.key, finding.left_out) for finding in plate.findings] == [
        ("lamp.y", False),
        ("plate.q[2]", False),
    ]
    assert plate.record.drivers[0].trial_count == 3


def test_recorded_bodies_are_equally_long(tmp_path: Path) -> None:
    name = "RopeWinding-rubber"
    write_synthetic(tmp_path, name)
    (content,) = synthetic_trials(name, [0.3]).contents
    content["ball-2"] = {key: values[:-1] for key, values in content["ball-2"].items()}
    write_trial(tmp_path, name, NUMBER, content)
    (one,) = import_trials(find_trials(tmp_path))
    assert (one.used, one.left_out) == (4, 1)
    assert (one.findings[0].key, one.findings[0].problem) == (
        "ball-2",
        "it has 94 frames",
    )


def test_marker_sets_of_several_bodies_are_joined(tmp_path: Path) -> None:
    """The beam's markers under its four blocks instead of all together; one file has a block that is shorter."""
    name = "CantileverBeam-soft"
    for number, content in enumerate(synthetic_trials(name).contents):
        ids = sorted(content.pop("markers"), key=int)
        for block in range(4):
            content[f"cube-{block + 1}"] = {}
        for place, marker in enumerate(ids):
            whole = synthetic_trials(name).contents[number]["markers"][marker]
            short = number == 3 and place % 4 == 2
            end = -1 if short else None
            content[f"cube-{place % 4 + 1}"][marker] = {
                key: values[:end] for key, values in whole.items()
            }
        write_trial(tmp_path, name, number, content)
    (one,) = import_trials(find_trials(tmp_path))
    assert (one.used, one.left_out) == (3, 1)
    assert (one.findings[0].key, one.findings[0].problem) == (
        "cube-3",
        "it has 94 frames",
    )
    start = scaled_markers(load_experiment(name), float(np.mean(AMOUNTS[:3])))
    np.testing.assert_allclose(
        load_band(name, DataSource.IMPORTED).mean[5], start.ravel(), rtol=0, atol=1e-9
    )


def test_a_copy_counts_once(tmp_path: Path) -> None:
    write_synthetic(tmp_path, SLIDER)
    folder = tmp_path / trial_folder(SLIDER)
    (folder / "trial-7.json").write_bytes((folder / "trial-2.json").read_bytes())
    (one,) = import_trials(find_trials(tmp_path))
    assert one.used == 4
    assert "is a copy of" in one.findings[0].problem and one.findings[0].file.endswith(
        "trial-7.json"
    )


def test_a_folder_named_as_a_trial_is_named(tmp_path: Path) -> None:
    write_synthetic(tmp_path, SLIDER)
    (tmp_path / trial_folder(SLIDER) / "trial-7.json").mkdir()
    (one,) = import_trials(find_trials(tmp_path))
    assert one.used == 4
    assert one.findings[0].problem.startswith("it cannot be read")


def test_two_trials_are_needed(tmp_path: Path) -> None:
    write_synthetic(tmp_path, SLIDER, [0.0])
    (one,) = import_trials(find_trials(tmp_path))
    assert one.record is None and load_imported(SLIDER) is None
    assert (
        one.findings[0].problem == "1 of its trials can be used"
        and one.findings[0].expected == "2 or more are needed"
    )


def test_the_command_imports_the_rest_and_exits_with_1(tmp_path: Path) -> None:
    for name in (SLIDER, PLATE):
        write_synthetic(tmp_path, name)
    write_trial(tmp_path, SLIDER, NUMBER, b"{")
    runner = CliRunner(env={"COLUMNS": "200"})
    result = runner.invoke(app, ["data", "import", str(tmp_path)])
    assert result.exit_code == 1
    assert (
        f"left out: {trial_folder(SLIDER)}/trial-{NUMBER}.json: (file): it is not JSON"
        in result.stderr
    )
    assert "8 trials of 2 experiments imported" in result.stderr
    assert SLIDER in result.stdout and PLATE in result.stdout
    assert load_imported(SLIDER).record.trial_count == 4
    result = runner.invoke(app, ["data", "import", str(tmp_path), "--json"])
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert [row.get("id") for row in rows] == [
        f"GAUGE/{SLIDER}",
        f"GAUGE/{PLATE}",
        None,
    ]
    assert rows[0]["left_out"] == 1 and rows[1]["drivers"][0]["body"] == "plate"
    assert rows[2]["finding"]["key"] == "(file)" and rows[2]["finding"]["left_out"]


# --- fuzz ------------------------------------------------------------------------------------------------------------


def read_all(content: bytes, name: str) -> Trial | None:
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


@given(st.binary(max_size=60) | VALUES.map(lambda value: json.dumps(value).encode()))
def test_any_bytes_are_a_trial_or_a_named_fault(content: bytes) -> None:
    read_all(content, SLIDER)


def small_trial(name: str) -> dict[str, Any]:
    """A trial of few markers' and frames' worth of numbers, quick to copy and to write."""
    (content,) = synthetic_trials(name, [0.3], frames_after=0).contents
    return content


SMALL = {name: small_trial(name) for name in (SLIDER, PLATE, FOAM)}


def places(value: Any, path: tuple = ()) -> list[tuple]:
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
@settings(max_examples=300, deadline=None)
def test_a_trial_with_changed_places_is_used_or_a_named_fault(
    data: st.DataObject, name: str
) -> None:
    content = copy.deepcopy(SMALL[name])
    for path in data.draw(
        st.lists(st.sampled_from(PLACES[name]), min_size=1, max_size=3)
    ):
        place: Any = content
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
@settings(max_examples=200, deadline=None)
def test_a_trial_with_changed_bytes_is_used_or_a_named_fault(
    cut: int, flips: list[tuple[int, int]]
) -> None:
    content = bytearray(json.dumps(SMALL[SLIDER]).encode())
    for place, byte in flips:
        content[place % len(content)] = byte
    read_all(bytes(content[: len(content) - cut] if cut < 20 else content), SLIDER)


@given(
    st.lists(
        st.tuples(st.floats(-300, 300), st.floats(-300, 300), st.floats(-300, 300)),
        min_size=9,
        max_size=12,
    ),
    st.integers(2, 4),
)
@settings(max_examples=60, deadline=None)
def test_what_is_written_is_what_is_read(
    path: list[tuple[float, float, float]], markers: int
) -> None:
    positions = np.array(path)
    content = {
        "FPS": 30,
        "translation unit": "mm",
        "cube": body_asset(positions),
        "set": marker_asset(
            np.repeat(positions[:, None], markers, axis=1), range(markers)
        ),
    }
    trial = parse_trial(json.dumps(content).encode())
    np.testing.assert_array_equal(trial.poses["cube"].positions_mm, positions)
    assert list(trial.markers["set"]) == [str(marker) for marker in range(markers)]
    np.testing.assert_array_equal(trial.markers["set"]["0"], positions)
