"""A scene as bodies, joints and collision filters of one PyBullet world."""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.pybullet.chains import add_rope
from gauge_envs.backends.pybullet.contacts import Surface, impact_bodies, pushing_bodies, surfaces
from gauge_envs.backends.pybullet.engine import pybullet, silent
from gauge_envs.backends.pybullet.frames import Frame, Handle
from gauge_envs.backends.pybullet.settings import SettingsPyBullet
from gauge_envs.backends.pybullet.soft import add_soft_body
from gauge_envs.backends.pybullet.world import DRIVEN_MASS_KG, BulletWorld
from gauge_envs.scene import BodyHinge, Hinge, Motion, RigidBody, Rope, Scene, SoftBody, Tether
from gauge_envs.scene.hinged import hinge_trees, other_end, parent_hinges, start_rate_rad_per_s

EARLY_CONTACTS = 1e18
"""Distance below which Bullet's solver takes contacts by default."""

STRING_MASS = 1e-6
"""Mass of the two links of a string, over that of the body that hangs on it."""


class WorldPyBullet(BulletWorld):
    """A PyBullet world at the start of a scene.

    Args:
        scene: The scene.
        settings: Numerical settings.

    Attributes:
        ropes: The ropes in PyBullet, by name.
        soft: The soft bodies in PyBullet, by name.
    """

    def __init__(self, scene: Scene, settings: SettingsPyBullet) -> None:
        super().__init__(scene, settings)
        self._build()

    def rebuild(self) -> None:
        """Return to the start of the scene, as after construction."""
        self._build()

    def _build(self) -> None:
        # PyBullet reads the files of convex pieces until all bodies exist.
        with tempfile.TemporaryDirectory() as folder, silent():
            self.folder = Path(folder)
            self._add_all()

    def _add_all(self) -> None:
        soft = [body for body in self.scene.deformables if isinstance(body, SoftBody)]
        self.call("resetSimulation", pybullet.RESET_USE_DEFORMABLE_WORLD if soft else 0)
        self._set_parameters()
        self.handles.clear()
        self.copies.clear()
        self._surfaces = surfaces(self.scene)
        self._coned = pushing_bodies(self.scene) if self.settings.cone_friction else set()
        self.ropes = {
            rope.name: add_rope(self, rope, cell_m=self.settings.cell_m)
            for rope in self.scene.deformables
            if isinstance(rope, Rope)
        }
        joints = {joint.body: joint for joint in self.scene.joints}
        for tree in hinge_trees(self.scene.body_hinges):
            self._joined(parent_hinges(tree))
        for body in self.scene.bodies:
            joint = joints.get(body.name)
            if body.name in self.handles:
                continue
            if isinstance(joint, Hinge):
                self._hinged(body, joint)
            elif isinstance(joint, Tether):
                self._tethered(body, joint)
            else:
                # Without a contact, a body still has a place.
                for _ in self._surfaces.get(body.name, [None]):
                    self._free(body)
        self.soft = {
            body.name: add_soft_body(self, body, self.folder / f"{body.name}.vtk", cell_m=self.settings.cell_m)
            for body in soft
        }
        self._set_contacts()
        self._filter_collisions()

    def _set_parameters(self) -> None:
        settings = self.settings
        self.call("setGravity", 0.0, 0.0, -self.scene.gravity_m_per_s2 * self.scale)
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

    def _free(self, body: RigidBody) -> None:
        """Add a free, fixed or driven body."""
        frame = self.frame(body)
        base = self.base_arguments(body, frame)
        is_coned = body.name in self._coned
        maximal = int(not (self.settings.reduced_coordinates or is_coned))
        handle = self.add_handle(body, int(self.call("createMultiBody", **base, useMaximalCoordinates=maximal)), -1)
        # A driven body has equal moments of inertia, so that it does not tumble within a step.
        moments = frame.moments if body.motion is Motion.DYNAMIC else [self.scale**2 * DRIVEN_MASS_KG] * 3
        if body.motion is not Motion.FIXED:
            self.set_dynamics(handle, mass=base["baseMass"], localInertiaDiagonal=moments)
        if is_coned:
            # The limit on the speed of joints holds for the base too.
            self.free_joints(handle.body, 0, spherical=())
        if body.motion is Motion.DYNAMIC:
            self._start_base(handle.body, body, frame)

    def _hinged(self, body: RigidBody, joint: Hinge) -> None:
        """Add a body as the link of a revolute joint. The link's frame lies at the anchor, along the principal axes."""
        frame = self.frame(body)
        link = body.pose.rotation * frame.axes
        arm_m = link.inv().apply(body.pose.to_world(frame.centre_m) - joint.anchor_m)
        shape = self.shape(body.shape, link.inv().apply(np.subtract(body.pose.position_m, joint.anchor_m)), frame)
        number = self.call(
            "createMultiBody",
            baseMass=0.0,
            basePosition=(self.scale * np.asarray(joint.anchor_m)).tolist(),
            linkMasses=[body.mass_kg],
            linkCollisionShapeIndices=[shape],
            linkVisualShapeIndices=[-1],
            linkPositions=[[0.0, 0.0, 0.0]],
            linkOrientations=[link.as_quat().tolist()],
            linkInertialFramePositions=[(self.scale * arm_m).tolist()],
            linkInertialFrameOrientations=[[0.0, 0.0, 0.0, 1.0]],
            linkParentIndices=[0],
            linkJointTypes=[pybullet.JOINT_REVOLUTE],
            linkJointAxis=[link.inv().apply(joint.axis).tolist()],
        )
        handle = self.add_handle(body, int(number), 0)
        self.set_dynamics(handle, mass=body.mass_kg, localInertiaDiagonal=frame.moments)
        rate = float(np.asarray(body.angular_velocity_rad_per_s) @ joint.axis)
        self.call("resetJointState", handle.body, 0, targetValue=0.0, targetVelocity=rate)
        self.free_joints(handle.body, 1, spherical=())

    def _joined(self, hinges: Mapping[str, BodyHinge]) -> None:
        """Add bodies that hinges join as one multibody, whose base is the root.

        Args:
            hinges: The hinge through which each body but the root hangs on another one, parents first.
        """
        root = self.scene.body(next(other_end(hinge, name) for name, hinge in hinges.items()))
        frames = {name: self.frame(self.scene.body(name)) for name in (root.name, *hinges)}
        turns = {name: self.scene.body(name).pose.rotation * frame.axes for name, frame in frames.items()}
        # The frame of the base is at its centre of mass, that of a link at its hinge.
        origins = {name: np.asarray(hinge.anchor_m) for name, hinge in hinges.items()}
        origins[root.name] = root.pose.to_world(frames[root.name].centre_m)
        names = list(frames)
        links: dict[str, list[Any]] = defaultdict(list)
        for name, hinge in hinges.items():
            body, parent, back = self.scene.body(name), other_end(hinge, name), turns[name].inv()
            arm_m = back.apply(body.pose.to_world(frames[name].centre_m) - origins[name])
            offset_m = back.apply(np.subtract(body.pose.position_m, origins[name]))
            place_m = turns[parent].inv().apply(origins[name] - origins[parent])
            links["linkMasses"].append(body.mass_kg)
            links["linkCollisionShapeIndices"].append(self.shape(body.shape, offset_m, frames[name]))
            links["linkVisualShapeIndices"].append(-1)
            links["linkPositions"].append((self.scale * place_m).tolist())
            links["linkOrientations"].append((turns[parent].inv() * turns[name]).as_quat().tolist())
            links["linkInertialFramePositions"].append((self.scale * arm_m).tolist())
            links["linkInertialFrameOrientations"].append([0.0, 0.0, 0.0, 1.0])
            links["linkParentIndices"].append(names.index(parent))
            links["linkJointTypes"].append(pybullet.JOINT_REVOLUTE)
            links["linkJointAxis"].append(back.apply(hinge.axis).tolist())
        number = int(self.call("createMultiBody", **self.base_arguments(root, frames[root.name]), **links))
        for link, name in enumerate(names, start=-1):
            body = self.scene.body(name)
            handle = self.add_handle(body, number, link)
            self.set_dynamics(handle, mass=body.mass_kg, localInertiaDiagonal=frames[name].moments)
        self._start_base(number, root, frames[root.name])
        for link, (name, hinge) in enumerate(hinges.items()):
            rate = start_rate_rad_per_s(hinge, self.scene.body(name), self.scene.body(other_end(hinge, name)))
            self.call("resetJointState", number, link, targetValue=0.0, targetVelocity=rate)
        self.free_joints(number, len(hinges), spherical=())

    def _start_base(self, number: int, body: RigidBody, frame: Frame) -> None:
        """Write the start velocity of the base of a multibody."""
        spin = np.asarray(body.angular_velocity_rad_per_s)
        speed = np.asarray(body.linear_velocity_m_per_s) + np.cross(spin, body.pose.rotation.apply(frame.centre_m))
        self.call("resetBaseVelocity", number, (self.scale * speed).tolist(), spin.tolist())

    def _tethered(self, body: RigidBody, joint: Tether) -> None:
        """Add a body on a string: a spherical joint, a sliding joint with an upper limit, and a spherical joint."""
        frame = self.frame(body)
        anchor = np.asarray(joint.anchor_m)
        along = np.asarray(body.pose.position_m) - anchor
        apart_m = float(np.linalg.norm(along))
        string = Rotation.align_vectors([along], [[0.0, 0.0, 1.0]])[0]
        link = body.pose.rotation * frame.axes
        light = STRING_MASS * body.mass_kg
        arm_m = frame.axes.inv().apply(frame.centre_m)
        origin, unturned = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]
        number = self.call(
            "createMultiBody",
            baseMass=0.0,
            basePosition=(self.scale * anchor).tolist(),
            linkMasses=[light, light, body.mass_kg],
            linkCollisionShapeIndices=[-1, -1, self.shape(body.shape, np.zeros(3), frame)],
            linkVisualShapeIndices=[-1, -1, -1],
            linkPositions=[origin, [0.0, 0.0, self.scale * apart_m], origin],
            linkOrientations=[string.as_quat().tolist(), unturned, (string.inv() * link).as_quat().tolist()],
            linkInertialFramePositions=[origin, origin, (self.scale * arm_m).tolist()],
            linkInertialFrameOrientations=[unturned] * 3,
            linkParentIndices=[0, 1, 2],
            linkJointTypes=[pybullet.JOINT_SPHERICAL, pybullet.JOINT_PRISMATIC, pybullet.JOINT_SPHERICAL],
            linkJointAxis=[[0.0, 0.0, 1.0]] * 3,
        )
        handle = self.add_handle(body, int(number), 2)
        self.set_dynamics(handle, mass=body.mass_kg, localInertiaDiagonal=frame.moments)
        inertia = light * (self.scale * joint.length_m) ** 2
        for light_link in (0, 1):
            self.call("changeDynamics", handle.body, light_link, mass=light, localInertiaDiagonal=[inertia] * 3)
        self.free_joints(handle.body, 3, spherical=(0, 2))
        # Bullet ignores limits of which the lower one is above the upper one, and needs both.
        upper = self.scale * (joint.length_m - apart_m)
        self.call("changeDynamics", handle.body, 1, jointLowerLimit=-1e6, jointUpperLimit=upper)

    def _set_contacts(self) -> None:
        late = impact_bodies(self.scene) if self.settings.late_impacts else set()
        awake = pybullet.ACTIVATION_STATE_DISABLE_SLEEPING
        for name in self.handles:
            is_dynamic = self.scene.body(name).motion is Motion.DYNAMIC
            for surface, handle in self._surface_handles(name):
                self.set_dynamics(
                    handle,
                    lateralFriction=surface.friction,
                    restitution=surface.restitution,
                    rollingFriction=0.0,
                    spinningFriction=0.0,
                    linearDamping=self.settings.linear_damping,
                    angularDamping=self.settings.angular_damping,
                    frictionAnchor=int(self.settings.friction_anchors),
                    contactProcessingThreshold=0.0 if name in late else EARLY_CONTACTS,
                    activationState=pybullet.ACTIVATION_STATE_ENABLE_SLEEPING if self.settings.sleeping else awake,
                    **(self._springs() if is_dynamic else {}),
                )

    def _springs(self) -> dict[str, float]:
        """Return the arguments of compliant contacts, nothing for rigid ones."""
        stiffness, damping = self.settings.contact_stiffness_n_per_m, self.settings.contact_damping_n_s_per_m
        if stiffness is None or damping is None:
            return {}
        return {"contactStiffness": stiffness, "contactDamping": damping}

    def _surface_handles(self, name: str) -> list[tuple[Surface, Handle]]:
        """Return the surfaces of a rigid body, each with its copy of the body."""
        found = self._surfaces.get(name, [Surface(frozenset(), 0.0, 0.0)])
        return list(zip(found, [self.handles[name], *self.copies.get(name, [])], strict=True))

    def _towards(self, name: str, partner: str) -> Handle:
        """Return the copy of a rigid body whose surface is that towards another body."""
        return next(handle for surface, handle in self._surface_handles(name) if partner in surface.partners)

    def _filter_collisions(self) -> None:
        """Let only the pairs of the scene's contacts collide."""
        for number in range(self.call("getNumBodies")):
            for link in range(-1, self.call("getNumJoints", number)):
                self.call("setCollisionFilterGroupMask", self.call("getBodyUniqueId", number), link, 0, 0)
        for contact in self.scene.contacts:
            for first, second in self.scene.colliding_pairs(contact):
                one, other = self._towards(first, second), self._towards(second, first)
                self.call("setCollisionFilterPair", one.body, other.body, one.link, other.link, 1)
