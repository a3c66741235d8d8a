"""Estimated costs: medians of earlier episodes, interpolated between numbers of steps, or unknown."""

import pytest

from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scoring.score import Score
from gauge_envs.tools.sweep.folder import (
    EarlierCosts,
    create_folder,
    earlier_episodes,
    write_episode,
)
from gauge_envs.tools.sweep.plan import plan_sweep, remaining_tasks
from gauge_envs.tools.sweep.spec import sweep_spec

DURATION_S = 0.6
"""Duration of SlopeSlider-2."""


@pytest.fixture
def costs(tmp_path):
    """Those of a folder with episodes of 2, 3 and 40 s with 216 steps, and of 10 s with 432."""
    create_folder(tmp_path)
    for seed, (wall_s, rate) in enumerate(
        [(2.0, 360), (3.0, 360), (40.0, 360), (10.0, 720)]
    ):
        result = Result(
            id="GAUGE/SlopeSlider-2-wood",
            outcome=Outcome.FINISHED,
            parameters="calibrated",
            score=Score(kind="trials", unit="mm"),
            task_sha256="0",
            backend="mujoco",
            wall_s=wall_s,
            sim_s=DURATION_S,
            settings={"timestep_s": 1 / rate},
            seed=seed,
        )
        write_episode(tmp_path, result, f"{seed}.json")
    return EarlierCosts(earlier_episodes(tmp_path).values())


@pytest.mark.parametrize(
    ("rate", "expected_s"),
    [(180, 3.0), (360, 3.0), (540, 6.5), (720, 10.0), (1440, 20.0)],
)
def test_the_cost_follows_earlier_episodes(costs, rate, expected_s):
    plan = plan_sweep(
        sweep_spec(
            {"variants": ["SlopeSlider-2-wood"], "settings": {"timestep_s": [1 / rate]}}
        )
    )
    cost = costs.of(remaining_tasks(plan, ()))
    assert (cost.known, cost.unknown) == (1, 0)
    assert cost.engine_s == pytest.approx(expected_s)


def test_other_experiments_are_unknown(costs):
    plan = plan_sweep(
        sweep_spec({"variants": ["SlopeSlider-2-metal", "SlopeSlider-2-wood"]})
    )
    cost = costs.of(remaining_tasks(plan, ()))
    assert (cost.known, cost.unknown) == (1, 1)
