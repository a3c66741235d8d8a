"""An engine that crashes, exits, hangs or takes all memory loses only its episode, and Ctrl-C leaves no process.

The faulty engines are from `hostile.py`, installed as a package.
"""

import atexit
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from places import ROOT
from sweep_workers import children

from gauge_envs.errors import GaugeError, ParameterError
from gauge_envs.experiments.variants import find_variant
from gauge_envs.runs import workers
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.workers import CrashError, Worker
from gauge_envs.tools.catalog import listing

WOOD, PLASTIC = "SlopeSlider-2-wood", "SlopeSlider-2-plastic"
needs_proc = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


# --- episodes ---


CAUSES = {
    "crash": "the engine's process died with signal 11 (segmentation fault)",
    "hard-exit": "the engine ended its process with exit code 6",
    "exit": "SystemExit: 5",
    "greedy": "MemoryError (memory limit: 0.8 GB)",
}
"""Causes of failure by engine; each engine fails in the episode of the plastic cube."""


def test_a_failure_of_an_engine_loses_one_episode(installed):
    installed(*CAUSES)
    requests = [RunRequest(PLASTIC, backend=engine) for engine in CAUSES]
    requests.insert(1, RunRequest(WOOD, backend="crash"))
    limits = {"memory_limit_gb": 0.8, "time_limit_s": 120.0}
    results = list(run_many(requests, isolate=None, **limits))
    assert results.pop(1).outcome.value == "finished"
    for result, cause in zip(results, CAUSES.values(), strict=True):
        assert result.outcome.value == "failed"
        assert cause in result.error


def test_an_engine_that_hangs_is_stopped_at_the_time_limit(installed):
    installed("hang")
    (result,) = run_many(
        [RunRequest(PLASTIC, backend="hang")], isolate=None, time_limit_s=0.5
    )
    assert "within the time limit of 0.5 s and was stopped" in result.error


def test_a_setting_without_a_json_form_loses_its_episode(installed, tmp_path):
    installed("no-json")
    requests = [RunRequest(WOOD, backend="no-json"), RunRequest(WOOD)]
    broken, healthy = run_many(requests, out=tmp_path / "out")
    assert "backend 'no-json': setting 'pool' is a set" in broken.error
    assert healthy.error is None


def test_a_list_names_broken_engines_with_their_cause(installed, monkeypatch):
    causes = {
        "at-import": "SystemExit: 3",
        "supports-crash": "segmentation fault",
        "supports-hang": "time limit of 0.5 s",
    }
    installed(*causes)
    monkeypatch.setattr(listing, "backend_names", lambda: ("mujoco", *causes))
    notes = []
    for name in causes:
        limit_s = 0.5 if name == "supports-hang" else 60.0
        monkeypatch.setattr(listing, "QUERY_LIMIT_S", limit_s)
        monkeypatch.setattr(
            listing, "backend_names", lambda name=name: ("mujoco", name)
        )
        (row,) = listing.list_rows([find_variant(WOOD)], notify=notes.append)
        assert row["backends"]["mujoco"] == []
        assert causes[name] in row["backends"][name][0]
        assert repr(name) in notes[-1] and causes[name] in notes[-1]


# --- a worker ---


def test_a_worker_continues_after_an_error_and_after_a_crash():
    with Worker() as worker:
        with pytest.raises(GaugeError, match="unknown experiment"):
            worker.call(find_variant, "nothing")
        first = worker.call(os.getpid)
        assert first != os.getpid()
        assert worker.call(os.getpid) == first
        with pytest.raises(CrashError, match="exit code 7"):
            worker.call(os._exit, 7)
        assert worker.call(os.getpid) != first


def test_a_process_ends_itself_unless_that_takes_long(tmp_path, monkeypatch):
    """Genesis stores its compiled kernels when its process ends."""
    with Worker() as worker:
        worker.call(atexit.register, os.mkdir, str(tmp_path / "kernels"))
    assert (tmp_path / "kernels").is_dir()
    monkeypatch.setattr(workers, "END_S", 0.1)
    start_s = time.monotonic()
    with Worker() as worker:
        worker.call(atexit.register, time.sleep, 600.0)
    assert time.monotonic() - start_s < 300.0


@pytest.mark.parametrize(
    ("is_single", "number", "expected"),
    [(True, None, "1"), (False, None, None), (True, "4", "4")],
)
def test_a_process_that_shares_the_cores_has_one_thread_by_default(
    is_single, number, expected, monkeypatch
):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if number is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", number)
    with Worker(single_thread=is_single) as worker:
        assert worker.call(os.getenv, "OMP_NUM_THREADS") == expected


@pytest.mark.parametrize(
    "limits",
    [
        *({"time_limit_s": limit} for limit in (0.0, math.nan, math.inf)),
        *({"memory_limit_gb": limit} for limit in (0.0, math.nan, math.inf)),
    ],
)
def test_a_limit_is_positive_and_finite(limits):
    with pytest.raises(
        ParameterError, match=r"limit is .*, expected a positive number"
    ):
        run_many([RunRequest(WOOD)], isolate=True, **limits)


def wait_for_the_end_of(process):
    """Wait for a process that ends soon; fail after 5 minutes, because the process would sleep for 10."""
    state = Path(f"/proc/{process}/stat")
    end_s = time.monotonic() + 300.0
    # A process that has ended without a parent that waits is a zombie.
    while state.exists() and state.read_text().rpartition(")")[2].split()[0] != "Z":
        assert time.monotonic() < end_s
        time.sleep(0.02)


@needs_proc
@pytest.mark.parametrize(
    "call", ["time.sleep, 0", "time.sleep, 600", "os.system, 'sleep 600'"]
)
def test_a_worker_and_its_child_processes_end_with_their_parent(call):
    code = (
        "import os, time; from gauge_envs.runs.workers import Worker; worker = Worker(); "
        f"print(worker.call(os.getpid), flush=True); worker.call({call}); time.sleep(600)"
    )
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        worker = int(parent.stdout.readline())
        processes = [worker]
        if "system" in call:
            while not (found := children(worker)):
                time.sleep(0.02)
            processes += found
        parent.kill()
    for process in processes:
        wait_for_the_end_of(process)


@needs_proc
def test_the_time_limit_also_ends_child_processes_of_a_worker(tmp_path):
    file = tmp_path / "pid"
    with Worker(2.0) as worker, pytest.raises(CrashError, match="time limit of 2 s"):
        worker.call(os.system, f"echo $$ > {file}; sleep 600")
    wait_for_the_end_of(int(file.read_text()))


# --- a run that is interrupted ---


@needs_proc
def test_ctrl_c_ends_several_jobs_at_once_and_leaves_no_process(tmp_path):
    command = "from gauge_envs.__main__ import main; main()"
    words = ("run", "*", "--jobs=2", "--out", str(tmp_path))
    with subprocess.Popen(
        [sys.executable, "-c", command, *words],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as run:
        while not list(tmp_path.glob("*.json")) and run.poll() is None:
            time.sleep(0.02)
        workers = children(run.pid)
        os.killpg(run.pid, signal.SIGINT)
        _, errors = run.communicate(timeout=300.0)
    assert workers
    assert run.returncode == 130
    assert "--resume continues from there" in errors and "Traceback" not in errors
    # A busy machine takes a while to end a process.
    deadline_s = time.monotonic() + 60.0
    while any(Path(f"/proc/{pid}").exists() for pid in workers):
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
