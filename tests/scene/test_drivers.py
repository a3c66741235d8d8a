"""Prescribed motions against their closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from gauge_envs.scene import Pose
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.prescribed_motion import PrescribedMotion
from gauge_envs.scene.profiles import CosineProfile, SampledProfile, TrapezoidProfile
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S


def profiles():
    return [
        TrapezoidProfile(
            start_s=0.2, duration_s=1.0, accelerate_s=0.3, brake_s=0.2, amount=-0.6
        ),
        TrapezoidProfile(
            start_s=0.0, duration_s=1.0, accelerate_s=0.0, brake_s=0.5, amount=0.6
        ),
        CosineProfile(start_s=0.1, duration_s=1.35, amount=-0.6),
        SampledProfile(times_s=(0.0, 0.3, 0.5, 1.2), values=(0.0, 0.1, 0.4, 0.35)),
    ]


@pytest.mark.parametrize("profile", profiles(), ids=lambda p: type(p).__name__)
def test_rate_is_the_derivative_and_stays_below_its_bound(profile):
    times = np.linspace(-0.1, 1.7, 4001)
    rates = np.array([profile.rate(t) for t in times])
    values = np.array([profile.value(t) for t in times])
    central = np.gradient(values, times)
    jump = np.abs(np.diff(rates, append=rates[-1])) > 0.02
    near_jump = np.convolve(jump, np.ones(5), mode="same") > 0
    # The slope of a cubic has a kink at each sample, which a central difference rounds off.
    assert rates[~near_jump] == pytest.approx(central[~near_jump], abs=4e-3)
    assert np.abs(rates).max() <= profile.largest_rate * (1 + 1e-9)


def test_trapezoid_ends_are_exact():
    profile = TrapezoidProfile(
        start_s=0.2, duration_s=1.0, accelerate_s=0.3, brake_s=0.2, amount=-0.6
    )
    assert profile.value(0.2) == 0.0
    assert profile.value(1.2) == pytest.approx(-0.6)
    assert profile.value(5.0) == pytest.approx(-0.6)
    assert profile.cruise_rate == pytest.approx(-0.6 / 0.75)
    assert profile.value(0.5) == pytest.approx(0.5 * profile.cruise_rate * 0.3)


def test_cosine_peaks_in_the_middle():
    profile = CosineProfile(start_s=0.0, duration_s=1.35, amount=0.6)
    assert profile.rate(0.675) == pytest.approx(0.5 * np.pi * 0.6 / 1.35)


@given(
    amount=st.floats(-3.0, 3.0),
    shift=st.floats(-0.5, 0.5),
    time_s=st.floats(0.0, 2.0),
)
def test_state_is_consistent_between_pose_and_velocity(amount, shift, time_s):
    driver = Driver(
        body="b",
        motions=(
            DriverMotion(
                kind="translate",
                axis=(1.0, 0.0, 0.0),
                profiles=(CosineProfile(start_s=0, duration_s=2, amount=shift),),
            ),
            DriverMotion(
                kind="rotate",
                axis=(0.0, 0.6, 0.8),
                point_m=(0.1, 0.2, 0.3),
                profiles=(CosineProfile(start_s=0, duration_s=2, amount=amount),),
            ),
        ),
        provenance="nominal",
    )
    start = Pose.from_euler_deg((0.4, -0.1, 0.2), (20.0, 30.0, 40.0))
    step = 1e-5
    velocity = driver.path(start, np.array([time_s]))[0, 7:]
    before, after = driver.pose(start, time_s - step), driver.pose(start, time_s + step)
    linear = np.subtract(after.position_m, before.position_m) / (2 * step)
    expected = [
        *linear,
        *(after.rotation * before.rotation.inv()).as_rotvec() / (2 * step),
    ]
    # The profile is flat outside its two seconds, so the difference is one-sided at the ends, where it is at rest.
    assert velocity == pytest.approx(expected, abs=1e-3)


def test_rotation_about_a_point_keeps_the_distance():
    motion = DriverMotion(
        kind="rotate",
        axis=(0.0, 1.0, 0.0),
        point_m=(0.0, 0.0, -0.038),
        profiles=(CosineProfile(start_s=0, duration_s=1, amount=np.radians(33.2)),),
    )
    driver = Driver(body="b", motions=(motion,), provenance="video")
    start = Pose(position_m=(0.0, 0.0, 0.0))
    end = driver.pose(start, 2.0)
    assert np.linalg.norm(np.subtract(end.position_m, motion.point_m)) == pytest.approx(
        0.038
    )
    # Positive turn about +y takes +z towards +x: the +x end of a board goes down.
    assert end.position_m[0] == pytest.approx(0.038 * np.sin(np.radians(33.2)))
    assert end.to_world(np.array([0.25, 0.0, 0.0]))[2] < 0.0


def test_euler_angles_turn_about_fixed_axes_in_the_order_x_y_z():
    pose = Pose.from_euler_deg((0.0, 0.0, 0.0), (90.0, 0.0, 90.0))
    assert pose.to_world(np.array([0.0, 1.0, 0.0])) == pytest.approx([0.0, 0.0, 1.0])
    assert pose.to_world(np.array([0.0, 0.0, 1.0])) == pytest.approx([1.0, 0.0, 0.0])
    assert pose.to_body(pose.to_world(np.array([0.1, 0.2, 0.3]))) == pytest.approx(
        [0.1, 0.2, 0.3]
    )


START = np.array([0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5])
"""Position [m] and quaternion of a driven body before anything moves."""


def two_motions():
    """A translation and a rotation that actions change by 0.3 m/s and 0.3 rad/s."""
    shift, turn = (
        DriverMotion(
            kind=kind,
            axis=(0.0, 0.6, 0.8),
            point_m=(0.1, 0.2, 0.4),
            profiles=(CosineProfile(start_s=0.0, duration_s=0.5, amount=amount),),
            residual_rate=0.3,
        )
        for kind, amount in (("translate", 0.2), ("rotate", 0.7))
    )
    return Driver(body="plate", motions=(shift, turn), provenance="nominal")


def ends_of(targets):
    """Return pose and velocity at the end of uniformly accelerated intervals, shape [..., 13]."""
    velocity, acceleration = targets[..., 7:13], targets[..., 13:]
    travel = SAMPLE_INTERVAL_S * velocity + 0.5 * SAMPLE_INTERVAL_S**2 * acceleration
    turned = Rotation.from_rotvec(travel[..., 3:].reshape(-1, 3)) * Rotation.from_quat(
        targets[..., 3:7].reshape(-1, 4), scalar_first=True
    )
    quaternions = turned.as_quat(scalar_first=True).reshape(targets[..., 3:7].shape)
    places = targets[..., :3] + travel[..., :3]
    return np.concatenate([places, quaternions], axis=-1)


@pytest.mark.parametrize("action", [0.0, 0.7])
def test_each_interval_ends_where_the_next_one_begins(action):
    motion = PrescribedMotion(two_motions(), START, 60)
    rows = [
        motion.targets(6 * frame, np.full((1, 2), action), 6)[:, 0]
        for frame in range(10)
    ]
    targets = np.concatenate(rows)
    assert ends_of(targets[:-1]) == pytest.approx(targets[1:, :7], abs=1e-12)
    assert targets[0, :7] == pytest.approx(START)


def test_worlds_are_driven_as_one_alone_also_after_an_action_of_one_motion():
    """Actions move one motion of the first world, both of the second, and none of the third."""
    together = PrescribedMotion(two_motions(), START, 48, world_count=3)
    alone = [PrescribedMotion(two_motions(), START, 48) for _ in range(3)]
    acted = np.array([[1.0, 0.0], [0.5, -1.0], [0.0, 0.0]])
    for interval in range(8):
        actions = acted if interval in (1, 2) else np.zeros((3, 2))
        rows = together.targets(interval, actions)[0]
        expected = [
            motion.targets(interval, action[None])[0, 0]
            for motion, action in zip(alone, actions, strict=True)
        ]
        assert rows == pytest.approx(np.array(expected), abs=1e-9)


def test_a_reset_gives_worlds_other_places_and_other_drivers():
    motion = PrescribedMotion(two_motions(), START, 12, world_count=2)
    motion.targets(0, np.ones((2, 2)), 6)
    elsewhere = START + np.eye(7)[0]
    later = two_motions()
    slower = replace(later.motions[0], residual_rate=0.1)
    other = replace(later, motions=(slower, later.motions[1]), provenance="mocap")
    motion.reset([later, other], np.array([START, elsewhere]))
    expected = [
        PrescribedMotion(driver, start, 12).targets(0, np.zeros((1, 2)), 12)
        for driver, start in ((later, START), (other, elsewhere))
    ]
    found = motion.targets(0, np.zeros((2, 2)), 12)
    assert found == pytest.approx(np.concatenate(expected, axis=1))


@pytest.mark.parametrize("angle_rad", [0.3, 3.0, 3.3, 6.0, -3.5])
def test_mean_rate_of_an_interval_is_the_shorter_rotation(angle_rad):
    """The rotation vector of SciPy, also where the body turns by more than half a turn in one interval."""
    axis = (0.0, 0.6, 0.8)
    spin = DriverMotion(
        kind="rotate",
        axis=axis,
        point_m=(0.0, 0.0, 0.0),
        profiles=(
            SampledProfile(times_s=(0.0, SAMPLE_INTERVAL_S), values=(0.0, angle_rad)),
        ),
        residual_rate=1.0,
    )
    driver = Driver(body="plate", motions=(spin,), provenance="nominal")
    row = PrescribedMotion(driver, START, 1).targets(0, np.zeros((1, 1)))[0, 0]
    mean_rate_rad_s = row[10:13] + 0.5 * SAMPLE_INTERVAL_S * row[16:19]
    expected_rad = Rotation.from_rotvec(angle_rad * np.array(axis)).as_rotvec()
    assert mean_rate_rad_s * SAMPLE_INTERVAL_S == pytest.approx(expected_rad, abs=1e-9)
