"""Measure the results of the demo: the drop of a ball, the creep of a cube, and the friction that policies use."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import frame_times_s
from gauge_envs.scoring.reference import reference_band
from gauge_envs.tools.sanity import SanityResult, check

BALL = "BouncingBall-rubber"
ROBOT = "HalfCheetah-v5"
CREEP = "creep-wood"
TASK = "GAUGE/SlopeSlider-Limit-metal"


@dataclass(frozen=True, kw_only=True)
class Drop:
    """Drop of the ball.

    Attributes:
        times_s: Times, shifted as in the score, shape [T].
        heights_mm: Heights of the ball's centre in the frame of the trials, shape [T].
        result: Result of the episode.
    """

    times_s: FloatArray
    heights_mm: FloatArray
    result: Result

    @property
    def exact_mm(self) -> float:
        """Distance of the exact motion with the same constants [mm]."""
        score = self.result.score
        assert score.distance and score.primary_normalized and score.exact
        return score.exact * score.distance / score.primary_normalized


def real_drops() -> tuple[FloatArray, FloatArray]:
    """Return the frames of the real drops [s], shape [T], and their heights [mm], shape [trial_count, T]."""
    band = reference_band(load_experiment(BALL))
    assert band is not None and band.trials is not None
    return frame_times_s(len(band.mean)), band.trials[:, :, 0]


def drop(**arguments: Any) -> Drop:
    """Simulate the drop of the ball.

    Args:
        **arguments: Arguments of `RunRequest`, as `parameters="measured"`.
    """
    result = run_episode(RunRequest(BALL, **arguments))
    band = reference_band(load_experiment(BALL))
    assert band is not None and result.trajectory is not None
    times_s, samples = result.trajectory.arrays()
    return Drop(
        times_s=times_s + (result.score.time_offset_s or 0.0),
        heights_mm=band.project(samples)[:, 0],
        result=result,
    )


def creep() -> SanityResult:
    """Return the creep of a wooden cube on 10 degrees with the contacts of `ROBOT`, and that of real cubes.

    Raises:
        GaugeError: The robot cannot be made.
    """
    (result,) = check(ROBOT, only=[CREEP], explain=False).checks
    return result


def used_friction(
    policy: Callable[[Any, FloatArray], NDArray[np.floating] | float],
) -> tuple[list[float], Any]:
    """Return the friction that a policy uses in each step of `TASK`, and the `LimitReport` of its episode.

    Args:
        policy: Function of the environment and the observation that returns the next action.
    """
    env: Any = gymnasium.make(TASK)
    observation, _ = env.reset(seed=0)
    column = env.unwrapped.OBSERVED.index("friction_used")
    used: list[float] = []
    is_over = False
    while not is_over:
        action = np.full(1, policy(env.unwrapped, observation), np.float32)
        observation, _, terminated, truncated, info = env.step(action)
        used.append(float(observation[column]))
        is_over = terminated or truncated
    return used, info["limit"]
