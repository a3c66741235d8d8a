"""Measurements of the bench return the constants of motions that closed forms give: slides, bounces, turns, grasps."""

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
    GRASPED,
    OBJECT,
    TURNED,
    from_pads_m,
    pad_creep_um_per_s,
    pad_depth_um,
    spin_torque_share,
    torque_share,
)
from gauge_envs.tools.bench.parts import ball, box_inertia_kg_m2, contact, ground
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.bench.slope import (
    Slope,
    acceleration_downhill_m_per_s2,
    creep_m_per_s,
    friction_of_slide,
    moved_m,
)
from gauge_envs.tools.bench.turning import ROLL, SPIN, turning_arm_m, turning_scene


def recording_of(scene, times_s, **moved):
    """Return a recording in which bodies move by displacements [m], shape [sample_count, 3]; the others rest."""
    states = {}
    for body in scene.bodies:
        rows = np.zeros((len(times_s), 13))
        rows[:, :3] = body.pose.position_m + moved.get(body.name, np.zeros(3))
        rows[:, 3:7] = body.pose.quaternion
        states[body.name] = rows
    return Recording(scene=scene, times_s=times_s, states=states)


# --- slopes ----------------------------------------------------------------------------------------------------------

LEAN = Rotation.from_euler("ZYZ", [50.0, 25.0, 30.0], degrees=True)
"""A slope of 25 degrees that falls towards 50 degrees from x, whose frame is turned about its normal."""

FALL = np.radians(25.0)


def test_a_slope_has_its_angle_and_falls_downhill():
    slope = Slope.of(Pose.from_rotation((0.2, 0.1, 1.0), LEAN))
    heading = np.radians(50.0)
    level = np.array([math.cos(heading), math.sin(heading), 0.0])
    downhill = math.cos(FALL) * level - [0.0, 0.0, math.sin(FALL)]
    normal = math.sin(FALL) * level + [0.0, 0.0, math.cos(FALL)]
    assert slope.angle_rad == pytest.approx(FALL)
    expected = np.array([downhill, np.cross(normal, downhill), normal])
    assert slope.axes == pytest.approx(expected)
    turned = Pose.from_euler_deg((0.0, 0.0, 0.0), (0.0, 0.0, 40.0))
    assert Slope.of(turned).angle_rad == pytest.approx(0.0, abs=1e-12)
    assert Slope.of(turned).axes[0] == pytest.approx(turned.rotation.apply([1, 0, 0]))


def slide(acceleration, lift, creep=0.0):
    """Return a ball that accelerates down a slope and off it, and creeps."""
    plane = replace(ground(), pose=Pose.from_rotation((0.2, 0.1, 1.0), LEAN))
    touch = contact("ball", "ground", friction=0.3)
    scene = Scene(
        bodies=(ball("ball", (0.0, 0.0, 2.0)), plane),
        contacts=(touch,),
        duration_s=0.5,
    )
    times_s = np.linspace(0.0, 0.5, 91)
    along = 0.5 * acceleration * times_s**2 + creep * times_s
    downhill, _, normal = Slope.of(plane.pose).axes
    path = np.outer(along, downhill) + np.outer(0.5 * lift * times_s**2, normal)
    return recording_of(scene, times_s, ball=path)


def test_a_slide_has_its_acceleration_and_friction():
    """a = g sin - mu (g cos + lift)."""
    friction, lift = 0.3, 0.1
    down = G * math.sin(FALL) - friction * (G * math.cos(FALL) + lift)
    sliding = slide(down, lift), "ball", "ground"
    assert acceleration_downhill_m_per_s2(*sliding) == pytest.approx(down)
    assert friction_of_slide(*sliding, start_s=0.1) == pytest.approx(friction)
    end = [0.125 * down, 0.0, 0.125 * lift]
    assert moved_m(*sliding)[-1] == pytest.approx(end, abs=1e-12)
    creeping = slide(0.0, 0.0, 1e-3), "ball", "ground"
    assert creep_m_per_s(*creeping, start_s=0.2) == pytest.approx(1e-3)


# --- drops and turns -------------------------------------------------------------------------------------------------


def test_each_ball_has_its_bounce():
    drops_m = {"low": 0.1, "high": 0.4}
    balls = balls_above_ground(drops_m, spacing_m=0.3)
    scene = drop_scene(balls, (), seconds=0.5, gravity=G)
    times_s = np.linspace(0.0, 0.45, 82)
    paths = {}
    for name, drop_m in drops_m.items():
        after_s = times_s - fall_s(drop_m, G)
        rising = 0.6 * math.sqrt(2.0 * G * drop_m) * after_s - 0.5 * G * after_s**2
        falling = drop_m - 0.5 * G * times_s**2
        heights = np.where(after_s < 0.0, falling, np.maximum(rising, 0.0))
        paths[name] = np.outer(heights - drop_m, [0.0, 0.0, 1.0])
    bounces = recording_of(scene, times_s, **paths)
    for name in drops_m:
        assert bounce_of(bounces, name).restitution == pytest.approx(0.6)
    assert bounce_of(recording_of(scene, times_s), "low") is None


@pytest.mark.parametrize(("axis", "share"), [(SPIN, 2 / 5), (ROLL, 7 / 5)])
def test_the_arm_of_a_turn_is_the_torque_over_the_normal_force(axis, share):
    """About its contact point a ball has 2/5 m r^2 about the normal, and 7/5 m r^2 across it."""
    arm_m = 2e-4
    rate = arm_m * G / (share * RADIUS_M**2)
    times_s = np.linspace(0.0, 0.4, 73)
    scene = turning_scene(0.4, 0.0, (0.0, 0.0, 20.0), torsion_m=arm_m)
    turning = recording_of(scene, times_s)
    turning.states["ball"][:, 10:] = np.outer(20.0 - rate * times_s, axis)
    assert turning_arm_m(turning, axis, start_s=0.1) == pytest.approx(arm_m)


# --- grasps ----------------------------------------------------------------------------------------------------------


def test_pads_that_close_sink_in_and_a_box_that_falls_creeps():
    times_s = np.linspace(0.0, 1.5, 271)
    closed = np.outer(np.where(times_s > 0.0, 3e-6, 0.0), [1.0, 0.0, 0.0])
    fallen = np.outer(-2e-6 * times_s, [0.0, 0.0, 1.0])
    grasp = recording_of(GRASPED, times_s, left=closed, right=-closed, object=fallen)
    assert pad_depth_um(grasp) == pytest.approx(3.0)
    assert pad_creep_um_per_s(grasp) == pytest.approx(2.0)
    assert from_pads_m(grasp)[-1] == pytest.approx([0.0, 0.0, -3e-6])


def test_a_box_that_stops_between_its_pads_had_their_torque():
    """Its energy goes into the angle that it turns."""
    torque_n_m, inertia = 0.02, box_inertia_kg_m2(OBJECT)[0]
    times_s = np.linspace(0.0, 0.1, 19)
    grasp = recording_of(TURNED, times_s)
    grasp.states["object"][:, 10] = 20.0 - torque_n_m / inertia * times_s
    assert spin_torque_share(grasp) == pytest.approx(torque_share(torque_n_m))
