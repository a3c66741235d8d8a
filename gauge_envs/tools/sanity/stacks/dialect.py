"""Define a dialect: the settings of a backend in the words of a training stack, read and written by one table."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from gauge_envs.scene import Vector
from gauge_envs.tools.sanity.model import Settings
from gauge_envs.tools.sanity.stacks.documents import Table


def number_text(value: Any) -> str:
    """Return a number with six digits at most."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def python_text(value: Any) -> str:
    """Return a value as Python writes it, numbers with six digits."""
    if isinstance(value, list | tuple):
        return f"({', '.join(map(python_text, value))})"
    return f'"{value}"' if isinstance(value, str) else number_text(value)


def toml_text(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_text, value))}]"
    return f'"{value}"' if isinstance(value, str) else number_text(value)


@dataclass(frozen=True)
class Kind:
    """How the values of a setting are read and written.

    Attributes:
        read: Function from a table and a key to the value of the setting; it returns None for an absent key.
        text: Function from the value of the setting to its text; that of the dialect if None.
    """

    read: Callable[[Table, str], Any] = Table.number
    text: Callable[[Any], str] | None = None


NUMBER, WHOLE, FLAG = Kind(), Kind(Table.whole), Kind(Table.flag)


@dataclass(frozen=True)
class Setting:
    """One setting of a backend in a stack.

    Attributes:
        name: Name of the backend's setting.
        place: Table, class or element of the stack in which it stands.
        key: Its key there.
        kind: How its values are read and written.
        pattern: Form of an assignment with `{place}`, `{key}` and `{value}`; that of the dialect if empty.
        others: Further keys that state it where the first one is absent.
        default: Value that the stack documents for an absent key; None if it is not known.
    """

    name: str
    place: str
    key: str
    kind: Kind = NUMBER
    pattern: str = ""
    others: tuple[str, ...] = ()
    default: Any = None


@dataclass(frozen=True, kw_only=True)
class Place:
    """What stands around the assignments of one place in a snippet.

    Attributes:
        form: Text with `{}` for the assignments.
        within: Place that holds this one; empty for none.
        is_alone: Whether every assignment stands alone, behind those of other places.
    """

    form: str
    within: str = ""
    is_alone: bool = False


@dataclass(frozen=True, kw_only=True)
class Dialect:
    """Words in which targets of one kind state their settings.

    Attributes:
        name: Name that a `TrainingConfiguration` refers to.
        settings: Settings that the stack has keys for, in the order in which they are read.
        pattern: Form of an assignment with `{place}`, `{key}` and `{value}`.
        other: Form of an assignment for a setting without a key.
        places: Places in the order in which a snippet has them, those within others first.
        joint: Text between the parts of a snippet.
        text: Function from a value to its text.
        other_text: The same for a setting without a key.
        gravity: Form of gravity with `{}` for its components.
        gravity_joint: Text between them.
        absent: Form of an assignment for a setting that is to be left out; that of None if empty.
        comes_last: Whether places come behind the assignments that stand alone.
        is_closed: Whether only the settings of the table can be stated; others are not changed.
    """

    name: str
    settings: tuple[Setting, ...] = ()
    pattern: str = "{key}={value}"
    other: str = "{key} = {value}"
    places: Mapping[str, Place] = field(default_factory=dict)
    joint: str = " and "
    text: Callable[[Any], str] = python_text
    other_text: Callable[[Any], str] = toml_text
    gravity: str
    gravity_joint: str = ", "
    absent: str = ""
    comes_last: bool = False
    is_closed: bool = False

    @cached_property
    def _by_name(self) -> dict[str, Setting]:
        return {one.name: one for one in self.settings}

    def setting(self, name: str, value: Any) -> Setting:
        """Return where a setting with a value stands; None is to be left out, which stands alone."""
        known = self._by_name.get(name) or Setting(
            name, "", name, Kind(text=self.other_text), self.other
        )
        return (
            replace(known, place="", pattern=self.absent)
            if value is None and self.absent
            else known
        )

    def writes(self, name: str) -> bool:
        """Return whether a target can state a setting; others are not changed."""
        return not self.is_closed or name in self._by_name

    def paste_text(self, changes: Settings) -> str:
        """Return changes of settings, new values by name, as text that can be pasted into the target."""
        grouped, alone = self._grouped(changes)
        parts = []
        for name, place in self.places.items():
            if grouped.get(name):
                text = place.form.format(", ".join(grouped[name]))
                if place.within:
                    grouped.setdefault(place.within, []).append(text)
                else:
                    parts.append(text)
        return self.joint.join(
            [*alone, *parts] if self.comes_last else [*parts, *alone]
        )

    def gravity_text(self, gravity_m_per_s2: Vector) -> str:
        """Return a gravity [m/s^2], shape [3], as text that can be pasted into the target."""
        return self.gravity.format(
            self.gravity_joint.join(
                number_text(round(g, 2) + 0.0) for g in gravity_m_per_s2
            )
        )

    def read(self, tables: Mapping[str, Table]) -> Iterator[tuple[str, Any, str]]:
        """Yield name, value and key of the settings of some places; for an absent key, the documented default.

        Args:
            tables: Table of each place.
        """
        for one in self.settings:
            table = tables.get(one.place)
            if table is not None:
                key = next(
                    (key for key in (one.key, *one.others) if key in table), one.key
                )
                value = one.kind.read(table, key)
                yield one.name, one.default if value is None else value, table.name(key)

    def _entry(self, one: Setting, value: Any) -> str:
        return (one.pattern or self.pattern).format(
            place=one.place, key=one.key, value=self._text(one, value)
        )

    def _text(self, one: Setting, value: Any) -> str:
        return (
            number_text(value) if value is None else (one.kind.text or self.text)(value)
        )

    def _grouped(self, changes: Settings) -> tuple[dict[str, list[str]], list[str]]:
        """Return assignments by their place, and those that stand alone."""
        grouped: dict[str, list[str]] = {}
        alone = []
        for name, value in changes.items():
            one = self.setting(name, value)
            place = self.places.get(one.place, Place(form="{}", is_alone=True))
            if place.is_alone:
                alone.append(place.form.format(self._entry(one, value)))
            else:
                grouped.setdefault(one.place, []).append(self._entry(one, value))
        return grouped, alone


TOML = Dialect(
    name="toml", text=toml_text, joint=", ", absent="no {key}", gravity="gravity = [{}]"
)
"""Lines of a settings file, which has one set of contact constants: `cone = "elliptic"`."""
