"""What Gymnasium's ecosystem does with environments: specs, checkers, wrappers, videos."""

import pickle
import re
import warnings
from ctypes.util import find_library
from functools import cache

import gymnasium
import numpy as np
import pytest
from episodes import run_to_end
from gymnasium import wrappers
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from opengl import needs_opengl
from places import ROOT
from programs import printed
from texts import fenced

from gauge_envs import (
    GaugeEnv,
    Jitter,
    LogScore,
    ScoreEpisode,
    find_variant,
    load_experiment,
    reference_band,
)
from gauge_envs.envs.vector import GaugeVectorEnv

RIGID, DRIVEN, SOFT = "SlopeSlider-2-wood", "SlopeSlider-3-metal", "StickStack-soft"
GUIDE = ROOT / "docs" / "ecosystem.md"


def layers(env):
    found = [env]
    while isinstance(found[-1], gymnasium.Wrapper):
        found.append(found[-1].env)
    return found


def test_what_the_package_returns_pickles():
    env = gymnasium.make(f"GAUGE/{RIGID}")
    _, info = run_to_end(env)
    experiment = load_experiment("SlopeSlider-3-metal", {"cube.friction": 0.2})
    for value in (
        info["score"],
        experiment,
        experiment.scene,
        find_variant(RIGID),
        Jitter(),
    ):
        assert pickle.loads(pickle.dumps(value)) == value
    band = reference_band(experiment)
    assert np.array_equal(
        pickle.loads(pickle.dumps(band)).mean, band.mean, equal_nan=True
    )
    trajectory = env.unwrapped.trajectory()
    assert np.array_equal(
        pickle.loads(pickle.dumps(trajectory)).samples, trajectory.samples
    )


# --- specs ---


def test_a_spec_of_plain_arguments_rebuilds_the_run():
    env = gymnasium.make(
        "GAUGE/FoamStretching-soft",
        parameters={"foam.young_modulus_pa": 50000.0},
        settings={"timestep_s": 1 / 3600},
        marker_proxy="node",
        render_mode="rgb_array",
        width=80,
        height=60,
    )
    text = env.spec.to_json()
    for again in (gymnasium.make(env.spec), gymnasium.make(EnvSpec.from_json(text))):
        ours, theirs = env.unwrapped, again.unwrapped
        assert theirs.arguments == ours.arguments
        assert theirs.experiment == ours.experiment
        settings = theirs.rollout.simulation.settings
        assert settings == ours.rollout.simulation.settings
        assert theirs.band is ours.band
        assert (theirs.render_mode, theirs.spec.kwargs["width"]) == ("rgb_array", 80)
        assert [type(layer) for layer in layers(again)] == [
            type(layer) for layer in layers(env)
        ]


def test_what_was_not_made_by_make_has_no_spec():
    assert GaugeEnv(RIGID).spec is None
    assert str(GaugeEnv(RIGID)) == "<GaugeEnv instance>"
    assert GaugeVectorEnv(RIGID).spec is None
    assert str(GaugeVectorEnv(RIGID)) == "GaugeVectorEnv(num_envs=1)"


# --- checkers ---


@needs_opengl
@pytest.mark.parametrize(("name", "wrapped"), [(RIGID, True), (SOFT, False)])
def test_gymnasiums_checker_passes_with_pictures(name, wrapped, monkeypatch):
    env = gymnasium.make(f"GAUGE/{name}", render_mode="rgb_array", width=80, height=60)
    # A window needs a display and has tests of its own.
    modes = [mode for mode in env.metadata["render_modes"] if mode != "human"]
    monkeypatch.setitem(type(env.unwrapped).metadata, "render_modes", modes)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # The checker prefers to be given what make has not wrapped.
        warnings.filterwarnings(
            "ignore", message=".*different from the unwrapped version.*"
        )
        check_env(env if wrapped else env.unwrapped)


# --- wrappers ---


def flat(env):
    return wrappers.FlattenObservation(env)


def flat_halved(env):
    space = gymnasium.spaces.flatten_space(env.observation_space)
    halved = gymnasium.spaces.Box(0.5 * space.low, 0.5 * space.high, dtype=space.dtype)
    return wrappers.TransformObservation(
        flat(env), lambda observation: 0.5 * observation, halved
    )


def flat_normalized(env):
    return wrappers.NormalizeObservation(flat(env))


LAYERS = (
    wrappers.RecordEpisodeStatistics,
    flat,
    flat_halved,
    flat_normalized,
    wrappers.Autoreset,
)


@cache
def plain_score(name):
    return run_to_end(gymnasium.make(f"GAUGE/{name}"))[1]["score"]


@pytest.mark.parametrize(
    ("name", "layer"),
    [
        *((RIGID, one) for one in LAYERS),
        (DRIVEN, flat),
        pytest.param(SOFT, flat, marks=pytest.mark.slow),
    ],
)
def test_wrappers_go_before_and_after_the_score(name, layer):
    after = layer(gymnasium.make(f"GAUGE/{name}"))
    before = ScoreEpisode(layer(GaugeEnv(name)))
    infos = []
    for env in (after, before):
        observation, _ = env.reset(seed=0)
        assert observation in env.observation_space
        infos.append(run_to_end(env)[1])
    assert infos[0]["score"] == infos[1]["score"] == plain_score(name)


def test_a_flat_observation_is_all_entries_by_name():
    env = gymnasium.make(f"GAUGE/{DRIVEN}")
    dictionary, _ = env.reset(seed=0)
    vector, _ = flat(env).reset(seed=0)
    assert np.array_equal(
        vector, np.concatenate([dictionary[key].ravel() for key in sorted(dictionary)])
    )


def test_an_episode_that_is_cut_short_has_no_score():
    limited = gymnasium.make(f"GAUGE/{RIGID}", max_episode_steps=5)
    for env in (limited, ScoreEpisode(wrappers.TimeLimit(GaugeEnv(RIGID), 5))):
        info = run_to_end(env)[1]
        assert info["frame"] == 5
        assert "score" not in info


# --- the guide ---


@pytest.mark.slow
def test_blocks_of_the_guide_run(tmp_path):
    blocks = fenced(GUIDE, "python")
    assert len(blocks) > 6
    if not find_library("EGL") and not find_library("OSMesa"):
        blocks = [block for block in blocks if "RecordVideo" not in block]
    code = "\n".join(blocks)
    shown = printed("-c", code, cwd=tmp_path)
    stated = re.findall(r"^ *print\(.*\)  # (.*)", code, re.MULTILINE)
    assert shown.splitlines() == stated


class Writer:
    """The part of TensorBoard's `SummaryWriter` that is used."""

    def __init__(self):
        self.scalars = []

    def add_scalar(self, tag, scalar_value, global_step):
        self.scalars.append((global_step, tag, scalar_value))


def test_scores_are_sent_to_tensorboard_and_to_functions_like_that_of_wandb():
    writer, calls = Writer(), []
    env = gymnasium.make("GAUGE/SlopeSlider-2-wood")
    env = LogScore(env, writer)
    env = LogScore(env, lambda values, step: calls.append((step, values)))
    for episode in (1, 2):
        _, info = run_to_end(env)
        assert calls[-1][0] == 18 * episode
    score = info["score"]
    assert calls[0][1] == calls[1][1]
    assert calls[1][1]["score/rmse_aligned"] == score.rmse_aligned
    assert calls[1][1]["score/rmse_aligned_normalized"] == score.rmse_aligned_normalized
    assert "score/over_uncertainty" not in calls[1][1]
    assert writer.scalars == [
        (step, name, value) for step, values in calls for name, value in values.items()
    ]
