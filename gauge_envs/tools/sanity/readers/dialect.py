"""Define a dialect: the settings of a backend in the terms of a training stack, read and written by a table."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.training import Settings

Entries = Mapping[str, Sequence[str]]
"""Assignments by their place."""

SettingOrigins = Mapping[str, tuple[Any, str]]
"""Value and origin of settings by their names."""


class NestedTable:
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

    def part(self, key: str) -> NestedTable:
        """Return a table, which is false when it is absent or empty."""
        value = self.value(key)
        values = {} if value is None else value
        return NestedTable(values, source=self.source, path=self.name(key))

    def number(self, key: str) -> float | None:
        """Return a number, which may be infinite."""
        numbers = self.numbers(key, 1)
        return None if numbers is None else numbers[0]

    def numbers(self, key: str, count: int) -> tuple[float, ...] | None:
        """Return a list of some numbers; a number alone stands for all of them."""
        value = self.value(key)
        if value is None:
            return None
        values = value if isinstance(value, list | tuple) else [value] * count
        # YAML reads 1e-3, without a dot, as text.
        with suppress(ValueError, TypeError, OverflowError):
            numbers = tuple(map(float, values))
            if len(numbers) == count and not any(map(math.isnan, numbers)):
                return numbers
        expected = "a number is" if count == 1 else f"{count} numbers are"
        raise TargetError(
            f"{self.source}: {self.name(key)} is {value!r:.80}, and {expected} expected"
        )


def not_carried_over(table: NestedTable, usual: Mapping[str, Any]) -> list[str]:
    """Return a note on each key that no experiment gets and whose value is unusual."""
    return [
        f"{table.name(key)} is not carried over"
        for key, value in usual.items()
        if table.value(key) not in (None, value)
    ]


# --- texts -----------------------------------------------------------------------------------------------------------


def number_text(value: Any) -> str:
    """Return a number with six digits at most."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def python_text(value: Any) -> str:
    """Return a value as Python writes it."""
    return f'"{value}"' if isinstance(value, str) else number_text(value)


def toml_text(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_text, value))}]"
    text = python_text(value)
    return text.lower() if isinstance(value, bool) else text


def joined(separator: str) -> Callable[[Entries], str]:
    """Return a function that returns all assignments in a row."""
    return lambda entries: separator.join(
        entry for assignments in entries.values() for entry in assignments
    )


ASSIGNMENT, COMMAS = "{key} = {value}", joined(", ")


# --- settings --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """One setting of a backend in a stack.

    Attributes:
        name: Name of the backend's setting.
        place: NestedTable, class or element of the stack that has the key.
        key: Its key there.
        read: Function from a table and a key to its value; it returns None for an absent key.
        text: Function from its value to its text; that of the dialect if None.
        pattern: Form of an assignment with `{place}`, `{key}` and `{value}`; that of the dialect if empty.
        default: Value that the stack documents for an absent key; None if it is unknown.
    """

    name: str
    place: str
    key: str
    read: Callable[[NestedTable, str], Any] = NestedTable.number
    text: Callable[[Any], str] | None = None
    pattern: str = ""
    default: Any = None


Kind = tuple[Callable[[NestedTable, str], Any], Callable[[Any], str] | None, str]
"""How a setting is read, its text, and the form of its assignment, as in `Setting`."""


def settings_of(table: str, kinds: Mapping[str, Kind]) -> tuple[Setting, ...]:
    """Return the settings of a table with a line for each: name, place, key, kind, and default in JSON where known.

    Args:
        table: The table.
        kinds: Kinds of values in addition to `number` and `value`.
    """
    known = {
        "number": (NestedTable.number, None, ""),
        "value": (NestedTable.value, None, ""),
    }
    settings = []
    for line in table.strip().splitlines():
        name, place, key, kind, *default = line.split()
        value = json.loads(default[0]) if default else None
        settings.append(Setting(name, place, key, *{**known, **kinds}[kind], value))
    return tuple(settings)


@dataclass(frozen=True, kw_only=True)
class Dialect:
    """Language in which targets of a kind give their settings.

    Attributes:
        name: Name that a `TrainingConfiguration` refers to.
        settings: Settings that the stack has keys for, in the order in which they are read.
        pattern: Form of an assignment with `{place}`, `{key}` and `{value}`.
        text: Function from a value to its text.
        join: Function from all assignments to the text that is pasted.
        is_closed: Whether only the settings of the table can be written; others are not changed.
    """

    name: str
    settings: tuple[Setting, ...] = ()
    pattern: str = ASSIGNMENT
    text: Callable[[Any], str] = toml_text
    join: Callable[[Entries], str] = COMMAS
    is_closed: bool = False

    def writes(self, name: str) -> bool:
        """Return whether a target can write a setting; others are not changed."""
        names = {setting.name for setting in self.settings}
        return not self.is_closed or name in names

    def value_text(self, setting: Setting, value: Any) -> str:
        """Return the text of a value of a setting."""
        text = setting.text or self.text
        return text(value)

    def paste_text(self, changes: Settings) -> str:
        """Return changes of settings, new values by name, as text that can be pasted into the target.

        None leaves a setting out.
        """
        known = {setting.name: setting for setting in self.settings}
        entries: dict[str, list[str]] = {}
        for name, value in changes.items():
            setting = known.get(name) or Setting(name, "", name, pattern=ASSIGNMENT)
            form = setting.pattern or self.pattern
            if value is None and setting.text is None:
                form = "no {key}"
            text = self.value_text(setting, value)
            entry = form.format(place=setting.place, key=setting.key, value=text)
            entries.setdefault(setting.place, []).append(entry)
        return self.join(entries)

    def read(self, tables: Mapping[str, NestedTable]) -> dict[str, tuple[Any, str]]:
        """Return the settings of some places, and those with a documented default; the last key wins.

        Args:
            tables: NestedTable of each place.
        """
        settings = {}
        for setting in self.settings:
            table = tables.get(setting.place)
            if table is not None:
                value = setting.read(table, setting.key)
                value = setting.default if value is None else value
                if value is not None:
                    settings[setting.name] = value, table.name(setting.key)
        return settings


TOML = Dialect(name="toml")
"""Lines of a settings file, which has one set of contact constants: `cone = "elliptic"`."""
