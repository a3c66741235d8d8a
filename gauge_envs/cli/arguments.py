"""Arguments that commands share, and how they are parsed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.references.imported import DataSource

Json = Annotated[bool, typer.Option("--json", help="JSON on stdout, one object a line.")]


Wide = Annotated[bool, typer.Option("--wide", help="All columns of the tables.")]


AssetOption = Annotated[
    Path | None,
    typer.Option("--asset", help="File with the scene, in place of the task file: a USD layer, or MJCF for mujoco."),
]


ParametersOption = Annotated[
    str | None,
    typer.Option("--parameters", help="calibrated, effective, ..., or overrides: cube.friction=0.3,cube.mass_kg=0.1"),
]


DriversOption = Annotated[
    DataSource,
    typer.Option("--drivers", help="Motion of driven bodies: bundled, from the task file; imported, from real trials."),
]


ReferenceOption = Annotated[
    DataSource,
    typer.Option("--reference", help="Band to score against: bundled, of the package; or imported, from real trials."),
]


WithheldOption = Annotated[
    bool,
    typer.Option(
        "--use-withheld",
        help="Also use reference bands that are withheld; gauge show ID states the reason.",
    ),
]


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


def parsed_settings(changes: Sequence[str]) -> dict[str, Any] | None:
    """Return settings such as `timestep_s=0.0005` as a dictionary; None for no settings."""
    return dict(map(_assigned, changes)) or None


def check_one_format(json_lines: bool, markdown: bool) -> None:
    """Check that at most one output format is asked for."""
    if json_lines and markdown:
        raise ParameterError("--json and --markdown exclude each other; give one of them")
