"""Conserved motion of two free bodies with a hinge between them.

Only engines with `Feature.BODY_HINGES` build scenes with such a hinge. Nothing touches the
hinged bodies, and the hinge does no work, so:

- the centre of mass of both falls as a parabola,
- the angular momentum about it is constant,
- the kinetic energy relative to it is constant, since gravity does no work on that motion.

For two equal bodies that open like scissors about an axis through neither centre, the angle has a closed form. Half the
angle is f, the distance of each centre from the axis is d, the mass is m, and the moment of inertia of a body about its
own centre is I. Then each body has the kinetic energy (I + m d^2 cos^2 f) f'^2 / 2, which is constant.
"""

from dataclasses import replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from gauge_envs.evaluation.estimators import acceleration_m_per_s2
from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    BodyHinge,
    Box,
    Pose,
    RigidBody,
    Scene,
)
from gauge_envs.scene.geometry import FloatArray, length_of, vector
from gauge_envs.scene.hinged import hinge_angle_rad, hinge_frames
from gauge_envs.tools.bench.parts import body, box, box_inertia_kg_m2
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.laws import (
    inertia_kg_m2,
    largest_mm,
)
from gauge_envs.tools.conformance.model import Check, Measurement, Tolerance, recorded

FLIGHT_S = 0.5
REACH_M = 0.05
"""Distance from the anchor of the two points of the axis that are compared [m]."""

SOURCE = "Newton, Euler"

# --- a tumbling pair -------------------------------------------------------------------------------------------------


def _pair_scene(
    first: RigidBody,
    second: RigidBody,
    anchor_m: FloatArray,
    axis: FloatArray,
    gravity: float,
) -> Scene:
    hinge = BodyHinge(
        first=first.name,
        second=second.name,
        anchor_m=vector(anchor_m),
        axis=vector(axis),
    )
    return Scene(
        bodies=(first, second),
        body_hinges=(hinge,),
        duration_s=FLIGHT_S,
        gravity_m_per_s2=gravity,
    )


def _moving(
    one: RigidBody,
    anchor_m: FloatArray,
    speed: FloatArray,
    spin: FloatArray,
) -> RigidBody:
    """Return a body that starts with an angular velocity, and of which one point has a given velocity."""
    linear = speed + np.cross(spin, np.subtract(one.pose.position_m, anchor_m))
    return replace(
        one,
        linear_velocity_m_per_s=vector(linear),
        angular_velocity_rad_per_s=vector(spin),
    )


@recorded(
    "two unequal blocks, joined at an edge, that tumble in free fall and fold by about 6 rad/s"
)
def _tumbling(lab: Lab) -> Rollout:
    pose = Pose.from_euler_deg((0.1, 0.2, 3.0), (20.0, 30.0, 40.0))
    anchor, axis = (
        pose.to_world(np.array([-0.035, 0.03, 0.01])),
        pose.rotation.apply([0.6, 0.8, 0.0]),
    )
    turned = Pose.from_euler_deg((0.0, 0.0, 0.0), (-30.0, 10.0, 70.0))
    # The anchor is at a corner region of the small block.
    other = replace(
        turned, position_m=vector(anchor - turned.rotation.apply([0.05, -0.015, 0.01]))
    )
    speed, spin = np.array([0.3, -0.2, 1.5]), np.array([3.0, -5.0, 4.0])
    large, small = Box(size_m=(0.1, 0.05, 0.05)), Box(size_m=(0.12, 0.04, 0.03))
    first = _moving(body("first", large, pose, mass_kg=0.4), anchor, speed, spin)
    second = _moving(
        body("second", small, other, mass_kg=0.2), anchor, speed, spin + 6.0 * axis
    )
    return lab.rollout(_pair_scene(first, second, anchor, axis, G))


def _centre(rollout: Rollout) -> FloatArray:
    """Return position and velocity of the common centre of mass, shape [sample_count, 6]."""
    blocks = rollout.scene.dynamic_bodies
    weighed = sum(
        one.mass_kg * rollout.states[one.name][:, [0, 1, 2, 7, 8, 9]] for one in blocks
    )
    return np.asarray(weighed / sum(one.mass_kg for one in blocks))


@_tumbling.check("hinged-closed")
def _hinged_closed(rollout: Rollout) -> Measurement:
    (hinge,) = rollout.scene.body_hinges
    frames = hinge_frames(
        hinge, *(rollout.scene.body(name).pose for name in (hinge.first, hinge.second))
    )
    largest = 0.0
    for side in (-REACH_M, REACH_M):
        ends = [
            rollout.position(name) + rollout.rotation(name).apply(anchor + side * axis)
            for name, anchor, axis in (
                (hinge.first, frames.first_anchor_m, frames.first_axis),
                (hinge.second, frames.second_anchor_m, frames.second_axis),
            )
        ]
        largest = max(largest, largest_mm(ends[1] - ends[0]))
    hint = (
        "the bodies fly apart: the hinge is missing" if largest > 2e3 * REACH_M else ""
    )
    return Measurement(measured=largest, hint=hint)


@_tumbling.check(
    "hinged-fall",
    source=SOURCE,
    tolerance=Tolerance(
        "a fall has no model error, as for a single body (free-fall)", absolute=1e-3 * G
    ),
)
def _hinged_fall(rollout: Rollout) -> Measurement:
    acceleration = [
        acceleration_m_per_s2(rollout.times_s, path_m)
        for path_m in _centre(rollout)[:, :3].T
    ]
    return Measurement(measured=length_of(np.add(acceleration, [0.0, 0.0, G])))


@_tumbling.check("hinged-momentum", source=SOURCE)
def _hinged_momentum(rollout: Rollout) -> Measurement:
    centre = _centre(rollout)
    total = np.zeros((len(centre), 3))
    for one in rollout.scene.dynamic_bodies:
        states = rollout.states[one.name]
        total += np.einsum(
            "tij,tj->ti", inertia_kg_m2(rollout, one.name), states[:, 10:]
        )
        total += one.mass_kg * np.cross(
            states[:, :3] - centre[:, :3], states[:, 7:10] - centre[:, 3:]
        )
    change = np.linalg.norm(total - total[0], axis=1).max() / np.linalg.norm(total[0])
    return Measurement(measured=100.0 * float(change))


@_tumbling.check("hinged-energy", source=SOURCE)
def _hinged_energy(rollout: Rollout) -> Measurement:
    centre = _centre(rollout)
    inner = np.zeros(len(centre))
    for one in rollout.scene.dynamic_bodies:
        states = rollout.states[one.name]
        inner += 0.5 * np.einsum(
            "ti,tij,tj->t",
            states[:, 10:],
            inertia_kg_m2(rollout, one.name),
            states[:, 10:],
        )
        inner += (
            0.5 * one.mass_kg * np.square(states[:, 7:10] - centre[:, 3:]).sum(axis=1)
        )
    change = inner / inner[0] - 1.0
    return Measurement(measured=100.0 * float(change[int(np.abs(change).argmax())]))


# --- scissors --------------------------------------------------------------------------------------------------------

BLADE = box("blade", (0.0, 0.0, 0.0), (0.1, 0.04, 0.03), mass_kg=0.3)
ARM_M = 0.04
START_RAD, RATE_RAD_PER_S = 0.3, 4.0
"""Half the angle at the start, and its rate."""


def scissors_angle_rad(times_s: FloatArray) -> FloatArray:
    """Return half the angle of the scissors at some times [rad], by quadrature, shape [T]."""
    about_centre = float(box_inertia_kg_m2(BLADE)[2])
    angles = np.linspace(
        START_RAD, START_RAD + 2.0 * RATE_RAD_PER_S * float(times_s[-1]), 20001
    )
    inertia = about_centre + BLADE.mass_kg * ARM_M**2 * np.cos(angles) ** 2
    slowness = np.sqrt(inertia / inertia[0]) / RATE_RAD_PER_S
    return np.interp(
        times_s, cumulative_trapezoid(slowness, angles, initial=0.0), angles
    )


@Check("hinged-angle")
def _hinged_angle(lab: Lab) -> Measurement:
    anchor, axis = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0])
    blades = []
    for name, side in (("first", -1.0), ("second", 1.0)):
        angle = side * START_RAD
        place = anchor + ARM_M * np.array([np.cos(angle), np.sin(angle), 0.0])
        pose = Pose.from_euler_deg(vector(place), (0.0, 0.0, float(np.degrees(angle))))
        # The common centre rests, so the hinge moves along x.
        back = np.array([ARM_M * np.sin(START_RAD) * RATE_RAD_PER_S, 0.0, 0.0])
        blades.append(
            _moving(
                replace(BLADE, name=name, pose=pose),
                anchor,
                back,
                side * RATE_RAD_PER_S * axis,
            )
        )
    scene = _pair_scene(blades[0], blades[1], anchor, axis, 0.0)
    rollout = lab.rollout(scene)
    frames = hinge_frames(scene.body_hinges[0], blades[0].pose, blades[1].pose)
    angles = np.unwrap(
        hinge_angle_rad(frames, rollout.rotation("first"), rollout.rotation("second"))
    )
    expected = 2.0 * (scissors_angle_rad(rollout.times_s) - START_RAD)
    error = np.degrees(np.abs(angles - expected).max())
    hint = "it turns the other way" if angles[-1] < 0.0 else ""
    return Measurement(measured=float(error), hint=hint)
