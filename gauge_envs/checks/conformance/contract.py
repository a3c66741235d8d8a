"""Conventions of the contract: units, frames, order, time, reset, repeatability, and going back to a state."""

from __future__ import annotations

import pickle

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import Simulation
from gauge_envs.checks.conformance.kit import Measurement, Tolerance, check
from gauge_envs.checks.conformance.lab import Lab
from gauge_envs.checks.conformance.parts import ball, body, box, driver, fixed_box, ground, ramp, strip_on_rod
from gauge_envs.checks.rollout import Course, PathsOfDrivers, record, states_now
from gauge_envs.scene import Box, Contact, ContactMode, Motion, Pose, Scene
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

__all__: list[str] = []

EXACT = Tolerance(absolute=0.0, rationale="the contract says the same, bit for bit")

# --- conventions -----------------------------------------------------------------------------------------------------


def _still_scene() -> Scene:
    """A fixed, a driven and two dynamic bodies, each turned in its own way."""
    return Scene(
        bodies=(
            box("brick", (0.5, -0.3, 2.0), (0.1, 0.06, 0.03), euler_deg=(20.0, 50.0, -100.0)),
            fixed_box("wall", (-0.4, 0.2, 1.0), (0.1, 0.3, 0.2), euler_deg=(0.0, 0.0, 30.0)),
            body(
                "plate",
                Box(size_m=(0.2, 0.2, 0.02)),
                Pose.from_euler_deg((0.1, 0.7, 0.4), (10.0, 0.0, 60.0)),
                mass_kg=1.0,
                motion=Motion.KINEMATIC,
            ),
            ball("ball", (-0.2, -0.6, 1.5)),
        ),
        drivers=(driver("plate", "translate", (0.0, 0.0, 1.0), ramp(0.1, start_s=0.1, duration_s=0.4, ramp_s=0.1)),),
        duration_s=1.0,
    )


def _as_built(lab: Lab) -> tuple[Scene, NDArray[np.float64], NDArray[np.float64]]:
    """States right after build, of the names in order and in reversed order."""
    scene = _still_scene()
    names = [one.name for one in scene.bodies]
    simulation = lab.build(scene)
    try:
        return scene, states_now(simulation, names), states_now(simulation, names[::-1])[::-1]
    finally:
        simulation.close()


@check(
    "start-position",
    title="build stands at the start: positions",
    measures="largest distance of a fixed, driven or dynamic body's origin from its start, right after build",
    law="RigidBody.pose",
    source="contract (Backend.build)",
    unit="mm",
    tolerance=Tolerance(absolute=1e-3, rationale="a float's rounding at 1 m is 0.1 um"),
    diagnosis="body_states must give the body origin in metres in the world frame, before any step is done",
)
def _start_position(lab: Lab) -> Measurement:
    scene, states, _ = lab.once(_as_built)
    expected = np.array([one.pose.position_m for one in scene.bodies])
    hint = "positions are in mm" if np.allclose(states[:, :3], 1e3 * expected, atol=1.0) else ""
    return Measurement(
        measured=1e3 * float(np.linalg.norm(states[:, :3] - expected, axis=1).max()), expected=0.0, hint=hint
    )


@check(
    "start-orientation",
    title="build stands at the start: orientations",
    measures="largest distance of a body's quaternion (w, x, y, z) from its start, right after build; either sign",
    law="RigidBody.pose",
    source="contract (Simulation.body_states)",
    unit="1",
    tolerance=Tolerance(absolute=1e-5, rationale="a float's rounding is 1e-7"),
    diagnosis="columns 3 to 6 of body_states are a unit quaternion, scalar first, body to world",
)
def _start_orientation(lab: Lab) -> Measurement:
    scene, states, _ = lab.once(_as_built)
    expected = np.array([one.pose.quaternion for one in scene.bodies])

    def miss(quaternions: NDArray[np.float64]) -> float:
        both = [np.linalg.norm(quaternions - sign * expected, axis=1) for sign in (1.0, -1.0)]
        return float(np.min(both, axis=0).max())

    reported = states[:, 3:7]
    explanations = {
        "it is x, y, z, w: the scalar comes last": np.roll(reported, 1, axis=1),
        "it is the inverse: world to body": reported * [1.0, -1.0, -1.0, -1.0],
    }
    hint = next((text for text, values in explanations.items() if miss(values) < 1e-4), "")
    return Measurement(measured=miss(reported), expected=0.0, hint=hint)


@check(
    "start-rest",
    title="build stands at the start: at rest",
    measures="largest reported speed [m/s] or angular speed [rad/s] right after build",
    law="v = 0, omega = 0",
    source="contract (scene.py has no start velocities)",
    unit="1",
    tolerance=Tolerance(absolute=1e-9, rationale="nothing has moved yet"),
    diagnosis="build must not step the engine, or must go back to the start after it",
)
def _start_rest(lab: Lab) -> Measurement:
    return Measurement(measured=float(np.abs(lab.once(_as_built)[1][:, 7:]).max()), expected=0.0)


@check(
    "order-of-names",
    title="rows are in the order of the names",
    measures="largest difference between states asked for in one order and in the reversed one",
    law="row i is that of names[i]",
    source="contract (Simulation.body_states)",
    unit="1",
    tolerance=EXACT,
    diagnosis="body_states must return one row for each name in the order asked for, not in the scene's",
)
def _order_of_names(lab: Lab) -> Measurement:
    _, forward, backward = lab.once(_as_built)
    return Measurement(measured=float(np.abs(forward - backward).max()), expected=0.0)


# --- time ------------------------------------------------------------------------------------------------------------


def _bounce_scene() -> Scene:
    """A box that tumbles on a fixed slab beside a driven plate: contact, rebound, rotation, driver."""
    return Scene(
        bodies=(
            box("brick", (0.0, 0.0, 0.2), (0.1, 0.06, 0.03), euler_deg=(25.0, 35.0, 10.0)),
            fixed_box("slab", (0.0, 0.0, -0.01), (1.0, 1.0, 0.02)),
            body(
                "plate",
                Box(size_m=(0.3, 0.3, 0.02)),
                Pose(position_m=(0.0, 0.0, 0.6)),
                mass_kg=1.0,
                motion=Motion.KINEMATIC,
            ),
            ball("ball", (0.1, 0.0, 0.64)),
        ),
        contacts=(
            Contact(first=("brick",), second=("slab",), friction=0.4, restitution=0.4, mode=ContactMode.IMPACT),
            Contact(first=("ball",), second=("plate",), friction=0.4, restitution=0.0),
        ),
        drivers=(driver("plate", "rotate", (0.0, 1.0, 0.0), ramp(0.5, start_s=0.05, duration_s=0.5, ramp_s=0.1)),),
        duration_s=1.0,
    )


def _bounces(lab: Lab) -> Scene:
    """That scene, or a single ball on the ground for an engine that knows no more."""
    contact = Contact(first=("ball",), second=("ground",), friction=0.4, restitution=0.6, mode=ContactMode.IMPACT)
    simple = Scene(bodies=(ball("ball", (0.1, 0.2, 0.2)), ground()), contacts=(contact,), duration_s=1.0)
    return lab.first_supported(_bounce_scene(), simple)


BOUNCE_S = 0.5


def _bounce(lab: Lab) -> Course:
    return lab.course(_bounces(lab), BOUNCE_S)


@check(
    "time",
    title="advance takes seconds",
    measures="fall of a brick within advance(1/30), called nine times, over that within 54 calls of advance(1/180)",
    law="advance(6 dt) = 6 advance(dt)",
    source="contract (Simulation.advance)",
    unit="1",
    tolerance=Tolerance(absolute=1e-4, rationale="steps are the same; only rounding differs"),
    diagnosis="advance(seconds) must simulate that time whatever its length: count steps, do not step once a call",
)
def _time(lab: Lab) -> Measurement:
    scene = Scene(bodies=(box("brick", (0.0, 0.0, 3.0), (0.1, 0.06, 0.03)),), duration_s=1.0)
    fallen = []
    for interval, count in ((1 / 30, 9), (SAMPLE_INTERVAL_S, 54)):
        simulation = lab.build(scene)
        try:
            simulation.reset(0)
            for _ in range(count):
                simulation.advance(interval)
            fallen.append(3.0 - states_now(simulation, ["brick"])[0, 2])
        finally:
            simulation.close()
    if not fallen[1] > 0.0:
        return Measurement(measured=float("nan"), expected=1.0, hint="the brick does not fall")
    return Measurement(measured=fallen[0] / fallen[1], expected=1.0)


@check(
    "sample-positions",
    title="sample_positions is advance and body_states",
    measures="largest difference between positions read by sample_positions and after each advance",
    law="= advance, then body_states",
    source="contract (Simulation.sample_positions)",
    unit="mm",
    tolerance=EXACT,
    diagnosis="an override of sample_positions must advance first and read then, the same bodies in the same order",
)
def _sample_positions(lab: Lab) -> Measurement:
    scene = Scene(
        bodies=(ball("ball", (0.1, 0.2, 2.0)), box("brick", (0.0, 0.0, 3.0), (0.1, 0.06, 0.03))), duration_s=1.0
    )
    names = ["brick", "ball"]
    read = []
    for tight in (True, False):
        simulation = lab.build(scene)
        try:
            simulation.reset(0)
            if tight:
                read.append(np.array(simulation.sample_positions(names, 12, SAMPLE_INTERVAL_S)))
                continue
            rows = []
            for _ in range(12):
                simulation.advance(SAMPLE_INTERVAL_S)
                rows.append(states_now(simulation, names)[:, :3])
            read.append(np.array(rows))
        finally:
            simulation.close()
    return Measurement(measured=1e3 * float(np.abs(read[0] - read[1]).max()), expected=0.0)


# --- repeatability ---------------------------------------------------------------------------------------------------


def _difference(first: Course, second: Course) -> float:
    """Largest difference of two courses of one scene in any number."""
    states = [np.abs(first.states[name] - second.states[name]).max() for name in first.states]
    nodes = [np.abs(first.nodes_m[name] - second.nodes_m[name]).max() for name in first.nodes_m]
    return float(max([*states, *nodes]))


def _again_after_reset(lab: Lab, scene: Scene, seconds: float) -> tuple[Course, Course]:
    """Two courses of one simulation; before the second it ran on, with another seed, and was reset.

    The first one starts as built: its first sample is from before the first reset.
    """
    simulation = lab.build(scene)
    try:
        built = record(simulation, scene, 0.0)
        simulation.reset(0)
        first = record(simulation, scene, seconds)
        simulation.reset(1)
        record(simulation, scene, 0.1)
        simulation.reset(0)
        for name, states in built.states.items():
            first.states[name][0] = states[0]
        for name, nodes in built.nodes_m.items():
            first.nodes_m[name][0] = nodes[0]
        return first, record(simulation, scene, seconds)
    finally:
        simulation.close()


def _bounce_again(lab: Lab) -> tuple[Course, Course]:
    return _again_after_reset(lab, _bounces(lab), BOUNCE_S)


def _cloth_again(lab: Lab) -> tuple[Course, Course]:
    return _again_after_reset(lab, strip_on_rod(), 0.2)


def _first_samples(course: Course) -> Course:
    return Course(
        scene=course.scene,
        times_s=course.times_s[:1],
        states={name: states[:1] for name, states in course.states.items()},
        nodes_m={name: nodes[:1] for name, nodes in course.nodes_m.items()},
    )


def _start_hint(first: Course, second: Course) -> str:
    moved = max((np.abs(s[0, :7] - second.states[n][0, :7]).max() for n, s in first.states.items()), default=0.0)
    speed = max((np.abs(s[0, 7:] - second.states[n][0, 7:]).max() for n, s in first.states.items()), default=0.0)
    if moved == 0.0 and speed > 0.0:
        return "velocities are kept"
    return "nothing goes back, or not everything" if moved > 0.0 else ""


@check(
    "reset-start",
    title="reset goes back to the start",
    measures="largest difference of any state [m, 1, m/s, rad/s] between right after build and after a later reset",
    law="state after reset = state after build",
    source="contract (Simulation.reset)",
    unit="1",
    tolerance=EXACT,
    diagnosis="reset must restore positions, orientations and velocities of all bodies, driven ones included",
)
def _reset_start(lab: Lab) -> Measurement:
    first, second = lab.once(_bounce_again)
    return Measurement(
        measured=_difference(_first_samples(first), _first_samples(second)),
        expected=0.0,
        hint=_start_hint(first, second),
    )


@check(
    "reset-course",
    title="the same seed gives the same course",
    measures="largest difference of any state in 0.5 s of bouncing after a second reset from those after the first",
    law="same seed, same course",
    source="contract (Simulation.reset)",
    unit="1",
    tolerance=EXACT,
    diagnosis="something outlives reset: velocities, warm starts, contact caches, forces on driven bodies, or time",
)
def _reset_course(lab: Lab) -> Measurement:
    return Measurement(measured=_difference(*lab.once(_bounce_again)), expected=0.0)


@check(
    "determinism",
    title="two builds give the same course",
    measures="largest difference of any state in 0.5 s of bouncing between two simulations of one scene",
    law="same scene, same course",
    source="contract (Simulation.reset); a benchmark must be repeatable",
    unit="1",
    tolerance=EXACT,
    diagnosis="unseeded random numbers, or sums in an order that changes, as of atomic additions on a GPU",
)
def _determinism(lab: Lab) -> Measurement:
    return Measurement(measured=_difference(lab.once(_bounce), _bounce(lab)), expected=0.0)


def _continued(lab: Lab, scene: Scene, *, in_copy: bool = False) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """All numbers 0.1 s after a state, and again after going back to it from elsewhere, or in another simulation."""
    names = [one.name for one in scene.bodies if one.motion is Motion.DYNAMIC]
    paths = PathsOfDrivers(scene, 1.0)

    def run_on(simulation: Simulation, first: int, count: int) -> None:
        for sample in range(first, first + count):
            paths.drive(simulation, sample)
            simulation.advance(SAMPLE_INTERVAL_S)

    def after(simulation: Simulation) -> NDArray[np.float64]:
        run_on(simulation, 18, 18)
        nodes = [np.array(simulation.nodes(one.name)).ravel() for one in scene.deformables]
        return np.concatenate([states_now(simulation, names).ravel(), *nodes])

    simulation = lab.build(scene)
    other = lab.build(scene) if in_copy else simulation
    try:
        simulation.reset(0)
        run_on(simulation, 0, 18)
        kept = simulation.state()
        first = after(simulation)
        run_on(simulation, 36, 6)
        other.restore(pickle.loads(pickle.dumps(kept)) if in_copy else kept)
        return first, after(other)
    finally:
        simulation.close()
        other.close()


@check(
    "restore",
    title="restore goes on bit for bit",
    measures="largest difference of any state 0.1 s after a restored state from the first time",
    law="same state, same course",
    source="contract (Simulation.state)",
    unit="1",
    tolerance=EXACT,
    diagnosis="state() must hold velocities, warm starts and whatever else the next step reads, as copies",
)
def _restore(lab: Lab) -> Measurement:
    first, second = _continued(lab, _bounces(lab))
    return Measurement(measured=float(np.abs(first - second).max()), expected=0.0)


@check(
    "copy",
    title="a copy goes on bit for bit",
    measures="largest difference of any state 0.1 s after a state that another simulation restored from its pickle",
    law="same state, same course",
    source="contract (Simulation.state)",
    unit="1",
    tolerance=EXACT,
    diagnosis="state() must pickle, and hold what the next step reads, not where this one simulation keeps it",
)
def _copy(lab: Lab) -> Measurement:
    first, second = _continued(lab, _bounces(lab), in_copy=True)
    return Measurement(measured=float(np.abs(first - second).max()), expected=0.0)


@check(
    "cloth-reset",
    title="cloth: the same seed gives the same course",
    measures="largest difference of any node [m] or state in 0.2 s of swinging after a second reset",
    law="same seed, same course",
    source="contract (Simulation.reset)",
    unit="1",
    tolerance=EXACT,
    diagnosis="reset must restore positions and velocities of the nodes, and whatever the solver keeps between steps",
)
def _cloth_reset(lab: Lab) -> Measurement:
    return Measurement(measured=_difference(*lab.once(_cloth_again)), expected=0.0)


@check(
    "cloth-determinism",
    title="cloth: two builds give the same course",
    measures="largest difference of any node [m] or state in 0.2 s of swinging between two simulations",
    law="same scene, same course",
    source="contract (Simulation.reset); a benchmark must be repeatable",
    unit="1",
    tolerance=EXACT,
    diagnosis="unseeded random numbers, or sums in an order that changes, as of atomic additions on a GPU",
)
def _cloth_determinism(lab: Lab) -> Measurement:
    return Measurement(measured=_difference(lab.once(_cloth_again)[0], lab.course(strip_on_rod(), 0.2)), expected=0.0)


@check(
    "cloth-restore",
    title="cloth: restore goes on bit for bit",
    measures="largest difference of any node [m] 0.1 s after a restored state from the first time",
    law="same state, same course",
    source="contract (Simulation.state)",
    unit="1",
    tolerance=EXACT,
    diagnosis="state() must hold the nodes' velocities and whatever else the next step reads, as copies",
)
def _cloth_restore(lab: Lab) -> Measurement:
    first, second = _continued(lab, strip_on_rod())
    return Measurement(measured=float(np.abs(first - second).max()), expected=0.0)


@check(
    "cloth-copy",
    title="cloth: a copy goes on bit for bit",
    measures="largest difference of any node [m] 0.1 s after a state that another simulation restored from its pickle",
    law="same state, same course",
    source="contract (Simulation.state)",
    unit="1",
    tolerance=EXACT,
    diagnosis="state() must pickle, and hold what the next step reads, not where this one simulation keeps it",
)
def _cloth_copy(lab: Lab) -> Measurement:
    first, second = _continued(lab, strip_on_rod(), in_copy=True)
    return Measurement(measured=float(np.abs(first - second).max()), expected=0.0)
