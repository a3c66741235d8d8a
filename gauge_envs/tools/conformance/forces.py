"""Applied forces and torques, the inertia that they show, and contact forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    RigidBody,
    Scene,
    body_mass_properties,
)
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.bench.parts import box, contact, fixed_box, thrown
from gauge_envs.tools.bench.recording import DeclinedError, Recording, record
from gauge_envs.tools.conformance.free_motion import DIRECTION, ZERO, centre_m, solids
from gauge_envs.tools.conformance.lab import Lab, largest, push, ratio
from gauge_envs.tools.conformance.model import Measurement, Tolerance, check

PUSH_S = 0.1
RATE_RAD_PER_S2 = 0.4
"""Angular acceleration, which turns a body by 2 mrad within `PUSH_S`."""
LEVER_M = 0.02
"""Distance that counts as a ratio of 2."""


def _push(lab: Lab, turned: Sequence[RigidBody]) -> Recording:
    """Push floating bodies by torques, and copies of them by forces, each of which replaces another wrench."""
    pushed = [replace(each, name=f"pushed {each.name}") for each in turned]
    scene = Scene(bodies=(*turned, *pushed), duration_s=PUSH_S, gravity_m_per_s2=0.0)
    with lab.running(scene) as simulation:
        for at, each in enumerate(turned):
            moments, axes = np.linalg.eigh(body_mass_properties(each)[1])
            torque = RATE_RAD_PER_S2 * each.pose.matrix @ axes @ moments
            push(simulation, each.name, [*ZERO, *torque])
            force = each.mass_kg * np.roll(DIRECTION, at)
            for share in (-3.0, 1.0):
                push(simulation, pushed[at].name, [*(share * force), *ZERO])
        return record(simulation, scene, PUSH_S)


def _pushed(lab: Lab) -> Recording:
    return _push(lab, solids(lab))


@check(
    "wrench-force",
    title="force on a free body",
    law="m a = F",
    source="Newton; contract (Simulation.apply_wrench)",
    tolerance=Tolerance("0.1 % allows for a step at the end", absolute=1e-3),
    cause="apply_wrench takes force and torque in the world frame, and acts until another call",
    optional=True,
)
def wrench_force(lab: Lab) -> Measurement:
    """Floating turned solids of 0.1 g to 100 kg; each gets a force of 1 N for each kg, which replaces another.

    Distance of the velocity of the centre of mass after 0.1 s from the law, over the speed by the law.
    """
    rollout = lab.once(_pushed)
    cases = {}
    for at, each in enumerate(rollout.scene.bodies[: len(rollout.states) // 2]):
        name = f"pushed {each.name}"
        gained = _centre_speed(rollout, name) / rollout.times_s[-1]
        force, turn = np.roll(DIRECTION, at), each.pose.rotation
        tried = {
            "": force,
            "the force is ignored; raise BackendError if the engine applies none": ZERO,
            "the force acts during the first call of advance only": force / 18.0,
            "the force is taken in the body frame": turn.apply(force),
            "the force is turned the other way": turn.apply(force, inverse=True),
            "a call adds to the force of the call before": -2.0 * force,
        }
        cases[f"the acceleration of the {each.mass_kg:g} kg {each.name}"] = {
            text: length_of(gained - one) for text, one in tried.items()
        }
    return largest(cases)


# --- inertia ---------------------------------------------------------------------------------------------------------


def _centre_speed(rollout: Recording, name: str) -> FloatArray:
    """Return the velocity of a centre of mass at the end [m/s], shape [3]."""
    arm = (centre_m(rollout, name) - rollout.position(name))[-1]
    spin = rollout.angular_velocity(name)[-1]
    return np.asarray(rollout.velocity(name)[-1] + np.cross(spin, arm))


def _inertia(rollout: Recording) -> Measurement:
    ratios = {}
    for each in rollout.scene.bodies[: len(rollout.states) // 2]:
        _, tensor = body_mass_properties(each)
        _, axes = np.linalg.eigh(tensor)
        spin = rollout.angular_velocity(each.name)[-1]
        inner = each.pose.rotation.apply(spin, inverse=True)
        for axis, rate in enumerate(inner @ axes / rollout.times_s[-1], 1):
            case = f"the inertia of the {each.name} about its principal axis {axis}"
            ratios[case] = RATE_RAD_PER_S2 / float(rate or np.nan)
        off_m = length_of(_centre_speed(rollout, each.name)) / length_of(spin)
        ratios[f"the centre of mass of the {each.name}"] = 1.0 + off_m / LEVER_M
        spin = rollout.angular_velocity(f"pushed {each.name}")[-1]
        inner = each.pose.rotation.apply(spin, inverse=True)
        off_m = length_of(tensor @ inner) / (each.mass_kg * PUSH_S)
        ratios[f"the place of a force on the {each.name}"] = 1.0 + off_m / LEVER_M
    return ratio(ratios, "what the motion shows")


BY_PUSH = Tolerance("0.5 % of inertia, 0.1 mm of the centre of mass", absolute=5e-3)


@check(
    "inertia",
    title="inertia and centre of mass of all solids",
    law="torque = I alpha about the centre of mass; I = integral of density (r^2 1 - r r')",
    source="Euler; uniform density (RigidBody)",
    tolerance=BY_PUSH,
    cause="inertia or centre of mass do not follow from shape and mass, as with half sizes or armature",
    optional=True,
)
def inertia(lab: Lab) -> Measurement:
    """Two floating turned bodies of each solid, one under a torque, one under a force, for 0.1 s without gravity.

    Inertia about each principal axis over that of the solid. For the point about which a torque turns a body, and at
    which a force acts: 1 and its distance from the centre of mass over 20 mm. The worst.
    """
    return _inertia(lab.once(_pushed))


@check(
    "stated-inertia",
    title="inertia that the scene gives",
    law="torque = I alpha",
    source="Euler; RigidBody.inertia_kg_m2",
    tolerance=BY_PUSH,
    cause="read RigidBody.inertia_kg_m2, or leave Feature.STATED_INERTIA out",
    optional=True,
)
def stated_inertia(lab: Lab) -> Measurement:
    """The solids of `inertia`, each with an inertia of 1 g m^2 for each kg about every axis.

    As for `inertia`.
    """
    bodies = [replace(each, inertia_kg_m2=1e-3 * each.mass_kg) for each in solids(lab)]
    return _inertia(_push(lab, bodies))


# --- contact forces --------------------------------------------------------------------------------------------------

BRICK_M, BRICK_KG, UP = (0.1, 0.08, 0.03), 0.2, np.array([0.0, 0.0, 1.0])
PAIRS = (
    ("resting", "slab"),
    ("shelf", "resting"),
    ("sliding", "slab"),
    ("slab", "dropped"),
)
SIGNS = np.array([1.0, -1.0, 1.0, -1.0])
BRICKS = (
    box("resting", (0.0, 0.5, 0.015), BRICK_M),
    thrown(box("sliding", (-1.0, -0.5, 0.015), BRICK_M), (2.4, 0.7, 0.0)),
    box("dropped", (1.5, -1.0, 0.115), BRICK_M),
)
GROUNDS = (
    fixed_box("slab", (0.0, -0.5, -0.05), (4.0, 2.0, 0.1)),
    fixed_box("shelf", (0.0, 1.0, -0.05), (4.0, 1.0, 0.1)),
)


def _forces(lab: Lab) -> tuple[FloatArray, FloatArray]:
    """Return forces of the slabs on bricks by `PAIRS`, and what moves the bricks, in intervals, over the weight."""
    scene = Scene(
        bodies=(GROUNDS[0], *BRICKS, GROUNDS[1]),
        contacts=(
            contact("slab", ("resting", "sliding"), friction=0.3),
            contact("resting", "shelf", friction=0.3),
            contact("slab", "dropped", friction=0.3),
        ),
        duration_s=0.5,
    )
    names = [each.name for each in BRICKS]
    forces, speeds = [], []
    with lab.running(scene) as simulation:
        read = simulation.contact_forces(PAIRS)
        if read is None:
            raise DeclinedError(("contact forces are not read",))
        for _ in range(80):
            speeds.append(simulation.body_states(names)[0, :, 7:10])
            simulation.advance(SAMPLE_INTERVAL_S)
            forces.append(SIGNS[:, None] * read()[0] / (BRICK_KG * G))
    moved = np.diff(speeds, axis=0) / (SAMPLE_INTERVAL_S * G) + UP
    return np.array(forces)[:-1], moved


BY_CONTACT = Tolerance("as for the acceleration of a slide", absolute=0.01)


@check(
    "force-rest",
    title="contact force at rest",
    law="N = m g",
    source="Newton; contract (Simulation.contact_forces)",
    tolerance=BY_CONTACT,
    cause="the points of a pair add up, in the world frame [N], and those of other bodies do not",
    optional=True,
)
def force_rest(lab: Lab) -> Measurement:
    """A brick that rests on two fixed slabs; it is the first body of a pair and the second of the other.

    Distance of the sum of both forces on the brick from its weight upward, over the weight; mean from 0.11 s on.
    """
    forces, _ = lab.once(_forces)
    first, second = forces[20:, :2].mean(axis=0)
    tried = {
        "": first + second,
        "the sign is wrong where a fixed body comes first": first - second,
        "the sign is wrong where a fixed body comes second": second - first,
        "the force is that on the second body of a pair": -first - second,
    }
    case = {text: length_of(one - UP) for text, one in tried.items()}
    return largest({"the force on the brick": case})


@check(
    "force-slide",
    title="contact forces of a slide and of an impact",
    law="mean of F = m (dv / dt - g)",
    source="Newton; contract (Simulation.contact_forces)",
    tolerance=BY_CONTACT,
    cause="friction is left out or in another frame, or the force is that of the last step, not the mean of advance",
    optional=True,
)
def force_slide(lab: Lab) -> Measurement:
    """A brick that slides on a slab with friction 0.3, and a brick that falls flat on it by 0.1 m.

    Force on a brick less its change of momentum in an interval of 1/180 s, over the largest force on it; the worst.
    """
    forces, moved = lab.once(_forces)
    off = np.linalg.norm(forces[:, 2:] - moved[:, 1:], axis=2).max(axis=0)
    slide, impact = off / np.linalg.norm(moved[:, 1:], axis=2).max(axis=0)
    last = "it may be that of the last step instead of the mean of advance"
    return largest(
        {
            "the force of a slide": {"": slide},
            "that of an impact": {"": impact, last: 0},
        }
    )
