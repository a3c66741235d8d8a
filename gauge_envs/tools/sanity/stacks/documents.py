"""Read files that a user names, and typed values of their tables.

A training run dumps its configuration with tags of Python. Two of them are data: a tuple, and a slice, which is read as
None. Nothing of a file is run.
"""

from __future__ import annotations

import codecs
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from gauge_envs.errors import TargetError, needs_extra
from gauge_envs.files import os_errors
from gauge_envs.tools.sanity.model import Settings

PYTHON = "tag:yaml.org,2002:python/"


def file_text(path: Path) -> str:
    """Return the text of a file in UTF-8, or in UTF-16 with a byte-order mark, as Windows writes it.

    Raises:
        TargetError: The file is not there, is empty, or is no text.
    """
    if not path.exists():
        raise TargetError(f"{path}: there is no such file")
    with os_errors(lambda cause: TargetError(f"{path}: cannot be read: {cause}")):
        content = path.read_bytes()
    is_wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = content.decode("utf-16" if is_wide else "utf-8-sig")
    except UnicodeDecodeError:
        raise TargetError(f"{path}: is no text in UTF-8: save it as UTF-8") from None
    if not text.strip():
        raise TargetError(f"{path}: is empty")
    return text


def file_value(path: Path, parse: Callable[[str], Any]) -> Any:
    """Return the value of a file, by a function that raises `ValueError` for what it cannot parse."""
    text = file_text(path)
    try:
        return parse(text)
    except ValueError as error:
        raise TargetError(f"{path}: {error}") from None


def yaml_document(text: str) -> Any:
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
        return yaml.load(text, Loader=Loader)
    except (
        Exception
    ) as error:  # Constructors of dates and numbers raise anything for damaged ones.
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}: " if mark else ""
        cause = getattr(error, "problem", " ".join(str(error).split()))
        if PYTHON in str(error):
            cause += "; a tag of Python is not run: write the value itself"
        raise ValueError(f"{line}it is no YAML: {cause}") from None


# --- tables ----------------------------------------------------------------------------------------------------------


class Table:
    """A nested table. Keys are paths with dots, such as `sim.physx.solver_type`.

    A key that is absent or null has no value: its reader returns None. A value of another kind is a `TargetError`.

    Args:
        values: The table.
        source: Name of the file, for messages.
        path: Key of the table in the whole file.
    """

    def __init__(self, values: Any, *, source: str, path: str = "") -> None:
        self.source, self.path = source, path
        if not isinstance(values, Mapping):
            raise TargetError(
                f"{source}: {path or 'the file'} is {values!r:.80}, and a table is expected"
            )
        self.values: Settings = values

    def __bool__(self) -> bool:
        return bool(self.values)

    def name(self, key: str) -> str:
        """Return the key in the whole file."""
        return f"{self.path}.{key}" if self.path else key

    def value(self, key: str) -> Any:
        """Return a value of any kind; None when it is absent or null."""
        value: Any = self.values
        for part in key.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        return value

    def part(self, key: str) -> Table:
        """Return a table, which is false when it is absent or empty."""
        value = self.value(key)
        values = {} if value is None else value
        return Table(values, source=self.source, path=self.name(key))

    def number(self, key: str) -> float | None:
        """Return a number, which may be infinite."""
        numbers = self.numbers(key, 1)
        return None if numbers is None else numbers[0]

    def numbers(self, key: str, count: int) -> tuple[float, ...] | None:
        """Return a list of some numbers; a number alone stands for all of them."""
        value = self.value(key)
        if value is None:
            return None
        several = value if isinstance(value, list | tuple) else [value] * count
        # YAML reads 1e-3, without a dot, as text.
        with suppress(ValueError, TypeError, OverflowError):
            numbers = tuple(map(float, several))
            if len(numbers) == count and not any(map(math.isnan, numbers)):
                return numbers
        expected = "a number is" if count == 1 else f"{count} numbers are"
        raise TargetError(
            f"{self.source}: {self.name(key)} is {value!r:.80}, and {expected} expected"
        )


def not_carried_over(table: Table, *keys: str) -> list[str]:
    """Return a note on each key that is set and that no experiment gets."""
    return [
        f"{table.name(key)} is not carried over" for key in keys if table.value(key)
    ]
