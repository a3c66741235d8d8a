"""Constants of the fabrics in every engine's terms, and the losses of each mapping."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import repeat

from rich.console import Group
from rich.text import Text

from gauge_envs.pages.table import Column, Place, Table, as_rich
from gauge_envs.pages.text import heading
from gauge_envs.scene.fabrics import MAPPINGS, Fabric, bending_length_m, shear_stiffness, uniaxial_stiffness


def material_values(fabrics: Mapping[str, Fabric]) -> dict[str, dict[str, dict[str, float]]]:
    """Return the constants of every fabric in every engine's terms: fabric, engine, constant."""
    return {
        name: {engine: mapping(fabric).constants for engine, mapping in MAPPINGS.items()}
        for name, fabric in fabrics.items()
    }


MEASURED = {
    "K_s [N/m]": "stretch_stiffness_n_per_m",
    "K_sh [N/m]": "shear_stiffness_n_per_m",
    "K_theta [N m/rad]": "bend_stiffness_n_m_per_rad",
    "thickness [m]": "thickness_m",
    "areal density [kg/m^2]": "areal_density_kg_per_m2",
}
"""Attributes of the measured constants by title."""


def material_view(fabrics: Mapping[str, Fabric], *, wide: bool = False) -> Group:
    """Return the constants of every fabric in every engine's terms, what they give, and every fall-back and loss."""
    digits = 4 if wide else 3
    rows: list[dict[str, str]] = []

    def add(source: str, constant: str, values: Iterable[float], marks: Iterable[str] = repeat(" ")) -> None:
        texts = (f"{_constant_text(value, digits)}{mark}" for value, mark in zip(values, marks, strict=False))
        rows.append({"source": source, "constant": constant} | dict(zip(fabrics, texts, strict=True)))

    for title, attribute in MEASURED.items():
        add("measured", title, (getattr(fabric, attribute) for fabric in fabrics.values()))
    add("measured", "bending length [m]", map(bending_length_m, fabrics.values()))
    notes: list[Text] = []
    for engine, mapping in MAPPINGS.items():
        mapped = [mapping(fabric) for fabric in fabrics.values()]
        for constant, unit in mapped[0].units.items():
            marks = ("*" if constant in one.replaced else " " for one in mapped)
            add(engine, f"{constant} [{unit}]", (one.constants[constant] for one in mapped), marks)
        add(engine, "gives K_s [N/m]", map(uniaxial_stiffness, mapped))
        add(engine, "gives K_sh [N/m]", map(shear_stiffness, mapped), ("!" if one.lost else " " for one in mapped))
        losses = {name: "; ".join((*one.fallbacks, *one.lost)) for name, one in zip(fabrics, mapped, strict=True)}
        if any(losses.values()):
            notes += [heading(engine), *(Text(f"{name}: {text}") for name, text in losses.items() if text)]
    names = (Column(name, name, is_number=True) for name in fabrics)
    columns = (Column("source", "source", place=Place.HEADING), Column("constant", "constant"), *names)
    legend = ("", "* set by a fall-back   ! not the measured shear stiffness")
    return Group(as_rich(Table(columns=columns, rows=rows, notes=legend), wide=wide), *notes)


def _constant_text(value: float, digits: int) -> str:
    """Return a constant to some digits, with a short exponent for a large or small one."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.0f}" if abs(value) >= 1e3 else f"{value:.{digits}g}"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}"
