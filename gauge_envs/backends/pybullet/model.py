"""A scene as bodies, joints and collision filters of one PyBullet world."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.pybullet.contacts import (
    Surface,
    impact_bodies,
    pushing_bodies,
    surfaces,
    turning_shares,
)
from gauge_envs.backends.pybullet.deformables import add_rope, add_soft_body
from gauge_envs.backends.pybullet.settings import SettingsPyBullet
from gauge_envs.backends.pybullet.world import (
    DRIVEN_MASS_KG,
    BulletWorld,
    Handle,
    Link,
    pybullet,
    silent,
)
from gauge_envs.backends.settings import check_kept
from gauge_envs.backends.shared.rigid import centre_velocity
from gauge_envs.scene import (
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
"""Mass of the two links of a string, over that of the body that hangs on it."""


class WorldPyBullet(BulletWorld):
    """A PyBullet world at the start of a scene.

    Attributes:
        ropes: The ropes in PyBullet, by name.
        soft: PyBullet's numbers of the soft bodies, by name.
    """

    def __init__(self, scene: Scene, settings: SettingsPyBullet) -> None:
        super().__init__(scene, settings)
        self._surfaces = surfaces(scene)
        self._coned = pushing_bodies(scene) if settings.cone_friction else set()
        self.rebuild()

    def rebuild(self) -> None:
        """Return to the start of the scene, as after construction."""
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
        self.ropes = {
            rope.name: add_rope(self, rope, cell_m=self.settings.cell_m)
            for rope in self.scene.deformables
            if isinstance(rope, Rope)
        }
        joints = {joint.body: joint for joint in self.scene.joints}
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
            body.name: add_soft_body(
                self,
                body,
                self.folder / f"{body.name}.vtk",
                cell_m=self.settings.cell_m,
                friction=self._surfaces[body.name][0].friction
                if body.name in self._surfaces
                else None,
            )
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
        asked = {
            "fixedTimeStep": settings.timestep_s,
            "numSolverIterations": settings.solver_iterations,
        }
        check_kept("PyBullet", asked, self.call("getPhysicsEngineParameters"))
        if settings.split_impulse == "all":
            self.call("setPhysicsEngineParameter", splitImpulsePenetrationThreshold=0.0)

    def _free(self, body: RigidBody) -> None:
        """Add a free, fixed or driven body."""
        frame = self.frame(body)
        base = self.base_arguments(body, frame)
        is_coned = body.name in self._coned
        maximal = int(not (self.settings.reduced_coordinates or is_coned))
        handle = self.add_handle(
            body,
            int(self.call("createMultiBody", **base, useMaximalCoordinates=maximal)),
            -1,
        )
        # A driven body has equal moments of inertia, so that it does not tumble within a step.
        moments = (
            frame.moments
            if body.motion is Motion.DYNAMIC
            else [self.scale**2 * DRIVEN_MASS_KG] * 3
        )
        if body.motion is not Motion.FIXED:
            self.set_dynamics(
                handle, mass=base["baseMass"], localInertiaDiagonal=moments
            )
        if is_coned:
            # The limit on the speed of joints holds for the base too.
            self.free_joints(handle.body)
        if body.motion is Motion.DYNAMIC:
            speed = self.scale * centre_velocity(body, frame.centre_m)
            self.call(
                "resetBaseVelocity",
                handle.body,
                speed.tolist(),
                list(body.angular_velocity_rad_per_s),
            )

    def _hinged(self, body: RigidBody, hinge: Hinge) -> None:
        """Add a body on a hinge as the link of a fixed base at its anchor.

        The frame of the link is at the hinge, along the principal axes of the body.
        """
        frame = self.frame(body)
        origin_m = np.asarray(hinge.anchor_m)
        turn = body.pose.rotation * frame.axes
        back = turn.inv()
        centre_m = back.apply(body.pose.to_world(frame.centre_m) - origin_m)
        body_origin_m = back.apply(np.subtract(body.pose.position_m, origin_m))
        link = Link(
            joint=pybullet.JOINT_REVOLUTE,
            place=(np.zeros(3), turn),
            mass_kg=body.mass_kg,
            moments=frame.moments,
            centre=self.scale * centre_m,
            shape=self.shape(body.shape, body_origin_m, frame),
            axis=back.apply(hinge.axis).tolist(),
        )
        base = {"baseMass": 0.0, "basePosition": (self.scale * origin_m).tolist()}
        number = self.add_handle(body, self.add_multibody(base, [], [link]), 0).body
        rate = float(np.dot(body.angular_velocity_rad_per_s, hinge.axis))
        self.call("resetJointState", number, 0, targetValue=0.0, targetVelocity=rate)

    def _tethered(self, body: RigidBody, joint: Tether) -> None:
        """Add a body on a string: a spherical joint, a sliding joint with an upper limit, and a spherical joint."""
        frame = self.frame(body)
        anchor = np.asarray(joint.anchor_m)
        along = np.asarray(body.pose.position_m) - anchor
        apart_m = length_of(along)
        string = Rotation.align_vectors([along], [[0.0, 0.0, 1.0]])[0]
        mass_kg = STRING_MASS * body.mass_kg
        light: dict[str, Any] = {
            "mass_kg": mass_kg,
            "moments": [mass_kg * (self.scale * joint.length_m) ** 2] * 3,
        }
        origin = np.zeros(3)
        links = (
            Link(
                joint=pybullet.JOINT_SPHERICAL,
                place=(origin, string),
                centre=origin,
                **light,
            ),
            Link(
                joint=pybullet.JOINT_PRISMATIC,
                place=(np.array([0.0, 0.0, self.scale * apart_m]), Rotation.identity()),
                centre=origin,
                **light,
            ),
            Link(
                joint=pybullet.JOINT_SPHERICAL,
                place=(origin, string.inv() * (body.pose.rotation * frame.axes)),
                mass_kg=body.mass_kg,
                moments=frame.moments,
                centre=self.scale * frame.axes.inv().apply(frame.centre_m),
                shape=self.shape(body.shape, origin, frame),
            ),
        )
        base = {"baseMass": 0.0, "basePosition": (self.scale * anchor).tolist()}
        handle = self.add_handle(body, self.add_multibody(base, [], links), 2)
        upper = self.scale * (joint.length_m - apart_m)
        # Bullet ignores limits of which the lower one is above the upper one, and needs both.
        limits = {"jointLowerLimit": -1e6, "jointUpperLimit": upper}
        self.call("changeDynamics", handle.body, 1, **limits)

    def _set_contacts(self) -> None:
        late = impact_bodies(self.scene) if self.settings.late_impacts else set()
        settings = self.settings
        awake = pybullet.ACTIVATION_STATE_DISABLE_SLEEPING
        springs = {
            "contactStiffness": settings.contact_stiffness_n_per_m,
            "contactDamping": settings.contact_damping_n_s_per_m,
        }
        shares = turning_shares(self.scene)
        for name in self.handles:
            torsion, rolling = shares.get(name, (0.0, 0.0))
            # Bullet applies torsional friction only where there is rolling friction.
            rolling = max(rolling, 1e-6 * torsion)
            is_dynamic = self.scene.body(name).motion is Motion.DYNAMIC
            has_springs = is_dynamic and settings.contact_stiffness_n_per_m is not None
            for surface, handle in self._surface_handles(name):
                self.set_dynamics(
                    handle,
                    lateralFriction=surface.friction,
                    restitution=surface.restitution,
                    rollingFriction=0.5 * self.scale * rolling * surface.friction,
                    spinningFriction=0.5 * self.scale * torsion * surface.friction,
                    linearDamping=self.settings.linear_damping,
                    angularDamping=self.settings.angular_damping,
                    frictionAnchor=int(self.settings.friction_anchors),
                    contactProcessingThreshold=0.0 if name in late else EARLY_CONTACTS,
                    activationState=pybullet.ACTIVATION_STATE_ENABLE_SLEEPING
                    if self.settings.sleeping
                    else awake,
                    **(springs if has_springs else {}),
                )

    def _surface_handles(self, name: str) -> list[tuple[Surface, Handle]]:
        """Return the surfaces of a rigid body, each with its copy of the body."""
        found = self._surfaces.get(name, [Surface(frozenset(), 0.0, 0.0)])
        return list(
            zip(found, [self.handles[name], *self.copies.get(name, [])], strict=True)
        )

    def _towards(self, name: str, partner: str) -> Handle:
        """Return a soft body, or the copy of a rigid body whose surface is that towards another body."""
        if name in self.soft:
            return Handle(self.soft[name], -1, np.zeros(3), Rotation.identity())
        return next(
            handle
            for surface, handle in self._surface_handles(name)
            if partner in surface.partners
        )

    def _filter_collisions(self) -> None:
        """Let only the pairs of the scene's contacts collide."""
        for number in range(self.call("getNumBodies")):
            for link in range(-1, self.call("getNumJoints", number)):
                self.call(
                    "setCollisionFilterGroupMask",
                    self.call("getBodyUniqueId", number),
                    link,
                    0,
                    0,
                )
        for contact in self.scene.contacts:
            for first, second in self.scene.colliding_pairs(contact):
                one, other = self._towards(first, second), self._towards(second, first)
                self.call(
                    "setCollisionFilterPair",
                    one.body,
                    other.body,
                    one.link,
                    other.link,
                    1,
                )
