"""Grasps: an object between two pads on hinged jaws, whose motors press with a known force.

A jaw turns about a vertical axis in the plane of its face, so that neither weight nor friction has a moment about it.
Its pad presses with N = torque / length to 0.5 %, wherever on its face: rigid bodies leave the pressure open. Friction
holds 2 mu N, and pads with a face hold a torque about their axis too, as a soft finger does; balls hold none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gauge_envs.evaluation.estimators import steady_speed_m_per_s
from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Hinge,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
)
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.motors import Servo, TorqueMotor
from gauge_envs.tools.bench.parts import (
    body,
    box,
    box_inertia_kg_m2,
    contact,
    fixed_box,
    ramp,
)

MASS_KG, FRICTION, JAW_M, PAD_M, SIZE_M = 0.2, 0.5, 2.0, 0.02, (0.04, 0.06, 0.16)
WEIGHT_N, MIDDLE_M = MASS_KG * G, np.array([0.0, 0.0, 1.0])
THICK_M, OFF_M, RELEASE_RAD = 0.01, 0.05, 0.7
PAD, TIP = Box(size_m=(THICK_M, PAD_M, PAD_M)), Sphere(radius_m=0.5 * THICK_M)
OBJECT = box("object", (0.0, 0.0, 1.0), SIZE_M, mass_kg=MASS_KG)


def grasp_scene(
    force_n: float,
    seconds: float,
    *,
    pad: Shape = PAD,
    grasped: RigidBody = OBJECT,
    gravity: float = G,
) -> Scene:
    """Return an object between two pads that press with a force [N] each."""
    pads, hinges = [], []
    for name, side in (("left", -1.0), ("right", 1.0)):
        face_m = 0.5 * side * SIZE_M[0]
        motor = TorqueMotor(
            command=ramp(
                side * force_n * JAW_M, start_s=0.0, duration_s=1e-6, ramp_s=0.0
            )
        )
        pads.append(
            body(name, pad, Pose(position_m=(face_m + 0.5 * side * THICK_M, 0.0, 1.0)))
        )
        hinges.append(
            Hinge(
                body=name,
                anchor_m=(face_m, -JAW_M, 1.0),
                axis=(0.0, 0.0, 1.0),
                motor=motor,
            )
        )
    return Scene(
        bodies=(grasped, *pads),
        joints=tuple(hinges),
        contacts=(contact("object", ("left", "right"), friction=FRICTION),),
        duration_s=seconds,
        gravity_m_per_s2=gravity,
    )


_spun = replace(OBJECT, angular_velocity_rad_per_s=(20.0, 0.0, 0.0))
HELD, TURNED = (
    grasp_scene(2.0 * WEIGHT_N, 1.5),
    grasp_scene(2.0 * WEIGHT_N, 0.15, grasped=_spun, gravity=0.0),
)
"""The box at rest, and with a spin about the axis of its pads, which Coulomb's law stops after 0.18 s or later."""

_asked, _at = ramp(0.3, start_s=0.0, duration_s=1e-6, ramp_s=0.0), 0.017 + 0.5 * THICK_M
_servo = Servo(
    command=_asked, kp_n_m_per_rad=17.8, kv_n_m_s_per_rad=0.6, torque_limit_n_m=1.0
)
_cube, _palm = (
    box("object", (0.0, 0.0, 1.0), (0.034,) * 3, mass_kg=0.025),
    fixed_box("palm", (-_at, 0.0, 1.0), PAD.size_m),
)
SQUEEZED = Scene(
    bodies=(
        _cube,
        _palm,
        body("jaw", PAD, Pose(position_m=(_at, 0.0, 1.0)), mass_kg=0.012),
    ),
    joints=(
        Hinge(
            body="jaw", anchor_m=(0.017, -0.1, 1.0), axis=(0.0, 0.0, 1.0), motor=_servo
        ),
    ),
    contacts=(contact("object", ("palm", "jaw"), friction=FRICTION),),
    duration_s=1.0,
)
"""A wooden cube in a gripper of about the SO-101's size, whose servo asks its light jaw to go on by 30 mm."""


STILL_S, SHAKEN_S = 0.5, 1.5
"""Time in which a held box has settled and is not yet shaken [s]."""

SHARES = (0.3826, 0.7071)
"""Mean distance from the centre of a square's points, and of its corners, over its side."""


def from_pads_m(rollout: Rollout) -> FloatArray:
    """Return the displacement of the object from the middle of its pads [m], shape [sample_count, 3]."""
    return rollout.displacement("object") - 0.5 * (
        rollout.displacement("left") + rollout.displacement("right")
    )


def pad_depth_um(rollout: Rollout) -> float:
    """Return the depth of the pads in the box [um]."""
    apart_m = rollout.displacement("left")[:, 0] - rollout.displacement("right")[:, 0]
    return 0.5e6 * float(apart_m[rollout.between(STILL_S, SHAKEN_S)].mean())


def pad_creep_um_per_s(rollout: Rollout) -> float:
    """Return the speed with which the box creeps down its pads [um/s]."""
    still = rollout.between(STILL_S, SHAKEN_S)
    return -1e6 * steady_speed_m_per_s(
        rollout.times_s[still], from_pads_m(rollout)[still, 2]
    )


def torque_share(torque_n_m: float) -> float:
    """Return the torque of pads that press with twice the weight over mu N times their side; see `SHARES`."""
    return torque_n_m / (2.0 * FRICTION * 2.0 * WEIGHT_N * PAD_M)


def spin_torque_share(rollout: Rollout) -> float:
    """Return `torque_share` of a box that spins between its pads: its loss of energy over the angle."""
    spin_rad_per_s = rollout.angular_velocity("object")[:, 0]
    lost_j = (
        0.5
        * box_inertia_kg_m2(OBJECT)[0]
        * float(spin_rad_per_s[0] ** 2 - spin_rad_per_s[-1] ** 2)
    )
    return torque_share(lost_j / float(np.trapezoid(spin_rad_per_s, rollout.times_s)))
