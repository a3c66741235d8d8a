"""Result files of strangers: a damaged one is named and skipped, and its texts change nothing but themselves."""

import copy
import hashlib
import json
import re

import pytest
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.errors import ResultFileError
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result, result_file_name

NAME = "SlopeSlider-2-wood"

HOSTILE = "mujoco\n# heading\n![picture](http://a.b/c)\x1b[2J|`:smile:`$\\frac{$"


@pytest.fixture(scope="module")
def content():
    """Content of a valid result file."""
    return json.loads(
        json.dumps(run_episode(RunRequest(NAME, backend="mujoco")).to_dict())
    )


def asset(**changes):
    return {
        "file": "a.usda",
        "kind": "usd",
        "sha256": "0" * 64,
        "edited": True,
        "changes": [],
    } | changes


# Key, value that is impossible, and what the error says.
DAMAGES = [
    ("asset", asset(sha256=5), "sha256"),
    ("asset", asset(changes=3), "changes"),
    ("asset", asset(kind="picture"), "kind"),
    ("asset", {"edited": True}, "file"),
    ("dataset", 5, "dataset"),
    ("dataset", {"drivers": "elsewhere"}, "dataset.drivers is 'elsewhere'"),
    ("marker_proxy", "ghost", "marker_proxy is 'ghost'"),
    ("score.kind", "gold", "score.kind is 'gold'"),
    ("trajectory.samples", [], "times but 0 samples"),
    (
        "trajectory",
        {"unit": "mm", "coordinates": ["x"], "times_s": [], "samples": []},
        "it has no samples",
    ),
    ("trajectory", None, "no trajectory"),
    ("id", "GAUGE/../../x", "unknown experiment"),
    (
        "trajectory.later_samples",
        [[1e308] * 3] * 60,
        "amounts of at most 1e+12 are expected",
    ),
]


@pytest.mark.parametrize(("key", "value", "reason"), DAMAGES)
def test_one_damaged_file_is_skipped(key, value, reason, content, gauge, tmp_path):
    damaged = copy.deepcopy(content)
    place = damaged
    *path, last = key.split(".")
    for part in path:
        place = place[part]
    place[last] = value
    (tmp_path / "a.json").write_text(json.dumps(damaged))
    (tmp_path / "b.json").write_text(json.dumps(content))
    with pytest.raises(ResultFileError, match="not a result file") as caught:
        load_result(tmp_path / "a.json")
    assert reason in str(caught.value)
    result = gauge("compare", tmp_path)
    assert result.exit_code == 1
    assert "skipped:" in result.stderr and "SlopeSlider" in result.stdout


def test_keys_of_release_0_3_that_are_gone_are_ignored(content, tmp_path):
    old = copy.deepcopy(content)
    old["scatter"] = {"unit": "mm", "run_count": 40, "spreads": [], "verdict": "none"}
    old["deformation"] = None
    old["score"]["explained"] = [{"name": "friction cube/board", "left": 0.5}]
    for name, written in (("old.json", old), ("new.json", content)):
        (tmp_path / name).write_text(json.dumps(written))
    assert load_result(tmp_path / "old.json") == load_result(tmp_path / "new.json")


def test_a_loaded_result_of_a_single_trial_keeps_its_file_name(content, tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(content | {"jitter": {"trial": 0}}))
    digest = hashlib.sha256(b'{"trial": 0}').hexdigest()[:8]
    assert (
        result_file_name(load_result(tmp_path / "a.json"))
        == f"{NAME}.mujoco.calibrated.jitter-{digest}.json"
    )


def test_a_result_whose_scene_cannot_be_built_is_skipped(content, tmp_path):
    (tmp_path / "a.json").write_text(
        json.dumps(content | {"parameters": {"ghost.friction": 1.0}})
    )
    (tmp_path / "b.json").write_text(json.dumps(content))
    for kind in ("experiments", "compare"):
        arguments = [
            "plot",
            str(tmp_path),
            "--kind",
            kind,
            "--out",
            str(tmp_path / kind),
        ]
        result = CliRunner(env={"COLUMNS": "400"}).invoke(app, arguments)
        assert result.exit_code == 1
        assert (
            "a.json: SlopeSlider-2-wood: override 'ghost.friction' names no body"
            in result.stderr
        )
        assert list((tmp_path / kind).glob("*.png"))


@pytest.fixture
def hostile(content, tmp_path):
    """A folder with a result whose texts try to leave their place."""
    folder = tmp_path / "results"
    folder.mkdir()
    for number, name in enumerate(("mujoco", HOSTILE)):
        changed = content | {
            "backend": name,
            "settings_given": {HOSTILE: 1.0},
            "versions": {HOSTILE: HOSTILE},
        }
        (folder / f"{number}.json").write_text(json.dumps(changed))
    return folder


def test_markdown_gets_no_heading_picture_or_code(hostile, gauge):
    result = gauge("compare", hostile, "--format", "markdown")
    assert result.exit_code == 0
    assert not [line for line in result.stdout.splitlines() if line.startswith("#")]
    assert (
        not re.search(r"(?<!\\)(!\[|\]\()", result.stdout)
        and "\x1b" not in result.stdout
    )
    for block in result.stdout.split("\n\n"):
        rows = [
            line.replace("\\|", "")
            for line in block.splitlines()
            if line.startswith("|")
        ]
        assert len({row.count("|") for row in rows}) <= 1
    assert r"\`:smile:\`" in result.stdout


def test_a_dollar_sign_starts_no_formula(hostile, gauge, tmp_path):
    for kind in ("experiments", "compare"):
        result = gauge("plot", hostile, "--kind", kind, "--out", tmp_path / kind)
        assert result.exit_code == 0, result.exception
        assert list((tmp_path / kind).glob("*.png"))
