"""The stage that a scene is written to: paths of bodies, groups, meshes and attributes."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt

from gauge_envs.errors import ParameterError
from gauge_envs.scene.bodies import Contact
from gauge_envs.scene.geometry import FloatArray, IntArray, Pose
from gauge_envs.scene.scene import Scene
from gauge_envs.tools.usd.layer import record_written

GROUPS = ("PhysicsScene", "Contacts", "Materials", "Joints", "Attachments", "Markers")
"""Names of the groups beside the bodies below the world prim."""


class Target:
    """An empty stage with the paths of the bodies of a scene.

    Attributes:
        stage: The stage.
        scene: The scene.
        paths: Path of the prim of each body, by name.
        collides: Names of the bodies that may touch another one.
    """

    def __init__(self, stage: Usd.Stage, scene: Scene) -> None:
        self.stage = stage
        self.scene = scene
        names = [body.name for body in (*scene.bodies, *scene.deformables)]
        for kind, listed in (
            ("name", names),
            ("driver", [driver.body for driver in scene.drivers]),
        ):
            twice = next((name for name in listed if listed.count(name) > 1), None)
            if twice is not None:
                raise ParameterError(f"body {twice!r} has more than one {kind}")
        self.paths = _paths(names)
        self.collides = {
            name
            for contact in scene.contacts
            for name in (*contact.first, *contact.second)
        }

    def group(self, name: str) -> str:
        """Return the path of a group below the world, which is created if it does not exist."""
        path = f"/World/{name}"
        UsdGeom.Scope.Define(self.stage, path)
        return path

    def first_contact(self, name: str) -> int | None:
        """Return the index of the first contact of a body: UsdPhysics has materials per body and not per pair."""
        return next(
            (
                i
                for i, c in enumerate(self.scene.contacts)
                if name in c.first or name in c.second
            ),
            None,
        )

    def bind(self, path: str, material: UsdShade.Material) -> None:
        """Bind a material of physics to a body."""
        binding = UsdShade.MaterialBindingAPI.Apply(self.stage.GetPrimAtPath(path))
        binding.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")

    def place(self, xform: UsdGeom.Xformable, name: str, pose: Pose) -> None:
        """Write the pose of a body, and its name in the scene."""
        precision = UsdGeom.XformOp.PrecisionDouble
        xform.AddTranslateOp(precision).Set(Gf.Vec3d(*pose.position_m))
        xform.AddOrientOp(precision).Set(quatd(pose.quaternion))
        write_gauge(xform, "name", name, "string")

    def mesh(
        self, path: str, points_m: FloatArray, faces: Sequence[Sequence[int]]
    ) -> UsdGeom.Mesh:
        """Write a mesh of points [m], shape [point_count, 3], and faces of their indices."""
        mesh = UsdGeom.Mesh.Define(self.stage, path)
        mesh.CreatePointsAttr(single_points(points_m))
        mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
        mesh.CreateFaceVertexIndicesAttr([index for face in faces for index in face])
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        write_extent(mesh)
        return mesh


def _paths(names: Sequence[str]) -> dict[str, str]:
    """Return a unique path for each body; invalid or taken names are changed."""
    taken, paths = set(GROUPS), {}
    for name in names:
        identifier = Tf.MakeValidIdentifier(name)
        while identifier in taken:
            identifier += "_"
        taken.add(identifier)
        paths[name] = f"/World/{identifier}"
    return paths


def write_gauge(
    schema: Any, name: str, value: Any, kind: str = "double", *, written: Any = None
) -> Usd.Attribute:
    """Write a `gauge:` attribute.

    Args:
        schema: Prim or schema.
        name: Name without the prefix.
        value: Its value.
        kind: Name of its type in USD.
        written: Written value of its standard counterpart, if it has one.
    """
    attribute = write_attribute(schema, f"gauge:{name}", kind, value)
    if written is not None:
        record_written(attribute, written)
    return attribute


def write_omni(schema: Any, name: str, kind: str, value: Any) -> Usd.Attribute:
    """Write an attribute of the deformable schema, which is not custom for tools with that schema."""
    return write_attribute(schema, f"omniphysics:{name}", kind, value)


def write_attribute(schema: Any, name: str, kind: str, value: Any) -> Usd.Attribute:
    """Write an attribute, which is custom if its name begins with `gauge:`."""
    prim = schema if isinstance(schema, Usd.Prim) else schema.GetPrim()
    is_custom = name.startswith("gauge:")
    attribute = prim.CreateAttribute(
        name, Sdf.ValueTypeNames.Find(kind), custom=is_custom
    )
    attribute.Set(value)
    return attribute


def write_friction(prim: Usd.Prim, contact: Contact) -> UsdPhysics.MaterialAPI:
    """Write friction and restitution of a contact to a material."""
    material = UsdPhysics.MaterialAPI.Apply(prim)
    material.CreateStaticFrictionAttr(contact.friction)
    material.CreateDynamicFrictionAttr(contact.friction)
    material.CreateRestitutionAttr(contact.restitution)
    return material


def write_extent(geometry: UsdGeom.Boundable) -> None:
    """Write the box around a geometry."""
    geometry.CreateExtentAttr(
        UsdGeom.Boundable.ComputeExtentFromPlugins(geometry, Usd.TimeCode.Default())
    )


def quatd(quaternion: Iterable[float]) -> Gf.Quatd:
    """Return a quaternion w, x, y, z as that of USD."""
    w, x, y, z = quaternion
    return Gf.Quatd(w, x, y, z)


def single_points(points_m: FloatArray) -> Vt.Vec3fArray:
    """Return points [m], shape [point_count, 3], as USD's array in single precision."""
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(points_m, dtype=np.float32))


def integer_rows(indices: IntArray) -> Any:
    """Return rows of indices as USD's array of integer vectors."""
    kind = {3: Vt.Vec3iArray, 4: Vt.Vec4iArray}[indices.shape[1]]
    return kind.FromNumpy(np.ascontiguousarray(indices, dtype=np.int32))
