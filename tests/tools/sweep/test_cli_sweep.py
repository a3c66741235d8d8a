"""`gauge sweep`: plans, runs, exit codes, interruption, and a message for each wrong request."""

import json

import approval
import pytest
from sweep_workers import HereWorker, contents, needs_rapier

from gauge_envs.tools.sweep import command

FILE = """
variants = ["SlopeSlider-2-wood"]
repeats = 2

[settings]
timestep_s = [0.002777777777777778, 0.001388888888888889]
"""


@pytest.fixture
def gauge(gauge, tmp_path, monkeypatch):
    """Runs the command in a folder with `sweep.toml`, on workers in this process."""
    (tmp_path / "sweep.toml").write_text(FILE)
    monkeypatch.setattr(command, "_workers", lambda *arguments: [HereWorker()])
    return gauge


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
        gauge(
            "sweep", "sweep.toml", "--out", "out", "--dry-run", "--json", "--repeats=3"
        )
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
        "--only=SlopeSlider-2-wood",
        "--repeats=2",
        "--set",
        steps,
        "--out",
        "options",
    )
    assert contents(tmp_path / "file") == contents(tmp_path / "options")


@needs_rapier
def test_words_and_options_replace_keys_of_the_file(gauge):
    options = [
        "--backend=mujoco",
        "--backend=rapier",
        "--set",
        "mujoco.iterations=5,10",
        "--jitter=0.5mm",
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
    foam = ["--backend=rapier", "--repeats=1", "--out", "out"]
    declined = gauge("sweep", "--only=FoamBending-soft", *foam)
    assert declined.exit_code == 1 and declined.stdout.split()[-5:] == [
        "rapier",
        "0",
        "0",
        "1",
        "0",
    ]
    assert gauge("sweep", "--only=FoamBending-s[o]ft", *foam).exit_code == 0


REFUSED = """
sweep
sweep --repeats=2
sweep sweep.toml --jitter=1cm
sweep sweep.toml SlopeSlider-2-wood
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
"""
"""Requests that are refused before anything runs."""


def test_what_cannot_be_met_is_refused_in_the_approved_words(gauge, approved):
    commands = REFUSED.strip().splitlines()
    approved("sweep/refused", approval.refused_commands(gauge, *commands))


@pytest.mark.parametrize(
    ("arguments", "place"),
    [
        (["sweep.toml", "--repeats=0"], "--repeats"),
        (["none.toml"], "none.toml: cannot be read"),
        (["sweep.toml", "--out", "sweep.toml"], "results cannot be written there"),
        (["sweep.toml", "--set", "iterations=many"], "MuJoCo setting 'iterations'"),
        (["sweep.toml", "--shard", "1" * 5000 + "/2"], "expected NUMBER/COUNT"),
    ],
)
def test_a_wrong_request_has_exit_code_2(gauge, arguments, place):
    result = gauge("sweep", *arguments)
    assert result.exit_code == 2
    assert place in result.stderr


@pytest.mark.parametrize(
    ("name", "words"),
    [("text", ""), ("wide", "--format wide"), ("dry-run", "--dry-run")],
)
def test_the_output_is_the_approved_one(gauge, approved, name, words):
    result = gauge("sweep", "sweep.toml", "--out", "out", *words.split())
    lines = [line for line in result.stdout.splitlines() if " s " not in line]
    approved(f"sweep/{name}", "\n".join(lines))


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
