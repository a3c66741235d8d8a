"""Settings that MuJoCo cannot use, and states that it cannot continue from."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.errors import ParameterError
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome

NAME = "SlopeSlider-2-wood"
UNSTABLE = {"sustained_solref": [1e-6, 0.1], "refsafe": False, "timestep_s": 1 / 180}


def test_a_state_that_mujoco_puts_back_to_its_start_counts_as_diverged() -> None:
    (result,) = run_many([RunRequest("Turntable-1-wood", settings=UNSTABLE)])
    assert result.outcome is Outcome.DIVERGED
    assert result.score.rmse is None
    assert "put the state back to its start" in str(result.diverged_reason)


def test_a_reset_or_a_restored_state_clears_the_fault() -> None:
    scene = load_experiment("SlopeSlider-1-wood").scene
    simulation = backend("mujoco").build(scene)
    start = simulation.state()
    for clear in (lambda: simulation.reset(0), lambda: simulation.restore(start)):
        simulation.data.qvel[0] = 1e11
        simulation.advance(1 / 180)
        assert "velocity that is huge" in str(simulation.fault())
        clear()
        simulation.advance(1 / 180)
        assert simulation.fault() is None


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"sustained_solref": (math.nan, 1.0)}, "'sustained_solref.0'.*given: nan"),
        ({"impratio": math.inf}, "'impratio'.*given: inf"),
        ({"iterations": 10**21}, "'iterations'.*at most 2147483647"),
        ({"noslip_iterations": np.int64(2**40)}, "'noslip_iterations'"),
        ({"timestep_s": 1e-320}, "'timestep_s'.*given: 1e-320"),
        ({"drive_interval_s": math.inf}, "'drive_interval_s'"),
        ({"drive_interval_s": 1e300}, "'drive_interval_s'.*given: 1e.300"),
        ({"preset": ["stack"]}, "unknown MuJoCo preset"),
        ({3: 1}, "expected texts as keys"),
        ([1], "expected a mapping"),
    ],
)
def test_impossible_settings(settings: Any, message: str) -> None:
    with pytest.raises((ParameterError, LookupError), match=message):
        GaugeEnv(NAME, settings=settings)


def test_an_integrator_that_cannot_simulate_the_scene_is_an_error_of_the_settings() -> (
    None
):
    with pytest.raises(
        ParameterError,
        match=r"MuJoCo cannot build the scene with these settings: .*discrete",
    ):
        GaugeEnv("TextileBending-rayon", settings={"integrator": "implicitfast"})
