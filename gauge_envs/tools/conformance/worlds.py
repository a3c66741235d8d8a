"""Many worlds at once: each world of a batch is the single simulation of its scene, also after it restarts alone.

The worlds differ in starts, masses, friction, restitution and driven motion. What an engine does not build together is
built one by one (`worlds_of`), as for training.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.base import Worlds, scene_support, worlds_of
from gauge_envs.runs.rollout import DeclinedError
from gauge_envs.scene import Motion, Scene
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
from gauge_envs.tools.conformance.contract import one_sign
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import Check, Measurement, Recorded

Array = NDArray[np.float64]

WORLDS = 4
NAMES = ("ball", "brick", "plate")
INTERVALS = 60
PLATE_M = (0.0, 0.0, 0.5)


def _scene(number: int) -> Scene:
    """Return the scene of a world: a ball that drops on a slab, and a brick on a driven plate."""
    friction = 0.1 + 0.15 * number
    thrown = replace(
        ball("ball", (0.5 + 0.01 * number, 0.0, 0.13 + 0.02 * number)),
        mass_kg=0.1 * (1 + number),
        linear_velocity_m_per_s=(0.2 * number, 0.1, 0.0),
    )
    return Scene(
        bodies=(
            thrown,
            replace(
                box("brick", (0.02 * number, 0.0, 0.525), (0.06, 0.05, 0.03)),
                mass_kg=0.2 + 0.1 * number,
            ),
            fixed_box("slab", (0.5, 0.0, -0.05), (2.0, 2.0, 0.1)),
            driven_box("plate", PLATE_M, (0.4, 0.4, 0.02)),
        ),
        contacts=(
            contact("ball", "slab", friction=friction, restitution=0.2 + 0.2 * number),
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


SCENES = tuple(_scene(number) for number in range(WORLDS))
STILL = tuple(
    replace(
        scene,
        bodies=scene.bodies[:1] + scene.bodies[2:3],
        contacts=scene.contacts[:1],
        drivers=(),
    )
    for scene in SCENES
)
"""The same scenes without what is driven."""


def _motions(interval: int) -> Array:
    """Return pose, velocity and acceleration of the plate of each world in an interval, shape [world_count, 19]."""
    rates = 1.0 + 0.5 * np.arange(WORLDS)
    time_s = interval * SAMPLE_INTERVAL_S
    motions = np.zeros((WORLDS, 19))
    motions[:, :3] = PLATE_M
    motions[:, 0] += 0.5 * rates * time_s**2
    motions[:, 3] = 1.0
    motions[:, 7], motions[:, 13] = rates * time_s, rates
    return motions


def _built(lab: Lab, scenes: tuple[Scene, ...], **how: Any) -> Worlds:
    support = scene_support(lab.backend, scenes[0])
    if not support:
        raise DeclinedError(support.missing)
    return worlds_of(lab.backend, scenes, lab.settings, **how)


def _course(worlds: Worlds, first: int, count: int) -> Array:
    """Drive and advance some intervals; return states, shape [count, world_count, body_count, 13]."""
    rows = []
    numbers = np.arange(WORLDS, dtype=np.intp)
    for interval in range(first, first + count):
        worlds.drive("plate", _motions(interval)[numbers], numbers)
        worlds.advance(SAMPLE_INTERVAL_S)
        rows.append(one_sign(np.array(worlds.body_states(list(NAMES)))))
    return np.array(rows)


def _singles(lab: Lab) -> Array:
    """Return the states of single simulations, shape [INTERVALS, WORLDS, body_count, 13]."""
    courses = []
    for number, scene in enumerate(SCENES):
        with closing(lab.build(scene)) as simulation:
            simulation.reset(0)
            rows = []
            for interval in range(INTERVALS):
                motion = _motions(interval)[number]
                pose = replace(
                    scene.body("plate").pose,
                    position_m=(float(motion[0]), *PLATE_M[1:]),
                )
                simulation.drive("plate", pose, motion[7:13], motion[13:])
                simulation.advance(SAMPLE_INTERVAL_S)
                rows.append(one_sign(np.array(simulation.body_states(list(NAMES)))))
            courses.append(rows)
    return np.array(courses).transpose(1, 0, 2, 3)


_alone = Recorded("", _singles)
WHAT = (
    "four worlds of a ball that drops on a slab and a brick on a driven plate, with other starts, masses, friction, "
    "restitution and driven motion each"
)


def _difference(found: Array, expected: Array, world_names: list[str]) -> Measurement:
    """Measure the largest difference of states, shape [T, world_count, body_count, 13], and name its world and body."""
    apart = np.abs(found - expected)
    _, world, body, column = np.unravel_index(int(apart.argmax()), apart.shape)
    part = "position" if column < 3 else "orientation" if column < 7 else "velocity"
    hint = f"{world_names[world]} differs most, in the {part} of the {NAMES[body]}"
    others = [
        other
        for other in range(apart.shape[1])
        if other != world
        and np.abs(found[:, world] - expected[:, other]).max() < 0.1 * apart.max()
    ]
    if others:
        hint += f": it has the values of {world_names[others[0]]}"
    return Measurement(measured=float(apart.max()), hint=hint)


LABELS = [f"world {number}" for number in range(WORLDS)]


@Check("worlds-single", scene=WHAT)
def _worlds_single(lab: Lab) -> Measurement:
    with closing(_built(lab, SCENES)) as worlds:
        worlds.reset(0)
        found = _course(worlds, 0, INTERVALS)
    return _difference(found, _alone(lab), LABELS)


@Check("worlds-reset", scene=WHAT)
def _worlds_reset(lab: Lab) -> Measurement:
    with closing(_built(lab, SCENES)) as worlds:
        worlds.reset(0)
        _course(worlds, 0, 30)
        worlds.reset(0)
        found = _course(worlds, 0, 30)
    return _difference(found, _alone(lab)[:30], LABELS)


@Check("worlds-restart", scene=WHAT)
def _worlds_restart(lab: Lab) -> Measurement:
    before, after, number = 30, 20, 1
    with closing(_built(lab, SCENES, restart_alone=True)) as worlds:
        worlds.reset(0)
        _course(worlds, 0, before)
        worlds.restart(number)
        rows = []
        for interval in range(after):
            motions = _motions(before + interval)
            motions[number] = _motions(interval)[number]
            worlds.drive("plate", motions, np.arange(WORLDS, dtype=np.intp))
            worlds.advance(SAMPLE_INTERVAL_S)
            rows.append(one_sign(np.array(worlds.body_states(list(NAMES)))))
    expected = np.array(_alone(lab)[before : before + after])
    expected[:, number] = _alone(lab)[:after, number]
    labels = [f"{one}, which goes on," for one in LABELS]
    labels[number] = f"{LABELS[number]}, which restarts,"
    return _difference(np.array(rows), expected, labels)


@Check(
    "worlds-record",
    scene="four worlds of a ball that drops on a slab, with other starts and constants each",
)
def _worlds_record(lab: Lab) -> Measurement:
    names = [one.name for one in STILL[0].bodies if one.motion is Motion.DYNAMIC]
    frames, samples = 10, 6
    with closing(_built(lab, STILL)) as worlds:
        if not worlds.can_record:
            raise DeclinedError(("the engine records nothing on a device",))
        worlds.reset(0)
        recording = worlds.record(
            names,
            frame_count=frames,
            samples=samples,
            interval_s=SAMPLE_INTERVAL_S,
        )
        kernels = recording.kernels
        positions, states = (
            np.array(one) if kernels is None else kernels.copied(one)
            for one in (recording.positions_m, recording.states)
        )
        worlds.reset(0)
        read = [np.array(worlds.body_states(names))]
        for _ in range((frames - 1) * samples):
            worlds.advance(SAMPLE_INTERVAL_S)
            read.append(np.array(worlds.body_states(names)))
    expected = np.array(read)
    if positions.shape != expected[..., :3].shape:
        hint = f"positions have the shape {positions.shape} instead of {expected[..., :3].shape}"
        return Measurement(measured=np.nan, hint=hint)
    apart = float(np.abs(positions - expected[..., :3]).max())
    of_frames = np.abs(one_sign(states) - one_sign(expected[::samples])).max()
    return Measurement(measured=max(apart, float(of_frames)))
