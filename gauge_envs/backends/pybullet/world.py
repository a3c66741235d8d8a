"""A PyBullet world: its connection, and the shapes, frames and joints that all kinds of bodies use.

The import of PyBullet discards its messages, which would mix with the output of a command.
"""

import ctypes
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.pybullet.settings import SettingsPyBullet
from gauge_envs.backends.shared.rigid import principal_axes
from gauge_envs.errors import BackendError
from gauge_envs.scene import (
    Box,
    ConvexUnion,
    Cylinder,
    Motion,
    Plane,
    RigidBody,
    Scene,
    Shape,
    Sphere,
)
from gauge_envs.scene.geometry import FloatArray, Vector
from gauge_envs.scene.meshes import body_mass_properties, hull_faces


@contextmanager
def silent() -> Iterator[None]:
    """Discard what C++ code of this process writes to the standard streams."""
    libc = ctypes.CDLL(None) if os.name == "posix" else ctypes.cdll.msvcrt
    # The buffer of the C library holds output from before, which belongs to the user.
    libc.fflush(None)
    saved = {stream: os.dup(stream) for stream in (1, 2)}
    try:
        with Path(os.devnull).open("wb") as null:
            for stream in saved:
                os.dup2(null.fileno(), stream)
        yield
    finally:
        libc.fflush(None)
        for stream, descriptor in saved.items():
            os.dup2(descriptor, stream)
            os.close(descriptor)


with silent():
    import pybullet as pybullet
    from pybullet_utils.bullet_client import BulletClient

FASTEST_JOINT = 1e9
"""Bullet's limit on the speed of joints in units per second; its default of 100 is 1 m/s at 100 units per metre."""

PLANE_HALF_EDGE_M = 8.0
"""Half the edge of the box for a plane [m]. On some boxes with half an edge of 11.7 m or more, Bullet brakes rolling
spheres by up to 39 %; on 107 boxes from 1 to 11.6 m, spheres roll within 0.1 % of the law."""

DRIVEN_MASS_KG = 1e6
"""Mass of a driven body, which contacts between two drives do not move: 1 N moves it by 2e-11 m in 1/180 s."""

NO_SHAPE = -1
"""Number of the shape of links that touch nothing."""

NO_ROTATION = Rotation.identity()

BASE = -1
"""Number of the link that is the base of a body."""


Handle = tuple[int, int]
"""PyBullet's numbers of a body and of its link, which is `BASE` for most bodies."""


@dataclass(frozen=True)
class Frame:
    """Mass properties of a body; Bullet's frame is at the centre of mass, along the principal axes.

    Attributes:
        centre_m: Centre of mass in the body frame [m].
        axes: Rotation from the principal axes to the body frame.
        moments: Principal moments of inertia [kg units^2].
        quaternion: Rotation w, x, y, z from the body frame to the principal axes, shape [4].
    """

    centre_m: FloatArray
    axes: Rotation
    moments: list[float]
    quaternion: FloatArray

    @classmethod
    def of(cls, body: RigidBody, scale: float) -> "Frame":
        """Return the mass properties of a body in a world with some units per metre."""
        centre_m, inertia = body_mass_properties(body)
        moments, matrix = principal_axes(inertia)
        axes = Rotation.from_matrix(matrix)
        quaternion = axes.inv().as_quat(scalar_first=True)
        return cls(centre_m, axes, (scale**2 * moments).tolist(), quaternion)


@dataclass(frozen=True, kw_only=True)
class Link:
    """A link of a chain on a base, whose lengths are in units.

    Attributes:
        joint: PyBullet's type of the joint to the link before.
        place: Position and rotation in the frame of the link before.
        mass_kg: Mass [kg].
        moments: Moments of inertia [kg units^2].
        centre: Centre of mass in the frame of the link, whose axes are the principal axes.
        shape: PyBullet's number of its shape.
        axis: Axis of the joint in the frame of the link.
    """

    joint: int
    place: tuple[FloatArray, Rotation]
    mass_kg: float
    moments: list[float]
    centre: FloatArray
    shape: int = NO_SHAPE
    axis: Sequence[float] = (0.0, 0.0, 1.0)


class World:
    """A PyBullet world without bodies.

    Attributes:
        scene: The scene.
        settings: Numerical settings.
        scale: Units per metre.
        client: PyBullet's functions in this world.
        folder: Folder of files that exist while bodies are added.
        frames: Mass properties of the rigid bodies, by name.
        handles: The rigid bodies in PyBullet, by name; a body with several surfaces has as many copies.
        names: Names of the rigid bodies by their handles.
    """

    def __init__(self, scene: Scene, settings: SettingsPyBullet) -> None:
        self.scene = scene
        self.settings = settings
        self.scale = settings.units_per_m
        with silent():
            self.client = BulletClient(pybullet.DIRECT)
        if not self.client.isConnected():
            raise BackendError(
                "PyBullet opens no further world in this process: close unused simulations"
            )
        self.folder = Path()
        self.frames = {body.name: Frame.of(body, self.scale) for body in scene.bodies}
        self.handles: dict[str, list[Handle]] = {}
        self.names: dict[Handle, str] = {}

    def close(self) -> None:
        """Free the world. A second call does nothing."""
        if self.client.isConnected():
            self.client.disconnect()

    def shape(self, body: RigidBody, offset_m: FloatArray) -> int:
        """Return the shape of a body whose frame lies at a place [m] in a frame along its principal axes."""
        rotation = self.frames[body.name].axes.inv()
        place = {
            "collisionFramePosition": (self.scale * offset_m).tolist(),
            "collisionFrameOrientation": rotation.as_quat().tolist(),
        }
        arguments = place | self._shape_arguments(body.shape)
        return int(self.client.createCollisionShape(**arguments))

    def _shape_arguments(self, shape: Shape) -> dict[str, Any]:
        scale = self.scale
        flags = 0
        if self.settings.polyhedral_features:
            flags = pybullet.URDF_INITIALIZE_SAT_FEATURES
        box = {"shapeType": pybullet.GEOM_BOX, "flags": flags}
        if isinstance(shape, Sphere):
            return {"shapeType": pybullet.GEOM_SPHERE, "radius": scale * shape.radius_m}
        if isinstance(shape, Cylinder):
            size = {"radius": scale * shape.radius_m, "height": scale * shape.length_m}
            return {"shapeType": pybullet.GEOM_CYLINDER, **size}
        if isinstance(shape, Plane) and self.settings.planes == "plane":
            return {"shapeType": pybullet.GEOM_PLANE, "planeNormal": [0.0, 0.0, 1.0]}
        if isinstance(shape, Plane):
            # A box below the plane.
            half_edge = scale * PLANE_HALF_EDGE_M
            place = {"collisionFramePosition": [0.0, 0.0, -half_edge]}
            return {"halfExtents": [half_edge] * 3, **place, **box}
        if isinstance(shape, Box):
            return {"halfExtents": [0.5 * scale * edge for edge in shape.size_m], **box}
        assert isinstance(shape, ConvexUnion), "compounds are unsupported"
        mesh = {"shapeType": pybullet.GEOM_MESH, "flags": flags}
        if len(shape.pieces_m) == 1:
            return {"vertices": np.multiply(scale, shape.pieces_m[0]).tolist(), **mesh}
        text = _object_text(shape, scale)
        path = self.folder / f"{len(list(self.folder.iterdir()))}.obj"
        path.write_text(text)
        return {"fileName": str(path), **mesh}

    def base(
        self,
        place_m: FloatArray,
        rotation: Rotation = NO_ROTATION,
        mass_kg: float = 0.0,
    ) -> dict[str, Any]:
        """Return the arguments of `createMultiBody` for a base without shape at a place in the world [m]."""
        return {
            "baseMass": mass_kg,
            "basePosition": (self.scale * place_m).tolist(),
            "baseOrientation": rotation.as_quat().tolist(),
        }

    def base_of(self, body: RigidBody) -> dict[str, Any]:
        """Return the arguments of `createMultiBody` for a body as base, whose frame is at its centre of mass."""
        frame = self.frames[body.name]
        mass_kg = 0.0 if body.motion is Motion.FIXED else body.mass_kg
        if body.motion is Motion.KINEMATIC:
            mass_kg = DRIVEN_MASS_KG
        centre_m = body.pose.to_world(frame.centre_m)
        base = self.base(centre_m, body.pose.rotation * frame.axes, mass_kg)
        origin_m = frame.axes.inv().apply(-frame.centre_m)
        return {"baseCollisionShapeIndex": self.shape(body, origin_m), **base}

    def add_handle(self, name: str, number: int, link: int) -> None:
        """Register a body as a link of a multibody, or as a copy of a registered body."""
        self.handles.setdefault(name, []).append((number, link))
        self.names[number, link] = name

    def link(
        self,
        body: RigidBody,
        joint: int,
        joint_m: FloatArray,
        place: FloatArray,
        parent: Rotation,
        axis: Vector = (0.0, 0.0, 1.0),
    ) -> Link:
        """Return a body as a link, whose frame is at its joint, along its principal axes.

        Args:
            body: The body.
            joint: PyBullet's type of the joint.
            joint_m: Position of the joint in the world [m].
            place: Position of the joint in the frame of the link before [units].
            parent: Rotation of the link before, in the world.
            axis: Axis of the joint in the world.
        """
        frame = self.frames[body.name]
        rotation = body.pose.rotation * frame.axes
        inverse = rotation.inv()
        centre_m = inverse.apply(body.pose.to_world(frame.centre_m) - joint_m)
        origin_m = inverse.apply(body.pose.position_m - joint_m)
        return Link(
            joint=joint,
            place=(place, parent.inv() * rotation),
            mass_kg=body.mass_kg,
            moments=frame.moments,
            centre=self.scale * centre_m,
            shape=self.shape(body, origin_m),
            axis=inverse.apply(axis).tolist(),
        )

    def add_multibody(
        self, base: dict[str, Any], moments: list[float], links: Sequence[Link]
    ) -> int:
        """Add bodies on joints without friction and motors, and return PyBullet's number of the multibody.

        Args:
            base: Arguments of `createMultiBody` for the base.
            moments: Moments of inertia of the base [kg units^2]; empty for a base without mass.
            links: The links.
        """
        number = self.client.createMultiBody(
            **base,
            linkMasses=[link.mass_kg for link in links],
            linkCollisionShapeIndices=[link.shape for link in links],
            linkVisualShapeIndices=[NO_SHAPE] * len(links),
            linkPositions=[link.place[0].tolist() for link in links],
            linkOrientations=[link.place[1].as_quat().tolist() for link in links],
            linkInertialFramePositions=[link.centre.tolist() for link in links],
            linkInertialFrameOrientations=[[0.0, 0.0, 0.0, 1.0]] * len(links),
            linkParentIndices=list(range(len(links))),
            linkJointTypes=[link.joint for link in links],
            linkJointAxis=[list(link.axis) for link in links],
        )
        if moments:
            self.set_mass(number, BASE, base["baseMass"], moments)
        for row, link in enumerate(links):
            self.set_mass(number, row, link.mass_kg, link.moments)
        self.free_joints(number, links)
        return int(number)

    def set_mass(
        self, number: int, link: int, mass_kg: float, moments: list[float]
    ) -> None:
        """Write the mass [kg] and the principal moments of inertia [kg units^2] of a body."""
        self.client.changeDynamics(
            number, link, mass=mass_kg, localInertiaDiagonal=moments
        )

    def free_joints(self, number: int, links: Sequence[Link] = ()) -> None:
        """Remove Bullet's damping, speed limit and motors of the joints of a multibody.

        Args:
            number: PyBullet's number of the multibody.
            links: Its links.
        """
        for row in range(BASE, len(links)):
            self.client.changeDynamics(
                number,
                row,
                jointDamping=0.0,
                linearDamping=self.settings.linear_damping,
                angularDamping=self.settings.angular_damping,
                maxJointVelocity=FASTEST_JOINT,
            )
        for row, link in enumerate(links):
            if link.joint == pybullet.JOINT_SPHERICAL:
                self.client.setJointMotorControlMultiDof(
                    number,
                    row,
                    pybullet.POSITION_CONTROL,
                    targetPosition=[0.0, 0.0, 0.0, 1.0],
                    positionGain=0.0,
                    velocityGain=0.0,
                    force=[0.0, 0.0, 0.0],
                )
            else:
                self.client.setJointMotorControl2(
                    number,
                    row,
                    pybullet.VELOCITY_CONTROL,
                    targetVelocity=0.0,
                    force=0.0,
                )


@lru_cache(maxsize=64)
def _object_text(shape: ConvexUnion, scale: float) -> str:
    """Return an OBJ file with an object for each convex hull; PyBullet accepts several hulls in no other form."""
    lines: list[str] = []
    first = 1
    for index, piece_m in enumerate(shape.pieces_m):
        points = np.multiply(scale, piece_m)
        lines.append(f"o piece{index}")
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
        for face in hull_faces(points):
            lines.append("f " + " ".join(str(first + vertex) for vertex in face))
        first += len(points)
    return "\n".join(lines) + "\n"
