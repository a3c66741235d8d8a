"""Reader of deformable bodies, attachments, markers and air of USD layers that this package wrote."""

from collections.abc import Mapping
from dataclasses import MISSING, fields
from functools import partial
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade
from pydantic import TypeAdapter

from gauge_envs.formats.usd.layer import (
    AIR_KINDS,
    KINDS,
    MARKER_INDICES,
    OMNI_MATERIAL,
)
from gauge_envs.formats.usd.source import Source
from gauge_envs.scene import (
    Air,
    Attachment,
    Box,
    Cloth,
    Deformable,
    Markers,
    Region,
    SoftBody,
)
from gauge_envs.scene.geometry import vector

AIR_PREFIX = "gauge:air:"

LIMITS = {"poisson_ratio": (-1.0, 0.5), "warp_angle_rad": (-np.pi, np.pi)}
"""Open interval of constants that need not be positive."""

Names = Mapping[Sdf.Path, str]
"""Names of bodies in the scene, by path of the prim."""


def is_deformable(prim: Usd.Prim) -> bool:
    """Return whether a prim is a deformable body, written by this package or another tool."""
    # usd-core does not know these schemas and lists them only here.
    applied = prim.GetPrimTypeInfo().GetAppliedAPISchemas()
    return prim.HasAttribute("gauge:kind") or "OmniPhysicsDeformableBodyAPI" in applied


def read_deformable(source: Source, prim: Usd.Prim, name: str) -> Deformable:
    """Read a deformable body."""
    models = {kind: model for model, kind in KINDS.items()}
    kind = source.text(prim.GetAttribute("gauge:kind"))
    if kind not in models:
        raise source.fault(
            prim,
            f"is a deformable body without gauge:kind: set one of {', '.join(models)}",
        )
    model = models[kind]
    pose, scale = source.frame(prim, Usd.TimeCode(source.start))
    if (scale != 1.0).any():
        raise source.fault(
            prim, "is a scaled deformable body: remove the scale and edit its size"
        )
    values: dict[str, Any] = {"name": name, "pose": pose}
    for field in fields(model):
        if field.type == "float" and (
            field.default is MISSING or prim.HasAttribute(f"gauge:{field.name}")
        ):
            values[field.name] = _constant(source, prim, field.name)
    if model in (Cloth, SoftBody):
        size_m = tuple(prim.GetAttribute("gauge:size_m").Get())
        if min(size_m) <= 0.0:
            raise source.fault(
                prim, f"gauge:size_m is {size_m}: positive lengths are expected"
            )
        values |= (
            {"size_m": size_m} if model is Cloth else {"shape": Box(size_m=size_m)}
        )
    return model(**values)


def _constant(source: Source, prim: Usd.Prim, name: str) -> float:
    """Read a constant of a body from its `gauge:` double and from the standard attribute, if it has one."""
    exact = prim.GetAttribute(f"gauge:{name}")
    # The material of a body without contacts has no friction, so `Source.material` would not find it.
    binding = UsdShade.MaterialBindingAPI(prim)
    material, _ = binding.ComputeBoundMaterial("physics")
    holders = [prim, material.GetPrim()] if material else [prim]
    standard = {"mass_kg": "mass", **OMNI_MATERIAL}.get(name)
    stored = [
        source.stored(holder.GetAttribute(f"omniphysics:{standard}"))
        for holder in holders
    ]
    if name == "radius_m":
        widths = prim.GetAttribute("widths")
        stored = [source.stored(widths, (1,), lambda width_m: 0.5 * width_m[0])]
    value = source.edited(exact, stored)
    low, high = LIMITS.get(name, (0.0, np.inf))
    if value is None or not low < value < high:
        raise source.fault(
            prim,
            f"gauge:{name} is {value}: a number above {low:g} and below {high:g} is expected",
        )
    return float(value)


def read_air(prim: Usd.Prim) -> Air | None:
    """Return the air of a PhysicsScene prim, which UsdPhysics lacks; None without `gauge:air:` attributes."""
    values: dict[str, Any] = {}
    for attribute in prim.GetAuthoredPropertiesInNamespace(AIR_PREFIX):
        name, value = attribute.GetName().removeprefix(AIR_PREFIX), attribute.Get()
        values[name] = vector(value) if name in AIR_KINDS else value
    return TypeAdapter(Air).validate_python(values) if values else None


def read_attachment(source: Source, prim: Usd.Prim, names: Names) -> Attachment | None:
    """Return the attachment of a prim; None if it has none or is disabled."""
    is_enabled = prim.GetAttribute("omniphysics:attachmentEnabled").Get()
    if not prim.HasAttribute("gauge:region_axis") or is_enabled is False:
        return None
    values = {
        field.name: prim.GetAttribute(f"gauge:region_{field.name}").Get()
        for field in fields(Region)
    }
    return Attachment(
        deformable=source.targets(prim, "omniphysics:src0", names)[0],
        region=TypeAdapter(Region).validate_python(values),
        to=source.targets(prim, "omniphysics:src1", names)[0],
    )


def read_markers(source: Source, names: Names) -> Markers | None:
    """Read the markers; return None if the stage has none."""
    carriers = (prim for prim in source.prims() if prim.HasRelationship("gauge:bodies"))
    prim = next(carriers, None)
    if prim is None:
        return None
    with source.errors_at(prim):
        stored = source.stored(
            UsdGeom.Points(prim).GetPointsAttr(),
            (-1, 3),
            partial(source.to_world, prim),
        )
        exact = prim.GetAttribute("gauge:positions_m")
        positions_m = source.edited(exact, [stored], (-1, 3))
        if positions_m is None:
            raise source.fault(prim, "has no points")
        values: dict[str, Any] = {
            "bodies": source.targets(prim, "gauge:bodies", names),
            "positions_m": positions_m.tolist(),
        }
        for name, shape in MARKER_INDICES.items():
            indices = np.array(prim.GetAttribute(f"gauge:{name}").Get(), dtype=int)
            values[name] = indices.reshape(shape).tolist()
        return TypeAdapter(Markers).validate_python(values)
