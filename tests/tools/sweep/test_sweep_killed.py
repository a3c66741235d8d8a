"""Sweeps that are killed at random moments, and Ray: the same bits, nothing lost, nothing twice."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time

import pytest
from places import ROOT
from sweep_workers import children, contents, needs_rapier, outcomes, swept

from gauge_envs.runs.pool import Limits
from gauge_envs.tools.sweep.machines import ray_workers
from gauge_envs.tools.sweep.plan import plan_sweep
from gauge_envs.tools.sweep.spec import sweep_spec

VALUES = {
    "backends": ["mujoco", "rapier"],
    "variants": ["SlopeSlider-2-*"],
    "repeats": 8,
    "settings": {"timestep_s": [1 / 360, 1 / 720]},
}
COUNT = 96
COMMAND = [
    *(
        sys.executable,
        "-c",
        "from gauge_command import main; main()",
        "sweep",
        "--jobs",
        "2",
    ),
    *("--backend=mujoco,rapier", "--only=SlopeSlider-2-*", "--repeats=8"),
    *("--set", f"timestep_s={1 / 360!r},{1 / 720!r}", "--retry-failed", "--out"),
]


def whole(folder):
    """The results of the sweep in one process."""
    assert len(swept(plan_sweep(sweep_spec(VALUES)), folder)) == COUNT
    return contents(folder)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="it finds workers in /proc")
@needs_rapier
def test_kills_of_parent_and_workers_lose_nothing_and_nothing_runs_twice(tmp_path):
    expected = whole(tmp_path / "whole")
    folder, moments = tmp_path / "killed", random.Random(0)
    kills = []
    for count, victim in enumerate(("parent", "parent", "worker", None), 1):
        before = {file.name: file.stat().st_mtime_ns for file in folder.glob("*.json")}
        process = subprocess.Popen(
            [*COMMAND, str(folder)], cwd=ROOT, stdout=subprocess.DEVNULL
        )
        while (
            victim
            and process.poll() is None
            and len(list(folder.glob("*.json"))) < len(before) + 3
        ):
            time.sleep(0.01)
        time.sleep(moments.uniform(0.0, 0.3))
        # A child that is found may end before it is killed; the next one is then taken.
        while victim and len(kills) < count and process.poll() is None:
            with contextlib.suppress(ProcessLookupError, IndexError):
                os.kill(
                    process.pid if victim == "parent" else children(process.pid)[0],
                    signal.SIGKILL,
                )
                kills.append(victim)
        returncode = process.wait()
        assert (
            returncode
            in ({"parent": [-signal.SIGKILL], "worker": [0, 1], None: [0]}[victim])
        )
        after = {file.name: file.stat().st_mtime_ns for file in folder.glob("*.json")}
        assert before.items() <= after.items()
        assert contents(folder).items() <= expected.items()
    assert kills == ["parent", "parent", "worker"]
    assert contents(folder) == expected
    assert outcomes(folder) == ["finished"] * COUNT


@pytest.mark.slow
@needs_rapier
def test_two_ray_workers_of_which_one_is_killed_give_the_same_bits(
    tmp_path, monkeypatch
):
    ray = pytest.importorskip("ray")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    expected = whole(tmp_path / "whole")
    workers = ray_workers("local", 2, Limits())
    try:
        first = workers[0]
        run, calls = first.run, []

        def run_and_kill(request):
            calls.append(request)
            if len(calls) == 3:
                ray.kill(first._actor)
            return run(request)

        monkeypatch.setattr(first, "run", run_and_kill)
        assert (
            len(swept(plan_sweep(sweep_spec(VALUES)), tmp_path / "ray", *workers))
            == COUNT
        )
    finally:
        ray.shutdown()
    assert len(calls) > 3
    assert contents(tmp_path / "ray") == expected
