"""The command line as a whole: its size, its help, and what it answers to old and wrong spellings."""

import inspect
from importlib.metadata import version

import pytest
from places import ROOT
from programs import run_python
from rich.text import Text

from gauge_envs.cli.app import load_command
from gauge_envs.cli.commands import commands, help_lines, listings

MOST_HELP_COST = 8.0
"""CPU time of `gauge --help` over that of `import typer`."""

NAMES = list(commands())


def options(command):
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


# --- its help ---


@pytest.mark.parametrize("name", NAMES)
def test_the_line_in_the_table_is_that_of_the_function(name):
    """The help of a group shows it without an import of the instrument."""
    text = inspect.cleandoc(commands()[name].function().__doc__)
    assert text.partition("\n\n")[0].replace("\n", " ") == help_lines()[name]


def test_every_listing_has_its_function():
    assert all(callable(listing.function()) for listing in listings().values())


def test_the_help_names_all_commands(gauge):
    shown = gauge("--help").stdout
    assert all(name in shown for name in help_lines() if " " not in name)
    for name in help_lines():
        entry, _, below = name.partition(" ")
        assert not below or below in gauge(entry, "--help").stdout


def test_help_loses_no_text():
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


def calls(code):
    """Return how many calls and returns a new process that runs code has."""
    done = run_python("-c", COUNTED + code, cwd=ROOT)
    return int(done.stderr.splitlines()[-1])


def test_the_help_and_a_typo_are_quick():
    least = calls("import typer")
    for word in ("--help", "lits"):
        command = (
            f"sys.argv = ['gauge', {word!r}]; from gauge_command import main; main()"
        )
        assert calls(command) < MOST_HELP_COST * least


def test_the_help_loads_no_tool():
    code = (
        "import atexit, sys; sys.argv = ['gauge', '--help']; from gauge_command import main\n"
        "heavy = ('gauge_envs.tools.run', 'scipy', 'pydantic', 'mujoco', 'matplotlib', 'rich.progress')\n"
        "atexit.register(lambda: print([one for one in sys.modules if one.startswith(heavy)], file=sys.stderr))\n"
        "main()"
    )
    done = run_python("-c", code, cwd=ROOT)
    assert done.returncode == 0
    assert done.stderr == "[]\n"


def test_the_version_is_shown(gauge):
    assert gauge("--version").stdout == f"gauge-envs {version('gauge-envs')}\n"
