"""Sweeps in a folder: results, resuming and failures."""

import json
from contextlib import closing

import pytest
from sweep_workers import (
    HereWorker,
    contents,
    mortal_worker,
    needs_rapier,
    outcomes,
    plain,
    swept,
)

from gauge_envs.runs.batch import run_many
from gauge_envs.runs.pool import Limits, ProcessWorker
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.sweep.plan import plan_sweep, remaining_tasks
from gauge_envs.tools.sweep.run import run_sweep
from gauge_envs.tools.sweep.spec import sweep_spec

WOOD, PLASTIC, METAL = (
    "SlopeSlider-2-wood",
    "SlopeSlider-2-plastic",
    "SlopeSlider-2-metal",
)
QUICK = {"timestep_s": [1 / 360, 1 / 720]}


def planned(**values):
    return plan_sweep(
        sweep_spec({"variants": [WOOD], "repeats": 2, "settings": QUICK} | values)
    )


# --- results ---


@needs_rapier
def test_results_are_those_of_gauge_run_bit_for_bit(tmp_path):
    results = swept(
        planned(backends=["mujoco", "rapier"]), tmp_path, HereWorker(), HereWorker()
    )
    requests = [
        RunRequest(WOOD, backend=engine, settings={"timestep_s": step}, repeats=2)
        for engine in ("mujoco", "rapier")
        for step in QUICK["timestep_s"]
    ]
    assert sorted(map(plain, results)) == sorted(map(plain, run_many(requests)))
    assert sorted(contents(tmp_path).values()) == sorted(map(plain, results))


@pytest.mark.slow
def test_worker_processes_give_the_same_bits(tmp_path):
    plan = planned(settings={"timestep_s": [1 / 360]})
    swept(plan, tmp_path / "here")
    swept(plan, tmp_path / "there", ProcessWorker(Limits()), ProcessWorker(Limits()))
    assert contents(tmp_path / "here") == contents(tmp_path / "there") != {}


# --- resuming ---


def test_nothing_runs_twice(tmp_path):
    plan = planned()
    with closing(
        run_sweep(list(remaining_tasks(plan, ())), [HereWorker()], tmp_path)
    ) as finished:
        next(finished)
    kept = contents(tmp_path)
    assert len(kept) == 1
    times = {file.name: file.stat().st_mtime_ns for file in tmp_path.glob("*.json")}
    again = HereWorker()
    assert len(swept(plan, tmp_path, again)) == len(again.requests) == 3
    assert len(contents(tmp_path)) == 4
    assert (
        times.items()
        <= {
            file.name: file.stat().st_mtime_ns for file in tmp_path.glob("*.json")
        }.items()
    )
    assert swept(plan, tmp_path) == []


def test_a_longer_sweep_takes_what_is_there(tmp_path):
    steps = {"timestep_s": [1 / 360]}
    swept(planned(settings=steps), tmp_path)
    worker = HereWorker()
    swept(planned(variants=[WOOD, METAL], repeats=3, settings=steps), tmp_path, worker)
    assert len(worker.requests) == 6 - 2


def test_a_damaged_result_runs_again(tmp_path):
    plan = planned()
    swept(plan, tmp_path)
    file = min(tmp_path.glob("*.json"))
    file.write_text(file.read_text()[:1000])
    notes = []
    assert len(swept(plan, tmp_path, notify=notes.append)) == 1
    assert len(notes) == 1 and file.name in notes[0] and "run again" in notes[0]
    assert len(contents(tmp_path)) == 4


def test_the_version_of_another_machine_is_a_failure(tmp_path):
    class OldWorker(HereWorker):
        def run(self, request):
            results = super().run(request)
            for result in results:
                result.versions["mujoco"] = "1.0"
            return results

    (result,) = swept(
        planned(variants=[WOOD], repeats=1, settings={}), tmp_path, OldWorker()
    )
    assert result.outcome is Outcome.FAILED and "made with mujoco 1.0, not" in str(
        result.error
    )


# --- failures ---


def test_a_worker_that_dies_costs_its_episode(installed, tmp_path):
    installed("crash")
    plan = planned(
        backends=["crash"],
        variants=[WOOD, PLASTIC],
        repeats=1,
        settings={"timestep_s": [1 / 360]},
    )
    folder = tmp_path / "out"
    results = swept(plan, folder, ProcessWorker(Limits()))
    assert sorted(result.outcome.value for result in results) == ["failed", "finished"]
    failed = [
        json.loads(file.read_text()) for file in (folder / "failed").glob("*.json")
    ]
    assert {one["id"] for one in failed} == {f"GAUGE/{PLASTIC}"}
    assert all(
        "died with signal 11 (segmentation fault)" in one["error"] for one in failed
    )
    assert outcomes(folder) == ["failed", "finished"]
    worker = HereWorker()
    assert swept(plan, folder, worker) == [] == worker.requests


def test_failures_run_again_on_request(tmp_path):
    plan = planned(variants=[WOOD], repeats=1, settings={"timestep_s": [1 / 360]})
    (result,) = swept(plan, tmp_path, mortal_worker(0))
    assert (
        result.error == "died" and len(list((tmp_path / "failed").glob("*.json"))) == 1
    )
    assert swept(plan, tmp_path) == []
    (result,) = swept(plan, tmp_path, retry_failed=True)
    assert result.outcome is Outcome.FINISHED
    assert list((tmp_path / "failed").glob("*.json")) == []
    assert outcomes(tmp_path) == ["finished"]


@needs_rapier
def test_what_a_declined_scene_leaves(tmp_path):
    (result,) = swept(
        planned(
            backends=["rapier"], variants=["FoamBending-soft"], repeats=1, settings={}
        ),
        tmp_path,
    )
    assert result.outcome is Outcome.DECLINED
    assert len(list((tmp_path / "declined").glob("*.json"))) == 1


def test_an_error_of_a_worker_ends_the_sweep(tmp_path):
    class Broken(HereWorker):
        def run(self, request):
            raise ZeroDivisionError("a mistake in the program")

    with pytest.raises(ZeroDivisionError, match="a mistake"):
        swept(planned(), tmp_path, Broken(), HereWorker())
