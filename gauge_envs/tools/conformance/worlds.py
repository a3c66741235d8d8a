"""Many worlds at once: each world of a batch is the single simulation of its scene, also after it restarts alone.

The worlds differ in starts, masses, friction, restitution, driven motion and wrenches. What an engine does
not build together is built one by one (`worlds_of`), as for training. Few worlds are compared with single simulations;
all are compared with a batch of the same scenes that are each one place further, which must have the same courses.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np

from gauge_envs.backends.base import Backend, scene_support
from gauge_envs.backends.shared.resampled import worlds_in_intervals
from gauge_envs.backends.worlds import Worlds
from gauge_envs.envs.device import dynamic_states
from gauge_envs.errors import BackendError, MissingExtraError
from gauge_envs.envs.recording import DeclinedError
from gauge_envs.scene import RigidBody, Scene
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.bench.parts import (
    ball,
    box,
    contact,
    driven_box,
    driver,
    fixed_box,
    ramp,
)
from gauge_envs.tools.conformance.contract import one_sign, parts_apart
from gauge_envs.tools.conformance.differences import LEAST, cause_of, cause_of_told
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import Check, Measurement, Recorded

Numbers = IntArray

TOGETHER, SEPARATE = 64, 4
"""Number of worlds of engines that build them together, and of those that build simulations one by one."""
SINGLES = (0, 1, 31, 63)
"""Worlds that are compared with single simulations."""
NAMES = ("ball", "brick", "plate")
INTERVALS = 42
PLATE_M = (0.0, 0.0, 0.5)


def _scene(number: int) -> Scene:
    """Return the scene of a world: a ball that drops on a slab, and a brick on a driven plate."""
    # From 0 to 1; neighbours differ by a quarter.
    share = 0.25 * (number % 4) + number / 256
    # The plate is faster than friction can carry the brick, so that it slides in each world.
    friction = 0.1 + 0.4 * share
    thrown = replace(
        ball("ball", (0.5 + 0.03 * share, 0.0, 0.13 + 0.06 * share)),
        mass_kg=0.1 + 0.3 * share,
        linear_velocity_m_per_s=(0.6 * share, 0.1, 0.0),
    )
    return Scene(
        bodies=(
            thrown,
            replace(
                box("brick", (0.06 * share, 0.0, 0.525), (0.06, 0.05, 0.03)),
                mass_kg=0.2 + 0.3 * share,
            ),
            fixed_box("slab", (0.5, 0.0, -0.05), (2.0, 2.0, 0.1)),
            driven_box("plate", PLATE_M, (0.6, 0.4, 0.02)),
        ),
        contacts=(
            contact("ball", "slab", friction=friction, restitution=0.2 + 0.6 * share),
            contact("brick", "plate", friction=friction),
        ),
        drivers=(
            driver(
                "plate",
                "translate",
                (1.0, 0.0, 0.0),
                ramp(0.3, start_s=0.0, duration_s=0.5, ramp_s=0.1),
            ),
        ),
        duration_s=0.5,
    )


def _motions(numbers: Numbers, interval: Numbers | int) -> FloatArray:
    """Return pose, velocity and acceleration of the plates of some scenes in an interval of each, shape [n, 19]."""
    rates = 6.5 + 0.2 * (numbers % 4)
    time_s = interval * SAMPLE_INTERVAL_S
    motions = np.zeros((len(numbers), 19))
    motions[:, :3] = PLATE_M
    motions[:, 0] += 0.5 * rates * time_s**2
    motions[:, 3] = 1.0
    motions[:, 7], motions[:, 13] = rates * time_s, rates
    return motions


def _numbers(lab: Lab) -> Numbers:
    """Return the numbers of the worlds of a batch."""
    engine = lab.backend
    builds_worlds = type(engine).build_worlds is not Backend.build_worlds
    return np.arange(
        TOGETHER if builds_worlds and engine.worlds_mix_constants else SEPARATE
    )


def _built(lab: Lab, scenes: list[Scene], **how: Any) -> Worlds:
    support = scene_support(lab.backend, scenes[0])
    if not support:
        raise DeclinedError(support.missing)
    started = [*map(lab.started, scenes)]
    return worlds_in_intervals(lab.backend, started, lab.settings, **how)


def _scenes(numbers: Numbers) -> list[Scene]:
    return [*map(_scene, numbers.tolist())]


def _course(worlds: Worlds, scenes: Numbers, first: Numbers, count: int) -> FloatArray:
    """Drive half of the worlds, then the others, and advance, for some intervals.

    Args:
        worlds: The worlds.
        scenes: Number of the scene of each world.
        first: First interval of each world.
        count: Number of intervals.

    Returns:
        States, shape [count, world_count, body_count, 13].
    """
    rows = []
    numbers = np.arange(len(scenes), dtype=np.intp)
    for interval in range(count):
        motions = _motions(scenes, first + interval)
        for some in (numbers[::2], numbers[1::2]):
            worlds.drive("plate", motions[some], some)
        worlds.advance(SAMPLE_INTERVAL_S)
        rows.append(one_sign(np.array(worlds.body_states(list(NAMES)))))
    return np.array(rows)


def _singles(lab: Lab) -> FloatArray:
    """Return the states of single simulations, shape [INTERVALS, world_count, body_count, 13].

    Those of worlds beyond `SINGLES` are of a batch in which each scene is one place further.
    """
    numbers = np.roll(_numbers(lab), 1)
    with closing(_built(lab, _scenes(numbers))) as worlds:
        worlds.reset(0)
        courses = np.roll(_course(worlds, numbers, 0 * numbers, INTERVALS), -1, axis=1)
    for number in _compared(len(numbers)):
        courses[:, number] = _single(lab, number)
    return courses


def _compared(count: int) -> Sequence[int]:
    """Return the numbers of the worlds that are compared with single simulations."""
    return SINGLES if count == TOGETHER else range(SEPARATE)


def _single(lab: Lab, number: int) -> FloatArray:
    """Return the states of the scene of a world alone, shape [INTERVALS, body_count, 13]."""
    scene = _scene(number)
    rows = []
    with lab.running(scene) as simulation:
        for interval in range(INTERVALS):
            (motion,) = _motions(np.array([number]), interval)
            pose = replace(
                scene.body("plate").pose,
                position_m=(float(motion[0]), *PLATE_M[1:]),
            )
            simulation.drive("plate", pose, motion[7:13], motion[13:])
            simulation.advance(SAMPLE_INTERVAL_S)
            rows.append(one_sign(np.array(simulation.body_states(list(NAMES)))))
    return np.array(rows)


_alone = Recorded("", _singles)
WHAT = (
    "64 worlds, or four of an engine that builds them one by one, of a ball that drops on a slab and a brick on a "
    "driven plate, with other starts, masses, friction, restitution and driven motion each"
)


def _difference(
    found: FloatArray, expected: FloatArray, restarted: Numbers | None = None
) -> Measurement:
    """Measure the largest difference of states, shape [T, world_count, body_count, 13], and name its world and body."""
    apart = np.abs(found - expected)
    parts: dict[str, float] = {}
    for column, name in enumerate(NAMES):
        parts |= parts_apart(apart[:, :, column], name)
    largest = max(parts, key=lambda name: parts[name])
    world = int(apart.max(axis=(0, 2, 3)).argmax())
    label = f"world {world}"
    if restarted is not None:
        label += ", which restarts," if world in restarted else ", which goes on,"
    hint = f"{label} differs most, in the {largest}"
    return Measurement(measured=float(apart.max()), hint=hint, parts=parts)


def _explained(lab: Lab, found: FloatArray) -> Measurement:
    """Measure the largest difference from the scenes alone, and find what explains it."""
    expected = _alone(lab)[: len(found)]
    measured = _difference(found, expected)
    count = found.shape[1]
    sizes = np.abs(found - expected).max(axis=(0, 2, 3))
    # The others are compared with worlds that may have the same fault.
    compared = np.array(_compared(count))
    world = int(compared[sizes[compared].argmax()])
    if sizes[world] < LEAST:
        world = int(sizes.argmax())
    if sizes[world] < LEAST:
        return measured
    near = {0, world - 1, world + 1, world ^ 1, count - 1, count - 1 - world, world % 4}
    near = {number for number in near if 0 <= number < count} - {world}
    courses = {number: _single(lab, number)[: len(found)] for number in sorted(near)}
    law = _single(lab, world)[: len(found)]
    cause = cause_of(found[:, world], law, courses, found.mean(axis=1))
    hint = f"{np.sum(sizes > LEAST)} of {count} worlds differ, as world {world}"
    if not cause:
        hint = measured.hint
    return replace(measured, hint=hint, cause=cause)


def _twice(lab: Lab) -> tuple[FloatArray, FloatArray]:
    """Return the states of worlds, and those after a reset."""
    numbers = _numbers(lab)
    with closing(_built(lab, _scenes(numbers))) as worlds:
        worlds.reset(0)
        before = _course(worlds, numbers, 0 * numbers, INTERVALS)
        worlds.reset(0)
        return before, _course(worlds, numbers, 0 * numbers, INTERVALS // 2)


_together = Recorded("", _twice)


@Check("worlds-single", scene=WHAT)
def _worlds_single(lab: Lab) -> Measurement:
    before, _ = _together(lab)
    return _explained(lab, before)


@Check("worlds-reset", scene=WHAT)
def _worlds_reset(lab: Lab) -> Measurement:
    _, after = _together(lab)
    return _explained(lab, after)


@Check("worlds-restart", scene=WHAT)
def _worlds_restart(lab: Lab) -> Measurement:
    before, after = 30, 12
    numbers = _numbers(lab)
    # The first and the last world are among them; reversed numbers are other ones.
    restarted = np.unique([*numbers[::3], 1, numbers[-1]])
    first = np.full_like(numbers, before)
    first[restarted] = 0
    with closing(_built(lab, _scenes(numbers), restart_alone=True)) as worlds:
        worlds.reset(0)
        _course(worlds, numbers, 0 * numbers, before)
        for number in restarted.tolist():
            worlds.restart(number)
        found = _course(worlds, numbers, first, after)
    expected = np.array(_alone(lab)[before : before + after])
    expected[:, restarted] = _alone(lab)[:after, restarted]
    return _difference(found, expected, restarted)


PUSH_N, TOLD = 0.2, 30
"""Force [N], and number of intervals."""


def _told(
    lab: Lab, scenes: list[Scene], tell: Callable[[Worlds, Numbers], None]
) -> FloatArray:
    """Return the states of the body of each world, shape [TOLD, world_count, 13].

    In each interval half of the worlds are told first, and then the others.

    Args:
        lab: The lab.
        scenes: Scenes of one dynamic body.
        tell: Function that pushes the worlds of some numbers.
    """
    with closing(_built(lab, scenes)) as worlds:
        worlds.reset(0)
        every = np.arange(len(scenes))
        (name,) = (one.name for one in scenes[0].bodies)
        rows = []
        for _ in range(TOLD):
            for numbers in (every[::2], every[1::2]):
                try:
                    tell(worlds, numbers)
                except BackendError as error:
                    raise DeclinedError((str(error),)) from error
            worlds.advance(SAMPLE_INTERVAL_S)
            rows.append(np.array(worlds.body_states([name]))[:, 0])
        return np.array(rows)


def _worst(
    told: Mapping[str, FloatArray], rates: FloatArray, gains: FloatArray
) -> Measurement:
    """Return the ratio that is farthest from 1, name its world, and find what explains it.

    Args:
        told: What sets the acceleration of each world, as in `cause_of_told`.
        rates: Velocity of each world at the end of each interval, shape [TOLD, world_count].
        gains: What the velocity should gain in an interval in each world, shape [world_count].
    """
    shares = np.diff(rates, axis=0, prepend=0.0 * rates[:1]) / gains
    ratios = shares.mean(axis=0)
    world = int(np.abs(ratios - 1.0).argmax())
    hint = f"in world {world}; {np.sum(np.abs(ratios - 1.0) > 0.01)} of {len(ratios)} are off by more than 1 %"
    cause = cause_of_told(told, shares)
    return Measurement(
        measured=float(ratios[world]), expected=1.0, hint=hint, cause=cause
    )


@Check(
    "worlds-wrench", scene="worlds of a free brick, each with another mass and force"
)
def _worlds_wrench(lab: Lab) -> Measurement:
    numbers = _numbers(lab)
    masses_kg: FloatArray = 0.2 + 0.01 * numbers.astype(np.float64)
    forces_n: FloatArray = PUSH_N * (1 + numbers % 5).astype(np.float64)
    scenes = [
        Scene(
            bodies=(
                replace(box("brick", (0.0, 0.0, 0.0), (0.06, 0.05, 0.03)), mass_kg=one),
            ),
            duration_s=TOLD * SAMPLE_INTERVAL_S,
            gravity_m_per_s2=0.0,
        )
        for one in masses_kg.tolist()
    ]
    wrenches = np.zeros((len(numbers), 6))
    wrenches[:, 1] = forces_n
    states = _told(
        lab,
        scenes,
        lambda worlds, some: worlds.apply_wrench("brick", wrenches[some], some),
    )
    told = {"force": forces_n, "mass": 1.0 / masses_kg}
    gains = forces_n / masses_kg * SAMPLE_INTERVAL_S
    return _worst(told, states[..., 8], gains)


@Check("worlds-device", scene=f"{WHAT}, in arrays of the device")
def _worlds_device(lab: Lab) -> Measurement:
    numbers = _numbers(lab)
    scenes = _scenes(numbers)
    built = [
        replace(one, bodies=tuple(map(_at_start_of, one.bodies, other.bodies)))
        for one, other in zip(scenes, [*scenes[1:], scenes[0]], strict=True)
    ]
    starts = np.array([dynamic_states(one) for one in scenes])
    courses = []
    with closing(_built(lab, built)) as worlds:
        try:
            device = worlds.on_device()
        except (BackendError, MissingExtraError) as error:
            raise DeclinedError((str(error),)) from error
        device.begin(device.asarray(starts))
        for interval in range(INTERVALS):
            device.drive("plate", device.asarray(_motions(numbers, interval)))
            device.advance(SAMPLE_INTERVAL_S)
            states = device.copied(device.body_states(NAMES))
            courses.append(one_sign(states.astype(np.float64)))
    return _explained(lab, np.array(courses))


def _at_start_of(body: RigidBody, other: RigidBody) -> RigidBody:
    """Return a body that starts as another one does."""
    speed = other.linear_velocity_m_per_s
    return replace(body, pose=other.pose, linear_velocity_m_per_s=speed)
