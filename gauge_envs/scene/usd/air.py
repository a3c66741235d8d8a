"""Air of a scene in USD layers: `gauge:air:` doubles of the PhysicsScene prim, as UsdPhysics has no air."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from pxr import Gf, Sdf, Usd

from gauge_envs.errors import ParameterError
from gauge_envs.scene.air import Air
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.usd.source import Source

PREFIX = "gauge:air:"

WIND = "wind_m_per_s"
"""The one field that is a vector."""


def write_air(prim: Usd.Prim, air: Air) -> None:
    """Write the fields of the air as custom doubles of the PhysicsScene prim."""
    for field in fields(Air):
        value = getattr(air, field.name)
        kind = Sdf.ValueTypeNames.Double3 if field.name == WIND else Sdf.ValueTypeNames.Double
        attribute = prim.CreateAttribute(f"{PREFIX}{field.name}", kind, custom=True)
        attribute.Set(Gf.Vec3d(*value) if field.name == WIND else value)


def read_air(source: Source, prim: Usd.Prim) -> Air | None:
    """Return the air of a PhysicsScene prim; None without such attributes."""
    names = [field.name for field in fields(Air)]
    values: dict[str, Any] = {}
    for attribute in prim.GetAuthoredAttributes():
        name = attribute.GetName().removeprefix(PREFIX)
        if not attribute.GetName().startswith(PREFIX):
            continue
        if name not in names:
            raise source.fault(attribute, f"is no property of air; known are {', '.join(names)}")
        value = source.numbers(attribute, (3,) if name == WIND else ())
        if value is not None:
            values[name] = vector(value) if name == WIND else float(value)
    if not values:
        return None
    missing = [name for name in ("density_kg_per_m3", "normal_coefficient") if name not in values]
    if missing:
        raise source.fault(prim, f"states air without {PREFIX}{missing[0]}: add it, or remove all {PREFIX} attributes")
    try:
        return Air(**values)
    except ParameterError as error:
        raise source.fault(prim, str(error)) from None
