"""Batches of worlds: each world equals a single simulation with its initial state and prescribed motion."""

from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from gauge_envs.backends import LoopedSimulation, Simulation
from gauge_envs.backends.shared.resampled import ResampledSimulation
from gauge_envs.fixtures.parts import ball
from gauge_envs.fixtures.recording import UnsupportedError
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.states import nominal_states
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.conformance.lab import Lab, Measurement, largest, push, ratio
from gauge_envs.tools.conformance.model import COUNT, Checks, Level, Tolerance
from gauge_envs.tools.conformance.repeats import BITS_OR_RUN, gaps
from gauge_envs.tools.conformance.restart import (
    BOUNCE,
    CARRIED,
    HUNG,
    aside,
    cloths,
    shifted_states,
    widest,
)

check = Checks(Level.RIGID)


WORLDS = range(16)
SINGLES = (0, 1, 5, 10, 14, 15)
"""Worlds that are compared with single simulations; the reversed order has the same worlds."""
INTERVALS = 36
ALONE = Tolerance("single precision, in another order, over one rebound", absolute=1e-4)


def _rigid(lab: Lab) -> Scene:
    """Return a scene without contacts of boxes, whose many points enlarge each rounding."""
    return widest(lab, BOUNCE, CARRIED, HUNG)


def _initial_states(scene: Scene, numbers: Sequence[int]) -> FloatArray:
    """Return initial states, different for each world, shape [world_count, body_count, 13]."""
    return np.array([shifted_states(scene, number / len(WORLDS)) for number in numbers])


def _drive(
    simulation: Simulation, scene: Scene, numbers: Sequence[int], at: int
) -> None:
    """Drive the plates of worlds in interval `at`, each with another acceleration."""
    if not scene.drivers:
        return
    targets = np.zeros((len(numbers), 19))
    targets[:, :7] = nominal_states(scene)[-2 if scene.joints else -1, :7]
    rates, time_s = 6.5 + 0.1 * np.array(numbers), at * SAMPLE_INTERVAL_S
    targets[:, 0] += 0.5 * rates * time_s**2
    targets[:, 7], targets[:, 13] = rates * time_s, rates
    targets.flags.writeable = False
    simulation.drive("plate", targets)


def _read(simulation: Simulation, scene: Scene) -> FloatArray:
    """Return the states of the worlds, or the nodes of their cloth."""
    if scene.deformables:
        return np.array(simulation.nodes("cloth"))
    return np.array(simulation.body_states([body.name for body in scene.bodies]))


def _course(
    simulation: Simulation,
    scene: Scene,
    numbers: Sequence[int],
    initial_states: FloatArray | None = None,
    wrenches: FloatArray | None = None,
) -> FloatArray:
    """Run worlds from their initial states, under wrenches on the stick, and return the states after each interval."""
    simulation.reset(
        _initial_states(scene, numbers) if initial_states is None else initial_states, 0
    )
    if wrenches is not None:
        push(simulation, "stick", wrenches)
    rows = []
    for interval in range(12 if scene.deformables else INTERVALS):
        _drive(simulation, scene, numbers, interval)
        simulation.advance(SAMPLE_INTERVAL_S)
        rows.append(_read(simulation, scene))
    return np.array(rows)


@check(
    "worlds-shapes",
    title="arrays of worlds",
    law="shape = [N, ...], new arrays, inputs unchanged",
    tolerance=COUNT,
    cause="arrays have the world as first axis, and belong to the caller",
)
def worlds_shapes(lab: Lab) -> Measurement:
    """One and three worlds of a stick, a bouncing ball, one on a driven plate and a pendulum; and of cloth.

    Number of faults: shapes of what is returned, arrays that change later, arrays of starts that `reset` changes or
    needs later, a nominal start that not all worlds have, `diverged` that names healthy worlds; if the engine restarts
    single worlds, a restart that does not start its world or moves others.

    Source: contract (gauge_envs.backends.simulation).
    """
    faults = set()
    for scene in (_rigid(lab), *lab.once(cloths)):
        for count in (1, 3):
            with closing(lab.build(scene, count)) as simulation:
                is_whole = isinstance(simulation, ResampledSimulation)
                restarts = lab.backend.restarts_worlds and not is_whole
                is_right = _are_right(simulation, scene, count, restarts)
                faults |= {text for text, fine in is_right.items() if not fine}
    return Measurement(measured=len(faults), hint="; ".join(sorted(faults)))


def _are_right(
    simulation: Simulation, scene: Scene, count: int, restarts: bool
) -> dict[str, Any]:
    """Return whether each array of a simulation is right, by its fault; also after a restart of the first world."""
    names = [body.name for body in scene.bodies]
    initial_states = _initial_states(scene, range(count))
    given = initial_states.copy()
    simulation.reset(initial_states, 0)
    states = simulation.body_states(names)
    first = np.array(states)
    is_kept = np.array_equal(initial_states, given)
    initial_states[:] = np.nan
    _drive(simulation, scene, range(count), 0)
    simulation.advance(SAMPLE_INTERVAL_S)
    later, reasons = _read(simulation, scene), dict(simulation.diverged())
    simulation.reset(None, 0)
    nominal = _read(simulation, scene)
    is_right: dict[str, Any] = {
        f"world_count is {simulation.world_count}": simulation.world_count == count,
        f"body_states has shape {first.shape}": first.shape == (count, len(names), 13),
        f"an array has shape {later.shape}": len(later) == count and later.ndim == 3,
        "body_states returns an array that changes later": np.array_equal(
            states, first
        ),
        "reset() changes the array of starts": is_kept,
        "reset() keeps the array of starts": np.isfinite(later).all(),
        f"diverged() is {reasons}": not reasons,
        "worlds differ right after reset()": not np.ptp(nominal, 0).any(),
    }
    if restarts:
        simulation.reset(given, 0)
        start = _read(simulation, scene)
        _drive(simulation, scene, range(count), 0)
        simulation.advance(SAMPLE_INTERVAL_S)
        expected = [*start[:1], *_read(simulation, scene)[1:]]
        simulation.reset(given, 0, np.arange(count) == 0)
        is_equal = [*map(np.array_equal, _read(simulation, scene), expected)]
        is_right["reset(worlds) does not start its world"] = is_equal[0]
        is_right["reset(worlds) moves other worlds"] = all(is_equal[1:])
    return is_right


TOGETHER = "the world of start"
THREADS = "the simulation in threads of start"
AGAIN = "the reset world of start"
ALIKE = "worlds of one start"
Courses = dict[int, FloatArray]
"""States after each interval, by the number of the initial state."""


def _courses(simulation: Simulation, scene: Scene, numbers: Sequence[int]) -> Courses:
    """Return the course of each world of a simulation."""
    courses = _course(simulation, scene, numbers)
    return {number: courses[:, world] for world, number in enumerate(numbers)}


def _batches(lab: Lab) -> list[tuple[Scene, Courses, dict[str, Courses]]]:
    """Return two scenes, the courses of single simulations, and those of each kind of batch."""
    batches = []
    for scene in (_rigid(lab), *lab.once(cloths)):
        runs = {}
        compared = SINGLES[:3] if scene.deformables else SINGLES
        worlds = compared if scene.deformables else WORLDS
        singles: Courses = {}
        with closing(lab.build(scene)) as simulation:
            for number in compared:
                singles |= _courses(simulation, scene, [number])
            if simulation.releases_gil:
                copies = [lab.build(scene) for _ in SINGLES]
                with closing(LoopedSimulation(copies)) as threaded:
                    runs[THREADS] = _courses(threaded, scene, SINGLES)
        with closing(lab.build(scene, len(worlds))) as batch:
            runs[TOGETHER] = _courses(batch, scene, worlds)
            runs[AGAIN] = _courses(batch, scene, worlds[::-1])
            alike = _course(batch, scene, [compared[1]] * len(worlds))
            runs[ALIKE] = dict(enumerate(np.moveaxis(alike, 1, 0)))
        batches.append((scene, singles, runs))
    return batches


def _gap(here: FloatArray, there: FloatArray) -> FloatArray:
    """Return differences of states or nodes; a value that is not finite differs by 1e9."""
    gap = gaps(here, there) if here.shape[-1] == 13 else np.abs(here - there)
    return np.nan_to_num(gap, nan=1e9, posinf=1e9)


def _first_gap(scene: Scene, gap: FloatArray, limit: float = ALONE.absolute) -> str:
    """Return the first interval with a difference, and the body that differs most in it."""
    is_off = (gap > limit).reshape(len(gap), -1).any(axis=1)
    interval = int(is_off.argmax())
    row = int(gap[interval].max(axis=-1).argmax())
    name = "cloth" if scene.deformables else scene.bodies[row].name
    return f"first the {name} in interval {interval + 1}"


def _compared(lab: Lab, *kinds: str) -> Measurement:
    """Measure the largest difference of courses from single simulations, and name its world, body and interval."""
    errors = {}
    mistakes = {}
    for scene, singles, runs in lab.once(_batches):
        for kind, number in product(kinds, singles):
            if kind not in runs:
                continue
            course = runs[kind][number]
            gap = _gap(course, singles[number])
            case = f"{kind} {number}, {_first_gap(scene, gap)},"
            errors[case] = float(gap.max())
            mistakes[case] = {
                f"it has the course of start {twin}": float(_gap(course, single).max())
                for twin, single in singles.items()
            }
    return largest(errors, "", mistakes)


@check(
    "worlds-single",
    title="a world of a batch is a single simulation",
    law="a world is that of its start and of its driven motion",
    tolerance=ALONE,
    cause="worlds have the start or the driven motion of another world, or one step for all is another step",
    revision=2,
)
def worlds_single(lab: Lab) -> Measurement:
    """16 worlds of a stick, a bouncing ball, one on a driven plate and a pendulum; and of falling sheets of cloth.

    Largest difference of a state or node within 0.2 s from single simulations; the worlds start and move differently.
    Simulations of engines with `releases_gil` also advance in threads at once. Worlds that start and move alike must
    be equal to the last bit, unless `Backend.repeatability` is `statistical`.

    Source: contract (Backend.build_worlds, Simulation.reset, Simulation.drive).
    """
    measurement = _compared(lab, TOGETHER, THREADS)
    repeats = lab.backend.repeatability(lab.settings).kind in BITS_OR_RUN
    if not repeats or not measurement.measured <= ALONE.absolute:
        return measurement
    errors = {}
    for scene, _, runs in lab.once(_batches):
        first = runs[ALIKE][0]
        for world, course in runs[ALIKE].items():
            gap = _gap(course, first)
            case = f"world {world}, which starts and moves as world 0, {_first_gap(scene, gap, 0.0)},"
            errors[case] = float(gap.max())
    unequal = replace(largest(errors), width=0.0)
    return unequal if unequal.measured else measurement


@check(
    "worlds-reset",
    title="reset of all worlds to other starts",
    law="a world is that of its start and of its driven motion",
    tolerance=ALONE,
    cause="reset(starts) must write the starts of all worlds, and forget their contacts, forces and earlier starts",
)
def worlds_reset(lab: Lab) -> Measurement:
    """The worlds of `worlds-single` after 0.2 s, reset to their starts in the reversed order.

    Largest difference of a state or node within 0.2 s after the reset from single simulations.

    Source: contract (Backend.build_worlds, Simulation.reset, Simulation.drive).
    """
    return _compared(lab, AGAIN)


WRENCH = ("force x", "force y", "force z", "torque x", "torque y", "torque z")


@check(
    "worlds-wrench",
    title="a wrench in each world",
    law="v = F t / m, w = M t / I",
    tolerance=Tolerance("a constant force has no model error", relative=1e-3),
    cause="worlds have the wrench of another world or of another call, or lose it",
    optional=True,
)
def worlds_wrench(lab: Lab) -> Measurement:
    """16 worlds of a floating ball, each under three wrenches in turn, all different.

    Gain of velocity or spin in ten intervals over force times time through mass, or torque times time through moment of
    inertia, in the world and call that are farthest off.

    Source: Newton, Euler; contract (Simulation.apply_wrench).
    """
    floating = ball("ball", (0.0, 0.0, 0.0))
    inertia = 0.4 * floating.mass_kg * 0.03**2
    scene = Scene(bodies=(floating,), duration_s=0.5, gravity_m_per_s2=0.0)
    sizes = np.random.default_rng(0).uniform(0.5, 1.5, (3, len(WORLDS), 6))
    wrenches = sizes * np.repeat([0.2, 1e-4], 3)
    speeds = [np.zeros((len(WORLDS), 6))]
    with lab.running(scene, len(WORLDS)) as simulation:
        for rows in wrenches:
            push(simulation, "ball", rows)
            for _ in range(10):
                simulation.advance(SAMPLE_INTERVAL_S)
            speeds.append(_read(simulation, scene)[:, 0, 7:])
    laws = wrenches * 10 * SAMPLE_INTERVAL_S
    laws /= np.repeat([floating.mass_kg, inertia], 3)
    ratios = {}
    for (call, world, axis), share in np.ndenumerate(np.diff(speeds, axis=0) / laws):
        part = WRENCH[axis]
        ratios[f"the {part} of call {call + 1} in world {world}"] = float(share)
    return ratio(ratios, "the gain of velocity")


@check(
    "worlds-neighbours",
    title="worlds do not feel their neighbours",
    law="a world is that of its start and of its driven motion",
    tolerance=ALONE,
    cause="worlds share forces, contacts, solver steps or a limit of their number",
)
def worlds_neighbours(lab: Lab) -> Measurement:
    """Five worlds, of which the first, third and fifth change what they do: start, motion, wrench, and divergence.

    Largest difference of a state of the second and fourth world within 0.2 s from the run before these changes.

    Source: contract (Backend.build_worlds, Simulation.diverged).
    """
    scene, numbers = _rigid(lab), range(5)
    watched, changed = [1, 3], [0, 2, 4]
    wrenches, fast = np.zeros((5, 6)), _initial_states(scene, numbers)
    wrenches[changed] = [0.3, -0.2, 0.4, 0.001, 0.002, -0.003]
    fast[changed, 0, 7] = 1e12
    cases: dict[str, tuple[Any, ...]] = {
        # Numbers of initial states, other initial states, and wrenches on the stick.
        "start and move otherwise": ((9, 1, 11, 3, 13),),
        "are pushed": (numbers, None, wrenches),
        "diverge": (numbers, fast),
        "have diverged": (numbers,),
    }
    errors, mistakes = {}, {}
    with aside(), lab.running(scene, 5) as five:
        before = _course(five, scene, numbers)[:, watched]
        for what, run in cases.items():
            with suppress(UnsupportedError):
                courses = _course(five, scene, *run)[:, watched]
                case = f"world 1 or 3, where worlds 0, 2 and 4 {what},"
                errors[case] = float(_gap(courses, before).max())
                if not five.diverged().keys().isdisjoint(watched):
                    errors[case] = 1e9
                    mistakes[case] = {"diverged() names it": 0.0}
    return largest(errors, "", mistakes)
