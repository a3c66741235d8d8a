"""Write changes of settings in Python, as a user of Newton states them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gauge_envs.tools.sanity.languages.base import Language, number_text
from gauge_envs.tools.sanity.languages.toml import toml_value

SOLVER = {
    "integrator": "integrator",
    "cone": "cone",
    "impratio": "impratio",
    "iterations": "iterations",
    "line_search_iterations": "ls_iterations",
    "tolerance": "tolerance",
    "mujoco_contacts": "use_mujoco_contacts",
    "njmax": "njmax",
    "naconmax": "nconmax",
}
"""Arguments of `SolverMuJoCo` by name of the setting."""

SHAPE = ("contact_solref", "contact_kf_n_s_per_m")
"""Settings that are arguments of `ShapeConfig`."""

ATTRIBUTE = {"contact_solimp": "geom_solimp"}
"""Attributes of `model.mujoco` by name of the setting."""


class Newton(Language):
    """Python of Newton: `SolverMuJoCo(model, iterations=100)`, `ShapeConfig(ke=2500, kd=100)`."""

    name = "newton"

    def assignment(self, name: str, value: Any) -> str:
        """Return arguments as Python writes them; a setting that Newton does not have is written as in TOML."""
        if name == "timestep_s":
            return f"dt={number_text(value)}"
        if name in SOLVER:
            return f"{SOLVER[name]}={_python(value)}"
        if name == "contact_kf_n_s_per_m":
            return f"kf={number_text(value)}"
        if name == "contact_solref":
            return _shape_text(value)
        if name in ATTRIBUTE:
            return f"{ATTRIBUTE[name]}={_python(value)}"
        return f"{name} = {toml_value(value)}"

    def value_text(self, name: str, value: Any) -> str:
        """Return the value of a setting alone; the stiffness and damping of shapes with their names."""
        return _shape_text(value) if name == "contact_solref" else super().value_text(name, value)

    def paste_text(self, changes: Mapping[str, Any], *, geoms: str = "") -> str:
        """Return a call of the solver, the shapes' configuration, attributes of the model, and the step."""
        parts = []
        solver = [self.assignment(name, value) for name, value in changes.items() if name in SOLVER]
        shape = [self.assignment(name, value) for name, value in changes.items() if name in SHAPE]
        if solver:
            parts.append(f"SolverMuJoCo(model, {', '.join(solver)})")
        if shape:
            raw = any(part.startswith("solref=") for part in shape)
            text = f"model.mujoco.{shape[0]}" if raw and len(shape) == 1 else f"ShapeConfig({', '.join(shape)})"
            parts.append(f"{text} for {geoms}" if geoms else text)
        for name, value in changes.items():
            if name in ATTRIBUTE:
                parts.append(f"model.mujoco.{self.assignment(name, value)}")
            elif name == "timestep_s":
                parts.append(f"solver.step(..., {self.assignment(name, value)})")
            elif name not in SOLVER and name not in SHAPE:
                parts.append(self.assignment(name, value))
        return " and ".join(parts)

    def gravity_text(self, gravity_m_per_s2: tuple[float, float, float]) -> str:
        """Return `model.set_gravity((x, y, z))`."""
        x, y, z = (f"{round(component, 2) + 0.0:g}" for component in gravity_m_per_s2)
        return f"model.set_gravity(({x}, {y}, {z}))"


def stiffness_and_damping(solref: tuple[float, float]) -> tuple[float, float] | None:
    """Return `ke` and `kd` of shapes for which Newton computes a solref; None for a solref in the direct format.

    Newton computes the time constant 2 / kd and the damping ratio kd / (2 sqrt(ke)).
    """
    time_constant, ratio = solref
    if time_constant <= 0.0 or ratio <= 0.0:
        return None
    damping = 2.0 / time_constant
    return (0.5 * damping / ratio) ** 2, damping


def _shape_text(solref: Any) -> str:
    found = stiffness_and_damping(solref)
    if found is None:
        return f"solref={_python(solref)}"
    return f"ke={found[0]:.6g}, kd={found[1]:.6g}"


def _python(value: Any) -> str:
    """Return a value as Python writes it."""
    if isinstance(value, list | tuple):
        return f"({', '.join(map(_python, value))})"
    return f'"{value}"' if isinstance(value, str) else number_text(value)
