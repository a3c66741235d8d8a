"""`gauge sweep` gives the results of `gauge run`, runs each episode once, and returns the outcome as exit code."""

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
    planned,
    swept,
)

from gauge_envs.runs.batch import run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.run import command
from gauge_envs.tools.run.folder import run_sweep
from gauge_envs.tools.run.plan import remaining_tasks

WOOD, METAL = "SlopeSlider-2-wood", "SlopeSlider-2-metal"
QUICK = {"timestep_s": [1 / 360, 1 / 720]}
FILE = f"""
variants = ["{WOOD}"]
repeats = 2

[settings]
timestep_s = [{1 / 360!r}, {1 / 720!r}]
"""


@needs_rapier
def test_results_equal_results_of_gauge_run_bit_for_bit(tmp_path):
    plan = planned(backends=["mujoco", "rapier"], settings=QUICK)
    results = swept(plan, tmp_path, HereWorker(), HereWorker())
    requests = [
        RunRequest(WOOD, backend=engine, settings={"timestep_s": step})
        for engine in ("mujoco", "rapier")
        for step in QUICK["timestep_s"]
    ]
    assert sorted(map(plain, results)) == sorted(map(plain, run_many(requests)))
    assert sorted(contents(tmp_path).values()) == sorted(map(plain, results))


# --- resuming ---


def test_each_episode_runs_once(tmp_path):
    plan = planned(repeats=2, settings=QUICK)
    tasks = list(remaining_tasks(plan, ()))
    with closing(run_sweep(tasks, [HereWorker()], tmp_path)) as finished:
        next(finished)
    (file,) = tmp_path.glob("*.json")
    written_ns = file.stat().st_mtime_ns
    again = HereWorker()
    assert len(swept(plan, tmp_path, again)) == len(again.requests) == 3
    assert len(contents(tmp_path)) == 4
    assert file.stat().st_mtime_ns == written_ns
    # A longer sweep keeps the existing results.
    longer = planned(variants=[WOOD, METAL], repeats=3, settings=QUICK)
    assert len(swept(longer, tmp_path)) == 12 - 4


def test_retry_failed_runs_failures_again(tmp_path):
    plan = planned()
    (result,) = swept(plan, tmp_path, mortal_worker(0))
    assert result.error == "died"
    assert swept(plan, tmp_path) == []
    (result,) = swept(plan, tmp_path, retry_failed=True)
    assert result.outcome is Outcome.FINISHED
    assert outcomes(tmp_path) == ["finished"]


# --- the command ---


@pytest.fixture
def gauge(gauge, tmp_path, monkeypatch):
    """Run the command in a folder with `sweep.toml`, on workers in this process."""
    (tmp_path / "sweep.toml").write_text(FILE)
    monkeypatch.setattr(command, "_workers", lambda *arguments: [HereWorker()])
    return gauge


def lines(result):
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_a_sweep_runs_in_parts_after_a_plan(gauge, tmp_path):
    steps = f"timestep_s={1 / 360!r},{1 / 720!r}"
    words = [f"--only={WOOD}", "--repeats=2", "--set", steps, "--out", "out"]
    plan = gauge("sweep", *words, "--dry-run")
    assert "4 episodes, 4 left" in plan.stderr
    assert not (tmp_path / "out").exists()
    for number in range(2):
        part = gauge("sweep", *words, "--shard", f"{number}/2", "--json")
        assert [row["outcome"] for row in lines(part)] == ["finished"] * 2
    # The sweep file has the same episodes, and an option replaces its key.
    words = ("sweep", "sweep.toml", "--out", "out")
    assert lines(gauge(*words, "--json")) == []
    (row,) = lines(gauge(*words, "--dry-run", "--json", "--repeats=3"))
    assert (row["experiment"], row["episodes"], row["left"]) == (WOOD, 6, 2)
    # Episodes of the slope slider take 0.6 s.
    assert row["simulated_s"] == pytest.approx(2 * 0.6)
    table = gauge(*words).stdout.splitlines()
    assert table[-1].split() == ["mujoco", "finished", "4"]


@needs_rapier
def test_an_unsupported_id_has_exit_code_1(gauge, tmp_path):
    options = ["--backend=rapier", "--repeats=1", "--out", "out"]
    assert gauge("sweep", "--only=FoamBending-soft", *options).exit_code == 1
    assert len(list((tmp_path / "out/unsupported").glob("*.json"))) == 1
    assert gauge("sweep", "--only=FoamBending-s[o]ft", *options).exit_code == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", "nothing to run"),
        ("sweep.toml --shard 5/4", "--shard '5/4'"),
        ("sweep.toml --backend=bullet", "'bullet'"),
        ("sweep.toml --parameter=tuned", "'tuned'"),
        ("sweep.toml --set substeps=2", "substeps"),
        ("sweep.toml --set rapier.iterations=3", "settings.rapier"),
        ("sweep.toml --repeats=1000000000", "more than 1,000,000 episodes"),
    ],
)
def test_a_wrong_request_is_rejected_before_the_run(gauge, tmp_path, words, message):
    rejected = gauge("sweep", *words.split())
    assert rejected.exit_code == 2
    assert message in rejected.stderr
    assert not (tmp_path / "sweep").exists()
