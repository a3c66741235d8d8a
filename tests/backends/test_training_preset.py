"""The preset `training` of the engines that build deformable bodies: it exists, follows the scene, and stays near."""

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends import backend

SCENES = (
    "TextileFlinging-satin",
    "TextileStretching-oxford",
    "TableclothPulling-wood",
    "RotatingBall-satin",
    "FoamTwisting-soft",
    "CantileverBeam-soft",
    "RopeWinding-rubber",
    "StickStack-soft",
    "SlopeSlider-3-wood",
    "BouncingBall-rubber",
    "NewtonsCradle-metal",
    "Pendulum-metal",
    "WallBreaking-wood",
)


@pytest.mark.parametrize("engine", ["mujoco", "newton"])
@pytest.mark.parametrize("name", SCENES)
def test_every_scene_has_a_training_preset_that_is_not_finer(engine, name):
    scene = load_experiment(name).scene
    chosen = backend(engine)
    default, training = (
        chosen.resolved_settings(scene, changes)
        for changes in ({}, {"preset": "training"})
    )
    assert training["preset"] == "training"
    assert training["timestep_s"] >= default["timestep_s"]
    if default.get("cell_m") is not None:
        assert training["cell_m"] >= default["cell_m"]
    # What a user states stays.
    stated = chosen.resolved_settings(
        scene, {"preset": "training", "timestep_s": 1 / 1800}
    )
    assert stated["timestep_s"] == 1 / 1800
    assert {
        key: value for key, value in stated.items() if key != "timestep_s"
    }.items() <= training.items()


@pytest.mark.parametrize(
    ("name", "frames", "limit_mm"),
    [
        # The cloth is accelerated through 1 cm; cells twice as wide move its hem late.
        ("TextileFlinging-satin", 12, 1.0),
        # Half the cells of the default move it by 0.3 mm.
        ("FoamTwisting-soft", 8, 0.05),
        # The slide starts within a step of 0.56 ms, at 3.5 m/s^2 after 0.4 s: 0.8 mm.
        ("SlopeSlider-2-wood", 12, 0.8),
    ],
)
def test_a_trajectory_for_training_is_near(name, frames, limit_mm, rollout):
    paths = []
    for settings in ({}, {"preset": "training"}):
        env, trajectory, _ = rollout(
            name, frames=frames, settings=settings, marker_proxy="material"
        )
        paths.append(
            1e3
            * (
                trajectory.bodies[..., :3]
                if trajectory.bodies.size
                else trajectory.markers_m
            )
        )
        env.close()
    apart_mm = np.linalg.norm(paths[1] - paths[0], axis=-1)
    assert 0.0 < apart_mm.max() < limit_mm
    assert np.ptp(paths[0], axis=0).max() > 3.0 * limit_mm, "something moves"
