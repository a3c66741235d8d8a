"""Bodies on hinges and strings: periods, energy, arms and lengths."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from gauge_envs.fixtures.parts import ball, body, corners, thrown
from gauge_envs.fixtures.recording import UnsupportedError
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    ConvexUnion,
    Hinge,
    Pose,
    Scene,
    Shape,
    Sphere,
    Tether,
    Vector,
    mass_properties,
)
from gauge_envs.scene.geometry import length_of, vector
from gauge_envs.scoring.estimators import (
    acceleration_m_per_s2,
    mean_period_s,
    pendulum_period_s,
)
from gauge_envs.tools.conformance.free_motion import ZERO, centre_m, kinetic_energies
from gauge_envs.tools.conformance.lab import Lab, Measurement, largest, ratio
from gauge_envs.tools.conformance.model import Checks, Level, Tolerance

check = Checks(Level.RIGID)


BAR, LEANING = Box(size_m=(0.03, 0.04, 0.3)), (0.48, 0.6, 0.64)
BLOCK = ConvexUnion(pieces_m=(corners((0.0, -0.02, -0.02), (0.12, 0.03, 0.02)),))
"""Block whose origin is on a face, 60 mm from its centre of mass."""
BOBS: dict[str, tuple[Shape, Vector, Vector, float]] = {
    "ball": (Sphere(radius_m=0.05), (0.0, 1.0, 0.0), (0.173, 0.0, -0.1), 0.0),
    "fast ball": (Sphere(radius_m=0.02), (-0.6, 0.8, 0.0), (0.04, 0.03, 0.03), 0.0),
    "block on a leaning axis": (BLOCK, (0.8, 0.0, 0.6), (0.078, 0.07, -0.104), 0.0),
    "block": (BLOCK, (0.6, 0.0, 0.8), (0.08, -0.05, -0.06), 0.0),
    "balanced bar of -14 rad/s": (BAR, LEANING, ZERO, -14.0),
    "balanced bar of 0.05 rad/s": (BAR, LEANING, ZERO, 0.05),
}
"""Shape, axis of the hinge, centre of mass from the anchor [m], and rate [rad/s] at the start."""
TORQUE_M2_PER_S2 = 0.3
"""Torque on a pushed body over its mass."""


def _hinged(names: Sequence[str]) -> Scene:
    bodies, hinges = [], []
    for at, name in enumerate(names):
        shape, axis, arm, rate = BOBS[name]
        anchor = (0.1 + 0.7 * at, 0.2, 1.0)
        pose = Pose.from_euler_deg(ZERO, (20.0 * at, -35.0 * at, 50.0))
        centre = pose.to_world(mass_properties(shape, 1.0)[0])
        pose = replace(pose, position_m=vector(np.add(anchor, arm) - centre))
        bob = body(name, shape, pose, mass_kg=0.1 * 2.0**at)
        bodies.append(thrown(bob, ZERO, np.multiply(rate, axis)))
        hinges.append(Hinge(body=name, anchor_m=anchor, axis=axis))
    return Scene(bodies=tuple(bodies), joints=tuple(hinges), duration_s=4.0)


def _pendulums(lab: Lab) -> list[dict[str, float]]:
    """Return errors of the arm [mm], periods over the law, and changes of energy [%]."""
    scene = _hinged(lab.buildable([*BOBS], _hinged))
    runs = {"": lab.rollout(scene), " for 20 s": lab.rollout(_hinged(["ball"]), 20.0)}
    # A force like gravity, and a torque about the hinge.
    wrenches = {
        each.name: each.mass_kg
        * np.array([0.0, 0.0, -G, *np.multiply(TORQUE_M2_PER_S2, BOBS[each.name][1])])
        for each in scene.bodies
    }
    pushed = " under a wrench"
    with suppress(UnsupportedError):
        floating = replace(scene, gravity_m_per_s2=0.0)
        runs[pushed] = lab.rollout(floating, 0.6, wrenches=wrenches)
    radii, periods, energies = {}, {}, {}
    for run, rollout in runs.items():
        for each in rollout.scene.bodies:
            shape, axis, start, _ = BOBS[each.name]
            name, arm_m = each.name + run, length_of(start)
            path = centre_m(rollout, each.name)
            arms = path - rollout.scene.hinges[each.name].anchor_m
            off_m = np.abs([np.linalg.norm(arms, axis=1) - arm_m, arms @ axis]).max()
            radii[f"the arm of the {name}"] = 1e3 * float(off_m)
            _, tensor = mass_properties(shape, 1.0)
            spins = rollout.angular_velocity(each.name)
            inner = each.pose.matrix.T @ axis
            gyration_m = float(np.sqrt(inner @ tensor @ inner))
            energy = kinetic_energies(rollout, each)
            # A body at rest gives NaN, which fails.
            scale = energy.max() or np.nan
            energy += G * path[:, 2]
            if run == pushed:
                angle_rad = cumulative_trapezoid(
                    spins @ axis, rollout.times_s, initial=0.0
                )
                energy -= TORQUE_M2_PER_S2 * angle_rad
            elif arm_m:
                # Lowest direction across the axis.
                low = axis[2] * np.array(axis) - [0.0, 0.0, 1.0]
                across = length_of(low)
                period = pendulum_period_s(
                    length_m=arm_m,
                    gyration_m=gyration_m,
                    amplitude_rad=float(np.arccos(start @ low / across / arm_m)),
                    gravity_m_per_s2=G * across,
                )
                measured_s = mean_period_s(rollout.times_s, arms @ np.cross(axis, low))
                periods[f"the {name}"] = measured_s / period
            change = 100.0 / scale * (energy - energy[0])
            percent = np.abs(change).max()
            if len(change) > 3000:
                # The trend between the first and the last 5 s, in 100 s.
                trend = change[-900:].mean() - change[:900].mean()
                percent = abs(trend) * 100.0 / 15.0
            energies[f"the energy of the {name}"] = float(percent)
    return [radii, periods, energies]


@check(
    "hinge-radius",
    title="hinge keeps the arm of a body",
    law="|r - anchor| = l, across the axis",
    unit="mm",
    tolerance=Tolerance("0.1 % of the arm, 0.05 % of the period", absolute=0.2),
    cause="the joint is soft, or its anchor or axis is not that of the scene, in the world frame",
)
def hinge_radius(lab: Lab) -> Measurement:
    """Turned balls, blocks and bars on level and leaning hinges, for 4 s; a ball for 20 s.

    Bars turn about their centres with 0.05 to 14 rad/s.

    Largest change of the distance of a body's centre from the anchor, across the axis and along it.

    Source: hinge (scene.Hinge).
    """
    return largest(lab.once(_pendulums)[0], "mm")


@check(
    "pendulum-energy",
    title="energy of pendulums, balanced bars and pushed bodies",
    law="T + V = const",
    unit="%",
    tolerance=Tolerance("an observable resolves 1 % in 100 s", absolute=1.0),
    cause="the hinge or the body is damped, the step is too long, or apply_wrench fails for bodies with a hinge",
)
def pendulum_energy(lab: Lab) -> Measurement:
    """The bodies of hinge-radius; without gravity too, pushed by forces like it and by torques, for 0.6 s.

    Largest change of kinetic and potential energy over the largest kinetic energy. In 20 s: its trend from the mean of
    the first quarter to that of the last, in 100 s.

    Source: hinge without friction (scene.Hinge).
    """
    return largest(lab.once(_pendulums)[2], "%")


@check(
    "pendulum-period",
    title="period of pendulums",
    law="T = 4 sqrt((l^2 + k^2) / (g l)) K(sin^2(theta / 2)), with gravity across the axis",
    tolerance=Tolerance("a fifth of a period in 100 periods", absolute=2e-3),
    cause="the inertia about the hinge, the anchor, damping, friction or armature of the hinge",
)
def pendulum_period(lab: Lab) -> Measurement:
    """The bodies of hinge-radius.

    Mean period over the law, the worst.

    Source: physical pendulum, complete elliptic integral.
    """
    return ratio(lab.once(_pendulums)[1], "the period")


# --- strings ---------------------------------------------------------------------------------------------------------

STRINGS = {
    "slack ball": ((0.0, 0.0, 1.0), 0.3, 0.2),
    "resting ball": ((-0.3, 0.5, 0.8), 0.24, 0.24),
    "block": ((1.1, -0.2, 1.5), 0.3, 0.3),
}
"""Anchor, length, and distance of the body at the start [m]."""
SLACK_S = 0.13


def _hanging(names: Sequence[str]) -> Scene:
    bodies, strings = [], []
    for name in names:
        anchor, length_m, start_m = STRINGS[name]
        bob = ball(name, vector(np.subtract(anchor, [0.0, 0.0, start_m])))
        bodies.append(replace(bob, shape=BLOCK) if name == "block" else bob)
        strings.append(Tether(body=name, anchor_m=anchor, length_m=length_m))
    return Scene(bodies=tuple(bodies), joints=tuple(strings), duration_s=0.5)


@check(
    "tether-length",
    title="strings keep their length, and only pull",
    law="|r - anchor| = l where taut, a = g where slack",
    unit="mm",
    tolerance=Tolerance("0.3 % of the length, as it becomes taut", absolute=1.0),
    cause="the string is soft, pushes, or is not that of the scene in length, anchor or point of the body",
)
def tether_length(lab: Lab) -> Measurement:
    """A ball that falls on a slack string; one that hangs at rest; a block that hangs beside its centre of mass.

    Largest distance from the anchor beyond the length, or from it where taut; distance of a ball from the line below
    the anchor; and the fall that the slack ball lacks in 0.13 s, by its acceleration.

    Source: inextensible string to the body's origin (scene.Tether).
    """
    names = lab.buildable([*STRINGS], _hanging)
    rollout = lab.rollout(_hanging(names))
    cases = {}
    for name in rollout.states:
        anchor, length_m, start_m = STRINGS[name]
        arm = rollout.position(name) - anchor
        beyond = np.linalg.norm(arm, axis=1) - length_m
        if start_m < length_m:
            fall = rollout.cut(0.0, SLACK_S)
            lack = G + acceleration_m_per_s2(fall.times_s, fall.position(name)[:, 2])
            lag_mm = 500.0 * abs(lack) * SLACK_S**2
            cases["the fall while a string is slack"] = lag_mm
            beyond = np.maximum(beyond, 0.0)
        off_m = [beyond]
        # A block turns about the end of its string.
        if name != "block":
            off_m += [*arm[:, :2].T]
        cases[f"the string of the {name}"] = 1e3 * float(np.abs(off_m).max())
    return largest(cases, "mm")
