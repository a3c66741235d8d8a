"""Commands are entry points: of this package, each with its details, and of another package."""

import sys
import tomllib
from importlib.metadata import EntryPoint, entry_points

import pytest
from places import ROOT
from typer.testing import CliRunner

from gauge_envs import registry
from gauge_envs.cli.app import app
from gauge_envs.cli.commands import (
    BUNDLED_COMMANDS,
    COMMANDS_GROUP,
    LINES_GROUP,
    all_commands,
    commands,
)

COMMAND = '''
from gauge_envs.cli.output import echo


def drift(cm: int = 0) -> None:
    """Report how far a resting body drifts."""
    echo(f"drift {cm}")
'''


@pytest.fixture
def plugins(tmp_path, monkeypatch):
    """Install two entry points of another package; one has the name of a bundled command."""
    (tmp_path / "drift_tools.py").write_text(COMMAND)
    points = [
        EntryPoint(name, "drift_tools:drift", COMMANDS_GROUP)
        for name in ("drift", "list")
    ]
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(
        registry, "entry_points", lambda group: [*entry_points(group=group), *points]
    )
    all_commands.cache_clear()
    yield
    all_commands.cache_clear()
    sys.modules.pop("drift_tools", None)


def test_a_plug_in_adds_its_command_after_the_bundled_ones(plugins):
    shown = CliRunner(env={"COLUMNS": "200"}).invoke(app, ["--help"]).stdout
    assert shown.index(" list ") < shown.index(" drift ")
    assert CliRunner().invoke(app, ["drift", "--cm", "3"]).stdout == "drift 3\n"


def test_a_plug_in_cannot_replace_a_bundled_command(plugins):
    assert commands()["list"].point.module == "gauge_envs.tools.catalog.command"


def test_each_command_of_the_package_has_an_entry_point_and_details():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = project["entry-points"]
    assert declared[COMMANDS_GROUP].keys() == BUNDLED_COMMANDS.keys()
    assert declared[LINES_GROUP].keys() <= BUNDLED_COMMANDS.keys() | {"result-file"}
    installed = {
        point.name: point.value for point in entry_points(group=COMMANDS_GROUP)
    }
    assert declared[COMMANDS_GROUP].items() <= installed.items(), (
        "pip install -e . again"
    )
