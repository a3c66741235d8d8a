"""Arguments that commands share, and how they are parsed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any

import typer

from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.variants import Variant, beyond_variants, find_variant, variants
from gauge_envs.references.imported import DataSource

__all__ = [
    "GLOB_CHARACTERS",
    "AssetOption",
    "DriversOption",
    "Json",
    "ParametersOption",
    "ReferenceOption",
    "Wide",
    "WithheldOption",
    "check_one_format",
    "is_glob",
    "matching_subjects",
    "matching_variants",
    "parsed_parameters",
    "parsed_settings",
    "split_commas",
]


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
    typer.Option("--drivers", help="Driven motion: bundled, from the task file; or imported, from imported trials."),
]


ReferenceOption = Annotated[
    DataSource,
    typer.Option("--reference", help="Reference band: bundled with the package; or imported, from imported trials."),
]


WithheldOption = Annotated[
    bool,
    typer.Option(
        "--use-withheld",
        help="Also use reference bands of low quality, which are withheld; gauge show ID gives the reason.",
    ),
]

GLOB_CHARACTERS = "*?["


def is_glob(pattern: str) -> bool:
    """Return whether a text is a pattern, not an id."""
    return any(character in pattern for character in GLOB_CHARACTERS)


def matching_variants(pattern: str) -> list[Variant]:
    """Return the variants of an id or a pattern, with or without `GAUGE/`.

    A pattern matches the benchmark; only one that matches nothing there matches the variants beyond it.

    Raises:
        UnknownNameError: No variant matches; the message offers the nearest name.
    """
    if not is_glob(pattern):
        return [find_variant(pattern)]
    stem = pattern.removeprefix("GAUGE/")
    for known in (variants(), beyond_variants()):
        found = [variant for variant in known if fnmatchcase(variant.name, stem)]
        if found:
            return found
    raise UnknownNameError("experiment", pattern, (variant.name for variant in (*variants(), *beyond_variants())))


def matching_subjects(pattern: str) -> Sequence[Variant | str]:
    """Return the variants of an id or a pattern, or the path of an experiment file."""
    from gauge_envs.experiments.scene_source import is_experiment_file

    return [pattern] if is_experiment_file(Path(pattern)) else matching_variants(pattern)


def split_commas(text: str) -> list[str]:
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
    try:
        return key, json.loads(value)
    except (ValueError, RecursionError):
        return key, value


def parsed_parameters(text: str | None) -> Parameters | None:
    """Return the name of a parameter set, or overrides such as `cube.friction=0.3,cube.mass_kg=0.1` as a dictionary."""
    if text is None or "=" not in text:
        return text
    return dict(_assigned(part) for part in split_commas(text))


def parsed_settings(changes: Sequence[str]) -> dict[str, Any] | None:
    """Return settings such as `timestep_s=0.0005` as a dictionary; None for no settings."""
    return dict(map(_assigned, changes)) or None


def check_one_format(json_lines: bool, markdown: bool) -> None:
    """Check that at most one output format is asked for.

    Raises:
        ParameterError: Both formats are asked for.
    """
    if json_lines and markdown:
        raise ParameterError("--json and --markdown exclude each other; give one of them")
