"""Outputs that cannot be written, and requests that cannot be met, are errors before anything runs."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gauge_envs.cli.output import Progress, echo

Gauge = Callable[..., Any]


@pytest.fixture
def no_check(monkeypatch):
    """Make every check an error of the test."""

    def fail(*_):
        raise AssertionError("a check ran")

    monkeypatch.setattr("gauge_envs.tools.conformance.matrix.run_column", fail)


@pytest.mark.usefixtures("no_check")
@pytest.mark.parametrize("suffix", [".json", ".html"])
def test_a_matrix_has_its_place_before_its_checks_run(gauge, suffix, tmp_path):
    folder, pipe, file = (
        tmp_path / f"a{suffix}",
        tmp_path / f"b{suffix}",
        tmp_path / "file",
    )
    folder.mkdir()
    os.mkfifo(pipe)
    file.touch()
    for place, reason in (
        (folder, "cannot be written: Is a directory"),
        (pipe, "cannot be written: it is not a regular file"),
        (file / f"matrix{suffix}", "cannot be written"),
    ):
        result = gauge(
            "backend", "check", "mujoco:*", "--only", "free-fall", "--out", place
        )
        assert result.exit_code == 2, result.output
        assert reason in result.stderr


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["sigmas=inf"], "sigmas are numbers above 0, at most 10"),
        (["sigmas=1e300"], "sigmas are numbers above 0, at most 10"),
        (["sigmas=nan"], "sigmas are numbers above 0, at most 10"),
        (["sigmas=1,1"], "two worlds have the name 'mujoco, "),
        (["--to", "mujoco:"], "two worlds have the name 'mujoco, "),
    ],
)
def test_worlds_of_a_transfer_are_checked_before_they_run(gauge, options, reason):
    common = [
        "numpy:mean",
        "--trust",
        "--id",
        "Pendulum-Limit-metal",
        "--to",
        "mujoco",
        "starts=1",
    ]
    result = gauge("transfer", *common, *options)
    assert result.exit_code == 2 and reason in result.stderr, result.output


def test_a_name_of_a_file_reaches_the_terminal_as_text(
    capsys,
):
    for text in (Path("a\x1b[2J") / os.fsdecode(b"\xff"), "two\nlines\tä"):
        echo(text)
    assert capsys.readouterr().out == "a\\x1b[2J/\\udcff\ntwo\nlines\tä\n"


@pytest.mark.parametrize("fraction", ["inf", "nan", "-1"])
def test_a_law_uses_a_finite_share_of_its_limit(gauge, fraction):
    result = gauge(
        "transfer",
        "envelope",
        "Pendulum-Limit-metal",
        "samples=2",
        "--policy",
        f"law:fraction={fraction}",
    )
    assert result.exit_code == 2 and isinstance(result.exception, SystemExit)


def test_the_time_left_is_told_without_the_step_that_loads_the_engine(
    monkeypatch, capsys
):
    seconds = iter(
        [0.0, 60.0, 72.0]
    )  # the start, and the ends of two steps of 12 s, of which the first also loads
    progress = Progress("checks", 12, line_interval_s=1.0)
    monkeypatch.setattr("gauge_envs.cli.output.time.monotonic", lambda: next(seconds))
    progress._start_s = progress._line_s = next(seconds)
    progress.advance("first")
    progress.advance("second")
    assert capsys.readouterr().err.splitlines() == [
        "1/12 first",
        "2/12 second, about 2.0 min left",
    ]
