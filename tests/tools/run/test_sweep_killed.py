"""Killed sweeps lose no episode, repeat no episode, and give the same bits."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time

import pytest
from places import ROOT
from sweep_workers import children, contents, outcomes, planned, swept

PLAN = {
    "variants": ["SlopeSlider-2-*"],
    "repeats": 16,
    "settings": {"timestep_s": [1 / 360, 1 / 720]},
}
COUNT = 96
PROGRAM = [sys.executable, "-c", "from gauge_envs.__main__ import main; main()"]
COMMAND = [*PROGRAM, "sweep", "--jobs", "2", "--only=SlopeSlider-2-*", "--repeats=16"]
COMMAND += ["--set", f"timestep_s={1 / 360!r},{1 / 720!r}", "--retry-failed", "--out"]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="it finds workers in /proc")
def test_kills_of_parent_and_workers_lose_nothing_and_nothing_runs_twice(tmp_path):
    assert len(swept(planned(**PLAN), tmp_path / "whole")) == COUNT
    expected = contents(tmp_path / "whole")
    folder, moments = tmp_path / "killed", random.Random(0)
    for victim in ("parent", "worker", None):
        before = {file: file.stat().st_mtime_ns for file in folder.glob("*.json")}
        command = [*COMMAND, str(folder)]
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL)
        is_killed = victim is None
        while not is_killed and process.poll() is None:
            time.sleep(moments.uniform(0.01, 0.1))
            if len(list(folder.glob("*.json"))) < len(before) + 3:
                continue
            # A child may end before the kill; then the next child is killed.
            with contextlib.suppress(ProcessLookupError, IndexError):
                pid = process.pid if victim == "parent" else children(process.pid)[0]
                os.kill(pid, signal.SIGKILL)
                is_killed = True
        assert is_killed
        process.wait()
        after = {file: file.stat().st_mtime_ns for file in folder.glob("*.json")}
        assert before.items() <= after.items()
        assert contents(folder).items() <= expected.items()
    assert contents(folder) == expected
    assert outcomes(folder) == ["finished"] * COUNT
