"""Recipes, what contact settings mean, and measured materials, as tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gauge_envs.checks.recipes import Recipe
from gauge_envs.checks.recipes.explain import Meaning
from gauge_envs.checks.recipes.materials import MaterialPair
from gauge_envs.errors import ParameterError
from gauge_envs.report.table import Column, Place, Table, TerminalTable, as_rich
from gauge_envs.scene.fabrics import MAPPINGS, EngineConstants, Fabric, shear_stiffness, uniaxial_stiffness

__all__ = ["fabric_recipe", "fabric_view", "material_table", "meaning_view", "recipe_view"]

TITLES = {
    "penetration_m": "penetration [m]",
    "creep_m_s": "creep [m/s]",
    "time_constant_s": "time constant [s]",
}
"""Titles of values whose names carry a unit."""


def _number(value: float) -> str:
    return f"{value:.4g}"


def recipe_view(recipe: Recipe) -> TerminalTable:
    """Return what was asked and reached, and the reason of a miss."""
    asked = {"friction": recipe.aim.friction, "restitution": recipe.aim.rebound, "penetration_m": recipe.aim.depth_m}
    rows = [
        {"name": TITLES.get(name, name), "asked": asked.get(name), "reached": value, "error": recipe.error.get(name)}
        for name, value in recipe.reached.items()
    ]
    columns = (
        Column("name", recipe.engine),
        Column("asked", "asked", _number, is_number=True),
        Column("reached", "reached", _number, is_number=True),
        Column("error", "error", lambda value: f"{value:+.2g}", is_number=True),
    )
    return as_rich(Table(columns=columns, rows=rows, notes=("", recipe.explanation)))


def meaning_view(meaning: Meaning) -> TerminalTable:
    """Return what settings give by simulation and in closed form."""
    expected: Mapping[str, Any] = meaning.expected or {}
    rows = [
        {"name": TITLES.get(name, name), "reached": value, "expected": expected.get(name)}
        for name, value in meaning.reached.items()
    ]
    columns = (
        Column("name", meaning.engine),
        Column("reached", "simulated", _number, is_number=True),
        Column("expected", "closed form", _number, is_number=True),
    )
    return as_rich(Table(columns=columns, rows=rows, notes=("", meaning.explanation)))


def _uncertain(value: float, std: float | None) -> str:
    return f"{value:.3g}" if std is None else f"{value:.4f} +- {std:.4f}"


def material_table(pairs: tuple[MaterialPair, ...]) -> Table:
    """Return the measured pairs with sources and standard uncertainties."""
    columns = (
        Column("name", "material"),
        Column("friction", "friction", _number, is_number=True),
        Column("friction_std", "std", _number, is_number=True),
        Column("restitution", "restitution", _number, is_number=True),
        Column("restitution_std", "std", _number, is_number=True),
        Column("mass_kg", "mass", _number, unit="kg", is_number=True),
        Column("what", "bodies", place=Place.BELOW),
        Column("source", "source", place=Place.BELOW),
    )
    uncertain = sorted({pair.uncertainty_source for pair in pairs if pair.uncertainty_source})
    notes = ("", "A dash is a number that was not measured, or an uncertainty that is not published.", *uncertain)
    return Table(columns=columns, rows=pairs, notes=notes)


# --- fabrics ---------------------------------------------------------------------------------------------------------


def fabric_recipe(name: str, fabric: Fabric, engine: str) -> dict[str, Any]:
    """Return a fabric in an engine's constants, the stiffness that they give, and what is lost.

    Args:
        name: Name of the fabric.
        fabric: Its measured constants.
        engine: Key of `gauge_envs.scene.fabrics.MAPPINGS`.

    Raises:
        ParameterError: The engine has no mapping of cloth.
    """
    mapped = _mapped(engine, fabric)
    asked = {"stretch_n_per_m": fabric.stretch_stiffness_n_per_m, "shear_n_per_m": fabric.shear_stiffness_n_per_m}
    reached = {"stretch_n_per_m": uniaxial_stiffness(mapped), "shear_n_per_m": shear_stiffness(mapped)}
    losses = [*mapped.fallbacks, *mapped.lost]
    return {
        "engine": engine,
        "fabric": name,
        "asked": asked | {"bend_n_m_per_rad": fabric.bend_stiffness_n_m_per_rad},
        "settings": mapped.constants,
        "snippet": fabric_snippet(mapped),
        "reached": reached,
        "error": {key: reached[key] - asked[key] for key in reached},
        "explanation": "; ".join(losses) or "Stretch and shear stiffness are reached.",
    }


def _mapped(engine: str, fabric: Fabric) -> EngineConstants:
    key = "isaac" if engine == "isaac_sim" else engine
    if key not in MAPPINGS:
        raise ParameterError(f"engine {engine!r} has no mapping of fabrics: choose one of {', '.join(MAPPINGS)}")
    return MAPPINGS[key](fabric)


def fabric_snippet(mapped: EngineConstants) -> str:
    """Return the constants of a fabric in the engine's own language."""
    given = {name: f"{value:.6g}" for name, value in mapped.constants.items()}
    if mapped.engine == "newton":
        bend = given["edge_ke_times_mean_edge_length"]
        return (
            "builder.add_cloth_mesh(\n"
            f"    ...,\n    tri_ke={given['tri_ke']},\n    tri_ka={given['tri_ka']},\n"
            f"    edge_ke={bend} / mean_edge_length,  # mean length of the edges of your mesh [m]\n)\n"
        )
    if mapped.engine == "mujoco":
        return (
            f'<elasticity young="{given["young"]}" poisson="{given["poisson"]}" thickness="{given["thickness"]}" '
            'elastic2d="both"/>\n'
            "<!-- MJCF states no shear stiffness: this flex has half of the stretch stiffness. -->\n"
        )
    if mapped.engine == "genesis":
        names = ", ".join(f"{name}={value}" for name, value in given.items())
        return f"material = gs.materials.PBD.Cloth({names})\n"
    return "".join(f"{name} = {value}  # {mapped.units[name]}\n" for name, value in given.items())


def fabric_view(values: Mapping[str, Any]) -> TerminalTable:
    """Return what a fabric's constants give, and what is lost."""
    names = {"stretch_n_per_m": "stretch [N/m]", "shear_n_per_m": "shear [N/m]", "bend_n_m_per_rad": "bend [N m/rad]"}
    rows = [
        {"name": title, "asked": values["asked"][key], "reached": values["reached"].get(key)}
        for key, title in names.items()
    ]
    columns = (
        Column("name", f"{values['fabric']} in {values['engine']}"),
        Column("asked", "measured", _number, is_number=True),
        Column("reached", "mapping gives", _number, is_number=True),
    )
    return as_rich(Table(columns=columns, rows=rows, notes=("", str(values["explanation"]))))
