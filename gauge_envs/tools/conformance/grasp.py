"""Grasps: an object between two pads on hinged jaws, whose motors press with a known force.

A jaw turns about a vertical axis in the plane of its face, so that neither weight nor friction has a moment about it.
Its pad presses with N = torque / length to 0.5 %, wherever on its face: rigid bodies leave the pressure open. Friction
holds 2 mu N, and pads with a face hold a torque about their axis too, as a soft finger does; balls hold none.
"""

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.envs.driver_paths import DriverPaths
from gauge_envs.evaluation.estimators import acceleration_m_per_s2, mean_period_s, steady_speed_m_per_s
from gauge_envs.runs.rollout import Rollout, states_now
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Box, Hinge, Pose, RigidBody, Scene, Shape, Sphere
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.motors import Servo, TorqueMotor
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.bench.parts import body, box, contact, fixed_box, ramp
from gauge_envs.tools.conformance.lab import Lab, push
from gauge_envs.tools.conformance.laws import box_inertia_kg_m2, pendulum_period_s
from gauge_envs.tools.conformance.model import Measurement, recorded, rollout_of

MASS_KG, FRICTION, JAW_M, PAD_M, SIZE_M = 0.2, 0.5, 2.0, 0.02, (0.04, 0.06, 0.16)
WEIGHT_N, MIDDLE_M = MASS_KG * G, np.array([0.0, 0.0, 1.0])
THICK_M, OFF_M, RELEASE_RAD = 0.01, 0.05, 0.7
PAD, TIP = Box(size_m=(THICK_M, PAD_M, PAD_M)), Sphere(radius_m=0.5 * THICK_M)
OBJECT = box("object", (0.0, 0.0, 1.0), SIZE_M, mass_kg=MASS_KG)


def _grasp(force_n: float, seconds: float, *, pad: Shape = PAD, held: RigidBody = OBJECT, gravity: float = G) -> Scene:
    """Return an object between two pads that press with a force [N] each."""
    pads, hinges = [], []
    for name, side in (("left", -1.0), ("right", 1.0)):
        face_m = 0.5 * side * SIZE_M[0]
        motor = TorqueMotor(command=ramp(side * force_n * JAW_M, start_s=0.0, duration_s=1e-6, ramp_s=0.0))
        pads.append(body(name, pad, Pose(position_m=(face_m + 0.5 * side * THICK_M, 0.0, 1.0))))
        hinges.append(Hinge(body=name, anchor_m=(face_m, -JAW_M, 1.0), axis=(0.0, 0.0, 1.0), motor=motor))
    return Scene(
        bodies=(held, *pads),
        joints=tuple(hinges),
        contacts=(contact("object", ("left", "right"), friction=FRICTION),),
        duration_s=seconds,
        gravity_m_per_s2=gravity,
    )


def _pushed(lab: Lab, scene: Scene, wrench: Callable[[float], Any]) -> Rollout:
    """Return the rollout of a scene in which a wrench over time [N, N m] acts on the object."""
    count, names = round(scene.duration_s / SAMPLE_INTERVAL_S), [one.name for one in scene.bodies]
    with closing(lab.build(scene)) as simulation:
        simulation.reset(0)
        paths, rows = DriverPaths(scene, scene.duration_s), [states_now(simulation, names)]
        for index in range(count):
            push(simulation, "object", wrench(index * SAMPLE_INTERVAL_S))
            paths.advance(simulation, index)
            rows.append(states_now(simulation, names))
    times_s = SAMPLE_INTERVAL_S * np.arange(count + 1, dtype=np.float64)
    return Rollout(scene=scene, times_s=times_s, states=dict(zip(names, np.stack(rows, axis=1), strict=True)))


def _from_pads(rollout: Rollout) -> NDArray[np.float64]:
    """Return the displacement of the object from the middle of its pads [m], shape [T, 3]."""
    return rollout.displacement("object") - 0.5 * (rollout.displacement("left") + rollout.displacement("right"))


STILL_S, SHAKEN_S, SHAKES_HZ, SHAKE = 0.5, 1.5, 4.0, 0.5


@recorded(
    "a box of 0.2 kg between two pads of 20 mm by 20 mm on jaws of 2 m that press with twice its weight each, with "
    "friction 0.5: 1.5 s at rest, then 1 s under a force of half its weight on its centre, up and down with 4 Hz"
)
def _held(lab: Lab) -> Rollout:
    def shake(time_s: float) -> tuple[float, ...]:
        force = SHAKE * WEIGHT_N * np.sin(2.0 * np.pi * SHAKES_HZ * time_s) if time_s > SHAKEN_S else 0.0
        return 0.0, 0.0, force, 0.0, 0.0, 0.0

    return _pushed(lab, _grasp(2.0 * WEIGHT_N, 2.5), shake)


@_held.check("grasp-sink")
def grasp_sink(rollout: Rollout) -> Measurement:
    """Return the depth of the pads in the box [um]."""
    apart = rollout.displacement("left")[:, 0] - rollout.displacement("right")[:, 0]
    return Measurement(measured=0.5e6 * float(apart[rollout.between(STILL_S, SHAKEN_S)].mean()))


@_held.check("grasp-creep")
def grasp_creep(rollout: Rollout) -> Measurement:
    """Return the speed with which the box creeps down its pads [um/s]."""
    still = rollout.between(STILL_S, SHAKEN_S)
    return Measurement(measured=-1e6 * steady_speed_m_per_s(rollout.times_s[still], _from_pads(rollout)[still, 2]))


@_held.check("grasp-holds")
def _grasp_holds(rollout: Rollout) -> Measurement:
    places = _from_pads(rollout.cut(SHAKEN_S, rollout.times_s[-1]))
    return Measurement(measured=1e3 * float(np.abs(places[:, 2] - places[0, 2]).max()))


@rollout_of(
    "the same box between pads that press with half its weight each, so that friction carries half of it",
    _grasp(0.5 * WEIGHT_N, 0.15),
).check("grasp-slips")
def _grasp_slips(rollout: Rollout) -> Measurement:
    falls = acceleration_m_per_s2(rollout.times_s, rollout.position("object")[:, 2])
    return Measurement(measured=1.0 + falls / G, expected=FRICTION)


TURNING_N_M, SHARES = 0.07, (0.3826, 0.7071)
"""Torque that turns the box; mean distance from the centre of a square's points, and of its corners, over its side."""


@recorded("the same box between pads that press with twice its weight each, under a torque of 0.07 N m; no gravity")
def _turned(lab: Lab) -> Rollout:
    return _pushed(lab, _grasp(2.0 * WEIGHT_N, 0.1, gravity=0.0), lambda _: (0.0, 0.0, 0.0, TURNING_N_M, 0.0, 0.0))


@_turned.check("grasp-torsion")
def _grasp_torsion(rollout: Rollout) -> Measurement:
    angles = rollout.rotation("object").as_rotvec()[:, 0]
    return _share(TURNING_N_M - box_inertia_kg_m2(OBJECT)[0] * acceleration_m_per_s2(rollout.times_s, angles))


def _share(held_n_m: float) -> Measurement:
    return Measurement(measured=held_n_m / (2.0 * FRICTION * 2.0 * WEIGHT_N * PAD_M), expected=sum(SHARES) / 2.0)


_spun = replace(OBJECT, angular_velocity_rad_per_s=(20.0, 0.0, 0.0))
HELD, TURNED = _grasp(2.0 * WEIGHT_N, 1.5), _grasp(2.0 * WEIGHT_N, 0.15, held=_spun, gravity=0.0)
"""The box at rest, and with a spin about the axis of its pads, which Coulomb's law stops after 0.18 s or later."""

_asked, _at = ramp(0.3, start_s=0.0, duration_s=1e-6, ramp_s=0.0), 0.017 + 0.5 * THICK_M
_servo = Servo(command=_asked, kp_n_m_per_rad=17.8, kv_n_m_s_per_rad=0.6, torque_limit_n_m=1.0)
_cube, _palm = (
    box("object", (0.0, 0.0, 1.0), (0.034,) * 3, mass_kg=0.025),
    fixed_box("palm", (-_at, 0.0, 1.0), PAD.size_m),
)
SQUEEZED = Scene(
    bodies=(_cube, _palm, body("jaw", PAD, Pose(position_m=(_at, 0.0, 1.0)), mass_kg=0.012)),
    joints=(Hinge(body="jaw", anchor_m=(0.017, -0.1, 1.0), axis=(0.0, 0.0, 1.0), motor=_servo),),
    contacts=(contact("object", ("palm", "jaw"), friction=FRICTION),),
    duration_s=1.0,
)
"""A wooden cube in a gripper of about the SO-101's size, whose servo asks its light jaw to go on by 30 mm."""


def grasp_turn(rollout: Rollout) -> Measurement:
    """Return the same of a box that spins between its pads, from its loss of energy."""
    spin = rollout.angular_velocity("object")[:, 0]
    lost = 0.5 * box_inertia_kg_m2(OBJECT)[0] * float(spin[0] ** 2 - spin[-1] ** 2)
    return _share(lost / float(np.trapezoid(spin, rollout.times_s)))


HANDS: Mapping[str, tuple[Scene, Callable[[Rollout], Measurement]]] = {
    "grasp-creep": (HELD, grasp_creep),
    "grasp-sink": (HELD, grasp_sink),
    "grasp-torsion": (TURNED, grasp_turn),
}
"""Scene and reading of what a robot's hand is judged by, by id of the check that has its law."""


_tilt = Rotation.from_euler("x", RELEASE_RAD)
_off_centre = replace(OBJECT, pose=Pose.from_rotation(vector(MIDDLE_M + _tilt.apply([0.0, 0.0, -OFF_M])), _tilt))


@rollout_of(
    "the same box between balls of 5 mm radius that press with five times its weight 50 mm above its centre, released "
    "at 0.7 rad",
    _grasp(5.0 * WEIGHT_N, 2.0, pad=TIP, held=_off_centre),
).check("grasp-swing")
def _grasp_swing(rollout: Rollout) -> Measurement:
    angles = rollout.rotation("object").as_rotvec()[:, 0]
    gyration = float(np.sqrt(box_inertia_kg_m2(OBJECT)[0] / MASS_KG))
    expected = pendulum_period_s(length_m=OFF_M, gyration_m=gyration, amplitude_rad=RELEASE_RAD, gravity_m_per_s2=G)
    return Measurement(measured=mean_period_s(rollout.times_s, angles), expected=expected)
