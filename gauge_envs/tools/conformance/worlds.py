"""Initial states as arrays, and many worlds at once: each world of a batch is the single simulation of its start.

The worlds differ in starts, driven motion and wrenches; they have the constants of one scene.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np

from gauge_envs.backends.base import scene_support
from gauge_envs.backends.shared.resampled import in_intervals
from gauge_envs.backends.simulation import Simulation
from gauge_envs.scene import Hinge, Pose, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.jitter import turn
from gauge_envs.scene.states import nominal_states, scene_at
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.bench.parts import (
    ball,
    box,
    contact,
    driven_box,
    driver,
    fixed_box,
    ground,
    ramp,
)
from gauge_envs.tools.bench.recording import DeclinedError, Recording, record
from gauge_envs.tools.conformance.contract import one_sign, parts_apart
from gauge_envs.tools.conformance.differences import LEAST, cause_of, cause_of_told
from gauge_envs.tools.conformance.lab import LIGHT_FABRIC, Lab, push, sheet
from gauge_envs.tools.conformance.model import Check, Measurement, Recorded

WORLDS = 16
SINGLES = (0, 1, 7, 15)
"""Worlds that are compared with single simulations."""
NAMES = ("ball", "brick", "plate")
INTERVALS = 42
PLATE_M = (0.0, 0.0, 0.5)


def _scene() -> Scene:
    """Return a ball that drops on a slab, and a brick on a driven plate."""
    return Scene(
        bodies=(
            replace(ball("ball", (0.5, 0.0, 0.13)), mass_kg=0.2),
            replace(box("brick", (0.0, 0.0, 0.525), (0.06, 0.05, 0.03)), mass_kg=0.3),
            fixed_box("slab", (0.5, 0.0, -0.05), (2.0, 2.0, 0.1)),
            driven_box("plate", PLATE_M, (0.6, 0.4, 0.02)),
        ),
        contacts=(
            contact("ball", "slab", friction=0.3, restitution=0.5),
            # The plate is faster than friction can carry the brick, so that it slides in each world.
            contact("brick", "plate", friction=0.3),
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


def _starts(world_count: int) -> FloatArray:
    """Return initial states of worlds, of which neighbours differ most, shape [world_count, 4, 13]."""
    numbers = np.arange(world_count)
    shares = 0.25 * (numbers % 4) + numbers / 256
    starts = np.tile(nominal_states(_scene()), (world_count, 1, 1))
    starts[:, 0, 0] += 0.03 * shares
    starts[:, 0, 2] += 0.06 * shares
    starts[:, 0, 7], starts[:, 0, 8] = 0.6 * shares, 0.1
    starts[:, 1, 0] += 0.06 * shares
    return starts


def _targets(world_count: int, interval: int) -> FloatArray:
    """Return the motion of the plates in an interval, shape [world_count, 19]."""
    rates = 6.5 + 0.2 * (np.arange(world_count) % 4)
    time_s = interval * SAMPLE_INTERVAL_S
    targets = np.zeros((world_count, 19))
    targets[:, :3] = PLATE_M
    targets[:, 0] += 0.5 * rates * time_s**2
    targets[:, 3] = 1.0
    targets[:, 7], targets[:, 13] = rates * time_s, rates
    return targets


def _built(lab: Lab, scene: Scene, world_count: int = WORLDS) -> Simulation:
    """Build a scene in worlds."""
    support = scene_support(lab.backend, scene)
    if not support:
        raise DeclinedError(support.missing)
    started = lab.started(scene)
    built = lab.backend.build_worlds(started, world_count, lab.settings)
    return in_intervals(built, started)


def _course(simulation: Simulation, starts: FloatArray, targets: slice) -> FloatArray:
    """Return states after each interval, shape [INTERVALS, N, body_count, 13].

    Args:
        simulation: The worlds.
        starts: Their initial states.
        targets: Slice of the worlds of `_targets`.
    """
    simulation.reset(starts, 0)
    rows = []
    for interval in range(INTERVALS):
        simulation.drive("plate", _targets(WORLDS, interval)[targets])
        simulation.advance(SAMPLE_INTERVAL_S)
        rows.append(one_sign(np.array(simulation.body_states(NAMES))))
    return np.array(rows)


def _single(lab: Lab, world: int) -> FloatArray:
    """Return the states of a world alone, shape [INTERVALS, body_count, 13]."""
    part = slice(world, world + 1)
    with closing(lab.build(_scene())) as simulation:
        return _course(simulation, _starts(WORLDS)[part], part)[:, 0]


def _twice(lab: Lab) -> tuple[FloatArray, FloatArray]:
    """Return the states of worlds, and those after another reset in the order of other starts."""
    starts = _starts(WORLDS)
    with closing(_built(lab, _scene())) as simulation:
        before = _course(simulation, starts, slice(None))
        _course(simulation, starts[::-1].copy(), slice(None, None, -1))
        return before, _course(simulation, starts, slice(None))


_together = Recorded("", _twice)
WHAT = "16 worlds of a ball that drops on a slab and a brick on a driven plate, each with another start and motion"


def _compared(lab: Lab, found: FloatArray) -> Measurement:
    """Measure the largest difference from single simulations, and find what explains it."""
    laws = {world: _single(lab, world) for world in SINGLES}
    apart = {
        world: float(np.abs(found[:, world] - law).max()) for world, law in laws.items()
    }
    worst = max(apart, key=lambda world: apart[world])
    differences = found[:, worst] - laws[worst]
    parts: dict[str, float] = {}
    for column, name in enumerate(NAMES):
        parts |= parts_apart(differences[:, column], name)
    cause = ""
    if apart[worst] >= LEAST:
        others = {world: law for world, law in laws.items() if world != worst}
        cause = cause_of(found[:, worst], laws[worst], others, found.mean(axis=1))
    return Measurement(
        measured=apart[worst],
        hint=f"world {worst} differs most",
        cause=cause,
        parts=parts,
    )


@Check("worlds-single", scene=WHAT)
def _worlds_single(lab: Lab) -> Measurement:
    return _compared(lab, _together(lab)[0])


@Check("worlds-reset", scene=WHAT)
def _worlds_reset(lab: Lab) -> Measurement:
    return _compared(lab, _together(lab)[1])


PUSH_N, PUSHED = 0.2, 30
"""Force [N], and number of intervals."""


@Check("worlds-wrench", scene="16 worlds of a free brick, each with another force")
def _worlds_wrench(lab: Lab) -> Measurement:
    brick = replace(box("brick", (0.0, 0.0, 0.0), (0.06, 0.05, 0.03)), mass_kg=0.2)
    scene = Scene(
        bodies=(brick,),
        duration_s=PUSHED * SAMPLE_INTERVAL_S,
        gravity_m_per_s2=0.0,
    )
    forces_n = PUSH_N * (1.0 + np.arange(WORLDS, dtype=np.float64) % 5)
    wrenches = np.zeros((WORLDS, 6))
    wrenches[:, 1] = forces_n
    speeds = []
    with closing(_built(lab, scene)) as simulation:
        simulation.reset(None, 0)
        for _ in range(PUSHED):
            push(simulation, "brick", wrenches)
            simulation.advance(SAMPLE_INTERVAL_S)
            speeds.append(np.array(simulation.body_states(["brick"]))[:, 0, 8])
    gains = forces_n / brick.mass_kg * SAMPLE_INTERVAL_S
    shares = np.diff(speeds, axis=0, prepend=np.zeros((1, WORLDS))) / gains
    ratios = shares.mean(axis=0)
    world = int(np.abs(ratios - 1.0).argmax())
    return Measurement(
        measured=float(ratios[world]),
        expected=1.0,
        hint=f"in world {world}",
        cause=cause_of_told({"force": np.asarray(forces_n, dtype=np.float64)}, shares),
    )


# --- initial states ---------------------------------------------------------------------------------------------------


def _from_states(
    lab: Lab, scene: Scene, states: FloatArray, seconds: float
) -> Recording:
    """Return the recording of a scene that starts from states, after a run from the nominal start."""
    with closing(lab.build(scene)) as simulation:
        record(simulation, scene, 0.1)
        simulation.reset(states[None], 0)
        return record(simulation, scene, seconds)


def _apart(found: Recording, expected: Recording) -> Measurement:
    """Measure the largest difference of two recordings in any state or node."""
    parts: dict[str, float] = {}
    for name, states in found.states.items():
        parts |= parts_apart(one_sign(states) - one_sign(expected.states[name]), name)
    for name, nodes_m in found.nodes_m.items():
        apart_m = np.abs(nodes_m - expected.nodes_m[name])
        parts[f"nodes of the {name}"] = float(apart_m.max())
    worst = max(parts, key=lambda name: parts[name])
    return Measurement(
        measured=parts[worst], hint=f"largest in the {worst}", parts=parts
    )


def _started_elsewhere(lab: Lab, scene: Scene, states: FloatArray) -> Measurement:
    """Measure how a run from given states differs from one of a scene that is built with them."""
    expected = lab.rollout(scene_at(scene, states), 0.2)
    return _apart(_from_states(lab, scene, states, 0.2), expected)


@Check("starts-free", scene="a thrown, spinning brick and a ball that drops on a plane")
def _starts_free(lab: Lab) -> Measurement:
    scene = Scene(
        bodies=(
            box("brick", (0.0, 0.0, 1.0), (0.06, 0.05, 0.03)),
            ball("ball", (0.5, 0.0, 0.2)),
            # Some engines derive constants from the longest fall, so this ball starts as the scene says.
            ball("high ball", (1.0, 0.0, 3.0)),
            ground(),
        ),
        contacts=(contact("ball", "ground", friction=0.3, restitution=0.5),),
        duration_s=0.5,
    )
    states = nominal_states(scene)
    turn(states[0], np.array([0.4, -0.3, 0.8]), states[0, :3].copy())
    states[0, :3] += [0.1, -0.2, 0.05]
    states[0, 7:] = [0.5, 0.2, -0.1, 3.0, -2.0, 1.0]
    states[1, :3] += [0.02, 0.03, -0.06]
    states[1, 7:10] = [0.3, 0.0, -0.4]
    return _started_elsewhere(lab, scene, states)


@Check("starts-hinge", scene="a brick on a hinge")
def _starts_hinge(lab: Lab) -> Measurement:
    anchor_m, axis = (0.0, 0.0, 2.0), (0.0, 1.0, 0.0)
    scene = Scene(
        bodies=(box("brick", (0.3, 0.0, 1.9), (0.1, 0.06, 0.03)),),
        joints=(Hinge(body="brick", anchor_m=anchor_m, axis=axis),),
        duration_s=0.5,
    )
    states = nominal_states(scene)
    spin = -1.5 * np.array(axis)
    turn(states[0], 0.7 * np.array(axis), np.array(anchor_m))
    states[0, 7:10] = np.cross(spin, states[0, :3] - anchor_m)
    states[0, 10:] = spin
    return _started_elsewhere(lab, scene, states)


@Check("starts-cloth", scene="a sheet of cloth in free fall, and a brick beside it")
def _starts_cloth(lab: Lab) -> Measurement:
    pose = Pose(position_m=(0.0, 0.0, 1.0))
    scene = Scene(
        bodies=(box("brick", (0.5, 0.0, 1.0), (0.06, 0.05, 0.03)),),
        deformables=(sheet(LIGHT_FABRIC, pose, (0.12, 0.09)),),
        duration_s=0.5,
    )
    states = nominal_states(scene)
    turn(states[1], np.array([0.0, 0.3, 0.4]), states[1, :3].copy())
    states[1, :3] += [0.05, -0.02, 0.03]
    return _started_elsewhere(lab, scene, states)
