"""Reader of deformable bodies, attachments, markers and air of USD layers that this package wrote."""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import partial
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade
from pydantic import TypeAdapter, ValidationError

from gauge_envs.errors import ParameterError, first_fault
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
from gauge_envs.tools.usd.layer import (
    KINDS,
    MARKER_INDICES,
    OMNI_MATERIAL,
)
from gauge_envs.tools.usd.source import Source

AIR_PREFIX = "gauge:air:"

Names = Mapping[Sdf.Path, str]
"""Names of bodies in the scene, by path of the prim."""


def is_deformable(prim: Usd.Prim) -> bool:
    """Return whether a prim is a deformable body, written by this package or another tool."""
    # usd-core does not know these schemas and lists them only here.
    applied = prim.GetPrimTypeInfo().GetAppliedAPISchemas()
    return prim.HasAttribute("gauge:kind") or "OmniPhysicsDeformableBodyAPI" in applied


def read_deformable(source: Source, prim: Usd.Prim, name: str) -> Deformable:
    """Read a deformable body."""
    enabled = prim.GetAttribute("omniphysics:deformableBodyEnabled")
    if enabled and enabled.Get() is False:
        raise source.fault(
            prim, "its deformable body is disabled: enable it or remove the prim"
        )
    models = {kind: model for model, kind in KINDS.items()}
    kind = source.text(prim.GetAttribute("gauge:kind"), tuple(models))
    if kind is None:
        raise source.fault(
            prim,
            f"is a deformable body without gauge:kind: set one of {', '.join(models)}",
        )
    model = models[kind]
    frame = source.frame(prim, Usd.TimeCode(source.start))
    if not np.array_equal(np.abs(frame.scale), np.ones(3)):
        raise source.fault(
            prim, "is a scaled deformable body: remove the scale and edit its size"
        )
    values: dict[str, Any] = {"name": name, "pose": frame.pose}
    for field in fields(model):
        if field.type == "float":
            values[field.name] = _constant(source, prim, field.name)
    if model is Cloth:
        values["size_m"] = _size_m(source, prim, 2)
    elif model is SoftBody:
        values["shape"] = Box(size_m=_size_m(source, prim, 3))
    return model(**values)


def _constant(source: Source, prim: Usd.Prim, name: str) -> float:
    """Read a constant of a body from its `gauge:` double and from the standard attribute, if it has one."""
    exact = prim.GetAttribute(f"gauge:{name}")
    if name == "radius_m":
        widths = prim.GetAttribute("widths")
        stored = source.stored(widths, (1,), lambda width_m: 0.5 * width_m[0])
        value = source.edited(exact, [stored])
    else:
        # The material of a body without contacts has no friction, so `Source.material` would not find it.
        binding = UsdShade.MaterialBindingAPI(prim)
        material = binding.ComputeBoundMaterial("physics")[0].GetPrim()
        holder, standard = material, OMNI_MATERIAL.get(name)
        if name == "mass_kg":
            holder, standard = prim, "mass"
        attribute = holder.GetAttribute(f"omniphysics:{standard}") if holder else None
        value = source.edited(exact, [source.stored(attribute)])
    low, high = (-1.0, 0.5) if name == "poisson_ratio" else (0.0, np.inf)
    if value is None or not low < value < high:
        state = "missing" if value is None else float(value)
        raise source.fault(
            prim,
            f"gauge:{name} is {state}: a number above {low:g} and below {high:g} is expected",
        )
    return float(value)


def _size_m(source: Source, prim: Usd.Prim, count: int) -> tuple[Any, ...]:
    size_m = source.numbers(prim.GetAttribute("gauge:size_m"), (count,))
    if size_m is None or not (size_m > 0.0).all():
        raise source.fault(
            prim,
            f"gauge:size_m is missing or not positive: {count} lengths are expected",
        )
    return tuple(size_m.tolist())


def read_air(source: Source, prim: Usd.Prim) -> Air | None:
    """Return the air of a PhysicsScene prim, which UsdPhysics has not; None without `gauge:air:` attributes."""
    known = [field.name for field in fields(Air)]
    values: dict[str, Any] = {}
    for attribute in prim.GetAuthoredPropertiesInNamespace(AIR_PREFIX):
        name = attribute.GetName().removeprefix(AIR_PREFIX)
        if name not in known:
            raise source.fault(
                attribute, f"is no property of air; known are {', '.join(known)}"
            )
        value = attribute.Get()
        values[name] = value if isinstance(value, float) else vector(value)
    for name in known[:2] if values else ():
        if name not in values:
            raise source.fault(prim, f"states air without {AIR_PREFIX}{name}: add it")
    try:
        return Air(**values) if values else None
    except ParameterError as error:
        raise source.fault(prim, str(error)) from None


def read_attachments(source: Source, names: Names) -> Iterator[Attachment]:
    """Yield the enabled attachments in the stage's order."""
    for prim in source.prims():
        enabled = prim.GetAttribute("omniphysics:attachmentEnabled")
        if not prim.HasAttribute("gauge:region_axis") or enabled.Get() is False:
            continue
        values = {
            field.name: prim.GetAttribute(f"gauge:region_{field.name}").Get()
            for field in fields(Region)
        }
        try:
            region = TypeAdapter(Region).validate_python(values)
        except ValidationError as error:
            place, reason = first_fault(error)
            raise source.fault(prim, f"gauge:region_{place}: {reason}") from None
        yield Attachment(
            deformable=source.targets(prim, "omniphysics:src0", names)[0],
            region=region,
            to=source.targets(prim, "omniphysics:src1", names)[0],
        )


def read_markers(source: Source, names: Names) -> Markers | None:
    """Read the markers; return None if the stage has none."""
    points = (prim for prim in source.prims() if prim.IsA(UsdGeom.Points))
    prim = next((one for one in points if one.HasRelationship("gauge:bodies")), None)
    if prim is None:
        return None
    stored = source.stored(
        UsdGeom.Points(prim).GetPointsAttr(), (-1, 3), partial(source.to_world, prim)
    )
    exact = prim.GetAttribute("gauge:positions_m")
    positions_m = source.edited(exact, [stored], (-1, 3))
    if positions_m is None:
        raise source.fault(prim, "has no points")
    indices: dict[str, Any] = {}
    for name, shape in MARKER_INDICES.items():
        attribute = prim.GetAttribute(f"gauge:{name}")
        rows = source.numbers(attribute, shape)
        if rows is None:
            continue
        if not np.isin(rows, np.arange(len(positions_m))).all():
            raise source.fault(
                attribute,
                f"names markers that do not exist: there are {len(positions_m)}",
            )
        listed = rows.astype(int).tolist()
        indices[name] = tuple(listed if rows.ndim == 1 else map(tuple, listed))
    return Markers(
        bodies=source.targets(prim, "gauge:bodies", names),
        positions_m=tuple(map(vector, positions_m)),
        **indices,
    )
