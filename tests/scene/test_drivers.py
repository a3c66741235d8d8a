"""Prescribed motions: profiles against their integrals, poses against SciPy's rotations, and uniform accelerations."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from gauge_envs.fixtures.parts import body
from gauge_envs.scene import Box, Pose
from gauge_envs.scene.drivers import Driver, DriverMotion, recorded_coordinates
from gauge_envs.scene.prescribed_motion import PrescribedMotion
from gauge_envs.scene.profiles import CosineProfile, SampledProfile, TrapezoidProfile
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

TRAPEZOID = TrapezoidProfile(
    start_s=0.2, duration_s=1.0, accelerate_s=0.3, brake_s=0.2, amount=-0.6
)
PROFILES = [
    (TRAPEZOID, (0.2, 0.5, 1.0, 1.2), -0.6),
    (replace(TRAPEZOID, accelerate_s=0.0, brake_s=0.0), (0.2, 1.2), -0.6),
    (CosineProfile(start_s=0.1, duration_s=1.35, amount=0.6), (0.1, 1.45), 0.6),
    (
        SampledProfile(times_s=(0.1, 0.3, 0.5, 1.2), values=(0.0, 0.1, 0.4, 0.35)),
        (0.1, 0.3, 0.5, 1.2),
        0.35,
    ),
]


@pytest.mark.parametrize(("profile", "knots_s", "amount"), PROFILES)
def test_a_value_is_the_integral_of_the_rate_which_has_a_sharp_bound(
    profile, knots_s, amount
):
    for end_s in (0.05, 0.35, 0.6, 1.1, 1.3, 2.0):
        breaks = [knot for knot in knots_s if knot < end_s]
        moved, _ = quad(profile.rate, 0.0, end_s, points=breaks or None)
        assert profile.value(end_s) == pytest.approx(moved, abs=1e-9)
    assert profile.value(5.0) == pytest.approx(amount)
    rates = np.abs([profile.rate(time_s) for time_s in np.linspace(0.0, 1.5, 3001)])
    assert rates.max() == pytest.approx(profile.largest_rate, rel=1e-4)


def test_rates_are_the_closed_forms():
    assert TRAPEZOID.cruise_rate == pytest.approx(-0.6 / 0.75)
    assert TRAPEZOID.rate(0.2 + 0.1) == pytest.approx(TRAPEZOID.cruise_rate / 3.0)
    assert TRAPEZOID.rate(1.2 - 0.05) == pytest.approx(TRAPEZOID.cruise_rate / 4.0)
    cosine = CosineProfile(start_s=0.1, duration_s=1.35, amount=0.6)
    peak = 0.5 * np.pi * 0.6 / 1.35
    assert cosine.rate(0.1 + 1.35 / 6.0) == pytest.approx(0.5 * peak)


# --- poses -----------------------------------------------------------------------------------------------------------


def two_motions(shift=0.2, angle_rad=0.7, duration_s=0.5):
    """A translation followed by a rotation; an action of 1 changes them by 0.3 m/s and 0.3 rad/s."""
    motions = [
        DriverMotion(
            kind=kind,
            axis=axis,
            point_m=(0.1, 0.2, 0.4),
            profiles=(
                CosineProfile(start_s=0.0, duration_s=duration_s, amount=amount),
            ),
            residual_rate=0.3,
        )
        for kind, axis, amount in (
            ("translate", (1.0, 0.0, 0.0), shift),
            ("rotate", (0.0, 0.6, 0.8), angle_rad),
        )
    ]
    return Driver(body="plate", motions=tuple(motions), provenance="nominal")


@given(st.floats(-0.5, 0.5), st.floats(-3.0, 3.0), st.floats(0.01, 1.99))
def test_velocities_are_those_of_poses_and_poses_those_of_scipy(
    shift, angle_rad, time_s
):
    driver = two_motions(shift, angle_rad, duration_s=2.0)
    start = Pose.from_euler_deg((0.4, -0.1, 0.2), (20.0, 30.0, 40.0))
    phase = 0.5 * (1.0 - np.cos(0.5 * np.pi * time_s))
    axis, point_m = np.array([0.0, 0.6, 0.8]), np.array([0.1, 0.2, 0.4])
    rotation = Rotation.from_rotvec(phase * angle_rad * axis)
    arm_m = np.subtract(start.position_m, point_m) + phase * shift * np.eye(3)[0]
    place_m = point_m + rotation.apply(arm_m)
    pose = driver.pose(start, time_s)
    assert pose.position_m == pytest.approx(place_m)
    assert pose.matrix == pytest.approx((rotation * start.rotation).as_matrix())
    step = 1e-5
    before, after = driver.pose(start, time_s - step), driver.pose(start, time_s + step)
    linear = np.subtract(after.position_m, before.position_m)
    angular = (after.rotation * before.rotation.inv()).as_rotvec()
    velocity = driver.path(start, np.array([time_s]))[0, 7:]
    expected = np.concatenate([linear, angular]) / (2 * step)
    assert velocity == pytest.approx(expected, abs=1e-7)


def test_the_speed_of_a_driven_body_is_below_its_bound():
    """The farthest corner of a plate on a turning arm, with the largest action."""
    driver = two_motions(duration_s=2.0)
    plate = body("plate", Box(size_m=(0.2, 0.2, 0.02)), Pose(position_m=(0.1, 0, 0.4)))
    cruise = 0.5 * np.pi / 2.0
    corners_m = plate.pose.to_world(plate.shape.corners_m) - [0.1, 0.2, 0.4]
    arm_m = np.linalg.norm(np.cross(corners_m, [0.0, 0.6, 0.8]), axis=1).max()
    expected = 0.2 * cruise + 0.3 + (0.7 * cruise + 0.3) * arm_m
    assert driver.speed_limit_m_per_s(plate) == pytest.approx(expected)


# --- intervals -------------------------------------------------------------------------------------------------------

START = np.array([0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5])
"""Position [m] and quaternion of a driven body before anything moves."""


def ends_of(targets):
    """Return the pose at the end of uniformly accelerated intervals, shape [count, 7]."""
    velocity, acceleration = targets[:, 7:13], targets[:, 13:]
    travel = SAMPLE_INTERVAL_S * velocity + 0.5 * SAMPLE_INTERVAL_S**2 * acceleration
    turned = Rotation.from_rotvec(travel[:, 3:]) * Rotation.from_quat(
        targets[:, 3:7], scalar_first=True
    )
    places = targets[:, :3] + travel[:, :3]
    return np.concatenate([places, turned.as_quat(scalar_first=True)], axis=1)


@pytest.mark.parametrize("kept", [slice(0, 2), slice(0, 1), slice(1, 2)])
@pytest.mark.parametrize("action", [0.0, 0.7])
def test_each_interval_ends_where_the_next_one_begins(action, kept):
    """An action of 0.7 adds a displacement at 0.7 times the rate of the driver."""
    driver = two_motions()
    driver = replace(driver, motions=driver.motions[kept])
    motion = PrescribedMotion(driver, START, 60)
    actions = np.full((1, motion.motion_count), action)
    rows = [motion.targets(6 * frame, actions, 6)[:, 0] for frame in range(10)]
    targets = np.concatenate(rows)
    assert ends_of(targets[:-1]) == pytest.approx(targets[1:, :7], abs=1e-12)
    times_s = SAMPLE_INTERVAL_S * np.arange(60)
    values, rates = recorded_coordinates(driver.motions, times_s)
    values += 0.3 * action * times_s[:, None]
    states = driver.moved(np.tile(START, (60, 1)), values, rates + 0.3 * action)
    assert targets[:, :7] == pytest.approx(states[:, :7], abs=1e-12)
    # The acceleration is the mean over an interval: the change of velocity over its length.
    gains = np.diff(states[:, 7:], axis=0) / SAMPLE_INTERVAL_S
    assert targets[:-1, 13:] == pytest.approx(gains, abs=1e-9)


def test_each_world_is_driven_as_a_single_world_with_its_own_start_and_driver():
    """Actions move one motion of the first world, all of the second, and none of the third."""
    together = PrescribedMotion(two_motions(), START, 48, world_count=3)
    together.targets(0, np.ones((3, 2)), 6)
    drivers = [two_motions(), two_motions(angle_rad=0.3), two_motions()]
    start_poses = np.array([START, START, START + np.eye(7)[0]])
    together.reset(drivers, start_poses)
    alone = [
        PrescribedMotion(driver, start, 48)
        for driver, start in zip(drivers, start_poses, strict=True)
    ]
    acted = np.array([[1.0, 0.0], [0.5, -1.0], [0.0, 0.0]])
    for interval in range(5):
        actions = acted if interval in (1, 2) else np.zeros((3, 2))
        rows = together.targets(interval, actions)[0]
        expected = [
            motion.targets(interval, action[None])[0, 0]
            for motion, action in zip(alone, actions, strict=True)
        ]
        assert rows == pytest.approx(np.array(expected), abs=1e-9)
    together.reset()
    nominal = PrescribedMotion(two_motions(), START, 48).targets(0, np.zeros((1, 2)))
    targets = together.targets(0, np.zeros((3, 2)))
    assert targets == pytest.approx(np.repeat(nominal, 3, axis=1))


@pytest.mark.parametrize("angle_rad", [0.3, 3.3, -3.5])
def test_the_mean_rate_of_an_interval_is_the_shorter_rotation(angle_rad):
    """It is SciPy's rotation vector, even if the body rotates by more than half a turn in one interval."""
    profile = SampledProfile(times_s=(0.0, SAMPLE_INTERVAL_S), values=(0.0, angle_rad))
    spin = replace(two_motions().motions[1], profiles=(profile,))
    driver = Driver(body="plate", motions=(spin,), provenance="nominal")
    row = PrescribedMotion(driver, START, 1).targets(0, np.zeros((1, 1)))[0, 0]
    mean_rate_rad_s = row[10:13] + 0.5 * SAMPLE_INTERVAL_S * row[16:19]
    expected_rad = Rotation.from_rotvec(angle_rad * np.array(spin.axis)).as_rotvec()
    assert mean_rate_rad_s * SAMPLE_INTERVAL_S == pytest.approx(expected_rad, abs=1e-9)
