"""Recipes, what contact settings mean, and measured materials, as tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from gauge_envs.pages.table import Column, Place, Table, TerminalTable, as_rich
from gauge_envs.scene.fabrics import Fabric, bending_length_m

if TYPE_CHECKING:
    from gauge_envs.tools.recipes import Recipe
    from gauge_envs.tools.recipes.explain import Meaning
    from gauge_envs.tools.recipes.fabrics import FabricRecipe
    from gauge_envs.tools.recipes.materials import MaterialPair

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
    friction = recipe.aim.friction if recipe.aim.is_friction_asked else None
    asked = {"friction": friction, "restitution": recipe.aim.rebound, "penetration_m": recipe.aim.depth_m}
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
    return as_rich(Table(columns=columns, rows=rows, notes=("", recipe.explanation, f"{recipe.wall_s:.1f} s")))


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

FABRIC_TITLES = {
    "stretch_n_per_m": "stretch [N/m]",
    "shear_n_per_m": "shear [N/m]",
    "bend_n_m": "bend [N m]",
    "bending_length_m": "bending length [m]",
}
"""Titles of the stiffness of a fabric."""


def fabric_view(recipe: FabricRecipe) -> TerminalTable:
    """Return what a fabric's constants give by the engine's law and in simulation, and what is lost."""
    gives = recipe.mapping_gives
    rows = [
        {
            "name": title,
            "asked": recipe.asked[key],
            "law": gives.get(key),
            "reached": recipe.reached[key],
            "error": recipe.error[key],
        }
        for key, title in FABRIC_TITLES.items()
    ]
    columns = (
        Column("name", f"{recipe.name} in {recipe.engine}"),
        Column("asked", "asked", _number, is_number=True),
        Column("law", "law of the engine", _number, is_number=True),
        Column("reached", "reached", _number, is_number=True),
        Column("error", "error", lambda value: f"{value:+.2g}", is_number=True),
    )
    return as_rich(Table(columns=columns, rows=rows, notes=("", recipe.explanation, f"{recipe.wall_s:.1f} s")))


def fabric_table(known: Mapping[str, Fabric]) -> Table:
    """Return the measured fabrics with what was measured."""
    rows = [
        {
            "name": name,
            "stretch": fabric.stretch_stiffness_n_per_m,
            "shear": fabric.shear_stiffness_n_per_m,
            "bend": fabric.bend_stiffness_n_m_per_rad,
            "density": fabric.areal_density_kg_per_m2,
            "length": bending_length_m(fabric),
        }
        for name, fabric in known.items()
    ]
    columns = (
        Column("name", "fabric"),
        Column("stretch", "stretch", _number, unit="N/m", is_number=True),
        Column("shear", "shear", _number, unit="N/m", is_number=True),
        Column("bend", "bend", _number, unit="N m/rad", is_number=True),
        Column("density", "areal density", _number, unit="kg/m^2", is_number=True),
        Column("length", "bending length", _number, unit="m", is_number=True),
    )
    return Table(columns=columns, rows=rows)
