"""The table of popular configurations: its data, its page, and the script that writes both."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity import configuration
from scripts import build_popular_configurations as script
from scripts.generated import stale_files


def test_a_changed_value_makes_the_page_stale(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = script.stored()
    row = next(one for one in data["rows"] if "creep-wood" in one["values"])
    row["values"]["creep-wood"] += 1.0
    changed = tmp_path / "data.json"
    changed.write_text(json.dumps(data), encoding="utf-8")
    monkeypatch.setattr(script, "DATA", changed)
    assert stale_files(script.contents()) == [script.PAGE]


def test_ranges_of_a_package_leave_out_what_is_held() -> None:
    real, name = script.real_value("slide-wood"), "slide-wood"
    rows = [{"values": {name: value}} for value in (real, 0.0, None)]
    assert script.share_range(rows, name) == "100 %, 1 held, 1 fails"
    assert (
        script.value_range([{"values": {"x": 1.25}}, {"values": {"x": -0.04}}], "x", 1)
        == "0.0 to 1.2"
    )
    assert script.value_range([{"values": {}}], "x", 1) == ""


def test_all_packages_are_in_the_data_with_their_versions() -> None:
    rows = json.loads(script.DATA.read_text(encoding="utf-8"))["rows"]
    assert {row["package"] for row in rows} == set(script.PACKAGES)
    assert all(row["version"] and row["engine_version"] for row in rows)


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
    script.measure_package("Gymnasium", data, tmp_path / "data.json")
    (row,) = json.loads((tmp_path / "data.json").read_text(encoding="utf-8"))["rows"]
    assert row["targets"] == ["Reacher-v5", "Swimmer-v5"]
    monkeypatch.setattr(script, "check", lambda *_, **__: pytest.fail("measured again"))
    script.measure_package("Gymnasium", data, tmp_path / "data.json")


@pytest.mark.parametrize(
    "package", [script.Package("absent", lambda: ["x"]), script.Package("absent")]
)
def test_package_that_is_not_here_keeps_its_rows(
    package: script.Package,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(script, "PACKAGES", {"Absent": package})
    data: dict[str, Any] = {"rows": [{"package": "Absent"}], "unreadable": {}}
    script.measure_package("Absent", data, tmp_path / "data.json", tmp_path)
    assert data["rows"] == [{"package": "Absent"}]
    assert "not here" in capsys.readouterr().out


def test_tasks_of_other_packages_are_read_from_probe_files(tmp_path: Path) -> None:
    (tmp_path / "playground").mkdir()
    file = tmp_path / "playground" / f"Walk{script.SUFFIX}"
    file.write_text(json.dumps({"versions": {"playground": "0.2.0"}}), encoding="utf-8")
    assert script.targets_of(script.PACKAGES["MuJoCo Playground"], tmp_path) == (
        "0.2.0",
        [str(file)],
    )
    assert script.shown_name(str(file)) == "Walk"


@pytest.mark.parametrize(
    ("acceleration", "text"),
    [(None, "fails"), (0.05, "held"), (script.real_value("slide-wood"), "100 %")],
)
def test_friction_is_shown_as_a_share(acceleration: float | None, text: str) -> None:
    row = {"values": {"slide-wood": acceleration}}
    assert script.met(row, "slide-wood") == text


@pytest.mark.parametrize(
    ("geoms", "text"),
    [
        ("", ""),
        ("floor, wall and 2 more with ball", " (ball)"),
        ("floor with head, torso and 3 more", " (head)"),
    ],
)
def test_deciding_geom_is_named(geoms: str, text: str) -> None:
    assert script.deciding({"geoms": {"slide-wood": geoms} if geoms else {}}) == text


def test_numbers_have_no_negative_zero() -> None:
    assert [script.number(value, 1) for value in (-0.04, -0.06, None)] == [
        "0.0",
        "-0.1",
        "fails",
    ]


def test_cure_is_shown_by_its_first_change() -> None:
    line = '<option cone="elliptic"/>: 1 of 2 flags go; with <option impratio="10"/> too: 2 of 2 (from this preset)'
    assert script.cure(line) == '`<option cone="elliptic"/>`: 1 of 2 flags go'
    assert script.cure("") == ""
