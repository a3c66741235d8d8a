"""Judging recorded motion: the numbers of the check itself, planted faults of a user's loop, and damaged files."""

from __future__ import annotations

import csv
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import ROOT
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.errors import TargetError, TrajectoryFileError
from gauge_envs.tools.sanity import Report, Verdict, check, export, judge, run_exported
from gauge_envs.tools.sanity.exchange.scenes import COLUMNS, MANIFEST

RUNNER = CliRunner()
EXAMPLES = ROOT / "examples" / "sanity_export"

QUICK = ("gravity", "creep-wood", "rest-height", "slide-wood", "slide-turned", "rebound", "seam", "point")
"""Rows whose scenes run in a second."""


def example(name: str) -> Any:
    """Return a program of the examples as a module."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


World = example("run_mujoco").World


def simulated(folder: Path, world: type[Any], *only: str) -> Report:
    export(folder, only=only)
    run_exported(folder, world)
    return judge(folder, only=only)


def values(report: Report) -> dict[str, float | None]:
    return {row.phenomenon: row.configured for row in report.rows}


def verdicts(report: Report) -> dict[str, Verdict]:
    return {row.phenomenon: row.verdict for row in report.rows}


# --- truth -----------------------------------------------------------------------------------------------------------


def test_plain_mujoco_gives_the_numbers_of_the_check(tmp_path: Path) -> None:
    judged = simulated(tmp_path / "engine", World, *QUICK)
    checked = check("mujoco", only=QUICK)
    for row, other in zip(judged.rows, checked.rows, strict=True):
        if row.phenomenon != "gravity":
            assert row.configured == pytest.approx(other.configured, rel=1e-9, abs=1e-12), row.phenomenon
            assert (row.verdict, row.reality) == (other.verdict, other.reality)
    assert values(judged)["gravity"] == pytest.approx(9.80665, abs=1e-6)
    assert judged.worst is Verdict.INSIDE


@pytest.mark.slow
def test_every_row_of_plain_mujoco_is_that_of_the_check(tmp_path: Path) -> None:
    judged = simulated(tmp_path / "engine", World)
    checked = check("mujoco")
    # In files a body starts where it touches: a release has no scene of its own.
    others = [row for row in checked.rows if row.applies and row.phenomenon != "release"]
    assert [row.phenomenon for row in judged.rows[1:]] == [row.phenomenon for row in others]
    for row, other in zip(judged.rows[1:], others, strict=True):
        assert row.configured == pytest.approx(other.configured, rel=1e-9, abs=1e-12), row.phenomenon
        assert row.verdict is other.verdict


def test_a_driven_scene_gives_the_numbers_of_the_check(tmp_path: Path) -> None:
    judged = simulated(tmp_path / "engine", World, "carry-wood")
    checked = check("mujoco", only=["carry-wood"])
    assert values(judged)["carry-wood"] == pytest.approx(values(checked)["carry-wood"], rel=1e-9)
    assert not any("off its driver" in note for note in judged.configuration.notes)


def test_velocities_may_be_left_out(tmp_path: Path) -> None:
    folder = tmp_path / "engine"
    whole = simulated(folder, World, "gravity", "rebound")
    change(folder / "drop" / "motion.csv", lambda rows: [row[:9] for row in rows])
    assert values(judge(folder))["rebound"] == pytest.approx(values(whole)["rebound"], rel=1e-3)


INSIDE_ON_PYBULLET = ("gravity", "creep-wood", "rest-height", "slide-wood", "carry-metal", "slip")


@pytest.mark.parametrize(
    "inside",
    [
        INSIDE_ON_PYBULLET,
        pytest.param((*INSIDE_ON_PYBULLET, "period", "energy"), marks=pytest.mark.slow, id="with a hinge"),
    ],
)
def test_pybullet_runs_the_urdf_files_without_this_package(inside: tuple[str, ...], tmp_path: Path) -> None:
    pytest.importorskip("pybullet")
    folder = tmp_path / "engine"
    only = () if "period" in inside else (*inside, "rebound")
    export(folder, only=only)
    program = (
        "import runpy, sys; sys.modules['gauge_envs'] = None; "
        f"sys.argv = ['run_pybullet.py', {str(folder)!r}]; "
        f"runpy.run_path({str(EXAMPLES / 'run_pybullet.py')!r}, run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False, env=dict(os.environ))
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    report = judge(folder, engine="PyBullet 3", only=only)
    found = verdicts(report)
    assert Verdict.DECLINED not in found.values()
    for name in inside:
        assert found[name] is Verdict.INSIDE, name
    # Bullet steps at 4 ms and has no rolling row of balls.
    assert values(report)["slide-wood"] == pytest.approx(2.72, rel=0.02)
    assert values(report)["rebound"] == pytest.approx(0.8, abs=0.05)
    assert not any("off its driver" in note for note in report.configuration.notes)


# --- planted faults of a user's loop ---------------------------------------------------------------------------------


def test_a_wrong_gravity_is_found(tmp_path: Path) -> None:
    class Moon(World):
        def __init__(self, folder: Path, scene: dict[str, Any]) -> None:
            super().__init__(folder, scene)
            self.model.opt.gravity[2] = -1.62

    report = simulated(tmp_path / "engine", Moon, "gravity", "slide-wood", "rebound")
    gravity = report.rows[0]
    assert gravity.verdict is Verdict.WRONG and gravity.configured == pytest.approx(1.62, abs=1e-6)
    assert gravity.cause is not None and "instead of" in gravity.cause.line and "-1.62" in gravity.cause.line
    assert verdicts(report)["slide-wood"] is Verdict.WRONG


def test_a_tilted_gravity_is_found(tmp_path: Path) -> None:
    class Tilted(World):
        def __init__(self, folder: Path, scene: dict[str, Any]) -> None:
            super().__init__(folder, scene)
            self.model.opt.gravity[:] = 9.80665 * np.array([np.sin(0.05), 0.0, -np.cos(0.05)])

    gravity = simulated(tmp_path / "engine", Tilted, "gravity", "rebound").rows[0]
    assert gravity.verdict is Verdict.WRONG and "tilted by 2.9 degrees" in gravity.remark


def test_another_order_of_the_quaternion_is_named(tmp_path: Path) -> None:
    class Xyzw(World):
        def state(self, name: str) -> list[float]:
            x, y, z, w, i, j, k, *speed = super().state(name)
            return [x, y, z, i, j, k, w, *speed]

    export(tmp_path / "engine", only=["creep-wood", "rebound"])
    run_exported(tmp_path / "engine", Xyzw)
    for only in ("creep-wood", "rebound"):
        with pytest.raises(TrajectoryFileError, match="seems to have x, y, z, w; write w first"):
            judge(tmp_path / "engine", only=[only])


def test_halved_friction_is_found_with_its_coefficient(tmp_path: Path) -> None:
    class Slippery(World):
        def __init__(self, folder: Path, scene: dict[str, Any]) -> None:
            super().__init__(folder, scene)
            self.model.pair_friction[:, :2] *= 0.5

    report = simulated(tmp_path / "engine", Slippery, "creep-wood", "slide-*")
    assert set(verdicts(report).values()) == {Verdict.WRONG}
    (slide,) = [row for row in report.rows if row.phenomenon == "slide-wood"]
    assert slide.remark == "as with a friction of 0.129, stated is 0.257"


def test_a_step_of_20_ms_is_found(tmp_path: Path) -> None:
    class Coarse(World):
        def __init__(self, folder: Path, scene: dict[str, Any]) -> None:
            super().__init__(folder, scene)
            self.model.opt.timestep = 0.02

    names = ("creep-wood", "slide-wood", "rebound", "seam", "point")
    report = simulated(tmp_path / "engine", Coarse, *names)
    checked = check(settings_of(0.02), only=names)
    flagged = {row.phenomenon for row in report.rows if row.is_flag}
    assert {"rebound", "point"} <= flagged
    assert {row.phenomenon for row in checked.rows if row.is_flag} & flagged
    assert report.configuration.settings == {"sample_interval_s": 0.02}
    assert any("farther apart than asked for" in note for note in report.configuration.notes)


def settings_of(step_s: float) -> Any:
    from gauge_envs.tools.sanity import TrainingConfiguration

    return TrainingConfiguration(name="coarse", source="test", backend="mujoco", settings={"timestep_s": step_s})


def test_a_turntable_that_stands_still_is_reported(tmp_path: Path) -> None:
    class Parked(World):
        def drive(self, name: str, numbers: list[float]) -> None:
            super().drive(name, [*self.state(name)[:7], *[0.0] * 12])

    report = simulated(tmp_path / "engine", Parked, "slip")
    assert any(
        "driven body 'plate' is up to" in note and "off its driver" in note for note in report.configuration.notes
    )


# --- files -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with one scene whose cube rests."""
    folder = tmp_path_factory.mktemp("judge") / "engine"
    export(folder, only=["creep-wood"])
    (scene,) = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))["scenes"]
    cube = next(body for body in scene["bodies"] if body["name"] == "cube")
    start = [*cube["position_m"], *cube["quaternion_wxyz"], 0.0, 0.0, 0.0]
    with (folder / "hold-wood" / "motion.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([COLUMNS, *([0.002 * index, "cube", *start] for index in range(501))])
    return folder


@pytest.fixture
def resting(template: Path, tmp_path: Path) -> Path:
    """Copy of that folder."""
    return Path(shutil.copytree(template, tmp_path / "engine"))


def change(motion: Path, function: Callable[[list[list[str]]], list[list[str]]]) -> None:
    """Change the rows of a motion file, the header among them."""
    with motion.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    with motion.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(function(rows))


def with_field(row: int, column: int, text: str) -> Callable[[list[list[str]]], list[list[str]]]:
    def changed(rows: list[list[str]]) -> list[list[str]]:
        rows[row][column] = text
        return rows

    return changed


def test_a_cube_at_rest_is_inside(resting: Path) -> None:
    report = judge(resting, engine="Still 1.0")
    assert verdicts(report) == {
        "gravity": Verdict.DECLINED,
        "creep-wood": Verdict.INSIDE,
        "rest-height": Verdict.INSIDE,
    }
    assert values(report)["creep-wood"] == pytest.approx(0.0, abs=1e-12)
    assert report.rows[0].remark == "measured in the fall of the balls of the scene 'drop': was not exported"
    assert (report.configuration.name, report.configuration.backend) == ("Still 1.0", "Still 1.0")


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        pytest.param(lambda rows: rows[:1], "has no rows", id="no-rows"),
        pytest.param(lambda rows: [], "has no rows", id="empty"),
        pytest.param(lambda rows: rows[:300], "samples end at 0.596 s; 1 s are needed", id="short"),
        pytest.param(lambda rows: rows[:3], "2 samples; 1 s are needed", id="two-samples"),
        pytest.param(lambda rows: [rows[0], *rows[1::25]], "one sample in 0.05 s is too few", id="rate"),
        pytest.param(lambda rows: rows[:200] + rows[201:], "sample 1.* write a sample every step", id="gap"),
        pytest.param(lambda rows: [rows[0], *rows[2:]], "the first sample is at 0.002 s, expected 0", id="no-start"),
        pytest.param(lambda rows: [rows[0], *rows[:0:-1]], "the first sample is at 1 s", id="backwards"),
        pytest.param(with_field(7, 0, "nan"), "sample 6: time_s is nan", id="nan-time"),
        pytest.param(with_field(7, 2, "1,5"), "line 8: x_m is '1,5', expected a number", id="comma"),
        pytest.param(with_field(7, 2, ""), "line 8: x_m is '', expected a number", id="no-number"),
        pytest.param(
            with_field(7, 1, "Cube"), "line 8: 'Cube' is no recorded body of this scene: it has cube", id="body"
        ),
        pytest.param(
            lambda rows: [*rows[:5], rows[5][:9], *rows[6:]], "line 6: 9 columns, the header has 12", id="columns"
        ),
        pytest.param(with_field(0, 3, "y"), "line 1: unknown column 'y'; expected the header time_s,body", id="header"),
        pytest.param(with_field(0, 3, "x_m"), "line 1: column 'x_m' appears twice", id="twice"),
        pytest.param(lambda rows: [row[:8] for row in rows], "no column 'qz'", id="no-qz"),
        pytest.param(lambda rows: [row[:11] for row in rows], "no column 'vz_m_per_s'", id="no-vz"),
        pytest.param(with_field(1, 2, "1000"), "'cube' starts at .* write the start before the first step", id="start"),
        pytest.param(
            lambda rows: [*rows[:7], [*rows[7][:5], *"0000", *rows[7][9:]], *rows[8:]],
            "a quaternion of 'cube' has no length at 0.012 s",
            id="no-length",
        ),
        pytest.param(with_field(1, 5, "3"), "the first quaternion of 'cube' has the length 3", id="length"),
    ],
)
def test_a_damaged_file_is_an_error_that_says_where(
    resting: Path, fault: Callable[[list[list[str]]], list[list[str]]], message: str
) -> None:
    change(resting / "hold-wood" / "motion.csv", fault)
    with pytest.raises(TrajectoryFileError, match=message) as caught:
        judge(resting)
    assert "hold-wood/motion.csv" in str(caught.value)


@pytest.mark.parametrize("content", [b"\xff\xfe\x00\x01", b"time_s,body\n\x00\x00", b'"' * 200_000, b"," * 300_000])
def test_a_hostile_file_is_an_error(resting: Path, content: bytes) -> None:
    (resting / "hold-wood" / "motion.csv").write_bytes(content)
    with pytest.raises(TrajectoryFileError, match=r"motion\.csv"):
        judge(resting)


def test_a_link_to_a_device_or_a_folder_is_an_error(resting: Path) -> None:
    motion = resting / "hold-wood" / "motion.csv"
    motion.unlink()
    motion.mkdir()
    with pytest.raises(TrajectoryFileError, match="cannot be read"):
        judge(resting)


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e300"])
def test_a_number_that_is_not_finite_is_a_diverged_row(resting: Path, text: str) -> None:
    change(resting / "hold-wood" / "motion.csv", with_field(200, 4, text))
    report = judge(resting)
    row = report.rows[1]
    assert row.verdict is Verdict.WRONG and row.configured is None
    assert row.remark.startswith("diverged: hold-wood/motion.csv: z_m of 'cube' is") and "0.398 s" in row.remark


def test_a_body_that_flies_away_is_a_diverged_row(resting: Path) -> None:
    change(resting / "hold-wood" / "motion.csv", with_field(200, 4, "5.0"))
    row = judge(resting).rows[1]
    assert row.verdict is Verdict.WRONG and "'cube' moves at" in row.remark


def test_columns_may_have_another_order(resting: Path) -> None:
    change(resting / "hold-wood" / "motion.csv", lambda rows: [[*row[5:9], row[1], *row[2:5], row[0]] for row in rows])
    assert judge(resting).rows[1].verdict is Verdict.INSIDE


def test_a_body_with_fewer_samples_is_an_error(tmp_path: Path) -> None:
    export(tmp_path / "engine", only=["rebound"])
    run_exported(tmp_path / "engine", World)
    motion = tmp_path / "engine" / "drop" / "motion.csv"
    change(motion, lambda rows: rows[:-1])
    with pytest.raises(TrajectoryFileError, match="body 'ball-4' has"):
        judge(tmp_path / "engine")


def test_a_missing_file_is_a_declined_row_that_says_so(resting: Path) -> None:
    export(resting, only=["creep-*"])
    report = judge(resting)
    assert verdicts(report)["creep-wood"] is Verdict.INSIDE
    row = next(one for one in report.rows if one.phenomenon == "creep-metal")
    assert (row.verdict, row.remark) == (Verdict.DECLINED, "hold-metal/motion.csv is missing")
    assert any("2 of 3 scenes have no motion.csv" in note for note in report.configuration.notes)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / MANIFEST).unlink(), "cannot be read: No such file"),
        (lambda folder: (folder / MANIFEST).write_text("{", encoding="utf-8"), "export again"),
        (lambda folder: (folder / MANIFEST).write_text("[]", encoding="utf-8"), "is no manifest"),
        (lambda folder: edit(folder, lambda m: m.update(version=2)), "has version 2, expected 1"),
        (lambda folder: edit(folder, lambda m: m.update(scenes=[])), "lists no scenes"),
        (lambda folder: edit(folder, lambda m: m.update(scenes=[1, {"name": []}])), "lists no scenes"),
        (lambda folder: edit(folder, lambda m: m["scenes"][0].update(name="x")), "lists no scenes, or unknown ones"),
        (lambda folder: edit(folder, lambda m: m["scenes"][0].pop("contacts")), "scene 'hold-wood'"),
        (
            lambda folder: edit(folder, lambda m: m["scenes"][0]["contacts"][0].update(friction=0.9)),
            "contacts.0.friction is not that of this version",
        ),
        (
            lambda folder: edit(folder, lambda m: m["scenes"][0]["contacts"][0].update(friction=10**400)),
            "contacts.0.friction is not that of this version",
        ),
    ],
)
def test_a_manifest_of_another_scene_is_an_error(resting: Path, damage: Callable[[Path], object], message: str) -> None:
    damage(resting)
    with pytest.raises(TargetError, match=message):
        judge(resting)


def edit(folder: Path, change_of: Callable[[Any], object]) -> None:
    content = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    change_of(content)
    (folder / MANIFEST).write_text(json.dumps(content), encoding="utf-8")


# --- command ---------------------------------------------------------------------------------------------------------


def creeping(folder: Path) -> None:
    """Let the cube creep downhill at 60 mm/s."""

    def crept(rows: list[list[str]]) -> list[list[str]]:
        return [rows[0], *([t, name, str(float(x) + 0.06 * float(t)), *rest] for t, name, x, *rest in rows[1:])]

    change(folder / "hold-wood" / "motion.csv", crept)


def test_the_command_judges_like_the_check(resting: Path, tmp_path: Path) -> None:
    command = ["sanity", "judge", str(resting), "--only", "creep-wood"]
    assert RUNNER.invoke(app, [*command, "--fail-on", "visible"]).exit_code == 0
    before = tmp_path / "before.json"
    before.write_text(RUNNER.invoke(app, [*command, "--json"]).stdout, encoding="utf-8")
    creeping(resting)
    done = RUNNER.invoke(app, [*command, "--fail-on", "wrong", "--label", "Soft 2"])
    assert done.exit_code == 1 and "1 flag: creep-wood" in done.output and "Soft 2" in done.output
    assert RUNNER.invoke(app, command).exit_code == 1
    assert RUNNER.invoke(app, [*command, "--fail-on", "never"]).exit_code == 0
    done = RUNNER.invoke(app, [*command, "--baseline", str(before)])
    assert done.exit_code == 1 and "regression: creep-wood: wrong, " in done.output
    markdown = RUNNER.invoke(app, [*command, "--format", "markdown"]).stdout
    assert "| creep-wood |" in markdown
    first, row = map(json.loads, RUNNER.invoke(app, [*command, "--json"]).stdout.splitlines())
    assert first["worst"] == "wrong" and row["configured"] == pytest.approx(60.0, rel=0.05)


def test_the_page_draws_the_motion(resting: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    page = tmp_path / "page.html"
    assert RUNNER.invoke(app, ["sanity", "judge", str(resting), "--out", str(page)]).exit_code == 0
    text = page.read_text(encoding="utf-8")
    assert "displacement downhill [mm]" in text and ">reality<" in text and "<svg" in text


def test_a_folder_without_motion_fails(resting: Path) -> None:
    (resting / "hold-wood" / "motion.csv").unlink()
    done = RUNNER.invoke(app, ["sanity", "judge", str(resting)])
    assert done.exit_code == 3 and "motion.csv is missing" in done.output


def test_a_folder_that_is_no_export_is_a_wrong_request(tmp_path: Path) -> None:
    done = RUNNER.invoke(app, ["sanity", "judge", str(tmp_path)])
    assert done.exit_code == 2 and "gauge sanity export" in done.output
