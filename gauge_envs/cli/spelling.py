"""What the parser of a command refuses beyond typer: values given twice, empty values, and spellings of old."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gauge_envs.cli.arguments import (
    FILE_SUFFIXES,
    FOLDER,
    OUTPUT,
    PER_ENGINE,
    SIDE,
    STDOUT,
    split_values,
)
from gauge_envs.errors import ParameterError, nearest

RENAMED = {
    "backends": "--backend",
    "engine": "--backend",
    "workers": "--jobs",
    "output": "--out",
    "parameters": "--parameter",
    "friction": "--parameter BODY.friction=",
    "variants": "--only",
    "variant": "--only",
    "presets": "--preset",
    "limits": "--timeout or --memory",
    "timestep": "--set timestep_s=",
    "timestep_s": "--set timestep_s=",
    "to_s": "--until",
    "seconds": "--duration",
    "only": "--id",
    "drivers": "--use imported-drivers",
    "reference": "--use imported-reference",
    "use_withheld": "--use withheld",
    "episodes": "--repeats",
    "n_episodes": "--repeats",
}
"""Option for a name of earlier versions or of other tools. Parameters of a function are found by their own names."""

DETAIL = re.compile(r"([A-Za-z_]\w*)=(?!=)(.*)", re.DOTALL)
"""A word NAME=VALUE, as earlier versions had them. A file of such a name is written as ./NAME=VALUE."""


LISTED = ("ID", "KIND or PATTERN", "NAME", "PATTERN")
"""Metavars of arguments that are lists of names, not of paths."""


def _names(text: str) -> list[str]:
    """Return the names of a word, which commas separate; the settings behind an engine belong to it."""
    return [text] if Path(text).exists() else split_values(text, PER_ENGINE)


def longest(param: Any) -> str:
    """Return the long name of an option."""
    return str(max(param.opts, key=len))


def option_for(params: Sequence[Any], name: str) -> str | None:
    """Return the option that a name of earlier versions or of other tools stands for; None if the command has none."""
    plain = name.removeprefix("--").replace("-", "_")
    options = [one for one in params if one.param_type_name == "option"]
    for one in options:
        if plain == one.name or f"--{plain.replace('_', '-')}" in one.opts:
            return longest(one)
    new = RENAMED.get(plain, "")
    known = {longest(one) for one in options}
    return new if new.split(" ")[0] in known else None


def check_options(params: Sequence[Any], words: Sequence[str]) -> None:
    """Raise an error that names the option for which a word of the command line stands."""
    known = {option for one in params for option in (*one.opts, *one.secondary_opts)}
    for word in words:
        option = word.partition("=")[0]
        if option == "--":
            return
        if option.startswith("--") and option not in known:
            new = option_for(params, option)
            if new is not None:
                raise ParameterError(f"there is no {option}: write {new}")


def checked_values(
    params: Sequence[Any],
    values: Mapping[str, Any],
    rest: Sequence[str],
    order: Sequence[Any],
) -> dict[str, Any]:
    """Return what a parser has read, with the values of lists apart.

    Args:
        params: Parameters of the command.
        values: Texts of arguments and options by the names of their parameters, as the parser has read them.
        rest: Words that no parameter takes.
        order: Parameters in the order of the command line, each as often as it was given.

    Raises:
        ParameterError: A value is empty, an option for one value has two, or a word is written as earlier versions did.
    """
    counts = Counter(one.name for one in order if one.param_type_name == "option")
    found = dict(values)
    words = list(rest)
    for one in params:
        value = values.get(one.name)
        if one.param_type_name == "argument":
            # An argument that was not given is None or, in some versions of click, a mark of its own.
            if isinstance(value, list | tuple) and one.metavar in LISTED:
                value = [part for text in value for part in _names(text)]
                found[one.name] = value
            if isinstance(value, str):
                words.append(value)
            elif isinstance(value, list | tuple) and one.metavar != SIDE:
                words += value
            continue
        option = longest(one)
        if one.multiple and value:
            metavar = one.metavar or ""
            value = [part for text in value for part in split_values(text, metavar)]
            found[one.name] = value
        elif counts[one.name] > 1:
            raise ParameterError(f"{option} is given twice: give it once")
        _check_texts(one, value if isinstance(value, list) else [value])
    for word in words:
        _check_word(params, word)
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


def _check_word(params: Sequence[Any], word: str) -> None:
    """Raise an error for an argument NAME=VALUE, which is the spelling of an option in earlier versions, or a typo."""
    detail = DETAIL.fullmatch(word)
    if detail is None or Path(word).exists():
        return
    name, value = detail.groups()
    new = option_for(params, name)
    options = {longest(one): one for one in params if one.param_type_name == "option"}
    if new is None:
        raise ParameterError(
            f"`{word}` is no file, and options are written --NAME VALUE: {nearest(f'--{name}', options)}"
        )
    one = options[new.split(" ")[0]]
    if one.is_flag:
        is_no = value.lower() in ("false", "no", "0")
        new = (one.secondary_opts or ["without it"])[0] if is_no else new
    elif not new.endswith("=") or value:
        new += ("" if new.endswith("=") else " ") + (value or "VALUE")
    raise ParameterError(f"`{word}` is an option now: write {new}")
