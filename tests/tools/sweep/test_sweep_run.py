"""`gauge sweep`: results, resuming, failures, exit codes, and a message for each wrong request."""

import json
from contextlib import closing

import approval
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
from gauge_envs.tools.sweep import command
from gauge_envs.tools.sweep.folder import run_sweep
from gauge_envs.tools.sweep.plan import remaining_tasks

WOOD, PLASTIC, METAL = (
    "SlopeSlider-2-wood",
    "SlopeSlider-2-plastic",
    "SlopeSlider-2-metal",
)
QUICK = {"timestep_s": [1 / 360, 1 / 720]}
FILE = f"""
variants = ["{WOOD}"]
repeats = 2

[settings]
timestep_s = [{1 / 360!r}, {1 / 720!r}]
"""


@needs_rapier
def test_results_are_those_of_gauge_run_bit_for_bit(tmp_path):
    plan = planned(backends=["mujoco", "rapier"], repeats=2, settings=QUICK)
    results = swept(plan, tmp_path, HereWorker(), HereWorker())
    requests = [
        RunRequest(WOOD, backend=engine, settings={"timestep_s": step}, repeats=2)
        for engine in ("mujoco", "rapier")
        for step in QUICK["timestep_s"]
    ]
    assert sorted(map(plain, results)) == sorted(map(plain, run_many(requests)))
    assert sorted(contents(tmp_path).values()) == sorted(map(plain, results))


# --- resuming ---


def test_nothing_runs_twice(tmp_path):
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
    # A longer sweep takes what is there.
    longer = planned(variants=[WOOD, METAL], repeats=3, settings=QUICK)
    assert len(swept(longer, tmp_path)) == 12 - 4


def test_a_damaged_result_runs_again(tmp_path):
    plan = planned(repeats=2, settings=QUICK)
    swept(plan, tmp_path)
    file = min(tmp_path.glob("*.json"))
    file.write_text(file.read_text()[:1000])
    notes = []
    assert len(swept(plan, tmp_path, notify=notes.append)) == 1
    (note,) = notes
    assert file.name in note
    assert "run again" in note


def test_the_version_of_another_machine_is_a_failure(tmp_path):
    class OldWorker(HereWorker):
        def run(self, request):
            (result,) = super().run(request)
            result.versions["mujoco"] = "1.0"
            return [result]

    (result,) = swept(planned(), tmp_path, OldWorker())
    assert result.outcome is Outcome.FAILED
    assert "made with mujoco 1.0, not" in result.error


# --- failures ---


def test_failures_run_again_on_request(tmp_path):
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
    """Runs the command in a folder with `sweep.toml`, on workers in this process."""
    (tmp_path / "sweep.toml").write_text(FILE)
    monkeypatch.setattr(command, "_workers", lambda *arguments: [HereWorker()])
    return gauge


def lines(result):
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_plan_and_run(gauge, tmp_path):
    words = ("sweep", "sweep.toml", "--out", "out")
    plan = gauge(*words, "--dry-run")
    assert plan.exit_code == 0
    assert not (tmp_path / "out").exists()
    assert "4 episodes, 4 left" in plan.stderr
    rows = lines(gauge(*words, "--json"))
    assert [row["outcome"] for row in rows] == ["finished"] * 4
    assert lines(gauge(*words, "--json")) == []
    (row,) = lines(gauge(*words, "--dry-run", "--json", "--repeats=3"))
    assert (row["experiment"], row["episodes"], row["left"]) == (WOOD, 6, 2)
    # Episodes of the slope slider take 0.6 s.
    assert row["simulated_s"] == pytest.approx(2 * 0.6)


@needs_rapier
def test_options_replace_keys_of_the_file(gauge):
    options = ["--backend=mujoco,rapier", "--set", "mujoco.iterations=5,10"]
    rows = lines(gauge("sweep", "sweep.toml", "--dry-run", "--json", *options))
    assert [(row["backend"], row["runs"]) for row in rows] == [
        ("mujoco", 4),
        ("rapier", 2),
    ]


def test_options_and_parts_give_the_sweep_of_the_file(gauge, tmp_path):
    gauge("sweep", "sweep.toml", "--out", "whole")
    steps = f"timestep_s={1 / 360!r},{1 / 720!r}"
    options = [f"--only={WOOD}", "--repeats=2", "--set", steps, "--out", "parts"]
    for number in range(2):
        assert gauge("sweep", *options, "--shard", f"{number}/2").exit_code == 0
        assert len(contents(tmp_path / "parts")) == 2 * (number + 1)
    assert contents(tmp_path / "parts") == contents(tmp_path / "whole")


def test_ctrl_c_keeps_what_is_complete(gauge, tmp_path, monkeypatch):
    class Interrupted(HereWorker):
        def run(self, request):
            if len(self.requests) == 2:
                raise KeyboardInterrupt
            return super().run(request)

    monkeypatch.setattr(command, "_workers", lambda *arguments: [Interrupted()])
    stopped = gauge("sweep", "sweep.toml", "--out", "out")
    assert stopped.exit_code == 130
    assert "the same command continues" in stopped.stderr
    assert len(contents(tmp_path / "out")) == 2


@needs_rapier
def test_a_declined_id_has_exit_code_1(gauge, tmp_path):
    options = ["--backend=rapier", "--repeats=1", "--out", "out"]
    assert gauge("sweep", "--only=FoamBending-soft", *options).exit_code == 1
    assert len(list((tmp_path / "out/declined").glob("*.json"))) == 1
    assert gauge("sweep", "--only=FoamBending-s[o]ft", *options).exit_code == 0


REFUSED = """
sweep
sweep --repeats=2
sweep none.toml
sweep sweep.toml --jitter=1cm
sweep sweep.toml --set iterations
sweep sweep.toml --set rapier.iterations=3
sweep sweep.toml --shard 3
sweep sweep.toml --shard 5/4
sweep sweep.toml --backend=bullet
sweep sweep.toml --only=SlopeSlider-9-*
sweep sweep.toml --preset=quick
sweep sweep.toml --parameter=measured
sweep sweep.toml --set substeps=2
sweep sweep.toml --set timestep_s=0.004
sweep sweep.toml --repeats=1000000000
sweep sweep.toml --out sweep.toml
"""
"""Requests that are refused before anything runs."""


def test_what_cannot_be_met_is_refused_in_the_approved_words(gauge, approved):
    commands = REFUSED.strip().splitlines()
    approved("sweep/refused", approval.refused_commands(gauge, *commands))


@pytest.mark.parametrize(("name", "words"), [("text", ""), ("dry-run", "--dry-run")])
def test_the_output_is_the_approved_one(gauge, approved, name, words):
    result = gauge("sweep", "sweep.toml", "--out", "out", *words.split())
    approved(f"sweep/{name}", result.stdout)
