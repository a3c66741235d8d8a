"""Bodies without contacts: uniform motion, free fall, free rotation, and their reported states."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial.polynomial import polyfit

from gauge_envs.fixtures.parts import ball, body, box, corners, thrown
from gauge_envs.fixtures.recording import Recording
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Capsule,
    Compound,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    Part,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    mass_properties,
)
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.conformance.lab import (
    Lab,
    Measurement,
    largest,
    largest_mm,
    ratio,
)
from gauge_envs.tools.conformance.model import Checks, Level, Tolerance

check = Checks(Level.RIGID)


# --- solids ----------------------------------------------------------------------------------------------------------

ZERO = (0.0, 0.0, 0.0)
turned = Pose.from_euler_deg
PARTS = (
    Part(
        shape=Box(size_m=(0.09, 0.03, 0.02)),
        pose=turned((0.05, 0.0, 0.0), (0.0, 20.0, 30.0)),
    ),
    Part(
        shape=Capsule(radius_m=0.015, length_m=0.05),
        pose=turned((0.0, 0.04, 0.0), (70.0, 0.0, 0.0)),
    ),
    Part(
        shape=Ellipsoid(radii_m=(0.02, 0.03, 0.04)),
        pose=turned((0.0, 0.0, 0.05), (0.0, 30.0, 0.0)),
    ),
)
SOLIDS: dict[str, Shape] = {
    "turned box": Box(size_m=(0.1, 0.06, 0.03)),
    "sphere": Sphere(radius_m=0.03),
    "turned cylinder": Cylinder(radius_m=0.02, length_m=0.09),
    "union of two blocks": ConvexUnion(
        pieces_m=(
            corners(ZERO, (0.09, 0.03, 0.02)),
            corners((0.0, 0.03, 0.0), (0.02, 0.08, 0.02)),
        )
    ),
    "compound of a box, a capsule and an ellipsoid": Compound(parts=PARTS),
}
"""Solids with and without the origin at their centre of mass."""
KILOGRAMS = (0.2, 1e-4, 0.0123, 100.0, 1.0)


def solids(lab: Lab) -> Sequence[RigidBody]:
    """Return a turned body of each solid that the engine builds, of different masses, 0.5 m apart."""
    bodies = [
        body(
            name,
            shape,
            turned(
                (0.5 * at - 0.8, 0.9 - 0.4 * at, 1.0), (50.0 + 30.0 * at, -20.0, 70.0)
            ),
            mass_kg=KILOGRAMS[at],
        )
        for at, (name, shape) in enumerate(SOLIDS.items())
    ]
    return lab.buildable(bodies, lambda some: Scene(bodies=(*some,), duration_s=1.0))


def centre_m(rollout: Recording, name: str) -> FloatArray:
    """Return positions of the centre of mass of a body [m], shape [sample_count, 3]."""
    centre, _ = mass_properties(rollout.scene.body(name).shape, 1.0)
    return rollout.position(name) + rollout.rotation(name).apply(centre)


# --- uniform motion --------------------------------------------------------------------------------------------------

SPANS_S = ((0.0, 0.8), (0.8, 1.8), (2.1, 2.6))
SPEEDS_M_PER_S = (20.0, -13.0, 0.1, -0.004, 0.001)
RATES_RAD_PER_S = (200.0, 45.0, -5.0, 0.05)
STEADY = 4e-3
LEVEL, DIRECTION = np.array([0.6, -0.8, 0.0]), np.array([0.6, -0.64, 0.48])


def _glide(lab: Lab) -> Recording:
    # Near the origin single precision resolves the steps of the slowest ball.
    balls = [
        thrown(ball(f"ball of {speed:g} m/s", ZERO), speed * LEVEL)
        for speed in SPEEDS_M_PER_S
    ]
    balls += [
        thrown(ball(f"ball of {rate:g} rad/s", (2.0, 0.0, 1.0)), ZERO, rate * LEVEL)
        for rate in RATES_RAD_PER_S
    ]
    return lab.run(balls, (), 2.6, gravity_m_per_s2=0.0)


@check(
    "glide-speed",
    title="free bodies keep velocity and spin, fast, slow and late",
    law="r = v t, angle = omega t",
    tolerance=Tolerance("single precision of orientations in 2.6 s", absolute=STEADY),
    cause="a limit of speed, damping of free bodies, or sleep of slow bodies",
)
def glide_speed(lab: Lab) -> Measurement:
    """Free balls without gravity for 2.6 s, thrown with 1 mm/s to 20 m/s or with a spin of 0.05 to 200 rad/s.

    Displacement or rotation over the law, in the first 0.8 s, to 1.8 s and after 2.1 s; the worst.

    Source: Newton, Euler.
    """
    rollout = lab.once(_glide)
    ratios = {}
    for each in rollout.scene.bodies:
        turns = rollout.rotation(each.name)
        steps = (turns[1:] * turns[:-1].inv()).as_rotvec()
        steps += np.diff(rollout.position(each.name), axis=0)
        # A ball either moves or spins.
        law = np.add(each.linear_velocity_m_per_s, each.angular_velocity_rad_per_s)
        shares = steps @ law / (law @ law) / rollout.interval_s
        for first, last in SPANS_S:
            share = shares[rollout.between(first, last - rollout.interval_s)].mean()
            ratios[f"the {each.name}, {first} to {last} s"] = float(share)
    errors = np.abs(np.reshape([*ratios.values()], (-1, len(SPANS_S))) - 1.0)
    return replace(ratio(ratios, "the speed"), cause=_by_speed(errors))


def _by_speed(errors: FloatArray) -> str:
    """Return why balls are off, if all of a kind are or those above or below some speed; empty otherwise.

    Args:
        errors: Relative error of the speed of each ball in each span, shape [ball_count, span_count].
    """
    moving = len(SPEEDS_M_PER_S)
    causes = []
    for kind, sizes, rows in (
        ("speed", np.abs(SPEEDS_M_PER_S), errors[:moving]),
        ("spin", np.abs(RATES_RAD_PER_S), errors[moving:]),
    ):
        off = ~(rows < STEADY).all(axis=1)
        if not off.any():
            continue
        others = sizes[~off]
        if (sizes[off].max() < others).all() and not off.all():
            causes.append(f"bodies of small {kind} fall asleep")
        elif (rows[off, 0] < 0.7 * rows[off, -1]).all():
            causes.append(f"the {kind} of free bodies is damped")
        elif off.all():
            causes.append(f"the {kind} of free bodies differs from the start's")
        elif (sizes[off].min() > others).all():
            causes.append(f"{kind} has a limit")
    return "; ".join(causes)


def _tumble(lab: Lab) -> Recording:
    """Record solids that spin and fly apart for 0.5 s without gravity, each thrown in another direction."""
    bodies = [
        thrown(
            each,
            np.roll([1.2, -0.8, 0.5], at),
            np.roll([2.0, 5.0, -3.0], at) * (1.0 + 0.4 * at),
        )
        for at, each in enumerate(solids(lab))
    ]
    return lab.run(bodies, (), 0.5, gravity_m_per_s2=0.0)


@check(
    "glide-reports",
    title="reported velocities are those of the motion",
    law="v = dx/dt, omega = dR/dt R^T",
    unit="%",
    tolerance=Tolerance("20 m/s at 50 m in single precision: 0.1 %", absolute=1.0),
    cause="columns 7 to 12 are the velocity of the body's origin and the angular velocity, in the world frame",
)
def glide_reports(lab: Lab) -> Measurement:
    """The balls of glide-speed; and thrown, spinning solids, some with their origin beside their centre of mass.

    Largest difference of a reported rate from the central difference of poses, over the largest rate.

    Source: contract (Simulation.body_states).
    """
    cases = {}
    for rollout in (lab.once(_glide), lab.once(_tumble)):
        for name, states in rollout.states.items():
            turns = rollout.rotation(name)
            rates = {
                "velocity": (states[2:, :3] - states[:-2, :3], states[1:-1, 7:10]),
                "spin": ((turns[2:] * turns[:-2].inv()).as_rotvec(), states[1:-1, 10:]),
            }
            for kind, (moved, given) in rates.items():
                rate = moved / (2.0 * rollout.interval_s)
                share = largest_mm(given - rate) / max(largest_mm(rate), 100.0)
                cases[f"the {kind} of the {name}"] = 100.0 * share
    return largest(cases, "%")


# --- fall ------------------------------------------------------------------------------------------------------------

FALLS_M_PER_S2 = (G, 1.62, 0.0)
FALL_S = 0.3


@check(
    "free-fall",
    title="free fall of all solids",
    law="a = g downward",
    tolerance=Tolerance("0.1 % is 0.4 mm at the first impact of a ball", absolute=1e-3),
    cause="gravity is not that of the scene, in size or direction, or for some bodies",
    revision=2,
)
def free_fall(lab: Lab) -> Measurement:
    """Turned solids that are released at rest, for 0.3 s at 9.80665 m/s^2, at 1.62 m/s^2 and without gravity.

    Acceleration at the start, downward and sideways, over the law; 9.80665 m/s^2 more counts 1 without gravity. A
    polynomial of degree 4 fits the path, so that resistance to the motion changes nothing.

    Source: Galilei; contract (Scene.gravity_m_per_s2).
    """
    ratios, falls = {}, []
    for gravity in FALLS_M_PER_S2:
        rollout = lab.run(solids(lab), (), FALL_S, gravity_m_per_s2=gravity)
        scale = gravity or G
        for name in rollout.states:
            # States that come an interval late repeat the first one.
            path = rollout.position(name)[1:]
            x, y, z = 2.0 * polyfit(rollout.times_s[1:], path, 4)[2]
            case = f"the {name} at {gravity:g} m/s^2"
            ratios[case] = 1.0 - float(z + gravity) / scale
            ratios[f"{case}, sideways"] = 1.0 + float(np.hypot(x, y)) / scale
            falls.append((x, y, z))
    measurement = ratio(ratios, "the acceleration")
    rows = np.reshape(falls, (len(FALLS_M_PER_S2), -1, 3))
    if np.ptp(rows, axis=1).max() > 0.01 * np.abs(rows).max():
        return measurement
    seen = ", ".join(f"{length_of(row):.3g}" for row in rows.mean(axis=1).round(4))
    asked = ", ".join(f"{gravity:.3g}" for gravity in FALLS_M_PER_S2)
    return replace(measurement, hint=f"all bodies fall with {seen} m/s^2 for {asked}")


# --- rotation --------------------------------------------------------------------------------------------------------


@check(
    "start-velocity-of-origin",
    title="start velocity is that of the body's origin",
    law="r_c = r_c0 + (v0 + omega0 x R c) t",
    unit="mm",
    tolerance=Tolerance("half the scatter of real trials", absolute=0.5),
    cause="the centre of mass does not follow from the shape, or the engine gives it the start velocity of the origin",
)
def start_velocity_of_origin(lab: Lab) -> Measurement:
    """Thrown, spinning solids without gravity for 0.5 s, some with their origin beside their centre of mass.

    Largest distance of a centre of mass from its straight line.

    Source: Newton; contract (RigidBody.linear_velocity_m_per_s).
    """
    rollout = lab.once(_tumble)
    cases = {}
    for each in rollout.scene.bodies:
        path = centre_m(rollout, each.name)
        velocity = np.array(each.linear_velocity_m_per_s)
        arm = path[0] - rollout.position(each.name)[0]
        velocity += np.cross(each.angular_velocity_rad_per_s, arm)
        off_m = path - path[0] - np.outer(rollout.times_s, velocity)
        cases[f"the path of the {each.name}"] = largest_mm(off_m)
    return largest(cases, "mm")


def _momenta(rollout: Recording, each: RigidBody) -> FloatArray:
    """Return the angular momentum of a body over its mass [m^2/s], shape [sample_count, 3]."""
    _, tensor = mass_properties(each.shape, 1.0)
    turns, spins = rollout.rotation(each.name), rollout.angular_velocity(each.name)
    return turns.apply(turns.apply(spins, inverse=True) @ tensor)


def kinetic_energies(rollout: Recording, each: RigidBody) -> FloatArray:
    """Return the kinetic energy of a body over its mass [m^2/s^2], shape [sample_count]."""
    spins, path = rollout.angular_velocity(each.name), centre_m(rollout, each.name)
    arms = path - rollout.position(each.name)
    speeds = rollout.velocity(each.name) + np.cross(spins, arms)
    squares = speeds**2 + _momenta(rollout, each) * spins
    return np.asarray(0.5 * squares.sum(axis=1))


@check(
    "spin-momentum",
    title="free rotation of all solids",
    law="R I R' omega = const",
    unit="%",
    tolerance=Tolerance("the turn of a tumbling body within 2 degrees", absolute=1.0),
    cause="the start spin, the gyroscopic term, the inertia or its frame is wrong, or the body is damped",
)
def spin_momentum(lab: Lab) -> Measurement:
    """Thrown, spinning solids of all kinds without gravity, each turned and thrown another way, for 0.5 s.

    Largest change of the angular momentum from that of the scene's start spin, over the latter; the worst.

    Source: Euler; angular momentum.
    """
    rollout = lab.once(_tumble)
    cases = {}
    for each in rollout.scene.bodies:
        _, tensor = mass_properties(each.shape, 1.0)
        first, start = each.pose.matrix, np.array(each.angular_velocity_rad_per_s)
        law = first @ tensor @ first.T @ start
        percent = 0.1 * largest_mm(_momenta(rollout, each) - law) / length_of(law)
        cases[f"the angular momentum of the {each.name}"] = percent
    return largest(cases, "%")


TUMBLERS_M = {
    "brick": (0.1, 0.06, 0.03),
    "rod": (0.16, 0.03, 0.02),
    "plate": (0.12, 0.1, 0.01),
}
TUMBLE_RAD_PER_S, TUMBLE_S = 12.0, 10.0


@check(
    "tumble-long",
    title="ten seconds of tumbling keep energy and angular momentum",
    law="omega I omega / 2 = const, R I R' omega = const",
    unit="%",
    tolerance=Tolerance(
        "as for free rotation; 1 % of energy is 0.5 % of the rate of a tumbling body",
        absolute=1.0,
    ),
    cause="the gyroscopic term is missing or of first order, the body is damped, or single precision adds up, which a "
    "smaller step makes worse",
)
def tumble_long(lab: Lab) -> Measurement:
    """A brick, a rod and a plate without gravity that spin with 12 rad/s near their middle axes, which is unstable.

    Largest change of the kinetic energy and of the angular momentum within 10 s, over those at the start.

    Source: Euler.
    """
    bodies, spin = [], TUMBLE_RAD_PER_S * np.array([0.1, 1.0, 0.05])
    for at, (name, size_m) in enumerate(TUMBLERS_M.items()):
        block = box(name, (at, 0.0, 0.0), size_m, euler_deg=(20.0, 40.0, 60.0 * at))
        bodies.append(thrown(block, ZERO, block.pose.matrix @ spin))
    scene = Scene(bodies=tuple(bodies), duration_s=TUMBLE_S, gravity_m_per_s2=0.0)
    rollout = lab.rollout(scene, interval_s=0.05)
    cases = {}
    for each in rollout.scene.bodies:
        momenta = _momenta(rollout, each)
        energy = kinetic_energies(rollout, each)
        off = np.abs(energy / energy[0] - 1.0).max()
        cases[f"the energy of the {each.name}"] = 100.0 * float(off)
        off_mm = largest_mm(momenta - momenta[0])
        cases[f"the angular momentum of the {each.name}"] = (
            0.1 * off_mm / length_of(momenta[0])
        )
    return largest(cases, "%")
