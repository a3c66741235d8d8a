"""Recipes, what contact settings mean, and measured materials and fabrics, as tables."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from itertools import repeat
from typing import Any

from gauge_envs.pages.document import Document, Heading, Paragraph, Part
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.scene.fabrics import Fabric, bending_length_m
from gauge_envs.tools.recipes import Recipe
from gauge_envs.tools.recipes.explain import Meaning
from gauge_envs.tools.recipes.fabrics import FabricRecipe, fabric_constants
from gauge_envs.tools.recipes.materials import MaterialPair

TITLES = {
    "friction_hopping": "friction, hopping",
    "penetration_m": "penetration [m]",
    "creep_m_s": "creep [m/s]",
    "torsion_m": "torsion [m]",
    "rolling_m": "rolling [m]",
    "time_constant_s": "time constant [s]",
    "stretch_n_per_m": "stretch [N/m]",
    "shear_n_per_m": "shear [N/m]",
    "bend_n_m": "bend [N m]",
    "bending_length_m": "bending length [m]",
}
"""Titles of values whose names carry a unit."""


def _number(key: str, title: str, *, unit: str = "") -> Column:
    return Column(key, title, lambda value: f"{value:.4g}", unit=unit, is_number=True)


NAME = Column("name", "", lambda name: TITLES.get(name, name))
REACHED = (
    _number("reached", "reached"),
    # Less than 1e-12 is rounding.
    Column(
        "error",
        "error",
        lambda value: f"{value:+.2g}" if abs(value) > 1e-12 else "0",
        is_number=True,
    ),
)


def recipe_document(recipe: Recipe, pair: MaterialPair | None = None) -> Document:
    """Return what was asked and reached, and the reason of a miss, below the measured pair that was asked for."""
    table = Table(
        columns=(
            Column("name", recipe.engine, NAME.format),
            _number("asked", "asked"),
            *REACHED,
        ),
        rows=[
            {
                "name": name,
                "asked": recipe.asked.get(name),
                "reached": value,
                "error": recipe.error.get(name),
            }
            for name, value in recipe.reached.items()
        ],
        notes=("", recipe.explanation, f"{recipe.wall_s:.1f} s"),
    )
    return Document(
        parts=(*([] if pair is None else [material_table((pair,))]), table),
        rows=[recipe.json() | ({} if pair is None else {"material": dict(vars(pair))})],
    )


def meaning_document(meaning: Meaning) -> Document:
    """Return what settings give by simulation and in closed form."""
    expected: Mapping[str, Any] = meaning.expected or {}
    table = Table(
        columns=(
            Column("name", meaning.engine, NAME.format),
            _number("reached", "simulated"),
            _number("expected", "closed form"),
        ),
        rows=[
            {"name": name, "reached": value, "expected": expected.get(name)}
            for name, value in meaning.reached.items()
        ],
        notes=("", meaning.explanation),
    )
    return Document(parts=(table,), rows=[meaning.json()])


def material_table(pairs: tuple[MaterialPair, ...]) -> Table:
    """Return the measured pairs with sources and standard uncertainties."""
    uncertain = {source: None for pair in pairs for source in pair.uncertainty_sources}
    return Table(
        columns=(
            Column("name", "material"),
            _number("friction", "friction"),
            _number("friction_std", "std"),
            _number("restitution", "restitution"),
            _number("restitution_std", "std"),
            _number("mass_kg", "mass", unit="kg"),
            Column("what", "bodies", place=Place.BELOW),
            Column("source", "source", place=Place.BELOW),
        ),
        rows=pairs,
        notes=(
            "",
            "A dash is a number that was not measured, or an uncertainty that is not published.",
            *uncertain,
        ),
    )


PUBLISHED = (
    "",
    "Values of tables, for clean and dry surfaces. Samples of one pair differ, steel by a factor of five: measure.",
    "CTU Code: IMO, ILO and UNECE, Code of Practice for Packing of Cargo Transport Units, annex 7, appendix 2; its "
    "dynamic value is 75 % of the static one.",
    "CDA3000: Lust, Engineering Guide CDA3000, appendix A. Surface Improvement: Handbook of Surface Improvement and "
    "Modification, p. 167. SAE 2001-01-2755: Strauss, Carnahan, Inendino.",
)


def published_table(rows: list[dict[str, str]]) -> Table:
    """Return friction of further pairs with its sources."""
    names = {
        "name": "pair",
        "static": "static",
        "dynamic": "dynamic",
        "rolling_mm": "rolling [mm]",
        "source": "source",
    }
    return Table(
        columns=tuple(Column(*one) for one in names.items()), rows=rows, notes=PUBLISHED
    )


# --- fabrics ---------------------------------------------------------------------------------------------------------


def fabric_document(recipe: FabricRecipe) -> Document:
    """Return what a fabric's constants give by the engine's law and in simulation, and what is lost."""
    law = recipe.mapping_gives
    keys = ("stretch_n_per_m", "shear_n_per_m", "bend_n_m", "bending_length_m")
    table = Table(
        columns=(
            Column("name", f"{recipe.name} in {recipe.engine}", NAME.format),
            _number("asked", "asked"),
            _number("law", "law of the engine"),
            *REACHED,
        ),
        rows=[
            {
                "name": key,
                "asked": recipe.asked[key],
                "law": law.get(key),
                "reached": recipe.reached[key],
                "error": recipe.error[key],
            }
            for key in keys
        ],
        notes=("", recipe.explanation, f"{recipe.wall_s:.1f} s"),
    )
    return Document(parts=(table,), rows=[recipe.json()])


def fabric_table(known: Mapping[str, Fabric]) -> Table:
    """Return the measured fabrics with what was measured."""
    return Table(
        columns=(
            Column("name", "fabric"),
            _number("stretch", "stretch", unit="N/m"),
            _number("shear", "shear", unit="N/m"),
            _number("bend", "bend", unit="N m/rad"),
            _number("density", "areal density", unit="kg/m^2"),
            _number("length", "bending length", unit="m"),
        ),
        rows=[
            {
                "name": name,
                "stretch": fabric.stretch_stiffness_n_per_m,
                "shear": fabric.shear_stiffness_n_per_m,
                "bend": fabric.bend_stiffness_n_m_per_rad,
                "density": fabric.areal_density_kg_per_m2,
                "length": bending_length_m(fabric),
            }
            for name, fabric in known.items()
        ],
    )


MEASURED = {
    "K_s [N/m]": "stretch_stiffness_n_per_m",
    "K_sh [N/m]": "shear_stiffness_n_per_m",
    "K_theta [N m/rad]": "bend_stiffness_n_m_per_rad",
    "thickness [m]": "thickness_m",
    "areal density [kg/m^2]": "areal_density_kg_per_m2",
}
"""Attributes of the measured constants by title."""


def constants_document(fabrics: Mapping[str, Fabric]) -> Document:
    """Return the constants of every fabric in every engine's terms, what they give, and every fall-back and loss.

    Its row has the constants by fabric, engine and constant.
    """
    rows: list[dict[str, Any]] = []

    def add(
        source: str,
        constant: str,
        values: Iterable[float],
        marks: Iterable[str] = repeat(" "),
    ) -> None:
        marked = zip(values, marks, strict=False)
        rows.append(
            {"source": source, "constant": constant}
            | dict(zip(fabrics, marked, strict=True))
        )

    for title, attribute in MEASURED.items():
        add(
            "measured",
            title,
            (getattr(fabric, attribute) for fabric in fabrics.values()),
        )
    add("measured", "bending length [m]", map(bending_length_m, fabrics.values()))
    notes: list[Part] = []
    constants = {name: fabric_constants(fabric) for name, fabric in fabrics.items()}
    for engine in next(iter(constants.values())):
        mapped = [of_fabric[engine] for of_fabric in constants.values()]
        for constant, unit in mapped[0].units.items():
            marks = ("*" if constant in one.replaced else " " for one in mapped)
            add(
                engine,
                f"{constant} [{unit}]",
                (one.constants[constant] for one in mapped),
                marks,
            )
        add(
            engine, "gives K_s [N/m]", (one.stretch_stiffness_n_per_m for one in mapped)
        )
        marks = ("!" if one.lost else " " for one in mapped)
        add(
            engine,
            "gives K_sh [N/m]",
            (one.shear_stiffness_n_per_m for one in mapped),
            marks,
        )
        losses = {
            name: "; ".join((*one.fallbacks, *one.lost))
            for name, one in zip(fabrics, mapped, strict=True)
        }
        if any(losses.values()):
            notes += [
                Heading(engine),
                *(
                    Paragraph(f"{name}: {text}")
                    for name, text in losses.items()
                    if text
                ),
            ]
    narrow, wide = (
        [
            Column(name, name, partial(_constant_text, digits=digits), is_number=True)
            for name in fabrics
        ]
        for digits in (3, 4)
    )
    values = [replace(column, narrow_only=True) for column in narrow]
    values += [replace(column, wide_only=True) for column in wide]
    table = Table(
        columns=(
            Column("source", "source", place=Place.HEADING),
            Column("constant", "constant"),
            *values,
        ),
        rows=rows,
        notes=("", "* set by a fall-back   ! not the measured shear stiffness"),
    )
    row = {
        name: {engine: one.constants for engine, one in known.items()}
        for name, known in constants.items()
    }
    return Document(parts=(table, *notes), rows=[row])


def _constant_text(marked: tuple[float, str], *, digits: int) -> str:
    """Return a constant to some digits, with a short exponent for a large or small one, and its mark."""
    value, mark = marked
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return (f"{value:.0f}" if abs(value) >= 1e3 else f"{value:.{digits}g}") + mark
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}{mark}"
