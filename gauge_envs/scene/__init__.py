"""Vocabulary of a scene, the input from which a physics engine builds and drives one experiment."""

from gauge_envs.scene.bodies import (
    Attachment,
    Cloth,
    Contact,
    ContactMode,
    Deformable,
    Hinge,
    Markers,
    Motion,
    Region,
    RigidBody,
    Rod,
    Rope,
    SoftBody,
    Tether,
)
from gauge_envs.scene.geometry import Box, ConvexUnion, Cylinder, Plane, Pose, Shape, Sphere, Vector
from gauge_envs.scene.meshes import mass_properties
from gauge_envs.scene.scene import GRAVITY_M_PER_S2, Scene

__all__ = [
    "GRAVITY_M_PER_S2",
    "Attachment",
    "Box",
    "Cloth",
    "Contact",
    "ContactMode",
    "ConvexUnion",
    "Cylinder",
    "Deformable",
    "Hinge",
    "Markers",
    "Motion",
    "Plane",
    "Pose",
    "Region",
    "RigidBody",
    "Rod",
    "Rope",
    "Scene",
    "Shape",
    "SoftBody",
    "Sphere",
    "Tether",
    "Vector",
    "mass_properties",
]
