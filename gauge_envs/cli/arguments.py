"""Options that commands share, and parsers of their values. docs/commands.md has the conventions."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli.output import Format
from gauge_envs.errors import ParameterError, UnknownNameError

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table

SCENE, NUMERICS, SELECTION, OUTPUT = "Scene", "Numerics", "Selection", "Output"
"""Panels of the help: scene, numerics, selection of results, and output."""

ASSIGNED = "NAME=VALUE"
"""Metavar of an option with arbitrary names."""

PER_ENGINE = f"ENGINE[:{ASSIGNED},...]"
"""Metavar of an option with engines and their settings."""

SIDE = "SIDE"
"""Metavar of the sides of a comparison; a side may be only settings, as `iterations=4`."""


def option(panel: str, text: str, *names: str, **more: Any) -> Any:
    """Return an option with its panel and help line; `more` are arguments of `typer.Option`."""
    return typer.Option(*names, rich_help_panel=panel, help=text, **more)


def measured(
    name: str,
    unit: str,
    text: str,
    panel: str,
    *,
    is_positive: bool = False,
    show_default: bool | str = True,
) -> Any:
    """Return the option of a quantity; the unit after its value is optional, as `2` or `2kg`.

    Args:
        name: Name of the option.
        unit: Unit of the quantity, in place of a type in the help; empty for a number without a unit.
        text: Help line.
        panel: Panel of the help.
        is_positive: Whether zero is rejected.
        show_default: Text for a default that is not a number.
    """

    def value(given: str | float) -> float:
        # Typer also reads the default.
        if isinstance(given, float):
            return given
        number = number_of(given.strip().removesuffix(unit).strip())
        if number is None:
            form = f" in {unit}, as 2 or 2{unit}" if unit else ", as 2"
            raise typer.BadParameter(f"{given!r}: expected a number{form}")
        if number < 0.0 or (is_positive and number == 0.0):
            wanted = "a positive number" if is_positive else "0 or more"
            raise typer.BadParameter(f"{given!r}: expected {wanted}")
        return number

    return option(
        panel,
        text,
        name,
        metavar=unit or "number",
        parser=value,
        show_default=show_default,
    )


def number_of(text: str) -> float | None:
    """Return the finite number in a text; None if it is not one."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _ids(incomplete: str) -> list[str]:
    """Return the ids that complete a word in the shell."""
    from gauge_envs.experiments.variants import beyond_variants, variants

    known = (*variants(), *beyond_variants())
    return [variant.name for variant in known if variant.name.startswith(incomplete)]


def _engines(incomplete: str) -> list[str]:
    """Return the engines that complete a word in the shell."""
    from gauge_envs.registry import engine_points

    return [
        point.name for point in engine_points() if point.name.startswith(incomplete)
    ]


Ids = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="ID",
        autocompletion=_ids,
        help="Ids, patterns as 'SlopeSlider-*', or task files.",
    ),
]

Sources = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="PATH",
        show_default="results",
        help="Result files, or folders that hold some.",
    ),
]


def experiment(text: str) -> Any:
    """Return the option `--id`."""
    return option(SCENE, text, "--id", metavar="ID")


# --- scene -----------------------------------------------------------------------------------------------------------

Parameters = Annotated[
    list[str] | None,
    option(
        SCENE,
        "Constant of the scene, as cube.friction=0.3; or the name of a set, as measured.",
        "--parameter",
        "-p",
        metavar=ASSIGNED,
        show_default="published",
    ),
]

Asset = Annotated[
    Path | None,
    option(
        SCENE,
        "Scene, in place of the task file: a USD layer, or MJCF for mujoco.",
        "--asset",
        metavar="FILE",
    ),
]

Use = Annotated[
    list[str] | None,
    option(
        SCENE,
        "Data beyond the bundled: imported-drivers, imported-reference, or imported for both.",
        "--use",
        metavar="DATA",
        show_default="bundled",
    ),
]

# --- numerics --------------------------------------------------------------------------------------------------------


def backend(
    text: str, panel: str = NUMERICS, *, show_default: bool | str = True
) -> Any:
    """Return the option `--backend`."""
    return option(
        panel,
        text,
        "--backend",
        "-b",
        metavar="ENGINE",
        autocompletion=_engines,
        show_default=show_default,
    )


Settings = Annotated[
    list[str] | None,
    option(
        NUMERICS,
        "Setting of the engine, as timestep_s=1/1800.",
        "--set",
        metavar=ASSIGNED,
        show_default="those of the engine",
    ),
]

Seed = Annotated[
    int,
    option(NUMERICS, "Seed of the first start.", "--seed", "-s", min=0),
]

Repeats = Annotated[
    int,
    option(
        NUMERICS,
        "Episodes, each with the next seed and its own initial-state noise.",
        "--repeats",
        min=1,
    ),
]


def timeout(text: str, show_default: str) -> Any:
    """Return the option `--timeout`; zero is rejected, because it would stop every run."""
    return measured(
        "--timeout",
        "s",
        text,
        NUMERICS,
        is_positive=True,
        show_default=show_default,
    )


Memory = Annotated[
    float | None,
    measured(
        "--memory",
        "GB",
        "Largest memory of an experiment, which then has a process of its own.",
        NUMERICS,
        is_positive=True,
        show_default="no limit",
    ),
]

Isolate = Annotated[
    bool,
    option(NUMERICS, "Give each experiment a process of its own.", "--isolate"),
]

# --- selection -------------------------------------------------------------------------------------------------------

Only = Annotated[
    list[str] | None,
    option(SELECTION, "Ids or patterns.", "--only", metavar="ID", show_default="all"),
]

Metrics = Annotated[
    list[str] | None,
    option(
        SELECTION,
        "Metrics, as rmse or dtw.",
        "--metric",
        metavar="METRIC",
        show_default="all",
    ),
]

Corrected = Annotated[
    bool,
    option(
        SELECTION,
        "Whether engines count whose physics this package corrects.",
        "--corrected/--no-corrected",
    ),
]

# --- output ----------------------------------------------------------------------------------------------------------

Form = Annotated[
    Format,
    option(
        OUTPUT,
        "Format on stdout; wide has all columns, latex and csv the tables, json a line a row.",
        "--format",
    ),
]


Details = Annotated[
    bool,
    option(
        OUTPUT,
        "Also all numbers of each score, and the published ones.",
        "--details",
    ),
]

STDOUT = "-"
"""Path that stands for stdout, in the metavar of an option that takes it."""


def target(text: str, *, metavar: str = "FILE", show_default: bool | str = True) -> Any:
    """Return the option `--out`: a folder or a file, or several files of different suffixes."""
    return option(
        OUTPUT, text, "--out", "-o", metavar=metavar, show_default=show_default
    )


def folder(text: str, *, show_default: bool | str = True) -> Any:
    """Return the option `--out` of a command that writes a folder."""
    return target(text, metavar="DIR", show_default=show_default)


USES = {
    "imported": ("drivers", "reference"),
    "imported-drivers": ("drivers",),
    "imported-reference": ("reference",),
}
"""Keyword arguments that each word of `--use` changes."""


# --- values ----------------------------------------------------------------------------------------------------------


def split_values(text: str, metavar: str = "") -> list[str]:
    """Return the values of a list, separated by commas outside brackets.

    Args:
        text: Values with commas. A value NAME=VALUE and settings after an engine may also have commas.
        metavar: Metavar of the option.
    """
    values: list[str] = []
    for part in map(str.strip, re.split(r",(?![^\[]*\])", text)):
        if metavar == PER_ENGINE:
            goes_on = "=" in part and ":" not in part
        else:
            goes_on = metavar == ASSIGNED and "=" not in part and "=" in text
        if goes_on and part and values:
            values[-1] += f",{part}"
        else:
            values.append(part)
    return values


def assigned(option: str, texts: Sequence[str]) -> dict[str, str]:
    """Return the values of `NAME=VALUE` by their names, each once.

    Args:
        option: Name of the option, for messages.
        texts: The texts.
    """
    values: dict[str, str] = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals and value):
            raise ParameterError(f"{option} {text!r}: expected {ASSIGNED}")
        if name in values:
            raise ParameterError(
                f"{option}: {name} is given twice, {values[name]} and {value}"
            )
        values[name] = value
    return values


def value_of(text: str) -> Any:
    """Return the value of JSON, of a fraction, or of numbers with commas; else the text itself."""
    fraction = [number_of(part) for part in text.split("/")]
    if len(fraction) == 2 and fraction[0] is not None and fraction[1]:
        return fraction[0] / fraction[1]
    numbers = [number_of(part.strip()) for part in text.split(",")]
    if len(numbers) > 1 and None not in numbers:
        return numbers
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def parsed_settings(changes: Sequence[str] | None) -> dict[str, Any] | None:
    """Return settings such as `timestep_s=1/1800` as a dictionary; None for no settings."""
    values = assigned("--set", changes or ())
    return {name: value_of(value) for name, value in values.items()} or None


def parsed_use(words: Sequence[str] | None, *names: str) -> dict[str, Any]:
    """Return the values of the keyword arguments `drivers` and `reference`, if the command has them.

    Args:
        words: Words of `--use`, as `imported`.
        names: The keyword arguments.
    """
    from gauge_envs.references.user_data import DataSource

    known = [word for word, changed in USES.items() if set(changed) & set(names)]
    used: set[str] = set()
    for word in words or ():
        if word not in known:
            raise UnknownNameError("word of --use", word, known)
        used.update(USES[word])
    return {
        name: DataSource.IMPORTED if name in used else DataSource.BUNDLED
        for name in names
    }


def matching(
    tables: Sequence[Table], patterns: Sequence[str], *, kind: str
) -> list[Table]:
    """Return tables with the rows whose first column matches a pattern; without patterns, all rows."""
    missing = set(patterns)
    names: list[str] = []
    kept: list[Table] = []
    for table in tables:
        rows = []
        for row in table.rows:
            name = str(table.columns[0].value(row))
            names.append(name)
            hits = {pattern for pattern in patterns if fnmatchcase(name, pattern)}
            missing -= hits
            if hits or not patterns:
                rows.append(row)
        if rows:
            kept.append(replace(table, rows=rows))
    for pattern in patterns:
        if pattern in missing:
            raise UnknownNameError(kind, pattern, names)
    return kept


def by_suffix(files: Sequence[Path] | None, *suffixes: str) -> dict[str, Path]:
    """Return the files of `--out` by their suffixes, each once.

    Args:
        files: Given paths.
        suffixes: Suffixes that the command can write; an empty one is a folder.
    """
    chosen: dict[str, Path] = {}
    for file in files or ():
        if file.suffix not in suffixes:
            names = ", ".join(suffix or "none for a folder" for suffix in suffixes)
            raise ParameterError(f"--out {file}: expected a suffix of {names}")
        if file.suffix in chosen:
            raise ParameterError(
                f"--out {file}: {chosen[file.suffix]} has the same suffix; give one of them"
            )
        chosen[file.suffix] = file
    return chosen
