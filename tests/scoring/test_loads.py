"""Loads of rods and grips: wrong constants fail them, a right scene does not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.envs.episode import Episode
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.scene import Cloth
from gauge_envs.scoring.reference import reference_band, reference_loads
from gauge_envs.scoring.score import Score, score_trajectory
from gauge_envs.scoring.verification import COVERAGE_FACTOR, LEAST_FROZEN


def changed(scene, **factors):
    """Return a scene with factors on constants of its deformable body."""
    (body,) = scene.deformables
    values = {name: factor * getattr(body, name) for name, factor in factors.items()}
    return replace(scene, deformables=(replace(body, **values),))


def lighter(scene):
    """Return a scene with 0.8 of the density."""
    (body,) = scene.deformables
    names = (
        "mass_kg",
        *(("areal_density_kg_per_m2",) if isinstance(body, Cloth) else ()),
    )
    return changed(scene, **dict.fromkeys(names, 0.8))


def score(name, scene=None, settings=None):
    """Return the score of an episode on MuJoCo that ends with its last verified frame."""
    experiment = load_experiment(name)
    scene = scene or experiment.scene
    band = reference_band(experiment)
    simulation = BackendMuJoCo().build(scene, settings)
    episode = Episode(
        replace(experiment, scene=scene),
        simulation,
        band=band,
        marker_proxy=MarkerProxy.MATERIAL,
    )
    compared = band.points or band
    known = np.flatnonzero(np.isfinite(compared.mean).any(axis=1))
    ends = [
        last for load in reference_loads(experiment, band) for _, last in load.windows
    ]
    last = max(*ends, int(known[-1]))
    episode.begin()
    while episode.frame < last:
        episode.advance(episode.no_rates)
        assert episode.end_frame() is None
    recorded = episode.trajectory()
    # The frames after the last compared one do not count; the score needs them all the same.
    count = experiment.frame_count
    frames = np.full((count, recorded.frames.shape[1]), 0.0)
    frames[: len(recorded.frames)] = recorded.frames
    markers_m = np.full((count, *recorded.markers_m.shape[1:]), np.nan)
    markers_m[: len(recorded.markers_m)] = recorded.markers_m
    found = score_trajectory(
        experiment,
        band,
        times_s=np.arange(count) / 30.0,
        values=frames,
        markers_m=markers_m,
        wrenches=recorded.wrenches,
    )
    return found


@cache
def right_score(name):
    return score(name)


def in_u(found):
    """Return the distances in u, by quantity."""
    return {one.quantity: one.scaled for one in found.verifications}


@pytest.mark.parametrize(
    ("name", "pull"),
    [
        ("FoamCompressing-soft", "pull of the grips"),
        pytest.param(
            "FoamCompressing-hard", "pull of the grips", marks=pytest.mark.slow
        ),
    ],
)
def test_a_soft_and_light_bar_fails_both_loads_that_the_right_one_meets(name, pull):
    right = right_score(name)
    assert all(
        in_u(right)[one.quantity] < COVERAGE_FACTOR for one in right.also_verified
    )
    scene = load_experiment(name).scene
    wrong = in_u(score(name, lighter(changed(scene, young_modulus_pa=0.8))))
    assert wrong[pull] > LEAST_FROZEN
    assert wrong["weight in the grips"] > LEAST_FROZEN


def test_a_stiff_sheet_of_a_wrong_density_fails_both_numbers_of_flinging():
    """Coarse cells take a quarter of the time, and are as far off as the default ones within 1 u."""
    name, settings = "TextileFlinging-satin", {"cell_m": 0.04}
    right = score(name, settings=settings)
    assert in_u(right).keys() == {"positions of 63 markers", "force of the rod"}
    assert all(distance < LEAST_FROZEN for distance in in_u(right).values())
    assert right.verification.frozen > LEAST_FROZEN * right.verification.uncertainty
    scene = load_experiment(name).scene
    stiff = changed(scene, bend_stiffness_n_m_per_rad=1e4)
    wrong = score(name, lighter(stiff), settings)
    assert wrong.verification.scaled > LEAST_FROZEN
    assert in_u(wrong)["force of the rod"] > LEAST_FROZEN


def test_a_score_of_an_earlier_version_has_no_loads_and_is_read():
    values = Score(grade="model", unit="mm").to_dict()
    del values["also_verified"]
    assert Score.from_dict(values).also_verified == ()


def test_a_score_with_loads_is_read_as_it_was_written():
    found = right_score("FoamCompressing-soft")
    assert Score.from_dict(found.to_dict()).also_verified == found.also_verified
    assert len(found.verifications) == 3
