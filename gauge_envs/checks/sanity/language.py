"""Write changes of settings in the language of a target, so that they can be pasted: MJCF or a settings file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["Language", "assignment", "gravity_text", "paste_text"]

OPTION = {
    "timestep_s": "timestep",
    "integrator": "integrator",
    "cone": "cone",
    "impratio": "impratio",
    "solver": "solver",
    "iterations": "iterations",
    "tolerance": "tolerance",
    "ls_iterations": "ls_iterations",
    "ls_tolerance": "ls_tolerance",
    "noslip_iterations": "noslip_iterations",
    "noslip_tolerance": "noslip_tolerance",
    "ccd_iterations": "ccd_iterations",
    "ccd_tolerance": "ccd_tolerance",
    "sleep_tolerance": "sleep_tolerance",
}
"""Attributes of MJCF's `<option>` by name of the setting."""

FLAG = ("warmstart", "refsafe", "eulerdamp", "nativeccd", "multiccd", "island", "diagexact", "sleep", "speculative")
"""Attributes of MJCF's `<option><flag>`; settings have the same names."""

GEOM = {
    "contact_solref": "solref",
    "contact_solimp": "solimp",
    "contact_margin_m": "margin",
    "contact_gap_m": "gap",
    "condim": "condim",
}
"""Attributes of MJCF's `<geom>` by name of the setting."""


@dataclass(frozen=True, kw_only=True)
class Language:
    """Language in which a target states its settings.

    Attributes:
        is_mjcf: Whether the target is a MuJoCo model; a settings file in TOML otherwise.
        geoms: Geoms that the contact constants belong to, when there are several sets; empty for all geoms.
    """

    is_mjcf: bool = False
    geoms: str = ""


def assignment(language: Language, name: str, value: Any) -> str:
    """Return one setting as it is written: `solref="0.02 1"` in MJCF, `cone = "elliptic"` in a settings file."""
    if value is None:
        return 'override="disable"' if language.is_mjcf else f"no {name}"
    if not language.is_mjcf:
        return f"{name} = {_toml(value)}"
    if name in FLAG:
        return f'{name}="{"enable" if value else "disable"}"'
    attribute = OPTION.get(name) or GEOM.get(name)
    if attribute is None:
        return f"{name} = {_toml(value)}"
    return f'{attribute}="{_attribute(value)}"'


def paste_text(language: Language, changes: Mapping[str, Any]) -> str:
    """Return changes of settings as text that can be pasted into the target."""
    if not language.is_mjcf:
        return ", ".join(assignment(language, name, value) for name, value in changes.items())
    kinds: dict[str, list[str]] = {"option": [], "flag": [], "geom": [], "rest": []}
    for name, value in changes.items():
        is_flag = name in FLAG or value is None
        kind = "flag" if is_flag else "option" if name in OPTION else "geom" if name in GEOM else "rest"
        kinds[kind].append(assignment(language, name, value))
    option, flags, geom, rest = kinds.values()
    inner = f"<flag {' '.join(flags)}/>" if flags else ""
    parts = []
    if option or flags:
        head = " ".join(["<option", *option])
        parts.append(f"{head}>{inner}</option>" if inner else f"{head}/>")
    if geom:
        text = f"<geom {' '.join(geom)}/>"
        parts.append(f"{text} for {language.geoms}" if language.geoms else f"<default>{text}</default>")
    return " and ".join([*parts, *rest])


def gravity_text(language: Language, gravity_m_per_s2: tuple[float, float, float]) -> str:
    """Return a gravity as text that can be pasted into the target."""
    value = tuple(round(component, 2) + 0.0 for component in gravity_m_per_s2)
    return f'<option gravity="{_attribute(value)}"/>' if language.is_mjcf else f"gravity = {_toml(value)}"


def _attribute(value: Any) -> str:
    """Return a value of an MJCF attribute."""
    return " ".join(map(_number, value)) if isinstance(value, list | tuple) else _number(value)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else _number(value)


def _number(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
