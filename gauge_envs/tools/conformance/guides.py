"""What models of robots state beside hinges: full inertia tensors, sliders, ball joints, limits; and contact forces."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.evaluation.estimators import acceleration_m_per_s2
from gauge_envs.runs.rollout import DeclinedError, Rollout
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    BallJoint,
    Box,
    Hinge,
    Pose,
    RigidBody,
    Scene,
    Slider,
)
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.bench.parts import ball, body, box, contact, fixed_box
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.laws import (
    torque_free_orientation,
    worst_ratio,
)
from gauge_envs.tools.conformance.model import Measurement, recorded, rollout_of
from gauge_envs.tools.conformance.rich import OFF_CENTRE, thrown

# --- a stated tensor -------------------------------------------------------------------------------------------------

MOMENTS_KG_M2 = np.array([4e-4, 7e-4, 9e-4])
PRINCIPAL = Rotation.from_euler("xyz", [25.0, -40.0, 60.0], degrees=True)
TENSOR = PRINCIPAL.as_matrix() @ np.diag(MOMENTS_KG_M2) @ PRINCIPAL.as_matrix().T
SPIN_RAD_PER_S = np.array([3.0, 12.0, -5.0])
TUMBLE_S = 0.5


def _tumbling() -> RigidBody:
    """Return a box that states an inertia whose principal axes are not its own."""
    pose = Pose.from_euler_deg((0.0, 0.0, 1.0), (30.0, 20.0, -50.0))
    one = body("box", Box(size_m=(0.1, 0.06, 0.03)), pose, mass_kg=0.4)
    entries = (*np.diag(TENSOR), TENSOR[0, 1], TENSOR[0, 2], TENSOR[1, 2])
    xx, yy, zz, xy, xz, yz = map(float, entries)
    one = replace(one, inertia_kg_m2=(xx, yy, zz, xy, xz, yz))
    return thrown(one, np.zeros(3), SPIN_RAD_PER_S)


@rollout_of(
    "a box that tumbles without gravity and states an inertia whose principal axes are not its own",
    Scene(bodies=(_tumbling(),), duration_s=TUMBLE_S, gravity_m_per_s2=0.0),
).check("stated-tensor")
def _stated_tensor(rollout: Rollout) -> Measurement:
    start = rollout.scene.body("box").pose.rotation
    last = rollout.rotation("box")[-1]

    def error_deg(tensor: FloatArray) -> float:
        moments, columns = np.linalg.eigh(tensor)
        axes = Rotation.from_matrix(columns * np.linalg.det(columns))
        expected = torque_free_orientation(
            start=start * axes,
            spin_rad_per_s=SPIN_RAD_PER_S,
            moments=moments,
            seconds=TUMBLE_S,
        )
        return float(np.degrees((last * (expected * axes.inv()).inv()).magnitude()))

    diagonal = np.diag(np.diag(TENSOR))
    causes = {
        "the products of inertia are left out": diagonal,
        "the products of inertia have the wrong sign": 2.0 * diagonal - TENSOR,
        "the order of the products of inertia is another one": TENSOR[::-1, ::-1],
    }
    measured = error_deg(TENSOR)
    hint = next((one for one in causes if error_deg(causes[one]) < 0.05 * measured), "")
    return Measurement(measured=measured, hint=hint)


# --- sliders ---------------------------------------------------------------------------------------------------------

SLIDE_AXIS = np.array([0.6, -0.48, -0.64])
STOP_M = 0.05
"""Limit of a slider."""


def _sliding_scene() -> Scene:
    free = body(
        "free", OFF_CENTRE, Pose.from_euler_deg((0.0, 0.0, 1.0), (20.0, 0.0, 40.0))
    )
    stopped = replace(
        free, name="stopped", pose=replace(free.pose, position_m=(1.0, 0.0, 1.0))
    )
    rising = replace(
        free, name="rising", pose=replace(free.pose, position_m=(2.0, 0.0, 1.0))
    )
    axis = vector(SLIDE_AXIS)
    return Scene(
        bodies=(free, stopped, thrown(rising, -1.2 * SLIDE_AXIS)),
        guides=(
            Slider(body="free", axis=axis),
            Slider(body="stopped", axis=axis, limits_m=(-0.2, STOP_M)),
            Slider(body="rising", axis=vector(-SLIDE_AXIS)),
        ),
        duration_s=0.6,
    )


_sliders = rollout_of(
    "three blocks on leaning sliders: one starts at rest, one rises first, and one stops after 50 mm",
    _sliding_scene(),
)


@_sliders.check("slider-fall")
def _slider_fall(rollout: Rollout) -> Measurement:
    ratios = {}
    for name in ("free", "rising"):
        along = rollout.displacement(name) @ SLIDE_AXIS
        found = acceleration_m_per_s2(rollout.times_s, along)
        ratios[f"the {name} block"] = found / (-G * SLIDE_AXIS[2])
    return worst_ratio(ratios, "the acceleration along the axis is")


@_sliders.check("slider-line")
def _slider_line(rollout: Rollout) -> Measurement:
    off_mm, turned_deg = {}, {}
    for one in rollout.scene.bodies:
        moved = rollout.displacement(one.name)
        across = moved - np.outer(moved @ SLIDE_AXIS, SLIDE_AXIS)
        off_mm[one.name] = 1e3 * float(np.linalg.norm(across, axis=1).max())
        turns = rollout.rotation(one.name) * one.pose.rotation.inv()
        turned_deg[one.name] = float(np.degrees(turns.magnitude().max()))
    worst = max(off_mm, key=lambda name: off_mm[name] + turned_deg[name])
    hint = f"the {worst} block leaves its line by {off_mm[worst]:.3g} mm and turns by {turned_deg[worst]:.3g} degrees"
    return Measurement(measured=off_mm[worst] + turned_deg[worst], hint=hint)


@_sliders.check("slider-limit")
def _slider_limit(rollout: Rollout) -> Measurement:
    along = rollout.displacement("stopped") @ SLIDE_AXIS
    last = rollout.between(0.5, 0.6)
    hint = f"it goes as far as {1e3 * along.max():.4g} mm"
    return Measurement(
        measured=1e3 * float(along[last].mean()), expected=1e3 * STOP_M, hint=hint
    )


# --- a hinge with limits ---------------------------------------------------------------------------------------------

HINGE_STOP_RAD = 0.6


@rollout_of(
    "a bar on a hinge at its end, which falls from level to a limit at 0.6 rad",
    Scene(
        bodies=(box("bar", (0.15, 0.0, 1.0), (0.3, 0.03, 0.04)),),
        joints=(
            Hinge(
                body="bar",
                anchor_m=(0.0, 0.0, 1.0),
                axis=(0.0, 1.0, 0.0),
                limits_rad=(-0.1, HINGE_STOP_RAD),
            ),
        ),
        duration_s=1.2,
    ),
).check("hinge-limit")
def _hinge_limit(rollout: Rollout) -> Measurement:
    angles = np.degrees(rollout.rotation("bar").as_rotvec()[:, 1])
    last = rollout.between(1.0, 1.2)
    hint = f"it goes as far as {angles.max():.4g} degrees"
    return Measurement(
        measured=float(angles[last].mean()),
        expected=float(np.degrees(HINGE_STOP_RAD)),
        hint=hint,
    )


# --- a ball joint ----------------------------------------------------------------------------------------------------

CONE_RAD, STRING_M, PIVOT_M = np.radians(35.0), 0.4, np.array([0.1, -0.2, 1.5])
CONE_RAD_PER_S = float(np.sqrt(G / (STRING_M * np.cos(CONE_RAD))))


def _cone_scene() -> Scene:
    arm = STRING_M * np.array([np.sin(CONE_RAD), 0.0, -np.cos(CONE_RAD)])
    spin = np.array([0.0, 0.0, CONE_RAD_PER_S])
    bob = thrown(ball("bob", vector(PIVOT_M + arm)), np.cross(spin, arm), spin)
    joint = BallJoint(body="bob", anchor_m=vector(PIVOT_M))
    return Scene(bodies=(bob,), guides=(joint,), duration_s=2.0)


@rollout_of(
    "a ball on a ball joint 0.4 m above it, which circles at 35 degrees from the vertical",
    _cone_scene(),
).check("ball-joint-cone")
def _ball_joint_cone(rollout: Rollout) -> Measurement:
    arm = rollout.position("bob") - PIVOT_M
    azimuth = np.unwrap(np.arctan2(arm[:, 1], arm[:, 0]))
    rate = float((azimuth[-1] - azimuth[0]) / rollout.times_s[-1])
    length_mm = 1e3 * np.abs(np.linalg.norm(arm, axis=1) - STRING_M).max()
    rise_mm = 1e3 * float(np.ptp(arm[:, 2]))
    hint = f"its height changes by {rise_mm:.3g} mm, and its distance from the joint by {length_mm:.3g} mm"
    return Measurement(measured=rate / CONE_RAD_PER_S, expected=1.0, hint=hint)


# --- contact forces --------------------------------------------------------------------------------------------------

SLIDE_FRICTION = 0.3
MASS_KG = 0.2
WEIGHT_N = MASS_KG * G


@recorded(
    "a brick that rests on two fixed slabs at once, and one that slides on the first with friction 0.3"
)
def _forces(lab: Lab) -> FloatArray:
    """Return the forces on both bricks, and what moves the second one, in 80 intervals, [80, 4, 3]."""
    slab = fixed_box("slab", (0.0, -0.5, -0.05), (4.0, 2.0, 0.1))
    shelf = fixed_box("shelf", (0.0, 1.0, -0.05), (4.0, 1.0, 0.1))
    resting = box("resting", (0.0, 0.5, 0.015), (0.1, 0.08, 0.03))
    sliding = box("sliding", (-1.0, -0.5, 0.015), (0.1, 0.08, 0.03))
    scene = Scene(
        bodies=(slab, shelf, resting, thrown(sliding, (2.4, 0.7, 0.0))),
        contacts=(
            contact(("resting", "sliding"), "slab", friction=SLIDE_FRICTION),
            contact("resting", "shelf", friction=SLIDE_FRICTION),
        ),
        duration_s=0.5,
    )
    pairs = [("resting", "slab"), ("sliding", "slab"), ("resting", "shelf")]
    found = []
    with lab.running(scene) as simulation:
        forces = simulation.contact_forces(pairs)
        if forces is None:
            raise DeclinedError(("contact forces are not read",))
        before = simulation.body_states(["sliding"])[0, 7:10]
        for _ in range(80):
            simulation.advance(SAMPLE_INTERVAL_S)
            after = simulation.body_states(["sliding"])[0, 7:10]
            gained = MASS_KG * ((after - before) / SAMPLE_INTERVAL_S + [0.0, 0.0, G])
            found.append([*forces(), gained])
            before = after
    return np.array(found)


@_forces.check("force-rest")
def _force_rest(found: FloatArray) -> Measurement:
    slab, shelf = found[20:, [0, 2]].mean(axis=0) / WEIGHT_N
    both = slab + shelf
    hint = (
        f"the slab has {slab[2]:.3g} and the other slab {shelf[2]:.3g} of the weight; across it is "
        f"{np.linalg.norm(both[:2]):.3g}"
    )
    return Measurement(measured=float(both[2]), expected=1.0, hint=hint)


@_forces.check("force-slide")
def _force_slide(found: FloatArray) -> Measurement:
    _, force, _, gained = found.mean(axis=0)
    normal, sideways = (
        force[2] / gained[2],
        np.hypot(*force[:2]) / np.hypot(*gained[:2]),
    )
    hint = f"the normal force is {normal:.4g} and the friction {sideways:.4g} of what moves the brick"
    off = np.linalg.norm(found[:, 1] - found[:, 3], axis=1)
    return Measurement(measured=float(off.max()) / WEIGHT_N, hint=hint)
