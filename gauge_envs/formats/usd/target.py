"""The stage that a scene is written to: paths of bodies, groups, meshes and attributes."""

from collections.abc import Sequence
from typing import Any

from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade

from gauge_envs.formats.usd.layer import WRITTEN
from gauge_envs.scene import Contact, Pose, Scene

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
        self.paths = _paths(names)
        self.collides = {
            name
            for contact in scene.contacts
            for name in (*contact.first, *contact.second)
        }

    def group(self, name: str) -> str:
        """Return the path of a group below the world, which is created if it does not exist."""
        return str(UsdGeom.Scope.Define(self.stage, f"/World/{name}").GetPath())

    def first_contact(self, name: str) -> int | None:
        """Return the index of the first contact of a body: UsdPhysics has materials per body and not per pair."""
        for index, contact in enumerate(self.scene.contacts):
            if name in contact.first or name in contact.second:
                return index
        return None

    def material_path(self, name: str) -> str:
        """Return the path of the material of a deformable body."""
        return f"/World/Materials/body_{Sdf.Path(self.paths[name]).name}"

    def bind(self, name: str, material: str) -> None:
        """Bind a material of physics to a body."""
        prim = self.stage.GetPrimAtPath(self.paths[name])
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(
            UsdShade.Material.Get(self.stage, material),
            UsdShade.Tokens.weakerThanDescendants,
            "physics",
        )

    def place(self, xform: UsdGeom.Xformable, name: str, pose: Pose) -> None:
        """Write the pose of a body, and its name in the scene."""
        precision = UsdGeom.XformOp.PrecisionDouble
        xform.AddTranslateOp(precision).Set(pose.position_m)
        xform.AddOrientOp(precision).Set(Gf.Quatd(*pose.quaternion))
        write(xform, "gauge:name", name, "string")

    def relate(self, prim: Usd.Prim, name: str, bodies: Sequence[str]) -> None:
        """Write a relationship to bodies."""
        is_custom = name.startswith("gauge:")
        paths = [self.paths[body] for body in bodies]
        prim.CreateRelationship(name, custom=is_custom).SetTargets(paths)


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


def write(
    schema: Any, name: str, value: Any, kind: str = "double", *, written: Any = None
) -> Usd.Attribute:
    """Write an attribute, which is custom if its name begins with `gauge:`.

    Args:
        schema: Prim or schema.
        name: Name with its prefix.
        value: Its value.
        kind: Name of its type in USD.
        written: Written value of its standard counterpart, if it has one.
    """
    prim = schema if isinstance(schema, Usd.Prim) else schema.GetPrim()
    attribute = prim.CreateAttribute(
        name, Sdf.ValueTypeNames.Find(kind), custom=name.startswith("gauge:")
    )
    attribute.Set(value)
    if written is not None:
        attribute.SetCustomDataByKey(WRITTEN, written)
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
    extent = UsdGeom.Boundable.ComputeExtentFromPlugins(
        geometry, Usd.TimeCode.Default()
    )
    geometry.CreateExtentAttr(extent)
