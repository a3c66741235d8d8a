"""The study of checks by release: table, badges, workflow and stored numbers."""

import json

import mujoco
import pytest
import yaml
from places import ROOT

from gauge_envs.tools.versions import environments
from studies.what_changed import checks, engine_releases, what_changed


def test_the_note_has_the_checks_by_release():
    page = (ROOT / "studies" / "what_changed" / "README.md").read_text()
    assert what_changed.table() in page
    assert json.loads(what_changed.BADGE.read_text()) == what_changed.badge()


def test_a_release_of_an_engine_is_in_table_and_badge(tmp_path, monkeypatch):
    """Planted: a release of Drake in which a box on a slope rests, as in 1.37."""
    page = (ROOT / "studies" / "what_changed" / "README.md").read_text()
    assert engine_releases.table() in page
    before = engine_releases.badges()
    for engine, badge in before.items():
        file = engine_releases.HERE / f"badge_{engine}.json"
        assert json.loads(file.read_text()) == badge
    copied = tmp_path / "engines.csv"
    copied.write_bytes(engine_releases.RESULTS.read_bytes())
    monkeypatch.setattr(engine_releases, "RESULTS", copied)
    row = next(
        one for one in engine_releases.results() if one["release"] == "drake==1.51.1"
    )
    engine_releases.store("drake==1.60.0", row | {"slide": "0"})
    monkeypatch.setattr(
        engine_releases,
        "released_versions",
        lambda engine, *_, **__: ["1.51.1", "1.60.0", "1.61.0"],
    )
    find = engine_releases.indexed_releases
    newest = find(newest=True, has_candidates=False)
    assert newest == [f"{engine}==1.61.0" for engine in engine_releases.TITLES]
    assert "drake==1.51.1" in find(newest=False, has_candidates=False)
    assert "**1.60.0**: 0" in engine_releases.table()
    after = engine_releases.badges()["drake"]
    assert after["label"] == "Drake 1.60.0"
    count = int(before["drake"]["message"].split()[0])
    assert after["message"] == f"{count - 1} of 5 scenes"


def test_the_workflow_of_releases_runs_commands_of_the_study():
    text = (ROOT / ".github" / "workflows" / "releases.yml").read_text("utf-8")
    steps = yaml.safe_load(text)["jobs"]["measure"]["steps"]
    words = [step["run"].split() for step in steps if "studies" in step.get("run", "")]
    run = [line[2:] for line in words if line[0] == "python"]
    assert [line[0] for line in run] == ["studies.what_changed.what_changed"] * 2
    assert [line[1] for line in run] == ["checks", "engines"]
    assert set(what_changed.COMMANDS) >= {"checks", "engines"}


def test_the_badge_counts_the_checks_of_the_newest_release(monkeypatch):
    rows = what_changed.results()
    newest = list(rows)[-1]
    count = int(what_changed.badge()["message"].split()[0])
    worse = rows | {"99.0.0": rows[newest] | {"pad_depth_mm": "0.5"}}
    monkeypatch.setattr(what_changed, "results", lambda: worse)
    found = what_changed.badge()
    assert found["label"] == "MuJoCo 99.0.0"
    assert (found["message"], found["color"]) == (f"{count - 1} of 11 checks", "orange")


def test_a_candidate_is_before_its_release():
    versions = ["4.10.0", "4.1.0", "2.3.1.post1", "4.1.0rc1", "2.3.1"]
    assert sorted(versions, key=environments.version_key) == [
        *("2.3.1", "2.3.1.post1", "4.1.0rc1", "4.1.0", "4.10.0")
    ]
    assert environments.version_key("3.1.6") < environments.NUMPY_2_SINCE
    assert environments.version_key("3.2.0") > environments.NUMPY_2_SINCE


def test_the_checks_give_their_stored_numbers_here():
    """The numbers of the installed release, which `checks.csv` has with six digits."""
    stored = what_changed.results().get(mujoco.__version__)
    if stored is None:
        pytest.skip(f"no checks of MuJoCo {mujoco.__version__} are stored")
    names = set(checks.CHECKS) - {"mesh_tilt_deg", "grip_slip_mm"}
    for name in sorted(names):
        assert checks.CHECKS[name]() == pytest.approx(
            float(stored[name]), rel=0.02, abs=1e-3
        )


def test_a_move_is_a_change_of_the_number_and_no_rounding():
    assert engine_releases.is_same("1.0", "1.01", 0.0)
    assert not engine_releases.is_same("0.5", "1", 0.0)
    assert engine_releases.is_same("1e-9", "3e-7", 0.05)
    assert not engine_releases.is_same("XML Error", "1", 0.0)
