"""`gauge run`, killed at random moments and resumed, or ended by Ctrl-C: no result is lost, doubled or half-written."""

import json
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from places import ROOT
from sweep_workers import children

from gauge_envs.cli.app import app
from gauge_envs.runs.result_file import load_result

KILL_COUNT = 100
COMMAND = [
    "run",
    "SlopeSlider-*",
    "BouncingBall-rubber",
    "--repeats=2",
    "--resume",
    "--json",
    "--out",
]


def run(folder):
    with open(os.devnull, "w") as nothing:  # noqa: PTH123
        os.dup2(nothing.fileno(), 1)
        os.dup2(nothing.fileno(), 2)
    app([*COMMAND, str(folder)])


def contents(folder):
    """The results of a folder by file name, without the times of their making; each must be complete."""
    return {
        file.name: json.dumps(
            replace(load_result(file), wall_s=None, cpu_s=None, created="").to_dict()
        )
        for file in folder.iterdir()
        if not file.name.startswith(".")
    }


@pytest.mark.slow
def test_kills_at_random_moments_lose_double_and_cut_nothing(tmp_path):
    process = multiprocessing.get_context("fork").Process
    moments = random.Random(0)
    start = time.monotonic()
    whole = process(target=run, args=(tmp_path / "whole",))
    whole.start()
    whole.join()
    assert whole.exitcode == 0
    duration_s = time.monotonic() - start
    expected = contents(tmp_path / "whole")
    assert len(expected) == 20
    kills = rounds = partial = 0
    while kills < KILL_COUNT:
        folder = tmp_path / f"round-{rounds}"
        rounds += 1
        exitcode = None
        while exitcode != 0:
            one = process(target=run, args=(folder,))
            one.start()
            one.join(moments.uniform(0.0, duration_s))
            one.kill()
            one.join()
            exitcode = one.exitcode
            assert exitcode in (0, -signal.SIGKILL)
            kills += exitcode != 0
            if folder.exists():
                found = contents(folder)
                assert found.items() <= expected.items()
                partial += 0 < len(found) < len(expected)
        assert contents(folder) == expected
    print(
        f"{kills} kills in {rounds} runs of {duration_s:.1f} s, {partial} of them between results"
    )
    assert partial > KILL_COUNT // 10


@pytest.mark.skipif(sys.platform != "linux", reason="it finds workers in /proc")
def test_ctrl_c_ends_several_jobs_at_once_and_leaves_no_process(tmp_path):
    command = "from gauge_command import main; main()"
    words = ("run", "*", "--jobs=2", "--repeats=20", "--out", str(tmp_path))
    with subprocess.Popen(
        [sys.executable, "-c", command, *words],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as run:
        while not (workers := children(run.pid)) and run.poll() is None:
            time.sleep(0.05)
        time.sleep(1.0)
        start_s = time.monotonic()
        os.killpg(run.pid, signal.SIGINT)
        _, errors = run.communicate()
    assert workers
    assert time.monotonic() - start_s < 10.0, "a busy machine takes a second"
    assert run.returncode == 130
    assert "--resume continues from there" in errors and "Traceback" not in errors
    assert not [pid for pid in workers if Path(f"/proc/{pid}").exists()]
