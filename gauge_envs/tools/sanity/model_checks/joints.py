"""Check what drives and brakes the joints of a robot."""

from collections.abc import Iterator
from copy import copy

import mujoco
import numpy as np

from gauge_envs.pages.text import digits_text
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.sanity.model_checks.check import Fault, rule
from gauge_envs.tools.sanity.model_checks.drives import (
    Drive,
    drags,
    drives,
    largest_loads,
    start,
)
from gauge_envs.tools.sanity.model_checks.runs import finer_solver
from gauge_envs.tools.sanity.robot.robot import Robot, root_of

# --- friction, damping and armature ----------------------------------------------------------------------------------

SLOW_PER_S, SLOW_PER_S2 = 0.1, 0.5
"""Speed and acceleration that any joint reaches: 60 degrees in 10 s, from rest in 0.2 s [rad/s, rad/s^2]."""

STEP_PER_S, STEP_PER_S2 = 3.0, 30.0
"""Speed and acceleration of a leg that steps: half a radian in a swing of 0.2 s, from rest in 0.1 s."""


@rule(
    "robot-joint",
    title="friction, damping and armature of a joint",
    source="force balance of a slow motion: 0.1 rad/s from rest in 0.2 s, in a leg 3 rad/s in 0.1 s; a leg without "
    "power gives way to the whole robot",
    consequence="The policy learns torques that no motor has.",
)
def joint_brakes(robot: Robot) -> Iterator[Fault]:
    """Yield joints whose friction, damping or armature exceeds what moves them."""
    for drive in drives(robot):
        force, angle = drive.units
        dry, damping, armature = drive.dry, drive.damping, drive.armature
        brakes = f"friction {digits_text(dry)}, damping {digits_text(damping)}, armature {armature:.3g}"
        if min(dry, damping, armature) < 0.0:
            yield from drive.faults(
                np.inf, f"{drive.name} has {brakes}: a negative one feeds the motion"
            )
        speed, acceleration = (
            (STEP_PER_S, STEP_PER_S2) if drive.is_leg else (SLOW_PER_S, SLOW_PER_S2)
        )
        brake = drags(robot, speed)[drive.dof] + armature * acceleration * drive.scale
        yield from drive.faults(
            brake / drive.push,
            f"{drive.name} takes {digits_text(brake)} {force} to reach {speed * drive.scale:g} {angle}/s in "
            f"{speed / acceleration:g} s, and its motor makes {digits_text(drive.push)} {force}: {brakes}",
            drive.is_leg,
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

SMALL_MOTION = 1e-5
"""Largest displacement or speed of a motion that is stepped to confirm growth [rad, m, 1/s]."""

GROWTH, GROWTH_STEPS, MAX_RATIO = 3.0, 200, 1.05
"""Growth of a small motion in a number of steps, and its cap in one step: a stable loop has no growth."""


@rule(
    "robot-drive",
    title="response of a servo, over the limit of a drive",
    source="a slow motion without gravity and contact never grows; closed forms of a loop of second order for ringing, "
    "lag and sag",
    consequence="The joint does not do what the policy commands.",
    is_simulated=True,
)
def servo_response(robot: Robot) -> Iterator[Fault]:
    """Yield servos beyond the limit of their kind."""
    driven = [drive for drive in drives(robot) if drive.kp > 0.0]
    # The check robot-joint names joints with too much friction, damping or armature.
    braked = joint_brakes.finding(robot).parts
    driven = [drive for drive in driven if drive.name not in braked]
    yield from _modes(robot, driven)
    for drive in driven:
        yield from _response(drive)


def _modes(robot: Robot, driven: list[Drive]) -> Iterator[Fault]:
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
        text = f"{drive.name} is unstable: a small motion grows {np.abs(ratio):.3g} times in each step of "
        text += f"{1e3 * step_s:g} ms, with kp {digits_text(drive.kp)}, kv {digits_text(drive.kv)}"
        text += "" if drive.armature else ", no armature"
        # With this armature it swings by a radian in a step, with a damping ratio of a half.
        inertia, damping = drive.kp * step_s**2, [drive.kp * step_s, 0.0, 0.0]
        steadier = [("armature", inertia), ("damping", damping)]
        changes = (None,) if drive.armature else steadier
        yield from drive.faults(growth / GROWTH, text, changes=changes)
    for ratio, mode in _eigenmodes(robot):
        rate = np.log(complex(ratio) or 1e-300) / step_s
        is_swing = rate.imag > max(abs(rate.real), MIN_RATE_PER_S)
        if is_swing and np.abs(ratio) ** GROWTH_STEPS < GROWTH:
            drive = drive_of(mode)
            swing_hz, decay_s = rate.imag / (2.0 * np.pi), 1.0 / max(-rate.real, 1e-6)
            text = f"{drive.name} swings about its command with {swing_hz:.2g} Hz"
            text += f" for {decay_s:.2g} s" if decay_s < ENDLESS_S else " without end"
            ringing = RINGING * decay_s * abs(rate)
            yield from drive.faults(min(ringing, decay_s / RINGING_S), text, True)


def _eigenmodes(
    robot: Robot, *features: str
) -> Iterator[tuple[np.complex128, FloatArray]]:
    """Yield eigenvalues and modes of a step where all servos are at rest, with some more features switched off."""
    model = robot.without("contact", "gravity", "limit", "spring", *features)
    # Couplings damp: their forces are differentiated too.
    model = finer_solver(model)
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
    for ratio, mode in zip(ratios, modes.T, strict=True):
        is_growing = min(np.abs(ratio), MAX_RATIO) ** GROWTH_STEPS >= GROWTH
        if not is_growing or _grows(model, data, mode):
            yield ratio, mode


def _grows(model: mujoco.MjModel, data: mujoco.MjData, mode: FloatArray) -> bool:
    """Return whether a small motion along a mode grows: derivatives of stiff constraints can be wrong."""
    offset = SMALL_MOTION * np.real(mode / mode[np.argmax(np.abs(mode))])
    moved, rest = copy(data), copy(data)
    mujoco.mj_integratePos(model, moved.qpos, offset[: model.nv], 1.0)
    moved.qvel += offset[model.nv : 2 * model.nv]
    limit = GROWTH**0.5 * length_of(moved.qvel - rest.qvel)
    for _ in range(GROWTH_STEPS):
        for each in (moved, rest):
            mujoco.mj_step(model, each)
        # A speed that is no number has grown too.
        if not length_of(moved.qvel - rest.qvel) <= limit:
            return True
    return False


def _response(drive: Drive) -> Iterator[Fault]:
    robot, (force, angle) = drive.robot, drive.units
    damping, kp = drive.damping + drive.kv, drive.kp
    servo = f"kp {digits_text(kp)} {force}/{angle}"
    # Overdamped, a servo covers half of a step in ln(2) damping / kp.
    half_s = np.log(2.0) * damping / kp
    text = f"{drive.name} covers half of a small step in {half_s:.2g} s: {servo}, damping {digits_text(damping)}"
    yield from drive.faults(half_s / SLOW_S, text, True)
    weight = largest_loads(robot)[drive.dof]
    is_floating = (
        robot.model.body_dofnum[root_of(robot.model, drive.body)] == 6 and kp != 1.0
    )
    if drive.is_hinge and not is_floating:
        yield from drive.faults(
            weight / kp / SAG_RAD,
            f"{drive.name} sags by up to {weight / kp:.2g} rad: {servo} carries {digits_text(weight)} N m"
            f"{', the default kp of MuJoCo' if kp == 1.0 else ''}",
            True,
        )
