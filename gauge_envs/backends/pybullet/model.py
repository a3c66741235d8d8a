"""A scene as bodies, joints and collision filters of one PyBullet world."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends.pybullet.contacts import frictions, impact_bodies, restitutions
from gauge_envs.backends.pybullet.engine import pybullet, silent
from gauge_envs.backends.pybullet.pieces import write_convex_pieces
from gauge_envs.backends.pybullet.settings import SettingsPyBullet
from gauge_envs.errors import BackendError
from gauge_envs.scene import (
    Box,
    Cylinder,
    Hinge,
    Motion,
    Plane,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Tether,
)
from gauge_envs.scene.meshes import mass_properties

__all__ = ["Handle", "WorldPyBullet"]

SOLVERS = {
    "sequential_impulse": "CONSTRAINT_SOLVER_LCP_SI",
    "projected_gauss_seidel": "CONSTRAINT_SOLVER_LCP_PGS",
    "dantzig": "CONSTRAINT_SOLVER_LCP_DANTZIG",
}

FASTEST_JOINT = 1e9
"""Bullet's limit on the speed of joints in units per second; its default of 100 is 1 m/s at 100 units per metre."""

EARLY_CONTACTS = 1e18
"""Distance below which Bullet's solver takes contacts by default."""

PLANE_SIZE = 2.0
"""Half the edge of the box for a plane, over the largest distance of a body from the world's origin."""

DRIVEN_MASS_KG = 1e6
"""Mass of a driven body, which contacts between two drives do not move: 1 N moves it by 2e-11 m in 1/180 s."""

STRING_MASS = 1e-6
"""Mass of the two links of a string, over that of the body that hangs on it."""


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
    offset_m: NDArray[np.float64]
    turn: Rotation


class WorldPyBullet:
    """A PyBullet world at the start of a scene.

    Args:
        scene: The scene.
        settings: Numerical settings.

    Attributes:
        handles: The bodies in PyBullet, by name.
    """

    def __init__(self, scene: Scene, settings: SettingsPyBullet) -> None:
        self._scene, self._settings = scene, settings
        self._scale = settings.units_per_m
        with silent():
            self.client = pybullet.connect(pybullet.DIRECT)
        if self.client < 0:
            raise BackendError("PyBullet opens no further world in this process: close simulations that are not used")
        self._build()

    def call(self, function: str, *arguments: Any, **named: Any) -> Any:
        """Call a function of PyBullet in this world."""
        return getattr(pybullet, function)(*arguments, physicsClientId=self.client, **named)

    def rebuild(self) -> None:
        """Return to the start of the scene, as after construction."""
        with silent():
            self.call("resetSimulation")
        self._build()

    def close(self) -> None:
        """Free the world. A second call does nothing."""
        if self.client >= 0:
            with silent():
                self.call("disconnect")
            self.client = -1

    def _build(self) -> None:
        # PyBullet reads the files of convex pieces until all bodies exist.
        with tempfile.TemporaryDirectory() as folder, silent():
            self._folder = Path(folder)
            self._add_all()

    def _add_all(self) -> None:
        self._set_parameters()
        self.handles = {}
        joints = {joint.body: joint for joint in self._scene.joints}
        for body in self._scene.bodies:
            joint = joints.get(body.name)
            if isinstance(joint, Hinge):
                self.handles[body.name] = self._hinged(body, joint)
            elif isinstance(joint, Tether):
                self.handles[body.name] = self._tethered(body, joint)
            else:
                self.handles[body.name] = self._free(body)
        self._set_contacts()
        self._filter_collisions()

    def _set_parameters(self) -> None:
        settings = self._settings
        self.call("setGravity", 0.0, 0.0, -self._scene.gravity_m_per_s2 * self._scale)
        self.call(
            "setPhysicsEngineParameter",
            fixedTimeStep=settings.timestep_s,
            numSubSteps=0,
            numSolverIterations=settings.solver_iterations,
            solverResidualThreshold=settings.residual_threshold,
            useSplitImpulse=int(settings.split_impulse != "none"),
            restitutionVelocityThreshold=settings.rebound_threshold,
            erp=settings.erp,
            contactERP=settings.contact_erp,
            frictionERP=settings.friction_erp,
            globalCFM=settings.global_cfm,
            warmStartingFactor=settings.warm_starting,
            enableConeFriction=int(settings.cone_friction),
            contactSlop=settings.contact_slop,
            enableSAT=int(settings.polyhedral_features),
            minimumSolverIslandSize=settings.island_size,
            deterministicOverlappingPairs=1,
            # The cache knows files by their names, for the whole process.
            enableFileCaching=0,
        )
        if settings.split_impulse == "all":
            self.call("setPhysicsEngineParameter", splitImpulsePenetrationThreshold=0.0)

    def _shape(self, shape: Shape, offset_m: NDArray[np.float64], turn: Rotation) -> int:
        """Return a collision shape whose body frame lies at a place in the frame of the link."""
        place = {
            "collisionFramePosition": (self._scale * offset_m).tolist(),
            "collisionFrameOrientation": turn.as_quat().tolist(),
        }
        scale = self._scale
        flags = pybullet.URDF_INITIALIZE_SAT_FEATURES if self._settings.polyhedral_features else 0
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
        pieces = [(scale * np.asarray(piece)) for piece in shape.pieces_m]
        if len(pieces) == 1:
            vertices = pieces[0].tolist()
            return int(self.call("createCollisionShape", pybullet.GEOM_MESH, vertices=vertices, flags=flags, **place))
        path = write_convex_pieces(self._folder / f"{len(list(self._folder.iterdir()))}.obj", pieces)
        return int(self.call("createCollisionShape", pybullet.GEOM_MESH, fileName=str(path), flags=flags, **place))

    def _plane(self, flags: int, place: dict[str, Any]) -> int:
        """Return Bullet's plane, or a box below the plane that reaches beyond every place of a body."""
        if self._settings.planes == "plane":
            return int(self.call("createCollisionShape", pybullet.GEOM_PLANE, planeNormal=[0.0, 0.0, 1.0], **place))
        half = PLANE_SIZE * self._scale * self._scene.distance_limit_m
        place = place | {"collisionFramePosition": [0.0, 0.0, -half]}
        return int(self.call("createCollisionShape", pybullet.GEOM_BOX, halfExtents=[half] * 3, flags=flags, **place))

    def _frame(self, body: RigidBody) -> tuple[NDArray[np.float64], Rotation, list[float]]:
        """Return the centre of mass [m], the principal axes and the moments of inertia in units of a body."""
        centre_m, inertia = mass_properties(body.shape, body.mass_kg)
        moments, axes = np.diag(inertia), np.eye(3)
        if np.abs(inertia - np.diag(moments)).max() > 1e-12 * np.abs(inertia).max():
            moments, axes = np.linalg.eigh(inertia)
            axes[:, 2] *= np.linalg.det(axes)
        return centre_m, Rotation.from_matrix(axes), (self._scale**2 * moments).tolist()

    def _free(self, body: RigidBody) -> Handle:
        """Add a free, fixed or driven body. Its base frame is that of the centre of mass."""
        centre_m, axes, moments = self._frame(body)
        mass_kg = {Motion.DYNAMIC: body.mass_kg, Motion.FIXED: 0.0, Motion.KINEMATIC: DRIVEN_MASS_KG}[body.motion]
        pose = body.pose
        number = self.call(
            "createMultiBody",
            baseMass=mass_kg,
            baseCollisionShapeIndex=self._shape(body.shape, axes.inv().apply(-centre_m), axes.inv()),
            basePosition=(self._scale * pose.to_world(centre_m)).tolist(),
            baseOrientation=(pose.rotation * axes).as_quat().tolist(),
            useMaximalCoordinates=int(not self._settings.reduced_coordinates),
        )
        handle = Handle(int(number), -1, centre_m, axes.inv())
        if body.motion is Motion.KINEMATIC:
            # Equal moments of inertia, so that the body does not tumble within a step.
            moments = [self._scale**2 * DRIVEN_MASS_KG] * 3
        if body.motion is not Motion.FIXED:
            self.set_dynamics(handle, mass=mass_kg, localInertiaDiagonal=moments)
        if body.motion is Motion.DYNAMIC:
            spin = np.asarray(body.angular_velocity_rad_per_s)
            speed = np.asarray(body.linear_velocity_m_per_s) + np.cross(spin, pose.rotation.apply(centre_m))
            self.call("resetBaseVelocity", handle.body, (self._scale * speed).tolist(), spin.tolist())
        return handle

    def set_dynamics(self, handle: Handle, **named: Any) -> None:
        """Change dynamic properties of a body or a link."""
        self.call("changeDynamics", handle.body, handle.link, **named)

    def _hinged(self, body: RigidBody, joint: Hinge) -> Handle:
        """Add a body as the link of a revolute joint. The link's frame lies at the anchor, along the principal axes."""
        centre_m, axes, moments = self._frame(body)
        link = body.pose.rotation * axes
        arm_m = link.inv().apply(body.pose.to_world(centre_m) - joint.anchor_m)
        number = self.call(
            "createMultiBody",
            baseMass=0.0,
            basePosition=(self._scale * np.asarray(joint.anchor_m)).tolist(),
            linkMasses=[body.mass_kg],
            linkCollisionShapeIndices=[
                self._shape(body.shape, arm_m + axes.inv().apply(-centre_m), axes.inv()),
            ],
            linkVisualShapeIndices=[-1],
            linkPositions=[[0.0, 0.0, 0.0]],
            linkOrientations=[link.as_quat().tolist()],
            linkInertialFramePositions=[(self._scale * arm_m).tolist()],
            linkInertialFrameOrientations=[[0.0, 0.0, 0.0, 1.0]],
            linkParentIndices=[0],
            linkJointTypes=[pybullet.JOINT_REVOLUTE],
            linkJointAxis=[link.inv().apply(joint.axis).tolist()],
        )
        handle = Handle(int(number), 0, centre_m, axes.inv())
        self.set_dynamics(handle, mass=body.mass_kg, localInertiaDiagonal=moments)
        self._free_joints(handle)
        rate = float(np.asarray(body.angular_velocity_rad_per_s) @ joint.axis)
        self.call("resetJointState", handle.body, 0, targetValue=0.0, targetVelocity=rate)
        self.call(
            "setJointMotorControl2",
            handle.body,
            0,
            controlMode=pybullet.VELOCITY_CONTROL,
            targetVelocity=0.0,
            force=0.0,
        )
        return handle

    def _tethered(self, body: RigidBody, joint: Tether) -> Handle:
        """Add a body on a string: a spherical joint, a sliding joint with an upper limit, and a spherical joint."""
        centre_m, axes, moments = self._frame(body)
        anchor = np.asarray(joint.anchor_m)
        along = np.asarray(body.pose.position_m) - anchor
        apart_m = float(np.linalg.norm(along))
        string = Rotation.align_vectors([along], [[0.0, 0.0, 1.0]])[0]
        link = body.pose.rotation * axes
        light = STRING_MASS * body.mass_kg
        arm_m = axes.inv().apply(centre_m)
        origin = [0.0, 0.0, 0.0]
        number = self.call(
            "createMultiBody",
            baseMass=0.0,
            basePosition=(self._scale * anchor).tolist(),
            linkMasses=[light, light, body.mass_kg],
            linkCollisionShapeIndices=[-1, -1, self._shape(body.shape, np.zeros(3), axes.inv())],
            linkVisualShapeIndices=[-1, -1, -1],
            linkPositions=[origin, [0.0, 0.0, self._scale * apart_m], origin],
            linkOrientations=[
                string.as_quat().tolist(),
                [0.0, 0.0, 0.0, 1.0],
                (string.inv() * link).as_quat().tolist(),
            ],
            linkInertialFramePositions=[origin, origin, (self._scale * arm_m).tolist()],
            linkInertialFrameOrientations=[[0.0, 0.0, 0.0, 1.0]] * 3,
            linkParentIndices=[0, 1, 2],
            linkJointTypes=[pybullet.JOINT_SPHERICAL, pybullet.JOINT_PRISMATIC, pybullet.JOINT_SPHERICAL],
            linkJointAxis=[[0.0, 0.0, 1.0]] * 3,
        )
        handle = Handle(int(number), 2, centre_m, axes.inv())
        self.set_dynamics(handle, mass=body.mass_kg, localInertiaDiagonal=moments)
        inertia = light * (self._scale * joint.length_m) ** 2
        for light_link in (0, 1):
            self.call("changeDynamics", handle.body, light_link, mass=light, localInertiaDiagonal=[inertia] * 3)
        self._free_joints(handle)
        # Bullet ignores limits of which the lower one is above the upper one, and needs both.
        self.call(
            "changeDynamics",
            handle.body,
            1,
            jointLowerLimit=-1e6,
            jointUpperLimit=self._scale * (joint.length_m - apart_m),
        )
        for ball_joint in (0, 2):
            self.call(
                "setJointMotorControlMultiDof",
                handle.body,
                ball_joint,
                pybullet.POSITION_CONTROL,
                targetPosition=[0.0, 0.0, 0.0, 1.0],
                positionGain=0.0,
                velocityGain=0.0,
                force=[0.0, 0.0, 0.0],
            )
        self.call(
            "setJointMotorControl2",
            handle.body,
            1,
            controlMode=pybullet.VELOCITY_CONTROL,
            targetVelocity=0.0,
            force=0.0,
        )
        return handle

    def _free_joints(self, handle: Handle) -> None:
        """Remove Bullet's damping and speed limit of all joints of a body."""
        for link in range(-1, handle.link + 1):
            self.call(
                "changeDynamics",
                handle.body,
                link,
                jointDamping=0.0,
                linearDamping=self._settings.linear_damping,
                angularDamping=self._settings.angular_damping,
                maxJointVelocity=FASTEST_JOINT,
            )

    def _set_contacts(self) -> None:
        friction, restitution = frictions(self._scene), restitutions(self._scene)
        late = impact_bodies(self._scene) if self._settings.late_impacts else set()
        awake = pybullet.ACTIVATION_STATE_DISABLE_SLEEPING
        for body in self._scene.bodies:
            self.set_dynamics(
                self.handles[body.name],
                lateralFriction=friction.get(body.name, 0.0),
                restitution=restitution.get(body.name, 0.0),
                rollingFriction=0.0,
                spinningFriction=0.0,
                linearDamping=self._settings.linear_damping,
                angularDamping=self._settings.angular_damping,
                frictionAnchor=int(self._settings.friction_anchors),
                contactProcessingThreshold=0.0 if body.name in late else EARLY_CONTACTS,
                activationState=pybullet.ACTIVATION_STATE_ENABLE_SLEEPING if self._settings.sleeping else awake,
            )

    def _filter_collisions(self) -> None:
        """Let only the pairs of the scene's contacts collide."""
        for handle in self.handles.values():
            for link in range(-1, handle.link + 1):
                self.call("setCollisionFilterGroupMask", handle.body, link, 0, 0)
        for contact in self._scene.contacts:
            for first, second in self._scene.colliding_pairs(contact):
                one, other = self.handles[first], self.handles[second]
                self.call("setCollisionFilterPair", one.body, other.body, one.link, other.link, 1)
