"""Write settings as elements of MJCF: `<option cone="elliptic"/>`, `<default><geom solref="0.02 1"/></default>`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from gauge_envs.backends.mujoco.options import (
    DISABLE_FLAGS,
    ENABLE_FLAGS,
    NAMED_OPTIONS,
    SAME_NAME_OPTIONS,
)
from gauge_envs.tools.sanity.training import Settings


def attribute_text(value: Any) -> str:
    """Return a value as an attribute: numbers with six digits, lists with spaces."""
    values = value if isinstance(value, list | tuple) else [value]
    return " ".join(f"{n:.6g}" if isinstance(n, float) else str(n) for n in values)


class Attribute(NamedTuple):
    """An attribute of MJCF.

    Attributes:
        place: Element that has it.
        key: Its name there.
        text: Function from a value of the setting to its text.
    """

    place: str
    key: str
    text: Callable[[Any], str] = attribute_text


OPTIONS = (*NAMED_OPTIONS, *SAME_NAME_OPTIONS, "jacobian")
"""Settings that are called as in MJCF."""

ATTRIBUTES = {
    "timestep_s": Attribute("option", "timestep"),
    "contact_solref": Attribute("geom", "solref"),
    "contact_solimp": Attribute("geom", "solimp"),
    "contact_margin_m": Attribute("geom", "margin"),
    "contact_gap_m": Attribute("geom", "gap"),
    "condim": Attribute("geom", "condim"),
    "equality_solref": Attribute("equality", "solref"),
    "equality_solimp": Attribute("equality", "solimp"),
    **{name: Attribute("option", name) for name in OPTIONS},
    **{
        name: Attribute("flag", name, lambda is_on: "enable" if is_on else "disable")
        for name in (*DISABLE_FLAGS, *ENABLE_FLAGS)
    },
}
"""Attribute of each setting: of `<option>`, of its `<flag>`, and of the defaults."""


def paste_text(changes: Settings) -> str:
    """Return changes of settings, new values by name, as elements that can be pasted into a model."""
    entries: dict[str, str] = {}
    for name, value in changes.items():
        place, key, text = ATTRIBUTES[name]
        entries[place] = f'{entries.get(place, "")} {key}="{text(value)}"'
    flags = entries.pop("flag", "")
    option = entries.pop("option", "")
    end = f"><flag{flags}/></option>" if flags else "/>"
    parts = [f"<option{option}{end}"] if option or flags else []
    parts += [f"<default><{kind}{entries[kind]}/></default>" for kind in entries]
    return " and ".join(parts)
