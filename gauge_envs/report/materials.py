"""Fabrics in every engine's constants, and what is lost."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from gauge_envs.report.text import heading
from gauge_envs.scene.fabrics import MAPPINGS, Fabric, bending_length_m, shear_stiffness, uniaxial_stiffness

__all__ = [
    "material_values",
    "material_view",
]


def material_values(fabrics: Mapping[str, Fabric]) -> dict[str, dict[str, dict[str, float]]]:
    """Constants of every fabric in every engine's terms: fabric, engine, constant."""
    return {
        name: {engine: mapping(fabric).constants for engine, mapping in MAPPINGS.items()}
        for name, fabric in fabrics.items()
    }


def material_view(fabrics: Mapping[str, Fabric]) -> Group:
    """Constants of every fabric in every engine's terms, what comes back from them, and every fall-back and loss."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    for title in ("", "unit", *fabrics):
        table.add_column(escape(title), justify="left" if title in ("", "unit") else "right", overflow="fold")

    def add(title: str, unit: str, values: Iterable[float], marks: Iterable[str], style: str | None = None) -> None:
        cells = (f"{value:.4g}{mark or ' '}" for value, mark in zip(values, marks, strict=True))
        table.add_row(f"  {title}", escape(unit), *cells, style=style)

    table.add_row("[bold]measured[/]")
    plain = [""] * len(fabrics)
    for title, unit, attribute in (
        ("K_s", "N/m", "stretch_stiffness_n_per_m"),
        ("K_sh", "N/m", "shear_stiffness_n_per_m"),
        ("K_theta", "N m/rad", "bend_stiffness_n_m_per_rad"),
        ("thickness", "m", "thickness_m"),
        ("areal density", "kg/m^2", "areal_density_kg_per_m2"),
    ):
        add(title, unit, (getattr(fabric, attribute) for fabric in fabrics.values()), plain)
    add("bending length", "m", map(bending_length_m, fabrics.values()), plain, "dim")
    notes: dict[str, list[str]] = {}
    for engine, mapping in MAPPINGS.items():
        mapped = {name: mapping(fabric) for name, fabric in fabrics.items()}
        table.add_row(f"[bold]{engine}[/]")
        for constant, unit in next(iter(mapped.values())).units.items():
            marks = ["*" if constant in constants.replaced else "" for constants in mapped.values()]
            add(constant, unit, (constants.constants[constant] for constants in mapped.values()), marks)
        add("gives stretch", "N/m", map(uniaxial_stiffness, mapped.values()), plain, "dim")
        losses = ["!" if constants.lost else "" for constants in mapped.values()]
        add("gives shear", "N/m", map(shear_stiffness, mapped.values()), losses, "dim")
        for name, constants in mapped.items():
            if constants.fallbacks or constants.lost:
                notes.setdefault(engine, []).append(f"{name}: {'; '.join((*constants.fallbacks, *constants.lost))}")
    parts: list[Any] = [table, Text("\n* set by a fall-back   ! not the measured shear stiffness", style="dim")]
    for engine, lines in notes.items():
        parts += [heading(engine), *map(Text, lines)]
    return Group(*parts)
