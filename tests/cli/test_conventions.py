"""The conventions of docs/commands.md, read off the parameters of every command, and spellings that users type."""

import os
import re
import shlex

import pytest
from places import ROOT
from programs import run_python

from gauge_envs.cli.app import load_command, read_values
from gauge_envs.cli.arguments import (
    ASSIGNED,
    PANELS,
    parsed_jitter,
    parsed_parameters,
    parsed_settings,
    parsed_use,
    split_values,
)
from gauge_envs.cli.commands import commands, help_lines
from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.references.user_data import DataSource

NAMES = list(commands())

SHORT = {
    "--backend": "-b",
    "--out": "-o",
    "--seed": "-s",
    "--parameter": "-p",
    "--jobs": "-j",
    "--quiet": "-q",
}

OPEN_SETS = {"--set", "--parameter"}

UNITS = {"kg_m2", "n_per_m", "n_s_per_m", "m_s", "kg", "mm", "deg", "hz", "s", "m"}
"""Ends of the names of quantities in Python."""

TABLE = (ROOT / "tests/cli/spellings.txt").read_text()


def longest(option):
    """The long name of an option."""
    return max(option.opts, key=len)


def options(name):
    return [one for one in load_command(name).params if one.param_type_name == "option"]


ALL = [(name, one) for name in NAMES for one in options(name)]

IDS = [f"{name} {longest(one)}" for name, one in ALL]


# --- conventions ---


def test_there_are_at_most_13_commands_at_the_top():
    assert len({name for name in help_lines() if " " not in name}) <= 13


@pytest.mark.parametrize("name", NAMES)
def test_no_argument_is_a_word_name_value(name):
    for one in load_command(name).params:
        assert one.param_type_name == "option" or "=" not in (one.metavar or "")
    assert "Details:" not in (load_command(name).help or "")


@pytest.mark.parametrize(("name", "one"), ALL, ids=IDS)
def test_an_option_has_a_panel_a_line_of_help_and_its_short_name(name, one):
    option = longest(one)
    assert one.rich_help_panel in PANELS
    assert one.help
    assert re.fullmatch("--[a-z][a-z-]*[a-z]", option)
    assert [other for other in one.opts if not other.startswith("--")] == (
        [SHORT[option]] if option in SHORT else []
    )
    assert "by default" not in one.help
    assert "repeatable" not in one.help


@pytest.mark.parametrize(("name", "one"), ALL, ids=IDS)
def test_a_quantity_shows_its_unit(name, one):
    longest_first = sorted(UNITS, key=len, reverse=True)
    unit = next(
        (end for end in longest_first if str(one.name).endswith(f"_{end}")), None
    )
    if unit is not None:
        shown = (one.metavar or "").lower().replace(" ", "_").replace("/", "_per_")
        assert shown in (unit, unit.replace("m_s", "m_per_s"))


@pytest.mark.parametrize(("name", "one"), ALL, ids=IDS)
def test_only_open_sets_take_name_value(name, one):
    assert ((one.metavar or "") == ASSIGNED) == (longest(one) in OPEN_SETS)


def test_one_word_is_one_thing():
    """An option has the same name, unit and kind in every command that has it."""
    kinds = {}
    for _, one in ALL:
        shown = {"FILE": "PATH", "DIR": "PATH"}.get(str(one.metavar), one.metavar)
        kinds.setdefault(longest(one), set()).add((shown, one.is_flag))
    differing = {
        option: found
        for option, found in kinds.items()
        # A file is one of another kind in each command; a quantity's parser is a function of its own.
        if option not in ("--out", "--backend", "--format", "--parameter")
        and len(found) > 1
    }
    assert differing == {}


LISTS = [(name, one) for name, one in ALL if one.multiple]


@pytest.mark.parametrize(
    ("name", "one"), LISTS, ids=[f"{name} {longest(one)}" for name, one in LISTS]
)
def test_a_list_has_commas_or_repeats(name, one):
    first, second = ("a=1", "b=2") if one.metavar == ASSIGNED else ("3", "4")
    command = load_command(name)
    for values in ((f"{first},{second}",), (first, second)):
        read = read_values(command, {one.name: values})
        assert read[one.name] == [first, second]


# --- values ---


def test_values_of_a_list_are_apart():
    assert split_values("a=1,2,b=[3,4]", ASSIGNED) == ["a=1,2", "b=[3,4]"]
    assert split_values("newton:dt=1,n=2,rapier", "ENGINE[:NAME=VALUE,...]") == [
        "newton:dt=1,n=2",
        "rapier",
    ]
    assert split_values("calibrated,effective", ASSIGNED) == ["calibrated", "effective"]


def test_a_fraction_is_a_number():
    assert parsed_settings(["timestep_s=1/1800", "preset=a/b"]) == {
        "timestep_s": 1 / 1800,
        "preset": "a/b",
    }
    with pytest.raises(ParameterError, match="timestep_s is given twice"):
        parsed_settings(["timestep_s=1", "timestep_s=2"])


def test_what_a_jitter_does_not_state_is_zero():
    def scatter(text):
        found = parsed_jitter(split_values(text))
        return found.position_m, found.angle_rad

    assert parsed_jitter(None) is None
    assert scatter("1mm") == (1e-3, 0.0)
    assert scatter("0mm") == scatter("off") == (0.0, 0.0)
    assert (
        scatter("0.5deg, 2mm")
        == scatter("2mm,0.5deg")
        == (2e-3, 0.5 * 0.017453292519943295)
    )
    assert scatter("real") == (1e-3, 0.5 * 0.017453292519943295)


def test_data_of_a_command_are_those_that_it_can_use():
    assert parsed_use(None, "reference") == {"reference": DataSource.BUNDLED}
    assert parsed_use(["imported"], "reference") == {"reference": DataSource.IMPORTED}
    with pytest.raises(UnknownNameError, match="imported-reference"):
        parsed_use(["imported-drivers"], "reference")


def test_numbers_with_commas_are_a_vector():
    found = parsed_parameters(["cube.position_m=0.1, -.4,0.36"])
    assert found == {"cube.position_m": [0.1, -0.4, 0.36]}


# --- spellings ---


SPELLINGS = [
    line.rpartition(" -> ")[::2]
    for line in TABLE.splitlines()
    if not line.startswith("#")
]


def values_of(command, words, option):
    """Return what a command would receive for an option, with a comma between the values of a list."""
    context = command.make_context("gauge", list(words))
    (one,) = (
        one
        for one in command.params
        if one.param_type_name == "option"
        and longest(one) == f"--{option.replace('_', '-')}"
    )
    value = read_values(command, context.params)[one.name]
    values = value if isinstance(value, list | tuple) else [value]
    return ",".join(
        f"{one:g}" if isinstance(one, float) else str(one) for one in values
    )


@pytest.mark.parametrize(("command", "expected"), SPELLINGS, ids=lambda text: text)
def test_a_spelling_is_accepted_or_answered(gauge, tmp_path, command, expected):
    (tmp_path / "empty_folder").mkdir()
    (tmp_path / "my.csv").write_text("1\n")
    _, *words = shlex.split(command)
    if expected[:2] in ("! ", "+ "):
        result = gauge(*words)
        assert result.exit_code == (2 if expected[0] == "!" else 0), result.output
        text = result.stderr if expected[0] == "!" else result.stdout
        # Typer breaks lines of its messages and draws a frame around them.
        plain = " ".join(re.sub("[│╭╮╰╯─]", " ", text).split()).lower()
        # Click quotes the option, Typer puts a colon before it.
        plain = re.sub(r"no such option '(\S+)'", r"no such option: \1", plain)
        assert expected[2:].lower() in plain
        return
    name = max((one for one in NAMES if " ".join(words).startswith(one)), key=len)
    option, _, value = expected.partition("=")
    found = values_of(load_command(name), words[len(name.split()) :], option)
    assert found == value


PROGRAM = "import sys; sys.argv = ['gauge']; from gauge_command import main; main()"


def test_a_shell_completes_options_and_ids():
    def completed(words):
        done = run_python(
            *("-c", PROGRAM),
            cwd=ROOT,
            env=os.environ
            | {
                "_GAUGE_COMPLETE": "complete_bash",
                "COMP_WORDS": words,
                "COMP_CWORD": str(len(words.split()) - 1),
            },
        )
        return done.stdout.split()

    assert "--repeats" in completed("gauge run --re")
    assert "SlopeSlider-2-wood" in completed("gauge run SlopeSlider-2-w")
    assert "compare" in completed("gauge com")
