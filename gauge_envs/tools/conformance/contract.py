"""Rules of each call of the contract: arrays, repeatability, start, time and settings."""

from contextlib import closing, suppress
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.integrate import trapezoid
from scipy.special import exprel

from gauge_envs.backends import Simulation
from gauge_envs.fixtures.parts import box, contact, fixed_box, ground, thrown
from gauge_envs.fixtures.recording import UnsupportedError, record
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import length_of
from gauge_envs.scene.states import nominal_states
from gauge_envs.tools.conformance.cloth import LIGHT_FABRIC, hanging_strip
from gauge_envs.tools.conformance.free_motion import solids
from gauge_envs.tools.conformance.lab import Lab, Measurement, largest, ratio
from gauge_envs.tools.conformance.model import COUNT, Checks, Level, Tolerance
from gauge_envs.tools.conformance.repeats import BITS, apart, gaps, repeated

check = Checks(Level.RIGID)


BRICK_M = (0.1, 0.06, 0.03)
WALL = fixed_box("wall", (-0.4, 0.2, -1.0), BRICK_M, euler_deg=(0.0, 0.0, 30.0))
STRIP = hanging_strip(LIGHT_FABRIC)


# --- arrays and repeatability ----------------------------------------------------------------------------------------


def _several(lab: Lab) -> Scene:
    return Scene(bodies=(*solids(lab), WALL), duration_s=1.0)


def _arrays(simulation: Simulation, scene: Scene) -> list[Any]:
    names = [body.name for body in scene.bodies]
    states = [simulation.body_states(rows) for rows in (names, names[::-1])]
    return states + [simulation.nodes(body.name) for body in scene.deformables]


@check(
    "order-of-names",
    title="arrays of states and nodes",
    law="a new float64 array [N, len(names), 13], row i of names[i]; nodes [N, n, 3]",
    tolerance=COUNT,
    cause="body_states must return a new float64 array with a row for each name, in the order of the call",
)
def order_of_names(lab: Lab) -> Measurement:
    """A fixed box and free solids, all turned; and a strip of cloth, if the engine builds cloth.

    Number of faults of arrays: type, shape, order of rows, and changes after they were returned.

    Source: contract (Simulation.body_states, Simulation.nodes).
    """
    faults = set()
    for scene in (_several(lab), *filter(lab.supports, [STRIP])):
        with lab.running(scene) as simulation:
            given = _arrays(simulation, scene)
            before = [np.array(array) for array in given]
            simulation.advance(0.1)
            _arrays(simulation, scene)
        for array, old, width in zip(given, before, (13, 13, 3), strict=False):
            what = "nodes" if width == 3 else "body_states"
            is_right = type(array) is np.ndarray and old.dtype == np.float64
            if not is_right or old.shape != (1, *old.shape[-2:-1], width):
                found = f"{type(array).__name__} {old.dtype} {old.shape}"
                faults.add(
                    f"{what}: {found} instead of ndarray float64 (1, n, {width})"
                )
            if not np.array_equal(array, old):
                faults.add(f"{what}: a returned array changes later; return a copy")
        places = [array[..., :3] for array in before[:2]]
        if not faults and np.abs(places[0] - places[1][:, ::-1]).max() > 1e-3:
            faults.add("body_states: rows are not in the order of the names")
    return Measurement(measured=len(faults), cause="; ".join(sorted(faults)))


SPEED_M_PER_S = np.array([1.2, -0.8, 0.5])
SPINNING = thrown(box("brick", (0.0, 0.0, 0.2), BRICK_M), SPEED_M_PER_S, (8, -9, 11))
FREE = Scene(bodies=(SPINNING,), duration_s=0.3)
BOUNCE = replace(
    FREE,
    bodies=(SPINNING, ground()),
    contacts=(contact("brick", "ground", friction=0.4, restitution=0.4),),
)


@check(
    "determinism",
    title="a scene moves alike in each simulation",
    law="same scene and seed, same trajectory",
    tolerance=Tolerance("equal bits, or as Backend.repeatability says"),
    cause="random numbers have no seed, sums have a changing order, as atomic additions on a GPU, or simulations share"
    " their state",
    revision=2,
)
def determinism(lab: Lab) -> Measurement:
    """A spinning brick that falls on a plane, or freely without contacts; a strip of cloth, if the engine builds it.

    Largest difference [m, 1, m/s, rad/s] from a second simulation, alone and beside another of lower gravity.

    Source: contract (Backend.build, Simulation.reset).
    """
    again = []
    beside = []
    falling = BOUNCE if lab.supports(BOUNCE) else lab.in_any_shape(FREE)
    for scene in (falling, *filter(lab.supports, [STRIP])):
        first = lab.rollout(scene, 0.3)
        again += apart(first, lab.rollout(scene, 0.3), "in a second simulation")
        lighter = replace(scene, gravity_m_per_s2=1.62)
        with lab.running(scene) as simulation, lab.running(lighter) as neighbour:
            neighbour.advance(0.1)
            run = record(simulation, scene, 0.3)
        beside += apart(first, run, "beside another simulation, which shares gravity,")
    measurement = repeated(lab, again, BITS)
    is_same = measurement.measured <= (measurement.width or 0.0)
    return repeated(lab, beside, BITS) if is_same else measurement


# --- start -----------------------------------------------------------------------------------------------------------


def _start(lab: Lab) -> list[dict[str, float]]:
    """Return errors of positions [mm], quaternions and velocities [mm/s] right after build and after a reset."""
    scene = _several(lab)
    names = [body.name for body in scene.bodies]
    with closing(lab.build(scene)) as simulation:
        calls = {"build": np.array(simulation.body_states(names)[0])}
        simulation.advance(0.1)
        simulation.reset(None, 0)
        calls["reset"] = np.array(simulation.body_states(names)[0])
    places, turns, rates = {}, {}, {}
    for call, rows in calls.items():
        for name, off in zip(names, gaps(rows, nominal_states(scene)), strict=True):
            places[f"the {name} after {call}"] = 1e3 * length_of(off[:3])
            turns[f"the {name} after {call}"] = length_of(off[3:7])
            rates[f"the velocity of the {name} after {call}"] = 1e3 * length_of(off[7:])
    return [places, turns, rates]


@check(
    "start-position",
    title="bodies start at their positions",
    law="RigidBody.pose.position_m",
    unit="mm",
    tolerance=Tolerance("single precision rounds 1 m to 0.1 um", absolute=1e-3),
    cause="body_states must report body origins [m] in the world frame, before the first step and after reset",
)
def start_position(lab: Lab) -> Measurement:
    """A fixed box and free solids, all turned.

    Largest distance of a body's origin from its start, right after build and after a reset.

    Source: contract (Backend.build, Simulation.reset).
    """
    return largest(lab.once(_start)[0], "mm")


@check(
    "start-orientation",
    title="bodies start at their orientations",
    law="RigidBody.pose.quaternion",
    tolerance=Tolerance("single precision rounds to 1e-7", absolute=1e-5),
    cause="a quaternion is w, x, y, z from the body to the world, in Pose and in columns 3 to 6 of body_states",
)
def start_orientation(lab: Lab) -> Measurement:
    """A fixed box and free solids, all turned.

    Largest distance of a quaternion of either sign from its start, right after build and after a reset.

    Source: contract (Simulation.body_states).
    """
    return largest(lab.once(_start)[1])


@check(
    "start-rest",
    title="bodies at rest report no velocity",
    law="v = 0, omega = 0",
    unit="mm/s",
    tolerance=Tolerance("gravity gives 1 mm/s within 0.1 ms", absolute=0.1),
    cause="build and reset return time 0, before any step; velocities are those after the contacts of a step",
)
def start_rest(lab: Lab) -> Measurement:
    """Bodies that start at rest; and a brick that lies on a plane, if the engine builds contacts.

    Largest reported velocity [mm/s, mrad/s] right after build and reset; and the mean of the brick from 0.4 to 0.5 s,
    less that with which it moves.

    Source: contract (Simulation.body_states).
    """
    _, _, cases = lab.once(_start)
    brick = box("brick", (0.1, 0.0, 0.015), BRICK_M)
    touch = contact("brick", "ground", friction=0.5)
    scene = Scene(bodies=(ground(), brick), contacts=(touch,), duration_s=0.5)
    with suppress(UnsupportedError):
        late = lab.rollout(scene).cut(0.4, 0.5)
        moved = late.displacement("brick")[-1] / np.ptp(late.times_s)
        off = 1e3 * length_of(late.velocity("brick").mean(axis=0) - moved)
        # Other checks judge a brick that falls.
        if length_of(moved) < 0.01:
            cases = {**cases, "the velocity of a brick that lies still": off}
    return largest(cases, "mm/s")


# --- time and settings -----------------------------------------------------------------------------------------------

CALLS = {"1/180 s": (1 / 180, 432), "1/30 s": (1 / 30, 72), "1 s": (1.0, 2)}


@check(
    "time",
    title="advance simulates the given time",
    law="path = v t",
    tolerance=Tolerance("a lost call of 432 is 0.2 %", absolute=1e-3),
    cause="advance(seconds) must simulate any time: count steps, and carry over what is left",
    revision=2,
)
def time(lab: Lab) -> Measurement:
    """A thrown brick without gravity; 2 s or more in calls of 1/180 s, of 1/30 s and of 1 s.

    Horizontal path over time and speed, the worst. The speed is that of the start or as reported, whichever explains
    the path.

    Source: Newton; contract (Simulation.advance).
    """
    ratios, late = {}, []
    scene = lab.in_any_shape(replace(FREE, gravity_m_per_s2=0.0))
    for name, (interval_s, count) in CALLS.items():
        rows = lab.rollout(scene, interval_s * count, interval_s=interval_s)
        speeds = np.hypot(*rows.velocity("brick")[:, :2].T)
        given = count * np.hypot(*SPEED_M_PER_S[:2])
        # Braking, at one rate or by one share a second, is not a fault of time.
        moving = np.maximum(speeds, 1e-9)
        means = moving[:-1] * exprel(np.diff(np.log(moving)))
        sums = [speeds[:-1].sum(), trapezoid(speeds), means.sum(), given]
        steps = np.diff(rows.position("brick")[:, :2], axis=0)
        path = np.hypot(*steps.T).sum() / interval_s
        shares = path / np.maximum(sums, 1e-9)
        ratios[f"calls of {name}"] = float(shares[np.abs(shares - 1.0).argmin()])
        late.append(count * (1.0 - shares[-1]))
    measurement = ratio(ratios, "the simulated time")
    if not np.allclose(late, 1.0, atol=0.1):
        return measurement
    hint = "states are those before the last call of advance"
    return replace(measurement, hint=hint, cause="an interval late")


STEPS_S = (1 / 360, 1 / 900)


@check(
    "settings-step",
    title="settings have the step in force",
    law="Simulation.settings['timestep_s'] is the step",
    tolerance=COUNT,
    cause="read settings back from the engine; timestep_s must be its step",
    optional=True,
)
def settings_step(lab: Lab) -> Measurement:
    """A spinning brick that falls, with steps of 1/360 s and of 1/900 s.

    Number of faults: another step in the settings than the requested step; the same motion with both.

    Source: contract (Simulation.settings).
    """
    faults, ends = [], []
    scene = lab.in_any_shape(FREE)
    for step_s in STEPS_S:
        ends.append(lab.rollout(scene, timestep_s=step_s).states["brick"])
        given = lab.effective_settings.get("timestep_s", np.nan)
        if not abs(given / step_s - 1.0) < 1e-9:
            faults.append(f"settings have timestep_s {given:.6g}, not {step_s:.6g}")
    cause = ""
    if np.array_equal(ends[0], ends[1]):
        faults.append("two steps give the same motion")
        cause = "the engine ignores timestep_s"
    return Measurement(measured=len(faults), hint="; ".join(faults), cause=cause)
