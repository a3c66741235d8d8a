"""Scenes of checks as files: plain MuJoCo runs them, and its motions get the verdicts of the engine's adapter."""

import csv
import json
import re
import runpy
from xml.etree import ElementTree

import pytest
from places import ROOT

from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.tools.conformance import Status
from gauge_envs.tools.conformance.files import export_scenes, judge_motions

run_all = runpy.run_path(str(ROOT / "examples" / "check_scenes.py"))["run_all"]
QUICK = [
    *("crossed-edges", "oblique-grip", "oblique-slip", "oblique-fast", "strike-aside"),
    *("thin-wall", "rebound-flat", "rebound-slow", "rebound-0.5", "spin-on-point"),
    *("spinning-top", "tether-length", "spin-momentum", "drop-energy"),
    *("start-velocity-of-origin", "pucks-friction", "roll-ball", "rest-small"),
    *("torsion", "seam-roll", "mass-ratio"),
]
PUBLISHED = json.loads((ROOT / "scoring" / "conformance.json").read_text())["columns"]
MUJOCO = next(
    column["results"]
    for column in PUBLISHED
    if (column["backend"], column["name"]) == ("mujoco", "default")
)


def scenes_of(folder, checks):
    exported = export_scenes(folder, checks)
    run_all(folder)
    return exported


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenes") / "plain"
    assert sorted(scenes_of(folder, QUICK)) == sorted(QUICK)
    return folder


def assert_verdicts_of_the_adapter(folder, checks):
    results = judge_motions(folder, checks).results
    assert len(results) > 20
    for name, result in results.items():
        published = MUJOCO[name]
        assert result.status == Status(published["status"]), name
        close = pytest.approx(published["measured"], abs=0.1 * published["width"])
        assert result.measured == close, name


def test_plain_mujoco_gets_the_verdicts_of_the_adapter(folder):
    assert_verdicts_of_the_adapter(folder, QUICK)


@pytest.mark.slow
def test_plain_mujoco_gets_all_verdicts_of_the_adapter(tmp_path):
    exported = scenes_of(tmp_path, [])
    assert len(exported) > 45
    assert_verdicts_of_the_adapter(tmp_path, exported)


def test_each_scene_is_there_in_both_formats_with_its_law(folder):
    table = json.loads((folder / "checks.json").read_text())
    for name, run in table["runs"].items():
        model = ElementTree.parse(folder / f"{name}.xml").getroot()
        bodies = {body.get("name") for body in model.iter("body")}
        assert bodies >= set(run["bodies"])
        has_compound = name.startswith(("spin-momentum", "start-velocity"))
        assert (folder / f"{name}.usda").exists() != has_compound
    assert table["checks"]["roll-ball"]["law"].startswith("a = 5/7 g sin(slope)")
    assert table["checks"]["roll-ball"]["width"] == 0.01
    assert table["checks"]["torsion"]["runs"] == ["torsion-1", "torsion-2"]


@pytest.mark.parametrize(
    ("check", "old", "new"),
    [
        ("pucks-friction", r'friction="0\.(\d+)', r'friction="0.0\1'),
        ("free-fall", r'gravity="0 0 -9', 'gravity="0 0 -8'),
        ("rebound-slow", r"<keyframe>.*</keyframe>", ""),
        ("seam-roll", r'(tile 1" .*?pos="\S+ \S+ -0.02)5', r"\1"),
    ],
)
def test_a_fault_in_the_run_of_a_scene_is_caught(tmp_path, check, old, new):
    """The friction is low, gravity is low, the start velocities are lost, or a tile is 5 mm high."""
    export_scenes(tmp_path, [check])
    changed = 0
    for file in tmp_path.glob("*.xml"):
        text, count = re.subn(old, new, file.read_text(), flags=re.DOTALL)
        file.write_text(text)
        changed += count
    assert changed
    run_all(tmp_path)
    results = judge_motions(tmp_path, []).results
    assert [result.status for result in results.values()] == [Status.FAIL]


def test_a_motion_that_is_missing_or_short_is_named(tmp_path, gauge):
    scenes_of(tmp_path, ["crossed-edges", "spin-on-point"])
    (tmp_path / "spin-on-point-1.csv").unlink()
    file = tmp_path / "crossed-edges-1.csv"
    rows = list(csv.reader(file.open(newline="")))
    file.write_text("\n".join(",".join(row) for row in rows[:-1]))
    results = judge_motions(tmp_path, []).results
    assert results["spin-on-point"].missing == ("there is no spin-on-point-1.csv",)
    text = results["crossed-edges"].diagnosis
    assert re.search(
        r"'an edge across an edge 1' needs 37 rows, each 0.00555556 s", text
    )
    result = gauge("backend", "check", "--judge", tmp_path)
    assert result.exit_code == 1
    assert "0 pass, 0 fail, 1 error, 1 unsupported of 2" in result.stdout


def test_scenes_of_other_checks_are_rejected(tmp_path, gauge):
    with pytest.raises(ParameterError, match="cloth-strike has no scene for a file"):
        export_scenes(tmp_path, ["cloth-strike"])
    gauge("backend", "check", "--export", tmp_path, "--only", "oblique-grip")
    file = tmp_path / "checks.json"
    table = json.loads(file.read_text())
    table["checks"]["oblique-grip"]["fingerprint"] = "of another revision"
    file.write_text(json.dumps(table))
    with pytest.raises(ResultFileError, match="oblique-grip has changed since"):
        judge_motions(tmp_path, [])


@pytest.mark.parametrize(
    "words", [(), ("mujoco", "--judge", "x"), ("--judge", "x", "--set", "a=1")]
)
def test_files_and_engines_exclude_each_other(gauge, words):
    result = gauge("backend", "check", *words)
    assert (result.exit_code, result.stdout) == (2, "")
