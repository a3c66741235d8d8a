"""Check what drives and brakes the joints of a robot."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model_checks.check import (
    Case,
    Finding,
    model_check,
    worst_case,
)
from gauge_envs.tools.sanity.model_checks.drives import (
    Drive,
    drags,
    drives,
    largest_loads,
    servos,
    start,
)
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    joints_of,
    name_of,
    reaches_m,
    root_of,
)
from gauge_envs.tools.sanity.robot.standing import LIQUID_KG_PER_M3
from gauge_envs.tools.sanity.verdict import NotApplicableError

# --- friction, damping and armature ----------------------------------------------------------------------------------

SLOW_PER_S, SLOW_PER_S2 = 0.1, 0.5
"""Speed and acceleration that any joint reaches: 60 degrees in 10 s, from rest in 0.2 s [rad/s, rad/s^2]."""

STEP_PER_S, STEP_PER_S2 = 3.0, 30.0
"""Speed and acceleration of a leg that steps: half a radian in a swing of 0.2 s, from rest in 0.1 s."""


@model_check(
    "robot-joint",
    title="friction, damping and armature of a joint",
    interval=(0.0, 1.0),
    source="force balance of a slow motion: 0.1 rad/s from rest in 0.2 s, in a leg 3 rad/s in 0.1 s; a leg without "
    "power gives way to the whole robot; a rotor is rarely heavier than the whole robot where no torque moves it",
    consequence="The policy learns torques that no motor has.",
)
def joint_brakes(robot: Robot) -> Finding:
    """Return the joint whose friction, damping or armature most exceeds what moves it."""
    if not drives(robot):
        raise NotApplicableError("no motor acts on a joint")
    return worst_case(case for drive in drives(robot) for case in _brakes(drive))


def _brakes(drive: Drive) -> Iterator[Case]:
    robot, (force, angle), model = drive.robot, drive.units, drive.robot.model
    root, reaches = root_of(model, drive.body), reaches_m(robot)
    dry, damping, armature = drive.dry, drive.damping, drive.armature
    brakes = f"{drive.name}: friction {dry:.3g}, damping {damping:.3g}, armature {armature:.3g}"
    if min(dry, damping, armature) < 0.0:
        yield drive.case(np.inf, f"{brakes}: a negative one feeds the motion")
    speed, acceleration = (
        (STEP_PER_S, STEP_PER_S2) if drive.is_leg else (SLOW_PER_S, SLOW_PER_S2)
    )
    brake = drags(robot, speed)[drive.dof] + armature * acceleration * drive.scale
    yield drive.case(
        brake / drive.push,
        f"{brakes} take {brake:.3g} {force} at {speed * drive.scale:g} {angle}/s; its motor makes {drive.push:.3g}",
    )
    if not drive.is_hinge:
        return
    # The rotor of a slide moves through a screw, whose gear makes it heavier than any robot.
    if not np.isfinite(drive.limit):
        whole = model.body_subtreemass[root] * reaches[root] ** 2
        yield drive.case(
            armature / whole,
            f"{drive.name} has an armature of {armature:.3g} kg m^2 and no torque limit; the robot has {whole:.2g}",
            True,
        )


# --- servos ----------------------------------------------------------------------------------------------------------

ENDLESS_S = 1000.0
"""Decay time above which nothing damps a swing [s]."""

RINGING, RINGING_S = 0.05, 1.0
"""Damping ratio and decay time of a servo that rings: at 0.05 a step overshoots by 85 %; makers have 0.089."""

SLOW_S = 2.0
"""Longest time in which a servo covers half of a small step [s]: 10 times the slowest hobby servo's."""

SAG_RAD = 0.6
"""Error at which a servo carries its limb [rad]: twice that of the softest model of a maker, TALOS with 0.296."""

MIN_RATE_PER_S = 1.0
"""Angular frequency below which a mode is of a free body and not of a servo [1/s]."""

GROWTH, GROWTH_STEPS, MAX_RATIO = 3.0, 200, 1.05
"""Growth of a small motion in a number of steps, and its cap in one step: a stable loop has no growth."""


@model_check(
    "robot-drive",
    title="response of a servo, over the limit of a drive",
    interval=(0.0, 1.0),
    source="a slow motion without gravity and contact never grows; closed forms of a loop of second order for ringing, "
    "lag and sag",
    consequence="The joint does not do what the policy commands.",
    is_simulated=True,
)
def servo_response(robot: Robot) -> Finding:
    """Return the servo farthest beyond the limit of its kind."""
    driven = [drive for drive in drives(robot) if drive.kp > 0.0]
    if not driven and not servos(robot.model).any():
        raise NotApplicableError("no servo holds a position")
    # The check robot-joint names joints with too much friction, damping or armature.
    braked = joint_brakes.finding(robot).parts if driven else {}
    driven = [drive for drive in driven if braked.get(drive.name, 0.0) <= 1.0]
    responses = (case for drive in driven for case in _response(drive))
    return worst_case([*_modes(robot, driven), *responses])


def _modes(robot: Robot, driven: list[Drive]) -> Iterator[Case]:
    """Yield the small motions of a robot about its commands in the engine that grow or swing.

    Dry friction damps a swing, but holds no motion that grows once a command has overcome it: growth is read without. A
    mode belongs to the servo with the largest share of its energy.
    """
    if not driven:
        return
    step_s = robot.model.opt.timestep

    def drive_of(mode: FloatArray) -> Drive:
        energies = [drive.kp * abs(mode[drive.dof]) ** 2 for drive in driven]
        return driven[int(np.argmax(energies))]

    for ratio, mode in _eigenmodes(robot, "frictionloss"):
        growth, drive = min(np.abs(ratio), MAX_RATIO) ** GROWTH_STEPS, drive_of(mode)
        text = f"a small motion of {drive.name} grows by {np.abs(ratio) - 1.0:.2g} of itself in a step of "
        text += f"{1e3 * step_s:g} ms: kp {drive.kp:.4g}, kv {drive.kv:.3g}"
        text += "" if drive.armature else ", no armature"
        yield drive.case(growth / GROWTH, text)
    for ratio, mode in _eigenmodes(robot):
        rate = np.log(complex(ratio) or 1e-300) / step_s
        is_swing = rate.imag > max(abs(rate.real), MIN_RATE_PER_S)
        if is_swing and np.abs(ratio) ** GROWTH_STEPS < GROWTH:
            drive = drive_of(mode)
            swing_hz, decay_s = rate.imag / (2.0 * np.pi), 1.0 / max(-rate.real, 1e-6)
            text = f"{drive.name} swings about its command with {swing_hz:.2g} Hz"
            text += f" for {decay_s:.2g} s" if decay_s < ENDLESS_S else " without end"
            ringing = RINGING * decay_s * abs(rate)
            yield drive.case(min(ringing, decay_s / RINGING_S), text, True)


def _eigenmodes(
    robot: Robot, *features: str
) -> Iterator[tuple[np.complex128, FloatArray]]:
    """Yield eigenvalues and modes of a step where all servos are at rest, with some more features switched off."""
    model = robot.without(
        "contact", "gravity", "limit", "spring", "equality", *features
    )
    if model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_RK4):
        # MuJoCo differentiates no steps of RK4, which is as stable as this one.
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data, size = start(robot, model), 2 * model.nv + model.na
    low, high = model.actuator_ctrlrange.T
    data.ctrl[:] = np.clip(0.0, low, high) * (model.actuator_ctrllimited != 0)
    gain, bias = model.actuator_gainprm[:, 0], model.actuator_biasprm
    forces = gain * data.ctrl + bias[:, 1] * data.actuator_length
    is_affine = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    bias[is_affine, 0] = -forces[is_affine]
    transition = np.zeros((size, size))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, transition, None, None, None)
    ratios, modes = np.linalg.eig(np.nan_to_num(transition))
    yield from zip(ratios, modes.T, strict=True)


def _response(drive: Drive) -> Iterator[Case]:
    robot, (force, angle) = drive.robot, drive.units
    damping, kp = drive.damping + drive.kv, drive.kp
    servo = f"kp {kp:.3g} {force}/{angle}"
    # Overdamped, a servo covers half of a step in ln(2) damping / kp.
    half_s, limit_s = np.log(2.0) * damping / kp, SLOW_S
    text = f"{drive.name} covers half of a small step in {half_s:.2g} s: {servo}, damping {damping:.3g}"
    if drive.is_leg and robot.standing is not None:
        limit_s = np.sqrt(robot.standing.height_m / GRAVITY_M_PER_S2)
        text += f"; the robot falls in {limit_s:.2g} s"
    yield drive.case(half_s / limit_s, text, True)
    weight = largest_loads(robot)[drive.dof]
    is_floating = (
        robot.model.body_dofnum[root_of(robot.model, drive.body)] == 6 and kp != 1.0
    )
    if drive.is_hinge and not is_floating:
        text = f"{drive.name} sags by {weight / kp:.2g} rad: {servo} carries {weight:.3g} N m"
        if kp == 1.0:
            text += ", MuJoCo's default kp"
        yield drive.case(weight / kp / SAG_RAD, text, True)


# --- free joints ---------------------------------------------------------------------------------------

FREE_SHARE = 0.05
"""Share of its speed that a free base may lose in 1 s: air takes less from anything heavier than a balloon."""


@model_check(
    "robot-free",
    title="share of its speed that a free joint takes in 1 s",
    interval=(0.0, FREE_SHARE),
    source='nothing holds a base in the air; defaults of joints apply to <joint type="free"> and not to <freejoint>',
    consequence="The policy learns to turn and fall slower than the robot does.",
    is_usual=True,
)
def free_joint_drag(robot: Robot) -> Finding:
    """Return the free joint with the largest friction, damping or armature."""
    model = robot.model
    # A ball may be braked to keep it from rolling: only robots count.
    bases = {root_of(model, drive.body) for drive in drives(robot)}
    is_base = joints_of(model, "FREE") & np.isin(model.jnt_bodyid, list(bases))
    if not is_base.any() or model.opt.density > LIQUID_KG_PER_M3:
        raise NotApplicableError("no robot is free in air")
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, start(robot), matrix)
    damping = np.atleast_2d(model.dof_damping.T)[0]
    dry, armature = model.dof_frictionloss, model.dof_armature
    brakes, inertia = np.maximum(damping + dry, armature), np.diag(matrix) - armature
    cases = []
    for joint in np.flatnonzero(is_base).tolist():
        first = model.jnt_dofadr[joint]
        six = slice(first, first + 6)
        name = name_of(model, "body", int(model.jnt_bodyid[joint]))
        text = f"{name} is braked in the air by damping {damping[first]:g}, friction {dry[first]:g}, "
        text += f"armature {armature[first]:g}"
        share = (brakes[six] / inertia[six]).max()
        cases.append(Case(share, ("joint", joint), name, text))
    return worst_case(cases, limit=FREE_SHARE)
