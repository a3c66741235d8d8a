"""Read files that a user names, and typed values of their tables.

A training run dumps its configuration with tags of Python. Two of them are data: a tuple, and a slice, which Isaac Lab
writes for every selection of joints. A slice is read as None. Every other tag of Python is refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from gauge_envs.errors import TargetError, needs_extra
from gauge_envs.files import printable
from gauge_envs.tools.sanity.model import Settings

T = TypeVar("T")

PYTHON = "tag:yaml.org,2002:python/"
TUPLE, SLICE = f"{PYTHON}tuple", f"{PYTHON}object/apply:builtins.slice"


@cache
def _yaml() -> tuple[Any, Any]:
    """Return PyYAML, and a loader of plain values and tuples, and of slices as None."""
    with needs_extra("a YAML file", "sanity"):
        import yaml
    base = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    loader: Any = type("_Loader", (base,), {})
    loader.add_constructor(
        TUPLE, lambda loader, node: tuple(loader.construct_sequence(node, deep=True))
    )
    loader.add_constructor(SLICE, lambda loader, node: None)
    return yaml, loader


def file_content(path: Path) -> bytes:
    """Return the content of a file that a user names."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise TargetError(f"{path}: there is no such file") from None
    except OSError as error:
        raise TargetError(
            f"{path}: cannot be read: {error.strerror or error}"
        ) from None


def file_value(path: Path, parse: Callable[[bytes], Any]) -> Any:
    """Return the value of a file that a user names, by a function that raises `ValueError` for what it cannot parse."""
    content = file_content(path)
    try:
        return parse(content)
    except ValueError as error:
        raise TargetError(f"{path}: {error}") from None


def read_yaml(path: Path) -> Any:
    """Return the value of a YAML file; see `yaml_document`."""
    return file_value(path, yaml_document)


def yaml_document(content: bytes | str) -> Any:
    """Return the value of a YAML document; raise `ValueError` where it is damaged, or has a tag that is no data."""
    yaml, loader = _yaml()
    try:
        return yaml.load(content, Loader=loader)
    # Constructors of plain values assume well-formed dates and numbers.
    except (
        yaml.YAMLError,
        ArithmeticError,
        AttributeError,
        LookupError,
        TypeError,
    ) as error:
        raise ValueError(
            f"it is no YAML: {printable(' '.join(str(error).split()))}"
        ) from None


# --- tables ----------------------------------------------------------------------------------------------------------

REFERENCE = re.compile(r"\$\{([A-Za-z_][\w.]*)\}")
"""A value that stands at another place of the same file, as Hydra writes it."""

MOST_REFERENCES = 16
"""Longest chain of such values."""


class Table:
    """A nested table. Keys are paths with dots, such as `sim.physx.solver_type`.

    A key that is absent or null has no value: its reader returns None.

    Args:
        values: The table.
        source: Name of the file, for messages.
        path: Key of the table in the whole file.
        root: The whole file, in which references are looked up; the table itself if None.
    """

    def __init__(
        self,
        values: Any,
        *,
        source: str,
        path: str = "",
        root: Settings | None = None,
    ) -> None:
        self.source, self.path = source, path
        if not isinstance(values, Mapping):
            raise TargetError(
                f"{source}: {path or 'the file'} is {_kind(values)}, and a table is expected"
            )
        self.values: Settings = values
        self._root = values if root is None else root

    def __contains__(self, key: str) -> bool:
        return self.value(key) is not None

    def name(self, key: str) -> str:
        """Return the key in the whole file."""
        return f"{self.path}.{key}" if self.path else key

    def value(self, key: str) -> Any:
        """Return a value of any kind; None when it is absent or null."""
        return self._resolved(_at(self.values, key), self.name(key))

    def table(self, key: str) -> Table | None:
        """Return a table."""
        value = self.value(key)
        return (
            None
            if value is None
            else Table(value, source=self.source, path=self.name(key), root=self._root)
        )

    def part(self, key: str) -> Table:
        """Return a table; an empty one when it is absent."""
        return self.table(key) or Table(
            {}, source=self.source, path=self.name(key), root=self._root
        )

    def number(self, key: str) -> float | None:
        """Return a number, which may be infinite."""
        value = self.value(key)
        return None if value is None else self._number(value, key)

    def whole(self, key: str) -> int | None:
        """Return a whole number."""
        number = self.number(key)
        if number is None:
            return None
        if not math.isfinite(number) or number != int(number):
            raise self._wrong(key, number, "a whole number")
        return int(number)

    def flag(self, key: str) -> bool | None:
        """Return a Boolean value."""
        return self._of(bool, key, "true or false")

    def text(self, key: str) -> str | None:
        """Return a text."""
        return self._of(str, key, "a text")

    def _of(self, kind: type[T], key: str, what: str) -> T | None:
        value = self.value(key)
        if value is None or isinstance(value, kind):
            return value
        raise self._wrong(key, value, what)

    def choice(self, key: str, known: Collection[str]) -> str | None:
        """Return one of some texts."""
        value = self.value(key)
        if value is None or (isinstance(value, str) and value in known):
            return value
        raise TargetError(
            f"{self.source}: {self.name(key)} is {_kind(value)}: choose one of {', '.join(known)}"
        )

    def numbers(self, key: str, count: int) -> tuple[float, ...] | None:
        """Return a list of some numbers."""
        value = self.value(key)
        if value is None:
            return None
        if (
            not isinstance(value, Sequence)
            or isinstance(value, str)
            or len(value) != count
        ):
            raise self._wrong(key, value, f"a list of {count} numbers")
        return tuple(self._number(one, key) for one in value)

    def _number(self, value: Any, key: str) -> float:
        # YAML reads 1e-3, without a dot, as text.
        if isinstance(value, str):
            try:
                value = float(value)
            except ValueError:
                raise self._wrong(key, value, "a number") from None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._wrong(key, value, "a number")
        try:
            number = float(value)
        except OverflowError:
            raise self._wrong(key, "a number of many digits", "a number") from None
        if math.isnan(number):
            raise self._wrong(key, value, "a number")
        return number

    def _resolved(self, value: Any, name: str) -> Any:
        """Return the value that a reference stands for; other values unchanged."""
        for _ in range(MOST_REFERENCES):
            found = REFERENCE.fullmatch(value) if isinstance(value, str) else None
            if found is None:
                break
            value = _at(self._root, found[1])
        if isinstance(value, str) and "${" in value:
            raise TargetError(
                f"{self.source}: {name} is {printable(value)[:80]!r}, which Hydra fills in: give the file with all "
                "values that the training run writes"
            )
        return value

    def _wrong(self, key: str, value: Any, expected: str) -> TargetError:
        return TargetError(
            f"{self.source}: {self.name(key)} is {_kind(value)}, and {expected} is expected"
        )


def _at(values: Any, key: str) -> Any:
    for part in key.split("."):
        if not isinstance(values, Mapping):
            return None
        values = values.get(part)
    return values


def _kind(value: Any) -> str:
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list | tuple | set):
        return "a list"
    return "empty" if value is None else repr(value)[:80]
