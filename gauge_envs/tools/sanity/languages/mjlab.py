"""Write changes of settings as mjlab's configuration classes, as a task states them in Python."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gauge_envs.tools.sanity.languages.base import Language, number_text
from gauge_envs.tools.sanity.languages.mjcf import FLAG, GEOM, OPTION
from gauge_envs.tools.sanity.languages.toml import toml_value

SIMULATION = {"njmax": "njmax", "naconmax": "nconmax"}
"""Arguments of `SimulationCfg` by name of the setting; mjlab states contacts of one world."""


class Mjlab(Language):
    """Arguments of configuration classes: `SimulationCfg(mujoco=MujocoCfg(cone="elliptic"))`."""

    name = "mjlab"

    def assignment(self, name: str, value: Any) -> str:
        """Return `argument=value`; a setting that mjlab has no argument for is written as in TOML."""
        if value is None:
            return 'without the flag "override"'
        if name in FLAG:
            return f"disableflags={'()' if value else f'({name!r},)'}".replace("'", '"')
        argument = OPTION.get(name) or GEOM.get(name) or SIMULATION.get(name)
        return f"{name} = {toml_value(value)}" if argument is None else f"{argument}={_literal(value)}"

    def paste_text(self, changes: Mapping[str, Any], *, geoms: str = "") -> str:
        """Return `SimulationCfg(...)` with `MujocoCfg(...)` in it, and `CollisionCfg(...)` for contact constants."""
        mujoco = [self.assignment(one, value) for one, value in changes.items() if one in OPTION or one in FLAG]
        simulation = [self.assignment(one, value) for one, value in changes.items() if one in SIMULATION]
        contact = [self.assignment(one, value) for one, value in changes.items() if one in GEOM]
        known = {*OPTION, *FLAG, *SIMULATION, *GEOM}
        rest = [self.assignment(one, value) for one, value in changes.items() if one not in known]
        if mujoco:
            simulation.append(f"mujoco=MujocoCfg({', '.join(mujoco)})")
        parts = [f"SimulationCfg({', '.join(simulation)})"] if simulation else []
        if contact:
            parts.append(f"CollisionCfg({', '.join(contact)})" + (f" for {geoms}" if geoms else ""))
        return " and ".join([*parts, *rest])

    def gravity_text(self, gravity_m_per_s2: tuple[float, float, float]) -> str:
        """Return `SimulationCfg(mujoco=MujocoCfg(gravity=(x, y, z)))`."""
        value = tuple(round(component, 2) + 0.0 for component in gravity_m_per_s2)
        return f"SimulationCfg(mujoco=MujocoCfg(gravity={_literal(value)}))"


def _literal(value: Any) -> str:
    """Return a value as Python writes it; names of integrators, cones and solvers in lower case."""
    if isinstance(value, list | tuple):
        return f"({', '.join(map(number_text, value))})"
    return f'"{value.lower()}"' if isinstance(value, str) else number_text(value)
