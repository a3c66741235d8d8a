"""Typical mistakes of engine authors: a correct engine with one fault, the check that finds it, and its message."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends import Backend, LoopedSimulation, Simulation
from gauge_envs.scene import (
    Box,
    Capsule,
    Compound,
    Contact,
    Cylinder,
    Hinge,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Scene,
    Sphere,
    body_mass_properties,
)
from gauge_envs.scene.states import nominal_states


class Planted(Simulation):
    """Mixin of a simulation with a fault; fixed bodies report the poses of the given scene.

    Attributes:
        given: The scene of the caller.
    """

    given: Scene

    def body_states(self, names):
        states = super().body_states(names)
        for row, name in enumerate(names):
            body = self.given.body(name)
            if body.motion is Motion.FIXED:
                states[:, row, :7] = [*body.pose.position_m, *body.pose.quaternion]
        return states


class Faulty(Backend):
    """An engine with a fault.

    Args:
        healthy: The engine without the fault.
        planted: The fault.
    """

    name = "faulty"

    def __init__(self, healthy: Backend, planted: Fault):
        self.features = healthy.features
        self.healthy = healthy
        self.planted = planted

    def versions(self):
        return self.healthy.versions()

    def supports(self, scene):
        return self.healthy.supports(scene)

    def build(self, scene, settings=None):
        simulation = self.healthy.build(self.planted.scene(scene), settings)
        parts = (self.planted.simulation, type(simulation))
        simulation.__class__ = type("FaultySimulation", parts, {"given": scene})
        return simulation

    def build_worlds(self, scene, world_count, settings=None):
        worlds = [self.build(scene, settings) for _ in range(world_count)]
        return self.planted.worlds(worlds)


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault of an engine.

    Attributes:
        caught_by: Id of the check that names it.
        says: Words of its message.
        scene: Function from a scene to the scene that the engine builds instead.
        simulation: Part of the class of its simulation.
        worlds: How it joins the simulations of several worlds.
        engine: Class of the engine.
    """

    caught_by: str = ""
    says: str = ""
    scene: Callable[[Scene], Scene] = lambda scene: scene
    simulation: type[Planted] = Planted
    worlds: type[LoopedSimulation] = LoopedSimulation
    engine: type[Faulty] = Faulty


# --- the engine misreads the scene ---


def change_bodies(change):
    """Return a fault of each body."""
    return lambda scene: replace(
        scene, bodies=tuple(change(body) for body in scene.bodies)
    )


def change_contacts(change):
    """Return a fault of each contact."""
    return lambda scene: replace(
        scene, contacts=tuple(change(contact) for contact in scene.contacts)
    )


def _level_plane(body: RigidBody) -> RigidBody:
    if not isinstance(body.shape, Plane):
        return body
    return replace(body, pose=Pose(position_m=body.pose.position_m))


def _scalar_last(body: RigidBody) -> RigidBody:
    x, y, z, w = body.pose.quaternion
    return replace(body, pose=replace(body.pose, quaternion=(w, x, y, z)))


def _half_edges(body: RigidBody) -> RigidBody:
    if not isinstance(body.shape, Box) or body.motion is not Motion.DYNAMIC:
        return body
    size_m = tuple(2.0 * edge for edge in body.shape.size_m)
    return replace(body, shape=Box(size_m=size_m))


def _sphere_inertia(body: RigidBody) -> RigidBody:
    """Give a body the inertia of a sphere about it."""
    if body.motion is not Motion.DYNAMIC or isinstance(body.shape, Sphere):
        return body
    _, inertia_kg_m2 = body_mass_properties(body)
    mean = float(np.trace(inertia_kg_m2)) / 3.0
    return replace(body, inertia_kg_m2=mean)


def _first_part(body: RigidBody) -> RigidBody:
    if not isinstance(body.shape, Compound):
        return body
    return replace(body, shape=replace(body.shape, parts=body.shape.parts[:1]))


def _of_bodies(contact: Contact) -> Contact:
    """Multiply the friction of two bodies that each have the friction of the pair."""
    return replace(contact, friction=contact.friction**2)


def _axis_of_body(scene: Scene) -> Scene:
    """Rotate the axes of hinges from the body frame to the world frame."""
    joints = []
    for joint in scene.joints:
        if isinstance(joint, Hinge):
            turned = scene.body(joint.body).pose.rotation.apply(joint.axis)
            joint = replace(joint, axis=tuple(turned.tolist()))
        joints.append(joint)
    return replace(scene, joints=tuple(joints))


def _without_contacts(scene: Scene, names: set[str]) -> Scene:
    """Take bodies out of all contacts."""
    contacts = []
    for contact in scene.contacts:
        sides = [
            tuple(name for name in side if name not in names)
            for side in (contact.first, contact.second)
        ]
        if all(sides):
            contacts.append(replace(contact, first=sides[0], second=sides[1]))
    return replace(scene, contacts=tuple(contacts))


def _hinged_pass(scene: Scene) -> Scene:
    hinged = {joint.body for joint in scene.joints if isinstance(joint, Hinge)}
    return _without_contacts(scene, hinged)


def _capsules_pass(scene: Scene) -> Scene:
    names = {
        body.name
        for body in scene.bodies
        if isinstance(body.shape, Compound)
        and any(isinstance(part.shape, Capsule) for part in body.shape.parts)
    }
    return _without_contacts(scene, names)


def _thin_pass(scene: Scene) -> Scene:
    """Leave out fixed boxes thinner than 5 mm."""
    names = {
        body.name
        for body in scene.bodies
        if body.motion is Motion.FIXED
        and isinstance(body.shape, Box)
        and min(body.shape.size_m) < 0.005
    }
    return _without_contacts(scene, names)


def _hovers(body: RigidBody) -> RigidBody:
    """Give a box below 10 mm a margin of 0.1 mm."""
    if not isinstance(body.shape, Box) or max(body.shape.size_m) > 0.01:
        return body
    size_m = tuple(edge + 2e-4 for edge in body.shape.size_m)
    return replace(body, shape=Box(size_m=size_m))


def _water_below_1_cm3(body: RigidBody) -> RigidBody:
    """Give a body below 1 cm^3 the density of water."""
    volume_m3 = body.shape.volume_m3
    if body.motion is not Motion.DYNAMIC or volume_m3 > 1e-6:
        return body
    return replace(body, mass_kg=1000.0 * volume_m3)


def _odd_tile_high(body: RigidBody) -> RigidBody:
    """Raise every second tile of a floor by 0.3 mm."""
    if not body.name.endswith(("tile 1", "tile 3", "tile 5")):
        return body
    x, y, z = body.pose.position_m
    return replace(body, pose=replace(body.pose, position_m=(x, y, z + 3e-4)))


# --- the simulation runs or reports wrongly ---


class _NoPress(Planted):
    """Drop the part of a force that presses on a support."""

    def apply_wrench(self, body, wrenches):
        wrenches = np.array(wrenches)
        if self.given.contacts:
            wrenches[:, 2] = np.maximum(wrenches[:, 2], 0.0)
        super().apply_wrench(body, wrenches)


class _SpinGrows(Planted):
    """Add 1.5 % of spin in ten seconds to free bodies."""

    def advance(self, seconds):
        super().advance(seconds)
        if not self.given.contacts and not self.given.joints:
            spins = self.data.qvel.reshape(-1, 6)[:, 3:]
            spins *= 1.0 + 1.5e-3 * seconds


class _TurnsAsItSlides(Planted):
    """Turn sliding boxes about their normal by 0.3 rad/s^2, as friction that acts on one contact after the other."""

    def advance(self, seconds):
        super().advance(seconds)
        for body in self.given.dynamic_bodies:
            rates = self.data.joint(body.name).qvel
            is_free_box = isinstance(body.shape, Box) and len(rates) == 6
            if is_free_box and self.data.ncon and np.hypot(*rates[:2]) > 0.05:
                rates[5] += 0.3 * seconds


class _LyingCylindersRock(Planted):
    """Kick cylinders to and fro about the vertical to their axis, as one contact that jumps between its ends."""

    sign = 1.0

    def advance(self, seconds):
        super().advance(seconds)
        self.sign = -self.sign
        for body in self.given.dynamic_bodies:
            if isinstance(body.shape, Cylinder) and self.data.ncon:
                self.data.joint(body.name).qvel[3] += 0.05 * self.sign


class _TorqueInBodyFrame(Planted):
    def apply_wrench(self, body, wrenches):
        wrenches = np.array(wrenches)
        frame = self.data.body(body).xmat.reshape(3, 3)
        wrenches[:, 3:] = wrenches[:, 3:] @ frame.T
        super().apply_wrench(body, wrenches)


class _FrictionReversed(Planted):
    """Report contact forces on level bodies with the other sign of friction."""

    def contact_forces(self, pairs):
        read = super().contact_forces(pairs)
        return lambda: read() * [-1.0, -1.0, 1.0]


class _KeepsImpulses(Planted):
    """Start a run with a share of the contact impulses of the run before."""

    kept = 0.0

    def reset(self, starts=None, seed=0):
        self.kept = self.data.qfrc_constraint.copy()
        super().reset(starts, seed)

    def advance(self, seconds):
        self.data.qvel[:] += 1e-2 * self.kept
        self.kept = 0.0
        super().advance(seconds)


class _OneStepACall(Planted):
    def advance(self, seconds):
        super().advance(1.0 / 180.0)


class _Late(Planted):
    """Read states before the call of advance, not after it."""

    before = None

    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        self.before = None

    def advance(self, seconds):
        names = [body.name for body in self.given.bodies]
        self.before = dict(zip(names, super().body_states(names)[0], strict=True))
        super().advance(seconds)

    def body_states(self, names):
        if self.before is None:
            return super().body_states(names)
        return np.array([[self.before[name] for name in names]])


class _SceneOrder(Planted):
    def body_states(self, names):
        order = [body.name for body in self.given.bodies if body.name in names]
        return super().body_states(order)


class _OneBuffer(Planted):
    buffer = None

    def body_states(self, names):
        states = super().body_states(names)
        if self.buffer is None or self.buffer.shape != states.shape:
            self.buffer = states
        self.buffer[:] = states
        return self.buffer


class _Single(Planted):
    def body_states(self, names):
        return super().body_states(names).astype(np.float32)


class _Millimetres(Planted):
    def body_states(self, names):
        states = super().body_states(names)
        states[..., :3] *= 1e3
        return states


class _SpinInBodyFrame(Planted):
    def body_states(self, names):
        states = super().body_states(names)
        for row in states.reshape(-1, 13):
            rotation = Rotation.from_quat(row[3:7], scalar_first=True)
            row[10:] = rotation.apply(row[10:], inverse=True)
        return states


class _VelocityOfCentre(Planted):
    def body_states(self, names):
        states = super().body_states(names)
        for column, name in enumerate(names):
            body = self.given.body(name)
            if body.motion is Motion.DYNAMIC:
                centre_m, _ = _mass_properties(body)
                for row in states[:, column]:
                    rotation = Rotation.from_quat(row[3:7], scalar_first=True)
                    row[7:10] += np.cross(row[10:], rotation.apply(centre_m))
        return states


_mass_properties = cache(body_mass_properties)


class _GravityInVelocity(Planted):
    """Report the velocity before the contacts of a step, g h for a body at rest."""

    def body_states(self, names):
        states = super().body_states(names)
        for column, name in enumerate(names):
            if self.given.body(name).motion is Motion.DYNAMIC and self.given.contacts:
                states[:, column, 9] -= self.given.gravity_m_per_s2 / 1800.0
        return states


class _Teleported(Planted):
    def drive(self, body, targets):
        targets = np.array(targets)
        targets[:, 7:] = 0.0
        super().drive(body, targets)


class _NoAcceleration(Planted):
    def drive(self, body, targets):
        targets = np.array(targets)
        targets[:, 13:] = 0.0
        super().drive(body, targets)


class _DrivesLate(Planted):
    late: Mapping[str, np.ndarray] = {}

    def reset(self, starts=None, seed=0):
        self.late = {}
        super().reset(starts, seed)

    def drive(self, body, targets):
        super().drive(body, self.late.get(body, targets))
        self.late = {**self.late, body: np.array(targets)}


class _NoReset(Planted):
    def reset(self, starts=None, seed=0):
        pass


class _WrenchOfOneCall(Planted):
    pushed: tuple[str, ...] = ()

    def apply_wrench(self, body, wrenches):
        self.pushed = (*self.pushed, body)
        super().apply_wrench(body, wrenches)

    def advance(self, seconds):
        super().advance(seconds)
        for body in self.pushed:
            super().apply_wrench(body, np.zeros((self.world_count, 6)))


class _KeepsWrench(Planted):
    last: tuple[str, np.ndarray] | None = None

    def apply_wrench(self, body, wrenches):
        self.last = (body, np.array(wrenches))
        super().apply_wrench(body, wrenches)

    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        if self.last is not None:
            super().apply_wrench(*self.last)


class _NotFinite(Planted):
    """Report NaN states after the first step."""

    has_stepped = False

    def reset(self, starts=None, seed=0):
        self.has_stepped = False
        super().reset(starts, seed)

    def advance(self, seconds):
        self.has_stepped = True
        super().advance(seconds)

    def body_states(self, names):
        states = super().body_states(names)
        for row, name in enumerate(names):
            if self.has_stepped and self.given.body(name).motion is Motion.DYNAMIC:
                states[:, row] = np.nan
        return states


class _Leaks(Planted):
    """Keep 0.1 MB at each reset."""

    kept: tuple[np.ndarray, ...] = ()

    def reset(self, starts=None, seed=0):
        self.kept = (*self.kept, np.ones(12_500))
        super().reset(starts, seed)


class _Noisy(Planted):
    """Add noise of 1 um that does not depend on the seed."""

    random = np.random.default_rng()

    def body_states(self, names):
        states = super().body_states(names)
        states[..., :3] += 1e-6 * self.random.standard_normal(states[..., :3].shape)
        return states


class _IgnoresStarts(Planted):
    def first_row(self):
        return 0

    def reset(self, starts=None, seed=0):
        if starts is not None:
            starts = starts.copy()
            first = self.first_row()
            starts[:, first:] = nominal_states(self.given)[first:]
        super().reset(starts, seed)


class _StartsClothInPlace(_IgnoresStarts):
    def first_row(self):
        return len(self.given.bodies)


class _StartsAsFirst(LoopedSimulation):
    def reset(self, starts=None, seed=0):
        if starts is not None:
            starts = np.repeat(starts[:1], self.world_count, axis=0)
        super().reset(starts, seed)


class _DrivesAsFirst(LoopedSimulation):
    def drive(self, body, targets):
        super().drive(body, np.repeat(targets[:1], self.world_count, axis=0))


# --- the engine violates the contract ---


class _SupportsRaises(Faulty):
    """Look up the bodies of each pair, which may be deformable."""

    def supports(self, scene):
        for contact in scene.contacts:
            for pair in scene.colliding_pairs(contact):
                for name in pair:
                    scene.body(name)
        return super().supports(scene)


class _ChangesScene(Faulty):
    def build(self, scene, settings=None):
        object.__setattr__(scene, "gravity_m_per_s2", -scene.gravity_m_per_s2)
        return super().build(scene, settings)


FAULTS = {
    "arrays in float32": Fault(
        caught_by="order-of-names",
        says="float32 (1, 1, 13) instead of ndarray float64 (1, n, 13)",
        simulation=_Single,
    ),
    "supports raises for deformable bodies": Fault(
        caught_by="reset-start",
        says="supports() raised KeyError: 'cloth' (supports, faults.py",
        engine=_SupportsRaises,
    ),
    "the scene is changed in place": Fault(
        caught_by="determinism",
        says="the engine changed the scene that it was given: scene: gravity",
        engine=_ChangesScene,
    ),
    "rows in the order of the scene": Fault(
        caught_by="order-of-names",
        says="rows are not in the order of the names",
        simulation=_SceneOrder,
    ),
    "one array for all calls": Fault(
        caught_by="order-of-names",
        says="a returned array changes later; return a copy",
        simulation=_OneBuffer,
    ),
    "positions in millimetres": Fault(
        caught_by="start-position",
        says="body_states must report body origins [m]",
        simulation=_Millimetres,
    ),
    "quaternions x, y, z, w": Fault(
        caught_by="start-orientation",
        says="a quaternion is w, x, y, z from the body to the world",
        scene=change_bodies(_scalar_last),
    ),
    "angular velocity in the body frame": Fault(
        caught_by="glide-reports",
        says="the angular velocity, in the world frame",
        simulation=_SpinInBodyFrame,
    ),
    "velocity of the centre of mass": Fault(
        caught_by="glide-reports",
        says="columns 7 to 12 are the velocity of the body's origin",
        simulation=_VelocityOfCentre,
    ),
    "velocity before the contacts of a step": Fault(
        caught_by="start-rest",
        says="velocities are those after the contacts of a step",
        simulation=_GravityInVelocity,
    ),
    "NaN": Fault(
        caught_by="determinism",
        says="not finite: after 0.00556 s 'brick' is not finite",
        simulation=_NotFinite,
    ),
    "noise": Fault(
        caught_by="determinism", says="random numbers have no seed", simulation=_Noisy
    ),
    "one step a call": Fault(
        caught_by="time",
        says="advance(seconds) must simulate any time",
        simulation=_OneStepACall,
    ),
    "states before the call": Fault(
        caught_by="time",
        says="states are those before the last call of advance",
        simulation=_Late,
    ),
    "edges read as half edges": Fault(
        caught_by="inertia",
        says="the inertia is 4.001 times what it should be",
        scene=change_bodies(_half_edges),
    ),
    "the inertia of a sphere": Fault(
        caught_by="spin-momentum",
        says="the inertia or its frame is wrong",
        scene=change_bodies(_sphere_inertia),
    ),
    "the first part of a compound": Fault(
        caught_by="start-velocity-of-origin",
        says="the path of the compound",
        scene=change_bodies(_first_part),
    ),
    "a leaning plane built level": Fault(
        caught_by="roll-ball",
        says="the plane is level",
        scene=change_bodies(_level_plane),
    ),
    "hinge axis in the body frame": Fault(
        caught_by="hinge-radius",
        says="does not rotate the body about its hinge",
        scene=_axis_of_body,
    ),
    "frictions of two bodies multiplied": Fault(
        caught_by="pucks-friction",
        says="the engine multiplies the values of two bodies",
        scene=change_contacts(_of_bodies),
    ),
    "friction 20 % low": Fault(
        caught_by="pucks-friction",
        says="friction is smaller than Contact.friction",
        scene=change_contacts(
            lambda contact: replace(contact, friction=0.8 * contact.friction)
        ),
    ),
    "a driven body without velocity": Fault(
        caught_by="driven-velocity",
        says="it reports 0 times its velocity",
        simulation=_Teleported,
    ),
    "a driven body without acceleration": Fault(
        caught_by="driven-path",
        says="the acceleration that drive() gives were 0",
        simulation=_NoAcceleration,
    ),
    "a driven body an interval late": Fault(
        caught_by="driven-path",
        says="it comes one interval late",
        simulation=_DrivesLate,
    ),
    "a wrench for one call": Fault(
        caught_by="wrench-force",
        says="a wrench acts in all steps, until another call replaces it",
        simulation=_WrenchOfOneCall,
    ),
    "a wrench that reset keeps": Fault(
        caught_by="wrench-reset",
        says="reset() must clear forces, torques",
        simulation=_KeepsWrench,
    ),
    "reset does nothing": Fault(
        caught_by="start-position",
        says="before the first step and after reset",
        simulation=_NoReset,
    ),
    "reset keeps memory": Fault(
        caught_by="life",
        says="reset() makes objects that nothing frees",
        simulation=_Leaks,
    ),
    "starts ignored": Fault(
        caught_by="starts-free",
        says="reset(starts) must write pose and velocities of each body",
        simulation=_IgnoresStarts,
    ),
    "starts of a cloth ignored": Fault(
        caught_by="starts-free",
        says="the nodes of the cloth after reset(starts)",
        simulation=_StartsClothInPlace,
    ),
    "all worlds start as the first": Fault(
        caught_by="worlds-single",
        says="it has the course of start 0",
        worlds=_StartsAsFirst,
    ),
    "all worlds driven as the first": Fault(
        caught_by="worlds-single",
        says="first the plate in interval 1",
        worlds=_DrivesAsFirst,
    ),
    "hinged bodies pass": Fault(
        caught_by="grasp", says="the pads do not hold it at all", scene=_hinged_pass
    ),
    "capsules pass": Fault(
        caught_by="rest-shapes", says="the pair has no contact", scene=_capsules_pass
    ),
    "thin walls are left out": Fault(
        caught_by="thin-wall", says="an impact is missed", scene=_thin_pass
    ),
    "small boxes hover": Fault(
        caught_by="rest-small",
        says="lengths for large bodies",
        scene=change_bodies(_hovers),
    ),
    "tiles are not flush": Fault(
        caught_by="seam-slide",
        says="at the inner edge",
        scene=change_bodies(_odd_tile_high),
    ),
    "a pressing force is ignored": Fault(
        caught_by="push-holds",
        says="friction does not follow a force that presses",
        simulation=_NoPress,
    ),
    "spin grows": Fault(
        caught_by="tumble-long",
        says="the gyroscopic term is missing",
        simulation=_SpinGrows,
    ),
    "sliding boxes turn": Fault(
        caught_by="slide-straight",
        says="friction acts unevenly",
        simulation=_TurnsAsItSlides,
    ),
    "lying cylinders rock": Fault(
        caught_by="rest-still",
        says="so that bodies rock or roll",
        simulation=_LyingCylindersRock,
    ),
    "the mass of small bodies is ignored": Fault(
        caught_by="wrench-force",
        says="the acceleration of the 0.1 kg grain",
        scene=change_bodies(_water_below_1_cm3),
    ),
    "torques in the body frame": Fault(
        caught_by="inertia",
        says="or a torque otherwise",
        simulation=_TorqueInBodyFrame,
    ),
    "contact forces with reversed friction": Fault(
        caught_by="contact-force",
        says="its friction has the other sign",
        simulation=_FrictionReversed,
    ),
    "contact impulses survive a reset": Fault(
        caught_by="reset-course",
        says="reset() leaves something behind",
        simulation=_KeepsImpulses,
    ),
}
"""Faults by name."""
