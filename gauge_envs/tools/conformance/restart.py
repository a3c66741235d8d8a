"""The life of a simulation: restart, initial states, recovery from a failure, and a second process."""

import ctypes
import os
from collections.abc import Iterator, Mapping
from contextlib import chdir, closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from gauge_envs.backends import Simulation, backend as find_backend
from gauge_envs.errors import GaugeError
from gauge_envs.fixtures.parts import (
    ball,
    body,
    box,
    contact,
    driven_box,
    driver,
    ground,
    ramp,
    thrown,
)
from gauge_envs.fixtures.recording import (
    DivergedError,
    Recording,
    UnsupportedError,
    record,
)
from gauge_envs.runs.workers import Worker
from gauge_envs.scene import Hinge, Pose, RigidBody, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.jitter import rotate
from gauge_envs.scene.states import nominal_states, scene_at
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.conformance.cloth import LIGHT_FABRIC
from gauge_envs.tools.conformance.deformable import sheet
from gauge_envs.tools.conformance.free_motion import SOLIDS
from gauge_envs.tools.conformance.lab import Lab, Measurement, push
from gauge_envs.tools.conformance.model import EXACT, Checks, Level, Tolerance
from gauge_envs.tools.conformance.repeats import (
    BITS,
    RUN_S,
    apart,
    gaps,
    largest_gap,
    repeated,
    run_again,
)

check = Checks(Level.RIGID)


REPEATED = Tolerance(
    "bit for bit, or poses to 1000 times the start error of Backend.repeatability"
)
STARTED = Tolerance("single precision, over one rebound", absolute=1e-4)
SAME: dict[str, Any] = {
    "law": "same starts and seed, same trajectory",
    "tolerance": REPEATED,
}
ANCHOR_M, AXIS = np.array([0.0, 1.5, 1.0]), np.array([0.6, 0.0, 0.8])
LEANING = (20.0, 50.0, -100.0)
BRICK_M = (0.1, 0.06, 0.03)
STICK = thrown(
    box("stick", (1.5, 0.0, 1.0), BRICK_M, euler_deg=LEANING),
    (0.5, -0.3, 0.2),
    (2, 5, -3),
)
BOUNCE: dict[str, Any] = {
    "bodies": (
        thrown(ball("ball", (0.5, 0.0, 0.1)), (0.2, 0.1, -0.5), (3, -4, 2)),
        # Some engines derive constants from the longest fall, so this ball always starts as the scene says.
        ball("high", (-1.0, 0.0, 3.0)),
        ground(),
    ),
    "contacts": (contact(("ball", "high"), "ground", friction=0.3, restitution=0.5),),
}
CARRIED: dict[str, Any] = {
    "bodies": (
        ball("rider", (0.0, 0.0, 0.54)),
        driven_box("plate", (0.0, 0.0, 0.5), (0.6, 0.4, 0.02)),
    ),
    "contacts": (contact("rider", "plate", friction=0.1),),
    "drivers": (
        driver(
            "plate",
            "translate",
            (1.0, 0.0, 0.0),
            ramp(0.3, start_s=0.0, duration_s=0.5, ramp_s=0.1),
        ),
    ),
}
HUNG: dict[str, Any] = {
    "bodies": (box("bob", (0.2, 1.5, 0.9), BRICK_M, euler_deg=LEANING),),
    "joints": (Hinge(body="bob", anchor_m=(0.0, 1.5, 1.0), axis=(0.6, 0.0, 0.8)),),
}


TUMBLING: dict[str, Any] = {
    "bodies": (
        thrown(
            box("brick", (0.0, -1.0, 0.1), BRICK_M, euler_deg=LEANING), (0.1, 0.2, -0.3)
        ),
    ),
    "contacts": (contact("brick", "ground", friction=0.4, restitution=0.4),),
}


RESTING = Scene(
    bodies=(box("block", (0.0, 0.0, 0.015), BRICK_M), ground()),
    contacts=(contact("block", "ground", friction=0.4),),
    duration_s=0.5,
)
"""A block at rest, whose contacts bear forces when a run ends."""


def widest(lab: Lab, *parts: Mapping[str, Any]) -> Scene:
    """Return a scene with a thrown stick and all parts that the engine can build."""
    scene = lab.in_any_shape(Scene(bodies=(STICK,), duration_s=0.5))
    for part in parts:
        more = {key: getattr(scene, key) + value for key, value in part.items()}
        wider = replace(scene, **more)
        scene = wider if lab.supports(wider) else scene
    return scene


def lively(lab: Lab) -> Scene:
    """Return a thrown stick, balls that bounce and ride on a driven plate, a pendulum, and a brick that tumbles."""
    return widest(lab, BOUNCE, CARRIED, HUNG, TUMBLING)


CLOTH = Scene(
    bodies=(ground(),),
    deformables=(
        sheet(
            LIGHT_FABRIC,
            Pose.from_euler_deg((0.5, 0.0, 0.04), (0.0, 10.0, 20.0)),
            (0.12, 0.09),
        ),
    ),
    contacts=(contact("cloth", "ground", friction=0.4),),
    duration_s=0.5,
)
"""A sheet of cloth that falls on a plane."""


def cloths(lab: Lab) -> list[Scene]:
    """Return the scene with cloth if the engine can run it. Use it with `Lab.once`."""
    with suppress(UnsupportedError, DivergedError):
        lab.rollout(CLOTH, RUN_S)
        return [CLOTH]
    return []


def shifted_states(scene: Scene, share: float) -> FloatArray:
    """Return initial states [body_count, 13] whose distance from the nominal states grows with a share of 0 to 1."""
    states = nominal_states(scene)
    free = {item.name for item in (*scene.dynamic_bodies, *scene.deformables)}
    free.discard("high")
    for row, item in zip(states, (*scene.bodies, *scene.deformables), strict=True):
        if item.name in scene.hinges:
            rotate(row, 0.7 * share * AXIS, ANCHOR_M)
            row[10:] = -1.5 * share * AXIS
            row[7:10] = np.cross(row[10:], row[:3] - ANCHOR_M)
        elif item.name in free:
            rotate(row, share * np.array([0.4, -0.3, 0.8]), row[:3].copy())
            row[:3] += share * np.array([0.03, -0.02, 0.04])
            if isinstance(item, RigidBody):
                row[7:] += share * np.array([0.5, 0.2, -0.1, 3.0, -2.0, 1.0])
    return states


def _use(simulation: Simulation, scene: Scene, seed: int) -> None:
    """Run a simulation from other initial states, under a wrench if the engine can apply wrenches."""
    simulation.reset(shifted_states(scene, 1.0)[None], seed)
    for item in scene.bodies:
        if item.name in ("stick", "brick"):
            with suppress(UnsupportedError):
                push(simulation, item.name, [0.3, -0.2, 0.4, 0.001, 0.002, -0.003])
    record(simulation, scene, 0.1)


SEEDS = (0, 1, 2, 0, 1)


def _again(lab: Lab) -> list[tuple[Recording, list[Recording]]]:
    """Return the states of scenes before their first reset, and their runs with `SEEDS`."""
    many = []
    scenes = (lively(lab), *filter(lab.supports, [RESTING]), *lab.once(cloths))
    for scene in scenes:
        runs: list[Recording] = []
        with closing(lab.build(scene)) as simulation:
            built = record(simulation, scene, 0.0)
            for seed in SEEDS:
                if len(runs) > 1:
                    _use(simulation, scene, seed + 1)
                simulation.reset(None, seed)
                runs.append(record(simulation, scene, RUN_S))
        many.append((built, runs))
    return many


@check(
    "reset-start",
    title="reset restores the start",
    law="state after reset = state after build",
    tolerance=EXACT,
    cause="reset() must write poses, velocities and nodes of all bodies, driven ones too, and forget earlier starts",
    revision=2,
)
def reset_start(lab: Lab) -> Measurement:
    """A thrown stick, a tumbling brick, a bouncing ball, one on a driven plate, a pendulum; a block at rest; cloth.

    Largest difference of a state or node from before the first reset: after that reset, after a reset with seed 1 that
    follows a run, and after one with seed 2 that follows a run from other starts.

    Source: contract (Simulation.reset).
    """
    found = []
    cases = ("after the first reset", "after a run", "after a run from other starts")
    for built, runs in lab.once(_again):
        for run, when in zip(runs, cases, strict=False):
            found += apart(built, run.cut(0.0, 0.0), when)
    return largest_gap(found)


@check(
    "wrench-reset",
    title="reset ends wrenches and driven motion",
    cause="reset() must clear forces, torques and the targets of drive()",
    **SAME,
)
def wrench_reset(lab: Lab) -> Measurement:
    """A stick under a wrench, where the engine applies one, and a ball on a driven plate, among other bodies.

    Largest difference of a state within 0.1 s after a reset, without wrench and `drive`, from the same before.

    Source: contract (Simulation.apply_wrench, Simulation.drive).
    """
    scene = lively(lab)
    undriven = replace(scene, drivers=())
    with lab.running(scene) as simulation:
        before = record(simulation, undriven, 0.1)
        _use(simulation, scene, 0)
        after = run_again(simulation, undriven, 0.1)
    return repeated(lab, apart(before, after, "after the reset"))


@check(
    "reset-course",
    title="the same seed gives the same trajectory",
    cause="reset() leaves something behind: warm starts, contacts, driving forces, wrenches, time or random numbers",
    revision=2,
    **SAME,
)
def reset_course(lab: Lab) -> Measurement:
    """A thrown stick, a tumbling brick, a bouncing ball, one on a driven plate, a pendulum; a block at rest; cloth.

    Largest difference of a state or node within 0.2 s between runs of one simulation with the same seed, 0 or 1. Runs
    from other starts and with seeds 1 and 2 lie between. Free flight may not depend on the seed by more than 0.1 mm.

    Source: contract (Simulation.reset).
    """
    found = []
    for _, runs in lab.once(_again):
        for seed in (0, 1):
            found += apart(runs[seed], runs[seed + 3], f"with seed {seed} again")
        flights = [run.states["stick"] for run in runs if "stick" in run.states]
        gap = float(gaps(*flights[:2]).max()) if flights else 0.0
        if gap > STARTED.absolute:
            hint = f"seed 1 moves a free stick by {gap:.3g}"
            cause = "a seed is no jitter of starts"
            return Measurement(measured=gap, hint=hint, cause=cause)
    return repeated(lab, found)


@check(
    "starts-free",
    title="reset takes initial states",
    law="a reset with states is a scene that starts with them",
    tolerance=STARTED,
    cause="reset(starts) must write pose and velocities of each body: of the origin, in the world frame",
)
def starts_free(lab: Lab) -> Measurement:
    """Turned, thrown and moved bodies of all shapes, also driven and hinged ones; and a sheet of cloth.

    Largest difference of a state or node within 0.2 s between a reset with initial states, which follows a run, and a
    scene that is built with them.

    Source: contract (Simulation.reset).
    """
    solids = [
        {"bodies": (body(name, shape, Pose(position_m=(x, 3, 1))),)}
        for x, (name, shape) in enumerate(SOLIDS.items())
    ]
    found = []
    for scene in (widest(lab, *solids, BOUNCE, CARRIED, HUNG), *lab.once(cloths)):
        states = shifted_states(scene, 1.0)
        for row, item in zip(states, scene.bodies, strict=False):
            if item.name in ("plate", "rider"):
                row[1] += 0.3
        there = scene_at(scene, states)
        # A cloth on the ground crumples unpredictably.
        seconds = 0.1 if there.deformables else RUN_S
        expected = lab.rollout(there, seconds)
        with lab.running(scene) as simulation:
            record(simulation, scene, 0.1)
            simulation.reset(states[None], 0)
            run = record(simulation, there, seconds)
        found += apart(expected, run, "after reset(starts)")
    return largest_gap(found)


@contextmanager
def aside() -> Iterator[None]:
    """Hide output of engines about states that are not finite: on stderr, and files in the working directory."""
    kept = os.dup(2)
    with (
        TemporaryDirectory() as folder,
        chdir(folder),
        Path(os.devnull).open("w") as none,
    ):
        os.dup2(none.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


@check(
    "restart-after-nan",
    title="a simulation that failed is healthy after reset",
    cause="reset() leaves states, forces, contacts or caches that are not finite",
    **SAME,
)
def restart_after_nan(lab: Lab) -> Measurement:
    """A stick that starts with a velocity of NaN under a force of 1e30 N, among other bodies; then a reset.

    Largest difference of a state within 0.2 s from the run before. The failure itself must show: as states that are not
    finite, in `diverged`, or as an error.

    Source: contract (Simulation.reset, Simulation.diverged).
    """
    scene = lively(lab)
    with aside(), lab.running(scene) as simulation:
        before = record(simulation, scene, RUN_S)
        if not _fails_visibly(simulation, scene):
            hint = "a velocity of NaN became finite, and diverged() names no world"
            return Measurement(measured=np.inf, hint=hint)
        after = run_again(simulation, scene, RUN_S)
        return repeated(lab, apart(before, after, "after NaN"))


def _fails_visibly(simulation: Simulation, scene: Scene) -> bool:
    """Let a simulation fail, and return whether the failure shows."""
    states = nominal_states(scene)
    states[0, 7:] = np.nan
    with suppress(Exception):
        simulation.reset(states[None], 0)
        for _ in range(3):
            simulation.advance(SAMPLE_INTERVAL_S)
        is_finite = np.isfinite(simulation.body_states(["stick"])).all()
        if is_finite and not simulation.diverged():
            return False
        push(simulation, "stick", [1e30, 0.0, 0.0, 0.0, 1e30, 0.0])
        simulation.advance(SAMPLE_INTERVAL_S)
    return True


def _resident_mb() -> float:
    """Return the memory that this process occupies [MB]; 0 where the system has no /proc."""
    file = Path("/proc/self/statm")
    if not file.exists():
        return 0.0
    # Memory that was freed before would hide a leak. The function belongs to glibc.
    with suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    return 1e-6 * int(file.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@check(
    "life",
    title="200 resets need no memory",
    law="growth = 0",
    unit="MB",
    tolerance=Tolerance("Python's memory varies by 1 MB", absolute=4.0),
    cause="reset() makes objects that nothing frees: contacts, shapes, solvers or states",
)
def life(lab: Lab) -> Measurement:
    """A thrown stick, a tumbling brick, a bouncing ball, one on a driven plate, a pendulum, reset 200 times.

    Growth of the resident memory from reset 50 to 200.

    Source: a training run resets a simulation a million times.
    """
    scene = lively(lab)
    sizes_mb = []
    with closing(lab.build(scene)) as simulation:
        for count in (50, 150):
            for _ in range(count):
                run_again(simulation, scene, SAMPLE_INTERVAL_S)
            sizes_mb.append(_resident_mb())
    return Measurement(measured=max(sizes_mb[1] - sizes_mb[0], 0.0))


def _course(backend: str, settings: Mapping[str, Any] | None) -> Recording:
    """Return the run of an engine, in the process that calls it."""
    lab = Lab(find_backend(backend), settings)
    return lab.rollout(lively(lab), RUN_S)


@check(
    "second-process",
    title="another process gives the same trajectory",
    cause="the engine takes random numbers, the time, addresses or the order of a set",
    optional=True,
    **SAME,
)
def second_process(lab: Lab) -> Measurement:
    """A thrown stick, a tumbling brick, a bouncing ball, one on a driven plate, a pendulum.

    Largest difference of a state within 0.2 s between this Python process and a second one, for an installed engine.

    Source: contract (Simulation.reset).
    """
    name, installed = lab.backend.name, None
    with suppress(GaugeError):
        installed = find_backend(name)
    if type(installed) is not type(lab.backend):
        raise UnsupportedError(("no name starts the engine in another process",))
    here = lab.rollout(lively(lab), RUN_S)
    with Worker(300.0) as worker:
        there = worker.call(_course, name, lab.settings)
    return repeated(lab, apart(here, there, "in another process"), BITS)
