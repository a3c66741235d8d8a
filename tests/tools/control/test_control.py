"""Control tasks: their ids, reports, pages, and the uncertainty of their limits."""

import math

import approval
import gymnasium
import numpy as np
import pytest
from control_episodes import by_law, make
from opengl import needs_opengl

from gauge_envs import load_experiment
from gauge_envs.errors import GaugeError
from gauge_envs.references.uncertainties import friction_std
from gauge_envs.tools.control import control_tasks, find_control_task

NAMES = tuple(task.name for task in control_tasks())


@pytest.mark.parametrize("name", NAMES)
def test_each_id_has_its_own_limit_and_spaces(name):
    env = make(name)
    observation, info = env.reset(seed=0)
    assert observation in env.observation_space
    assert env.action_space.shape == (len(env.COMMANDED),)
    assert gymnasium.spec(f"GAUGE/{name}").max_episode_steps == env.steps
    assert info == {"frame": 0, "time_s": 0.0}
    assert 0.0 < env.limit.sigma < env.limit.value
    env.close()


def reset(env):
    env.reset(seed=0)
    return env


def test_wrong_calls_are_refused(approved):
    turntable = make("Turntable-Limit-wood")
    calls = {
        "unknown task": lambda: find_control_task("Turntable-Limit-wod"),
        "step before reset": lambda: make("Turntable-Limit-wood").step([0.0]),
        "report before the end": lambda: reset(turntable).report(),
        "jitter": lambda: turntable.reset(options={"jitterr": True}),
        "two actions": lambda: reset(turntable).step([0.0, 0.0]),
        "a large action": lambda: reset(turntable).step([1.1]),
        "no number": lambda: reset(turntable).step([math.nan]),
        "a word": lambda: reset(turntable).step("fast"),
    }
    approved("control/refused", approval.refused_calls(GaugeError, calls))


@needs_opengl
def test_picture_shows_the_board_tilting():
    env = make("SlopeSlider-Limit-wood", render_mode="rgb_array", width=160, height=120)
    level = reset(env).render()
    for _ in range(20):
        env.step(np.ones(1))
    assert (np.abs(env.render().astype(int) - level).max(axis=2) > 40).sum() > 50
    env.close()


@pytest.mark.usefixtures("rigid_only")
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("turntable", "Turntable-Limit-wood"),
        ("throw-json", "Throw-Limit-rubber --json"),
    ],
)
def test_what_is_shown_is_the_approved_text(gauge, approved, name, words):
    approved(f"control/{name}", approval.readable(gauge("show", *words.split())))


# --- limits and their uncertainty ---


def test_an_override_changes_the_limit_and_not_its_uncertainty():
    nominal = make("Turntable-Limit-plastic").limit
    other = make("Turntable-Limit-plastic", parameters={"cube.friction": 0.2}).limit
    assert (
        nominal.value
        == load_experiment("Turntable-1-plastic").scene.contacts[0].friction
    )
    assert other.value == 0.2
    assert other.sigma == nominal.sigma == friction_std(nominal.value, "plastic")


def test_a_task_steps_as_chosen_unless_settings_are_given():
    for settings, step_s in (
        ({"preset": "training"}, 1 / 180),
        ({"preset": "training", "timestep_s": 1 / 360}, 1 / 360),
    ):
        env = make("Throw-Limit-rubber", settings=settings)
        assert env.simulation.settings["timestep_s"] == step_s


def test_a_jittered_start_has_its_own_limit_and_the_next_start_the_nominal_one():
    env = make("Throw-Limit-rubber")
    nominal = env.limit.value
    env.reset(seed=1, options={"jitter": True})
    assert 1e-6 < abs(env.limit.value - nominal) < 0.01
    env.reset(seed=1, options={"jitter": False})
    assert env.limit.value == nominal
    assert by_law(env)[1].ratio < 1.0
