"""Write changes of settings as lines of a settings file in TOML."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gauge_envs.tools.sanity.languages.base import Language, number_text


class Toml(Language):
    """Lines of a settings file: `cone = "elliptic"`."""

    name = "toml"

    def assignment(self, name: str, value: Any) -> str:
        """Return `name = value`; `no name` for a setting that is to be left out."""
        return f"no {name}" if value is None else f"{name} = {toml_value(value)}"

    def paste_text(self, changes: Mapping[str, Any], *, geoms: str = "") -> str:
        """Return the lines, separated by commas; a settings file has one set of contact constants."""
        return ", ".join(self.assignment(name, value) for name, value in changes.items())

    def gravity_text(self, gravity_m_per_s2: tuple[float, float, float]) -> str:
        """Return `gravity = [x, y, z]`."""
        return f"gravity = {toml_value(tuple(round(component, 2) + 0.0 for component in gravity_m_per_s2))}"


def toml_value(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    return f'"{value}"' if isinstance(value, str) else number_text(value)
