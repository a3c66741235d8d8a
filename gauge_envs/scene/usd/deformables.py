"""Reader of deformable bodies, attachments and markers of USD layers that this package wrote."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade

from gauge_envs.scene.bodies import Attachment, Cloth, Deformable, Markers, Region, Rod, Rope, SoftBody
from gauge_envs.scene.geometry import Box, vector
from gauge_envs.scene.usd.layer import KINDS, FloatArray
from gauge_envs.scene.usd.source import Source, single

FABRIC = (
    "areal_density_kg_per_m2",
    "stretch_stiffness_n_per_m",
    "shear_stiffness_n_per_m",
    "bend_stiffness_n_m_per_rad",
)
"""Constants of a cloth without a standard attribute."""

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
    if not source.flag(prim.GetAttribute("omniphysics:deformableBodyEnabled"), default=True):
        raise source.fault(prim, "its deformable body is disabled: enable it or remove the prim")
    kind = source.text(prim.GetAttribute("gauge:kind"), tuple(KINDS.values()))
    if kind is None:
        raise source.fault(prim, f"is a deformable body without gauge:kind: set one of {', '.join(KINDS.values())}")
    frame = source.frame(prim, Usd.TimeCode(source.start))
    if not np.array_equal(np.abs(frame.scale), np.ones(3)):
        raise source.fault(prim, "is a scaled deformable body: remove the scale and edit its size")
    # The material of a body without contacts has no friction, so `Source.material` would not find it.
    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0].GetPrim()
    values: dict[str, Any] = {
        "name": name,
        "pose": frame.pose,
        "mass_kg": _positive(source, prim, "mass_kg", prim, "omniphysics:mass"),
    }
    if kind == "cloth":
        x, y = _size(source, prim, 2)
        values["thickness_m"] = _positive(source, prim, "thickness_m", material, "omniphysics:surfaceThickness")
        values |= {constant: _positive(source, prim, constant) for constant in FABRIC}
        return Cloth(**values, size_m=(x, y))
    values["young_modulus_pa"] = _positive(source, prim, "young_modulus_pa", material, "omniphysics:youngsModulus")
    if kind in ("soft_body", "rod"):
        values["poisson_ratio"] = _poisson_ratio(source, prim, material)
    if kind == "soft_body":
        x, y, z = _size(source, prim, 3)
        return SoftBody(**values, shape=Box(size_m=(x, y, z)))
    values |= {"length_m": _positive(source, prim, "length_m"), "radius_m": _radius(source, prim)}
    return Rope(**values) if kind == "rope" else Rod(**values)


def _positive(source: Source, prim: Usd.Prim, name: str, holder: Usd.Prim | None = None, standard: str = "") -> float:
    """Read a positive constant from its `gauge:` double and from an attribute of Omniverse's schema."""
    reading = source.reading(holder.GetAttribute(standard)) if holder else None
    return _checked(source, prim, name, source.counted(prim.GetAttribute(f"gauge:{name}"), [reading]))


def _checked(source: Source, prim: Usd.Prim, name: str, value: FloatArray | None) -> float:
    if value is None or not value > 0.0:
        found = "is missing" if value is None else f"is {float(value)}"
        raise source.fault(prim, f"gauge:{name} {found}: a positive number is expected")
    return float(value)


def _poisson_ratio(source: Source, prim: Usd.Prim, material: Usd.Prim | None) -> float:
    reading = source.reading(material.GetAttribute("omniphysics:poissonsRatio")) if material else None
    ratio = source.counted(prim.GetAttribute("gauge:poisson_ratio"), [reading])
    if ratio is None or not -1.0 < ratio < 0.5:
        found = "is missing" if ratio is None else f"is {float(ratio)}"
        raise source.fault(prim, f"gauge:poisson_ratio {found}: more than -1 and less than 0.5 is expected")
    return float(ratio)


def _radius(source: Source, prim: Usd.Prim) -> float:
    reading = source.reading(prim.GetAttribute("widths"), (1,), lambda width: 0.5 * width[0])
    radius = source.counted(prim.GetAttribute("gauge:radius_m"), [reading], rounded=lambda r: 0.5 * single(2.0 * r))
    return _checked(source, prim, "radius_m", radius)


def _size(source: Source, prim: Usd.Prim, count: int) -> list[float]:
    size = source.numbers(prim.GetAttribute("gauge:size_m"), (count,))
    if size is None or not (size > 0.0).all():
        raise source.fault(prim, f"gauge:size_m is missing or not positive: {count} lengths are expected")
    listed: list[float] = size.tolist()
    return listed


def read_attachments(source: Source, names: Names) -> Iterator[Attachment]:
    """Yield the enabled attachments in the stage's order."""
    for prim in source.prims():
        if not prim.HasAttribute("gauge:region_axis"):
            continue
        if not source.flag(prim.GetAttribute("omniphysics:attachmentEnabled"), default=True):
            continue
        axis = source.text(prim.GetAttribute("gauge:region_axis"), ("x", "y", "z"))
        side = source.text(prim.GetAttribute("gauge:region_side"), ("low", "high"))
        depth = source.number(prim.GetAttribute("gauge:region_depth_m"))
        if axis is None or side is None or depth is None or depth < 0.0:
            raise source.fault(prim, "gauge:region_axis, gauge:region_side and gauge:region_depth_m >= 0 are expected")
        region = Region(axis=axis, side=side, depth_m=depth)  # type: ignore[arg-type]
        ends = [_targets(source, prim, f"omniphysics:{end}", names) for end in ("src0", "src1")]
        if any(len(end) != 1 for end in ends):
            raise source.fault(prim, "omniphysics:src0 and omniphysics:src1 name one body each")
        yield Attachment(deformable=ends[0][0], region=region, to=ends[1][0])


def read_markers(source: Source, names: Names) -> Markers | None:
    """Read the markers; return None if the stage has none."""
    prims = [prim for prim in source.prims() if prim.IsA(UsdGeom.Points) and prim.HasRelationship("gauge:bodies")]
    if not prims:
        return None
    if len(prims) > 1:
        raise source.fault(prims[1], f"is a second set of markers beside {prims[0].GetPath()}: one is expected")
    (prim,) = prims
    positions = world_points(source, prim)
    count = len(positions)
    return Markers(
        bodies=_targets(source, prim, "gauge:bodies", names),
        positions_m=tuple(map(vector, positions)),
        faces=tuple((a, b, c) for a, b, c in _indices(source, prim, "faces", 3, count)),
        lines=tuple((a, b) for a, b in _indices(source, prim, "lines", 2, count)),
        corner=tuple(one for (one,) in _indices(source, prim, "corner", 1, count)),
        edge=tuple(one for (one,) in _indices(source, prim, "edge", 1, count)),
    )


def world_points(source: Source, prim: Usd.Prim) -> FloatArray:
    """Return the world positions of the points of a Points or Mesh prim at the start [m], shape [point_count, 3]."""
    if prim.GetTypeName() not in POINT_TYPES:
        found = prim.GetTypeName() or "a prim without a type"
        raise source.fault(prim, f"is {found}: {' or '.join(POINT_TYPES)} is expected")
    reading = source.reading(UsdGeom.PointBased(prim).GetPointsAttr(), (-1, 3), lambda p: source.to_world(prim, p))
    positions = source.counted(prim.GetAttribute("gauge:positions_m"), [reading], (-1, 3))
    if positions is None or not len(positions):
        raise source.fault(prim, "has no points")
    return positions


def _targets(source: Source, prim: Usd.Prim, relationship: str, names: Names) -> tuple[str, ...]:
    """Return the names of the bodies that a relationship targets."""
    found = prim.GetRelationship(relationship).GetTargets() if prim.HasRelationship(relationship) else []
    unknown = next((path for path in found if path not in names), None)
    if unknown is not None or not found:
        raise source.fault(prim, f"{relationship} names {unknown or 'nothing'}: bodies are expected")
    return tuple(names[path] for path in found)


def _indices(source: Source, prim: Usd.Prim, name: str, width: int, count: int) -> list[list[int]]:
    """Return indices of markers, shape [row_count, width]."""
    attribute = prim.GetAttribute(f"gauge:{name}")
    rows = source.numbers(attribute, (-1,) if width == 1 else (-1, width))
    if rows is None:
        return []
    if (rows < 0).any() or (rows >= count).any() or (rows != np.round(rows)).any():
        raise source.fault(attribute, f"names markers that do not exist: there are {count}")
    listed: list[list[int]] = rows.reshape(-1, width).astype(int).tolist()
    return listed
