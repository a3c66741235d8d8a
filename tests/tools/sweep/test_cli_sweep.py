"""`gauge sweep`: plans, runs, exit codes, interruption, and a message for each wrong request."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
from sweep_workers import HereWorker, contents, needs_rapier
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.tools.sweep import command

FILE = """
variants = ["SlopeSlider-2-wood"]
repeats = 2

[settings]
timestep_s = [0.002777777777777778, 0.001388888888888889]
"""


@pytest.fixture
def gauge(tmp_path, monkeypatch):
    """Runs the command in a folder with `sweep.toml`, on workers in this process."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sweep.toml").write_text(FILE)
    monkeypatch.setattr(command, "_workers", lambda *arguments: [HereWorker()])
    return lambda *arguments: CliRunner(env={"COLUMNS": "160"}).invoke(
        app, list(map(str, arguments))
    )


def lines(result):
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_plan_and_run(gauge, tmp_path):
    plan = gauge("sweep", "sweep.toml", "--out", "out", "--dry-run")
    assert plan.exit_code == 0 and not (tmp_path / "out").exists()
    assert "4 episodes, 4 left" in plan.stderr and "cost unknown" in plan.stderr
    done = gauge("sweep", "sweep.toml", "--out", "out")
    assert done.exit_code == 0 and "mujoco" in done.stdout
    assert len(contents(tmp_path / "out")) == 4
    (row,) = lines(
        gauge("sweep", "sweep.toml", "--out", "out", "--dry-run", "--json", "repeats=3")
    )
    assert (row["experiment"], row["episodes"], row["left"], row["unknown"]) == (
        "SlopeSlider-2-wood",
        6,
        2,
        0,
    )
    assert row["engine_s"] > 0.0


def test_words_alone_are_the_file(gauge, tmp_path):
    gauge("sweep", "sweep.toml", "--out", "file")
    steps = "timestep_s=0.002777777777777778,0.001388888888888889"
    gauge(
        "sweep",
        "variants=SlopeSlider-2-wood",
        "repeats=2",
        "--set",
        steps,
        "--out",
        "options",
    )
    assert contents(tmp_path / "file") == contents(tmp_path / "options")


@needs_rapier
def test_words_and_options_replace_keys_of_the_file(gauge):
    options = [
        "backends=mujoco",
        "backends=rapier",
        "--set",
        "mujoco.iterations=5,10",
        "jitter=0.5mm",
    ]
    rows = lines(
        gauge("sweep", "sweep.toml", "--out", "out", "--dry-run", "--json", *options)
    )
    assert [(row["backend"], row["runs"]) for row in rows] == [
        ("mujoco", 4),
        ("rapier", 2),
    ]


def test_json_has_a_line_for_each_new_result(gauge):
    rows = lines(gauge("sweep", "sweep.toml", "--out", "out", "--json"))
    assert len(rows) == 4 and {row["outcome"] for row in rows} == {"finished"}
    assert lines(gauge("sweep", "sweep.toml", "--out", "out", "--json")) == []


def test_ctrl_c_keeps_what_is_complete_and_says_how_to_go_on(
    gauge, tmp_path, monkeypatch
):
    class Interrupted(HereWorker):
        def run(self, request):
            if len(self.requests) == 2:
                raise KeyboardInterrupt
            return super().run(request)

    with monkeypatch.context() as patch:
        patch.setattr(command, "_workers", lambda *arguments: [Interrupted()])
        stopped = gauge("sweep", "sweep.toml", "--out", "out")
    assert stopped.exit_code == 130
    assert "interrupted: 2 of 4 episodes left; continue with:" in stopped.stderr
    kept = contents(tmp_path / "out")
    assert len(kept) == 2
    assert gauge("sweep", "sweep.toml", "--out", "out").exit_code == 0
    assert (
        len(contents(tmp_path / "out")) == 4
        and kept.items() <= contents(tmp_path / "out").items()
    )


@needs_rapier
def test_exit_code_1_states_a_bad_outcome(gauge, monkeypatch):
    foam = ["backends=rapier", "repeats=1", "--out", "out"]
    declined = gauge("sweep", "variants=FoamBending-soft", *foam)
    assert declined.exit_code == 1 and declined.stdout.split()[-5:] == [
        "rapier",
        "0",
        "0",
        "1",
        "0",
    ]
    assert gauge("sweep", "variants=FoamBending-s[o]ft", *foam).exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "nothing to run: give a sweep file"),
        (["repeats=2"], "variants: missing key"),
        (
            ["variant=SlopeSlider-2-wood"],
            "unknown detail 'variant'; did you mean variants?",
        ),
        (["sweep.toml", "repeats=0"], "repeats: "),
        (["sweep.toml", "jitter=1cm"], "expected numbers with units, as 1mm,0.5deg"),
        (
            ["sweep.toml", "SlopeSlider-2-wood"],
            "expected one sweep file; experiments are variants=ID,ID",
        ),
        (["none.toml"], "none.toml: (file): cannot be read"),
        (
            ["sweep.toml", "--set", "iterations"],
            "expected NAME=VALUE,VALUE or ENGINE.NAME=VALUE,VALUE",
        ),
        (
            ["sweep.toml", "--set", "rapier.iterations=3"],
            "'rapier' is no engine of this sweep: mujoco",
        ),
        (["sweep.toml", "--shard", "3"], "expected NUMBER/COUNT, as 0/16"),
        (["sweep.toml", "--shard", "5/4"], "expected a number from 0 to 3"),
        (["sweep.toml", "backends=bullet"], "unknown backend 'bullet'"),
        (
            ["variants=SlopeSlider-2-wood", "--slurm", "jobs.py"],
            "--slurm needs a sweep file",
        ),
        (
            ["sweep.toml", "repeats=1000000000"],
            "2,000,000,000 episodes, the limit is 1,000,000",
        ),
        (["sweep.toml", "--out", "sweep.toml"], "results cannot be written there"),
    ],
)
def test_a_wrong_request_has_exit_code_2(gauge, arguments, message):
    result = gauge("sweep", *arguments)
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())


def test_parts_together_are_the_sweep(gauge, tmp_path):
    for number in range(2):
        assert (
            gauge(
                "sweep", "sweep.toml", "--out", "parts", "--shard", f"{number}/2"
            ).exit_code
            == 0
        )
        assert len(contents(tmp_path / "parts")) == 2 * (number + 1)
    again = gauge("sweep", "sweep.toml", "--out", "parts")
    assert again.exit_code == 0 and "4/4" not in again.stderr


def test_the_slurm_script_states_the_sweep(gauge, tmp_path):
    assert (
        gauge(
            "sweep", "sweep.toml", "--out", "out", "--slurm", "jobs.py", "--shard", "3"
        ).exit_code
        == 0
    )
    text = (tmp_path / "jobs.py").read_text()
    compile(text, "jobs.py", "exec")
    assert "JOBS = 3" in text and str(tmp_path / "sweep.toml") in text


@pytest.mark.slow
def test_the_slurm_script_runs_every_part(gauge, tmp_path):
    pytest.importorskip("submitit")
    gauge("sweep", "sweep.toml", "--out", "out", "--slurm", "jobs.py", "--shard", "2")
    done = subprocess.run(
        [sys.executable, "jobs.py", "--cluster", "local"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "exit codes: [0, 0]" in done.stdout
    assert len(contents(tmp_path / "out")) == 4
