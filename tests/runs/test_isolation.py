"""Engines that crash, exit or hang cost their own episode, and results are the same in another process."""

import atexit
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from sweep_workers import plain
from typer.testing import CliRunner

from gauge_envs.backends import backend
from gauge_envs.cli.app import app
from gauge_envs.errors import BackendError, GaugeError, ParameterError
from gauge_envs.experiments.variants import find_variant
from gauge_envs.runs import batch, isolation
from gauge_envs.runs.batch import check_requests, run_many
from gauge_envs.runs.isolation import CrashError, Worker
from gauge_envs.runs.request import RunRequest
from gauge_envs.tools.catalog import listing
from gauge_envs.tools.catalog.listing import list_rows
from gauge_envs.tools.conformance import words
from gauge_envs.tools.conformance.words import backends_table

WOOD, PLASTIC, METAL = (
    "SlopeSlider-2-wood",
    "SlopeSlider-2-plastic",
    "SlopeSlider-2-metal",
)


def test_results_have_the_same_bits_in_another_process():
    requests = [RunRequest("SlopeSlider-3-metal", seed=2, repeats=2)]
    here, there = run_many(requests), run_many(requests, isolate=True)
    assert list(map(plain, here)) == list(map(plain, there))


def test_a_process_that_shares_the_cores_has_one_thread_unless_told_otherwise(
    monkeypatch,
):
    found = []
    for stated in (None, "4"):
        if stated is None:
            monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
        else:
            monkeypatch.setenv("OMP_NUM_THREADS", stated)
        for single in (True, False):
            with Worker(single_thread=single) as worker:
                found.append(worker.call(os.getenv, "OMP_NUM_THREADS"))
    assert found == ["1", None, "4", "4"]


def test_a_process_that_waits_for_a_call_ends_itself_unless_that_takes_long(
    tmp_path, monkeypatch
):
    """Genesis writes the kernels that it compiled when its process ends."""
    # A fork of the test's process ends at once.
    monkeypatch.setattr(isolation, "subprocess", subprocess)
    with Worker() as worker:
        worker.call(atexit.register, os.mkdir, str(tmp_path / "kernels"))
    assert (tmp_path / "kernels").is_dir()
    monkeypatch.setattr(isolation, "END_S", 0.1)
    start_s = time.monotonic()
    with Worker() as worker:
        worker.call(atexit.register, time.sleep, 60.0)
    assert time.monotonic() - start_s < 30.0


CAUSES = {
    "crash": "the engine's process died with signal 11 (segmentation fault)",
    "hard-exit": "the engine ended its process with exit code 6",
    "exit": "SystemExit: 5",
    "hang": "did not finish within the time limit of 8 s and was stopped",
    "greedy": "MemoryError (memory limit: 0.8 GB)",
}
"""Causes by the engines that fail in the episode of one scene."""


@pytest.mark.parametrize(
    "how", [{"isolate": None}, {"isolate": True, "jobs": 2}], ids=str
)
def test_a_crash_a_time_limit_and_a_memory_limit_cost_one_episode_each(how, installed):
    installed(*CAUSES)
    requests = [
        RunRequest(name, backend=engine)
        for engine in CAUSES
        for name in (PLASTIC, METAL)
    ]
    results = list(run_many(requests, time_limit_s=8.0, memory_limit_gb=0.8, **how))
    assert [one.backend for one in results] == [one.backend for one in requests]
    assert {one.outcome.value for one in results[1::2]} == {"finished"}
    for result, cause in zip(results[::2], CAUSES.values(), strict=True):
        assert result.outcome.value == "failed" and cause in str(result.error)


def test_a_setting_that_json_does_not_have_costs_its_episode(installed, tmp_path):
    installed("no-json")
    broken, healthy = run_many(
        [RunRequest(WOOD, backend="no-json"), RunRequest(WOOD)], out=tmp_path / "out"
    )
    assert "backend 'no-json': setting 'pool' is a set" in str(broken.error)
    assert healthy.error is None


def test_lists_name_broken_engines_with_their_cause(installed, monkeypatch):
    """Each engine outside this package answers in another process."""
    causes = {"at-import": "SystemExit: 3", "supports-crash": "segmentation fault"}
    installed("well", *causes)
    monkeypatch.setattr(listing, "backend_names", lambda: ("mujoco", "well", *causes))
    notes = []
    (row,) = list_rows([find_variant(WOOD)], notify=notes.append)
    assert row["backends"]["mujoco"] == row["backends"]["well"] == []
    check_causes(row["backends"], notes, causes)
    monkeypatch.setattr(words, "backend_names", lambda: ("mujoco", "well", "at-import"))
    errors = {row["name"]: row["error"] for row in backends_table().rows}
    assert errors["mujoco"] is errors["well"] is None
    assert "SystemExit" in errors["at-import"]


def check_causes(lacking, notes, causes):
    """Check that a list and its notes name each broken engine with its cause."""
    for name, cause in causes.items():
        assert cause in lacking[name][0]
        assert any(repr(name) in note and cause in note for note in notes)
    assert len(notes) == len(causes)


def test_a_list_waits_for_no_engine_that_hangs(installed, monkeypatch):
    installed("supports-hang")
    monkeypatch.setattr(listing, "backend_names", lambda: ("mujoco", "supports-hang"))
    monkeypatch.setattr(listing, "QUERY_LIMIT_S", 1.0)
    (row,) = list_rows([find_variant(WOOD)])
    assert row["backends"]["mujoco"] == []
    assert "time limit of 1 s" in row["backends"]["supports-hang"][0]


def test_one_process_asks_broken_engines_too(installed, monkeypatch):
    causes = {
        "other-name": "the class has the name 'another'",
        "no-backend": "expected a Backend",
        "at-import": "SystemExit: 3",
        "supports": "ZeroDivisionError: mass of nothing",
        "supports-exit": "SystemExit: 4",
    }
    installed("well", *causes)
    monkeypatch.setattr(isolation, "is_bundled", lambda name: True)
    notes = []
    backends = list_rows([find_variant(WOOD)], notify=notes.append)[0]["backends"]
    assert backends["mujoco"] == backends["well"] == []
    check_causes(backends, notes, causes)
    for name in ("at-import", "other-name"):
        with pytest.raises(BackendError, match=name):
            backend(name)


def test_settings_are_checked_in_the_other_process(installed):
    installed("well")
    with pytest.raises(GaugeError, match="MuJoCo setting 'nope'"):
        check_requests(
            [RunRequest(WOOD, backend="well", settings={"nope": 1})], isolate=None
        )


@pytest.mark.usefixtures("real_children")
def test_a_worker_goes_on_after_an_error_and_after_a_crash():
    with Worker(20.0) as worker:
        with pytest.raises(GaugeError, match="unknown experiment"):
            worker.call(find_variant, "nothing")
        first = worker.call(os.getpid)
        assert first != os.getpid()
        assert worker.call(os.getpid) == first
        with pytest.raises(CrashError, match="exit code 7"):
            worker.call(os._exit, 7)
        assert worker.call(os.getpid) != first


def wait_for_the_end_of(process):
    """Wait for a process that ends at once; one that sleeps for 10 minutes fails after 5."""
    state = Path(f"/proc/{process}/stat")
    end_s = time.monotonic() + 300.0
    # A process that has ended and that nobody waits for is a zombie.
    while state.exists() and state.read_text().rpartition(")")[2].split()[0] != "Z":
        assert time.monotonic() < end_s
        time.sleep(0.1)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_worker_ends_after_its_call_when_its_parent_is_gone():
    code = (
        "import os, time; from gauge_envs.runs.isolation import Worker; worker = Worker(); "
        "print(worker.call(os.getpid), flush=True); worker.call(time.sleep, 1.0)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True
    ) as parent:
        worker = int(parent.stdout.readline())
        parent.kill()
    wait_for_the_end_of(worker)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_the_time_limit_also_ends_what_a_worker_started(tmp_path):
    with Worker(5.0) as worker:
        with pytest.raises(CrashError, match="time limit of 5 s"):
            worker.call(os.system, f"echo $$ > {tmp_path / 'started'}; sleep 600")
        assert worker.call(os.getpid) > 0
    wait_for_the_end_of(int((tmp_path / "started").read_text()))


@pytest.mark.parametrize(
    ("name", "limits"),
    [
        ("time_limit_s", (0.0, -1.0, math.nan, math.inf)),
        ("memory_limit_gb", (0.0, -1.0, math.nan)),
    ],
)
def test_a_limit_is_positive_and_that_of_time_finite(name, limits):
    words = " ".join(name.split("_")[:2])
    for limit in limits:
        with pytest.raises(ParameterError, match=words):
            run_many([RunRequest(WOOD)], isolate=True, **{name: limit})


def test_a_memory_limit_ends_the_call_and_not_the_program():
    with Worker(120.0, memory_limit_gb=0.5) as worker:
        with pytest.raises(GaugeError, match="MemoryError"):
            worker.call(bytearray, 10**9)
        assert worker.call(os.getpid) > 0


@pytest.mark.parametrize(
    ("words", "isolate"),
    [((), None), (("--isolate",), True), (("--timeout", "60s"), True)],
)
def test_the_command_isolates_where_it_is_told_to(words, isolate, monkeypatch):
    asked = []

    def recorded(requests, **options):
        asked.append(options["isolate"])
        return (nothing for nothing in ())

    monkeypatch.setattr(batch, "run_many", recorded)
    CliRunner().invoke(app, ["run", "SlopeSlider-2-wood", *words])
    assert asked == [isolate]
