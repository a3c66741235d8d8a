"""An engine that crashes, exits or hangs in a check costs that check, and the others run."""

import json

import pytest
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.errors import GaugeError
from gauge_envs.runs.isolation import Worker
from gauge_envs.tools.conformance import Status, run_checks

ONLY = ("free-fall", "slide", "driven-path")
"""Of these, only the second has contacts."""


def checked(name, *options):
    """Rows and outcome of the command."""
    chosen = [part for one in ONLY for part in ("--only", one)]
    result = CliRunner().invoke(
        app, ["backend", "check", name, "--json", *chosen, *options]
    )
    return [json.loads(line) for line in result.stdout.splitlines()], result


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        (
            "contact-crash",
            "the engine's process died with signal 11 (segmentation fault)",
        ),
        ("contact-exit", "SystemExit: 5"),
        pytest.param(
            "contact-hard-exit",
            "the engine ended its process with exit code 6",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "contact-hang",
            "the engine did not finish within the time limit of 10 s and was stopped",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_an_engine_that_dies_costs_one_check(installed, name, cause):
    installed(name)
    # Only what hangs needs the clock; on a busy machine others may take as long to start.
    rows, result = checked(
        name, *(("--timeout", "10s") if name == "contact-hang" else ("--isolate",))
    )
    assert [(row["check"], row["status"]) for row in rows] == list(
        zip(ONLY, ("pass", "error", "pass"), strict=True)
    )
    assert str(rows[1]["diagnosis"]).startswith(cause)
    assert result.exit_code == 1
    assert "2 pass, 0 fail, 1 error, 0 declined of 3" in result.stderr


@pytest.mark.slow
def test_a_memory_limit_costs_one_check(installed):
    installed("contact-greedy")
    rows, _ = checked("contact-greedy", "--timeout", "60s", "--memory", "0.8GB")
    assert [row["status"] for row in rows] == ["pass", "error", "pass"]
    assert "MemoryError" in rows[1]["diagnosis"]


def test_checks_measure_the_same_bits_in_another_process():
    here = [row["measured"] for row in checked("mujoco")[0]]
    there = [row["measured"] for row in checked("mujoco", "--isolate")[0]]
    assert here == there


def test_an_engine_that_cannot_be_imported_is_an_error(installed):
    installed("at-import")
    rows, result = checked("at-import")
    assert (rows, result.exit_code) == ([], 2)
    assert "SystemExit: 3" in result.stderr


def test_an_engine_that_does_not_exist_is_an_error():
    with Worker() as worker, pytest.raises(GaugeError, match="unknown backend"):
        run_checks("nothing", only=ONLY, worker=worker)


def test_settings_that_json_does_not_have_are_a_finding(installed):
    installed("no-json")
    rows, _ = checked("no-json")
    assert {row["status"] for row in rows} == {Status.ERROR}
    assert "setting 'pool' is a set" in rows[0]["diagnosis"]


def test_a_limit_must_be_positive():
    for option in ("--timeout", "--memory"):
        rows, result = checked("mujoco", option, "0")
        assert (rows, result.exit_code) == ([], 2)
        assert "expected a positive number" in result.stderr
