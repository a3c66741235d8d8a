"""Wrenches of attachments in MuJoCo, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.envs.episode import Episode
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.scene.scene import GRAVITY_M_PER_S2


def played(name, scene, frames):
    """Return holders and the wrenches at the samples of an episode, shape [sample_count, holder_count, 6]."""
    experiment = replace(load_experiment(name), scene=scene)
    simulation = BackendMuJoCo().build(scene)
    episode = Episode(
        experiment, simulation, band=None, marker_proxy=MarkerProxy.MATERIAL
    )
    found = []

    def read(_):
        found.append(simulation.grip_wrenches(scene.holders))

    episode.begin()
    while episode.frame < frames:
        episode.advance(episode.no_rates, after_sample=read)
        episode.end_frame()
    return scene.holders, np.array(found)


def test_a_rod_carries_the_weight_of_the_cloth_that_hangs_from_it():
    scene = load_experiment("TextileFlinging-satin").scene
    (cloth,) = scene.deformables
    holders, wrenches = played(
        "TextileFlinging-satin", replace(scene, drivers=()), frames=30
    )
    weight_n = cloth.areal_density_kg_per_m2 * 0.5 * 0.4 * GRAVITY_M_PER_S2
    assert holders == ("rod",)
    # Waves run along the warp; over whole seconds they cancel.
    mean = wrenches[:, 0].mean(axis=0)
    assert mean[2] == pytest.approx(weight_n, rel=0.01)
    assert np.abs(mean[[0, 1, 3, 4, 5]]).max() < 0.01 * weight_n


def test_grips_pull_a_bar_with_its_stiffness_and_carry_its_weight():
    scene = load_experiment("FoamStretching-soft").scene
    (bar,) = scene.deformables
    holders, wrenches = played("FoamStretching-soft", scene, frames=20)
    (driver,) = scene.drivers
    start = scene.body("base-2").pose
    moved_m = driver.state(start, 20 / 30)[0].position_m[2] - start.position_m[2]
    strain = moved_m / (0.2 - 2 * 0.01285)
    pull_n = bar.young_modulus_pa * 0.05**2 * strain
    low, high = wrenches[-1, :, 2]
    assert holders == ("base-1", "base-2")
    assert 0.5 * (high - low) == pytest.approx(pull_n, rel=0.03)
    assert (wrenches[:, :, 2].sum(axis=1)).mean() == pytest.approx(
        bar.mass_kg * GRAVITY_M_PER_S2, rel=0.01
    )


def test_grips_twist_a_bar_with_its_torsion_stiffness():
    scene = load_experiment("FoamTwisting-soft").scene
    (bar,) = scene.deformables
    _, wrenches = played("FoamTwisting-soft", scene, frames=30)
    (driver,) = scene.drivers
    start = scene.body("base-2").pose
    pose = driver.state(start, 1.0)[0]
    angle = (start.rotation.inv() * pose.rotation).magnitude()
    shear_pa = bar.young_modulus_pa / (2.0 * (1.0 + bar.poisson_ratio))
    # Torsion constant of a square of side a: 0.1406 a^4 (Timoshenko and Goodier, section 109).
    torque_n_m = shear_pa * 0.1406 * 0.05**4 * angle / (0.2 - 2 * 0.01285)
    low, high = wrenches[-1, :, 5]
    assert -high == pytest.approx(torque_n_m, rel=0.1)
    assert low == pytest.approx(-high, rel=0.01)


def test_ropes_and_rods_are_declined():
    scene = load_experiment("StickStack-soft").scene
    assert BackendMuJoCo().build(scene).grip_wrenches(scene.holders) is None
