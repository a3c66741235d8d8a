"""The registry: what folders and packages declare is what the command line shows."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gauge_envs import registry
from gauge_envs.cli.app import app
from gauge_envs.errors import RegistryError

COMMAND = '''
"""Drift of resting bodies."""

from gauge_envs.cli.output import echo


def drift(cm: int = 0) -> None:
    """Report how far a resting body drifts."""
    echo(f"drift {cm}")


def list_drifts(patterns: list[str]) -> list[str]:
    return []
'''
DECLARATION = """
position = 5
listings = ["drifts"]

[commands]
drift = "Report how far a resting body drifts."

[scene_files]
module = "layers"
suffixes = [".drift"]
"""


@pytest.fixture
def foreign(tmp_path, monkeypatch):
    """A package of another author, found by its entry point."""
    folder = tmp_path / "drift_tools"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "command.py").write_text(COMMAND)
    (folder / "layers.py").write_text("read_scene = read_points = write_scene = None\n")
    (folder / "instrument.toml").write_text(DECLARATION)
    point = EntryPoint("drift", "drift_tools", registry.INSTRUMENTS_GROUP)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(
        registry, "entry_points", lambda group: [point] if group == point.group else []
    )
    clear()
    yield folder
    monkeypatch.undo()
    sys.modules.pop("drift_tools", None)
    clear()


def clear():
    registry.instruments.cache_clear()
    registry.command_lines.cache_clear()


def test_each_folder_with_a_declaration_is_an_instrument():
    folder = Path(registry.__file__).parent / "tools"
    declared = {file.parent.name for file in folder.glob("*/instrument.toml")}
    assert declared == {one.name for one in registry.bundled_instruments()}
    assert declared >= {
        one.name for one in folder.iterdir() if (one / "command.py").is_file()
    }


def test_a_foreign_instrument_has_its_commands_listings_and_scene_files(
    foreign,
):
    shown = CliRunner(env={"COLUMNS": "200"}).invoke(app, ["--help"]).stdout
    # Those of this package come first, whatever position another one asks for.
    assert shown.index(" list ") < shown.index(" drift ")
    assert CliRunner().invoke(app, ["drift", "--cm", "3"]).stdout == "drift 3\n"
    assert (
        registry.instruments_by("listings")["drifts"].function("list drifts")([]) == []
    )
    assert registry.scene_files(".drift").__name__ == "drift_tools.layers"


def test_a_foreign_instrument_cannot_take_a_command_of_this_package(
    foreign,
):
    text = DECLARATION.replace("drift =", "list =")
    (foreign / "instrument.toml").write_text(text)
    assert registry.instruments_by("commands")["list"].name == "catalog"


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("position = 5", "", "position"),
        ("listings", "listing", "'listing'"),
        ("position = 5", "position = [", "instrument.toml"),
        ('module = "layers"', "", "module"),
    ],
)
def test_a_wrong_declaration_is_an_error_that_names_the_file(foreign, old, new, place):
    (foreign / "instrument.toml").write_text(DECLARATION.replace(old, new))
    with pytest.raises(RegistryError, match="instrument 'drift'") as caught:
        registry.instruments()
    assert place in str(caught.value) and str(foreign) in str(caught.value)


def test_a_scene_file_that_nobody_reads_is_an_error_with_the_known_suffixes():
    with pytest.raises(RegistryError, match=r"'\.fbx'; known: .*\.usda"):
        registry.scene_files(".fbx")
