"""Checks of grasps: a box between two pads that press with a known force."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.envs.rollout import intervals
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Pose, Scene
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.prescribed_motion import prescribed_motions
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.scoring.estimators import (
    acceleration_m_per_s2,
    mean_period_s,
    pendulum_period_s,
)
from gauge_envs.tools.bench.grasp import (
    FRICTION,
    MASS_KG,
    MIDDLE_M,
    OBJECT,
    OFF_M,
    RELEASE_RAD,
    SHAKEN_S,
    SHARES,
    TIP,
    WEIGHT_N,
    from_pads_m,
    grasp_scene,
    grasp_wrenches,
    pad_creep_um_per_s,
    pad_depth_um,
    torque_share,
)
from gauge_envs.tools.bench.parts import box_inertia_kg_m2
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.lab import Lab, push
from gauge_envs.tools.conformance.model import Measurement, recorded

SHAKES_HZ, SHAKE = 4.0, 0.5
TURNING_N_M = 0.07
"""Torque that turns the box [N m]."""


def _pushed(lab: Lab, scene: Scene, wrench: Callable[[float], Any]) -> Recording:
    """Return the rollout of a box between pads with twice its weight, with a wrench over time on it [N, N m]."""
    count, names = (
        round(scene.duration_s / SAMPLE_INTERVAL_S),
        [one.name for one in scene.bodies],
    )
    with lab.running(scene) as simulation:
        for name, pressing in grasp_wrenches(2.0 * WEIGHT_N).items():
            push(simulation, name, pressing)
        motions = prescribed_motions(scene, scene.duration_s)
        actions = [np.zeros((1, motion.motion_count)) for motion in motions]
        rows = [np.array(simulation.body_states(names)[0])]
        for index in range(count):
            push(simulation, "object", wrench(index * SAMPLE_INTERVAL_S))
            for _ in intervals(simulation, motions, index, 1, actions):
                rows.append(np.array(simulation.body_states(names)[0]))
    times_s = SAMPLE_INTERVAL_S * np.arange(count + 1, dtype=np.float64)
    return Recording(
        scene=scene,
        times_s=times_s,
        states=dict(zip(names, np.stack(rows, axis=1), strict=True)),
    )


@recorded(
    "a box of 0.2 kg between two pads of 20 mm by 20 mm on jaws of 2 m that press with twice its weight each, with "
    "friction 0.5: 1.5 s at rest, then 1 s under a force of half its weight on its centre, up and down with 4 Hz"
)
def _grasped(lab: Lab) -> Recording:
    def shake(time_s: float) -> tuple[float, ...]:
        force = (
            SHAKE * WEIGHT_N * np.sin(2.0 * np.pi * SHAKES_HZ * time_s)
            if time_s > SHAKEN_S
            else 0.0
        )
        return 0.0, 0.0, force, 0.0, 0.0, 0.0

    return _pushed(lab, grasp_scene(2.5), shake)


@_grasped.check("grasp-sink")
def _grasp_sink(rollout: Recording) -> Measurement:
    return Measurement(measured=pad_depth_um(rollout))


@_grasped.check("grasp-creep")
def _grasp_creep(rollout: Recording) -> Measurement:
    return Measurement(measured=pad_creep_um_per_s(rollout))


@_grasped.check("grasp-holds")
def _grasp_holds(rollout: Recording) -> Measurement:
    places = from_pads_m(rollout.cut(SHAKEN_S, rollout.times_s[-1]))
    return Measurement(measured=1e3 * float(np.abs(places[:, 2] - places[0, 2]).max()))


@recorded(
    "the same box between pads that press with half its weight each, so that friction carries half of it"
)
def _slipping(lab: Lab) -> Recording:
    return lab.rollout(grasp_scene(0.15), wrenches=grasp_wrenches(0.5 * WEIGHT_N))


@_slipping.check("grasp-slips")
def _grasp_slips(rollout: Recording) -> Measurement:
    falls = acceleration_m_per_s2(rollout.times_s, rollout.position("object")[:, 2])
    return Measurement(measured=1.0 + falls / G, expected=FRICTION)


@recorded(
    "the same box between pads that press with twice its weight each, under a torque of 0.07 N m; no gravity"
)
def _turned(lab: Lab) -> Recording:
    return _pushed(
        lab,
        grasp_scene(0.1, gravity=0.0),
        lambda _: (0.0, 0.0, 0.0, TURNING_N_M, 0.0, 0.0),
    )


@_turned.check("grasp-torsion")
def _grasp_torsion(rollout: Recording) -> Measurement:
    angles_rad = rollout.rotation("object").as_rotvec()[:, 0]
    rate_rad_per_s2 = acceleration_m_per_s2(rollout.times_s, angles_rad)
    held_n_m = TURNING_N_M - box_inertia_kg_m2(OBJECT)[0] * rate_rad_per_s2
    return Measurement(measured=torque_share(held_n_m), expected=sum(SHARES) / 2.0)


_tilt = Rotation.from_euler("x", RELEASE_RAD)
_off_centre = replace(
    OBJECT,
    pose=Pose.from_rotation(vector(MIDDLE_M + _tilt.apply([0.0, 0.0, -OFF_M])), _tilt),
)


@recorded(
    "the same box between balls of 5 mm radius that press with five times its weight 50 mm above its centre, released "
    "at 0.7 rad"
)
def _swinging(lab: Lab) -> Recording:
    scene = grasp_scene(2.0, pad=TIP, grasped=_off_centre)
    return lab.rollout(scene, wrenches=grasp_wrenches(5.0 * WEIGHT_N))


@_swinging.check("grasp-swing")
def _grasp_swing(rollout: Recording) -> Measurement:
    angles = rollout.rotation("object").as_rotvec()[:, 0]
    gyration = float(np.sqrt(box_inertia_kg_m2(OBJECT)[0] / MASS_KG))
    expected = pendulum_period_s(
        length_m=OFF_M,
        gyration_m=gyration,
        amplitude_rad=RELEASE_RAD,
        gravity_m_per_s2=G,
    )
    return Measurement(
        measured=mean_period_s(rollout.times_s, angles), expected=expected
    )
