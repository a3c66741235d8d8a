"""Applied forces and torques, the inertia that they show, and contact forces."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gauge_envs.fixtures.parts import ball, box, contact, fixed_box, thrown
from gauge_envs.fixtures.recording import Recording, UnsupportedError, record
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    RigidBody,
    Scene,
    body_mass_properties,
)
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.conformance.free_motion import DIRECTION, centre_m, solids
from gauge_envs.tools.conformance.lab import Lab, Measurement, largest, push, ratio
from gauge_envs.tools.conformance.model import Checks, Level, Tolerance

check = Checks(Level.RIGID)


PUSH_S = 0.1
RATE_RAD_PER_S2 = 0.4
"""Angular acceleration, which turns a body by 2 mrad within `PUSH_S`."""
FORCE_N_PER_KG = 0.1 * DIRECTION


def _push(lab: Lab, bodies: Sequence[RigidBody]) -> Recording:
    """Push floating bodies by forces and torques together, which replace earlier ones."""
    scene = Scene(bodies=(*bodies,), duration_s=PUSH_S, gravity_m_per_s2=0.0)
    with lab.running(scene) as simulation:
        for at, each in enumerate(bodies):
            moments, axes = np.linalg.eigh(body_mass_properties(each)[1])
            torque = RATE_RAD_PER_S2 * each.pose.matrix @ axes @ moments
            force = each.mass_kg * np.roll(FORCE_N_PER_KG, at)
            for share in (-3.0, 1.0):
                push(simulation, each.name, [*(share * force), *torque])
        return record(simulation, scene, PUSH_S)


def _pushed(lab: Lab) -> Recording:
    return _push(lab, [*solids(lab), ball("grain", (0.1, 0.1, 0.1), radius_m=4e-3)])


def _gained(rollout: Recording, name: str) -> FloatArray:
    """Return the mean acceleration of a centre of mass [m/s^2], shape [3]."""
    arm = (centre_m(rollout, name) - rollout.position(name))[-1]
    turning = np.cross(rollout.angular_velocity(name)[-1], arm)
    return np.asarray((rollout.velocity(name)[-1] + turning) / rollout.times_s[-1])


@check(
    "wrench-force",
    title="force on a free body",
    law="m a = F",
    tolerance=Tolerance("0.1 % allows for a step at the end", absolute=1e-3),
    cause="a wrench acts in all steps, until another call replaces it, in the frame of the world; or a mass is another",
    optional=True,
    revision=2,
)
def wrench_force(lab: Lab) -> Measurement:
    """Floating turned solids of 0.1 g to 100 kg, and a heavy ball of 8 mm.

    Each gets a torque and a force of 0.1 N for each kg.

    Distance of the acceleration of the centre of mass in 0.1 s from the law, over that by the law.

    Source: Newton; contract (Simulation.apply_wrench).
    """
    rollout = lab.once(_pushed)
    errors = {}
    for at, each in enumerate(rollout.scene.bodies):
        gained, law = _gained(rollout, each.name) / 0.1, np.roll(DIRECTION, at)
        case = f"the acceleration of the {each.mass_kg:g} kg {each.name}"
        errors[case] = length_of(gained - law)
    return largest(errors)


# --- inertia ---------------------------------------------------------------------------------------------------------


def _inertia(rollout: Recording) -> Measurement:
    ratios = {}
    for each in rollout.scene.bodies:
        _, axes = np.linalg.eigh(body_mass_properties(each)[1])
        spin = rollout.angular_velocity(each.name)[-1] / rollout.times_s[-1]
        inner = each.pose.matrix.T @ spin @ axes
        for axis, rate in enumerate(inner, 1):
            case = f"the {each.name} about its principal axis {axis}"
            ratios[case] = RATE_RAD_PER_S2 / float(rate or np.nan)
    return ratio(ratios, "the inertia")


BY_PUSH = Tolerance("0.5 % of inertia, a force within 0.02 mm", absolute=5e-3)


@check(
    "inertia",
    title="inertia and centre of mass of all solids",
    law="torque = I alpha about the centre of mass; I = integral of density (r^2 1 - r r')",
    tolerance=BY_PUSH,
    cause="inertia does not follow from shape and mass, a force acts beside the centre of mass, or a torque otherwise",
    optional=True,
    revision=2,
)
def inertia(lab: Lab) -> Measurement:
    """The solids of wrench-force.

    Inertia about each principal axis over that of the solid, the worst. A force beside the centre of mass changes it.

    Source: Euler; uniform density (RigidBody).
    """
    return _inertia(lab.once(_pushed))


@check(
    "stated-inertia",
    title="inertia that the scene gives",
    law="torque = I alpha",
    tolerance=BY_PUSH,
    cause="read RigidBody.inertia_kg_m2, or leave Feature.STATED_INERTIA out",
    optional=True,
)
def stated_inertia(lab: Lab) -> Measurement:
    """The solids of `inertia`, each with an inertia of 1 g m^2 for each kg about every axis.

    As for `inertia`.

    Source: Euler; RigidBody.inertia_kg_m2.
    """
    bodies = [replace(each, inertia_kg_m2=1e-3 * each.mass_kg) for each in solids(lab)]
    return _inertia(_push(lab, bodies))


# --- contact forces --------------------------------------------------------------------------------------------------

BRICK_M, BRICK_KG = (0.1, 0.08, 0.03), 0.2
BRICKS = (
    box("resting", (0.0, 0.5, 0.015), BRICK_M),
    thrown(box("sliding", (-1.0, -0.5, 0.015), BRICK_M), (2.4, 0.7, 0.0)),
    box("dropped", (1.5, -1.0, 0.115), BRICK_M),
)
PAIRS = {
    ("resting", "slab"): 1.0,
    ("sliding", "slab"): 1.0,
    ("slab", "dropped"): -1.0,
}
"""Sign by which a force is that on the brick."""
MISTAKES = {
    "its friction has the other sign": (-1.0, -1.0, 1.0),
    "it is without friction": (0.0, 0.0, 1.0),
    "it is that on the other body": (-1.0, -1.0, -1.0),
}
"""Factors of the force."""


@check(
    "contact-force",
    title="contact forces at rest, in a slide and in an impact",
    law="mean of F = m (dv / dt - g)",
    tolerance=Tolerance("as for the acceleration of a slide", absolute=0.01),
    cause="the force is that on the first body, of all points with friction, in the world frame, the mean of advance",
    optional=True,
)
def contact_force(lab: Lab) -> Measurement:
    """A brick that rests on a slab, one that slides with friction 0.3, and one that falls flat by 0.1 m.

    Force on a brick less its change of momentum in an interval of 1/180 s, over the largest force on it; the worst.

    Source: Newton; contract (Simulation.contact_forces).
    """
    slab = fixed_box("slab", (0.0, 0.0, -0.05), (4.0, 3.0, 0.1))
    touching = tuple(contact(*pair, friction=0.3) for pair in PAIRS)
    scene = Scene(bodies=(slab, *BRICKS), contacts=touching, duration_s=0.5)
    names = [each.name for each in BRICKS]
    signs = np.reshape([*PAIRS.values()], (-1, 1))
    forces, speeds = [], []
    with lab.running(scene) as simulation:
        read = simulation.contact_forces([*PAIRS])
        if read is None:
            raise UnsupportedError(("contact forces are not read",))
        for _ in range(80):
            speeds.append(simulation.body_states(names)[0, :, 7:10])
            simulation.advance(SAMPLE_INTERVAL_S)
            forces.append(signs * read()[0] / BRICK_KG)
    law = np.diff(speeds, axis=0) / SAMPLE_INTERVAL_S + [0.0, 0.0, G]
    read_n = np.array(forces[:-1])
    scales = (read_n * law).sum(axis=(0, 2)) / (law**2).sum(axis=(0, 2))
    rows = [(1.0, 1.0, 1.0), *MISTAKES.values(), scales[:, None]]
    loads = np.linalg.norm(law, axis=2)
    offs = [read_n - law * row for row in rows]
    offs.append(offs[0] * (loads > 1e-3 * G)[..., None])
    shares = np.linalg.norm(offs, axis=3).max(axis=1) / loads.max(axis=0)
    errors, mistakes = {}, {}
    for name, scale, (share, *left) in zip(
        names, scales, shares.T.tolist(), strict=True
    ):
        case = f"the force on the {name} brick"
        errors[case] = share
        scaled = f"it is {scale:.3g} times that of the law"
        causes = (*MISTAKES, scaled, "it stays after the bodies part")
        mistakes[case] = dict(zip(causes, left, strict=True))
    return largest(errors, mistakes=mistakes)
