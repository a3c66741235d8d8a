"""Outputs that cannot be written, and requests that cannot be met, are errors before anything runs."""

import pytest

from gauge_envs.cli.output import Progress


@pytest.fixture
def no_check(monkeypatch):
    """Make every check an error of the test."""

    def fail(*_):
        raise AssertionError("a check ran")

    monkeypatch.setattr("gauge_envs.tools.conformance.results.run_column", fail)


@pytest.mark.usefixtures("no_check")
@pytest.mark.parametrize("suffix", [".json", ".html"])
def test_a_matrix_has_its_place_before_its_checks_run(gauge, suffix, tmp_path):
    folder, file = tmp_path / f"a{suffix}", tmp_path / "file"
    folder.mkdir()
    file.touch()
    for place, reason in (
        (folder, "cannot be written: Is a directory"),
        (file / f"matrix{suffix}", "cannot be written"),
    ):
        result = gauge(
            "backend", "check", "mujoco:*", "--only", "free-fall", "--out", place
        )
        assert result.exit_code == 2, result.output
        assert reason in result.stderr


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
