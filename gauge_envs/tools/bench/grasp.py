"""Grasps: an object between two pads on hinged jaws, which known torques press together.

A jaw turns about a vertical axis in the plane of its face, so neither weight nor friction has a moment about it. Its
pad presses with N = torque / length, within 0.5 %, wherever the force acts on its face. Friction holds 2 mu N. Pads
with a face also hold a torque about their axis, as a soft finger does; balls do not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

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
from gauge_envs.scoring.estimators import steady_speed_m_per_s
from gauge_envs.tools.bench.parts import body, box, box_inertia_kg_m2, contact
from gauge_envs.tools.bench.recording import Recording

MASS_KG, FRICTION, JAW_M, PAD_M, SIZE_M = 0.2, 0.5, 2.0, 0.02, (0.04, 0.06, 0.16)
WEIGHT_N, MIDDLE_M = MASS_KG * G, np.array([0.0, 0.0, 1.0])
THICK_M, OFF_M, RELEASE_RAD = 0.01, 0.05, 0.7
PAD, TIP = Box(size_m=(THICK_M, PAD_M, PAD_M)), Sphere(radius_m=0.5 * THICK_M)
OBJECT = box("object", (0.0, 0.0, 1.0), SIZE_M, mass_kg=MASS_KG)


def grasp_wrenches(force_n: float) -> Mapping[str, FloatArray]:
    """Return the torques on the jaws that make each pad press with a force [N], as wrenches by body, shape [6]."""
    torque = np.array([0.0, 0.0, 0.0, 0.0, 0.0, force_n * JAW_M])
    return {"left": -torque, "right": torque}


def grasp_scene(
    seconds: float,
    *,
    pad: Shape = PAD,
    grasped: RigidBody = OBJECT,
    gravity: float = G,
) -> Scene:
    """Return an object between two pads, which the torques of `grasp_wrenches` press."""
    pads, hinges = [], []
    for name, side in (("left", -1.0), ("right", 1.0)):
        face_m = 0.5 * side * SIZE_M[0]
        pads.append(
            body(name, pad, Pose(position_m=(face_m + 0.5 * side * THICK_M, 0.0, 1.0)))
        )
        hinges.append(
            Hinge(
                body=name,
                anchor_m=(face_m, -JAW_M, 1.0),
                axis=(0.0, 0.0, 1.0),
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
GRASPED = grasp_scene(1.5)
TURNED = grasp_scene(0.15, grasped=_spun, gravity=0.0)
PRESSED = grasp_wrenches(2.0 * WEIGHT_N)
"""The box at rest, and with a spin about the axis of its pads, which Coulomb's law stops after 0.18 s or later."""

STILL_S, SHAKEN_S = 0.5, 1.5
"""Interval in which a grasped box has settled and is not yet shaken [s]."""

SHARES = (0.3826, 0.7071)
"""Mean distance from the centre of a square's points, and of its corners, over its side."""


def from_pads_m(rollout: Recording) -> FloatArray:
    """Return the displacement of the object from the middle of its pads [m], shape [sample_count, 3]."""
    return rollout.displacement("object") - 0.5 * (
        rollout.displacement("left") + rollout.displacement("right")
    )


def pad_depth_um(rollout: Recording) -> float:
    """Return the depth of the pads in the box [um]."""
    apart_m = rollout.displacement("left")[:, 0] - rollout.displacement("right")[:, 0]
    return 0.5e6 * float(apart_m[rollout.between(STILL_S, SHAKEN_S)].mean())


def pad_creep_um_per_s(rollout: Recording) -> float:
    """Return the speed with which the box creeps down its pads [um/s]."""
    still = rollout.between(STILL_S, SHAKEN_S)
    return -1e6 * steady_speed_m_per_s(
        rollout.times_s[still], from_pads_m(rollout)[still, 2]
    )


def torque_share(torque_n_m: float) -> float:
    """Return the torque of pads that press with twice the weight over mu N times their side; see `SHARES`."""
    return torque_n_m / (2.0 * FRICTION * 2.0 * WEIGHT_N * PAD_M)


def spin_torque_share(rollout: Recording) -> float:
    """Return `torque_share` of a box that spins between its pads: its loss of energy over the angle."""
    spin_rad_per_s = rollout.angular_velocity("object")[:, 0]
    lost_j = (
        0.5
        * box_inertia_kg_m2(OBJECT)[0]
        * float(spin_rad_per_s[0] ** 2 - spin_rad_per_s[-1] ** 2)
    )
    return torque_share(lost_j / float(np.trapezoid(spin_rad_per_s, rollout.times_s)))
