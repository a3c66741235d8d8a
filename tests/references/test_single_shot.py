"""The recorded tosses: their conventions against finite differences and free flight, and planted faults."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gauge_envs import beyond_variants, load_experiment, variants
from gauge_envs.errors import ParameterError
from gauge_envs.references.single_shot import single_shots

NAME = "CubeToss-acrylic"
HALF_WIDTH_M = 0.0524
GRAVITY = 9.80665


@pytest.fixture(scope="module")
def shots():
    return single_shots(NAME)


def flights(shots, half):
    """Return trials with their number of frames before the cube is near the table."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    found = []
    for trial in shots.trials(half)[::4]:
        shot = shots.shot(trial)
        matrices = Rotation.from_quat(shot.quaternions, scalar_first=True).as_matrix()
        lowest = shot.positions_m[:, 2] + np.einsum(
            "tij,vj->tvi", matrices, HALF_WIDTH_M * signs
        )[:, :, 2].min(axis=1)
        if (count := int(np.argmax(lowest < 0.005))) >= 8:
            found.append((shot, count))
    return found


def drift(shot, count):
    """Return how far free flight from the start is from the record at its end: position [m], rotation [rad]."""
    time_s = shot.times_s[count - 1]
    fall = np.array([0.0, 0.0, 0.5 * GRAVITY * time_s**2])
    place = shot.positions_m[0] + shot.velocity_m_per_s * time_s - fall
    turned = Rotation.from_rotvec(shot.angular_velocity_rad_per_s * time_s)
    rotations = Rotation.from_quat(shot.quaternions[[0, count - 1]], scalar_first=True)
    apart = turned * rotations[0] * rotations[1].inv()
    return float(np.linalg.norm(place - shot.positions_m[count - 1])), float(
        apart.magnitude()
    )


def test_single_trials_are_beyond_the_75(shots):
    beyond = {variant.name for variant in beyond_variants()}
    assert {
        NAME,
        "CubePush-light",
        "SiliconeBeam-0g-silicone",
    } <= beyond
    assert not beyond & {variant.name for variant in variants()}
    assert len(variants()) == 75
    assert len(shots) == 499


@pytest.mark.parametrize("half", ["fit", "judge"])
def test_recorded_flights_follow_the_closed_form(shots, half):
    # Equal moments of inertia: a constant angular velocity, and a parabola with gravity. The judging
    # half has no part in the scale of lengths.
    drifts = np.array([drift(shot, count) for shot, count in flights(shots, half)])
    assert len(drifts) > 40
    assert np.median(drifts[:, 0]) < 0.3e-3
    assert np.median(np.degrees(drifts[:, 1])) < 0.3
    falls = []
    for shot, count in flights(shots, half):
        falls.append(
            -2.0 * np.polyfit(shot.times_s[:count], shot.positions_m[:count, 2], 2)[0]
        )
    # Three standard errors of a median.
    assert np.median(falls) == pytest.approx(
        GRAVITY, abs=3.0 * 1.25 * np.std(falls) / np.sqrt(len(falls))
    )


def test_start_velocities_are_those_of_finite_differences(shots):
    apart = []
    for shot, _ in flights(shots, "judge"):
        step_s = shot.times_s[1]
        rotations = Rotation.from_quat(shot.quaternions, scalar_first=True)
        linear = (shot.positions_m[2] - shot.positions_m[0]) / (2.0 * step_s)
        linear[2] += GRAVITY * step_s
        angular = (rotations[2] * rotations[0].inv()).as_rotvec() / (2.0 * step_s)
        apart.append(
            [
                np.linalg.norm(linear - shot.velocity_m_per_s),
                np.linalg.norm(angular - shot.angular_velocity_rad_per_s),
            ]
        )
    # The rates differ by 3 rad/s if those of the body are taken for those of the world.
    assert np.median(apart, axis=0) == pytest.approx([0.0, 0.0], abs=0.2)
    assert np.median(apart, axis=0)[0] < 0.02


def test_planted_faults_of_convention_are_seen(shots):
    """Each fault moves the median drift in free flight past the limits of the test above."""

    def world_rate(shot):
        start = Rotation.from_quat(shot.quaternions[0], scalar_first=True)
        return replace(
            shot,
            angular_velocity_rad_per_s=start.inv().apply(
                shot.angular_velocity_rad_per_s
            ),
        )

    def scalar_last(shot):
        return replace(shot, quaternions=np.roll(shot.quaternions, 1, axis=1))

    def unscaled(shot):
        scale = shots.stated["nuisances"]["length_scale"]
        return replace(
            shot,
            positions_m=shot.positions_m / scale,
            velocity_m_per_s=shot.velocity_m_per_s / scale,
        )

    def late_velocity(shot):
        lag = np.array(
            [0.0, 0.0, GRAVITY * shots.stated["nuisances"]["velocity_lag_s"]]
        )
        return replace(shot, velocity_m_per_s=shot.velocity_m_per_s + lag)

    for fault, column, limit in (
        (world_rate, 1, np.radians(0.3)),
        (scalar_last, 1, np.radians(0.3)),
        (unscaled, 0, 0.3e-3),
        (late_velocity, 0, 0.3e-3),
    ):
        found = [
            drift(fault(shot), count)[column] for shot, count in flights(shots, "judge")
        ]
        assert np.median(found) > 2.0 * limit, fault.__name__


def test_nuisances_agree_with_what_they_were_not_fitted_on(shots):
    nuisances = shots.stated["nuisances"]
    # The height of the resting cube gives the scale a second time.
    rest = [shots.shot(trial).positions_m[-1, 2] for trial in shots.trials("judge")]
    assert np.median(rest) == pytest.approx(HALF_WIDTH_M, abs=1e-4)
    unshifted = (np.median(rest) - nuisances["height_offset_m"]) / nuisances[
        "length_scale"
    ]
    assert HALF_WIDTH_M / unshifted == pytest.approx(
        nuisances["length_scale"], abs=4e-3
    )
    # Backward differences lag by half an interval.
    assert nuisances["velocity_lag_s"] == pytest.approx(
        0.5 / shots.stated["rate_hz"], rel=0.1
    )


def test_poses_between_frames_and_after_the_end(shots):
    shot = shots.shot(3)
    middle, _ = shot.poses_at(shot.times_s)
    np.testing.assert_allclose(middle, shot.positions_m, atol=1e-12)
    late, rotation = shot.poses_at(np.array([shot.duration_s, 9.0]))
    np.testing.assert_array_equal(late[0], late[1])
    assert (rotation[0] * rotation[1].inv()).magnitude() < 1e-12


def test_a_trial_that_does_not_exist_is_named(shots):
    with pytest.raises(
        ParameterError, match="trial 499 does not exist: choose 0 to 498"
    ):
        shots.shot(499)
    assert single_shots("SlopeSlider-2-wood") is None


def test_moment_of_inertia_is_the_stated_one():
    cube = load_experiment(NAME).scene.body("cube")
    assert cube.inertia_kg_m2 == pytest.approx(0.295 * HALF_WIDTH_M**2, rel=1e-3)
