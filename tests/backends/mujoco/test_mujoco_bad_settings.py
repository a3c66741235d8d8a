"""Settings that MuJoCo cannot use, and states that it cannot continue from."""

from gauge_envs.runs.batch import run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome

UNSTABLE = {"sustained_solref": [1e-6, 0.1], "refsafe": False, "timestep_s": 1 / 180}


def test_a_state_that_mujoco_puts_back_to_its_start_counts_as_diverged():
    (result,) = run_many([RunRequest("Turntable-1-wood", settings=UNSTABLE)])
    assert result.outcome is Outcome.DIVERGED
    assert result.score.rmse is None
    assert "put the state back to its start" in str(result.diverged_reason)
