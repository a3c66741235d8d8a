"""Batches of worlds: each world equals a single simulation with its initial state and prescribed motion."""

from collections.abc import Sequence
from contextlib import closing, suppress
from itertools import product
from typing import Any

import numpy as np

from gauge_envs.backends import LoopedSimulation, Simulation
from gauge_envs.fixtures.parts import ball
from gauge_envs.fixtures.recording import UnsupportedError
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.states import nominal_states
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.conformance.lab import Lab, Measurement, largest, push
from gauge_envs.tools.conformance.model import COUNT, Tolerance, check
from gauge_envs.tools.conformance.restart import (
    BOUNCE,
    CARRIED,
    HUNG,
    aside,
    cloths,
    gaps,
    shifted_states,
    widest,
)

WORLDS = range(16)
SINGLES = (0, 1, 5, 10, 14, 15)
"""Worlds that are compared with single simulations; the reversed order has the same worlds."""
INTERVALS = 36
ALONE = Tolerance("single precision, in another order, over one rebound", absolute=1e-4)
BATCH = "contract (Backend.build_worlds, Simulation.reset, Simulation.drive)"


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
    source="contract (gauge_envs.backends.simulation)",
    tolerance=COUNT,
    cause="arrays have the world as first axis, and belong to the caller",
)
def worlds_shapes(lab: Lab) -> Measurement:
    """One and three worlds of a stick, a bouncing ball, one on a driven plate and a pendulum; and of cloth.

    Number of faults: shapes of what is returned, arrays that change later, arrays of starts that `reset` changes or
    needs later, a nominal start that not all worlds have, `diverged` that names healthy worlds.
    """
    faults: dict[str, None] = {}
    for scene in (_rigid(lab), *lab.once(cloths)):
        names = [body.name for body in scene.bodies]
        for count in (1, 3):
            initial_states = _initial_states(scene, range(count))
            given = initial_states.copy()
            with closing(lab.build(scene, count)) as simulation:
                simulation.reset(initial_states, 0)
                states = simulation.body_states(names)
                first, unchanged = (
                    np.array(states),
                    np.array_equal(initial_states, given),
                )
                initial_states[:] = np.nan
                _drive(simulation, scene, range(count), 0)
                simulation.advance(SAMPLE_INTERVAL_S)
                later, reasons = _read(simulation, scene), dict(simulation.diverged())
                simulation.reset(None, 0)
                nominal = _read(simulation, scene)
                right = {
                    f"world_count is {simulation.world_count}": simulation.world_count
                    == count,
                    f"body_states has shape {first.shape}": first.shape
                    == (count, len(names), 13),
                    f"an array has shape {later.shape}": later.shape
                    == (count, *later.shape[-2:]),
                    "body_states returns an array that changes later": np.array_equal(
                        states, first
                    ),
                    "reset() changes the array of starts": unchanged,
                    "reset() keeps the array of starts": np.isfinite(later).all(),
                    f"diverged() is {reasons}": not reasons,
                    "worlds differ right after reset()": not np.ptp(nominal, 0).any(),
                }
            faults |= {text: None for text, fine in right.items() if not fine}
    return Measurement(measured=len(faults), hint="; ".join(faults))


TOGETHER, THREADS, AGAIN = "world", "in threads simulation", "after the reset world"
Runs = dict[str, tuple[Sequence[int], FloatArray]]
"""Kind of run -> numbers of the initial states, and courses, shape [interval_count, world_count, ...]."""


def _batches(lab: Lab) -> list[tuple[Scene, dict[int, FloatArray], Runs]]:
    """Return scenes, the courses of single simulations by number of their initial state, and the courses of batches."""
    batches = []
    for scene in (_rigid(lab), *lab.once(cloths)):
        runs: Runs = {}
        worlds = SINGLES[:3] if scene.deformables else WORLDS
        with closing(lab.build(scene)) as simulation:
            singles = {
                n: _course(simulation, scene, [n])[:, 0] for n in SINGLES if n in worlds
            }
            if simulation.releases_gil:
                with closing(
                    LoopedSimulation([lab.build(scene) for _ in SINGLES])
                ) as threaded:
                    runs[THREADS] = SINGLES, _course(threaded, scene, SINGLES)
        with closing(lab.build(scene, len(worlds))) as batch:
            for what, numbers in ((TOGETHER, worlds), (AGAIN, worlds[::-1])):
                runs[what] = numbers, _course(batch, scene, numbers)
        batches.append((scene, singles, runs))
    return batches


def _gap(here: FloatArray, there: FloatArray) -> FloatArray:
    """Return differences of states or nodes; a value that is not finite differs by 1e9."""
    gap = gaps(here, there) if here.shape[-1] == 13 else np.abs(here - there)
    return np.nan_to_num(gap, nan=1e9, posinf=1e9)


def _compared(lab: Lab, *kinds: str) -> Measurement:
    """Measure the largest difference of courses from single simulations, and name its world, body and interval."""
    worst = Measurement(measured=0.0)
    for scene, singles, runs in lab.once(_batches):
        for what, number in product(kinds, singles):
            if what not in runs:
                continue
            numbers, courses = runs[what]
            here = courses[:, numbers.index(number)]
            gap = _gap(here, singles[number])
            if gap.max() <= worst.measured:
                continue
            hint = f"{what} {numbers.index(number)} differs by {gap.max():.3g}"
            when = int(
                (gap > ALONE.absolute).reshape(len(gap), -1).any(axis=1).argmax()
            )
            body = int(gap[when].max(axis=-1).argmax())
            name = "cloth" if scene.deformables else scene.bodies[body].name
            hint += f", first the {name} in interval {when + 1}"
            for twin, course in singles.items():
                if twin != number and _gap(here, course).max() < 0.01 * gap.max():
                    hint += f"; it has the course of world {numbers.index(twin)}"
            worst = Measurement(measured=float(gap.max()), hint=hint)
    return worst


@check(
    "worlds-single",
    title="a world of a batch is a single simulation",
    law="a world is that of its start and of its driven motion",
    source=BATCH,
    tolerance=ALONE,
    cause="worlds have the start or the driven motion of another world, or one step for all is another step",
)
def worlds_single(lab: Lab) -> Measurement:
    """16 worlds of a stick, a bouncing ball, one on a driven plate and a pendulum; and of falling sheets of cloth.

    Largest difference of a state or node within 0.2 s from single simulations; the worlds start and move differently.
    Simulations of engines with `releases_gil` also advance in threads at once.
    """
    return _compared(lab, TOGETHER, THREADS)


@check(
    "worlds-reset",
    title="reset of all worlds to other starts",
    law="a world is that of its start and of its driven motion",
    source=BATCH,
    tolerance=ALONE,
    cause="reset(starts) must write the starts of all worlds, and forget their contacts, forces and earlier starts",
)
def worlds_reset(lab: Lab) -> Measurement:
    """The worlds of `worlds-single` after 0.2 s, reset to their starts in the reversed order.

    Largest difference of a state or node within 0.2 s after the reset from single simulations.
    """
    return _compared(lab, AGAIN)


@check(
    "worlds-wrench",
    title="a wrench in each world",
    law="v = F t / m, w = M t / I",
    source="Newton, Euler; contract (Simulation.apply_wrench)",
    tolerance=Tolerance("a constant force has no model error", relative=1e-3),
    cause="worlds have the wrench of another world or of another call, or lose it",
    optional=True,
)
def worlds_wrench(lab: Lab) -> Measurement:
    """16 worlds of a floating ball, each under three wrenches in turn, all different.

    Gain of velocity or spin in ten intervals over force times time through mass, or torque times time through moment of
    inertia, in the world and call that are farthest off.
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
    gains = np.diff(speeds, axis=0)
    expected = wrenches * 10 * SAMPLE_INTERVAL_S
    expected /= np.repeat([floating.mass_kg, inertia], 3)
    ratios = gains / expected
    errors = np.nan_to_num(np.abs(ratios - 1.0), nan=np.inf)
    call, world, axis = np.unravel_index(errors.argmax(), errors.shape)
    what, part = ("force", slice(3)) if axis < 3 else ("torque", slice(3, 6))
    ratio = float(ratios[call, world, axis])
    hint = f"{ratio:.3g} times the {what} of call {call + 1} acts in world {world}"
    alike = np.isclose(expected[..., part], gains[call, world, part], rtol=5e-3)
    for other_call, other_world in np.argwhere(alike.all(axis=-1)):
        hint += f"; it is that of call {other_call + 1} in world {other_world}"
    return Measurement(measured=ratio, expected=1.0, hint=hint)


@check(
    "worlds-neighbours",
    title="worlds do not feel their neighbours",
    law="a world is that of its start and of its driven motion",
    source="contract (Backend.build_worlds, Simulation.diverged)",
    tolerance=ALONE,
    cause="worlds share forces, contacts, solver steps or a limit of their number",
)
def worlds_neighbours(lab: Lab) -> Measurement:
    """Five worlds, of which the first, third and fifth change what they do: start, motion, wrench, and divergence.

    Largest difference of a state of the second and fourth world within 0.2 s from the run before these changes.
    """
    scene, numbers = _rigid(lab), range(5)
    watched, changed = [1, 3], [0, 2, 4]
    wrenches, fast = np.zeros((5, 6)), _initial_states(scene, numbers)
    wrenches[changed] = [0.3, -0.2, 0.4, 0.001, 0.002, -0.003]
    fast[changed, 0, 7] = 1e12
    cases: tuple[tuple[str, Sequence[int], Any, Any], ...] = (
        ("are as before", numbers, None, None),
        ("start and move otherwise", (9, 1, 11, 3, 13), None, None),
        ("are pushed", numbers, None, wrenches),
        ("diverge", numbers, fast, None),
        ("have diverged", numbers, None, None),
    )
    results = {}
    with aside(), lab.running(scene, 5) as five:
        for what, *how in cases:
            with suppress(UnsupportedError):
                courses = _course(five, scene, *how)[:, watched]
                if what == "are as before":
                    before = courses
                is_lost = not five.diverged().keys().isdisjoint(watched)
                gap = 1e9 if is_lost else float(_gap(courses, before).max())
                text = f"world 1 or 3, where worlds 0, 2 and 4 {what},"
                left = 0.0 if is_lost else gap
                results[text] = {"": gap, "diverged() names it": left}
    return largest(results)
