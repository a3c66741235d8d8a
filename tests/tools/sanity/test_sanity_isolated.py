"""An engine of another package that crashes in a sanity check costs a phenomenon. Results keep their bits."""

import json

import pytest
from typer.testing import CliRunner

from gauge_envs.cli.app import app


def checked(target, *only):
    """Rows and outcome of the command."""
    options = [part for one in only for part in ("--only", one)]
    result = CliRunner().invoke(app, ["sanity", target, "--json", *options])
    return [json.loads(line) for line in result.stdout.splitlines()][1:], result


def test_an_engine_that_dies_costs_one_phenomenon(installed):
    installed("fall-crash", "supports-crash")
    (slide, rebound), result = checked("fall-crash", "creep-wood", "rebound")
    assert (slide["verdict"], rebound["verdict"], result.exit_code) == (
        "inside",
        "wrong",
        1,
    )
    assert (
        rebound["remark"]
        == "the engine's process died with signal 11 (segmentation fault)"
    )
    (row,), result = checked("supports-crash", "creep-wood")
    assert (row["verdict"], result.exit_code) == ("wrong", 1)
    assert "segmentation fault" in row["remark"]


@pytest.mark.slow
def test_an_engine_that_cannot_start_is_one_line(installed):
    installed("at-import", "contact-crash")
    for name, cause in (
        ("at-import", "SystemExit: 3"),
        ("contact-crash", "segmentation fault"),
    ):
        rows, result = checked(name, "creep-wood")
        assert (rows, result.exit_code) == ([], 2)
        assert cause in result.stderr and result.stderr.startswith("error: ")
