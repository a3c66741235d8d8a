"""Rich scenes: many directions, speeds, orders and times at once; each is compared with one law or symmetry.

A law that holds for one body in one direction holds for all: the check reports the worst of them, and its hint says
what sets that one apart. So a scene sees faults that depend on direction, speed, time, or which body is listed first.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import (
    Box,
    ConvexUnion,
    Hinge,
    Pose,
    RigidBody,
    Scene,
    Tether,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.tools.bench.parts import (
    ball,
    body,
    corners,
    driven_box,
    ramp,
)
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.laws import (
    furthest_from,
    largest_mm,
    spin_from_orientations,
    worst_ratio,
)
from gauge_envs.tools.conformance.model import Measurement, rollout_of


def thrown(one: RigidBody, velocity: Any, spin: Any = (0.0, 0.0, 0.0)) -> RigidBody:
    """Return a body that starts with a velocity [m/s] and an angular velocity [rad/s]."""
    return replace(
        one,
        linear_velocity_m_per_s=vector(velocity),
        angular_velocity_rad_per_s=vector(spin),
    )


# --- free motion, fast, slow and late --------------------------------------------------------------------------------

GLIDE_S = 2.6
DIRECTION = np.array([0.6, -0.64, 0.48])
GLIDES = {
    "20 m/s": 20.0 * DIRECTION,
    "13 m/s": -13.0 * DIRECTION,
    "0.1 m/s": 0.1 * DIRECTION,
    "4 mm/s": -0.004 * DIRECTION,
}
RATES = {"+14 rad/s": 14.0, "-5 rad/s": -5.0, "+0.05 rad/s": 0.05}
AXIS = np.array([0.48, 0.6, 0.64])
SPIN_RAD_PER_S = 45.0
LEAST = {"velocity": 0.1, "angular velocity": 0.5}
"""Scales below which rates are not compared relatively [m/s, rad/s]."""


def _hinged(name: str, rate: float, place: FloatArray) -> tuple[RigidBody, Hinge]:
    """Return a bar on a hinge through its centre, which starts with a rate [rad/s]."""
    pose = Pose.from_euler_deg(vector(place), (20.0, -35.0, 50.0))
    one = body(name, Box(size_m=(0.2, 0.03, 0.04)), pose)
    hinge = Hinge(body=name, anchor_m=vector(place), axis=vector(AXIS))
    return thrown(one, np.zeros(3), rate * AXIS), hinge


def _glide_scene() -> Scene:
    # Near the origin single precision resolves the steps of the slowest ball.
    balls = [
        thrown(ball(name, (0.0, 0.0, 0.0)), velocity)
        for name, velocity in GLIDES.items()
    ]
    spinning = thrown(
        ball("spinning ball", (2.0, 0.0, 1.0)), np.zeros(3), SPIN_RAD_PER_S * AXIS
    )
    bars = [
        _hinged(name, rate, np.array([3.0, 0.5 * index, 1.0]))
        for index, (name, rate) in enumerate(RATES.items())
    ]
    return Scene(
        bodies=(*balls, spinning, *(bar for bar, _ in bars)),
        joints=tuple(hinge for _, hinge in bars),
        duration_s=GLIDE_S,
        gravity_m_per_s2=0.0,
    )


_glide = rollout_of(
    "balls thrown with 4 mm/s to 20 m/s, one that spins, and bars on hinges through their centres that turn both ways, "
    "without gravity and contacts, for 2.6 s",
    _glide_scene(),
)


@_glide.check("glide-speed")
def _glide_speed(rollout: Recording) -> Measurement:
    ratios = {}
    for name, velocity in GLIDES.items():
        for start_s, end_s in ((0.0, 0.8), (0.8, 1.8), (2.1, GLIDE_S)):
            first, last = rollout.sample_at(start_s), rollout.sample_at(end_s)
            moved = rollout.position(name)[last] - rollout.position(name)[first]
            seconds = float(rollout.times_s[last] - rollout.times_s[first])
            law = seconds * velocity
            ratios[f"{name} from {start_s:g} to {end_s:g} s"] = float(
                moved @ law / (law @ law)
            )
    return worst_ratio(ratios, "the speed is")


@_glide.check("glide-turn")
def _glide_turn(rollout: Recording) -> Measurement:
    rates = RATES | {"spinning ball": SPIN_RAD_PER_S}
    ratios = {}
    for name, rate in rates.items():
        rotations = rollout.rotation(name)
        steps = (rotations[1:] * rotations[:-1].inv()).as_rotvec() @ AXIS
        for start_s, end_s in ((0.0, 1.0), (2.1, GLIDE_S)):
            part = slice(rollout.sample_at(start_s), rollout.sample_at(end_s))
            ratios[f"{name} from {start_s:g} to {end_s:g} s"] = float(
                steps[part].mean() / rollout.interval_s / rate
            )
    return worst_ratio(ratios, "the rate of rotation is")


@_glide.check("glide-reports")
def _glide_reports(rollout: Recording) -> Measurement:
    errors = {}
    for one in rollout.scene.bodies:
        turns = rollout.rotation(one.name)
        moved = {
            "velocity": np.gradient(
                rollout.position(one.name), rollout.times_s, axis=0
            ),
            "angular velocity": spin_from_orientations(turns, rollout.interval_s),
        }
        reported = {
            "velocity": rollout.velocity(one.name)[1:-1],
            "angular velocity": rollout.angular_velocity(one.name)[1:-1],
        }
        moved["velocity"] = moved["velocity"][1:-1]
        for kind, rate in moved.items():
            scale = max(float(np.linalg.norm(rate, axis=1).max()), LEAST[kind])
            off = np.linalg.norm(reported[kind] - rate, axis=1) / scale
            # A difference of poses is no rate where that changes: something brakes the body.
            changes = np.linalg.norm(np.gradient(rate, axis=0), axis=1)
            off = np.where(changes < 0.01 * scale, off, 0.0)
            errors[f"{kind} of {one.name}"] = float(off.max())
    worst = max(errors, key=lambda one: np.nan_to_num(errors[one], nan=np.inf))
    hint = f"the reported {worst} is not the one with which it moves"
    return Measurement(measured=100.0 * errors[worst], hint=hint)


# --- a driven body turned away from its axes -------------------------------------------------------------------------

PLATE_M = (0.5, 0.3, 0.1)
BLOCKS = {
    "first block": ((-70.0, 35.0, 20.0), (0.6, 0.0, 0.8), (0.0, -0.6, 0.8), 1.5),
    "second block": ((25.0, -15.0, 80.0), (0.48, 0.64, -0.6), (0.8, 0.6, 0.0), -1.3),
    "third block": ((0.0, 50.0, -130.0), (0.0, -0.8, 0.6), (0.6, 0.0, -0.8), 1.1),
}
"""Orientation at the start [deg], axis and line of the motion, and angle [rad]."""


def _turned_scene() -> Scene:
    blocks, drivers = [], []
    for number, (name, (start_deg, axis, line, angle_rad)) in enumerate(BLOCKS.items()):
        place = np.array([0.3 + number, -0.2, 1.0])
        blocks.append(driven_box(name, vector(place), PLATE_M, euler_deg=start_deg))
        turn = DriverMotion(
            kind="rotate",
            axis=axis,
            point_m=vector(np.add(place, (-0.2, 0.3, -0.2))),
            profiles=(ramp(angle_rad, start_s=0.0, duration_s=0.4, ramp_s=0.05),),
        )
        move = DriverMotion(
            kind="translate",
            axis=line,
            profiles=(ramp(-0.4, start_s=0.1, duration_s=0.2, ramp_s=0.05),),
        )
        drivers.append(Driver(body=name, motions=(turn, move), provenance="nominal"))
    return Scene(bodies=tuple(blocks), drivers=tuple(drivers), duration_s=0.5)


_turned = rollout_of(
    "three driven blocks, turned away from their axes, that turn by up to 1.5 rad about leaning axes beside them and "
    "move; no contacts",
    _turned_scene(),
)


@_turned.check("driven-turned-path")
def _driven_turned_path(rollout: Recording) -> Measurement:
    vertices = Box(size_m=PLATE_M).corners_m
    errors, hints = {}, {}
    for motion in rollout.scene.drivers:
        name = motion.body
        start = rollout.scene.body(name).pose
        asked = [motion.pose(start, float(time)) for time in rollout.times_s]
        places = np.array([one.to_world(vertices) for one in asked])
        found = np.array([turn.apply(vertices) for turn in rollout.rotation(name)])
        found += rollout.position(name)[:, None]
        turns = Rotation.concatenate([one.rotation for one in asked])
        off_rad = (rollout.rotation(name) * turns.inv()).magnitude()
        centre_mm = largest_mm(found.mean(axis=1) - places.mean(axis=1))
        errors[name] = largest_mm(found - places)
        hints[name] = (
            f"the centre of the {name} is off by {centre_mm:.3g} mm, its orientation by "
            f"{np.degrees(off_rad.max()):.3g} degrees"
        )
    worst = max(errors, key=lambda one: errors[one])
    others = ", ".join(f"{one} {error:.3g} mm" for one, error in errors.items())
    return Measurement(measured=errors[worst], hint=f"{hints[worst]} ({others})")


@_turned.check("driven-turned-rate")
def _driven_turned_rate(rollout: Recording) -> Measurement:
    errors, hints = {}, {}
    for motion in rollout.scene.drivers:
        name = motion.body
        start = rollout.scene.body(name).pose
        asked = motion.path(start, rollout.times_s)[:, 7:]
        found = np.hstack([rollout.velocity(name), rollout.angular_velocity(name)])
        # At the start of the motion the reported rate may still be that of rest.
        largest = [np.abs(asked[:, :3]).max()] * 3 + [np.abs(asked[:, 3:]).max()] * 3
        error = np.abs(found - asked)[1:] / largest
        part = "linear" if error[:, :3].max() > error[:, 3:].max() else "angular"
        frame = rollout.rotation(name).apply(asked[:, 3:], inverse=True)
        from_body = np.abs(found[:, 3:] - frame)[1:].max()
        in_body = from_body < 0.1 * np.abs(found[:, 3:] - asked[:, 3:])[1:].max()
        errors[name] = 100.0 * float(error.max())
        hints[name] = f"the {part} velocity of the driven body is off for the {name}"
        hints[name] += ": it is in the body frame" if in_body else ""
    worst = max(errors, key=lambda one: errors[one])
    return Measurement(measured=errors[worst], hint=hints[worst])


# --- a string at the body's origin -----------------------------------------------------------------------------------

STRING_M, STRING_TOP_M = 0.3, np.array([0.1, -0.2, 1.5])
OFF_CENTRE = ConvexUnion(pieces_m=(corners((0.0, -0.02, -0.02), (0.12, 0.03, 0.02)),))
"""Block whose origin is on one of its faces, 60 mm from its centre of mass."""


@rollout_of(
    "a block that hangs on a string of 0.3 m at its origin, 60 mm beside its centre of mass, and falls from level",
    Scene(
        bodies=(
            body(
                "block",
                OFF_CENTRE,
                Pose(position_m=vector(STRING_TOP_M - [0.0, 0.0, STRING_M])),
            ),
        ),
        joints=(
            Tether(body="block", anchor_m=vector(STRING_TOP_M), length_m=STRING_M),
        ),
        duration_s=0.4,
    ),
).check("tether-origin")
def _tether_origin(rollout: Recording) -> Measurement:
    distance = np.linalg.norm(rollout.position("block") - STRING_TOP_M, axis=1)
    return furthest_from(1e3 * STRING_M, 1e3 * distance)
