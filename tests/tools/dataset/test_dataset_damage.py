"""Damaged trial files are left out, and named with the place and the expected content."""

import json
import re

import numpy as np
import pytest
from dataset_writer import (
    AMOUNTS,
    synthetic_trials,
    trial_folder,
    write_synthetic,
    write_trial,
)
from imports import band_of, import_contents, imported

from gauge_envs.references.user_data import imported_file
from gauge_envs.tools.dataset.trial import parse_trial

SLIDER, FOAM, PLATE = "SlopeSlider-1-wood", "FoamBending-soft", "Turntable-2-wood"


def encoded(content):
    return json.dumps(content).encode()


def put(place, *values):
    """Return a change that sets or deletes a value at a place such as `cube.x.4`."""
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
    """Return a change of lists of the cube."""

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


def copied(asset, first, second):
    def edit(content):
        content[asset][second] = content[asset][first]
        return content

    return edit


# Variant, change of a trial, and expected message.
DAMAGES = [
    (SLIDER, lambda content: encoded(content)[:500], r"\(file\): it is not JSON: .*; expected a complete file"),
    (SLIDER, put("FPS"), "FPS: it is missing; .*--rate 30"),
    (SLIDER, cube(lambda values: [value / 1e3 for value in values]), "cube: it starts .* mm from"),
    (SLIDER, lambda content: {"box": content.pop("cube")} | content, "cube: .* missing; the file has box"),
    (SLIDER, put("cube.y", 1.0), "cube.y: it is 1.0; expected a list"),
    (SLIDER, put("cube.x.4", float("inf")), r"cube\[4\]: it is more than 100 m away; .*a few metres"),
    (SLIDER, put("cube.qw.3", 0.9), r"cube.q\[3\]: .*norm is 0.9; expected 1"),
    (SLIDER, cube(lambda values: values[:5], "x y z qx qy qz qw"), r"\(file\): it has 5 frames; at least 9"),
    (FOAM, put("foam"), "markers: the marker set is missing; the file has cube"),
    (FOAM, put("foam.5"), "markers: it has 13 markers; expected 14"),
    (FOAM, copied("foam", "5", "8"), "marker-1: it is at the place of marker-0 in frame 0"),
    (FOAM, exchanged("foam", "5", "44"), "markers.5: it starts at marker 13.*; .*the metadata's markers"),
]  # fmt: skip


@pytest.mark.parametrize("name", [SLIDER, FOAM])
def test_damaged_files_are_named_and_the_rest_is_used(name, tmp_path):
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


def test_a_damaged_driven_body_leaves_the_trial_in_the_band(tmp_path):
    contents = synthetic_trials(PLATE).contents
    del contents[0]["plate"]
    for key in ("qx", "qy", "qz", "qw"):
        del contents[1]["plate"][key]
    contents[2]["plate"]["x"][:3] = [None] * 3
    outcome = import_contents(tmp_path, PLATE, contents)
    assert (outcome.used, outcome.left_out) == (len(AMOUNTS), 0)
    keys = [finding.key for finding in outcome.findings if finding.left_out]
    assert keys == ["plate", "plate.qx", "plate[0]"]
    assert outcome.facts.drivers[0].trial_count == len(AMOUNTS) - 3


def test_the_command_imports_the_rest_and_exits_with_1(tmp_path, gauge):
    cloth = "TableclothPulling-wood"  # without published baselines
    write_synthetic(tmp_path, SLIDER)
    write_synthetic(tmp_path, cloth)
    write_synthetic(tmp_path, PLATE, [0.0])
    for number in (98, 99):
        write_trial(tmp_path, SLIDER, number, b"{%d" % number)
    result = gauge("data", "import", tmp_path)
    assert result.exit_code == 1
    table = " ".join(result.stdout.split())
    assert "trial-98.json" in table and "(file): it is not JSON" in table
    assert "usable trials: 1; at least 2" in table
    assert f"{2 * len(AMOUNTS)} trials of 2 experiments imported" in result.stderr
    assert result.stdout.count("RMSE") == 3
    assert "2 of 6 baselines differ" in result.stdout
    lines = gauge("data", "import", tmp_path, "--json").stdout.splitlines()
    rows = [json.loads(line) for line in lines]
    slider, plate, table = (
        next(row for row in rows if row.get("id") == f"GAUGE/{name}")
        for name in (SLIDER, PLATE, cloth)
    )
    assert (slider["imported"], slider["left_out"]) == (True, 2)
    assert (plate["imported"], plate["frames"]) == (False, None)
    assert table["drivers"][0]["body"] == "rod"
    keys = [row["finding"]["key"] for row in rows if "finding" in row]
    # One trial has nothing to be compared with.
    assert keys == ["(file)", "(file)", "(folder)", "(folder)"]


def test_a_damaged_import_fails_alone(tmp_path, gauge):
    """The run names the id with the command that renews it, and runs the others."""
    names = ("SlopeSlider-1-wood", "SlopeSlider-1-plastic")
    for name in names:
        write_synthetic(tmp_path, name)
    assert gauge("data", "import", tmp_path).exit_code == 0
    file = imported_file(names[1])
    file.write_bytes(file.read_bytes()[:400])
    result = gauge("run", "SlopeSlider-1-wood", names[1], "--use", "imported")
    assert result.exit_code == 1
    said = " ".join(result.stderr.split())
    assert f"failed: {names[1]}" in said and f"import DIR {names[1]} renews it" in said
    assert "1 finished, 1 failed" in said


def test_encoding_line_ends_and_unit_do_not_change_a_trial(tmp_path, gauge):
    """The file has a byte-order mark, line ends of Windows and metres; the user gives the rate."""
    (content,) = synthetic_trials(SLIDER, [0.3]).contents
    expected = parse_trial(encoded(content)).pose_track("cube").positions_mm
    for axis in "xyz":
        content["cube"][axis] = [value / 1e3 for value in content["cube"][axis]]
    content["translation unit"] = "m"
    del content["FPS"]
    text = json.dumps(content, indent=1).replace("\n", "\r\n")
    trial = parse_trial(b"\xef\xbb\xbf" + text.encode(), {"FPS": 30.0})
    positions_mm = trial.pose_track("cube").positions_mm
    np.testing.assert_allclose(positions_mm, expected, rtol=1e-12)
    del content["translation unit"]
    write_trial(tmp_path, SLIDER, 1, content)
    content["cube"]["y"] = [value + 1e-3 for value in content["cube"]["y"]]
    write_trial(tmp_path, SLIDER, 2, content)
    result = gauge("data", "import", tmp_path, "--unit", "m", "--rate", "30")
    assert result.exit_code == 0 and "2 trials" in result.stderr
