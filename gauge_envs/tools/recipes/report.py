"""Report recipes, and measured materials and fabrics, as tables."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace

from gauge_envs.pages.document import Bullets, Document, Paragraph, Part, Tone
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.tools.recipes.fabrics import fabric_constants
from gauge_envs.tools.recipes.materials import MaterialPair
from gauge_envs.tools.recipes.own_task import TESTED
from gauge_envs.tools.recipes.search import Recipe

TITLES = {
    "penetration_m": "penetration [m]",
    "creep_m_s": "creep [m/s]",
    "impact_friction": "friction in impacts",
    "slip_restitution": "restitution in a slip",
    "hop_m": "hop [m]",
    "torsion_m": "torsion [m]",
    "rolling_m": "rolling [m]",
    "stretch_n_per_m": "stretch [N/m]",
    "shear_n_per_m": "shear [N/m]",
    "bend_n_m": "bend [N m]",
    "bending_length_m": "bending length [m]",
}
"""Titles of values whose names carry a unit."""


def _number(key: str, title: str, *, unit: str = "") -> Column:
    return Column(key, title, "{:.4g}".format, unit=unit, is_number=True)


def _error_text(error: float) -> str:
    """Return the text of an error; errors below 1e-12 are rounding."""
    return f"{round(error, 12) + 0.0:+.2g}"


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
        rows.append([TITLES.get(name, name), target, value, error])
    columns = [Column("0", title), _number("2", "reached")]
    if any(target is not None for _, target, _, _ in rows):
        columns.insert(1, _number("1", "asked"))
        columns.append(Column("3", "error", _error_text, is_number=True))
    if recipe.explanation:
        parts.insert(0, Paragraph(recipe.explanation, Tone.ANSWER))
    parts.append(Table(columns=tuple(columns), rows=rows))
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
                row[name] = f"{mapped.constants[constant]:.3g}"
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
            "All mappings have the measured stretch stiffness. --format wide shows the units.",
        ),
    )
    losses = Paragraph("gauge recipe FABRIC -b ENGINE names losses.", Tone.NOTE)
    constants = {
        name: {engine: mapped.constants for engine, mapped in by_engine.items()}
        for name, by_engine in known.items()
    }
    return Document(parts=(table, losses), rows=[constants])


def tested_document(fabric: Fabric) -> Document:
    """Return the constants of a tested fabric for a task file and for every engine, and what each mapping loses."""
    constants = constants_document({TESTED: fabric})
    values = [f"{name} = {value:.6g}" for name, value in asdict(fabric).items()]
    lost = [
        f"{engine} loses {loss}."
        for engine, mapped in fabric_constants(fabric).items()
        for loss in mapped.lost
    ]
    parts = (
        *map(Paragraph, [f"[constants.textile.{TESTED}]", *values, ""]),
        constants.parts[0],
        Bullets(lost),
    )
    return replace(constants, parts=parts)
