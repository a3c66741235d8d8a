"""Sixth set: faults of physics engines, half from public trackers, planted in the backend of MuJoCo.

They were written after the rules of causes, with the words that name them, and run once.
"""

from dataclasses import replace
from functools import partial
from typing import ClassVar

import numpy as np

from gauge_envs.backends import LoopedSimulation
from gauge_envs.scene import (
    Capsule,
    Compound,
    Cylinder,
    Hinge,
    Motion,
    Plane,
    Sphere,
    body_mass_properties,
)
from studies.planted_faults.contract_faults import all_pairs, changed_model
from studies.planted_faults.third_set import (
    DeepContacts,
    Stepped,
    bodies_of_pair,
    dofs,
    entry,
    free,
)
from tests.faults import Fault, Planted, change_bodies, change_contacts

# --- from public trackers ---


def _friction_over_points(model, simulation):
    """Halve the friction of pairs without a ball, which have several points."""
    balls = {
        body.name for body in simulation.given.bodies if isinstance(body.shape, Sphere)
    }
    for index in range(model.npair):
        if not balls & set(bodies_of_pair(model, index)):
            model.pair_friction[index, :2] *= 0.5


def _inertia_along_y(model, simulation):
    """Give cylinders and parts the inertia of an axis along y."""
    for body in free(simulation.given):
        if isinstance(body.shape, Cylinder | Capsule):
            row = model.body(body.name).id
            _, tensor = body_mass_properties(body)
            model.body_inertia[row] = np.diag(tensor)[[0, 2, 1]]
            model.body_iquat[row] = [1.0, 0.0, 0.0, 0.0]


class _SpinningSink(DeepContacts):
    """Balls that spin faster than 8 rad/s sink by 2 mm."""

    def depth_m(self, body, velocities):
        is_fast = np.linalg.norm(velocities[3:]) > 8.0
        return 2e-3 if is_fast and isinstance(body.shape, Sphere) else 0.0


class _WrenchGrows(Planted):
    """Each call of advance adds the wrench once more."""

    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        self._pushed = {}

    def apply_wrench(self, body, wrenches):
        self.__dict__.setdefault("_pushed", {})[body] = [np.array(wrenches), 0]
        super().apply_wrench(body, wrenches)

    def advance(self, seconds):
        for body, pushed in self.__dict__.setdefault("_pushed", {}).items():
            pushed[1] += 1
            super().apply_wrench(body, pushed[0] * pushed[1])
        super().advance(seconds)


class _Swapped(Planted):
    """Report spins in the columns of velocities, and the reverse."""

    def body_states(self, names):
        states = super().body_states(names)
        return states[..., [*range(7), 10, 11, 12, 7, 8, 9]]


class _NoStartVelocity(Planted):
    """reset(starts) ignores velocities."""

    def reset(self, starts=None, seed=0):
        if starts is not None:
            starts = np.array(starts)
            starts[..., 7:] = 0.0
        super().reset(starts, seed)


class _Lifted(Planted):
    """A ball is lifted by 2 mm as it rebounds, to leave the other body."""

    def advance(self, seconds):
        model, data = self.model, self.data
        balls = [b for b in free(self.given) if isinstance(b.shape, Sphere)]
        before = {b.name: data.qvel[dofs(model, b.name)][2] for b in balls}
        super().advance(seconds)
        for body in balls:
            after = data.qvel[dofs(model, body.name)][2]
            if before[body.name] < -0.2 and after > 0.2:
                data.qpos[int(model.joint(body.name).qposadr[0]) + 2] += 2e-3


class _GravityInFirstSteps(Stepped):
    """Gravity acts in the first three quarters of the steps of a call."""

    def _step(self, world, count):
        gravity = self.model.opt.gravity.copy()
        self._left = 0.75 * count
        self._gravity = gravity
        super()._step(world, count)
        self.model.opt.gravity[:] = gravity

    def before(self, data):
        self.model.opt.gravity[:] = self._gravity if self._left > 0.0 else 0.0
        self._left -= 1.0


class _StaleAfterReset(Planted):
    """After a reset, states are those of before until the next advance."""

    def reset(self, starts=None, seed=0):
        self._stale = None
        if getattr(self, "_has_run", False):
            names = [body.name for body in self.given.bodies]
            states = super().body_states(names)
            self._stale = dict(zip(names, np.moveaxis(states, 1, 0), strict=True))
        super().reset(starts, seed)

    def advance(self, seconds):
        self._stale = None
        self._has_run = True
        super().advance(seconds)

    def body_states(self, names):
        stale = getattr(self, "_stale", None)
        if stale is None:
            return super().body_states(names)
        return np.stack([stale[name] for name in names], axis=1)


class _SharedGravity(Planted):
    """The gravity of the simulation that was built last acts in all of the process."""

    last: ClassVar[dict] = {}

    def reset(self, starts=None, seed=0):
        if "_own" not in self.__dict__:
            self._own = self.model.opt.gravity.copy()
            _SharedGravity.last["gravity"] = self._own
        super().reset(starts, seed)

    def advance(self, seconds):
        self.model.opt.gravity[:] = _SharedGravity.last.get(
            "gravity", self.model.opt.gravity
        )
        super().advance(seconds)


# --- own ---


def _anchor_off(scene):
    joints = tuple(
        replace(joint, anchor_m=tuple(np.add(joint.anchor_m, (0.003, 0.0, 0.0))))
        if isinstance(joint, Hinge)
        else joint
        for joint in scene.joints
    )
    return replace(scene, joints=joints)


def _heavy_compounds(body):
    if not isinstance(body.shape, Compound) or body.motion is not Motion.DYNAMIC:
        return body
    return replace(body, mass_kg=1.5 * body.mass_kg)


class _NoSpinOfDrive(Planted):
    def drive(self, body, targets):
        targets = np.array(targets)
        targets[:, 10:13] = 0.0
        targets[:, 16:19] = 0.0
        super().drive(body, targets)


def _dead_solids(scene):
    """Only balls rebound."""
    balls = {body.name for body in scene.bodies if isinstance(body.shape, Sphere)}
    contacts = []
    for contact in scene.contacts:
        for first, second in scene.colliding_pairs(contact):
            pair = replace(contact, first=(first,), second=(second,))
            if not {first, second} & balls:
                pair = replace(pair, restitution=0.0)
            contacts.append(pair)
    return replace(scene, contacts=tuple(contacts))


def _tilted_gravity(model, _):
    size = np.linalg.norm(model.opt.gravity)
    angle = np.radians(2.0)
    model.opt.gravity[:] = size * np.array([np.sin(angle), 0.0, -np.cos(angle)])


def _order_of_pairs(scene):
    """A pair that lists its fixed body first has half of its friction."""
    still = {body.name for body in scene.bodies if body.motion is not Motion.DYNAMIC}
    contacts = []
    for contact in scene.contacts:
        is_first = set(contact.first) <= still
        factor = 0.5 if is_first else 1.0
        contacts.append(replace(contact, friction=factor * contact.friction))
    return replace(scene, contacts=tuple(contacts))


class _ForceLimit(Planted):
    """Forces of wrenches are limited to 0.05 N."""

    def apply_wrench(self, body, wrenches):
        wrenches = np.array(wrenches)
        sizes = np.linalg.norm(wrenches[:, :3], axis=1, keepdims=True)
        wrenches[:, :3] *= np.minimum(1.0, 0.05 / np.maximum(sizes, 1e-12))
        super().apply_wrench(body, wrenches)


class _OnlyFirstDriven(LoopedSimulation):
    def drive(self, body, targets):
        targets = np.array(targets)
        targets[1:, 7:] = 0.0
        super().drive(body, targets)


class _WholeFrames(Planted):
    """advance simulates whole frames of 1/240 s, and drops the rest."""

    def advance(self, seconds):
        super().advance(max(np.floor(seconds * 240.0 + 1e-9), 1.0) / 240.0)


class _HalfFriction(Planted):
    """contact_forces have half of the friction."""

    def contact_forces(self, pairs):
        read = super().contact_forces(pairs)
        return lambda: read() * [0.5, 0.5, 1.0]


def _raised_planes(body):
    if not isinstance(body.shape, Plane):
        return body
    lifted = np.array(body.pose.position_m) + 1e-3 * body.pose.matrix[:, 2]
    return replace(body, pose=replace(body.pose, position_m=tuple(lifted)))


FAULTS6 = {
    "friction over points": entry(
        "bepu/bepuphysics2 pull 410",
        "convex manifolds divide the friction by the number of contacts",
        "Friction of faces is too small; that of balls is right.",
        changed_model(_friction_over_points),
    ),
    "cylinder inertia along y": entry(
        "newton-physics/newton pull 505",
        "the inertia of cylinders is about another axis",
        "Cylinders have another inertia.",
        changed_model(_inertia_along_y),
    ),
    "spinning balls sink": entry(
        "avianphysics/avian pull 1023",
        "fast balls sink into the ground",
        "Spinning or rolling balls sink.",
        Fault(simulation=_SpinningSink),
    ),
    "wrench grows": entry(
        "anthonytorlucci/rlevo pull 250",
        "forces are never cleared and accumulate",
        "apply_wrench applies a multiple.",
        Fault(simulation=_WrenchGrows),
    ),
    "free pairs collide": entry(
        "schteppe/cannon.js issue 261; hecht-software/box2dweb issue 25",
        "filters of pairs are ignored",
        "Bodies collide that have no contact.",
        Fault(scene=partial(all_pairs, is_free=True)),
    ),
    "velocity and spin swapped": entry(
        "RoboVerseOrg/RoboVerse pull 204",
        "spatial velocities have the angular part first",
        "Reported velocities and spins are swapped.",
        Fault(simulation=_Swapped),
    ),
    "start velocities ignored": entry(
        "isaac-sim/IsaacLab issue 5064",
        "a written velocity does not reach the solver",
        "reset(starts) ignores velocities.",
        Fault(simulation=_NoStartVelocity),
    ),
    "lifted at impacts": entry(
        "piqnt/planck.js issue 223",
        "removal of overlap adds height, so that a ball jumps higher",
        "Impacts add energy: rebounds are too high.",
        Fault(simulation=_Lifted),
    ),
    "global friction": entry(
        "gazebosim/gazebo-classic issue 989",
        "boxes with different coefficients slide at the same rate",
        "Friction is not that of the pair but one value.",
        Fault(scene=change_contacts(lambda c: replace(c, friction=0.4))),
    ),
    "gravity in a part of the steps": entry(
        "bulletphysics/bullet3 pull 668",
        "gravity does not act in all substeps",
        "Gravity is too small.",
        Fault(simulation=_GravityInFirstSteps),
    ),
    "stale after reset": entry(
        "unilabsim/unisim issue 143",
        "states are not refreshed by a reset until the next step",
        "States right after a reset are those of before.",
        Fault(simulation=_StaleAfterReset),
    ),
    "shared gravity": entry(
        "StanfordVL/BEHAVIOR-1K pull 699",
        "environments of a process share their physics",
        "Simulations share gravity.",
        Fault(simulation=_SharedGravity),
    ),
    "anchor off": entry(
        "own", "3 mm", "Hinges have another anchor.", Fault(scene=_anchor_off)
    ),
    "heavy compounds": entry(
        "own",
        "1.5 times the mass of compounds",
        "Some bodies have another mass.",
        Fault(scene=change_bodies(_heavy_compounds)),
    ),
    "no spin of drive": entry(
        "own",
        "drive() ignores the spin",
        "Driven bodies lack their spin.",
        Fault(simulation=_NoSpinOfDrive),
    ),
    "dead solids": entry(
        "own",
        "only balls rebound",
        "Bodies other than balls do not rebound.",
        Fault(scene=_dead_solids),
    ),
    "tilted gravity": entry(
        "own",
        "2 degrees",
        "Gravity has another direction.",
        changed_model(_tilted_gravity),
    ),
    "order of pairs": entry(
        "own",
        "friction x 0.5 if the fixed body comes first",
        "Friction depends on the order of the pair.",
        Fault(scene=_order_of_pairs),
    ),
    "force limit": entry(
        "own",
        "forces above 0.05 N are cut",
        "apply_wrench applies a smaller force.",
        Fault(simulation=_ForceLimit),
    ),
    "only the first world driven": entry(
        "own",
        "other worlds have no driven motion",
        "Worlds lack their driven motion.",
        Fault(worlds=_OnlyFirstDriven),
    ),
    "whole frames": entry(
        "own",
        "advance drops what is left of 1/240 s",
        "advance simulates another time.",
        Fault(simulation=_WholeFrames),
    ),
    "half friction reported": entry(
        "own",
        "contact_forces with half of the friction",
        "contact_forces have another friction.",
        Fault(simulation=_HalfFriction),
    ),
    "raised planes": entry(
        "own",
        "1 mm",
        "Planes are too high.",
        Fault(scene=change_bodies(_raised_planes)),
    ),
}
"""Twelve faults of trackers and eleven own ones."""
