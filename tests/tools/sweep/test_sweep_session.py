"""Sweeps in a folder: results, resuming, failures, the store, and the lock."""

from __future__ import annotations

import json
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from sweep_lanes import HereLane, contents, needs_rapier, plain, stored

from gauge_envs.errors import GaugeError, ResultFileError
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.tools.sweep.lanes import LaneLostError, Limits, WorkerLane
from gauge_envs.tools.sweep.plan import SweepPlan, plan_sweep
from gauge_envs.tools.sweep.session import SweepSession
from gauge_envs.tools.sweep.spec import sweep_spec
from gauge_envs.tools.sweep.store import SweepFolder

WOOD, PLASTIC, METAL = "SlopeSlider-2-wood", "SlopeSlider-2-plastic", "SlopeSlider-2-metal"
QUICK = {"timestep_s": [1 / 360, 1 / 720]}


def planned(**values: Any) -> SweepPlan:
    return plan_sweep(sweep_spec({"variants": [WOOD], "repeats": 2, "settings": QUICK} | values))


def swept(plan: SweepPlan, folder: Path, *used: Any, **options: Any) -> list[Result]:
    with SweepSession(plan, folder, **options) as session:
        return list(session.run(used or [HereLane()]))


# --- results ---


@needs_rapier
def test_results_are_those_of_gauge_run_bit_for_bit(tmp_path: Path) -> None:
    results = swept(planned(backends=["mujoco", "rapier"]), tmp_path, HereLane(), HereLane())
    requests = [
        RunRequest(WOOD, backend=engine, settings={"timestep_s": step}, repeats=2)
        for engine in ("mujoco", "rapier")
        for step in QUICK["timestep_s"]
    ]
    assert sorted(map(plain, results)) == sorted(map(plain, run_many(requests)))
    assert sorted(contents(tmp_path).values()) == sorted(map(plain, results))


@pytest.mark.slow
def test_worker_processes_give_the_same_bits(tmp_path: Path) -> None:
    plan = planned(settings={"timestep_s": [1 / 360]})
    swept(plan, tmp_path / "here")
    swept(plan, tmp_path / "there", WorkerLane(Limits()), WorkerLane(Limits()))
    assert contents(tmp_path / "here") == contents(tmp_path / "there") != {}


# --- resuming ---


def test_nothing_runs_twice(tmp_path: Path) -> None:
    plan = planned()
    lane = HereLane()
    with SweepSession(plan, tmp_path) as session, closing(session.run([lane])) as results:
        next(results)
    kept = contents(tmp_path)
    assert 1 <= len(kept) < 4
    times = {file.name: file.stat().st_mtime_ns for file in tmp_path.glob("*.json")}
    again = HereLane()
    with SweepSession(plan, tmp_path) as session:
        assert session.earlier == {("mujoco", Outcome.FINISHED): len(kept)}
        assert len(list(session.run([again]))) == len(again.requests) == 4 - len(kept)
    assert len(contents(tmp_path)) == 4
    assert times.items() <= {file.name: file.stat().st_mtime_ns for file in tmp_path.glob("*.json")}.items()
    assert swept(plan, tmp_path) == []


def test_a_longer_sweep_takes_what_is_there(tmp_path: Path) -> None:
    steps = {"timestep_s": [1 / 360]}
    swept(planned(settings=steps), tmp_path)
    lane = HereLane()
    swept(planned(variants=[WOOD, METAL], repeats=3, settings=steps), tmp_path, lane)
    assert len(lane.requests) == 6 - 2


def test_a_damaged_result_is_moved_aside_and_runs_again(tmp_path: Path) -> None:
    plan = planned()
    swept(plan, tmp_path)
    file = min(tmp_path.glob("*.json"))
    file.write_text(file.read_text()[:1000])
    notes: list[str] = []
    assert len(swept(plan, tmp_path, notify=notes.append)) == 1
    assert len(notes) == 1 and file.name in notes[0] and "moved to" in notes[0]
    assert len(contents(tmp_path)) == 4


def test_the_version_of_another_machine_is_a_failure(tmp_path: Path) -> None:
    class OldLane(HereLane):
        def run(self, request: RunRequest) -> list[Result]:
            results = super().run(request)
            for result in results:
                result.versions["mujoco"] = "1.0"
            return results

    (result,) = swept(planned(variants=[WOOD], repeats=1, settings={}), tmp_path, OldLane())
    assert result.outcome is Outcome.FAILED and "made with mujoco 1.0, planned with" in str(result.error)


# --- failures ---


def test_a_worker_that_dies_costs_its_episode(installed: Callable[..., None], tmp_path: Path) -> None:
    installed("crash")
    plan = planned(backends=["crash"], variants=[WOOD, PLASTIC], repeats=1, settings={"timestep_s": [1 / 360]})
    folder = tmp_path / "out"
    results = swept(plan, folder, WorkerLane(Limits()))
    assert sorted(result.outcome.value for result in results) == ["failed", "finished"]
    failed = [json.loads(file.read_text()) for file in (folder / "failed").glob("*.json")]
    assert {one["id"] for one in failed} == {f"GAUGE/{PLASTIC}"}
    assert all("died with signal 11 (segmentation fault)" in one["error"] for one in failed)
    rows = stored(folder, "SELECT outcome, count(*) FROM results GROUP BY outcome ORDER BY outcome")
    assert rows == [("failed", 1), ("finished", 1)]
    lane = HereLane()
    assert swept(plan, folder, lane) == [] == lane.requests


class Mortal:
    """A worker process that dies where one of some seeds runs."""

    def __init__(self, *seeds: int) -> None:
        self._seeds = set(seeds)

    def call(self, function: Any, request: RunRequest) -> list[Result]:
        if self._seeds & set(range(request.seed, request.seed + request.repeats)):
            raise GaugeError("died")
        return function(request)

    def close(self) -> None:
        pass


def mortal_lane(*seeds: int) -> WorkerLane:
    lane = WorkerLane(Limits())
    lane._worker = Mortal(*seeds)  # type: ignore[assignment]
    return lane


def test_failures_run_again_on_request(tmp_path: Path) -> None:
    plan = planned(variants=[WOOD], repeats=1, settings={"timestep_s": [1 / 360]})
    (result,) = swept(plan, tmp_path, mortal_lane(0))
    assert result.error == "died" and len(list((tmp_path / "failed").glob("*.json"))) == 1
    assert swept(plan, tmp_path) == []
    (result,) = swept(plan, tmp_path, retry_failed=True)
    assert result.outcome is Outcome.FINISHED
    assert list((tmp_path / "failed").glob("*.json")) == []
    assert stored(tmp_path, "SELECT outcome FROM results") == [("finished",)]


@needs_rapier
def test_worlds_that_die_together_run_one_by_one(tmp_path: Path) -> None:
    plan = planned(backends=["rapier"], variants=[WOOD], repeats=3, settings={"timestep_s": [1 / 360]})
    results = swept(plan, tmp_path, mortal_lane(1))
    assert [result.outcome.value for result in results] == ["finished", "failed", "finished"]


def test_a_lane_that_is_closed_while_it_runs_calls_nothing_a_failure() -> None:
    lane = mortal_lane(0)
    lane.close()
    with pytest.raises(LaneLostError, match="closed"):
        lane.run(RunRequest(WOOD, repeats=4))


def test_a_lost_lane_costs_nothing(tmp_path: Path) -> None:
    class Lossy(HereLane):
        losses = 0

        def run(self, request: RunRequest) -> list[Result]:
            if self.losses < 2:
                self.losses += 1
                raise LaneLostError("the machine is gone")
            return super().run(request)

    plan = planned()
    swept(plan, tmp_path / "whole")
    swept(plan, tmp_path / "lossy", Lossy())
    assert contents(tmp_path / "whole") == contents(tmp_path / "lossy")


def test_a_task_that_always_loses_its_lane_fails(tmp_path: Path) -> None:
    class Lost(HereLane):
        def run(self, request: RunRequest) -> list[Result]:
            raise LaneLostError("the machine is gone")

    results = swept(planned(), tmp_path, Lost(), Lost())
    assert len(results) == 4
    assert {str(result.error) for result in results} == {"the machine is gone, 3 times"}


@needs_rapier
def test_what_a_declined_scene_leaves(tmp_path: Path) -> None:
    (result,) = swept(planned(backends=["rapier"], variants=["FoamBending-soft"], repeats=1, settings={}), tmp_path)
    assert result.outcome is Outcome.DECLINED
    assert len(list((tmp_path / "declined").glob("*.json"))) == 1


def test_an_error_of_a_lane_ends_the_sweep(tmp_path: Path) -> None:
    class Broken(HereLane):
        def run(self, request: RunRequest) -> list[Result]:
            raise ZeroDivisionError("a mistake in the program")

    with pytest.raises(ZeroDivisionError, match="a mistake"):
        swept(planned(), tmp_path, Broken(), HereLane())


# --- the store ---


def test_the_store_has_a_row_for_each_file(tmp_path: Path) -> None:
    results = swept(planned(), tmp_path)
    rows = stored(
        tmp_path, "SELECT file, score, wall_s, timestep_s, rmse, json_extract(settings, '$.iterations') FROM results"
    )
    assert {row[0] for row in rows} == set(contents(tmp_path))
    assert sorted(row[1:5] for row in rows) == sorted(
        (one.score.primary_normalized, one.wall_s, one.settings["timestep_s"], one.score.rmse) for one in results
    )
    assert {row[5] for row in rows} == {results[0].settings["iterations"]}


@pytest.mark.parametrize("damage", [b"no database", b"SQLite format 3\x00" + b"\x07" * 5000, b""])
def test_a_damaged_store_is_made_again_from_the_files(tmp_path: Path, damage: bytes) -> None:
    swept(planned(), tmp_path)
    everything = stored(tmp_path, "SELECT * FROM results ORDER BY file")
    SweepFolder(tmp_path).store_path.write_bytes(damage)
    notes: list[str] = []
    assert stored(tmp_path, "SELECT * FROM results ORDER BY file", notes.append) == everything
    if damage:
        assert "made again from the result files" in notes[0]
        assert (tmp_path / "sweep.sqlite.damaged").read_bytes() == damage


def test_a_store_with_damaged_pages_is_made_again(tmp_path: Path) -> None:
    swept(planned(repeats=4), tmp_path)
    everything = stored(tmp_path, "SELECT * FROM results ORDER BY file")
    path = SweepFolder(tmp_path).store_path
    content = bytearray(path.read_bytes())
    content[8192:12288] = b"\xff" * 4096
    path.write_bytes(content)
    notes: list[str] = []
    assert stored(tmp_path, "SELECT * FROM results ORDER BY file", notes.append) == everything
    assert "the store is damaged" in notes[0]


def test_a_store_of_another_version_is_made_again(tmp_path: Path) -> None:
    swept(planned(), tmp_path)
    with closing(sqlite3.connect(SweepFolder(tmp_path).store_path)) as connection:
        connection.execute("ALTER TABLE results ADD COLUMN other TEXT")
    notes: list[str] = []
    assert stored(tmp_path, "SELECT count(*) FROM results", notes.append) == [(4,)]
    assert "columns of another version" in notes[0]


def test_rows_follow_the_files(tmp_path: Path) -> None:
    swept(planned(), tmp_path)
    min(tmp_path.glob("*.json")).unlink()
    list(run_many([RunRequest(METAL)], out=tmp_path))
    rows = stored(tmp_path, "SELECT id, count(key), count(*) FROM results GROUP BY id ORDER BY id")
    assert rows == [(f"GAUGE/{METAL}", 0, 1), (f"GAUGE/{WOOD}", 3, 3)]


def test_a_folder_without_results_is_named(tmp_path: Path) -> None:
    with pytest.raises(ResultFileError, match="no result files there"):
        stored(tmp_path, "SELECT 1")


# --- the lock ---

HOLD = """
import fcntl, sys
with open(sys.argv[1] + "/.sweep.lock", "a") as stream:
    fcntl.flock(stream, fcntl.LOCK_SH if sys.argv[2] == "shared" else fcntl.LOCK_EX)
    print("held", flush=True)
    sys.stdin.read()
"""
"""A sweep in another process, as far as its lock goes."""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no shared lock")
@pytest.mark.parametrize("kind", ["whole", "shared"])
def test_two_sweeps_never_share_a_folder_and_parts_do(tmp_path: Path, kind: str) -> None:
    plan = planned(variants=[WOOD], repeats=1, settings={"timestep_s": [1 / 360]})
    swept(plan, tmp_path)
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path), kind], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None and other.stdout.readline() == b"held\n"
        with pytest.raises(ResultFileError, match="another sweep writes there"):
            swept(plan, tmp_path)
        if kind == "shared":
            assert swept(plan, tmp_path, is_part=True) == []
        assert stored(tmp_path, "SELECT count(*) FROM results") == [(1,)]
        other.kill()
    assert swept(plan, tmp_path) == []


def test_a_part_writes_files_alone(tmp_path: Path) -> None:
    assert len(swept(planned(), tmp_path, is_part=True)) == 4
    assert not SweepFolder(tmp_path).store_path.exists()
    assert stored(tmp_path, "SELECT count(*) FROM results") == [(4,)]
