"""Sliders, ball joints, limits and inertia tensors: what contradicts them is an error with its cause."""

from dataclasses import replace

import pytest

from gauge_envs.backends import backend
from gauge_envs.errors import ParameterError
from gauge_envs.scene import BallJoint, Hinge, Scene, Slider, Tether
from gauge_envs.scene.jitter import Jitter, jittered
from gauge_envs.tools.bench.parts import ball, fixed_box

BALL = ball("ball", (0.0, 0.0, 1.0))
WALL = fixed_box("wall", (1.0, 0.0, 1.0), (0.1, 0.1, 0.1))
UP = (0.0, 0.0, 1.0)
SLIDER = Slider(body="ball", axis=UP)
SCENE = Scene(bodies=(BALL, WALL), guides=(SLIDER,), duration_s=1.0)
MOVING = replace(BALL, linear_velocity_m_per_s=(0.3, 0.0, 0.0))
HINGE = Hinge(body="ball", anchor_m=(0.0, 0.2, 1.0), axis=UP, limits_rad=(0.1, 0.4))


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"guides": (Slider(body="wall", axis=UP),)}, "'wall', which is no dynamic"),
        ({"guides": (Slider(body="gone", axis=UP),)}, "'gone', which is no dynamic"),
        ({"guides": (Slider(body="ball", axis=(0.0, 0.0, 2.0)),)}, "of length 2"),
        (
            {"guides": (SLIDER, BallJoint(body="ball", anchor_m=UP))},
            "and another joint",
        ),
        (
            {"joints": (Tether(body="ball", anchor_m=UP, length_m=1.0),)},
            "and another joint",
        ),
        ({"bodies": (MOVING, WALL)}, "none that its slider"),
        (
            {
                "bodies": (MOVING, WALL),
                "guides": (BallJoint(body="ball", anchor_m=(0.0, 0.0, 2.0)),),
            },
            "none that its slider or ball joint",
        ),
        (
            {"guides": (Slider(body="ball", axis=UP, limits_m=(0.1, 0.2)),)},
            "do not enclose its start",
        ),
        ({"guides": (), "joints": (HINGE,)}, "do not enclose its start"),
        (
            {
                "bodies": (
                    replace(BALL, inertia_kg_m2=(1.0, 1.0, 3.0, 0.0, 0.0, 0.0)),
                    WALL,
                )
            },
            "which no body has",
        ),
    ],
)
def test_what_contradicts_a_guide_or_a_tensor_is_an_error(changes, cause):
    with pytest.raises(ParameterError, match=cause):
        replace(SCENE, **changes)


def test_starts_on_guides_are_not_scattered():
    with pytest.raises(ParameterError, match="no start is scattered"):
        jittered(SCENE, Jitter(position_m=0.01), seed=0)


def test_states_belong_to_scenes_with_the_same_guides():
    free = replace(SCENE, guides=())
    states = [backend("mujoco").build(one).state().scene for one in (SCENE, free)]
    assert states[0] != states[1]
