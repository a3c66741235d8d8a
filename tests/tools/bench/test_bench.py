"""Scenes of the bench: measurements of motions that are known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Pose, Scene
from gauge_envs.tools.bench.drop import (
    RADIUS_M,
    balls_above_ground,
    bounce_of,
    drop_scene,
    fall_s,
)
from gauge_envs.tools.bench.grasp import (
    HELD,
    OBJECT,
    TURNED,
    from_pads_m,
    pad_creep_um_per_s,
    pad_depth_um,
    spin_torque_share,
    torque_share,
)
from gauge_envs.tools.bench.parts import box_inertia_kg_m2, contact, ground
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.bench.slope import (
    Slope,
    acceleration_downhill_m_per_s2,
    creep_m_per_s,
    friction_of_slide,
    moved_m,
)
from gauge_envs.tools.bench.turning import (
    INERTIA_SHARES,
    ROLL,
    SPIN,
    turning_arm_m,
    turning_scene,
)


def rollout_of(scene, times_s, **moved):
    """Return a rollout in which bodies move by given displacements [m], shape [sample_count, 3]; the others rest."""
    states = {}
    for body in scene.bodies:
        rows = np.zeros((len(times_s), 13))
        rows[:, :3] = np.array(body.pose.position_m) + moved.get(
            body.name, np.zeros((len(times_s), 3))
        )
        rows[:, 3:7] = body.pose.quaternion
        states[body.name] = rows
    return Recording(scene=scene, times_s=times_s, states=states)


# --- slopes ----------------------------------------------------------------------------------------------------------


def leaning(slope_deg, turn_deg=0.0):
    turned = Rotation.from_euler("zy", [turn_deg, slope_deg], degrees=True)
    return Pose.from_rotation(
        (0.2, 0.1, 1.0), Rotation.from_euler("z", 50.0, degrees=True) * turned
    )


@pytest.mark.parametrize("turn_deg", [0.0, 30.0])
def test_a_slope_has_its_angle_and_falls_downhill(turn_deg):
    slope = Slope.of(leaning(25.0, turn_deg))
    downhill, across, normal = slope.axes
    assert np.degrees(slope.angle_rad) == pytest.approx(25.0)
    assert downhill == pytest.approx(
        np.array([math.cos(math.radians(25.0)), 0.0, -math.sin(math.radians(25.0))])
        @ Rotation.from_euler("z", 50.0, degrees=True).as_matrix().T
    )
    assert np.array([downhill, across, normal]) @ slope.axes.T == pytest.approx(
        np.eye(3)
    )


def test_a_level_support_has_the_axes_of_its_frame():
    pose = Pose.from_euler_deg((0.0, 0.0, 0.0), (0.0, 0.0, 40.0))
    slope = Slope.of(pose)
    assert slope.angle_rad == pytest.approx(0.0, abs=1e-12)
    assert slope.axes[0] == pytest.approx(pose.rotation.apply([1.0, 0.0, 0.0]))


def sliding(acceleration, lift, creep=0.0):
    """Return a ball on a plane that leans by 25 degrees, which accelerates along and off it, and creeps."""
    plane = replace(ground(), name="plane", pose=leaning(25.0, 30.0))
    (ball,) = balls_above_ground({"ball": 0.0}, spacing_m=0.0)
    scene = Scene(
        bodies=(ball, plane),
        contacts=(contact("ball", "plane", friction=0.3),),
        duration_s=0.5,
    )
    times_s = np.linspace(0.0, 0.5, 91)
    along = 0.5 * acceleration * times_s**2 + creep * times_s
    off = 0.5 * lift * times_s**2
    downhill, _, normal = Slope.of(plane.pose).axes
    return rollout_of(
        scene, times_s, ball=np.outer(along, downhill) + np.outer(off, normal)
    )


def test_a_slide_has_its_acceleration_and_friction():
    slope, friction, lift = math.radians(25.0), 0.3, 0.1
    down = G * math.sin(slope) - friction * (G * math.cos(slope) + lift)
    rollout = sliding(down, lift)
    assert acceleration_downhill_m_per_s2(rollout, "ball", "plane") == pytest.approx(
        down
    )
    assert friction_of_slide(rollout, "ball", "plane", start_s=0.1) == pytest.approx(
        friction
    )
    assert moved_m(rollout, "ball", "plane")[-1] == pytest.approx(
        [0.125 * down, 0.0, 0.125 * lift], abs=1e-12
    )


def test_creep_is_along_the_slope():
    assert creep_m_per_s(
        sliding(0.0, 0.0, 1e-3), "ball", "plane", start_s=0.2
    ) == pytest.approx(1e-3)


# --- drops -----------------------------------------------------------------------------------------------------------


def test_each_ball_has_its_bounce():
    drops_m = {"low": 0.1, "high": 0.4}
    scene = drop_scene(
        balls_above_ground(drops_m, spacing_m=0.3), (), seconds=0.5, gravity=G
    )
    times_s = np.linspace(0.0, 0.45, 82)
    paths = {}
    for name, drop_m in drops_m.items():
        falls_s = fall_s(drop_m, G)
        after_s = times_s - falls_s
        rising = 0.6 * G * falls_s * after_s - 0.5 * G * after_s**2
        heights = np.where(
            after_s < 0.0, drop_m - 0.5 * G * times_s**2, np.maximum(rising, 0.0)
        )
        paths[name] = np.outer(heights - drop_m, [0.0, 0.0, 1.0])
    rollout = rollout_of(scene, times_s, **paths)
    for name in drops_m:
        found = bounce_of(rollout, name)
        assert found.restitution == pytest.approx(0.6)
    assert bounce_of(rollout_of(scene, times_s), "low") is None


# --- balls that turn -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", [SPIN, ROLL])
def test_the_arm_of_a_turn_is_the_torque_over_the_normal_force(axis):
    arm_m = 2e-4
    rate = arm_m * G / (INERTIA_SHARES[axis] * RADIUS_M**2)
    times_s = np.linspace(0.0, 0.4, 73)
    rollout = rollout_of(
        turning_scene(0.4, 0.0, (0.0, 0.0, 20.0), torsion_m=arm_m), times_s
    )
    rollout.states["ball"][:, 10:] = np.outer(20.0 - rate * times_s, axis)
    assert turning_arm_m(rollout, axis, start_s=0.1) == pytest.approx(arm_m)


# --- grasps ----------------------------------------------------------------------------------------------------------


def test_pads_that_close_sink_in_and_a_box_that_falls_creeps():
    times_s = np.linspace(0.0, 1.5, 271)
    closed = np.outer(np.where(times_s > 0.0, 3e-6, 0.0), [1.0, 0.0, 0.0])
    fallen = np.outer(-2e-6 * times_s, [0.0, 0.0, 1.0])
    rollout = rollout_of(HELD, times_s, left=closed, right=-closed, object=fallen)
    assert pad_depth_um(rollout) == pytest.approx(3.0)
    assert pad_creep_um_per_s(rollout) == pytest.approx(2.0)
    assert from_pads_m(rollout)[-1] == pytest.approx([0.0, 0.0, -3e-6])


def test_a_box_that_stops_between_its_pads_had_their_torque():
    """Its energy goes into the angle that it turns."""
    torque_n_m, inertia = 0.02, box_inertia_kg_m2(OBJECT)[0]
    times_s = np.linspace(0.0, 0.1, 19)
    rollout = rollout_of(TURNED, times_s)
    rollout.states["object"][:, 10] = 20.0 - torque_n_m / inertia * times_s
    assert spin_torque_share(rollout) == pytest.approx(torque_share(torque_n_m))
