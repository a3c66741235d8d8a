"""The request of a run: checks of its values, equality, and its episode, which is that of an environment."""

from dataclasses import replace

import pytest
from episodes import run_to_end

from gauge_envs import GaugeEnv, Jitter, ScoreEpisode, find_variant
from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.runs.episodes import episode_result, run_episode
from gauge_envs.runs.request import RunRequest

NAME = "SlopeSlider-2-wood"


def test_name_id_and_variant_are_the_same_request():
    named = RunRequest(NAME)
    assert named.variant == find_variant(NAME)
    assert named == RunRequest(f"GAUGE/{NAME}") == RunRequest(find_variant(NAME))
    assert hash(named) == hash(RunRequest(f"GAUGE/{NAME}"))


@pytest.mark.parametrize(
    "changes",
    [
        {"backend": "newton"},
        {"parameters": {"cube.friction": 0.3}},
        {"settings": {"impratio": 1.0}},
        {"marker_proxy": "node"},
        {"seed": 1},
        {"repeats": 2},
        {"jitter": Jitter()},
    ],
)
def test_requests_of_other_runs_differ(changes):
    assert replace(RunRequest(NAME), **changes) != RunRequest(NAME)
    assert replace(RunRequest(NAME), **changes) == RunRequest(NAME, **changes)


def test_an_unknown_variant_is_refused_at_once():
    with pytest.raises(UnknownNameError, match=NAME):
        RunRequest("SlopeSlider-2-wod")


def test_the_calibrated_experiment_exists_where_the_parameters_are_wrong():
    request = RunRequest(NAME, parameters={"cubes.friction": 0.3})
    with pytest.raises(ParameterError, match="cubes"):
        request.experiment()
    assert request.calibrated_experiment() == RunRequest(NAME).experiment()


@pytest.mark.parametrize(
    "name", ["SlopeSlider-2-wood", "SlopeSlider-3-wood", "CubeToss-acrylic"]
)
def test_a_run_is_the_episode_of_the_environment_with_its_arguments(name):
    changes = {"settings": {"timestep_s": 1 / 3600}}
    if name == "SlopeSlider-2-wood":
        changes |= {
            "parameters": {"cube.friction": 0.2},
            "marker_proxy": MarkerProxy.NODE,
        }
    # `gymnasium.make` refuses arguments that change nothing, which a run of many ids may have.
    env = ScoreEpisode(GaugeEnv(name, **changes))
    _, info = run_to_end(env, seed=3)
    mine, its = (
        one.to_dict()
        for one in (
            run_episode(RunRequest(name, seed=3, **changes)),
            episode_result(env, info),
        )
    )
    assert {key for key in mine if mine[key] != its[key]} <= {
        "wall_s",
        "cpu_s",
        "created",
    }
    env.close()
