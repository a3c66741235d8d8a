"""The warning for an environment without reward: once for each id, and it says what to do."""

import shutil
import warnings
from functools import partial
from pathlib import Path

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env
from places import ROOT

import gauge_envs
from gauge_envs import load_experiment, reference_band, variants
from gauge_envs.envs import arguments
from gauge_envs.envs.dm_env import load
from gauge_envs.errors import NoRewardWarning
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest

SILENT = "GAUGE/RopeWinding-rubber"


@pytest.fixture(autouse=True)
def _nothing_was_reported(monkeypatch):
    monkeypatch.setattr(arguments, "_warned", set())


def warnings_of(make):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        make()
    return [
        warning for warning in caught if issubclass(warning.category, NoRewardWarning)
    ]


def test_make_warns_once_for_each_id_at_the_line_of_the_caller():
    (first,) = warnings_of(lambda: gymnasium.make(SILENT))
    assert Path(first.filename) == Path(__file__)
    assert warnings_of(lambda: gymnasium.make(SILENT)) == []
    assert len(warnings_of(lambda: gymnasium.make("GAUGE/WallBreaking-wood"))) == 1


def test_make_vec_and_dm_env_warn_too():
    (vector,) = warnings_of(lambda: gymnasium.make_vec(SILENT, num_envs=2))
    assert Path(vector.filename) == Path(__file__)
    assert len(warnings_of(lambda: load("WallBreaking-wood"))) == 1


@pytest.mark.parametrize(
    "name", ["SlopeSlider-2-wood", "Turntable-1-wood", "Turntable-Limit-wood"]
)
def test_ids_with_a_reward_and_control_tasks_are_silent(name):
    assert warnings_of(lambda: gymnasium.make(f"GAUGE/{name}")) == []


@pytest.mark.slow
def test_the_class_itself_and_runs_are_silent():
    assert warnings_of(lambda: gauge_envs.GaugeEnv("RopeWinding-rubber")) == []
    assert warnings_of(lambda: run_episode(RunRequest("RopeWinding-rubber"))) == []
    # A run reports the grade itself. It does not use up the warning of the id.
    assert len(warnings_of(lambda: gymnasium.make(SILENT))) == 1


def test_a_warning_that_is_an_error_is_raised_each_time():
    with warnings.catch_warnings():
        warnings.simplefilter("error", NoRewardWarning)
        for _ in range(2):
            with pytest.raises(NoRewardWarning, match="every reward is 0"):
                gymnasium.make(SILENT)


def test_warnings_have_the_approved_words(approved, tmp_path, monkeypatch):
    shutil.copy(ROOT / "examples" / "own_experiment" / "crate.toml", tmp_path)
    monkeypatch.setenv("GAUGE_TASKS", str(tmp_path / "crate.toml"))
    gauge_envs.register_all()
    ids = ("RopeWinding-rubber", "SlopeContact-wood", "CrateSlide-pine")
    found = [warnings_of(partial(gymnasium.make, f"GAUGE/{name}")) for name in ids]
    del gymnasium.registry["GAUGE/CrateSlide-pine"]
    messages = [str(warning.message) for one in found for warning in one]
    approved("envs/no-reward", "\n".join(messages))


def test_an_id_without_reward_passes_the_checks_of_gymnasium():
    env = gymnasium.make(SILENT)
    check_env(env.unwrapped, skip_render_check=True)
    assert env.reset(seed=0) and env.step(env.action_space.sample() * 0)[1] == 0.0


def test_the_list_of_scored_ids_is_the_list_of_silent_ones(gauge):
    listed = gauge("list", "--scored").stdout
    scored = {
        word.removeprefix("GAUGE/")
        for word in listed.split()
        if word.startswith("GAUGE/")
    }
    assert scored == {
        variant.name
        for variant in variants()
        if reference_band(load_experiment(variant)) is not None
    }
    assert len(scored) > 20
