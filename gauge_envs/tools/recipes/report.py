"""Report recipes, and measured materials and fabrics, as tables."""

from collections.abc import Mapping, Sequence

from gauge_envs.pages.document import Document, Part
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.scene.fabrics import Fabric, bending_length_m
from gauge_envs.tools.recipes.fabrics import fabric_constants
from gauge_envs.tools.recipes.materials import MaterialPair
from gauge_envs.tools.recipes.search import Recipe

TITLES = {
    "friction_hopping": "friction, hopping",
    "penetration_m": "penetration [m]",
    "creep_m_s": "creep [m/s]",
    "torsion_m": "torsion [m]",
    "rolling_m": "rolling [m]",
    "stretch_n_per_m": "stretch [N/m]",
    "shear_n_per_m": "shear [N/m]",
    "bend_n_m": "bend [N m]",
    "bending_length_m": "bending length [m]",
}
"""Titles of values whose names carry a unit."""


def _number(key: str, title: str, *, unit: str = "") -> Column:
    return Column(key, title, _digits, unit=unit, is_number=True)


def _digits(value: float) -> str:
    return f"{value:.4g}"


def _error_text(error: float) -> str:
    """Return the text of an error; errors below 1e-12 are rounding."""
    return f"{error:+.2g}" if abs(error) > 1e-12 else "0"


COLUMNS = {"asked": _digits, "reached": _digits, "error": _error_text}
"""Columns of a recipe, and the function that formats their values."""


def recipe_document(
    recipe: Recipe, material: MaterialPair | str | None = None
) -> Document:
    """Return requested and reached values, and the reasons of misses.

    Args:
        recipe: The recipe.
        material: The requested pair, which is shown above, or the name of the fabric.
    """
    row, parts, title = vars(recipe), list[Part](), recipe.engine
    if isinstance(material, MaterialPair):
        row = row | {"material": vars(material)}
        parts.append(material_table([material]))
    elif material is not None:
        row = row | {"material": material}
        title = f"{material} in {recipe.engine}"
    rows = []
    for name, value in recipe.reached.items():
        target, error = recipe.asked.get(name), recipe.error.get(name)
        if value is not None and error is not None:
            # A stiffness determines a depth, and a damping determines a rebound.
            target = value - error
        rows.append({"name": name, "asked": target, "reached": value, "error": error})
    columns = [Column("name", title, lambda name: TITLES.get(name, name))]
    columns += [
        Column(name, name, text, is_number=True)
        for name, text in COLUMNS.items()
        if any(row[name] is not None for row in rows)
    ]
    notes = ("", recipe.explanation)
    parts.append(Table(columns=tuple(columns), rows=rows, notes=notes))
    return Document(parts=parts, rows=[row])


def material_table(pairs: Sequence[MaterialPair]) -> Table:
    """Return the measured pairs with standard uncertainties; `--format wide` shows the sources of a list."""
    is_list = len(pairs) > 1
    sources = {source: None for pair in pairs for source in pair.uncertainty_sources}
    notes = ("", "-: not measured or not published.", *sources)
    return Table(
        columns=(
            Column("name", "material"),
            _number("friction", "friction"),
            _number("friction_std", "std"),
            _number("restitution", "restitution"),
            _number("restitution_std", "std"),
            _number("mass_kg", "mass", unit="kg"),
            Column("what", "bodies", place=Place.BELOW, wide_only=is_list),
            Column("source", "source", place=Place.BELOW, wide_only=is_list),
        ),
        rows=pairs,
        notes=notes if is_list else (),
    )


# --- fabrics ---------------------------------------------------------------------------------------------------------


def fabric_table(known: Mapping[str, Fabric]) -> Table:
    """Return the measured fabrics with their constants."""
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


def constants_document(fabrics: Mapping[str, Fabric]) -> Document:
    """Return the constants of every fabric for every engine.

    The JSON row has the constants by fabric, engine and constant.
    """
    known = {name: fabric_constants(fabric) for name, fabric in fabrics.items()}
    rows = []
    for engine, first in next(iter(known.values())).items():
        for constant, unit in first.units.items():
            row = {"engine": engine, "constant": constant, "unit": unit}
            for name, by_engine in known.items():
                mapped = by_engine[engine]
                mark = "*" if constant in mapped.replaced else ""
                row[name] = f"{mapped.constants[constant]:.3g}{mark}"
            rows.append(row)
    table = Table(
        columns=(
            Column("engine", "engine", place=Place.HEADING),
            Column("constant", "constant"),
            *(Column(name, name, is_number=True) for name in fabrics),
            Column("unit", "unit", wide_only=True),
        ),
        rows=rows,
        notes=(
            "",
            "* A fall-back sets this constant; gauge recipe FABRIC -b ENGINE gives the reason. All mappings have the "
            "measured stretch stiffness. --format wide shows the units.",
        ),
    )
    constants = {
        name: {engine: mapped.constants for engine, mapped in by_engine.items()}
        for name, by_engine in known.items()
    }
    return Document(parts=(table,), rows=[constants])
