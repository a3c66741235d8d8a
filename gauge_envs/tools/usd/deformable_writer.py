"""Writer of deformable bodies and attachments into a USD layer, under Omniverse's names."""

from dataclasses import fields

import numpy as np
from pxr import UsdGeom, UsdPhysics, UsdShade

from gauge_envs.scene.bodies import Attachment, Cloth, Deformable, Rod, Rope, SoftBody
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.meshes import TOUCHING_M, grid, nodes_in, tetrahedra
from gauge_envs.tools.usd.isaac_fabric import surface_constants
from gauge_envs.tools.usd.layer import (
    KINDS,
    OMNI_MATERIAL,
    record_follower,
    record_written,
)
from gauge_envs.tools.usd.target import (
    Target,
    integer_rows,
    single_points,
    write_extent,
    write_friction,
    write_gauge,
    write_omni,
)

LINE_SPACING_M = 0.01
"""Distance between the points of ropes and rods [m]."""

ISAAC_ATTRIBUTES = {
    "youngs_modulus": "youngsModulus",
    "poissons_ratio": "poissonsRatio",
    "surfaceBendStiffness": "surfaceBendStiffness",
}
"""Attributes of Omniverse's deformable material, by the names of `isaac_fabric.surface_constants`."""


class DeformableWriter:
    """Writes the deformable bodies of a scene, and what holds them."""

    def __init__(self, target: Target) -> None:
        self.target = target
        self.stage = target.stage
        self.paths = target.paths
        self.deformables = {body.name: body for body in target.scene.deformables}
        self.points: dict[str, FloatArray] = {}

    def write(self, body: Deformable) -> None:
        """Write a body with its mesh, its constants and its material."""
        path = self.paths[body.name]
        if isinstance(body, Cloth):
            geometry, api = (
                self._cloth(path, body),
                "OmniPhysicsSurfaceDeformableSimAPI",
            )
        elif isinstance(body, SoftBody):
            geometry, api = (
                self._soft_body(path, body),
                "OmniPhysicsVolumeDeformableSimAPI",
            )
        else:
            geometry, api = self._line(path, body), None
        prim = geometry.GetPrim()
        self.target.place(geometry, body.name, body.pose)
        write_gauge(prim, "kind", KINDS[type(body)], "token")
        for field in fields(body):
            if isinstance(value := getattr(body, field.name), float):
                write_gauge(prim, field.name, value)
        # usd-core does not have these schemas; Omniverse recognizes their names.
        prim.AddAppliedSchema("OmniPhysicsBodyAPI")
        prim.AddAppliedSchema("OmniPhysicsDeformableBodyAPI")
        write_omni(prim, "deformableBodyEnabled", "bool", True)
        record_written(
            prim.GetAttribute("gauge:mass_kg"),
            write_omni(prim, "mass", "float", body.mass_kg).Get(),
        )
        size = f"gauge:{'length_m' if api is None else 'size_m'}"
        points = UsdGeom.PointBased(prim).GetPointsAttr()
        record_follower(points, size)
        if api is not None:
            prim.AddAppliedSchema(api)
            record_follower(
                write_omni(prim, "restShapePoints", "point3f[]", points.Get()), size
            )
            collision = UsdPhysics.CollisionAPI.Apply(prim)
            collision.CreateCollisionEnabledAttr(body.name in self.target.collides)
        self.target.bind(path, self._material(body))

    def _cloth(self, path: str, cloth: Cloth) -> UsdGeom.Mesh:
        nodes, shape = grid((*cloth.size_m, 0.0))
        corner = np.arange(len(nodes)).reshape(shape)[:, :, 0]
        a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
        triangles = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
        self.points[cloth.name] = nodes
        mesh = self.target.mesh(path, nodes, triangles.tolist())
        record_follower(mesh.GetFaceVertexIndicesAttr(), "gauge:size_m")
        record_follower(
            write_omni(mesh, "restTriVtxIndices", "int3[]", integer_rows(triangles)),
            "gauge:size_m",
        )
        write_gauge(mesh, "size_m", cloth.size_m, "double2")
        return mesh

    def _soft_body(self, path: str, body: SoftBody) -> UsdGeom.TetMesh:
        nodes, shape = grid(body.shape.size_m)
        indices = integer_rows(tetrahedra(shape))
        self.points[body.name] = nodes
        mesh = UsdGeom.TetMesh.Define(self.stage, path)
        mesh.CreatePointsAttr(single_points(nodes))
        mesh.CreateTetVertexIndicesAttr(indices)
        mesh.CreateSurfaceFaceVertexIndicesAttr(
            UsdGeom.TetMesh.ComputeSurfaceFaces(mesh)
        )
        write_extent(mesh)
        record_follower(mesh.GetTetVertexIndicesAttr(), "gauge:size_m")
        record_follower(
            write_omni(mesh, "restTetVtxIndices", "int4[]", indices), "gauge:size_m"
        )
        write_gauge(mesh, "size_m", body.shape.size_m, "double3")
        return mesh

    def _line(self, path: str, body: Rope | Rod) -> UsdGeom.BasisCurves:
        count = round(body.length_m / LINE_SPACING_M) + 1
        nodes = np.zeros((count, 3))
        nodes[:, 0 if isinstance(body, Rope) else 2] = np.linspace(
            -0.5 * body.length_m, 0.5 * body.length_m, count
        )
        self.points[body.name] = nodes
        curves = UsdGeom.BasisCurves.Define(self.stage, path)
        curves.CreateTypeAttr(UsdGeom.Tokens.linear)
        curves.CreateWrapAttr(UsdGeom.Tokens.nonperiodic)
        curves.CreateCurveVertexCountsAttr([count])
        curves.CreatePointsAttr(single_points(nodes))
        curves.CreateWidthsAttr([2.0 * body.radius_m])
        curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)
        write_extent(curves)
        return curves

    def _material(self, body: Deformable) -> UsdShade.Material:
        self.target.group("Materials")
        material = UsdShade.Material.Define(
            self.stage, material_path(self.target, body.name)
        )
        prim, gauge = (
            material.GetPrim(),
            self.stage.GetPrimAtPath(self.paths[body.name]),
        )
        prim.AddAppliedSchema("OmniPhysicsBaseMaterialAPI")
        prim.AddAppliedSchema("OmniPhysicsDeformableMaterialAPI")
        if (index := self.target.first_contact(body.name)) is not None:
            contact = self.target.scene.contacts[index]
            write_friction(prim, contact)
            write_omni(prim, "staticFriction", "float", contact.friction)
            write_omni(prim, "dynamicFriction", "float", contact.friction)
        if isinstance(body, Cloth):
            prim.AddAppliedSchema("OmniPhysicsSurfaceDeformableMaterialAPI")
            density = write_omni(
                prim,
                "density",
                "float",
                body.areal_density_kg_per_m2 / body.thickness_m,
            )
            record_follower(density, "gauge:areal_density_kg_per_m2")
        for name, attribute in OMNI_MATERIAL.items():
            if hasattr(body, name):
                written = write_omni(
                    prim, attribute, "float", getattr(body, name)
                ).Get()
                record_written(gauge.GetAttribute(f"gauge:{name}"), written)
        if isinstance(body, Cloth):
            isaac = surface_constants(Fabric.of(body))
            for name, attribute in ISAAC_ATTRIBUTES.items():
                value = isaac.constants[name]
                for one in (
                    write_omni(prim, attribute, "float", value),
                    write_gauge(prim, f"isaac:{name}", value),
                ):
                    record_follower(
                        one, "gauge:stretch_, gauge:shear_ and gauge:bend_stiffness_..."
                    )
            write_gauge(
                prim, "isaac:notes", [*isaac.fallbacks, *isaac.lost], "string[]"
            )
        if isinstance(body, Rope | Rod):
            (width,) = UsdGeom.BasisCurves(gauge).GetWidthsAttr().Get()
            record_written(gauge.GetAttribute("gauge:radius_m"), 0.5 * width)
        return material

    def attach(self, index: int, attachment: Attachment) -> None:
        """Write an attachment, for Omniverse with the attached vertices of the mesh in this file."""
        body = self.deformables[attachment.deformable]
        nodes = self.points[attachment.deformable]
        attached = nodes_in(nodes, attachment.region)
        other = self.deformables.get(attachment.to)
        kind = (
            "OmniPhysicsVtxXformAttachment"
            if other is None
            else "OmniPhysicsVtxVtxAttachment"
        )
        prim = self.stage.DefinePrim(
            f"{self.target.group('Attachments')}/attachment_{index}", kind
        )
        pose = (
            self.target.scene.body(attachment.to).pose if other is None else other.pose
        )
        local = pose.to_body(body.pose.to_world(nodes[attached]))
        if other is None:
            follows = [
                write_omni(
                    prim, "localPositionsSrc1", "point3f[]", single_points(local)
                )
            ]
        else:
            partners = self.points[attachment.to]
            distance = np.linalg.norm(local[:, None] - partners[None], axis=-1)
            touching = distance.min(axis=1) < TOUCHING_M
            attached = attached[touching]
            nearest = distance.argmin(axis=1)[touching]
            follows = [write_omni(prim, "vtxIndicesSrc1", "int[]", nearest.tolist())]
        follows.append(write_omni(prim, "vtxIndicesSrc0", "int[]", attached.tolist()))
        for one in follows:
            record_follower(
                one, "gauge:region_axis, gauge:region_side and gauge:region_depth_m"
            )
        write_omni(prim, "attachmentEnabled", "bool", True)
        for name, target in (("src0", attachment.deformable), ("src1", attachment.to)):
            prim.CreateRelationship(f"omniphysics:{name}", custom=False).SetTargets(
                [self.paths[target]]
            )
        write_gauge(prim, "region_axis", attachment.region.axis, "token")
        write_gauge(prim, "region_side", attachment.region.side, "token")
        write_gauge(prim, "region_depth_m", attachment.region.depth_m)


def material_path(target: Target, name: str) -> str:
    """Return the path of the material of a deformable body."""
    return f"/World/Materials/body_{target.paths[name].rpartition('/')[2]}"
