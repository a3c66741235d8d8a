"""Driven bodies: they follow their drivers, carry what rests on them, and push balls."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Box, Scene
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.profiles import TrapezoidProfile
from gauge_envs.scoring.estimators import acceleration_m_per_s2
from gauge_envs.tools.bench.parts import ball, box, contact, driven_box, driver, ramp
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.laws import (
    driver_error,
    driver_poses,
    largest_mm,
)
from gauge_envs.tools.conformance.model import Check, Measurement, rollout_of

PLATE_M = (0.6, 0.4, 0.02)
CUBE_M = 0.05


def _on_plate(
    motion: Driver, *, friction: float = 0.4, x_m: float, seconds: float = 1.5
) -> Scene:
    """Return a cube on a driven plate."""
    cube = box("cube", (x_m, 0.0, 0.5 + 0.5 * (PLATE_M[2] + CUBE_M)), (CUBE_M,) * 3)
    return Scene(
        bodies=(cube, driven_box("plate", (0.0, 0.0, 0.5), PLATE_M)),
        contacts=(contact("cube", "plate", friction=friction),),
        drivers=(motion,),
        duration_s=seconds,
    )


_carry = rollout_of(
    "a cube on a plate that is driven by 0.3 m within 1.2 s; friction 0.4",
    _on_plate(
        driver(
            "plate",
            "translate",
            (1.0, 0.0, 0.0),
            ramp(0.3, start_s=0.0, duration_s=1.2, ramp_s=0.4),
        ),
        x_m=-0.1,
    ),
)
"""The plate accelerates by 0.94 m/s^2; friction can hold 3.9 m/s^2."""

TURN = TrapezoidProfile(
    start_s=0.0, duration_s=10.0, accelerate_s=0.5, brake_s=0.0, amount=19.5
)
_turntable = rollout_of(
    "a cube 50 mm off the axis of a plate that turns at up to 2 rad/s; friction 0.4",
    _on_plate(driver("plate", "rotate", (0.0, 0.0, 1.0), TURN), x_m=0.05),
)
"""The centripetal acceleration is 0.2 m/s^2; friction can hold 3.9 m/s^2."""


@_carry.check("driven-velocity")
def _driven_velocity(rollout: Recording) -> Measurement:
    cruise = rollout.scene.drivers[0].motions[0].rate(0.6)
    speed = rollout.velocity("plate")[rollout.sample_at(0.6), 0]
    return Measurement(measured=float(speed / cruise), expected=1.0)


@_turntable.check("driven-path")
def _driven_path(rollout: Recording) -> Measurement:
    corners = Box(size_m=PLATE_M).corners_m
    rotated = np.stack(
        [rotation.apply(corners) for rotation in rollout.rotation("plate")]
    )
    found = driver_error(rollout, rotated + rollout.position("plate")[:, None])
    return found if found.hint else replace(found, hint=_turn_hint(rollout))


def _turn_hint(rollout: Recording) -> str:
    """Return how far the plate turns in each interval, from where its drive puts it, if that is degrees for radians."""
    prescribed = Rotation.concatenate([pose.rotation for pose in driver_poses(rollout)])
    asked = (prescribed[1:] * prescribed[:-1].inv()).magnitude()
    turned = (rollout.rotation("plate")[1:] * prescribed[:-1].inv()).magnitude()
    moves = asked > 0.5 * asked.max()
    ratio = float(np.median(turned[moves] / asked[moves]))
    wrong = any(
        abs(ratio / unit - 1.0) < 0.05 for unit in (np.degrees(1.0), np.radians(1.0))
    )
    return (
        f"in each interval it turns {ratio:.3g} times as far as prescribed: drive() gives rad/s"
        if wrong
        else ""
    )


CARRY_DIAGNOSIS = (
    "the driven body must have a velocity in every step, so that friction carries the cube; a piecewise constant speed "
    "jolts the cube at each change, as when the acceleration that drive() gives is ignored"
)


@_turntable.check(
    "carry-turn",
    diagnosis=CARRY_DIAGNOSIS
    + "; check the angular velocity's sign and frame, and outward creep",
)
@_carry.check("carry-line", diagnosis=CARRY_DIAGNOSIS)
def _slip(rollout: Recording) -> Measurement:
    """Measure the largest displacement of the cube in the plate's prescribed frame [mm]."""
    poses = driver_poses(rollout)
    places = [
        pose.to_body(position)
        for pose, position in zip(poses, rollout.position("cube"), strict=True)
    ]
    return Measurement(measured=largest_mm(np.array(places) - places[0]))


@Check("carry-slip")
def _carry_slip(lab: Lab) -> Measurement:
    start = TrapezoidProfile(
        start_s=0.0, duration_s=0.5, accelerate_s=0.5, brake_s=0.0, amount=0.25
    )
    motion = driver("plate", "translate", (1.0, 0.0, 0.0), start)
    rollout = lab.rollout(_on_plate(motion, friction=0.05, x_m=0.0, seconds=0.4))
    measured = acceleration_m_per_s2(rollout.times_s, rollout.position("cube")[:, 0])
    return Measurement(measured=measured, expected=0.05 * G)


# The driven plate accelerates the first ball, then brakes and loses contact.

LEFT_KG, RIGHT_KG, RESTITUTION = 0.1, 0.2, 0.6
PUSH_M_PER_S = 0.5
PUSHED_S = 0.42
"""Time at which the ball flies freely [s]."""


def _collide() -> Scene:
    """Return two balls, one of which a driven plate pushes."""
    stroke = ramp(0.1, start_s=0.0, duration_s=0.3, ramp_s=0.1)
    return Scene(
        bodies=(
            ball("left", (0.0, 0.0, 1.0), radius_m=0.02, mass_kg=LEFT_KG),
            ball("right", (0.25, 0.0, 1.0), radius_m=0.02, mass_kg=RIGHT_KG),
            driven_box("plate", (-0.03, 0.0, 1.0), (0.02, 0.1, 0.1)),
        ),
        contacts=(
            contact("left", "plate", friction=0.0),
            contact("left", "right", friction=0.0, restitution=RESTITUTION),
        ),
        drivers=(driver("plate", "translate", (1.0, 0.0, 0.0), stroke),),
        duration_s=1.0,
        gravity_m_per_s2=0.0,
    )


_collision = rollout_of(
    "a driven plate pushes a ball of 0.1 kg at 0.5 m/s against a resting one of 0.2 kg; no gravity",
    _collide(),
)


@_collision.check("pushed-ball")
def _pushed_ball(rollout: Recording) -> Measurement:
    pushed = rollout.velocity("left")[rollout.sample_at(PUSHED_S), 0]
    return Measurement(measured=float(pushed), expected=PUSH_M_PER_S)
