"""Joints: dry and viscous friction, armature, motors, and a chain of two bars that hangs on the world.

Every bar hangs on a horizontal hinge. Its angle is counted from the vertical, about the axis of the hinge. With the
inertia I about the hinge, the mass m and the distance c of its centre from the hinge, it obeys

    (I + armature) angle'' = motor - m g c sin(angle) - dry sign(angle') - viscous angle'

and a bar at rest stays at rest while the other torques together are at most the dry friction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.signal import argrelmax
from scipy.spatial.transform import Rotation

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, BodyHinge, Box, Hinge, JointDynamics, Pose, RigidBody, Scene
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.motors import Motor, Servo, TorqueMotor
from gauge_envs.tools.conformance.lab import Lab, body, ramp
from gauge_envs.tools.conformance.laws import (
    acceleration_m_per_s2,
    box_inertia_kg_m2,
    mean_period_s,
    pendulum_period_s,
)
from gauge_envs.tools.conformance.model import Check, Measurement, Tolerance, rollout_of

Array = NDArray[np.float64]

PIVOT_M, AXIS = np.array([0.1, 0.2, 1.0]), np.array([0.6, 0.8, 0.0])
MASS_KG, CENTRE_M, SIZE_M = 0.4, 0.15, (0.03, 0.03, 0.3)
"""A bar, and the distance of its centre from the hinge: its upper end is at the hinge."""


def _bar(name: str = "bar", angle_rad: float = 0.0, pivot_m: Array = PIVOT_M) -> RigidBody:
    turn = Rotation.from_rotvec(angle_rad * AXIS)
    place = pivot_m + turn.apply([0.0, 0.0, -CENTRE_M])
    return body(name, Box(size_m=SIZE_M), Pose.from_rotation(vector(place), turn), mass_kg=MASS_KG)


ABOUT_CENTRE = float(box_inertia_kg_m2(_bar()) @ AXIS**2)
INERTIA = ABOUT_CENTRE + MASS_KG * CENTRE_M**2
"""Moments of inertia of a bar about its centre and about its hinge [kg m^2]."""
WEIGHT_N_M = MASS_KG * G * CENTRE_M
"""Torque of the weight of a level bar [N m]."""


def _scene(
    *bars: RigidBody, seconds: float, gravity: float = G, motor: Motor | None = None, **dynamics: float
) -> Scene:
    friction = JointDynamics(**dynamics)
    pivot, axis = vector(PIVOT_M), vector(AXIS)
    hinges = (Hinge(body=bar.name, anchor_m=pivot, axis=axis, dynamics=friction, motor=motor) for bar in bars)
    return Scene(bodies=bars, joints=tuple(hinges), duration_s=seconds, gravity_m_per_s2=gravity)


def _turned_rad(rollout: Rollout, name: str = "bar") -> Array:
    """Return the angle of a bar from its start [rad], at most half a turn, shape [T]."""
    rotations = rollout.rotation(name)
    return np.asarray((rotations * rotations[0].inv()).as_rotvec() @ AXIS)


def _stays(amount: float) -> Any:
    """Return a command that steps to an amount at the start and stays."""
    return ramp(amount, start_s=0.0, duration_s=1e-6, ramp_s=0.0)


def joint_angle_rad(
    times_s: Array, torque: Callable[[float, float], float], *, inertia: float, start_rad: float, dry: float
) -> Array:
    """Return the angle of a joint that starts at rest, by DOP853 from each stop to the next one [rad], shape [T].

    Args:
        times_s: Times from 0 on [s], shape [T].
        torque: Torque of all but dry friction, of the angle [rad] and the rate [rad/s]; it does not change in time.
        inertia: Moment of inertia with the armature [kg m^2].
        start_rad: Angle at the start.
        dry: Dry friction [N m].
    """
    angles, time, angle = np.full(len(times_s), start_rad), 0.0, start_rad
    while time < times_s[-1] and abs(torque(angle, 0.0)) > dry:
        way = float(np.sign(torque(angle, 0.0)))

        def rates(_: float, state: Array, way: float = way) -> list[float]:
            return [state[1], (torque(*state) - way * dry) / inertia]

        def stop(_: float, state: Array) -> float:
            return float(state[1])

        stop.terminal, stop.direction = True, -way  # type: ignore[attr-defined]
        span, exact = (time, float(times_s[-1])), {"rtol": 1e-9, "atol": 1e-12, "method": "DOP853"}
        run = solve_ivp(rates, span, [angle, 0.0], events=stop, dense_output=True, max_step=0.01, **exact)
        later = times_s >= time
        angles[later] = run.sol(np.minimum(times_s[later], run.t[-1]))[0]
        time, angle = float(run.t[-1]), float(run.y[0, -1])
    return angles


# --- friction and armature -------------------------------------------------------------------------------------------

DRY_N_M, VISCOUS, ARMATURE, RELEASE_RAD = 0.02, 0.02, 0.01, 0.5
FRICTION = Tolerance("as for a slide: the error must be well below the scatter of real friction", relative=0.01)

_dry = rollout_of(
    "a bar of 0.4 kg on a hinge with a dry friction of 0.02 N m, released at 0.5 rad",
    _scene(_bar(angle_rad=RELEASE_RAD), seconds=2.5, dry_friction_n_m=DRY_N_M),
)


@_dry.check(
    "joint-dry",
    title="dry friction of a joint",
    measures="energy that a swinging bar loses between its first stop and its last one within 2.5 s, over the angle "
    "between its stops",
    law="loss = dry friction times angle, 4 dry / (m g c) of the amplitude in a small cycle",
    source="Coulomb",
    unit="N m",
    tolerance=FRICTION,
    diagnosis="check the unit of the joint's friction, that it does not depend on speed or load, and damping",
)
def _joint_dry(rollout: Rollout) -> Measurement:
    angles = RELEASE_RAD + _turned_rad(rollout)
    tops = [0, *argrelmax(np.abs(angles))[0]]
    heights = [float(np.cos(angles[top])) for top in tops]
    between = float(np.abs(np.diff(angles[tops])).sum())
    loss = WEIGHT_N_M * (heights[-1] - heights[0])
    return Measurement(measured=loss / between if len(tops) > 1 else np.nan, expected=DRY_N_M)


HOLD_N_M, HELD_RAD, SLIPPING_RAD = 0.3, float(np.arcsin(0.24 / WEIGHT_N_M)), float(np.arcsin(0.375 / WEIGHT_N_M))
"""A dry friction, and the angles at which the weight has 0.8 and 1.25 times as much torque."""

_held = rollout_of(
    "two bars at rest on hinges with a dry friction of 0.3 N m, whose weights exert 0.24 and 0.375 N m",
    _scene(_bar("held", HELD_RAD), _bar("slipping", SLIPPING_RAD), seconds=1.0, dry_friction_n_m=HOLD_N_M),
)


@_held.check(
    "joint-stick",
    title="dry friction holds a joint",
    measures="largest angle by which the first bar turns within 1 s",
    law="it rests while |torque| <= dry friction",
    source="Coulomb",
    unit="deg",
    tolerance=Tolerance("0.1 mm at the end of the bar, as for a cube that holds", absolute=0.02),
    diagnosis="friction is regularized: it is viscous at low speed, and the joint creeps",
)
def _joint_stick(rollout: Rollout) -> Measurement:
    return Measurement(measured=float(np.degrees(np.abs(_turned_rad(rollout, "held")).max())))


@_held.check(
    "joint-slip",
    title="more than dry friction turns a joint",
    measures="angle by which the second bar turns within 1 s",
    law="I angle'' = -m g c sin(angle) - dry sign(angle')",
    source="Coulomb, integrated by scipy's DOP853",
    unit="deg",
    tolerance=Tolerance("1 % of the friction, as for a slide, is 4 % of what is left of the torque", relative=0.04),
    diagnosis="where joint-dry passes, friction at rest is larger than in motion",
)
def _joint_slip(rollout: Rollout) -> Measurement:
    expected = joint_angle_rad(
        rollout.times_s,
        lambda angle, rate: -WEIGHT_N_M * np.sin(angle),
        inertia=INERTIA,
        start_rad=SLIPPING_RAD,
        dry=HOLD_N_M,
    )
    measured = float(np.degrees(_turned_rad(rollout, "slipping")[-1]))
    return Measurement(measured=measured, expected=float(np.degrees(expected[-1] - SLIPPING_RAD)))


RATE_RAD_PER_S = 3.0
_spinning = replace(
    _bar(),
    linear_velocity_m_per_s=vector(np.cross(RATE_RAD_PER_S * AXIS, [0.0, 0.0, -CENTRE_M])),
    angular_velocity_rad_per_s=vector(RATE_RAD_PER_S * AXIS),
)
_slowing = rollout_of(
    "a bar on a hinge with a viscous friction of 0.02 N m s/rad, which starts with 3 rad/s, without gravity",
    _scene(_spinning, seconds=1.0, gravity=0.0, viscous_friction_n_m_s_per_rad=VISCOUS),
)


@_slowing.check(
    "joint-viscous",
    title="viscous friction of a joint",
    measures="inertia over the time in which the rate falls to 1/e, of the logarithm of the rate over 1 s",
    law="rate = rate0 exp(-viscous t / I)",
    source="Newton",
    unit="N m s/rad",
    tolerance=FRICTION,
    diagnosis="check the unit of the joint's damping (radians), and damping of bodies",
)
def _joint_viscous(rollout: Rollout) -> Measurement:
    rate = np.maximum(rollout.angular_velocity("bar") @ AXIS, 1e-6)
    fall = np.polyfit(rollout.times_s, np.log(rate), 1)[0]
    return Measurement(measured=float(-INERTIA * fall), expected=VISCOUS)


_heavy = rollout_of(
    "a bar on a hinge with an armature of 0.01 kg m^2, released at 0.5 rad",
    _scene(_bar(angle_rad=RELEASE_RAD), seconds=4.0, armature_kg_m2=ARMATURE),
)


@_heavy.check(
    "joint-armature",
    title="armature of a joint",
    measures="mean period of the swinging bar over 4 s",
    law="T = 4 sqrt((I + armature) / (m g c)) K(sin^2(theta / 2))",
    source="physical pendulum, complete elliptic integral",
    unit="s",
    tolerance=Tolerance("as for the pendulum without armature", relative=2e-3),
    diagnosis="the armature adds to the inertia about the axis alone, and the weight does not act on it",
)
def _joint_armature(rollout: Rollout) -> Measurement:
    gyration = float(np.sqrt((ABOUT_CENTRE + ARMATURE) / MASS_KG))
    expected = pendulum_period_s(length_m=CENTRE_M, gyration_m=gyration, amplitude_rad=RELEASE_RAD, gravity_m_per_s2=G)
    return Measurement(measured=mean_period_s(rollout.times_s, RELEASE_RAD + _turned_rad(rollout)), expected=expected)


# --- motors ----------------------------------------------------------------------------------------------------------

TORQUE_N_M, DELAY_S = 0.03, 0.1
STEP_RAD, KP, KV, LIMIT_N_M = 0.3, 2.0, 0.05, 0.03
ENCODER = Tolerance("a servo's encoder of 4096 counts resolves 0.09 degrees; this is twice as much", absolute=0.18)

_pushed = rollout_of(
    "a bar on a hinge without gravity, whose motor exerts 0.03 N m from 0.1 s on: a step at the start with this delay",
    _scene(_bar(), seconds=0.8, gravity=0.0, motor=TorqueMotor(command=_stays(TORQUE_N_M), delay_s=DELAY_S)),
)


def _parabola(rollout: Rollout) -> Array:
    """Return the coefficients of a parabola through the angle from 0.15 s on, the highest power first."""
    part = rollout.between(0.15, rollout.times_s[-1])
    return np.polyfit(rollout.times_s[part], _turned_rad(rollout)[part], 2)


@_pushed.check(
    "joint-torque",
    title="torque motor",
    measures="angular acceleration of the bar from 0.15 to 0.8 s",
    law="angle'' = torque / I",
    source="Newton",
    unit="rad/s^2",
    tolerance=Tolerance("nothing else acts, as for a force on a free body", relative=1e-3),
    diagnosis="check the sign of the axis, the unit of the torque, and damping",
)
def _joint_torque(rollout: Rollout) -> Measurement:
    return Measurement(measured=2.0 * float(_parabola(rollout)[0]), expected=TORQUE_N_M / INERTIA)


@_pushed.check(
    "joint-delay",
    title="delay of a motor",
    measures="time at which the parabola through the angle starts",
    law="angle = torque (t - delay)^2 / 2 I",
    source="contract (World.command)",
    unit="ms",
    tolerance=Tolerance("half of an interval of 1/180 s", absolute=2.7),
    diagnosis="command() acts on the next advance(), not on the one after it",
)
def _joint_delay(rollout: Rollout) -> Measurement:
    square, slope, _ = _parabola(rollout)
    return Measurement(measured=-500.0 * float(slope / square), expected=1e3 * DELAY_S)


_stepped = rollout_of(
    "a bar on a hinge without gravity, with a servo of 2 N m/rad and 0.05 N m s/rad, whose command steps by 0.3 rad",
    _scene(
        _bar(),
        seconds=1.0,
        gravity=0.0,
        motor=Servo(command=_stays(STEP_RAD), kp_n_m_per_rad=KP, kv_n_m_s_per_rad=KV),
    ),
)


@_stepped.check(
    "joint-servo",
    title="step response of a servo",
    measures="largest error of the angle within 1 s",
    law="I angle'' = kp (command - angle) - kv angle'",
    source="damped oscillator",
    unit="deg",
    tolerance=ENCODER,
    diagnosis="check the gains (stiffness and damping in radians, not those of an acceleration), the sign of the rate",
)
def _joint_servo(rollout: Rollout) -> Measurement:
    decay = 0.5 * KV / INERTIA
    frequency, times = np.sqrt(KP / INERTIA - decay**2), rollout.times_s
    wave = np.cos(frequency * times) + decay / frequency * np.sin(frequency * times)
    error = _turned_rad(rollout) - STEP_RAD * (1.0 - np.exp(-decay * times) * wave)
    return Measurement(measured=float(np.degrees(np.abs(error).max())))


_limited = rollout_of(
    "the same servo with a largest torque of 0.03 N m, whose command steps by 2 rad",
    _scene(
        _bar(),
        seconds=0.8,
        gravity=0.0,
        motor=Servo(command=_stays(2.0), kp_n_m_per_rad=KP, kv_n_m_s_per_rad=KV, torque_limit_n_m=LIMIT_N_M),
    ),
)


@_limited.check(
    "joint-limit",
    title="largest torque of a servo",
    measures="angular acceleration of the bar within 0.8 s, in which the servo has its largest torque",
    law="angle'' = limit / I",
    source="Newton",
    unit="rad/s^2",
    tolerance=Tolerance("as for a torque motor", relative=1e-3),
    diagnosis="the limit is a torque, not an impulse of a step, and holds for both terms of the servo together",
)
def _joint_limit(rollout: Rollout) -> Measurement:
    measured = acceleration_m_per_s2(rollout.times_s, _turned_rad(rollout))
    return Measurement(measured=measured, expected=LIMIT_N_M / INERTIA)


@Check(
    "joint-all",
    title="friction and servo at once",
    scene="a hanging bar whose hinge has both frictions and a servo of at most 0.5 N m, whose command steps by 1 rad",
    measures="largest error of the angle within 1.5 s",
    law="I angle'' = servo - m g c sin(angle) - dry sign(angle') - viscous angle'",
    source="Newton and Coulomb, integrated by scipy's DOP853",
    unit="deg",
    tolerance=ENCODER,
    diagnosis="where the other joint checks pass, one term replaces another, as when they share one motor",
)
def _joint_all(lab: Lab) -> Measurement:
    servo = Servo(command=_stays(1.0), kp_n_m_per_rad=KP, kv_n_m_s_per_rad=KV, torque_limit_n_m=0.5)

    def torque(angle: float, rate: float) -> float:
        return servo.torque_n_m(1.0, angle, rate) - WEIGHT_N_M * np.sin(angle) - VISCOUS * rate

    terms = {"dry_friction_n_m": DRY_N_M, "viscous_friction_n_m_s_per_rad": VISCOUS}
    rollout = lab.rollout(_scene(_bar(), seconds=1.5, motor=servo, **terms))
    expected = joint_angle_rad(rollout.times_s, torque, inertia=INERTIA, start_rad=0.0, dry=DRY_N_M)
    return Measurement(measured=float(np.degrees(np.abs(_turned_rad(rollout) - expected).max())))


# --- chain -----------------------------------------------------------------------------------------------------------

STARTS_RAD = (0.6, -0.4)
"""Angles of the upper and the lower bar of the chain from the vertical at the start."""


def chain_angles_rad(times_s: Array, torque_n_m: float) -> Array:
    """Return the angles of both bars from the vertical by DOP853, with Lagrange's equations [rad], shape [2, T].

    Args:
        times_s: Times from 0 on [s], shape [T].
        torque_n_m: Torque of the motor between the bars, which turns the upper one relative to the lower one.
    """
    length = 2.0 * CENTRE_M
    upper, coupling = INERTIA + MASS_KG * length**2, MASS_KG * length * CENTRE_M
    weights = G * MASS_KG * np.array([CENTRE_M + length, CENTRE_M])

    def rates(_: float, state: Array) -> Array:
        apart = state[0] - state[1]
        cosine, sine = coupling * np.cos(apart), coupling * np.sin(apart)
        forces = np.array([torque_n_m - sine * state[3] ** 2, sine * state[2] ** 2 - torque_n_m])
        accelerations = np.linalg.solve([[upper, cosine], [cosine, INERTIA]], forces - weights * np.sin(state[:2]))
        return np.concatenate([state[2:], accelerations])

    span = (0.0, float(times_s[-1]))
    return solve_ivp(rates, span, [*STARTS_RAD, 0.0, 0.0], t_eval=times_s, rtol=1e-9, atol=1e-12, method="DOP853").y[:2]


def _chain_error(lab: Lab, motor: TorqueMotor | None, torque_n_m: float) -> Measurement:
    upper = _bar("upper", STARTS_RAD[0])
    joint_m = 2.0 * np.asarray(upper.pose.position_m) - PIVOT_M
    lower = _bar("lower", STARTS_RAD[1], joint_m)
    hinge = BodyHinge(first="lower", second="upper", anchor_m=vector(joint_m), axis=vector(AXIS), motor=motor)
    rollout = lab.rollout(replace(_scene(upper, seconds=1.0), bodies=(upper, lower), body_hinges=(hinge,)))
    expected = chain_angles_rad(rollout.times_s, torque_n_m)
    errors = [
        np.abs(start + _turned_rad(rollout, name) - angles).max() / np.ptp(angles)
        for name, start, angles in zip(("upper", "lower"), STARTS_RAD, expected, strict=True)
    ]
    return Measurement(measured=100.0 * float(max(errors)))


CHAIN: dict[str, Any] = {
    "source": "Lagrange, integrated by scipy's DOP853",
    "measures": "largest error of the angle of a bar within 1 s, over the range of its angle",
    "unit": "%",
    "tolerance": Tolerance("1 % of the angle, as for two bodies that a hinge joins (hinged-angle)", absolute=1.0),
}


@Check(
    "joint-chain",
    title="chain of two bars on the world",
    scene="a bar on a hinge to the world, and another bar on a hinge at its end, released at 0.6 and -0.4 rad",
    law="double physical pendulum",
    diagnosis="check the anchor of the second hinge in both bodies, and the inertia of the bars",
    **CHAIN,
)
def _joint_chain(lab: Lab) -> Measurement:
    return _chain_error(lab, None, 0.0)


@Check(
    "joint-between",
    title="motor between two bars",
    scene="the same chain with a torque motor of 0.03 N m between the bars, which turns the upper one",
    law="double physical pendulum, driven",
    diagnosis="a positive torque turns the second body relative to the first, whichever of both hangs on the other",
    **CHAIN,
)
def _joint_between(lab: Lab) -> Measurement:
    return _chain_error(lab, TorqueMotor(command=_stays(TORQUE_N_M)), TORQUE_N_M)
