"""Control tasks: their ids, errors, pages, and the uncertainty of their limits."""

import json
import math

import gymnasium
import pytest
from control_episodes import by_law, make

from gauge_envs import load_experiment
from gauge_envs.errors import ActionError, EpisodeError, UnknownNameError
from gauge_envs.references.uncertainties import friction_std
from gauge_envs.tools.control import names, play_paid, stored_policy


@pytest.mark.parametrize("name", names())
def test_each_id_has_its_limit_and_spaces(name):
    env = make(name)
    observation, info = env.reset(seed=0)
    assert observation in env.observation_space
    assert env.action_space.shape == (len(env.COMMANDED),)
    assert (
        gymnasium.spec(f"GAUGE/{name}").max_episode_steps
        == env.experiment.frame_count - 1
    )
    assert info == {"frame": 0, "time_s": 0.0}
    assert 0.0 < env.task.limit().sigma < env.task.limit().value


def test_wrong_calls_are_errors():
    env = make("Turntable-Limit-wood")
    with pytest.raises(EpisodeError, match="call reset before step"):
        env.step([0.0])
    env.reset(seed=0)
    with pytest.raises(EpisodeError, match="reported when it is over"):
        env.task.report()
    for action in ([0.0, 0.0], [1.1], [math.nan], "fast"):
        with pytest.raises(ActionError):
            env.step(action)


def test_a_page_shows_the_law_and_its_limit(gauge):
    assert "e v + (1 + e) V" in gauge("show", "Throw-Limit-rubber").stdout
    row = json.loads(gauge("show", "Throw-Limit-rubber", "--json").stdout)
    assert row["limit"]["value"] == make("Throw-Limit-rubber").task.limit().value
    assert (row["duration_s"], len(row["observed"])) == (3.0, 9)


# --- limits and their uncertainty ---


def test_an_override_changes_the_limit_and_not_its_uncertainty():
    nominal = make("Turntable-Limit-plastic").task.limit()
    overridden = make(
        "Turntable-Limit-plastic", parameters={"cube.friction": 0.2}
    ).task.limit()
    scene = load_experiment("Turntable-1-plastic").scene
    assert nominal.value == scene.contacts[0].friction
    assert overridden.value == 0.2
    assert overridden.sigma == nominal.sigma == friction_std(nominal.value, "plastic")


def test_a_task_steps_as_chosen_unless_a_step_is_given():
    for settings, step_s in (
        (None, 1 / 1800),
        ({"preset": "training"}, 1 / 180),
        ({"preset": "training", "timestep_s": 1 / 360}, 1 / 360),
    ):
        env = make("SlopeSlider-Limit-wood", settings=settings)
        assert env.rollout.simulation.settings["timestep_s"] == step_s


def test_a_noisy_start_has_its_limit_and_the_next_start_the_nominal_limit():
    env = make("Throw-Limit-rubber")
    nominal = env.task.limit().value
    env.reset(seed=1, options={"jitter": True})
    assert 1e-6 < abs(env.task.limit().value - nominal) < 0.01
    env.reset(seed=1, options={"jitter": False})
    assert env.task.limit().value == nominal
    assert by_law(env)[1].ratio < 1.0


@pytest.mark.parametrize("name", ["Throw-Limit-rubber", "SlopeSlider-Limit-metal"])
def test_a_stored_policy_nears_the_maximum_from_noisy_starts(name):
    env = gymnasium.make(f"GAUGE/{name}", jitter="real").unwrapped
    reports = [
        play_paid(env, stored_policy(name), seed=10_000 + n)[1] for n in range(2)
    ]
    assert all(0.95 < report.ratio <= 1.0 for report in reports)


def test_an_unknown_stored_policy_names_the_known():
    with pytest.raises(UnknownNameError, match="Throw-Limit-rubber"):
        stored_policy("Throw-Limit-rubbr")
