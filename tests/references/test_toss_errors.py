"""Scores of single tosses against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.toss_errors import (
    bootstrap_interval,
    energies_j,
    impacts,
    perturbed_start,
    shot_error,
    upper_face,
)
from gauge_envs import load_experiment
from gauge_envs.errors import ShapeError
from gauge_envs.references.single_shot import SingleShot, single_shots

NAME = "CubeToss-acrylic"
TIMES_S = np.arange(181) / 180.0
GRAVITY = 9.80665


def shot_of(positions_m, rotations):
    return SingleShot(
        body="cube",
        trial=0,
        source_number=0,
        times_s=TIMES_S,
        positions_m=positions_m,
        quaternions=rotations.as_quat(scalar_first=True),
        velocity_m_per_s=np.zeros(3),
        angular_velocity_rad_per_s=np.zeros(3),
    )


def test_errors_of_a_known_shift_and_turn():
    turned = Rotation.from_rotvec(np.outer(TIMES_S, [0.0, 0.0, 2.0]))
    places = np.column_stack([TIMES_S, TIMES_S**2, np.full(181, 0.1)])
    shot = shot_of(places, turned)
    zero = shot_error(shot, TIMES_S, places, turned)
    assert zero.rest_mm == pytest.approx(0.0, abs=1e-9)
    assert zero.rest_deg == pytest.approx(0.0, abs=1e-5)
    found = shot_error(
        shot,
        TIMES_S,
        places + np.array([0.003, 0.004, 0.0]),
        Rotation.from_euler("x", 7.0, degrees=True) * turned,
    )
    for name in ("early", "mean", "rest"):
        assert getattr(found, f"{name}_mm") == pytest.approx(5.0)
        assert getattr(found, f"{name}_deg") == pytest.approx(7.0)
    assert found.same_face
    over = shot_error(
        shot, TIMES_S, places, Rotation.from_euler("x", 90.0, degrees=True) * turned
    )
    assert not over.same_face
    assert over.rest_deg == pytest.approx(90.0)


def test_errors_need_samples_up_to_the_early_time():
    shot = shot_of(np.zeros((181, 3)), Rotation.identity(181))
    with pytest.raises(ShapeError, match=r"end at 0\.017 s"):
        shot_error(shot, TIMES_S[:4], np.zeros((4, 3)), Rotation.identity(4))
    with pytest.raises(ShapeError, match="4 times"):
        shot_error(shot, TIMES_S[:4], np.zeros((3, 3)), Rotation.identity(4))


@pytest.mark.parametrize(
    ("euler", "face"),
    [((0, 0, 40), "+z"), ((180, 0, 10), "-z"), ((90, 0, 0), "+y"), ((0, 90, 0), "-x")],
)
def test_upper_face(euler, face):
    assert upper_face(Rotation.from_euler("xyz", euler, degrees=True)) == face


def test_energy_of_free_flight_is_constant_and_has_its_closed_form():
    cube = load_experiment(NAME).scene.body("cube")
    linear, angular = np.array([1.0, -0.5, 0.4]), np.array([3.0, -4.0, 5.0])
    places = np.outer(TIMES_S, linear)
    places[:, 2] += 2.0 - 0.5 * GRAVITY * TIMES_S**2
    energies = energies_j(
        cube, TIMES_S, places, Rotation.from_rotvec(np.outer(TIMES_S, angular))
    )
    expected = (
        0.5 * 0.37 * linear @ linear
        + 0.5 * 8.1e-4 * angular @ angular
        + 0.37 * GRAVITY * 2.0
    )
    np.testing.assert_allclose(energies, expected, rtol=1e-9)
    uniform = replace(cube, inertia_kg_m2=None)
    assert (
        energies_j(
            uniform, TIMES_S, places, Rotation.from_rotvec(np.outer(TIMES_S, angular))
        )[0]
        < expected - 1e-3
    )


@pytest.mark.parametrize(("restitution", "kind"), [(0.5, "face"), (0.3, "corner")])
def test_first_impact_of_a_drop(restitution, kind):
    cube = load_experiment(NAME).scene.body("cube")
    tilt = (
        Rotation.identity()
        if kind == "face"
        else Rotation.align_vectors([[0, 0, -1]], [[1, 1, 1]])[0]
    )
    reach = 0.0524 if kind == "face" else 0.0524 * np.sqrt(3.0)
    fall_s, speed = 0.3, GRAVITY * 0.3
    after_s = TIMES_S - fall_s
    heights = reach + np.where(
        after_s < 0.0,
        0.5 * GRAVITY * (fall_s**2 - TIMES_S**2),
        restitution * speed * after_s - 0.5 * GRAVITY * after_s**2,
    )
    places = np.column_stack([np.zeros((181, 2)), heights])
    found = impacts(cube, 0.0524, TIMES_S, places, Rotation.concatenate([tilt] * 181))
    assert len(found) >= 1
    first = found[0]
    assert first.kind == kind
    assert first.time_s == pytest.approx(0.3, abs=1e-6)
    assert first.approach_m_per_s == pytest.approx(speed, rel=0.01)
    assert first.restitution == pytest.approx(restitution, abs=0.01)
    # Gravity acts for about 17 ms on either side.
    assert first.energy_lost == pytest.approx(1.0 - restitution**2, abs=0.06)


def test_no_impact_without_contact():
    cube = load_experiment(NAME).scene.body("cube")
    assert (
        impacts(cube, 0.0524, TIMES_S, np.full((181, 3), 0.3), Rotation.identity(181))
        == []
    )


def test_perturbed_starts_scatter_as_the_measurement():
    shots = single_shots(NAME)
    nuisances = shots.sidecar.nuisances
    cube = load_experiment(NAME).scene.body("cube")
    drawn = [perturbed_start(cube, nuisances, seed=seed) for seed in range(400)]
    heights = np.array([one.pose.position_m[2] for one in drawn])
    assert np.std(heights) == pytest.approx(nuisances.rest_height_std_m, rel=0.1)
    turns = [
        (one.pose.rotation * cube.pose.rotation.inv()).as_rotvec() for one in drawn
    ]
    horizontal = np.degrees(np.linalg.norm(np.array(turns)[:, :2], axis=1))
    assert np.sqrt(np.mean(horizontal**2)) == pytest.approx(
        nuisances.rest_tilt_deg, rel=0.1
    )
    assert perturbed_start(cube, nuisances, seed=1) == perturbed_start(
        cube, nuisances, seed=1
    )


def test_bootstrap_interval_of_a_mean_has_the_width_of_theory():
    values = np.random.default_rng(3).normal(10.0, 2.0, 400)
    low, high = bootstrap_interval(values, np.mean)
    assert high - low == pytest.approx(2 * 1.96 * 2.0 / 20.0, rel=0.15)
    assert low < 10.0 < high
