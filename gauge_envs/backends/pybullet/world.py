"""A PyBullet world: its connection, and the shapes, frames and joints that all kinds of bodies use."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends.pybullet.engine import pybullet, silent
from gauge_envs.backends.pybullet.frames import Frame, Handle
from gauge_envs.backends.pybullet.pieces import write_convex_pieces
from gauge_envs.backends.pybullet.settings import SettingsPyBullet
from gauge_envs.errors import BackendError
from gauge_envs.scene import Box, ConvexUnion, Cylinder, Motion, Plane, RigidBody, Scene, Shape, Sphere
from gauge_envs.scene.meshes import body_mass_properties

FASTEST_JOINT = 1e9
"""Bullet's limit on the speed of joints in units per second; its default of 100 is 1 m/s at 100 units per metre."""

PLANE_REACH_M = 8.0
"""Half the edge of the box for a plane [m]. On some boxes with half an edge of 11.7 m or more, Bullet brakes rolling
spheres by up to 39 %; on 107 boxes from 1 to 11.6 m, spheres roll within 0.1 % of the law."""

DRIVEN_MASS_KG = 1e6
"""Mass of a driven body, which contacts between two drives do not move: 1 N moves it by 2e-11 m in 1/180 s."""


class BulletWorld:
    """A PyBullet world without bodies.

    Args:
        scene: The scene.
        settings: Numerical settings.

    Attributes:
        scene: The scene.
        settings: Numerical settings.
        scale: Units per metre.
        client: PyBullet's number of the world; -1 after it is closed.
        folder: Folder of files that exist while bodies are added.
        handles: The rigid bodies in PyBullet, by name.
        copies: Copies of bodies with several surfaces, by name, without the first one.
    """

    def __init__(self, scene: Scene, settings: SettingsPyBullet) -> None:
        self.scene, self.scale = scene, settings.units_per_m
        self.settings = settings
        with silent():
            self.client = pybullet.connect(pybullet.DIRECT)
        if self.client < 0:
            raise BackendError("PyBullet opens no further world in this process: close simulations that are not used")
        self.handles: dict[str, Handle] = {}
        self.copies: dict[str, list[Handle]] = {}
        self.folder = Path()

    def call(self, function: str, *arguments: Any, **named: Any) -> Any:
        """Call a function of PyBullet in this world."""
        return getattr(pybullet, function)(*arguments, physicsClientId=self.client, **named)

    def close(self) -> None:
        """Free the world. A second call does nothing."""
        if self.client >= 0:
            with silent():
                self.call("disconnect")
            self.client = -1

    def shape(self, shape: Shape, offset_m: NDArray[np.float64], frame: Frame) -> int:
        """Return a collision shape whose body frame lies at a place [m] in a frame along the principal axes."""
        place = {
            "collisionFramePosition": (self.scale * offset_m).tolist(),
            "collisionFrameOrientation": frame.axes.inv().as_quat().tolist(),
        }
        scale = self.scale
        flags = pybullet.URDF_INITIALIZE_SAT_FEATURES if self.settings.polyhedral_features else 0
        if isinstance(shape, Box):
            half = [0.5 * scale * edge for edge in shape.size_m]
            return int(self.call("createCollisionShape", pybullet.GEOM_BOX, halfExtents=half, flags=flags, **place))
        if isinstance(shape, Sphere):
            return int(self.call("createCollisionShape", pybullet.GEOM_SPHERE, radius=scale * shape.radius_m, **place))
        if isinstance(shape, Plane):
            return self._plane(flags, place)
        if isinstance(shape, Cylinder):
            radius, length = scale * shape.radius_m, scale * shape.length_m
            return int(self.call("createCollisionShape", pybullet.GEOM_CYLINDER, radius=radius, height=length, **place))
        assert isinstance(shape, ConvexUnion), "compounds are declined by unsupported_features"
        pieces = [(scale * np.asarray(piece)) for piece in shape.pieces_m]
        if len(pieces) == 1:
            vertices = pieces[0].tolist()
            return int(self.call("createCollisionShape", pybullet.GEOM_MESH, vertices=vertices, flags=flags, **place))
        path = write_convex_pieces(self.folder / f"{len(list(self.folder.iterdir()))}.obj", pieces)
        return int(self.call("createCollisionShape", pybullet.GEOM_MESH, fileName=str(path), flags=flags, **place))

    def _plane(self, flags: int, place: dict[str, Any]) -> int:
        """Return Bullet's plane, or a box below the plane that reaches `PLANE_REACH_M` to each side."""
        if self.settings.planes == "plane":
            return int(self.call("createCollisionShape", pybullet.GEOM_PLANE, planeNormal=[0.0, 0.0, 1.0], **place))
        half = self.scale * PLANE_REACH_M
        place = place | {"collisionFramePosition": [0.0, 0.0, -half]}
        return int(self.call("createCollisionShape", pybullet.GEOM_BOX, halfExtents=[half] * 3, flags=flags, **place))

    def frame(self, body: RigidBody) -> Frame:
        """Return the mass properties of a body."""
        centre_m, inertia = body_mass_properties(body)
        moments, axes = np.diag(inertia), np.eye(3)
        if np.abs(inertia - np.diag(moments)).max() > 1e-12 * np.abs(inertia).max():
            moments, axes = np.linalg.eigh(inertia)
            axes[:, 2] *= np.linalg.det(axes)
        return Frame(centre_m, Rotation.from_matrix(axes), (self.scale**2 * moments).tolist())

    def base_arguments(self, body: RigidBody, frame: Frame) -> dict[str, Any]:
        """Return the arguments of `createMultiBody` for a body as base, whose frame is that of its centre of mass."""
        masses = {Motion.DYNAMIC: body.mass_kg, Motion.FIXED: 0.0, Motion.KINEMATIC: DRIVEN_MASS_KG}
        return {
            "baseMass": masses[body.motion],
            "baseCollisionShapeIndex": self.shape(body.shape, frame.axes.inv().apply(-frame.centre_m), frame),
            "basePosition": (self.scale * body.pose.to_world(frame.centre_m)).tolist(),
            "baseOrientation": (body.pose.rotation * frame.axes).as_quat().tolist(),
        }

    def add_handle(self, body: RigidBody, number: int, link: int) -> Handle:
        """Enter a body as a link of a multibody, or as a copy of a body that is entered already."""
        frame = self.frame(body)
        handle = Handle(number, link, frame.centre_m, frame.axes.inv())
        if self.handles.setdefault(body.name, handle) is not handle:
            self.copies.setdefault(body.name, []).append(handle)
        return handle

    def set_dynamics(self, handle: Handle, **named: Any) -> None:
        """Change dynamic properties of a body or a link."""
        self.call("changeDynamics", handle.body, handle.link, **named)

    def free_joints(self, body: int, count: int, *, spherical: Collection[int]) -> None:
        """Remove Bullet's damping, speed limit and motors of the joints of a multibody.

        Args:
            body: PyBullet's number of the multibody.
            count: Number of its links.
            spherical: Links on spherical joints.
        """
        for link in range(-1, count):
            self.call(
                "changeDynamics",
                body,
                link,
                jointDamping=0.0,
                linearDamping=self.settings.linear_damping,
                angularDamping=self.settings.angular_damping,
                maxJointVelocity=FASTEST_JOINT,
            )
        motor = {"controlMode": pybullet.VELOCITY_CONTROL, "targetVelocity": 0.0, "force": 0.0}
        still = {"targetPosition": [0.0, 0.0, 0.0, 1.0], "positionGain": 0.0, "velocityGain": 0.0}
        position = pybullet.POSITION_CONTROL
        for link in range(count):
            if link in spherical:
                self.call("setJointMotorControlMultiDof", body, link, position, force=[0.0, 0.0, 0.0], **still)
            else:
                self.call("setJointMotorControl2", body, link, **motor)
