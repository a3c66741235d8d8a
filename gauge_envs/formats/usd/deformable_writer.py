"""Writer of deformable bodies and attachments into a USD layer, under Omniverse's names."""

from dataclasses import fields

import numpy as np
from pxr import Usd, UsdGeom, UsdPhysics, UsdShade

from gauge_envs.formats.usd.isaac_fabric import surface_constants
from gauge_envs.formats.usd.layer import KINDS, OMNI_MATERIAL, WRITTEN, record_follower
from gauge_envs.formats.usd.target import (
    Target,
    write,
    write_extent,
    write_friction,
)
from gauge_envs.scene import Attachment, Cloth, Deformable, Rope, SoftBody
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.meshes import TOUCHING_M, grid, nodes_in, tetrahedra

LINE_SPACING_M = 0.01
"""Distance between the points of ropes and rods [m]."""

ISAAC_ATTRIBUTES = {
    "youngs_modulus": "youngsModulus",
    "poissons_ratio": "poissonsRatio",
    "surfaceBendStiffness": "surfaceBendStiffness",
}
"""Attributes of Omniverse's deformable material, by the names of `isaac_fabric.surface_constants`."""

APIS = {
    Cloth: "OmniPhysicsSurfaceDeformableSimAPI",
    SoftBody: "OmniPhysicsVolumeDeformableSimAPI",
}
"""Schemas of deformable meshes; usd-core lacks them, and Omniverse recognizes their names."""

STIFFNESSES = "gauge:stretch_, gauge:shear_ and gauge:bend_stiffness_..."
REGION = "gauge:region_axis, gauge:region_side and gauge:region_depth_m"


def write_deformable(target: Target, body: Deformable) -> None:
    """Write a body with its mesh, its constants and its material."""
    nodes = deformable_nodes(body)
    geometry = _define(target.stage, target.paths[body.name], body, nodes)
    points = geometry.CreatePointsAttr(nodes)
    write_extent(geometry)
    prim = geometry.GetPrim()
    target.place(geometry, body.name, body.pose)
    write(prim, "gauge:kind", KINDS[type(body)], "token")
    for field in fields(body):
        value = getattr(body, field.name)
        if isinstance(value, float) and value != field.default:
            write(prim, f"gauge:{field.name}", value)
    prim.AddAppliedSchema("OmniPhysicsBodyAPI")
    prim.AddAppliedSchema("OmniPhysicsDeformableBodyAPI")
    write(prim, "omniphysics:deformableBodyEnabled", True, "bool")
    _write_single(prim, "mass", prim, "mass_kg", body.mass_kg)
    size = "gauge:length_m"
    if api := APIS.get(type(body)):
        size = "gauge:size_m"
        _write_derived(prim, "restShapePoints", "point3f[]", nodes, size)
        prim.AddAppliedSchema(api)
        collision = UsdPhysics.CollisionAPI.Apply(prim)
        collision.CreateCollisionEnabledAttr(body.name in target.collides)
    record_follower(points, size)
    _write_material(target, body, prim)
    target.bind(body.name, target.material_path(body.name))


def deformable_nodes(body: Deformable) -> FloatArray:
    """Return the vertices of the mesh of a body in its frame [m], shape [node_count, 3]."""
    if isinstance(body, Cloth):
        return grid((*body.size_m, 0.0))[0]
    if isinstance(body, SoftBody):
        return grid(body.shape.size_m)[0]
    count = round(body.length_m / LINE_SPACING_M) + 1
    nodes = np.zeros((count, 3))
    axis = 0 if isinstance(body, Rope) else 2
    nodes[:, axis] = np.linspace(-0.5 * body.length_m, 0.5 * body.length_m, count)
    return nodes


def _define(
    stage: Usd.Stage, path: str, body: Deformable, nodes: FloatArray
) -> UsdGeom.PointBased:
    """Write the mesh of a body without its points."""
    if isinstance(body, Cloth):
        corner = np.arange(len(nodes)).reshape(grid((*body.size_m, 0.0))[1][:2])
        a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
        triangles = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
        mesh = UsdGeom.Mesh.Define(stage, path)
        mesh.CreateFaceVertexCountsAttr([3] * len(triangles))
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        faces = mesh.CreateFaceVertexIndicesAttr(triangles.ravel().tolist())
        record_follower(faces, "gauge:size_m")
        _write_derived(
            mesh,
            "restTriVtxIndices",
            "int3[]",
            triangles.tolist(),
            "gauge:size_m",
        )
        write(mesh, "gauge:size_m", body.size_m, "double2")
        return mesh
    if isinstance(body, SoftBody):
        indices = tetrahedra(grid(body.shape.size_m)[1]).tolist()
        solid = UsdGeom.TetMesh.Define(stage, path)
        record_follower(solid.CreateTetVertexIndicesAttr(indices), "gauge:size_m")
        faces = UsdGeom.TetMesh.ComputeSurfaceFaces(solid)
        solid.CreateSurfaceFaceVertexIndicesAttr(faces)
        _write_derived(solid, "restTetVtxIndices", "int4[]", indices, "gauge:size_m")
        write(solid, "gauge:size_m", body.shape.size_m, "double3")
        return solid
    curves = UsdGeom.BasisCurves.Define(stage, path)
    curves.CreateTypeAttr(UsdGeom.Tokens.linear)
    curves.CreateWrapAttr(UsdGeom.Tokens.nonperiodic)
    curves.CreateCurveVertexCountsAttr([len(nodes)])
    width_m = curves.CreateWidthsAttr([2.0 * body.radius_m]).Get()[0]
    curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    write(curves, "gauge:radius_m", body.radius_m, written=0.5 * width_m)
    return curves


def _write_material(target: Target, body: Deformable, gauge: Usd.Prim) -> None:
    """Write the material of a body, whose exact constants are at its own prim."""
    target.group("Materials")
    path = target.material_path(body.name)
    prim = UsdShade.Material.Define(target.stage, path).GetPrim()
    prim.AddAppliedSchema("OmniPhysicsBaseMaterialAPI")
    prim.AddAppliedSchema("OmniPhysicsDeformableMaterialAPI")
    if (index := target.first_contact(body.name)) is not None:
        contact = target.scene.contacts[index]
        write_friction(prim, contact)
        for name in ("staticFriction", "dynamicFriction"):
            write(prim, f"omniphysics:{name}", contact.friction, "float")
    for name, attribute in OMNI_MATERIAL.items():
        if hasattr(body, name):
            _write_single(prim, attribute, gauge, name, getattr(body, name))
    if not isinstance(body, Cloth):
        return
    prim.AddAppliedSchema("OmniPhysicsSurfaceDeformableMaterialAPI")
    density = body.areal_density_kg_per_m2 / body.thickness_m
    _write_derived(prim, "density", "float", density, "gauge:areal_density_kg_per_m2")
    isaac = surface_constants(Fabric.of(body))
    for name, attribute in ISAAC_ATTRIBUTES.items():
        value = isaac.constants[name]
        _write_derived(prim, attribute, "float", value, STIFFNESSES)
        record_follower(write(prim, f"gauge:isaac:{name}", value), STIFFNESSES)
    notes = [*isaac.fallbacks, *isaac.lost]
    write(prim, "gauge:isaac:notes", notes, "string[]")


def _write_single(
    prim: Usd.Prim, attribute: str, gauge: Usd.Prim, name: str, value: float
) -> None:
    """Write a number in single precision, and record it at its `gauge:` double."""
    single = write(prim, f"omniphysics:{attribute}", value, "float").Get()
    gauge.GetAttribute(f"gauge:{name}").SetCustomDataByKey(WRITTEN, single)


def _write_derived(
    prim: Usd.Prim | UsdGeom.PointBased,
    attribute: str,
    kind: str,
    value: object,
    source: str,
) -> None:
    """Write an attribute of the deformable schema that is computed from `gauge:` attributes."""
    record_follower(write(prim, f"omniphysics:{attribute}", value, kind), source)


def write_attachment(target: Target, index: int, attachment: Attachment) -> None:
    """Write an attachment, for Omniverse with the attached vertices of the mesh in this file."""
    soft = {body.name: body for body in target.scene.deformables}
    body, partner = soft[attachment.deformable], soft.get(attachment.to)
    nodes = deformable_nodes(body)
    attached = nodes_in(nodes, attachment.region)
    kind = "VtxXform" if partner is None else "VtxVtx"
    path = f"{target.group('Attachments')}/attachment_{index}"
    prim = target.stage.DefinePrim(path, f"OmniPhysics{kind}Attachment")
    pose = target.scene.body(attachment.to).pose if partner is None else partner.pose
    local = pose.to_body(body.pose.to_world(nodes[attached]))
    if partner is None:
        _write_derived(prim, "localPositionsSrc1", "point3f[]", local, REGION)
    else:
        partners = deformable_nodes(partner)
        distance = np.linalg.norm(local[:, None] - partners[None], axis=-1)
        touching = distance.min(axis=1) < TOUCHING_M
        attached = attached[touching]
        nearest = distance.argmin(axis=1)[touching].tolist()
        _write_derived(prim, "vtxIndicesSrc1", "int[]", nearest, REGION)
    _write_derived(prim, "vtxIndicesSrc0", "int[]", attached.tolist(), REGION)
    write(prim, "omniphysics:attachmentEnabled", True, "bool")
    target.relate(prim, "omniphysics:src0", [attachment.deformable])
    target.relate(prim, "omniphysics:src1", [attachment.to])
    write(prim, "gauge:region_axis", attachment.region.axis, "token")
    write(prim, "gauge:region_side", attachment.region.side, "token")
    write(prim, "gauge:region_depth_m", attachment.region.depth_m)
