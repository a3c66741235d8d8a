"""Constants of the fabrics in every engine's terms, and the losses of each mapping."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Group
from rich.text import Text

from gauge_envs.report.table import Column, Place, Table, as_rich
from gauge_envs.report.text import heading
from gauge_envs.scene.fabrics import (
    MAPPINGS,
    EngineConstants,
    Fabric,
    bending_length_m,
    shear_stiffness,
    uniaxial_stiffness,
)

__all__ = [
    "material_values",
    "material_view",
]


def material_values(fabrics: Mapping[str, Fabric]) -> dict[str, dict[str, dict[str, float]]]:
    """Return the constants of every fabric in every engine's terms: fabric, engine, constant."""
    return {
        name: {engine: mapping(fabric).constants for engine, mapping in MAPPINGS.items()}
        for name, fabric in fabrics.items()
    }


MEASURED = (
    ("K_s", "N/m", "stretch_stiffness_n_per_m"),
    ("K_sh", "N/m", "shear_stiffness_n_per_m"),
    ("K_theta", "N m/rad", "bend_stiffness_n_m_per_rad"),
    ("thickness", "m", "thickness_m"),
    ("areal density", "kg/m^2", "areal_density_kg_per_m2"),
)
"""Symbol, unit and attribute of the measured constants."""


def material_view(fabrics: Mapping[str, Fabric], *, wide: bool = False) -> Group:
    """Return the constants of every fabric in every engine's terms, what they give, and every fall-back and loss."""
    digits = 4 if wide else 3
    rows = [
        {"source": "measured", "constant": f"{title} [{unit}]"}
        | {name: f"{_constant_text(getattr(fabric, attribute), digits)} " for name, fabric in fabrics.items()}
        for title, unit, attribute in MEASURED
    ]
    lengths = {name: f"{_constant_text(bending_length_m(fabric), digits)} " for name, fabric in fabrics.items()}
    rows.append({"source": "measured", "constant": "bending length [m]"} | lengths)
    notes: list[Text] = []
    for engine, mapping in MAPPINGS.items():
        mapped = {name: mapping(fabric) for name, fabric in fabrics.items()}
        rows += _engine_rows(engine, mapped, digits)
        losses = [
            Text(f"{name}: {'; '.join((*constants.fallbacks, *constants.lost))}")
            for name, constants in mapped.items()
            if constants.fallbacks or constants.lost
        ]
        notes += [heading(engine), *losses] if losses else []
    table = Table(
        columns=(
            Column("source", "source", place=Place.HEADING),
            Column("constant", "constant"),
            *(Column(name, name, is_number=True) for name in fabrics),
        ),
        rows=rows,
        notes=("", "* set by a fall-back   ! not the measured shear stiffness"),
    )
    return Group(as_rich(table, wide=wide), *notes)


def _engine_rows(engine: str, mapped: Mapping[str, EngineConstants], digits: int) -> list[dict[str, str]]:
    """Return a row for each constant of an engine, and for the stiffness that the constants give back."""
    units = next(iter(mapped.values())).units
    rows = [
        {"source": engine, "constant": f"{constant} [{unit}]"}
        | {
            name: f"{_constant_text(one.constants[constant], digits)}{'*' if constant in one.replaced else ' '}"
            for name, one in mapped.items()
        }
        for constant, unit in units.items()
    ]
    stretch = {name: f"{_constant_text(uniaxial_stiffness(one), digits)} " for name, one in mapped.items()}
    shear = {
        name: f"{_constant_text(shear_stiffness(one), digits)}{'!' if one.lost else ' '}"
        for name, one in mapped.items()
    }
    rows.append({"source": engine, "constant": "gives K_s [N/m]"} | stretch)
    rows.append({"source": engine, "constant": "gives K_sh [N/m]"} | shear)
    return rows


def _constant_text(value: float, digits: int) -> str:
    """Return a constant to some digits, with a short exponent for a large or small one."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.0f}" if abs(value) >= 1e3 else f"{value:.{digits}g}"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}"
