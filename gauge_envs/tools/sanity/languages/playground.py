"""Write changes of settings for MuJoCo Playground: overrides of a task's configuration, and MJCF for all others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gauge_envs.tools.sanity.languages.base import number_text
from gauge_envs.tools.sanity.languages.mjcf import Mjcf

CONFIG = {"timestep_s": "sim_dt", "njmax": "njmax", "naconmax": "naconmax", "impl": "impl"}
"""Keys of a task's configuration by name of the setting. Other options stand in the task's XML file alone."""


class Playground(Mjcf):
    """Overrides of a configuration, `config_overrides={"sim_dt": 0.002}`, and elements of the task's XML file."""

    name = "playground"

    def assignment(self, name: str, value: Any) -> str:
        """Return `"key": value` for a key of the configuration, and `attribute="value"` of MJCF otherwise."""
        return f'"{CONFIG[name]}": {_literal(value)}' if name in CONFIG else super().assignment(name, value)

    def value_text(self, name: str, value: Any) -> str:
        """Return the value of a setting alone."""
        return _literal(value) if name in CONFIG else super().value_text(name, value)

    def paste_text(self, changes: Mapping[str, Any], *, geoms: str = "") -> str:
        """Return the argument `config_overrides` of `registry.load`, and elements of MJCF."""
        config = {name: value for name, value in changes.items() if name in CONFIG}
        rest = {name: value for name, value in changes.items() if name not in CONFIG}
        overrides = ", ".join(self.assignment(name, value) for name, value in config.items())
        parts = [f"config_overrides={{{overrides}}}"] if config else []
        return " and ".join([*parts, *([super().paste_text(rest, geoms=geoms)] if rest else [])])


def _literal(value: Any) -> str:
    """Return a value as Python writes it."""
    return repr(value) if isinstance(value, str) else number_text(value)
