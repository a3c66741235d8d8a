"""What the parser of a command reads and refuses beyond typer: lists with commas, values given twice, empty values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gauge_envs.cli.arguments import (
    FILE_SUFFIXES,
    FOLDER,
    OUTPUT,
    PER_ENGINE,
    STDOUT,
    split_values,
)
from gauge_envs.errors import ParameterError

LISTED = ("ID", "KIND or PATTERN", "NAME", "PATTERN")
"""Metavars of arguments that are lists of names, not of paths."""


def _names(text: str) -> list[str]:
    """Return the names of a word, which commas separate; the settings behind an engine belong to it."""
    return [text] if Path(text).exists() else split_values(text, PER_ENGINE)


def longest(param: Any) -> str:
    """Return the long name of an option."""
    return str(max(param.opts, key=len))


def checked_values(
    params: Sequence[Any], values: Mapping[str, Any], order: Sequence[Any]
) -> dict[str, Any]:
    """Return what a parser has read, with the values of lists apart.

    Args:
        params: Parameters of the command.
        values: Texts of arguments and options by the names of their parameters, as the parser has read them.
        order: Parameters in the order of the command line, each as often as it was given.

    Raises:
        ParameterError: A value is empty, or an option for one value has two.
    """
    counts = Counter(one.name for one in order if one.param_type_name == "option")
    found = dict(values)
    for one in params:
        value = values.get(one.name)
        if one.param_type_name == "argument":
            # An argument that was not given is None or, in some versions of click, a mark of its own.
            if isinstance(value, list | tuple) and one.metavar in LISTED:
                found[one.name] = [part for text in value for part in _names(text)]
            continue
        option = longest(one)
        if one.multiple and value:
            metavar = one.metavar or ""
            value = [part for text in value for part in split_values(text, metavar)]
            found[one.name] = value
        elif counts[one.name] > 1:
            raise ParameterError(f"{option} is given twice: give it once")
        _check_texts(one, value if isinstance(value, list) else [value])
    return found


def _check_texts(one: Any, texts: Sequence[Any]) -> None:
    """Raise an error for an empty value of an option, or for stdout in place of a file where it cannot be one."""
    option = longest(one)
    if any(isinstance(text, str) and not text.strip() for text in texts):
        raise ParameterError(f"{option} has an empty value: state it or leave it out")
    is_file = one.rich_help_panel == OUTPUT and STDOUT not in (one.metavar or "")
    if is_file and STDOUT in texts:
        raise ParameterError(
            f"{option} {STDOUT}: expected a path; stdout has what --format says"
        )
    is_folder = is_file and one.metavar == FOLDER
    for text in texts if is_folder else ():
        if str(text).endswith(FILE_SUFFIXES) and not Path(text).is_dir():
            raise ParameterError(
                f"{option} {text}: a folder is expected, and this is a name of a file"
            )
