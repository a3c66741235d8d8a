"""Write changes of settings in Python, as a program states them for a Genesis scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gauge_envs.tools.sanity.languages.base import Language, number_text

OPTION = {
    "iterations": "iterations",
    "tolerance": "tolerance",
    "line_search_iterations": "ls_iterations",
    "line_search_tolerance": "ls_tolerance",
    "noslip_iterations": "noslip_iterations",
    "impratio": "impratio",
    "pruning_tolerance": "contact_pruning_tolerance",
    "multi_contact": "enable_multi_contact",
    "box_box_detection": "box_box_detection",
    "gjk": "use_gjk_collision",
}
"""Arguments of `gs.options.RigidOptions` by name of the setting."""

CHOICE = ("integrator", "constraint_solver", "friction_cone", "contact_resolution")
"""Arguments of `gs.options.RigidOptions` that take a constant of Genesis; settings have the same names."""

CONSTANT = {"sustained_timeconst_s": "0", "sustained_dampratio": "1", "sustained_impedance": "2:5"}
"""Columns of `sol_params` by name of the setting."""


class GenesisPython(Language):
    """Arguments of a `gs.Scene`, such as `rigid_options=gs.options.RigidOptions(iterations=100)`."""

    name = "genesis"

    def assignment(self, name: str, value: Any) -> str:
        """Return `argument=value`; a column of `sol_params` for constants of contacts."""
        if name == "timestep_s":
            return f"dt={number_text(value)}"
        if name == "precision":
            return f'precision="{value}"'
        if name in CHOICE:
            return f"{name}=gs.{name}.{value}"
        if name in CONSTANT:
            return f"sol_params[:, {CONSTANT[name]}] = {_column_text(value)}"
        return f"{OPTION.get(name, name)}={_python(value)}"

    def paste_text(self, changes: Mapping[str, Any], *, geoms: str = "") -> str:
        """Return arguments of `gs.Scene` and `gs.init`, and statements for constants of contacts."""
        kinds: dict[str, list[str]] = {"init": [], "sim": [], "rigid": [], "constants": [], "rest": []}
        for name, value in changes.items():
            kind = "init" if name == "precision" else "sim" if name == "timestep_s" else "rest"
            kind = "rigid" if name in OPTION or name in CHOICE else "constants" if name in CONSTANT else kind
            kinds[kind].append(self.assignment(name, value))
        init, sim, rigid, constants, rest = kinds.values()
        parts = [f"gs.init({', '.join(init)})"] if init else []
        parts += [f"sim_options=gs.options.SimOptions({', '.join(sim)})"] if sim else []
        parts += [f"rigid_options=gs.options.RigidOptions({', '.join(rigid)})"] if rigid else []
        if constants:
            place = f" for {geoms}" if geoms else ""
            parts.append(
                f"sol_params = scene.rigid_solver.get_sol_params(); {'; '.join(constants)}; "
                f"scene.rigid_solver.set_sol_params(sol_params){place}"
            )
        return " and ".join([*parts, *rest])

    def gravity_text(self, gravity_m_per_s2: tuple[float, float, float]) -> str:
        """Return `sim_options=gs.options.SimOptions(gravity=(x, y, z))`."""
        value = tuple(round(component, 2) + 0.0 for component in gravity_m_per_s2)
        return f"sim_options=gs.options.SimOptions(gravity={_python(value)})"

    def value_text(self, name: str, value: Any) -> str:
        """Return the value alone; of a constant of Genesis, its name."""
        return str(value) if name in CHOICE else _python(value)


def _python(value: Any) -> str:
    """Return a value as Python writes it, numbers with six digits."""
    if isinstance(value, list | tuple):
        return f"({', '.join(map(_python, value))})"
    return number_text(value) if isinstance(value, float) else repr(value)


def _column_text(value: Any) -> str:
    """Return a value for columns of a tensor."""
    return f"torch.tensor({_python(value)})" if isinstance(value, list | tuple) else number_text(value)
