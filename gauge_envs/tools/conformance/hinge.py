"""Bodies on hinges and strings: periods, energy, and what the joint keeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

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
    body_mass_properties,
    mass_properties,
)
from gauge_envs.scene.geometry import length_of, vector
from gauge_envs.scoring.estimators import (
    acceleration_m_per_s2,
    mean_period_s,
    pendulum_period_s,
)
from gauge_envs.tools.bench.parts import ball, body, corners, thrown
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.forces import PUSH_S, RATE_RAD_PER_S2
from gauge_envs.tools.conformance.free_motion import DIRECTION, ZERO, solids
from gauge_envs.tools.conformance.lab import Lab, largest, ratio
from gauge_envs.tools.conformance.model import Measurement, Tolerance, check

BAR, LEANING = Box(size_m=(0.03, 0.04, 0.3)), (0.48, 0.6, 0.64)
Bobs = dict[str, tuple[Shape, Vector, Vector, float]]
BOBS: Bobs = {
    "ball": (Sphere(radius_m=0.05), (0.0, 1.0, 0.0), (0.173, 0.0, -0.1), 0.0),
    "fast ball": (Sphere(radius_m=0.02), (-0.6, 0.8, 0.0), (0.04, 0.03, 0.03), 0.0),
    "bar on a leaning axis": (BAR, (0.8, 0.0, 0.6), (0.078, 0.07, -0.104), 0.0),
    "plate": (Box(size_m=(0.12, 0.1, 0.02)), (1.0, 0.0, 0.0), (0.0, 0.1, -0.01), 0.0),
}
"""Shape, axis of the hinge, centre of mass from the anchor [m], and rate [rad/s] at the start."""
BARS: Bobs = {
    "balanced bar of 14 rad/s": (BAR, LEANING, ZERO, 14.0),
    "balanced bar of -5 rad/s": (BAR, (0.0, 0.0, 1.0), ZERO, -5.0),
    "balanced bar of 0.05 rad/s": (BAR, LEANING, ZERO, 0.05),
}
LONG: Bobs = {"ball for 20 s": BOBS["ball"]}
Cases = dict[str, dict[str, float]]


def _swing(lab: Lab, bobs: Bobs, seconds: float) -> Recording:
    bodies, hinges = [], []
    for at, (name, (shape, axis, arm, rate)) in enumerate(bobs.items()):
        anchor = (0.1 + 0.7 * at, 0.2, 1.0)
        place = vector(np.add(anchor, arm))
        pose = Pose.from_euler_deg(place, (20.0 * at, -35.0 * at, 50.0))
        one = body(name, shape, pose, mass_kg=0.1 * 2.0**at)
        bodies.append(thrown(one, ZERO, np.multiply(rate, axis)))
        hinges.append(Hinge(body=name, anchor_m=anchor, axis=axis))
    scene = Scene(bodies=tuple(bodies), joints=tuple(hinges), duration_s=seconds)
    return lab.rollout(scene)


def _hinged(
    lab: Lab, *runs: tuple[Bobs, float]
) -> tuple[Cases, dict[str, float], Cases]:
    """Return errors of the arm [mm], periods over the law, and changes of energy [%]."""
    radii, periods, energies = {}, {}, {}
    for bobs, seconds in runs:
        rollout = _swing(lab, bobs, seconds)
        for name, (shape, axis, start, _) in bobs.items():
            # Lowest direction across the axis, the direction that follows it, and the axis.
            low = axis[2] * np.array(axis) - [1e-9, 0.0, 1.0]
            low /= length_of(low)
            frame = np.array([low, np.cross(axis, low), axis]).T
            anchor = rollout.scene.hinges[name].anchor_m
            x, y, z = ((rollout.position(name) - anchor) @ frame).T
            x0, y0, z0 = start @ frame
            arm_m = float(np.hypot(x0, y0))
            off_mm = 1e3 * float(np.abs([np.hypot(x, y) - arm_m, z - z0]).max())
            radii[f"the arm of the {name}"] = {"": off_mm}
            _, tensor = mass_properties(shape, 1.0)
            turns = rollout.rotation(name)
            spin = turns.apply(rollout.angular_velocity(name), inverse=True)
            squares = (rollout.velocity(name) ** 2).sum(axis=1)
            energy = 0.5 * (squares + (spin @ tensor * spin).sum(axis=1))
            scale = energy.max()
            if arm_m:
                gravity = G * float(np.hypot(axis[0], axis[1]))
                energy -= gravity * x
                inner = turns[0].apply(axis, inverse=True)
                period = pendulum_period_s(
                    length_m=arm_m,
                    gyration_m=float(np.sqrt(inner @ tensor @ inner)),
                    amplitude_rad=float(np.arctan2(y0, x0)),
                    gravity_m_per_s2=gravity,
                )
                found = mean_period_s(rollout.times_s, np.arctan2(y, x))
                periods[f"the {name}"] = found / period
            change = 100.0 / scale * (energy - energy[0])
            energies[f"the energy of the {name}"] = {"": float(np.abs(change).max())}
            if seconds > 10.0:
                # Over five swings each.
                trend = change[-900:].mean() - change[:900].mean()
                case = f"the energy of the {name}, by its trend in 100 s,"
                energies[case] = {"": float(abs(trend)) * 100.0 / 15.0}
    return radii, periods, energies


def _pendulums(lab: Lab) -> tuple[Cases, dict[str, float], Cases]:
    return _hinged(lab, (BOBS, 4.0), (LONG, 20.0))


@check(
    "hinge-radius",
    title="hinge keeps the arm of a body",
    law="|r - anchor| = l, across the axis",
    source="hinge (scene.Hinge)",
    unit="mm",
    tolerance=Tolerance("0.1 % of the arm, 0.05 % of the period", absolute=0.2),
    cause="the joint is soft, or its anchor or axis is not that of the scene, in the world frame",
)
def hinge_radius(lab: Lab) -> Measurement:
    """Turned balls, a bar and a plate on level and leaning hinges, for 4 s; a ball for 20 s.

    Largest change of the distance of a body's centre from the anchor, across the axis and along it.
    """
    return largest(lab.once(_pendulums)[0], "mm")


@check(
    "pendulum-period",
    title="period of pendulums",
    law="T = 4 sqrt((l^2 + k^2) / (g l)) K(sin^2(theta / 2)), with gravity across the axis",
    source="physical pendulum, complete elliptic integral",
    tolerance=Tolerance("a fifth of a period in 100 periods", absolute=2e-3),
    cause="the inertia about the hinge, the anchor, damping, friction or armature of the hinge",
)
def pendulum_period(lab: Lab) -> Measurement:
    """The bodies of hinge-radius.

    Mean period over the law, the worst.
    """
    return ratio(lab.once(_pendulums)[1], "the period")


@check(
    "pendulum-energy",
    title="energy of pendulums and of balanced bars",
    law="T + V = const",
    source="hinge without friction (scene.Hinge)",
    unit="%",
    tolerance=Tolerance("an observable resolves 1 % in 100 s", absolute=1.0),
    cause="the hinge or the body is damped, or the step is too long",
)
def pendulum_energy(lab: Lab) -> Measurement:
    """The bodies of hinge-radius, and bars that turn on hinges through their centres with 0.05 to 14 rad/s.

    Largest change of kinetic and potential energy over the largest kinetic energy; and its trend between the means of
    the first and the last quarter, in 100 s.
    """
    bars = _hinged(lab, (BARS, 4.0))
    return largest(lab.once(_pendulums)[2] | bars[2], "%")


ACROSS = np.array([-0.8, -0.48, 0.36])
"""Direction across `DIRECTION`."""


@check(
    "wrench-hinged",
    title="force and torque on a hinged body",
    law="angle'' = (torque + arm x force) / I",
    source="Euler; contract (Simulation.apply_wrench)",
    tolerance=Tolerance("as for a free body, with a soft joint", absolute=5e-3),
    cause="apply_wrench is ignored for bodies with a hinge, acts at the hinge, or in another frame",
    optional=True,
)
def wrench_hinged(lab: Lab) -> Measurement:
    """Turned solids on hinges without gravity, two of each: with a force at its centre of mass or a torque, for 0.1 s.

    Angular acceleration over the law, the worst.
    """
    bodies, hinges, wrenches = [], [], {}
    for at, each in enumerate(solids(lab)):
        centre, tensor = body_mass_properties(each)
        axis, arm = np.roll(DIRECTION, at), 0.15 * np.roll(ACROSS, at)
        anchor = vector(each.pose.to_world(centre) - arm)
        inner = each.pose.matrix.T @ axis
        moment = inner @ tensor @ inner + each.mass_kg * arm @ arm
        side = np.cross(axis, arm) / (arm @ arm)
        for kind, wrench in {"force": [*side, *ZERO], "torque": [*ZERO, *axis]}.items():
            name = f"a {kind} on the {each.name}"
            bodies.append(replace(each, name=name))
            hinges.append(Hinge(body=name, anchor_m=anchor, axis=vector(axis)))
            wrenches[name] = RATE_RAD_PER_S2 * moment * np.array(wrench)
    scene = Scene(
        bodies=tuple(bodies),
        joints=tuple(hinges),
        duration_s=PUSH_S,
        gravity_m_per_s2=0.0,
    )
    rollout = lab.rollout(scene, wrenches=wrenches)
    ratios = {
        hinge.body: float(rollout.angular_velocity(hinge.body)[-1] @ hinge.axis)
        / (RATE_RAD_PER_S2 * rollout.times_s[-1])
        for hinge in hinges
    }
    return ratio(ratios, "the angular acceleration")


# --- strings ---------------------------------------------------------------------------------------------------------

STRINGS = {
    "slack ball": ((0.0, 0.0, 1.0), 0.3, 0.2),
    "first ball": ((0.4, -0.1, 1.2), 0.36, 0.36),
    "second ball": ((-0.3, 0.5, 0.8), 0.24, 0.24),
    "block": ((1.1, -0.2, 1.5), 0.3, 0.3),
}
"""Anchor, length, and distance of the body at the start [m]."""
SLACK_S = 0.13
BLOCK = ConvexUnion(pieces_m=(corners((0.0, -0.02, -0.02), (0.12, 0.03, 0.02)),))
"""Block whose origin is on a face, 60 mm from its centre of mass."""


def _hanging(names: Sequence[str]) -> Scene:
    bodies, strings = [], []
    for name in names:
        anchor, length_m, start_m = STRINGS[name]
        one = ball(name, vector(np.subtract(anchor, [0.0, 0.0, start_m])))
        bodies.append(replace(one, shape=BLOCK) if name == "block" else one)
        strings.append(Tether(body=name, anchor_m=anchor, length_m=length_m))
    return Scene(bodies=tuple(bodies), joints=tuple(strings), duration_s=0.5)


@check(
    "tether-length",
    title="strings keep their length, and only pull",
    law="|r - anchor| = l where taut, a = g where slack",
    source="inextensible string to the body's origin (scene.Tether)",
    unit="mm",
    tolerance=Tolerance("0.3 % of the length, as it becomes taut", absolute=1.0),
    cause="the string is soft, pushes, or is not that of the scene in length, anchor or point of the body",
)
def tether_length(lab: Lab) -> Measurement:
    """A ball that falls on a slack string; two that hang at rest; a block that hangs beside its centre of mass.

    Largest distance from the anchor beyond the length, or from it where taut; distance of a ball from the line below
    the anchor; and the fall that the slack ball lacks in 0.13 s, by its acceleration.
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
            cases["the fall while a string is slack"] = {"": lag_mm}
            beyond = np.maximum(beyond, 0.0)
        off_mm = 1e3 * float(np.abs(beyond).max())
        cases[f"the string of the {name}"] = {"": off_mm}
        if name != "block":
            aside_mm = 1e3 * float(np.abs(arm[:, :2]).max())
            cases[f"the place of the {name} below its anchor"] = {"": aside_mm}
    return largest(cases, "mm")
