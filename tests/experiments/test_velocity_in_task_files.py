"""Start velocities in task files and in overrides."""

import math

import numpy as np
import pytest
from texts import changed_text

from gauge_envs import load_experiment
from gauge_envs.errors import ParameterError, TaskFileError
from gauge_envs.experiments.scene_builder import SceneBuilder
from gauge_envs.experiments.task_files import load_task
from gauge_envs.experiments.variants import find_variant, task_path

SLIDE = "SlopeSlider-2-wood"


def built(tmp_path, name, *replacements):
    """The builder of a variant whose task file has texts replaced."""
    variant = find_variant(name)
    path = tmp_path / f"{variant.family}.toml"
    changed_text(task_path(variant.family), *replacements, to=path)
    return SceneBuilder(path, load_task(path), variant, {})


def test_a_task_file_states_a_velocity(tmp_path):
    start = "ball = { position_m"
    scene = built(
        tmp_path,
        "BouncingBall-rubber",
        (
            start,
            "ball = { velocity_m_per_s = [1.0, 0.0, -2.0], angular_velocity_deg_per_s = [0, 180, 0], position_m",
        ),
    ).build()
    assert scene.body("ball").linear_velocity_m_per_s == (1.0, 0.0, -2.0)
    assert scene.body("ball").angular_velocity_rad_per_s == pytest.approx(
        (0.0, math.pi, 0.0)
    )


def test_a_task_file_whose_fixed_body_moves_is_refused(tmp_path):
    start = "ground = { position_m"
    with pytest.raises(
        TaskFileError, match="'ground' is fixed and has a start velocity"
    ):
        built(
            tmp_path,
            "BouncingBall-rubber",
            (start, "ground = { velocity_m_per_s = [1, 0, 0], position_m"),
        )


def test_an_override_states_a_velocity():
    scene = load_experiment(SLIDE, {"cube.velocity_m_per_s": (0.1, 0.0, 0.2)}).scene
    assert scene.body("cube").linear_velocity_m_per_s == (0.1, 0.0, 0.2)
    assert scene.body("cube").angular_velocity_rad_per_s == (0.0, 0.0, 0.0)


def test_the_velocity_of_a_pendulum_follows_from_its_angular_velocity():
    axis = np.array(load_experiment("Pendulum-metal").scene.joints[0].axis)
    scene = load_experiment(
        "Pendulum-metal", {"ball.angular_velocity_deg_per_s": tuple(90.0 * axis)}
    ).scene
    ball, hinge = scene.body("ball"), scene.joints[0]
    arm = np.subtract(ball.pose.position_m, hinge.anchor_m)
    assert ball.linear_velocity_m_per_s == pytest.approx(
        np.cross(0.5 * math.pi * axis, arm)
    )


@pytest.mark.parametrize(
    ("name", "key", "value", "message"),
    [
        (
            SLIDE,
            "board.velocity_m_per_s",
            (1.0, 0.0, 0.0),
            "'board' is fixed and has a start velocity",
        ),
        (SLIDE, "cube.velocity_m_per_s", (1.0, 0.0), "cube.velocity_m_per_s"),
        (
            "Pendulum-metal",
            "ball.velocity_m_per_s",
            (1.0, 2.0, 3.0),
            "does not rotate the body about its hinge",
        ),
        (
            "TextileBending-rayon",
            "textile.velocity_m_per_s",
            (1.0, 0.0, 0.0),
            "is deformable and starts at rest",
        ),
    ],
)
def test_an_override_that_cannot_be(name, key, value, message):
    with pytest.raises(ParameterError, match=message):
        load_experiment(name, {key: value})
