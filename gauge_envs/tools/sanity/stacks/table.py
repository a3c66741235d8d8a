"""Read typed values from nested tables of a stranger; an error names the key."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.files import printable

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

    def __init__(self, values: Any, *, source: str, path: str = "", root: Mapping[str, Any] | None = None) -> None:
        self.source, self.path = source, path
        if not isinstance(values, Mapping):
            raise TargetError(f"{source}: {path or 'the file'} is {_kind(values)}, and a table is expected")
        self.values: Mapping[str, Any] = values
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
        return None if value is None else Table(value, source=self.source, path=self.name(key), root=self._root)

    def part(self, key: str) -> Table:
        """Return a table; an empty one when it is absent."""
        return self.table(key) or Table({}, source=self.source, path=self.name(key), root=self._root)

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
        value = self.value(key)
        if value is None or isinstance(value, bool):
            return value
        raise self._wrong(key, value, "true or false")

    def text(self, key: str) -> str | None:
        """Return a text."""
        value = self.value(key)
        if value is None or isinstance(value, str):
            return value
        raise self._wrong(key, value, "a text")

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of texts; an empty one when it is absent."""
        value = self.value(key) or ()
        if isinstance(value, list | tuple) and all(isinstance(one, str) for one in value):
            return tuple(value)
        raise self._wrong(key, value, "a list of texts")

    def choice(self, key: str, known: Collection[str]) -> str | None:
        """Return one of some texts."""
        value = self.value(key)
        if value is None or (isinstance(value, str) and value in known):
            return value
        raise TargetError(f"{self.source}: {self.name(key)} is {_kind(value)}: choose one of {', '.join(known)}")

    def numbers(self, key: str, count: int) -> tuple[float, ...] | None:
        """Return a list of some numbers."""
        value = self.value(key)
        if value is None:
            return None
        if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != count:
            raise self._wrong(key, value, f"a list of {count} numbers")
        return tuple(self._number(one, key) for one in value)

    def _number(self, value: Any, key: str) -> float:
        # YAML reads 1e-3, without a dot, as text.
        if isinstance(value, str):
            try:
                value = float(value)
            except ValueError:
                raise self._wrong(key, value, "a number") from None
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise self._wrong(key, value, "a number")
        try:
            return float(value)
        except OverflowError:
            raise self._wrong(key, "a number of many digits", "a number") from None

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
        return TargetError(f"{self.source}: {self.name(key)} is {_kind(value)}, and {expected} is expected")


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
