"""Write changes of settings in MJCF, as a MuJoCo model states them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gauge_envs.tools.sanity.languages.base import Language, number_text
from gauge_envs.tools.sanity.languages.toml import toml_value

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


OVERRIDDEN = "o_friction"
"""Setting that MJCF leaves out by switching the flag `override` off."""


class Mjcf(Language):
    """Elements of a MuJoCo model: `<option cone="elliptic"/>`, `<default><geom solref="0.02 1"/></default>`."""

    name = "mjcf"

    def assignment(self, name: str, value: Any) -> str:
        """Return `attribute="value"`; a setting that MJCF has no attribute for is written as in TOML."""
        if value is None and name == OVERRIDDEN:
            return 'override="disable"'
        if value is None:
            return f"no {OPTION.get(name) or GEOM.get(name) or name}"
        if name in FLAG:
            return f'{name}="{"enable" if value else "disable"}"'
        attribute = OPTION.get(name) or GEOM.get(name)
        if attribute is None:
            return f"{name} = {toml_value(value)}"
        return f'{attribute}="{_attribute(value)}"'

    def paste_text(self, changes: Mapping[str, Any], *, geoms: str = "") -> str:
        """Return elements: `<option>` with its flags, and `<geom>` for some geoms or as the default of all."""
        kinds: dict[str, list[str]] = {"option": [], "flag": [], "geom": [], "rest": []}
        for name, value in changes.items():
            kind = _kind(name, value)
            kinds[kind].append(self.assignment(name, value))
        option, flags, geom, rest = kinds.values()
        inner = f"<flag {' '.join(flags)}/>" if flags else ""
        parts = []
        if option or flags:
            head = " ".join(["<option", *option])
            parts.append(f"{head}>{inner}</option>" if inner else f"{head}/>")
        if geom:
            text = f"<geom {' '.join(geom)}/>"
            parts.append(f"{text} for {geoms}" if geoms else f"<default>{text}</default>")
        return " and ".join([*parts, *rest])

    def gravity_text(self, gravity_m_per_s2: tuple[float, float, float]) -> str:
        """Return `<option gravity="x y z"/>`."""
        value = tuple(round(component, 2) + 0.0 for component in gravity_m_per_s2)
        return f'<option gravity="{_attribute(value)}"/>'


def _kind(name: str, value: Any) -> str:
    """Return the element in which a setting stands."""
    if name in FLAG or (name == OVERRIDDEN and value is None):
        return "flag"
    if value is None:
        return "rest"
    return "option" if name in OPTION else "geom" if name in GEOM else "rest"


def _attribute(value: Any) -> str:
    """Return a value of an MJCF attribute."""
    return " ".join(map(number_text, value)) if isinstance(value, list | tuple) else number_text(value)
