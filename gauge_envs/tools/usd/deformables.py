"""Reader of deformable bodies, attachments, markers and air of USD layers that this package wrote."""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade

from gauge_envs.errors import ParameterError
from gauge_envs.scene.air import Air
from gauge_envs.scene.bodies import (
    Attachment,
    Cloth,
    Deformable,
    Markers,
    Region,
    SoftBody,
)
from gauge_envs.scene.geometry import Box, FloatArray, vector
from gauge_envs.tools.usd.layer import AIR_KINDS, KINDS, MARKER_INDICES, OMNI_MATERIAL
from gauge_envs.tools.usd.source import Source, single

POINT_TYPES = ("Points", "Mesh")
"""Types of prims whose points can be markers."""

Names = Mapping[Sdf.Path, str]
"""Names of bodies in the scene, by path of the prim."""


def is_deformable(prim: Usd.Prim) -> bool:
    """Return whether a prim is a deformable body, written by this package or another tool."""
    # usd-core does not know these schemas and lists them only here.
    applied = prim.GetPrimTypeInfo().GetAppliedAPISchemas()
    return prim.HasAttribute("gauge:kind") or "OmniPhysicsDeformableBodyAPI" in applied


def read_deformable(source: Source, prim: Usd.Prim, name: str) -> Deformable:
    """Read a deformable body."""
    if not source.flag(
        prim.GetAttribute("omniphysics:deformableBodyEnabled"), default=True
    ):
        raise source.fault(
            prim, "its deformable body is disabled: enable it or remove the prim"
        )
    kind = source.text(prim.GetAttribute("gauge:kind"), tuple(KINDS.values()))
    if kind is None:
        raise source.fault(
            prim,
            f"is a deformable body without gauge:kind: set one of {', '.join(KINDS.values())}",
        )
    frame = source.frame(prim, Usd.TimeCode(source.start))
    if not np.array_equal(np.abs(frame.scale), np.ones(3)):
        raise source.fault(
            prim, "is a scaled deformable body: remove the scale and edit its size"
        )
    # The material of a body without contacts has no friction, so `Source.material` would not find it.
    material = (
        UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0].GetPrim()
    )
    model = next(model for model, known in KINDS.items() if known == kind)
    values: dict[str, Any] = {"name": name, "pose": frame.pose}
    values |= {
        f.name: _constant(source, prim, material, f.name)
        for f in fields(model)
        if f.type == "float"
    }
    if model is Cloth:
        values["size_m"] = _size(source, prim, 2)
    elif model is SoftBody:
        values["shape"] = Box(size_m=_size(source, prim, 3))
    return model(**values)


def _constant(source: Source, prim: Usd.Prim, material: Usd.Prim, name: str) -> float:
    """Read a constant of a body from its `gauge:` double and from the standard attribute, if it has one."""
    double = prim.GetAttribute(f"gauge:{name}")
    if name == "radius_m":
        reading = source.reading(
            prim.GetAttribute("widths"), (1,), lambda width: 0.5 * width[0]
        )
        value = source.counted(
            double, [reading], rounded=lambda radius: 0.5 * single(2.0 * radius)
        )
    else:
        holder, standard = (
            (prim, "mass") if name == "mass_kg" else (material, OMNI_MATERIAL.get(name))
        )
        reading = (
            source.reading(holder.GetAttribute(f"omniphysics:{standard}"))
            if holder and standard
            else None
        )
        value = source.counted(double, [reading])
    low, high, expected = (0.0, np.inf, "a positive number")
    if name == "poisson_ratio":
        low, high, expected = (-1.0, 0.5, "more than -1 and less than 0.5")
    if value is None or not low < value < high:
        found = "is missing" if value is None else f"is {float(value)}"
        raise source.fault(prim, f"gauge:{name} {found}: {expected} is expected")
    return float(value)


def _size(source: Source, prim: Usd.Prim, count: int) -> tuple[Any, ...]:
    size = source.numbers(prim.GetAttribute("gauge:size_m"), (count,))
    if size is None or not (size > 0.0).all():
        raise source.fault(
            prim,
            f"gauge:size_m is missing or not positive: {count} lengths are expected",
        )
    return tuple(size.tolist())


def read_air(source: Source, prim: Usd.Prim) -> Air | None:
    """Return the air of a PhysicsScene prim, which UsdPhysics has not; None without `gauge:air:` attributes."""
    prefix, known = "gauge:air:", [field.name for field in fields(Air)]
    values: dict[str, Any] = {}
    for attribute in prim.GetAuthoredAttributes():
        if not attribute.GetName().startswith(prefix):
            continue
        name = attribute.GetName().removeprefix(prefix)
        if name not in known:
            raise source.fault(
                attribute, f"is no property of air; known are {', '.join(known)}"
            )
        value = source.numbers(attribute, (3,) if name in AIR_KINDS else ())
        if value is not None:
            values[name] = vector(value) if name in AIR_KINDS else float(value)
    if not values:
        return None
    missing = [
        name
        for name in ("density_kg_per_m3", "normal_coefficient")
        if name not in values
    ]
    if missing:
        raise source.fault(
            prim,
            f"states air without {prefix}{missing[0]}: add it, or remove all {prefix} attributes",
        )
    try:
        return Air(**values)
    except ParameterError as error:
        raise source.fault(prim, str(error)) from None


def read_attachments(source: Source, names: Names) -> Iterator[Attachment]:
    """Yield the enabled attachments in the stage's order."""
    for prim in source.prims():
        if not prim.HasAttribute("gauge:region_axis"):
            continue
        if not source.flag(
            prim.GetAttribute("omniphysics:attachmentEnabled"), default=True
        ):
            continue
        axis = source.text(prim.GetAttribute("gauge:region_axis"), ("x", "y", "z"))
        side = source.text(prim.GetAttribute("gauge:region_side"), ("low", "high"))
        depth = source.number(prim.GetAttribute("gauge:region_depth_m"))
        if axis is None or side is None or depth is None or depth < 0.0:
            raise source.fault(
                prim,
                "gauge:region_axis, gauge:region_side and gauge:region_depth_m >= 0 are expected",
            )
        region = Region(axis=axis, side=side, depth_m=depth)  # type: ignore[arg-type]
        ends = [
            _targets(source, prim, f"omniphysics:{end}", names)
            for end in ("src0", "src1")
        ]
        if any(len(end) != 1 for end in ends):
            raise source.fault(
                prim, "omniphysics:src0 and omniphysics:src1 name one body each"
            )
        yield Attachment(deformable=ends[0][0], region=region, to=ends[1][0])


def read_markers(source: Source, names: Names) -> Markers | None:
    """Read the markers; return None if the stage has none."""
    prims = [
        prim
        for prim in source.prims()
        if prim.IsA(UsdGeom.Points) and prim.HasRelationship("gauge:bodies")
    ]
    if not prims:
        return None
    if len(prims) > 1:
        raise source.fault(
            prims[1],
            f"is a second set of markers beside {prims[0].GetPath()}: one is expected",
        )
    (prim,) = prims
    positions = world_points(source, prim)
    return Markers(
        bodies=_targets(source, prim, "gauge:bodies", names),
        positions_m=tuple(map(vector, positions)),
        **{
            name: _indices(source, prim, name, kind, len(positions))
            for name, kind in MARKER_INDICES.items()
        },
    )


def world_points(source: Source, prim: Usd.Prim) -> FloatArray:
    """Return the world positions of the points of a Points or Mesh prim at the start [m], shape [point_count, 3]."""
    if prim.GetTypeName() not in POINT_TYPES:
        found = prim.GetTypeName() or "a prim without a type"
        raise source.fault(prim, f"is {found}: {' or '.join(POINT_TYPES)} is expected")
    reading = source.reading(
        UsdGeom.PointBased(prim).GetPointsAttr(),
        (-1, 3),
        lambda p: source.to_world(prim, p),
    )
    positions = source.counted(
        prim.GetAttribute("gauge:positions_m"), [reading], (-1, 3)
    )
    if positions is None or not len(positions):
        raise source.fault(prim, "has no points")
    return positions


def _targets(
    source: Source, prim: Usd.Prim, relationship: str, names: Names
) -> tuple[str, ...]:
    """Return the names of the bodies that a relationship targets."""
    found = (
        prim.GetRelationship(relationship).GetTargets()
        if prim.HasRelationship(relationship)
        else []
    )
    unknown = next((path for path in found if path not in names), None)
    if unknown is not None or not found:
        raise source.fault(
            prim, f"{relationship} names {unknown or 'nothing'}: bodies are expected"
        )
    return tuple(names[path] for path in found)


def _indices(
    source: Source, prim: Usd.Prim, name: str, kind: str, count: int
) -> tuple[Any, ...]:
    """Return indices of markers: numbers, or tuples of them for a type such as `int3[]`."""
    attribute, width = (
        prim.GetAttribute(f"gauge:{name}"),
        kind.removeprefix("int").removesuffix("[]"),
    )
    rows = source.numbers(attribute, (-1, int(width)) if width else (-1,))
    if rows is None:
        return ()
    if (rows < 0).any() or (rows >= count).any() or (rows != np.round(rows)).any():
        raise source.fault(
            attribute, f"names markers that do not exist: there are {count}"
        )
    listed = rows.astype(int).tolist()
    return tuple(map(tuple, listed)) if width else tuple(listed)
