"""The table of popular configurations: its data, its page, and the script that writes both."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import build_popular_configurations as script
import pytest

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity import configuration


def test_check_finds_a_page_that_is_not_current(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = json.loads(script.DATA.read_text(encoding="utf-8"))
    row = next(one for one in data["rows"] if "creep-wood" in one["values"])
    row["values"]["creep-wood"] += 1.0
    changed = tmp_path / "data.json"
    changed.write_text(json.dumps(data), encoding="utf-8")
    assert script.main(["--check", "--data", str(changed)]) == 1
    assert "not current" in capsys.readouterr().err


def test_share_of_friction_is_one_for_the_real_cube_and_largest_for_one_that_is_held() -> (
    None
):
    real = script.real_value("slide-turned")
    friction = math.tan(math.radians(30.0)) - real / (
        GRAVITY_M_PER_S2 * math.cos(math.radians(30.0))
    )
    assert script.share_of_friction("slide-turned", real) == pytest.approx(1.0)
    assert script.share_of_friction("slide-turned", 0.0) == pytest.approx(
        math.tan(math.radians(30.0)) / friction
    )
    assert script.share_of_friction("slide-turned", None) is None


def test_equal_settings_share_a_row() -> None:
    by_key, read, unreadable = script.groups_of(
        ["Reacher-v5", "Walker2d-v5", "Swimmer-v5", "NoSuchEnv-v5"]
    )
    assert list(by_key.values()) == [["Reacher-v5", "Swimmer-v5"], ["Walker2d-v5"]]
    assert len(read) == 2
    assert list(unreadable) == ["NoSuchEnv-v5"]


def test_feet_that_differ_have_rows_of_their_own() -> None:
    by_key, *_ = script.groups_of(["Humanoid-v5", "HumanoidStandup-v5"])
    assert list(by_key.values()) == [["Humanoid-v5"], ["HumanoidStandup-v5"]]


def test_friction_of_a_target_is_that_of_the_geoms_that_decide() -> None:
    read = configuration("HalfCheetah-v5")
    assert script.friction_of(read) == 0.4
    assert script.friction_of(read, read.contact_groups[0].geoms) == 0.4


def test_rows_that_are_known_are_not_measured_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = script.Package("gymnasium", lambda: ["Reacher-v5", "Swimmer-v5"])
    monkeypatch.setattr(script, "PACKAGES", {"Gymnasium": package})
    data: dict[str, Any] = {"rows": [], "unreadable": {}}
    script.measure("Gymnasium", data, tmp_path / "data.json")
    (row,) = json.loads((tmp_path / "data.json").read_text(encoding="utf-8"))["rows"]
    assert row["targets"] == ["Reacher-v5", "Swimmer-v5"]
    monkeypatch.setattr(script, "check", lambda *_, **__: pytest.fail("measured again"))
    script.measure("Gymnasium", data, tmp_path / "data.json")


def test_tasks_of_other_packages_are_read_from_probe_files(tmp_path: Path) -> None:
    (tmp_path / "playground").mkdir()
    file = tmp_path / "playground" / f"Walk{script.SUFFIX}"
    file.write_text(json.dumps({"versions": {"playground": "0.2.0"}}), encoding="utf-8")
    assert script.targets_of(script.PACKAGES["MuJoCo Playground"], tmp_path) == (
        "0.2.0",
        [str(file)],
    )
    assert script.shown_name(str(file)) == "Walk"
