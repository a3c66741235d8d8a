"""Every table of the command line at 80 and 120 columns: nothing is cut, nothing is too long."""

from dataclasses import replace

import pytest
from rich.console import Console
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.experiments.variants import find_variant
from gauge_envs.pages.terminal import Terminal
from gauge_envs.references.imported import SpreadRecord
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import result_file_name, write_result
from gauge_envs.tools import sanity
from gauge_envs.tools.dataset.importer import ImportedTrials, baseline_lines
from gauge_envs.tools.dataset.report import import_document

IDS = (
    "SlopeSlider-2-wood",
    "SlopeSlider-2-plastic",
    "SlopeSlider-2-metal",
    "BouncingBall-rubber",
)
UNLIMITED = 1000
SANITY_ROWS = (
    "foot-slide",
    "slide*",
    "rebound*",
    "creep-*",
    "rest-height",
    "momentum",
    "seam",
)


@pytest.fixture(scope="module")
def results():
    """Results of four experiments on MuJoCo, and the same under another engine's name."""
    ours = [run_episode(RunRequest(name)) for name in IDS]
    return [
        *ours,
        *(
            replace(result, backend="newton", versions={"newton": "1.0"})
            for result in ours
        ),
    ]


@pytest.fixture(scope="module")
def report():
    """The sanity check of HalfCheetah-v5, with some of its phenomena."""
    return sanity.check(sanity.configuration("HalfCheetah-v5"), only=SANITY_ROWS)


@pytest.fixture
def gauge(tmp_path, monkeypatch, results, report):
    """Prints the output of a command at a width; the folder holds the results."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sanity, "check", lambda *_, **__: report)
    (tmp_path / "results").mkdir()
    for result in results:
        write_result(result, tmp_path / "results" / result_file_name(result))

    def run(width, *arguments):
        outcome = CliRunner(env={"COLUMNS": str(width)}).invoke(app, list(arguments))
        # The robot has flags.
        assert outcome.exit_code == (arguments[0] == "sanity"), outcome.output
        return outcome.stdout

    return run


@pytest.fixture(scope="module")
def unlimited():
    """Words of commands at a width that has room for everything."""
    return {}


def words_of(gauge, unlimited, *command):
    if command not in unlimited:
        unlimited[command] = words(gauge(UNLIMITED, *command))
    return unlimited[command]


def words(text):
    return {word.strip(";:") for word in text.split()}


COMMANDS = (
    ("list",),
    ("show", "SlopeSlider-3-metal"),
    ("show", "FoamTwisting-hard"),
    ("recipe", "fabrics"),
    ("list", "materials"),
    ("list", "backends"),
    ("backend", "check", "mujoco", "--only", "slide*"),
    ("list", "scenes"),
    ("list", "references"),
    ("run", IDS[0], "--out", "new"),
    ("compare",),
    ("sanity", "HalfCheetah-v5"),
)


@pytest.mark.parametrize("width", [80, pytest.param(120, marks=pytest.mark.slow)])
@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_a_table_fits_the_terminal_and_breaks_no_word(gauge, unlimited, command, width):
    text = gauge(width, *command)
    assert max(map(len, text.splitlines())) <= width
    # An id or a number that is cut or broken is another word.
    assert words_of(gauge, unlimited, *command) <= words(text)


WIDE = tuple(
    command
    for command in COMMANDS
    if command[0] != "show" and command[1:] not in (("backends",), ("scenes",))
)


@pytest.mark.parametrize("command", WIDE, ids=" ".join)
def test_wide_shows_all_columns_at_any_width(gauge, command):
    text = gauge(80, *command, "--format", "wide")
    assert max(map(len, text.splitlines())) <= 80
    assert words(gauge(UNLIMITED, *command, "--format", "wide")) <= words(text)


@pytest.mark.parametrize("width", [80, 120])
def test_an_import_fits_the_terminal(width):
    variant = find_variant("NonsmoothContact-1-plastic")
    published = published_baselines(variant.name)
    spread = SpreadRecord(unit="mm", mean=12.3456, std=4.5678, trial_count=20)
    one = ImportedTrials(
        variant=variant,
        facts=None,
        used=20,
        left_out=1,
        frame_count=11,
        baselines=baseline_lines(dict.fromkeys(published, spread), published),
        findings=(),
    )
    console = Console(width=width)
    with console.capture() as capture:
        console.print(Terminal(import_document([one])))
    text = capture.get()
    assert max(map(len, text.splitlines())) <= width
    assert {variant.name, "12.35", "RMSE"} <= words(text)
