"""Changes of servos and of the solver that may mend rows of a robot."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from gauge_envs.tools.sanity.robot.behaviour import FAIR_STEP_S
from gauge_envs.tools.sanity.robot.finding import judged_row, limits_of, of_elements
from gauge_envs.tools.sanity.robot.joints import (
    dof_of,
    driven_dofs,
    position_servos,
    servos,
    springs,
    stiffness,
)
from gauge_envs.tools.sanity.robot.mended_model import element_names, listed
from gauge_envs.tools.sanity.robot.remedy import (
    Remedy,
    elements_remedy,
    remedies_of,
    rounded,
)
from gauge_envs.tools.sanity.robot.robot import Robot
from gauge_envs.tools.sanity.robot.rollout import (
    SOFT_MRAD,
    deflecting_nm,
    has_stiff_servos,
    lone_half_step_s,
    servo_responses,
)
from gauge_envs.tools.sanity.robot.row_remedies import (
    PER_DEGREE,
    drag_remedies,
    gear_remedies,
    rotor_remedies,
    weights_nm,
)
from gauge_envs.tools.sanity.robot.rows import ROWS

MOST_FACTOR = 10.0
"""Factor of a gain up to which it is advised without a unit that explains it."""

LARGEST_SAG_RAD = 0.15
"""Largest angle by which the weight may deflect a servo whose gain is scaled [rad]."""


SHARES = (0.5, 0.25, 0.1, 0.05, 0.02, 0.01)
"""Factors of gains that are tried, the largest first."""


def gains(
    robot: Robot, actuators: Sequence[int], *, kp: float = 1.0, kv: float = 1.0
) -> Remedy:
    """Return servos with other gains.

    Args:
        robot: The robot.
        actuators: Its servos.
        kp: Factor of the stiffness.
        kv: Factor of the damping of the servo.
    """
    model, changes = robot.model, {}
    factors = np.array([kp, kp, kv] + [1.0] * (model.actuator_biasprm.shape[1] - 3))
    for a in actuators:
        gain = model.actuator_gainprm[a].copy()
        gain[0] *= kp
        changes[f"actuator_gainprm[{a}]"] = gain
        changes[f"actuator_biasprm[{a}]"] = model.actuator_biasprm[a] * factors
    parts = [f"{n} times {v:.3g}" for n, v in (("kp", kp), ("kv", kv)) if v != 1.0]
    if kp == kv:
        parts = [f"kp and kv times {kp:.3g}"]
    every = set(actuators) == set(np.flatnonzero(servos(model)).tolist())
    where = (
        "all servos" if every else listed(element_names(robot, "actuator", actuators))
    )
    return Remedy(text=f"{' and '.join(parts)} for {where}", changes=changes)


def _bears(robot: Robot, actuators: Sequence[int], scale: float) -> bool:
    """Return whether servos with a scaled stiffness still hold the robot's weight."""
    weights = weights_nm(robot)
    dofs = {dof_of(robot, actuator) for actuator in actuators}
    return all(
        scale * stiffness(robot.model, dof) * LARGEST_SAG_RAD >= weights[dof]
        for dof in dofs
    )


def _scaled(
    robot: Robot, actuators: Sequence[int], shares: Sequence[float], power: float
) -> Iterator[Remedy]:
    """Yield smaller gains that still hold the robot's weight; kv is scaled by a power of the factor of kp."""
    if len(actuators) == 0:
        return
    for share in shares:
        if _bears(robot, actuators, share):
            remedy = gains(robot, actuators, kp=share, kv=share**power)
            yield replace(remedy, scales_gains=True)


@remedies_of("robot-stiffness")
def _stiff(robot: Robot) -> Iterator[Remedy]:
    low_mrad = limits_of("robot-stiffness")[0]
    limits = driven_dofs(robot)
    stiff = [
        a
        for a in position_servos(robot)
        if 1e3 * limits[dof_of(robot, a)]
        < low_mrad * stiffness(robot.model, dof_of(robot, a))
    ]
    yield from _units(robot, stiff)
    yield from _units(robot, position_servos(robot))
    yield from _scaled(robot, stiff, SHARES, 0.5)


def _units(robot: Robot, actuators: Sequence[int]) -> Iterator[Remedy]:
    """Yield gains that were meant per degree or in N mm."""
    for unit in (PER_DEGREE, 1e3) if actuators else ():
        if _bears(robot, actuators, 1.0 / unit):
            yield gains(robot, actuators, kp=1.0 / unit)
            yield gains(robot, actuators, kp=1.0 / unit, kv=1.0 / unit)


def _integrator(robot: Robot) -> dict[str, Any]:
    implicit = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    is_explicit = robot.model.opt.integrator != implicit
    return {"integrator": "implicitfast"} if is_explicit else {}


@remedies_of(
    *("robot-holds", "robot-stands", "robot-loads", "robot-energy", "robot-slip")
)
def _solver(robot: Robot) -> Iterator[Remedy]:
    """Yield the implicit integrator, then shorter steps with it."""
    option = _integrator(robot)
    text = 'integrator="implicitfast"' if option else ""
    if option:
        yield Remedy(text=f"<option {text}/>", changes=option)
    step_s = float(robot.model.opt.timestep)
    for shorter_s in (0.01, 0.005, 0.002, 0.001):
        if 0.1 * step_s <= shorter_s < step_s:
            words = f'timestep="{shorter_s:g}" {text}'.strip()
            yield Remedy(
                text=f"<option {words}/>", changes={"timestep_s": shorter_s} | option
            )


@remedies_of("robot-servo")
def _servo(robot: Robot) -> Iterator[Remedy]:
    if judged_row("robot-stiffness", ROWS["robot-stiffness"](robot)).is_flag:
        yield from _stiff(robot)
    yield from rotor_remedies(robot)
    yield from _solver(robot)
    option = _integrator(robot)
    for one in _scaled(robot, position_servos(robot), SHARES, 1.0):
        text = (
            f'<option integrator="implicitfast"/> and {one.text}'
            if option
            else one.text
        )
        yield replace(one, text=text, changes=option | dict(one.changes))


@remedies_of("robot-sag")
def _sag(robot: Robot) -> Iterator[Remedy]:
    high_mrad = limits_of("robot-sag")[1]
    weights = deflecting_nm(robot)
    sags_mrad = {
        a: 1e3
        * float(weights[dof_of(robot, a)])
        / stiffness(robot.model, dof_of(robot, a))
        for a in position_servos(robot)
    }
    soft = [a for a, sag_mrad in sags_mrad.items() if sag_mrad > high_mrad]
    if not soft:
        return
    joints = [int(robot.model.actuator_trnid[a, 0]) for a in soft]
    sprung = [joint for joint in joints if springs(robot.model)[joint]]
    without = of_elements("jnt_stiffness", dict.fromkeys(sprung, 0.0))
    for one in elements_remedy(robot, without):
        # A spring that pulls a servo back makes no fair step.
        yield replace(one, fair_step_s=FAIR_STEP_S)
    yield from gear_remedies(robot)
    every = position_servos(robot)
    largest_mrad = max(sags_mrad[a] for a in soft)
    per_degree = (every, soft) if len(soft) < len(every) else (every,)
    # Soft gains that are meant would make a servo stiffer than those of makers.
    for several in per_degree if largest_mrad > SOFT_MRAD else ():
        yield gains(robot, several, kp=PER_DEGREE)
        yield gains(robot, several, kp=PER_DEGREE, kv=PER_DEGREE)
    scale = rounded(largest_mrad / (0.3 * high_mrad))
    for kv in (1.0, rounded(scale**0.5), scale) if scale <= MOST_FACTOR else ():
        yield gains(robot, soft, kp=scale, kv=kv)


@remedies_of("robot-ringing")
def _ringing(robot: Robot) -> Iterator[Remedy]:
    """Yield another unit of kv, then that with which the loop has a damping ratio of 0.7, or of 0.3."""
    low = limits_of("robot-ringing")[0]
    model, responses = robot.model, servo_responses(robot)
    ringing = [
        a for a in position_servos(robot) if responses[dof_of(robot, a)][0] < low
    ]
    yield gains(robot, ringing, kv=PER_DEGREE)
    for ratio in (0.7, 0.3):
        changes = {}
        for a in ringing:
            dof = dof_of(robot, a)
            kp, band_hz = stiffness(model, dof), responses[dof][1]
            # The bandwidth of a loop that rings is 1.55 times its natural frequency.
            natural_per_s = 2.0 * np.pi * band_hz / np.sqrt(1.0 + np.sqrt(2.0))
            bias = model.actuator_biasprm[a].copy()
            gear = float(model.actuator_gear[a, 0])
            bias[2] = -rounded(2.0 * ratio * kp / natural_per_s / gear**2)
            changes[f"actuator_biasprm[{a}]"] = bias
        yield from elements_remedy(robot, changes)


@remedies_of("robot-lag")
def _lag(robot: Robot) -> Iterator[Remedy]:
    low_ms, high_ms = limits_of("robot-lag")
    alone_ms = {
        a: 1e3 * lone_half_step_s(robot, a, dof_of(robot, a))
        for a in position_servos(robot)
    }
    fast = [a for a, half_ms in alone_ms.items() if half_ms < low_ms]
    slow = [a for a, half_ms in alone_ms.items() if high_ms < half_ms < np.inf]
    if fast:
        yield from rotor_remedies(robot)
        yield from _units(robot, fast)
        scale = min(alone_ms[a] for a in fast) / (1.5 * low_ms)
        shares = [rounded(scale**2), *SHARES]
        yield from _scaled(robot, fast, shares, 0.5)
    if slow:
        if has_stiff_servos(robot):
            yield from _units(robot, position_servos(robot))
        for unit in (PER_DEGREE, 1e3):
            yield gains(robot, slow, kv=1.0 / unit)
        for dof in (dof_of(robot, a) for a in slow[:1]):
            drag = float(robot.model.dof_damping[dof])
            if drag > 0.0:
                yield from drag_remedies(robot, "damping", (PER_DEGREE,))
        scale = rounded(max(alone_ms[a] for a in slow) / (0.3 * high_ms))
        if scale <= MOST_FACTOR:
            yield gains(robot, slow, kv=rounded(1.0 / scale))
            yield gains(robot, slow, kp=scale)
