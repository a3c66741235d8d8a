"""Driven bodies: they follow their drivers, carry what rests on them, and push balls that collide."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.evaluation.estimators import acceleration_m_per_s2
from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Box, Scene
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.profiles import TrapezoidProfile
from gauge_envs.tools.bench.parts import ball, box, contact, driven_box, driver, ramp
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
def _driven_velocity(rollout: Rollout) -> Measurement:
    cruise = rollout.scene.drivers[0].motions[0].rate(0.6)
    speed = rollout.velocity("plate")[rollout.sample_at(0.6), 0]
    return Measurement(measured=float(speed / cruise), expected=1.0)


@_turntable.check("driven-path")
def _driven_path(rollout: Rollout) -> Measurement:
    corners = Box(size_m=PLATE_M).corners_m
    rotated = np.stack(
        [rotation.apply(corners) for rotation in rollout.rotation("plate")]
    )
    found = driver_error(rollout, rotated + rollout.position("plate")[:, None])
    return found if found.hint else replace(found, hint=_turn_hint(rollout))


def _turn_hint(rollout: Rollout) -> str:
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
def _slip(rollout: Rollout) -> Measurement:
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


# The contract has no start velocities, so a driven plate accelerates the first ball, then brakes and loses contact.

LEFT_KG, RIGHT_KG, RESTITUTION = 0.1, 0.2, 0.6
PUSH_M_PER_S = 0.5
BEFORE_S, AFTER_S = 0.42, 0.75


def _collide(slowdown: float) -> Scene:
    """Return two balls, one of which a driven plate pushes; all times are longer by a factor."""
    stroke = ramp(0.1, start_s=0.0, duration_s=0.3 * slowdown, ramp_s=0.1 * slowdown)
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
        duration_s=slowdown,
        gravity_m_per_s2=0.0,
    )


PUSHED = "a driven plate pushes a ball of 0.1 kg at {} m/s against a resting one of 0.2 kg; no gravity"
_collision = rollout_of(PUSHED.format(0.5), _collide(1.0))
_slow_collision = rollout_of(PUSHED.format(0.1), _collide(5.0))


def _speeds(rollout: Rollout, time_s: float) -> tuple[float, float]:
    """Return the speeds of both balls at a time [s] of the fast collision."""
    sample = rollout.sample_at(time_s * rollout.scene.duration_s)
    return float(rollout.velocity("left")[sample, 0]), float(
        rollout.velocity("right")[sample, 0]
    )


def _collided(
    rollout: Rollout, expected: float, measure: Callable[[float, float, float], float]
) -> Measurement:
    """Measure a collision by the first ball's speed before it and both speeds after it, if the second one rested."""
    push = PUSH_M_PER_S / rollout.scene.duration_s
    (before, still), (left, right) = (
        _speeds(rollout, BEFORE_S),
        _speeds(rollout, AFTER_S),
    )
    if abs(before) > 0.2 * push and abs(still) < 0.01 * push:
        return Measurement(measured=measure(before, left, right), expected=expected)
    hint = f"before the collision the balls move at {before:.3g} and {still:.3g} m/s instead of {push:g} and 0"
    return Measurement(measured=float("nan"), expected=expected, hint=hint)


@_collision.check("pushed-ball")
def _pushed_ball(rollout: Rollout) -> Measurement:
    return Measurement(measured=_speeds(rollout, BEFORE_S)[0], expected=PUSH_M_PER_S)


@_collision.check("collision-momentum")
def _collision_momentum(rollout: Rollout) -> Measurement:
    return _collided(
        rollout,
        1.0,
        lambda before, left, right: (
            (LEFT_KG * left + RIGHT_KG * right) / (LEFT_KG * before)
        ),
    )


@_slow_collision.check("collision-slow")
@_collision.check("collision-rebound")
def _relative_speed(rollout: Rollout) -> Measurement:
    return _collided(
        rollout, RESTITUTION, lambda before, left, right: (right - left) / before
    )
