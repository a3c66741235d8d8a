"""Joints: dry and viscous friction, armature, motors, backlash, and a chain of two bars that hangs on the world.

A bar of mass m hangs on a horizontal hinge at the distance c from its centre, with the inertia I about the hinge:

    (I + armature) angle'' = motor - m g c sin(angle) - dry sign(angle') - viscous angle'

A bar at rest stays at rest while the other torques together are at most the dry friction.

A rotor with play b turns the bar at one of two stops: J rotor'' + I bar'' = motor, whatever their restitution. A relay
on the bar, as of a servo with an encoder on its output, reverses a torque with the sign of bar + lead bar'. The bar is
then h = J b / 2 (I + J) behind the mean angle, whose acceleration is a constant +-a: the period is 4 h / (lead a).
"""

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from gauge_envs.backends import Simulation
from gauge_envs.evaluation.estimators import acceleration_m_per_s2, mean_period_s
from gauge_envs.evaluation.pendulum_laws import pendulum_period_s
from gauge_envs.runs.rollout import Rollout, states_now
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    BodyHinge,
    Box,
    Hinge,
    JointDynamics,
    Pose,
    RigidBody,
    Scene,
)
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scene.motors import Motor, Servo, TorqueMotor
from gauge_envs.scene.timing import DRIVE_INTERVAL_S
from gauge_envs.tools.bench.parts import body, box_inertia_kg_m2, ramp
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.laws import worst_ratio
from gauge_envs.tools.conformance.model import Check, Measurement, Tolerance, rollout_of

PIVOT_M, AXIS = np.array([0.1, 0.2, 1.0]), np.array([0.6, 0.8, 0.0])
MASS_KG, CENTRE_M, SIZE_M = 0.4, 0.15, (0.03, 0.03, 0.3)


def _bar(
    name: str = "bar", angle_rad: float = 0.0, pivot_m: FloatArray = PIVOT_M
) -> RigidBody:
    turn = Rotation.from_rotvec(angle_rad * AXIS)
    place = vector(pivot_m + turn.apply([0.0, 0.0, -CENTRE_M]))
    return body(
        name, Box(size_m=SIZE_M), Pose.from_rotation(place, turn), mass_kg=MASS_KG
    )


ABOUT_CENTRE = float(box_inertia_kg_m2(_bar()) @ AXIS**2)
INERTIA, WEIGHT_N_M = ABOUT_CENTRE + MASS_KG * CENTRE_M**2, MASS_KG * G * CENTRE_M
"""Moment of inertia about the hinge [kg m^2], and torque of the weight of a level bar [N m]."""


def _scene(
    *bars: RigidBody,
    seconds: float,
    gravity: float = 0.0,
    motor: Motor | None = None,
    **terms: Any,
) -> Scene:
    joint: dict[str, Any] = {"dynamics": JointDynamics(**terms), "motor": motor}
    hinges = (
        Hinge(body=bar.name, anchor_m=vector(PIVOT_M), axis=vector(AXIS), **joint)
        for bar in bars
    )
    return Scene(
        bodies=bars, joints=tuple(hinges), duration_s=seconds, gravity_m_per_s2=gravity
    )


def _turned_rad(rollout: Rollout, name: str = "bar") -> FloatArray:
    """Return the angle of a bar from its start [rad], at most half a turn, shape [T]."""
    rotations = rollout.rotation(name)
    return np.asarray((rotations * rotations[0].inv()).as_rotvec() @ AXIS)


def _stays(amount: float) -> Any:
    """Return a command that steps to an amount at the start and stays."""
    return ramp(amount, start_s=0.0, duration_s=1e-6, ramp_s=0.0)


# --- friction and armature -------------------------------------------------------------------------------------------

DRY_N_M, BRAKE_N_M, VISCOUS, ARMATURE, RELEASE_RAD = 0.02, 0.1, 0.02, 0.01, 0.5
KP, KV, LIMIT_N_M = 2.0, 0.05, 0.03
FRICTION = Tolerance(
    "as for a slide: the error must be well below the scatter of real friction",
    relative=0.01,
)


def _dry_n_m(
    from_rest_rad: FloatArray, energy_j: FloatArray, expected: float
) -> Measurement:
    """Measure dry friction by the energy that is lost from the first stop to the last one, over the angle between."""
    away_rad = np.abs(from_rest_rad)
    middle = away_rad[1:-1]
    is_top = (middle > away_rad[:-2]) & (middle > away_rad[2:])
    tops = [0, *(1 + np.flatnonzero(is_top))]
    between = float(np.abs(np.diff(from_rest_rad[tops])).sum())
    lost = float(energy_j[0] - energy_j[tops[-1]])
    return Measurement(
        measured=lost / between if between else np.nan, expected=expected
    )


DRY: dict[str, Any] = {
    "measures": "energy lost from the first stop to the last one within 2.5 s, over the angle between the stops",
    "source": "Coulomb",
    "unit": "N m",
    "tolerance": FRICTION,
}


@rollout_of(
    "a bar of 0.4 kg on a hinge with a dry friction of 0.02 N m, released at 0.5 rad",
    _scene(
        _bar(angle_rad=RELEASE_RAD), seconds=2.5, gravity=G, dry_friction_n_m=DRY_N_M
    ),
).check("joint-dry", **DRY)
def _joint_dry(rollout: Rollout) -> Measurement:
    angles = RELEASE_RAD + _turned_rad(rollout)
    return _dry_n_m(angles, -WEIGHT_N_M * np.cos(angles), DRY_N_M)


HOLD_N_M, HELD_RAD, SLIPPING_RAD = (
    0.3,
    float(np.arcsin(0.24 / WEIGHT_N_M)),
    float(np.arcsin(0.375 / WEIGHT_N_M)),
)
_sticking = rollout_of(
    "two bars at rest on hinges with a dry friction of 0.3 N m, whose weights exert 0.24 and 0.375 N m",
    _scene(
        _bar("held", HELD_RAD),
        _bar("slips", SLIPPING_RAD),
        seconds=1.0,
        gravity=G,
        dry_friction_n_m=HOLD_N_M,
    ),
)


@_sticking.check("joint-stick")
def _joint_stick(rollout: Rollout) -> Measurement:
    return Measurement(
        measured=float(np.degrees(np.abs(_turned_rad(rollout, "held")).max()))
    )


@_sticking.check("joint-slip", tolerance=FRICTION)
def _joint_slip(rollout: Rollout) -> Measurement:
    at = rollout.sample_at(0.2)
    turned, rate = (
        _turned_rad(rollout, "slips")[at],
        rollout.angular_velocity("slips")[at] @ AXIS,
    )
    lost = (
        WEIGHT_N_M * (np.cos(SLIPPING_RAD + turned) - np.cos(SLIPPING_RAD))
        - 0.5 * INERTIA * rate**2
    )
    return Measurement(
        measured=float(lost / abs(turned)) if turned else np.nan, expected=HOLD_N_M
    )


def _turning(rate_rad_per_s: float) -> RigidBody:
    """Return a hanging bar that starts with a rate."""
    spin = rate_rad_per_s * AXIS
    speed = vector(np.cross(spin, [0.0, 0.0, -CENTRE_M]))
    return replace(
        _bar(), linear_velocity_m_per_s=speed, angular_velocity_rad_per_s=vector(spin)
    )


@rollout_of(
    "a bar on a hinge with a viscous friction of 0.02 N m s/rad, which starts with 3 rad/s, without gravity",
    _scene(_turning(3.0), seconds=1.0, viscous_friction_n_m_s_per_rad=VISCOUS),
).check("joint-viscous", tolerance=FRICTION)
def _joint_viscous(rollout: Rollout) -> Measurement:
    rate = np.maximum(rollout.angular_velocity("bar") @ AXIS, 1e-6)
    return Measurement(
        measured=float(-INERTIA * np.polyfit(rollout.times_s, np.log(rate), 1)[0]),
        expected=VISCOUS,
    )


@rollout_of(
    "a bar on a hinge with an armature of 0.01 kg m^2, released at 0.5 rad",
    _scene(
        _bar(angle_rad=RELEASE_RAD), seconds=4.0, gravity=G, armature_kg_m2=ARMATURE
    ),
).check("joint-armature")
def _joint_armature(rollout: Rollout) -> Measurement:
    gyration = float(np.sqrt((ABOUT_CENTRE + ARMATURE) / MASS_KG))
    expected = pendulum_period_s(
        length_m=CENTRE_M,
        gyration_m=gyration,
        amplitude_rad=RELEASE_RAD,
        gravity_m_per_s2=G,
    )
    return Measurement(
        measured=mean_period_s(rollout.times_s, RELEASE_RAD + _turned_rad(rollout)),
        expected=expected,
    )


# --- motors ----------------------------------------------------------------------------------------------------------

TORQUE_N_M, DELAY_S, STEP_RAD = 0.03, 0.1, 0.3

_pushed = rollout_of(
    "a bar on a hinge without gravity, whose motor exerts 0.03 N m from 0.1 s on: a step at the start with this delay",
    _scene(
        _bar(),
        seconds=0.8,
        motor=TorqueMotor(command=_stays(TORQUE_N_M), delay_s=DELAY_S),
    ),
)


def _parabola(rollout: Rollout) -> FloatArray:
    """Return the coefficients of a parabola through the angle from 0.15 s on, the highest power first."""
    part = rollout.between(0.15, rollout.times_s[-1])
    return np.polyfit(rollout.times_s[part], _turned_rad(rollout)[part], 2)


@_pushed.check("joint-torque")
def _joint_torque(rollout: Rollout) -> Measurement:
    return Measurement(
        measured=2.0 * float(_parabola(rollout)[0]), expected=TORQUE_N_M / INERTIA
    )


@_pushed.check("joint-delay")
def _joint_delay(rollout: Rollout) -> Measurement:
    square, slope, _ = _parabola(rollout)
    return Measurement(
        measured=-500.0 * float(slope / square) if square else np.nan,
        expected=1e3 * DELAY_S,
    )


def _servo(step_rad: float, **limit: float) -> Servo:
    command = _stays(step_rad)
    gains: dict[str, Any] = {"kp_n_m_per_rad": KP, "kv_n_m_s_per_rad": KV, **limit}
    return Servo(command=command, **gains)


@rollout_of(
    "a bar on a hinge without gravity, with a servo of 2 N m/rad and 0.05 N m s/rad, whose command steps by 0.3 rad",
    _scene(_bar(), seconds=1.0, motor=_servo(STEP_RAD)),
).check("joint-servo")
def _joint_servo(rollout: Rollout) -> Measurement:
    decay, times = 0.5 * KV / INERTIA, rollout.times_s
    frequency = np.sqrt(KP / INERTIA - decay**2)
    wave = np.cos(frequency * times) + decay / frequency * np.sin(frequency * times)
    error = _turned_rad(rollout) - STEP_RAD * (1.0 - np.exp(-decay * times) * wave)
    return Measurement(measured=float(np.degrees(np.abs(error).max())))


def _limit_check(id: str, scene: str, step_rad: float) -> None:
    servo = _servo(step_rad, torque_limit_n_m=LIMIT_N_M)

    @rollout_of(scene, _scene(_bar(), seconds=0.8, motor=servo)).check(id)
    def measure(rollout: Rollout) -> Measurement:
        measured = acceleration_m_per_s2(rollout.times_s, _turned_rad(rollout))
        expected = float(np.copysign(LIMIT_N_M / INERTIA, step_rad))
        return Measurement(measured=measured, expected=expected)


_limit_check(
    "joint-limit",
    "the same servo with a largest torque of 0.03 N m, whose command steps by 2 rad",
    2.0,
)
_limit_check("joint-limit-back", "the same servo, whose command steps by -2 rad", -2.0)


@Check("wrench-hinged")
def _wrench_hinged(lab: Lab) -> Measurement:
    bars = _bar("pushed"), _bar("turned")
    side = np.cross(AXIS, [0.0, 0.0, -1.0])
    wrenches = {
        "pushed": [*(TORQUE_N_M / CENTRE_M * side), 0.0, 0.0, 0.0],
        "turned": [0.0, 0.0, 0.0, *(-TORQUE_N_M * AXIS)],
    }
    seconds = 18 * DRIVE_INTERVAL_S
    rollout = lab.rollout(_scene(*bars, seconds=seconds), wrenches=wrenches)
    scale = INERTIA / (TORQUE_N_M * seconds)
    pushed, turned = (
        scale * float(rollout.angular_velocity(name)[-1] @ AXIS) for name in wrenches
    )
    ratios = {"a force": pushed, "a torque": -turned}
    return worst_ratio(ratios, "the angular acceleration is")


def motor_scene() -> Scene:
    """Return a bar at rest on a hinge without gravity, with a torque motor."""
    motor = TorqueMotor(command=_stays(TORQUE_N_M))
    return _scene(_bar(), seconds=2.0, motor=motor)


def _commanded(lab: Lab) -> tuple[Simulation, Callable[[], FloatArray]]:
    """Return a bar with a torque motor, and a function that advances by 0.1 s and returns the state, shape [13]."""
    simulation = lab.build(motor_scene())
    simulation.reset(0)

    def later() -> FloatArray:
        simulation.advance(18 * DRIVE_INTERVAL_S)
        return states_now(simulation, ["bar"])[0]

    return simulation, later


@Check("reset-command")
def _reset_command(lab: Lab) -> Measurement:
    simulation, later = _commanded(lab)
    with closing(simulation):
        fresh = later()
        simulation.reset(0)
        simulation.command(np.array([TORQUE_N_M]))
        later()
        simulation.reset(0)
        return Measurement(measured=float(np.abs(later() - fresh).max()))


@Check("restore-command")
def _restore_command(lab: Lab) -> Measurement:
    simulation, later = _commanded(lab)
    with closing(simulation):
        simulation.command(np.array([TORQUE_N_M]))
        later()
        saved = simulation.state()
        expected = later()
        simulation.command(np.array([-TORQUE_N_M]))
        later()
        simulation.restore(saved)
        return Measurement(measured=float(np.abs(later() - expected).max()))


@rollout_of(
    "a bar on a hinge without gravity, with a dry friction of 0.1 N m and a servo of 2 N m/rad that steps by 0.5 rad",
    _scene(
        _bar(),
        seconds=2.5,
        motor=Servo(command=_stays(RELEASE_RAD), kp_n_m_per_rad=KP),
        dry_friction_n_m=BRAKE_N_M,
    ),
).check("joint-dry-servo", **DRY)
def _joint_dry_servo(rollout: Rollout) -> Measurement:
    angles = _turned_rad(rollout) - RELEASE_RAD
    return _dry_n_m(angles, 0.5 * KP * angles**2, BRAKE_N_M)


PLAY_RAD, DRIVE_N_M, LEAD_S = 0.02, 0.002, 0.11
TOTAL, ROTOR = (
    INERTIA + ARMATURE,
    {"armature_kg_m2": ARMATURE, "backlash_rad": PLAY_RAD},
)
CYCLE_S, SWITCH_RAD_PER_S = (
    2.0 * ARMATURE * PLAY_RAD / (LEAD_S * DRIVE_N_M),
    0.5 * PLAY_RAD * ARMATURE / TOTAL / LEAD_S,
)


@rollout_of(
    "a bar with a play of 0.02 rad on a hinge with an armature of 0.01 kg m^2, whose motor exerts 0.002 N m",
    _scene(_bar(), seconds=1.2, motor=TorqueMotor(command=_stays(DRIVE_N_M)), **ROTOR),
).check("joint-backlash", tolerance=FRICTION)
def _joint_backlash(rollout: Rollout) -> Measurement:
    part = rollout.between(0.6, 1.2)
    lag = -float(np.polyfit(rollout.times_s[part], _turned_rad(rollout)[part], 2)[2])
    return Measurement(measured=2.0 * lag * TOTAL / ARMATURE, expected=PLAY_RAD)


@Check("joint-backlash-cycle", tolerance=FRICTION)
def _joint_backlash_cycle(lab: Lab) -> Measurement:
    motor, switches_s, torque = TorqueMotor(command=_stays(0.0)), [], -DRIVE_N_M
    scene = _scene(
        _turning(SWITCH_RAD_PER_S), seconds=3.25 * CYCLE_S, motor=motor, **ROTOR
    )
    with lab.running(scene) as simulation:
        for interval in range(round(scene.duration_s / DRIVE_INTERVAL_S)):
            state, mean = simulation.body_states(["bar"])[0], torque
            turned, rate = (
                Rotation.from_quat(state[[4, 5, 6, 3]]).as_rotvec() @ AXIS,
                state[10:] @ AXIS,
            )
            ahead, climb = (
                turned + LEAD_S * rate,
                DRIVE_INTERVAL_S * (rate + LEAD_S * torque / TOTAL),
            )
            if (ahead + climb) * torque > 0.0:
                # The mean torque has the impulse of one that changes sign within the interval.
                share = float(np.clip(-ahead / climb, 0.0, 1.0))
                mean, torque = (2.0 * share - 1.0) * torque, -torque
                switches_s.append(DRIVE_INTERVAL_S * (interval + share))
            simulation.command(np.array([mean]))
            simulation.advance(DRIVE_INTERVAL_S)
    halves_s = np.diff(switches_s)[-4:]
    return Measurement(
        measured=2.0 * float(halves_s.mean()) if len(halves_s) == 4 else np.nan,
        expected=CYCLE_S,
    )


# --- chain -----------------------------------------------------------------------------------------------------------

STARTS_RAD = (0.6, -0.4)
"""Angles of the upper and the lower bar of the chain from the vertical at the start."""


def chain_angles_rad(times_s: FloatArray, torque_n_m: float) -> FloatArray:
    """Return the angles of both bars from the vertical by DOP853, with Lagrange's equations [rad], shape [2, T].

    Args:
        times_s: Times from 0 on [s], shape [T].
        torque_n_m: Torque of the motor between the bars, which turns the upper one relative to the lower one.
    """
    length = 2.0 * CENTRE_M
    upper, coupling = INERTIA + MASS_KG * length**2, MASS_KG * length * CENTRE_M
    weights = G * MASS_KG * np.array([CENTRE_M + length, CENTRE_M])

    def rates(_: float, state: FloatArray) -> FloatArray:
        apart = state[0] - state[1]
        cosine, sine = coupling * np.cos(apart), coupling * np.sin(apart)
        forces = np.array(
            [torque_n_m - sine * state[3] ** 2, sine * state[2] ** 2 - torque_n_m]
        )
        accelerations = np.linalg.solve(
            [[upper, cosine], [cosine, INERTIA]], forces - weights * np.sin(state[:2])
        )
        return np.concatenate([state[2:], accelerations])

    span = (0.0, float(times_s[-1]))
    return solve_ivp(
        rates,
        span,
        [*STARTS_RAD, 0.0, 0.0],
        t_eval=times_s,
        rtol=1e-9,
        atol=1e-12,
        method="DOP853",
    ).y[:2]


@Check("joint-between")
def _joint_between(lab: Lab) -> Measurement:
    upper = _bar("upper", STARTS_RAD[0])
    end_m = 2.0 * np.asarray(upper.pose.position_m) - PIVOT_M
    lower = _bar("lower", STARTS_RAD[1], end_m)
    hinge = BodyHinge(
        first="lower",
        second="upper",
        anchor_m=vector(end_m),
        axis=vector(AXIS),
        motor=TorqueMotor(command=_stays(TORQUE_N_M)),
    )
    rollout = lab.rollout(
        replace(
            _scene(upper, seconds=1.0, gravity=G),
            bodies=(upper, lower),
            body_hinges=(hinge,),
        )
    )
    errors = []
    expected = chain_angles_rad(rollout.times_s, TORQUE_N_M)
    for name, start, angles in zip(
        ("upper", "lower"), STARTS_RAD, expected, strict=True
    ):
        off_rad = np.abs(start + _turned_rad(rollout, name) - angles).max()
        errors.append(float(off_rad / np.ptp(angles)))
    return Measurement(measured=100.0 * max(errors))
