"""Define a dialect: how changes of settings are written in the language of a target."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gauge_envs.tools.sanity.training import Settings

Entries = Mapping[str, Sequence[str]]
"""Assignments by their place."""

# --- texts -----------------------------------------------------------------------------------------------------------


def number_text(value: Any) -> str:
    """Return a number with six digits at most."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def toml_text(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_text, value))}]"
    text = f'"{value}"' if isinstance(value, str) else number_text(value)
    return text.lower() if isinstance(value, bool) else text


ASSIGNMENT = "{key} = {value}"


def commas(entries: Entries) -> str:
    """Return all assignments in a row."""
    return ", ".join(entry for assignments in entries.values() for entry in assignments)


# --- settings --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """One setting of a backend in a language.

    Attributes:
        name: Name of the backend's setting.
        place: Element that has the key.
        key: Its key there.
        text: Function from its value to its text; that of the dialect if None.
    """

    name: str
    place: str
    key: str
    text: Callable[[Any], str] | None = None


@dataclass(frozen=True, kw_only=True)
class Dialect:
    """Language in which targets of a kind give their settings.

    Attributes:
        name: Name that a `TrainingConfiguration` refers to.
        settings: Settings that have another name or place in the language.
        pattern: Form of an assignment with `{key}` and `{value}`.
        text: Function from a value to its text.
        join: Function from all assignments to the text that is pasted.
    """

    name: str
    settings: tuple[Setting, ...] = ()
    pattern: str = ASSIGNMENT
    text: Callable[[Any], str] = toml_text
    join: Callable[[Entries], str] = commas

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
            setting = known.get(name)
            form = ASSIGNMENT if setting is None else self.pattern
            setting = setting or Setting(name, "", name)
            if value is None and setting.text is None:
                form = "no {key}"
            text = self.value_text(setting, value)
            entry = form.format(key=setting.key, value=text)
            entries.setdefault(setting.place, []).append(entry)
        return self.join(entries)


TOML = Dialect(name="toml")
"""Lines of a settings file, which has one set of contact constants: `cone = "elliptic"`."""
