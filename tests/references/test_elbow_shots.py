"""The recorded tosses of two hinged blocks: their conventions against laws of flight, scores, and planted faults."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment, reference_band
from gauge_envs.backends import backend_for, backend_names
from gauge_envs.errors import MissingExtraError, ParameterError
from gauge_envs.experiments.resolve import with_trial
from gauge_envs.references.single_shot import ShotSidecar, single_shots
from gauge_envs.scene.hinged import hinge_angle_rad, hinge_frames

NAME = "ElbowToss-blocks"
BODIES = ("first", "second")
GRAVITY = 9.80665
ENGINES = tuple(
    name
    for name in backend_names()
    if name in ("mujoco", "rapier", "pybullet", "physx", "drake")
)


@pytest.fixture(scope="module")
def shots():
    return single_shots(NAME)


def with_sign(shots, sign):
    """Return the tosses with angles of the hinge of either sign."""
    return replace(
        shots,
        arrays=shots.arrays
        | {"angle": (sign * shots.arrays["angle"]).astype(np.int16)},
    )


def centre_drift_m(shots, trial, frames=14):
    """Return how far the recorded centre of mass is from a parabola with gravity, root mean square [m]."""
    places = np.mean(
        [shots.shot(trial, body).positions_m[:frames] for body in BODIES], axis=0
    )
    times = shots.shot(trial).times_s[:frames]
    places[:, 2] += 0.5 * GRAVITY * times**2
    line = np.polyfit(times, places, 1)
    return float(
        np.sqrt(np.mean(np.sum((places - np.vander(times, 2) @ line) ** 2, axis=1)))
    )


def last_height_m(shots, trial):
    """Return the height of the lowest corner of both blocks in the last frame [m]."""
    corners = load_experiment(NAME).scene.body("first").shape.corners_m
    last = [shots.shot(trial, body) for body in BODIES]
    return min(
        float((one.positions_m[-1] + one.rotations[-1].apply(corners))[:, 2].min())
        for one in last
    )


def test_the_tosses_are_all_there(shots):
    assert (len(shots), shots.sidecar.bodies) == (453, BODIES)
    assert sum(array.nbytes for array in shots.arrays.values()) < 2e6


@pytest.mark.parametrize("half", ["fit", "judge"])
def test_the_centre_of_mass_falls_freely(shots, half):
    assert (
        np.median([centre_drift_m(shots, trial) for trial in shots.trials(half)[::4]])
        < 0.6e-3
    )


def test_the_sign_of_the_hinge_puts_both_blocks_on_the_table(shots):
    """The authors shift each toss so that its lowest corner ends on the table; the other sign buries some blocks."""
    right, wrong = (
        [last_height_m(with_sign(shots, sign), trial) for trial in range(0, 453, 9)]
        for sign in (1, -1)
    )
    assert np.std(right) < 0.5e-3
    assert np.std(wrong) > 3e-3


def test_the_recorded_hinge_is_that_of_the_scene(shots):
    for trial in (0, 7, 300):
        scene = with_trial(load_experiment(NAME), trial).scene
        frames = hinge_frames(
            scene.body_hinges[0], *(scene.body(name).pose for name in BODIES)
        )
        first, second = (shots.shot(trial, name) for name in BODIES)
        ends = [
            shot.positions_m + shot.rotations.apply(anchor)
            for shot, anchor in (
                (first, frames.first_anchor_m),
                (second, frames.second_anchor_m),
            )
        ]
        np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)
        angles = (
            np.pi
            / 32767.0
            * shots.arrays["angle"][slice(*shots.arrays["first"][trial : trial + 2]), 0]
        )
        since = (angles - angles[0] + np.pi) % (2.0 * np.pi) - np.pi
        found = hinge_angle_rad(frames, first.rotations, second.rotations)
        np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * since), atol=1e-9)


def test_start_rates_are_those_of_finite_differences(shots):
    slopes, rates = [], []
    for trial in shots.trials("judge")[::3]:
        rows = slice(*shots.arrays["first"][trial : trial + 2])
        angles = np.unwrap(
            np.pi / 32767.0 * shots.arrays["angle"][rows, 0].astype(float)
        )[:9]
        slopes.append(np.polyfit(np.arange(9) / 148.0, angles, 2)[1])
        rates.append(shots.arrays["start_angle_rate"][trial, 0])
    # Slopes over nine noisy frames scatter; with the other sign the correlation is negative.
    assert np.corrcoef(slopes, rates)[0, 1] > 0.7


@pytest.mark.parametrize("engine", ENGINES)
def test_flights_of_engines_follow_the_records(shots, engine):
    """Engines reproduce the recorded flight with its start, so the second block and the hinge are where they should."""
    errors = []
    for trial in (1, 3, 21):
        scene = with_trial(load_experiment(NAME), trial).scene
        try:
            simulation = backend_for(engine, None).build(scene)
        except MissingExtraError:
            pytest.skip(f"{engine} is not installed")
        simulation.reset(0)
        simulation.advance(0.1)
        for place, name in enumerate(BODIES):
            state = simulation.body_states(BODIES)[place]
            recorded, turned = shots.shot(trial, name).poses_at(np.array([0.1]))
            angle = (
                Rotation.from_quat(state[3:7], scalar_first=True) * turned.inv()
            ).magnitude()
            errors.append(
                [1e3 * np.linalg.norm(state[:3] - recorded[0]), np.degrees(angle[0])]
            )
        simulation.close()
    assert np.median(errors, axis=0)[0] < 2.0
    assert np.median(errors, axis=0)[1] < 2.0


def test_an_episode_is_scored_on_both_bodies(shots):
    env = gymnasium.make(f"GAUGE/{NAME}")
    observation, info = env.reset(options={"trial": 3})
    assert info["trial"] == 3
    for place, name in enumerate(BODIES):
        shot = shots.shot(3, name)
        np.testing.assert_allclose(
            observation["bodies"][place, :3], shot.positions_m[0], atol=1e-9
        )
        np.testing.assert_allclose(
            observation["bodies"][place, 7:10], shot.velocity_m_per_s, atol=1e-9
        )
        np.testing.assert_allclose(
            observation["bodies"][place, 10:],
            shot.angular_velocity_rad_per_s,
            atol=1e-9,
        )
    truncated = False
    while not truncated:
        *_, truncated, info = env.step(0)
    assert info["score"].grade == "trials"
    band = reference_band(with_trial(load_experiment(NAME), 3))
    assert band.coordinates == (
        "first.x",
        "first.y",
        "first.z",
        "second.x",
        "second.y",
        "second.z",
    )
    assert band.mean.shape == (25, 6)
    env.close()


def test_unknown_bodies_and_wrong_sidecars_are_refused(shots):
    with pytest.raises(
        ParameterError, match="'third' is not recorded; recorded are: first, second"
    ):
        shots.shot(0, "third")
    values = shots.sidecar.model_dump()
    for changes, message in (
        ({"hung": ()}, "errors of angles go together"),
        (
            {"hung": (values["hung"][0] | {"on": "third"},)},
            "a new body on one of first",
        ),
        (
            {"hung": (values["hung"][0] | {"axis": (0.0, 2.0, 0.0)},)},
            "not a unit vector",
        ),
    ):
        with pytest.raises(ValidationError, match=message):
            ShotSidecar.model_validate(values | changes)
