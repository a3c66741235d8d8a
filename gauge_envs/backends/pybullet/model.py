"""A scene as bodies, joints and collision filters of one PyBullet world."""

import tempfile
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.pybullet.contacts import (
    Pair,
    Surfaces,
    colliding_pairs,
    impact_bodies,
    pushing_bodies,
    surfaces,
    turning_shares,
)
from gauge_envs.backends.pybullet.deformables import RopePart, add_rope, add_soft_body
from gauge_envs.backends.pybullet.settings import SettingsPyBullet
from gauge_envs.backends.pybullet.world import (
    BASE,
    DRIVEN_MASS_KG,
    NO_ROTATION,
    Handle,
    Link,
    World,
    pybullet,
)
from gauge_envs.backends.shared.rigid import centre_velocity
from gauge_envs.scene import (
    ConvexUnion,
    Hinge,
    Motion,
    RigidBody,
    Rope,
    Scene,
    SoftBody,
    Tether,
)
from gauge_envs.scene.geometry import length_of

EARLY_CONTACTS = 1e18
"""Distance below which Bullet's solver takes contacts by default."""

STRING_MASS = 1e-6
"""Mass of the two links of a string, over the mass of its body."""

ORIGIN = np.zeros(3)

UNTOUCHED: Surfaces = {(0.0, 0.0): set()}
"""Surfaces of a body without contacts."""


class ModelPyBullet(World):
    """A PyBullet world with the bodies of a scene.

    Attributes:
        ropes: The ropes in PyBullet, by name.
        soft: PyBullet's numbers of the soft bodies, by name.
    """

    def __init__(self, scene: Scene, settings: SettingsPyBullet) -> None:
        super().__init__(scene, settings)
        self.ropes: dict[str, RopePart] = {}
        self.soft: dict[str, int] = {}
        # Body and link with the surface of the first body towards the second.
        self._towards: dict[Pair, Handle] = {}
        self._pairs = [pair for _, pair in colliding_pairs(scene)]
        self._surfaces = surfaces(scene)
        self._late = impact_bodies(scene) if settings.late_impacts else set()
        self._coned = pushing_bodies(scene) if settings.cone_friction else set()
        self._turning = turning_shares(scene)

    def build(self, bodies: Sequence[RigidBody]) -> None:
        """Clear the world, and add the scene with its rigid bodies in given initial states."""
        is_soft = self.scene.has(SoftBody)
        world = pybullet.RESET_USE_DEFORMABLE_WORLD if is_soft else 0
        self.client.resetSimulation(world)
        self._set_parameters()
        self.handles.clear()
        self.names.clear()
        has_files = is_soft or any(
            isinstance(body.shape, ConvexUnion) and len(body.shape.pieces_m) > 1
            for body in bodies
        )
        # PyBullet reads the files of convex pieces until all bodies exist.
        with tempfile.TemporaryDirectory() if has_files else nullcontext("") as folder:
            self.folder = Path(folder)
            self.ropes = {
                rope.name: add_rope(self, rope, self.settings.cell_m)
                for rope in self.scene.deformables
                if isinstance(rope, Rope)
            }
            self._add_rigid(bodies)
            self._add_soft()
            self._set_contacts()
            self._filter_collisions()

    def _set_parameters(self) -> None:
        settings = self.settings
        self.client.setGravity(0.0, 0.0, -self.scene.gravity_m_per_s2 * self.scale)
        self.client.setPhysicsEngineParameter(
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
            self.client.setPhysicsEngineParameter(splitImpulsePenetrationThreshold=0.0)

    def _add_rigid(self, bodies: Sequence[RigidBody]) -> None:
        """Add the rigid bodies that no rope has added."""
        joints = {joint.body: joint for joint in self.scene.joints}
        for body in bodies:
            joint = joints.get(body.name)
            if body.name in self.handles:
                continue
            if isinstance(joint, Hinge):
                self._add_hinged(body, joint)
            elif isinstance(joint, Tether):
                self._add_tethered(body, joint)
            else:
                for _ in self._surfaces.get(body.name, UNTOUCHED):
                    self._add_free(body)

    def _add_soft(self) -> None:
        """Add the soft bodies, which are attached to rigid bodies that exist."""
        for soft in self.scene.deformables:
            if isinstance(soft, SoftBody):
                surfaces_of = self._surfaces.get(soft.name, {})
                friction = next((friction for friction, _ in surfaces_of), None)
                number = add_soft_body(self, soft, self.settings.cell_m, friction)
                self.soft[soft.name] = number
                for partners in surfaces_of.values():
                    for partner in partners:
                        self._towards[soft.name, partner] = number, BASE

    def _add_free(self, body: RigidBody) -> None:
        """Add a free, fixed or driven body."""
        frame = self.frames[body.name]
        base = self.base_of(body)
        is_coned = body.name in self._coned
        maximal = int(not (self.settings.reduced_coordinates or is_coned))
        number = self.client.createMultiBody(**base, useMaximalCoordinates=maximal)
        self.add_handle(body.name, number, BASE)
        if body.motion is Motion.FIXED:
            return
        moments = frame.moments
        if body.motion is Motion.KINEMATIC:
            # Equal moments of inertia, so that it does not tumble within a step.
            moments = [self.scale**2 * DRIVEN_MASS_KG] * 3
        self.set_mass(number, BASE, base["baseMass"], moments)
        if is_coned:
            # The limit on the speed of joints holds for the base too.
            self.free_joints(number)
        speed = self.scale * centre_velocity(body, frame.centre_m)
        spin = list(body.angular_velocity_rad_per_s)
        self.client.resetBaseVelocity(number, speed.tolist(), spin)

    def _add_hinged(self, body: RigidBody, hinge: Hinge) -> None:
        """Add a body on a hinge as the link of a fixed base at its anchor."""
        anchor_m = np.asarray(hinge.anchor_m)
        link = self.link(
            body, pybullet.JOINT_REVOLUTE, anchor_m, ORIGIN, NO_ROTATION, hinge.axis
        )
        number = self.add_multibody(self.base(anchor_m), [], [link])
        self.add_handle(body.name, number, 0)
        rate = float(np.dot(body.angular_velocity_rad_per_s, hinge.axis))
        self.client.resetJointState(number, 0, targetValue=0.0, targetVelocity=rate)

    def _add_tethered(self, body: RigidBody, tether: Tether) -> None:
        """Add a body on a string: a spherical joint, a sliding joint with an upper limit, and a spherical joint."""
        anchor_m, origin_m = np.array([tether.anchor_m, body.pose.position_m])
        arm_m = origin_m - anchor_m
        apart = self.scale * length_of(arm_m)
        longest = self.scale * tether.length_m
        string = Rotation.align_vectors([arm_m], [[0.0, 0.0, 1.0]])[0]
        mass_kg = STRING_MASS * body.mass_kg
        light: dict[str, Any] = {
            "mass_kg": mass_kg,
            "moments": [mass_kg * longest**2] * 3,
            "centre": ORIGIN,
        }
        end = np.array([0.0, 0.0, apart])
        ball = pybullet.JOINT_SPHERICAL
        links = (
            Link(joint=ball, place=(ORIGIN, string), **light),
            Link(joint=pybullet.JOINT_PRISMATIC, place=(end, NO_ROTATION), **light),
            self.link(body, ball, origin_m, ORIGIN, string),
        )
        number = self.add_multibody(self.base(anchor_m), [], links)
        self.add_handle(body.name, number, 2)
        # Bullet needs both limits, and ignores them if the lower limit is above the upper limit.
        self.client.changeDynamics(
            number, 1, jointLowerLimit=-1e6, jointUpperLimit=longest - apart
        )

    def _set_contacts(self) -> None:
        settings = self.settings
        activation = pybullet.ACTIVATION_STATE_DISABLE_SLEEPING
        if settings.sleeping:
            activation = pybullet.ACTIVATION_STATE_ENABLE_SLEEPING
        for name, handles in self.handles.items():
            torsion, rolling = self._turning.get(name, (0.0, 0.0))
            # Bullet applies torsional friction only where there is rolling friction.
            rolling = max(rolling, 1e-6 * torsion)
            springs = {}
            is_dynamic = self.scene.body(name).motion is Motion.DYNAMIC
            if is_dynamic and settings.contact_stiffness_n_per_m is not None:
                springs = {
                    "contactStiffness": settings.contact_stiffness_n_per_m,
                    "contactDamping": settings.contact_damping_n_s_per_m,
                }
            surfaces_of_body = self._surfaces.get(name, UNTOUCHED)
            for surface, handle in zip(surfaces_of_body.items(), handles, strict=True):
                (friction, restitution), partners = surface
                self._towards |= {(name, partner): handle for partner in partners}
                self.client.changeDynamics(
                    *handle,
                    lateralFriction=friction,
                    restitution=restitution,
                    rollingFriction=0.5 * self.scale * rolling * friction,
                    spinningFriction=0.5 * self.scale * torsion * friction,
                    linearDamping=settings.linear_damping,
                    angularDamping=settings.angular_damping,
                    frictionAnchor=int(settings.friction_anchors),
                    contactProcessingThreshold=0.0
                    if name in self._late
                    else EARLY_CONTACTS,
                    activationState=activation,
                    **springs,
                )

    def _filter_collisions(self) -> None:
        """Let only the pairs of the scene's contacts collide."""
        for row in range(self.client.getNumBodies()):
            number = self.client.getBodyUniqueId(row)
            for link in range(BASE, self.client.getNumJoints(number)):
                self.client.setCollisionFilterGroupMask(number, link, 0, 0)
        let_collide = self.client.setCollisionFilterPair
        for first, second in self._pairs:
            first_body, first_link = self._towards[first, second]
            second_body, second_link = self._towards[second, first]
            let_collide(first_body, second_body, first_link, second_link, 1)
