"""A PyBullet world: its connection, and the shapes, frames and joints that all kinds of bodies use.

The import of PyBullet discards its messages, which would mix with the output of a command.
"""

import ctypes
import os
import sys
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.pybullet.settings import SettingsPyBullet
from gauge_envs.backends.settings import check_kept
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
    SoftBody,
    Sphere,
)
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.meshes import body_mass_properties, hull_faces


@contextmanager
def silent() -> Iterator[None]:
    """Discard what C++ code of this process writes to the standard streams."""
    sys.stdout.flush()
    sys.stderr.flush()
    libc = ctypes.CDLL(None) if os.name == "posix" else ctypes.cdll.msvcrt
    saved = [os.dup(1), os.dup(2)]
    null = os.open(os.devnull, os.O_WRONLY)
    # What the C library still holds was written before, and belongs to the user.
    libc.fflush(None)
    try:
        for stream in (1, 2):
            os.dup2(null, stream)
        yield
    finally:
        libc.fflush(None)
        for stream, descriptor in zip((1, 2), saved, strict=True):
            os.dup2(descriptor, stream)
            os.close(descriptor)
        os.close(null)


with silent():
    import pybullet as pybullet

FASTEST_JOINT = 1e9
"""Bullet's limit on the speed of joints in units per second; its default of 100 is 1 m/s at 100 units per metre."""

PLANE_REACH_M = 8.0
"""Half the edge of the box for a plane [m]. On some boxes with half an edge of 11.7 m or more, Bullet brakes rolling
spheres by up to 39 %; on 107 boxes from 1 to 11.6 m, spheres roll within 0.1 % of the law."""

DRIVEN_MASS_KG = 1e6
"""Mass of a driven body, which contacts between two drives do not move: 1 N moves it by 2e-11 m in 1/180 s."""


NO_SHAPE = -1
"""Number of the shape of links that touch nothing."""

DYNAMICS = {"lateralFriction": 1, "rollingFriction": 6, "spinningFriction": 7}
"""Places in what `getDynamicsInfo` returns; that of the restitution is 0 for some bodies that rebound."""


@dataclass(frozen=True)
class Frame:
    """Mass properties of a body; Bullet's frame is that of the centre of mass, along the principal axes.

    Attributes:
        centre_m: Centre of mass in the body frame [m].
        axes: Rotation from the principal axes to the body frame.
        moments: Principal moments of inertia [kg units^2].
    """

    centre_m: FloatArray
    axes: Rotation
    moments: list[float]


@dataclass(frozen=True)
class Handle:
    """A body in PyBullet.

    Attributes:
        body: PyBullet's number of the body.
        link: Number of its link; -1 is the base.
        offset_m: Position of Bullet's frame, which is that of the centre of mass, in the body frame [m].
        turn: Rotation from Bullet's frame to the body frame.
    """

    body: int
    link: int
    offset_m: FloatArray
    turn: Rotation

    @cached_property
    def quaternion(self) -> FloatArray:
        """The rotation `turn` as a quaternion w, x, y, z, shape [4]."""
        return np.asarray(self.turn.as_quat(scalar_first=True))


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


class BulletWorld:
    """A PyBullet world without bodies.

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
        # Soft bodies move otherwise in a world that others have used.
        is_rigid = not scene.has(SoftBody)
        self.client = _connect(is_reused=is_rigid)
        if self.client < 0:
            raise BackendError(
                "PyBullet opens no further world in this process: close simulations that are not used"
            )
        # Bullet keeps a world, some 30 MB, until it is disconnected: also where nobody calls `close`.
        self._disconnect = weakref.finalize(
            self, _disconnect, self.client, is_reused=is_rigid
        )
        self._disconnect.atexit = False
        self.handles: dict[str, Handle] = {}
        self.copies: dict[str, list[Handle]] = {}
        self.folder = Path()

    def call(self, function: str, *arguments: Any, **named: Any) -> Any:
        """Call a function of PyBullet in this world."""
        return getattr(pybullet, function)(
            *arguments, physicsClientId=self.client, **named
        )

    def close(self) -> None:
        """Free the world. A second call does nothing."""
        self._disconnect()
        self.client = -1

    def shape(self, shape: Shape, offset_m: FloatArray, frame: Frame) -> int:
        """Return a collision shape whose body frame lies at a place [m] in a frame along the principal axes."""
        place = {
            "collisionFramePosition": (self.scale * offset_m).tolist(),
            "collisionFrameOrientation": frame.axes.inv().as_quat().tolist(),
        }
        return int(
            self.call("createCollisionShape", **place | self._shape_arguments(shape))
        )

    def _shape_arguments(self, shape: Shape) -> dict[str, Any]:
        scale = self.scale
        flags = (
            pybullet.URDF_INITIALIZE_SAT_FEATURES
            if self.settings.polyhedral_features
            else 0
        )
        if isinstance(shape, Sphere):
            return {"shapeType": pybullet.GEOM_SPHERE, "radius": scale * shape.radius_m}
        if isinstance(shape, Cylinder):
            size = {"radius": scale * shape.radius_m, "height": scale * shape.length_m}
            return {"shapeType": pybullet.GEOM_CYLINDER, **size}
        if isinstance(shape, Plane) and self.settings.planes == "plane":
            return {"shapeType": pybullet.GEOM_PLANE, "planeNormal": [0.0, 0.0, 1.0]}
        if isinstance(shape, Plane):
            # A box below the plane.
            half = [scale * PLANE_REACH_M] * 3
            place = {"collisionFramePosition": [0.0, 0.0, -half[2]]}
            return {
                "shapeType": pybullet.GEOM_BOX,
                "halfExtents": half,
                "flags": flags,
                **place,
            }
        if isinstance(shape, Box):
            half = [0.5 * scale * edge for edge in shape.size_m]
            return {"shapeType": pybullet.GEOM_BOX, "halfExtents": half, "flags": flags}
        assert isinstance(shape, ConvexUnion), (
            "compounds are declined by unsupported_features"
        )
        pieces = [(scale * np.asarray(piece)) for piece in shape.pieces_m]
        mesh: dict[str, Any] = {"vertices": pieces[0].tolist()}
        if len(pieces) > 1:
            path = self.folder / f"{len(list(self.folder.iterdir()))}.obj"
            path.write_text("\n".join(_object_lines(pieces)) + "\n")
            mesh = {"fileName": str(path)}
        return {"shapeType": pybullet.GEOM_MESH, "flags": flags, **mesh}

    def frame(self, body: RigidBody) -> Frame:
        """Return the mass properties of a body."""
        centre_m, inertia = body_mass_properties(body)
        moments, axes = np.diag(inertia), np.eye(3)
        if np.abs(inertia - np.diag(moments)).max() > 1e-12 * np.abs(inertia).max():
            moments, axes = np.linalg.eigh(inertia)
            axes[:, 2] *= np.linalg.det(axes)
        return Frame(
            centre_m, Rotation.from_matrix(axes), (self.scale**2 * moments).tolist()
        )

    def base_arguments(self, body: RigidBody, frame: Frame) -> dict[str, Any]:
        """Return the arguments of `createMultiBody` for a body as base, whose frame is that of its centre of mass."""
        masses = {
            Motion.DYNAMIC: body.mass_kg,
            Motion.FIXED: 0.0,
            Motion.KINEMATIC: DRIVEN_MASS_KG,
        }
        return {
            "baseMass": masses[body.motion],
            "baseCollisionShapeIndex": self.shape(
                body.shape, frame.axes.inv().apply(-frame.centre_m), frame
            ),
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
        kept = self.call("getDynamicsInfo", handle.body, handle.link)
        asked = {name: value for name, value in named.items() if name in DYNAMICS}
        check_kept(
            "PyBullet", asked, {name: kept[place] for name, place in DYNAMICS.items()}
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
        number = int(
            self.call(
                "createMultiBody",
                **base,
                linkMasses=[link.mass_kg for link in links],
                linkCollisionShapeIndices=[link.shape for link in links],
                linkVisualShapeIndices=[-1] * len(links),
                linkPositions=[link.place[0].tolist() for link in links],
                linkOrientations=[link.place[1].as_quat().tolist() for link in links],
                linkInertialFramePositions=[link.centre.tolist() for link in links],
                linkInertialFrameOrientations=[[0.0, 0.0, 0.0, 1.0]] * len(links),
                linkParentIndices=list(range(len(links))),
                linkJointTypes=[link.joint for link in links],
                linkJointAxis=[list(link.axis) for link in links],
            )
        )
        if moments:
            self.call(
                "changeDynamics",
                number,
                -1,
                mass=base["baseMass"],
                localInertiaDiagonal=moments,
            )
        for row, link in enumerate(links):
            self.call(
                "changeDynamics",
                number,
                row,
                mass=link.mass_kg,
                localInertiaDiagonal=link.moments,
            )
        self.free_joints(number, links)
        return number

    def free_joints(self, body: int, links: Sequence[Link] = ()) -> None:
        """Remove Bullet's damping, speed limit and motors of the joints of a multibody.

        Args:
            body: PyBullet's number of the multibody.
            links: Its links.
        """
        for row in range(-1, len(links)):
            self.call(
                "changeDynamics",
                body,
                row,
                jointDamping=0.0,
                linearDamping=self.settings.linear_damping,
                angularDamping=self.settings.angular_damping,
                maxJointVelocity=FASTEST_JOINT,
            )
        motor = {
            "controlMode": pybullet.VELOCITY_CONTROL,
            "targetVelocity": 0.0,
            "force": 0.0,
        }
        still = {
            "targetPosition": [0.0, 0.0, 0.0, 1.0],
            "positionGain": 0.0,
            "velocityGain": 0.0,
        }
        position = pybullet.POSITION_CONTROL
        for row, link in enumerate(links):
            if link.joint == pybullet.JOINT_SPHERICAL:
                self.call(
                    "setJointMotorControlMultiDof",
                    body,
                    row,
                    position,
                    force=[0.0, 0.0, 0.0],
                    **still,
                )
            else:
                self.call("setJointMotorControl2", body, row, **motor)


_IDLE: list[int] = []
"""At most one world that is closed and still connected: to open one takes 20 ms, to empty it 1 ms."""


def _connect(*, is_reused: bool) -> int:
    """Return PyBullet's number of a world, which a reset must empty; negative if there can be no more."""
    try:
        if is_reused:
            return _IDLE.pop()
    except IndexError:
        pass
    with silent():
        return int(pybullet.connect(pybullet.DIRECT))


def _disconnect(client: int, *, is_reused: bool) -> None:
    if is_reused and not _IDLE:
        _IDLE.append(client)
        return
    with silent():
        pybullet.disconnect(physicsClientId=client)


def _object_lines(pieces: Sequence[FloatArray]) -> Iterator[str]:
    """Yield the lines of an OBJ file, the only form in which PyBullet takes a body of several convex hulls.

    Args:
        pieces: Vertices of each piece in units, shape [vertex_count, 3]; each piece is an object.
    """
    first = 1
    for index, piece in enumerate(pieces):
        yield f"o piece{index}"
        yield from (f"v {x!r} {y!r} {z!r}" for x, y, z in piece.tolist())
        yield from (
            "f " + " ".join(str(first + vertex) for vertex in face)
            for face in hull_faces(piece)
        )
        first += len(piece)
