"""Read files that a user names.

A training run dumps its configuration with tags of Python. Two of them are data: a tuple, and a slice, which is read as
None. Nothing of a file is run.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.optional import needs_extra
from gauge_envs.reading import reading
from gauge_envs.text import filled_text

PYTHON = "tag:yaml.org,2002:python/"


def file_text(path: Path) -> str:
    """Return the text of a file in UTF-8, or in UTF-16 with a byte-order mark, as Windows writes it.

    Raises:
        TargetError: The file is not there, is empty, or is no text.
    """
    with reading(path, TargetError) as content:
        return filled_text(content)


def file_value(path: Path, parse: Callable[[bytes], Any]) -> Any:
    """Return the value of a file, by a function that parses its content."""
    with reading(path, TargetError) as content:
        return parse(content)


def yaml_document(content: bytes) -> Any:
    """Return the value of a YAML document.

    Raises:
        ValueError: The document is damaged, or has a tag that is no data.
    """
    with needs_extra("a YAML file", "sanity"):
        import yaml

    class Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
        """Loader of plain values, tuples and slices."""

    Loader.add_constructor(
        f"{PYTHON}tuple",
        lambda loader, node: tuple(loader.construct_sequence(node, deep=True)),
    )
    Loader.add_constructor(
        f"{PYTHON}object/apply:builtins.slice", lambda loader, node: None
    )
    try:
        return yaml.load(filled_text(content), Loader=Loader)
    except (
        Exception
    ) as error:  # Constructors of dates and numbers raise anything for damaged ones.
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}: " if mark else ""
        cause = getattr(error, "problem", " ".join(str(error).split()))
        if PYTHON in str(error):
            cause += "; a tag of Python is not run: write the value itself"
        raise ValueError(f"{line}it is no YAML: {cause}") from None
