"""The command line as a whole: its size, its help, and what it answers to old and wrong spellings."""

from __future__ import annotations

import inspect
import subprocess
import sys
from typing import Any

import pytest
from places import ROOT
from rich.text import Text
from typer.main import get_command
from typer.testing import CliRunner

from gauge_envs.cli.app import app, load_command
from gauge_envs.cli.arguments import (
    parsed_jitter,
    parsed_limits,
    parsed_use,
    split_details,
)
from gauge_envs.errors import GaugeError, ParameterError, UnknownNameError
from gauge_envs.references.user_data import DataSource
from gauge_envs.registry import command_lines, instruments_by

MOST_ENTRIES = 16
MOST_OPTIONS = 130
MOST_HELP_COST = 8.0
"""CPU time of `gauge --help` over that of `import typer`."""

NAMES = list(instruments_by("commands"))
ROOT_COMMAND: Any = get_command(app)


def gauge(*arguments: str) -> Any:
    return CliRunner(env={"COLUMNS": "200"}).invoke(app, list(arguments))


def options(command: Any) -> list[str]:
    """The options of a command; with `--format` goes `--json`, which is short for one of its values."""
    found = [
        max(one.opts, key=len)
        for one in command.params
        if one.param_type_name == "option"
    ]
    return [option for option in found if option != "--help"] + (
        ["--json"] if "--format" in found else []
    )


# --- its size ---


def test_a_person_can_hold_it() -> None:
    assert len(ROOT_COMMAND.list_commands(None)) <= MOST_ENTRIES
    counted = {name: options(load_command(name)) for name in NAMES} | {
        "": options(ROOT_COMMAND)
    }
    assert sum(map(len, counted.values())) <= MOST_OPTIONS, counted


def test_every_result_is_printed_in_all_formats() -> None:
    silent = {name for name in NAMES if "--format" not in options(load_command(name))}
    writers = {
        "plot",
        "report",
        "sanity probe",
        "data download",
        "data scenes",
        "data isaac-sim",
    }
    assert silent == writers | {
        name for name in NAMES if name.startswith("video") and name != "video score"
    }


def test_json_is_short_for_a_format() -> None:
    assert (
        gauge("list", "SlopeSlider-2-wood", "--json").stdout
        == gauge("list", "SlopeSlider-2-wood", "--format", "json").stdout
    )
    both = gauge("list", "--json", "--format", "wide")
    assert (
        both.exit_code == 2
        and "--json is --format json: give one of them" in both.stderr
    )


# --- its help ---


@pytest.mark.parametrize("name", NAMES)
def test_the_line_in_the_table_is_that_of_the_function(name: str) -> None:
    """The help of a group shows it without an import of the instrument."""
    text = inspect.cleandoc(instruments_by("commands")[name].function(name).__doc__)
    assert text.partition("\n\n")[0].replace("\n", " ") == command_lines()[name]


@pytest.mark.parametrize(
    ("kinds", "verb"), [("listings", "list"), ("pictures", "draw")]
)
def test_every_kind_has_its_function(kinds: str, verb: str) -> None:
    assert all(
        callable(instrument.function(f"{verb} {kind}"))
        for kind, instrument in instruments_by(kinds).items()
    )


def test_the_help_names_all_commands() -> None:
    shown = gauge("--help").stdout
    assert all(name in shown for name in command_lines() if " " not in name)
    for name in command_lines():
        entry, _, below = name.partition(" ")
        assert not below or below in gauge(entry, "--help").stdout


def test_help_loses_no_text() -> None:
    """The help is Rich markup, in which `[mm]` is a tag and is not shown."""
    texts = {
        text
        for name in NAMES
        for text in (
            load_command(name).help,
            *(one.help for one in load_command(name).params),
        )
    }
    shown = {text: Text.from_markup(text).plain for text in texts if text}
    assert len(shown) > 90
    assert {text: plain for text, plain in shown.items() if text != plain} == {}


COUNTED = """
import atexit, sys
count = 0


def counted(*_):
    global count
    count += 1


def end():
    sys.setprofile(None)
    print(f"\\n{count}", file=sys.stderr)


atexit.register(end)
sys.setprofile(counted)
"""
"""Start of a program whose calls and returns of functions are counted: they cost the same on every machine."""


def calls(code: str) -> int:
    """Return how many calls and returns a new process that runs code has."""
    done = subprocess.run(
        [sys.executable, "-c", COUNTED + code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    return int(done.stderr.splitlines()[-1])


def test_the_help_and_a_typo_are_quick() -> None:
    least = calls("import typer")
    for word in ("--help", "lits"):
        command = (
            f"sys.argv = ['gauge', {word!r}]; from gauge_command import main; main()"
        )
        assert calls(command) < MOST_HELP_COST * least


def test_the_help_loads_no_tool() -> None:
    code = (
        "import atexit, sys; sys.argv = ['gauge', '--help']; from gauge_command import main\n"
        "heavy = ('gauge_envs.tools.run', 'scipy', 'pydantic', 'mujoco', 'matplotlib', 'rich.progress')\n"
        "atexit.register(lambda: print([one for one in sys.modules if one.startswith(heavy)], file=sys.stderr))\n"
        "main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == "[]\n"


def test_the_version_is_shown() -> None:
    assert gauge("--version").stdout.startswith("gauge-envs 0.")


# --- wrong spellings ---


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("run --seed", "run seed="),
        ("run --jitter-mm", "run jitter="),
        ("run --marker-proxy", "run marker_proxy="),
        ("sweep --variant", "sweep variants="),
        ("sweep --backend", "sweep backends="),
        ("compare --metric", "compare metric="),
        ("diagnose --measured-only", "diagnose measured_only="),
        ("recipe --mass", "recipe mass_kg="),
        ("recipe --damping", "recipe damping_n_s_per_m="),
        ("transfer --sigmas", "transfer sigmas="),
        ("video film --recording-rate-hz", "video film recording_rate_hz="),
        ("video film --fps", "video film fps="),
        ("video render --seconds", "video render seconds="),
        ("video score --size", "video score size="),
    ],
)
def test_an_option_that_is_a_detail_now_is_answered(old: str, new: str) -> None:
    result = gauge(*old.split(), "1")
    assert result.exit_code == 2
    assert result.stderr == f"error: `gauge {old}` is `gauge {new}...`\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["lits"], "unknown command 'lits'; did you mean list"),
        (
            ["backend", "chek"],
            "unknown command 'backend chek'; did you mean backend check",
        ),
        (["list", "phenomna"], "unknown experiment 'phenomna'"),
        (
            ["list", "phenomena", "slde-wood"],
            "unknown phenomenon 'slde-wood'; did you mean slide-wood",
        ),
        (
            ["list", "backends", "mujoko"],
            "unknown backend 'mujoko'; did you mean mujoco",
        ),
        (["list", "materials", "satn"], "unknown material 'satn'; did you mean satin"),
        (
            ["run", "SlopeSlider-2-wood", "sed=3"],
            "unknown detail 'sed'; did you mean seed",
        ),
        (
            ["run", "SlopeSlider-2-wood", "timestep_s=1"],
            "other values have options: --help",
        ),
        (["run", "SlopeSlider-2-wood", "seed=x"], "seed: "),
        (["run", "SlopeSlider-2-wood", "repeats=0"], "repeats: "),
        (
            ["run", "SlopeSlider-2-wood", "jitter=1"],
            "jitter '1': expected numbers with units, as 1mm,0.5deg",
        ),
        (
            ["run", "SlopeSlider-2-wood", "--use", "import"],
            "unknown word of --use 'import'; did you mean imported",
        ),
        (
            ["run", "SlopeSlider-2-wood", "--limits", "60"],
            "--limits '60': expected numbers with units, as 3600s,4GB",
        ),
        (
            ["run", "SlopeSlider-2-wood", "--set", "iteration=3"],
            "unknown setting; did you mean iterations",
        ),
        (
            ["run", "SlopeSlider-2-wood", "--set", "preset=dampped"],
            "unknown MuJoCo preset 'dampped'",
        ),
        (
            ["run", "SlopeSlider-2-wood", "--parameters", "cube.frction=1"],
            "no constant 'frction'; did you mean friction",
        ),
        (
            ["run", "SlopeSlider-2-wood", "--parameters", "cbe.friction=1"],
            "names no body of the scene",
        ),
        (
            ["plot", "--kind", "costs"],
            "unknown kind of picture 'costs'; did you mean cost",
        ),
        (
            ["plot", "--id", "SlopeSlider-2-wood"],
            "--id and --use go with --kind diagnose",
        ),
        (["sanity"], "no target is given: name one"),
        (
            ["sanity", "HalfCheetah-v5", "--limits", "4GB"],
            "expected a time alone, as 60s",
        ),
        (
            ["sanity", "HalfCheetah-v5", "--out", "page.pdf"],
            "expected a suffix of .html, .md, .json",
        ),
        (
            ["sanity", "HalfCheetah-v5", "--out", "a.md", "--out", "b.md"],
            "a.md has the same suffix",
        ),
        (
            ["recipe", "friktion=0.3"],
            "unknown detail 'friktion'; did you mean friction",
        ),
        (
            ["recipe", "satin", "wood-on-wood"],
            "expected one pair of materials or one fabric",
        ),
        (["transfer", "envelope"], "ID [NAME=VALUE]"),
        (["diagnose", "measured_only=maybe"], "measured_only: "),
    ],
)
def test_a_wrong_spelling_is_answered_by_the_nearest(
    arguments: list[str], message: str, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = gauge(*arguments)
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())


# --- texts of options ---


def test_limits_are_a_time_a_memory_and_a_process() -> None:
    assert parsed_limits("") == (False, None, None)
    assert parsed_limits("isolate") == (True, None, None)
    assert parsed_limits("90.5s") == (True, 90.5, None)
    assert parsed_limits(".5s,5e-1GB") == (True, 0.5, 0.5)
    assert parsed_limits("4GB, 1e3s") == (True, 1000.0, 4.0)
    for text in ("9" * 100_000, "s", "-1s", "nans", "1s4GB", "1h", "3600"):
        with pytest.raises(ParameterError, match="expected numbers with units"):
            parsed_limits(text)


def test_a_jitter_has_the_names_of_the_api() -> None:
    assert parsed_jitter("1mm") == {"position_m": 1e-3}
    assert parsed_jitter("0.5deg,2mm").keys() == {"position_m", "angle_rad"}


def test_data_of_a_command_are_those_that_it_can_use() -> None:
    assert parsed_use("", "reference", "use_withheld") == {
        "reference": DataSource.BUNDLED,
        "use_withheld": False,
    }
    assert parsed_use("imported,withheld", "reference", "use_withheld") == {
        "reference": DataSource.IMPORTED,
        "use_withheld": True,
    }
    with pytest.raises(UnknownNameError, match="imported-drivers"):
        parsed_use("imported-drivers", "use_withheld")


def test_a_file_may_look_like_a_detail() -> None:
    assert split_details(["results", "seed=3", "./seed=4"], seed=int) == (
        ["results", "./seed=4"],
        {"seed": 3},
    )
    with pytest.raises(GaugeError):
        split_details(["seed="], seed=int)
