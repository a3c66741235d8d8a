"""Arguments that commands share, and how they are parsed."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from inspect import isfunction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli.output import Format
from gauge_envs.errors import ParameterError, UnknownNameError, first_fault, nearest

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table

Form = Annotated[
    Format,
    typer.Option(
        "--format", help="wide has all columns; --json is short for json, a line a row."
    ),
]

Sources = Annotated[
    list[str] | None,
    typer.Argument(metavar="[DIR or FILE]...", help="Results; results/ by default."),
]

Backends = Annotated[
    list[str] | None,
    typer.Option("--backend", help="Engine; repeatable; mujoco by default."),
]

Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Setting of the engine, as timestep_s=0.0005.",
    ),
]

Asset = Annotated[
    Path | None,
    typer.Option(
        "--asset",
        help="Scene, in place of the task file: a USD layer, or MJCF for mujoco.",
    ),
]

Parameters = Annotated[
    str | None,
    typer.Option(
        help="calibrated, effective, ..., or overrides: cube.friction=0.3,cube.mass_kg=0.1"
    ),
]

Use = Annotated[
    str,
    typer.Option(
        "--use",
        metavar="DATA",
        help="Data beyond the bundled: imported-drivers, imported-reference, imported for both; withheld bands.",
    ),
]

Limits = Annotated[
    str,
    typer.Option(
        "--limits",
        metavar="LIMITS",
        help="Process of its own with limits, as 3600s,4GB; isolate for one without.",
    ),
]

Only = Annotated[
    list[str] | None,
    typer.Option("--only", metavar="ID", help="Ids or patterns; repeatable."),
]

USES = {
    "imported": ("drivers", "reference"),
    "imported-drivers": ("drivers",),
    "imported-reference": ("reference",),
    "withheld": ("use_withheld",),
}
"""Keyword arguments that the words of `--use` change."""

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


def parsed_parameters(text: str | None) -> str | dict[str, Any] | None:
    """Return the name of a parameter set, or overrides such as `cube.friction=0.3,cube.mass_kg=0.1` as a dictionary."""
    if text is None or "=" not in text:
        return text
    return dict(_assigned(part) for part in split_list(text))


def parsed_settings(changes: Sequence[str] | None) -> dict[str, Any] | None:
    """Return settings such as `timestep_s=0.0005` as a dictionary; None for no settings."""
    return dict(map(_assigned, changes or ())) or None


def parsed_use(text: str, *names: str) -> dict[str, Any]:
    """Return those of the keyword arguments `drivers`, `reference` and `use_withheld` that a command has.

    Args:
        text: Words of `--use` with commas, as `imported,withheld`.
        names: The keyword arguments.
    """
    from gauge_envs.references.user_data import DataSource

    known = [word for word, changed in USES.items() if set(changed) & set(names)]
    used: set[str] = set()
    for word in filter(None, map(str.strip, text.split(","))):
        if word not in known:
            raise UnknownNameError("word of --use", word, known)
        used.update(USES[word])
    sources = {
        name: DataSource.IMPORTED if name in used else DataSource.BUNDLED
        for name in names
    }
    return sources | (
        {"use_withheld": "use_withheld" in used} if "use_withheld" in names else {}
    )


def parsed_limits(text: str) -> tuple[bool, float | None, float | None]:
    """Return whether there is a process of its own, its limit of time [s] and of memory [GB], of `3600s,4GB`."""
    values = quantities(
        "--limits",
        ",".join(word for word in text.split(",") if word != "isolate"),
        s=3600.0,
        GB=4.0,
    )
    return bool(text), values.get("s"), values.get("GB")


def parsed_jitter(text: str) -> dict[str, float]:
    """Return the standard deviations that `jitter` states, as `1mm,0.5deg`, by the names of `gauge_envs.Jitter`."""
    values = quantities("jitter", text, mm=1.0, deg=0.5)
    position = {"position_m": 1e-3 * values["mm"]} if "mm" in values else {}
    return position | (
        {"angle_rad": math.radians(values["deg"])} if "deg" in values else {}
    )


def quantities(name: str, text: str, **units: float) -> dict[str, float]:
    """Return the numbers of a text such as `3600s,4GB` by their units.

    Args:
        name: What the text is of, for messages.
        text: Numbers with units and commas.
        units: An example for each unit.
    """
    values = {}
    for part in filter(None, text.split(",")):
        found = re.fullmatch(
            r"((?:\d+|\d*\.\d+)(?:e[-+]?\d+)?)\s*([A-Za-z]+)", part.strip()
        )
        if found is None or found[2] not in units:
            example = ",".join(f"{value:g}{unit}" for unit, value in units.items())
            raise ParameterError(
                f"{name} {text!r}: expected numbers with units, as {example}"
            )
        values[found[2]] = float(found[1])
    return values


def split_details(
    words: Sequence[str] | None, **known: Any
) -> tuple[list[str], dict[str, Any]]:
    """Return the words of a command that are no details, and its details by name.

    Args:
        words: Arguments of the command.
        known: The type of each detail, as pydantic checks it; or a function that returns its value from a text.
    """
    from pydantic import TypeAdapter, ValidationError

    others, values = [], {}
    for word in words or ():
        found = DETAIL.fullmatch(word)
        if found is None:
            others.append(word)
            continue
        name, text = found.groups()
        if name not in known:
            raise ParameterError(
                f"unknown detail {name!r}; {nearest(name, known)}; other values have options: --help"
            )
        convert = (
            known[name]
            if isfunction(known[name])
            else TypeAdapter(known[name]).validate_python
        )
        try:
            values[name] = convert(text)
        except ValidationError as error:
            raise ParameterError(f"{name}: {first_fault(error)[1]}") from None
    return others, values


def check_spelling(command: str, option: str, details: Iterable[str]) -> None:
    """Raise an error that states the detail which an option is meant for: `--hold-s 1` is `hold_s=1`.

    Args:
        command: Name of the command.
        option: An option that it does not have.
        details: Names of its details, NAME=VALUE.
    """
    plain = option.removeprefix("--").replace("-", "_")
    similar = [
        name
        for name in details
        if name.startswith(plain) or plain.startswith(f"{name}_")
    ]
    if similar:
        nearest = min(similar, key=lambda name: abs(len(name) - len(plain)))
        raise ParameterError(
            f"`gauge {command} {option}` is `gauge {command} {nearest}=...`"
        )


def split_subject(words: Sequence[str], **known: Any) -> tuple[str, dict[str, Any]]:
    """Return the one word of a command that is no detail, and its details by name."""
    others, values = split_details(words, **known)
    if len(others) != 1:
        raise ParameterError(
            f"{' and '.join(others) or 'nothing'}: expected one name beside NAME=VALUE"
        )
    return others[0], values


def matching(
    tables: Sequence[Table], patterns: Sequence[str], *, kind: str
) -> list[Table]:
    """Return tables with the rows whose first column matches a name or a pattern; all rows without patterns."""
    named = [
        [(str(table.columns[0].value(row)), row) for row in table.rows]
        for table in tables
    ]
    names = [name for rows in named for name, _ in rows]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise UnknownNameError(kind, pattern, names)
    chosen = {
        name
        for name in names
        if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns)
    }
    kept = [[row for name, row in rows if name in chosen] for rows in named]
    return [
        replace(table, rows=rows)
        for table, rows in zip(tables, kept, strict=True)
        if rows
    ]


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
            raise ParameterError(
                f"--out {file}: {found[file.suffix]} has the same suffix; give one of them"
            )
        found[file.suffix] = file
    return found
