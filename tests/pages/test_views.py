"""Tables of the command line at 80 columns: no text is cut or too long."""

from dataclasses import replace

import pytest
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import result_file_name, write_result

UNLIMITED = 1000


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the results of two experiments on MuJoCo, and the same under the name of another engine."""
    folder = tmp_path_factory.mktemp("views")
    (folder / "results").mkdir()
    for name in ("SlopeSlider-2-wood", "BouncingBall-rubber"):
        result = run_episode(RunRequest(name))
        renamed = replace(result, backend="newton", versions={"newton": "1.0"})
        for version in (result, renamed):
            write_result(version, folder / "results" / result_file_name(version))
    return folder


def words(text):
    return {word.strip(";:") for word in text.split()}


COMMANDS = (
    ("list",),
    ("show", "SlopeSlider-3-metal"),
    ("show", "FoamTwisting-hard"),
    ("recipe", "fabrics"),
    ("list", "materials"),
    ("list", "backends"),
    ("backend", "check", "mujoco", "--only", "pucks*,roll*"),
    ("run", "SlopeSlider-2-wood", "--out", "new"),
    ("compare",),
    ("compare", "--format", "wide"),
)


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_a_table_fits_the_terminal_and_breaks_no_word(folder, monkeypatch, command):
    monkeypatch.chdir(folder)

    def printed(width):
        result = CliRunner(env={"COLUMNS": str(width)}).invoke(app, list(command))
        assert result.exit_code == 0, result.output
        return result.stdout

    text = printed(80)
    assert max(map(len, text.splitlines())) <= 80
    # An id or a number that is cut or broken is another word.
    assert words(printed(UNLIMITED)) <= words(text)
