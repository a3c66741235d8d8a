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
from gauge_envs.experiments.variants import Variant, find_variant, variants
from gauge_envs.references.imported import DataSource

__all__ = [
    "GLOB_CHARACTERS",
    "AssetOption",
    "DriversOption",
    "ReferenceOption",
    "WithheldOption",
    "Json",
    "ParametersOption",
    "check_one_format",
    "is_glob",
    "matching_subjects",
    "matching_variants",
    "parsed_parameters",
    "parsed_settings",
]


Json = Annotated[bool, typer.Option("--json", help="JSON on stdout, one object a line.")]


AssetOption = Annotated[
    Path | None,
    typer.Option(
        "--asset", help="File that the scene is from, instead of the task file: a USD layer, or MJCF for mujoco."
    ),
]


ParametersOption = Annotated[
    str | None,
    typer.Option("--parameters", help="calibrated, effective, ..., or overrides: cube.friction=0.3,cube.mass_kg=0.1"),
]


DriversOption = Annotated[
    DataSource,
    typer.Option(
        "--drivers", help="Driven motion: bundled, as the task file states; imported, as imported trials show."
    ),
]


ReferenceOption = Annotated[
    DataSource,
    typer.Option("--reference", help="Band: bundled with the package; imported, of imported trials."),
]


WithheldOption = Annotated[
    bool, typer.Option("--use-withheld", help="Score also on a band that is withheld; gauge show reports why it is.")
]


GLOB_CHARACTERS = "*?["


def is_glob(pattern: str) -> bool:
    return any(character in pattern for character in GLOB_CHARACTERS)


def matching_variants(pattern: str) -> list[Variant]:
    """Variants of an id or a pattern, with or without `GAUGE/`.

    Raises:
        UnknownNameError: There are none; the message offers the nearest.
    """
    if not is_glob(pattern):
        return [find_variant(pattern)]
    stem = pattern.removeprefix("GAUGE/")
    found = [variant for variant in variants() if fnmatchcase(variant.name, stem)]
    if not found:
        raise UnknownNameError("experiment", pattern, (variant.name for variant in variants()))
    return found


def matching_subjects(pattern: str) -> Sequence[Variant | str]:
    """Variants of an id or a pattern, or the path of an experiment file."""
    from gauge_envs.experiments.scene_source import is_experiment_file

    return [pattern] if is_experiment_file(Path(pattern)) else matching_variants(pattern)


def _split(text: str) -> list[str]:
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
    except ValueError:
        return key, value


def parsed_parameters(text: str | None) -> Parameters | None:
    if text is None or "=" not in text:
        return text
    return dict(_assigned(part) for part in _split(text))


def parsed_settings(changes: Sequence[str]) -> dict[str, Any] | None:
    return dict(map(_assigned, changes)) or None


def check_one_format(json_lines: bool, markdown: bool) -> None:
    if json_lines and markdown:
        raise ParameterError("--json and --markdown exclude each other")
