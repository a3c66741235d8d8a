"""Conventions of the contract: finite states, units, frames, order, time, reset and repeatability."""

from contextlib import closing
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from gauge_envs.envs.rollout import intervals
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Hinge,
    Pose,
    Region,
    Scene,
    SoftBody,
)
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.prescribed_motion import prescribed_motions
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
from gauge_envs.tools.bench.recording import (
    DeclinedError,
    NotFiniteError,
    Recording,
    record,
)
from gauge_envs.tools.conformance.lab import STRIP_ON_ROD, Lab, clamped, strip_on_rod
from gauge_envs.tools.conformance.laws import largest_mm
from gauge_envs.tools.conformance.model import (
    COUNT,
    EXACT,
    REBUILT,
    REPEATED,
    Check,
    Measurement,
    recorded,
)

SAME_SEED: dict[str, Any] = {
    "law": "same seed, same trajectory",
    "source": "contract (Simulation.reset)",
    "tolerance": REPEATED,
}
SAME_SCENE: dict[str, Any] = {
    "law": "same scene, same trajectory",
    "source": "contract (Simulation.reset); a benchmark must be repeatable",
    "tolerance": REBUILT,
    "diagnosis": "unseeded random numbers, or sums in a changing order, such as atomic additions on a GPU",
}

# --- finite states ---------------------------------------------------------------------------------------------------


def _swinging_scene() -> Scene:
    """Return a ball on a hinge and one on a plane."""
    return Scene(
        bodies=(ball("bob", (0.2, 0.0, 1.0)), ball("ball", (0.0, 0.5, 0.03)), ground()),
        joints=(Hinge(body="bob", anchor_m=(0.0, 0.0, 1.0), axis=(0.0, 1.0, 0.0)),),
        contacts=(contact("ball", "ground", friction=0.4),),
        duration_s=1.0,
    )


def _foam_scene() -> Scene:
    """Return a bar of foam that hangs from a fixed body."""
    foam = SoftBody(
        name="foam",
        shape=Box(size_m=(0.04, 0.04, 0.1)),
        pose=Pose(position_m=(0.0, 0.0, 1.0)),
        mass_kg=0.016,
        young_modulus_pa=1e4,
        poisson_ratio=0.3,
    )
    return clamped(foam, Region(axis="z", side="high"), duration_s=1.0)


@Check("finite", tolerance=COUNT)
def _finite(lab: Lab) -> Measurement:
    scenes = (
        _still_scene(),
        _bounce_scene(),
        _swinging_scene(),
        strip_on_rod(),
        _foam_scene(),
    )
    faults, declined = [], []
    for scene in scenes:
        try:
            lab.rollout(scene, 0.05)
        except NotFiniteError as error:
            faults.append(str(error))
        except DeclinedError as error:
            declined.append(error)
    if len(declined) == len(scenes):
        raise declined[0]
    return Measurement(measured=len(faults), hint="; ".join(faults))


# --- conventions -----------------------------------------------------------------------------------------------------


def _still_scene() -> Scene:
    """Return a scene of a fixed, a driven and two dynamic bodies with different orientations."""
    return Scene(
        bodies=(
            box(
                "brick",
                (0.5, -0.3, 2.0),
                (0.1, 0.06, 0.03),
                euler_deg=(20.0, 50.0, -100.0),
            ),
            fixed_box(
                "wall", (-0.4, 0.2, 1.0), (0.1, 0.3, 0.2), euler_deg=(0.0, 0.0, 30.0)
            ),
            driven_box(
                "plate", (0.1, 0.7, 0.4), (0.2, 0.2, 0.02), euler_deg=(10.0, 0.0, 60.0)
            ),
            ball("ball", (-0.2, -0.6, 1.5)),
        ),
        drivers=(
            driver(
                "plate",
                "translate",
                (0.0, 0.0, 1.0),
                ramp(0.1, start_s=0.1, duration_s=0.4, ramp_s=0.1),
            ),
        ),
        duration_s=1.0,
    )


class _Built(NamedTuple):
    """A scene and its states right after build, read in the order of the names and in the reversed order."""

    scene: Scene
    states: FloatArray
    backward: FloatArray


@recorded(
    "a brick, a fixed wall, a driven plate and a ball, all turned differently, without contacts"
)
def _as_built(lab: Lab) -> _Built:
    scene = _still_scene()
    names = [one.name for one in scene.bodies]
    with closing(lab.build(scene)) as simulation:
        return _Built(
            scene,
            np.array(simulation.body_states(names)[0]),
            np.array(simulation.body_states(names[::-1])[0, ::-1]),
        )


def one_sign(states: FloatArray) -> FloatArray:
    """Return states, shape [..., 13], whose quaternions have one of the two signs of a rotation.

    Its largest component, of nearly equal ones the first, is positive.
    """
    states = np.array(states)
    quaternions = states[..., 3:7]
    sizes = np.abs(quaternions)
    near = sizes > sizes.max(axis=-1, keepdims=True) - 1e-3
    first = np.take_along_axis(quaternions, near.argmax(axis=-1)[..., None], axis=-1)
    states[..., 3:7] *= np.where(first < 0.0, -1.0, 1.0)
    return states


@_as_built.check("order-of-names", tolerance=EXACT)
def _order_of_names(built: _Built) -> Measurement:
    apart = one_sign(built.states) - one_sign(built.backward)
    return Measurement(measured=float(np.abs(apart).max()))


@_as_built.check("start-position")
def _start_position(built: _Built) -> Measurement:
    positions, expected = (
        built.states[:, :3],
        np.array([one.pose.position_m for one in built.scene.bodies]),
    )
    hint = (
        "positions are in mm"
        if np.allclose(positions, 1e3 * expected, atol=1.0)
        else ""
    )
    return Measurement(measured=largest_mm(positions - expected), hint=hint)


@_as_built.check("start-orientation")
def _start_orientation(built: _Built) -> Measurement:
    expected = np.array([one.pose.quaternion for one in built.scene.bodies])

    def error(quaternions: FloatArray) -> float:
        both = [
            np.linalg.norm(quaternions - sign * expected, axis=1)
            for sign in (1.0, -1.0)
        ]
        return float(np.min(both, axis=0).max())

    reported = built.states[:, 3:7]
    explanations = {
        "it is x, y, z, w: the scalar comes last": np.roll(reported, 1, axis=1),
        "it is the inverse: world to body": reported * [1.0, -1.0, -1.0, -1.0],
    }
    hint = next(
        (text for text, values in explanations.items() if error(values) < 1e-4), ""
    )
    return Measurement(measured=error(reported), hint=hint)


@_as_built.check("start-rest")
def _start_rest(built: _Built) -> Measurement:
    return Measurement(measured=float(np.abs(built.states[:, 7:]).max()))


# --- time ------------------------------------------------------------------------------------------------------------


def _bounce_scene() -> Scene:
    """Return a scene with contact, rebound, rotation and a driver: a tumbling box beside a driven plate."""
    return Scene(
        bodies=(
            box(
                "brick",
                (0.0, 0.0, 0.2),
                (0.1, 0.06, 0.03),
                euler_deg=(25.0, 35.0, 10.0),
            ),
            fixed_box("slab", (0.0, 0.0, -0.01), (1.0, 1.0, 0.02)),
            driven_box("plate", (0.0, 0.0, 0.6), (0.3, 0.3, 0.02)),
            ball("ball", (0.1, 0.0, 0.64)),
        ),
        contacts=(
            contact("brick", "slab", friction=0.4, restitution=0.4),
            contact("ball", "plate", friction=0.4),
        ),
        drivers=(
            driver(
                "plate",
                "rotate",
                (0.0, 1.0, 0.0),
                ramp(0.5, start_s=0.05, duration_s=0.5, ramp_s=0.1),
            ),
        ),
        duration_s=1.0,
    )


def bounces(lab: Lab) -> Scene:
    """Return that scene, or a ball on the ground when the backend cannot build it."""
    bounce = contact("ball", "ground", friction=0.4, restitution=0.6)
    simple = Scene(
        bodies=(ball("ball", (0.1, 0.2, 0.2)), ground()),
        contacts=(bounce,),
        duration_s=1.0,
    )
    return lab.first_supported(_bounce_scene(), simple)


BOUNCES = (
    "a brick dropped by 0.2 m on a fixed slab, and a ball on a plate that turns by 0.5 rad; or a ball dropped on a "
    "plane"
)


@Check("time")
def _time(lab: Lab) -> Measurement:
    scene = Scene(
        bodies=(box("brick", (0.0, 0.0, 3.0), (0.1, 0.06, 0.03)),), duration_s=1.0
    )
    fallen = []
    for interval, count in ((1 / 30, 9), (SAMPLE_INTERVAL_S, 54)):
        with lab.running(scene) as simulation:
            for _ in range(count):
                simulation.advance(interval)
            fallen.append(3.0 - float(simulation.body_states(["brick"])[0, 0, 2]))
    if fallen[1] == 0.0:
        return Measurement(
            measured=float("nan"), expected=1.0, hint="the brick does not move"
        )
    law_m = 0.5 * G * (54 * SAMPLE_INTERVAL_S) ** 2
    wrong = abs(abs(fallen[1]) - law_m) > 0.05 * law_m
    hint = f"in 54 calls it fell by {fallen[1]:.3g} m instead of {law_m:.3g} m: each call changes its speed"
    if np.allclose(fallen, law_m * np.square([8 / 9, 53 / 54]), rtol=5e-3):
        hint, wrong = (
            "the states are those before the last call of advance(): one interval late",
            True,
        )
    return Measurement(
        measured=fallen[0] / fallen[1], expected=1.0, hint=hint if wrong else ""
    )


# --- what is returned and reported ------------------------------------------------------------------------------------


def _new_arrays(lab: Lab, scene: Scene) -> Measurement:
    """Measure by how much arrays that were returned before change as the simulation goes on."""
    names = [one.name for one in scene.bodies]
    with lab.running(scene) as simulation:
        given = [simulation.body_states(names)]
        given += [simulation.nodes(one.name) for one in scene.deformables]
        kept = [np.array(one) for one in given]
        for _ in range(3):
            simulation.advance(SAMPLE_INTERVAL_S)
            simulation.body_states(names)
            for one in scene.deformables:
                simulation.nodes(one.name)
        changed = [
            np.abs(one - old).max() for one, old in zip(given, kept, strict=True)
        ]
    return Measurement(measured=float(max(changed)))


@Check("new-arrays", scene=BOUNCES)
def _new_arrays_rigid(lab: Lab) -> Measurement:
    return _new_arrays(lab, bounces(lab))


@Check("cloth-new-arrays", scene=STRIP_ON_ROD)
def _new_arrays_cloth(lab: Lab) -> Measurement:
    return _new_arrays(lab, strip_on_rod())


SETTING_STEPS_S = (1 / 360, 1 / 900)


@Check("settings-step", scene=BOUNCES, tolerance=COUNT)
def _settings_step(lab: Lab) -> Measurement:
    wrong, ends = [], []
    scene = bounces(lab)
    names = [one.name for one in scene.bodies]
    for step_s in SETTING_STEPS_S:
        with closing(lab.build(scene, timestep_s=step_s)) as simulation:
            told_s = simulation.settings.get("timestep_s")
            if told_s is None:
                wrong.append("settings state no timestep_s")
            elif abs(told_s / step_s - 1.0) > 1e-9:
                wrong.append(f"asked for {step_s:.6g} s, settings state {told_s:.6g} s")
            ends.append(record(simulation, scene, 0.3).states)
    if all(np.array_equal(ends[0][name], ends[1][name]) for name in names):
        wrong.append(
            "two steps give the same motion: the step is not that of the settings"
        )
    return Measurement(measured=len(wrong), hint="; ".join(wrong))


@Check("two-at-once", scene=BOUNCES)
def _two_at_once(lab: Lab) -> Measurement:
    scene = bounces(lab)
    other = replace(scene, gravity_m_per_s2=1.62)
    alone = lab.rollout(scene, 0.3)
    motions = prescribed_motions(scene, 0.3)
    actions = [np.zeros((1, motion.motion_count)) for motion in motions]
    names = [one.name for one in scene.bodies]
    with closing(lab.build(scene)) as first, closing(lab.build(other)) as second:
        first.reset(None, 0)
        second.reset(None, 0)
        apart = 0.0
        for index in range(round(0.3 / SAMPLE_INTERVAL_S)):
            for simulation in (second, first):
                for _ in intervals(simulation, motions, index, 1, actions):
                    pass
            expected = np.array([alone.states[name][index + 1] for name in names])
            now = first.body_states(names)[0]
            apart = max(apart, float(np.abs(one_sign(now) - one_sign(expected)).max()))
    hint = (
        "simulations share constants or state: gravity, contacts, or time"
        if apart
        else ""
    )
    return Measurement(measured=apart, hint=hint)


# --- repeatability ---------------------------------------------------------------------------------------------------


def parts_apart(apart: FloatArray, name: str) -> dict[str, float]:
    """Return the largest differences of position, orientation and velocity of a body.

    Args:
        apart: Differences of its states, shape [..., 13].
        name: Name of the body.
    """
    columns = {
        "position": slice(0, 3),
        "orientation": slice(3, 7),
        "velocity": slice(7, 13),
    }
    return {
        f"{quantity} of the {name}": float(np.abs(apart[..., where]).max())
        for quantity, where in columns.items()
    }


def _difference(first: Recording, second: Recording, hint: str = "") -> Measurement:
    """Measure the largest difference between two rollouts of one scene in any number."""
    parts: dict[str, float] = {}
    for name, states in first.states.items():
        parts |= parts_apart(one_sign(states) - one_sign(second.states[name]), name)
    for name, nodes_m in first.nodes_m.items():
        parts[f"nodes of {name}"] = float(np.abs(nodes_m - second.nodes_m[name]).max())
    largest = float(np.max([*parts.values()]))
    return Measurement(measured=largest, hint=hint, parts=parts)


def _again_after_reset(
    lab: Lab, scene: Scene, seconds: float
) -> tuple[Recording, Recording]:
    """Return two rollouts of one simulation, which runs with another seed and is reset between them.

    The first sample of the first rollout is from before the first reset.
    """
    with closing(lab.build(scene)) as simulation:
        built = record(simulation, scene, 0.0)
        simulation.reset(None, 0)
        first = record(simulation, scene, seconds)
        simulation.reset(None, 1)
        record(simulation, scene, 0.1)
        simulation.reset(None, 0)
        for name, states in built.states.items():
            first.states[name][0] = states[0]
        for name, nodes in built.nodes_m.items():
            first.nodes_m[name][0] = nodes[0]
        return first, record(simulation, scene, seconds)


@recorded(BOUNCES)
def _bounce_again(lab: Lab) -> tuple[Recording, Recording]:
    return _again_after_reset(lab, bounces(lab), 0.5)


@recorded(STRIP_ON_ROD)
def _cloth_again(lab: Lab) -> tuple[Recording, Recording]:
    return _again_after_reset(lab, strip_on_rod(), 0.2)


@_bounce_again.check("reset-start", tolerance=EXACT)
def _reset_start(pair: tuple[Recording, Recording]) -> Measurement:
    first, second = (rollout.cut(0.0, 0.0) for rollout in pair)
    apart = np.abs(
        [
            one_sign(states[0]) - one_sign(second.states[name][0])
            for name, states in first.states.items()
        ]
    )
    hint = "reset does not restore all positions" if apart[:, :7].any() else ""
    if apart.any() and not hint:
        hint = "velocities are kept"
    return _difference(first, second, hint)


@_bounce_again.check("reset-course", **SAME_SEED)
def _reset_course(pair: tuple[Recording, Recording]) -> Measurement:
    return _difference(*pair)


@Check("determinism", scene=BOUNCES, **SAME_SCENE)
def _determinism(lab: Lab) -> Measurement:
    first, second = (lab.rollout(bounces(lab), 0.5) for _ in range(2))
    return _difference(first, second)


_cloth_again.check("cloth-reset", **SAME_SEED)(_reset_course)


@Check("cloth-determinism", scene=STRIP_ON_ROD, **SAME_SCENE)
def _cloth_determinism(lab: Lab) -> Measurement:
    return _difference(_cloth_again(lab)[0], lab.rollout(strip_on_rod(), 0.2))
