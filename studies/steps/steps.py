"""Errors of MuJoCo's time steps over the uncertainty of references, as `steps.csv`, and the rule that chooses a step.

python -m studies.steps.steps SlopeSlider-3-wood Turntable-Limit-wood >> studies/steps/steps.csv

The settings are those of preset `training` but for the step; foam of `DEFAULT_TOLERANCE` has the default's.
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

import gauge_envs  # noqa: F401  registers the ids
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.envs.episode import Trajectory
from gauge_envs.errors import ParameterError
from gauge_envs.evaluation.metrics.trajectory import trajectory_rmse as rmse
from gauge_envs.evaluation.reference import reference_loads
from gauge_envs.evaluation.verification import load_length
from gauge_envs.references.bands import Band
from gauge_envs.tools.control.env import ControlEnv
from gauge_envs.tools.control.play import engine_limit, play

FILE = Path(__file__).with_name("steps.csv")

SHARES = {"default": 0.1, "training": 0.5}
"""Largest error of a step by preset, over the uncertainty that the reference states.

Added in quadrature, 0.1 makes that uncertainty 0.5 % larger and 0.5 makes it 12 % larger.
"""

RIGID_STEPS_PER_S = (180, 360, 540, 720, 900, 1800, 4500, 9000)
DEFORMABLE_STEPS_PER_S = (180, 360, 540, 900)
"""Steps that are tried; each is compared with half of it."""

CHOSEN_ON = "stated start"
"""Start of the rows on which the rule chooses; the others verify the choice."""

VERIFYING_SEEDS = (1, 2, 3)
"""Seeds of the random starts, `jitter` in a reset."""

REACHING = ("Carry", "Push", "Throw", "Fling")
"""Families of control tasks whose error is that of what the law's policy reaches with 0.98 of the limit."""


DEFAULT_TOLERANCE = (
    "FoamCompressing",
    "FoamShearing",
    "FoamStretching",
    "FoamTwisting",
)
"""Families whose rows choose both presets, which differ in the tolerance alone."""


@dataclass(frozen=True, kw_only=True)
class StepError:
    """The error of one step in one quantity: the observable, a load of grips, or what a task reaches.

    Attributes:
        id: Experiment or control task.
        start: `stated start`, or the seed of a random start or goal.
        steps_per_s: One over the step.
        error: Change of the whole episode with half the step, rms over the frames; of a control task, change of the
            share of the limit that the law's policy reaches.
        unit: Unit of `error` and `uncertainty`.
        uncertainty: What the score divides by: the scatter of real trials, or the uncertainty of a law or of a solved
            model, rms over the frames; of a control task, that of its limit over the limit.
    """

    id: str
    start: str
    steps_per_s: int
    error: float
    unit: str
    uncertainty: float


def read_rows(file: Path = FILE) -> list[StepError]:
    """Read the table."""
    with file.open(newline="", encoding="utf-8") as lines:
        return TypeAdapter(list[StepError]).validate_python([*csv.DictReader(lines)])


def longest_step(rows: Iterable[StepError], share: float) -> int | None:
    """Return one over the longest step that counts, or None if none does; this is the rule.

    A step counts if its error in every quantity, and that of every shorter step that was tried, is at most the share of
    the uncertainty.

    Args:
        rows: Errors of one experiment or control task, of one start.
        share: One of `SHARES`.
    """
    rows = list(rows)
    # A comparison with NaN is false.
    failing = [
        row.steps_per_s for row in rows if not row.error <= share * row.uncertainty
    ]
    shortest_failing = max(failing, default=0)
    return min(
        (row.steps_per_s for row in rows if row.steps_per_s > shortest_failing),
        default=None,
    )


def band_uncertainty(band: Band) -> float:
    """Return what a score against a band divides by, rms over its measured frames."""
    values = band.sigma
    if not band.grade.is_real and band.uncertainty is not None:
        values = band.uncertainty
    measured = values[band.measured]
    return rmse(np.zeros_like(measured), measured)


@cache
def episode(name: str, steps_per_s: int, seed: int | None) -> Trajectory:
    """Run an episode without actions."""
    settings: dict[str, Any] = {"timestep_s": 1.0 / steps_per_s}
    if not name.startswith(DEFAULT_TOLERANCE):
        settings["preset"] = "training"
    env = GaugeEnv(name, settings=settings, marker_proxy="material")
    env.reset(seed=seed or 0, options={"jitter": seed is not None})
    env.episode.play()
    env.close()
    return env.trajectory()


def distance(coarse: NDArray[np.float64], fine: NDArray[np.float64]) -> float:
    """Return the distance of two motions, rms over the frames; infinite if one of them diverged."""
    if coarse.shape != fine.shape:
        return math.inf
    return rmse(coarse, fine)


def experiment_errors(name: str, seed: int | None) -> Iterator[StepError]:
    """Yield the error of each step of an experiment from one start; nothing without a reference."""
    env = GaugeEnv(name)
    band = env.band
    experiment = env.experiment
    env.close()
    if band is None:
        return
    start = CHOSEN_ON if seed is None else f"random start {seed}"
    holders = experiment.scene.holders
    is_deformable = bool(experiment.scene.deformables)
    for count in DEFORMABLE_STEPS_PER_S if is_deformable else RIGID_STEPS_PER_S:
        coarse, fine = episode(name, count, seed), episode(name, 2 * count, seed)
        motion = distance(
            band.project(coarse.frames[: experiment.frame_count]),
            band.project(fine.frames[: experiment.frame_count]),
        )
        quantities = [(motion, band.unit, band_uncertainty(band))]
        for load in reference_loads(experiment, band):
            values = load.values(holders, coarse.wrenches)
            change = load_length(values - load.values(holders, fine.wrenches))
            quantities.append((change, load.unit, load_length(load.uncertainty)))
        for error, unit, uncertainty in quantities:
            yield StepError(
                id=name,
                start=start,
                steps_per_s=count,
                error=error,
                unit=unit,
                uncertainty=uncertainty,
            )


@cache
def reached(task: str, steps_per_s: int, seed: int | None) -> tuple[float, float]:
    """Return the share of its limit that the law's policy reaches in a control task, and that limit's uncertainty.

    The share is NaN where the policy fails; the uncertainty is over the limit.
    """
    settings = {"preset": "training", "timestep_s": 1.0 / steps_per_s}
    env = gymnasium.make(f"GAUGE/{task}", settings=settings).unwrapped
    assert isinstance(env, ControlEnv)
    if task.startswith(REACHING):
        share = play(env, lambda _: env.law_action(0.98), seed=seed or 0).ratio
    else:
        try:
            share = engine_limit(env, bounds=(0.8, 1.2), resolution=0.0005)
        except ParameterError:
            share = 0.0
    env.close()
    return share if share > 0.0 else math.nan, env.limit.sigma / env.limit.value


def task_errors(task: str, seed: int | None) -> Iterator[StepError]:
    """Yield the error of each step of a control task, from one goal."""
    for count in RIGID_STEPS_PER_S:
        share, uncertainty = reached(task, count, seed)
        yield StepError(
            id=task,
            start=CHOSEN_ON if seed is None else f"goal {seed}",
            steps_per_s=count,
            error=abs(share - reached(task, 2 * count, seed)[0]),
            unit="1",
            uncertainty=uncertainty,
        )


def main(names: Iterable[str]) -> None:
    """Print the rows of some experiments and control tasks."""
    writer = csv.DictWriter(sys.stdout, [field.name for field in fields(StepError)])
    for name in names:
        is_task = "-Limit-" in name
        errors = task_errors if is_task else experiment_errors
        # Goals alone scatter in a task; other materials verify those without.
        has_goals = name.startswith(REACHING[:2])
        for seed in (None, *(VERIFYING_SEEDS if not is_task or has_goals else ())):
            for row in errors(name, seed):
                numbers = {
                    key: f"{value:.4g}" if isinstance(value, float) else value
                    for key, value in asdict(row).items()
                }
                writer.writerow(numbers)
                sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
