"""Arguments that commands share, and how they are parsed."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from gauge_envs.cli.output import Format
from gauge_envs.errors import ParameterError, UnknownNameError

if TYPE_CHECKING:
    from gauge_envs.experiments.scene_builder import Parameters
    from gauge_envs.pages.table import Table

FormatOption = Annotated[
    Format,
    typer.Option("--format", help="Format on stdout; wide is text with all columns, json has one object a line."),
]

SourcesArgument = Annotated[
    list[str] | None,
    typer.Argument(metavar="[DIR or FILE]...", help="Result files, or folders of them; results/ by default."),
]

BackendsOption = Annotated[list[str] | None, typer.Option("--backend", help="Engine; repeatable; mujoco by default.")]

SettingsOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Setting of the engine, as timestep_s=0.0005; repeatable."),
]

AssetOption = Annotated[
    Path | None,
    typer.Option("--asset", help="File with the scene, in place of the task file: a USD layer, or MJCF for mujoco."),
]

ParametersOption = Annotated[
    str | None,
    typer.Option("--parameters", help="calibrated, effective, ..., or overrides: cube.friction=0.3,cube.mass_kg=0.1"),
]

UseOption = Annotated[
    str,
    typer.Option(
        "--use",
        metavar="DATA",
        help="Data beyond those of the package, with commas: imported-drivers and imported-reference, of real trials; "
        "imported for both; withheld for bands that gauge show ID reports as withheld.",
    ),
]

WithheldOption = Annotated[
    str, typer.Option("--use", metavar="DATA", help="withheld: also bands that gauge show ID reports as withheld.")
]

LimitsOption = Annotated[
    str,
    typer.Option(
        "--limits",
        metavar="LIMITS",
        help="Limits of time and memory, as 3600s,4GB, in another process; isolate for that process without them.",
    ),
]

OnlyOption = Annotated[
    list[str] | None, typer.Option("--only", metavar="ID", help="Id or pattern; repeatable, or with commas.")
]

USES: Mapping[str, tuple[str, ...]] = {
    "imported": ("drivers", "reference"),
    "imported-drivers": ("drivers",),
    "imported-reference": ("reference",),
    "withheld": ("use_withheld",),
}
"""What the words of `--use` change."""

DETAIL = re.compile(r"([A-Za-z_]\w*)=(.*)", re.DOTALL)
"""A detail of a command, NAME=VALUE. A file of such a name is written as ./NAME=VALUE."""


def split_list(text: str) -> list[str]:
    """Split at the commas that are outside brackets."""
    parts, depth = [""], 0
    for character in text:
        depth += (character == "[") - (character == "]")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return parts


def _assigned(text: str) -> tuple[str, Any]:
    key, equals, value = (part.strip() for part in text.partition("="))
    if not (key and equals and value):
        raise ParameterError(f"{text!r}: expected NAME=VALUE")
    return key, json_or_text(value)


def json_or_text(value: str) -> Any:
    """Return the value of a JSON text, or the text itself if it is none."""
    try:
        return json.loads(value)
    except (ValueError, RecursionError):
        return value


def parsed_parameters(text: str | None) -> Parameters | None:
    """Return the name of a parameter set, or overrides such as `cube.friction=0.3,cube.mass_kg=0.1` as a dictionary."""
    if text is None or "=" not in text:
        return text
    return dict(_assigned(part) for part in split_list(text))


def parsed_settings(changes: Sequence[str] | None) -> dict[str, Any] | None:
    """Return settings such as `timestep_s=0.0005` as a dictionary; None for no settings."""
    return dict(map(_assigned, changes or ())) or None


def parsed_use(text: str, *names: str) -> dict[str, Any]:
    """Return the keyword arguments that `--use` states.

    Args:
        text: Words with commas, as `imported,withheld`.
        names: Keyword arguments that the command has, of `drivers`, `reference` and `use_withheld`.
    """
    from gauge_envs.references.imported import DataSource

    known = [word for word, changed in USES.items() if set(changed) & set(names)]
    values: dict[str, Any] = {name: False if name == "use_withheld" else DataSource.BUNDLED for name in names}
    for word in filter(None, (part.strip() for part in text.split(","))):
        if word not in known:
            raise UnknownNameError("word of --use", word, known)
        changed = set(USES[word]) & set(names)
        values |= {name: True if name == "use_withheld" else DataSource.IMPORTED for name in changed}
    return values


class ProcessLimits(NamedTuple):
    """Limits of a process of its own.

    Attributes:
        isolate: Whether there is such a process.
        time_s: Limit of time [s]; None if none is given.
        memory_gb: Limit of resident memory [GB]; None for none.
    """

    isolate: bool
    time_s: float | None
    memory_gb: float | None


def parsed_limits(text: str) -> ProcessLimits:
    """Return the limits that `--limits` states, as `3600s,4GB`."""
    words = text.split(",")
    values = quantities("--limits", ",".join(word for word in words if word != "isolate"), s=3600.0, GB=4.0)
    return ProcessLimits(bool(text), values.get("s"), values.get("GB"))


def parsed_jitter(text: str) -> dict[str, float]:
    """Return the standard deviations that `jitter` states, as `1mm,0.5deg`, by the names of `gauge_envs.Jitter`."""
    values = quantities("jitter", text, mm=1.0, deg=0.5)
    names = {"position_m": ("mm", lambda value: 1e-3 * value), "angle_rad": ("deg", math.radians)}
    return {name: convert(values[unit]) for name, (unit, convert) in names.items() if unit in values}


def quantities(name: str, text: str, **units: float) -> dict[str, float]:
    """Return the numbers of a text such as `3600s,4GB` by their units.

    Args:
        name: What the text is of, for messages.
        text: Numbers with units and commas.
        units: An example for each unit.
    """
    values = {}
    for part in filter(None, text.split(",")):
        found = re.fullmatch(r"(\d+\.?\d*|\.\d+)(?:e([-+]?\d{1,2}))?\s*([A-Za-z]+)", part.strip())
        if found is None or found[3] not in units:
            example = ",".join(f"{value:g}{unit}" for unit, value in units.items())
            raise ParameterError(f"{name} {text!r}: expected numbers with units, as {example}")
        values[found[3]] = float(f"{found[1]}e{found[2] or 0}")
    return values


def split_details(
    words: Sequence[str] | None, known: Mapping[str, Callable[[str], Any]]
) -> tuple[list[str], dict[str, Any]]:
    """Return the words of a command that are no details, and its details by name.

    Args:
        words: Arguments of the command.
        known: Names of details, and how the text of each becomes a value; `float`, `whole` and `boolean` convert.
    """
    others, values = [], {}
    for word in words or ():
        found = DETAIL.fullmatch(word)
        if found is None:
            others.append(word)
        elif found[1] not in known:
            raise UnknownNameError("detail", found[1], known)
        else:
            try:
                values[found[1]] = known[found[1]](found[2])
            except ValueError as error:
                if isinstance(error, ParameterError):
                    raise
                raise ParameterError(f"{word}: expected a number") from None
    return others, values


def matching(tables: Sequence[Table], patterns: Sequence[str], *, kind: str) -> list[Table]:
    """Return tables with the rows whose first column matches a name or a pattern; all rows without patterns."""
    named = [[(str(table.columns[0].value(row)), row) for row in table.rows] for table in tables]
    names = [name for rows in named for name, _ in rows]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise UnknownNameError(kind, pattern, names)
    chosen = {name for name in names if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns)}
    kept = [[row for name, row in rows if name in chosen] for rows in named]
    return [replace(table, rows=rows) for table, rows in zip(tables, kept, strict=True) if rows]


def whole(least: int) -> Callable[[str], int]:
    """Return what converts the text of a whole number, at least `least`."""

    def convert(text: str) -> int:
        if not re.fullmatch(r"-?\d{1,18}", text) or int(text) < least:
            raise ParameterError(f"{text!r}: expected a whole number, at least {least}")
        return int(text)

    return convert


def boolean(text: str) -> bool:
    """Return the value of `true` or `false`."""
    if text not in ("true", "false"):
        raise ParameterError(f"{text!r}: expected true or false")
    return text == "true"


def by_suffix(files: Sequence[Path] | None, *suffixes: str) -> dict[str, Path]:
    """Return the files of `--out` by their suffixes, each once.

    Args:
        files: Paths that were given.
        suffixes: Suffixes that the command can write; empty for a folder.
    """
    found: dict[str, Path] = {}
    for file in files or ():
        if file.suffix not in suffixes:
            names = ", ".join(suffix or "none for a folder" for suffix in suffixes)
            raise ParameterError(f"--out {file}: expected a suffix of {names}")
        if file.suffix in found:
            raise ParameterError(f"--out {file}: {found[file.suffix]} has the same suffix; give one of them")
        found[file.suffix] = file
    return found
