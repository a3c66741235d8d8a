"""Results of engines whose motion at each step is known, with planted faults."""

from __future__ import annotations

import numpy as np

from gauge_envs import load_experiment
from gauge_envs.evaluation.laws import slide
from gauge_envs.evaluation.score import Score, Validation
from gauge_envs.files import versions
from gauge_envs.runs.result import Outcome, RecordedTrajectory, Result

WOOD = "SlopeSlider-2-wood"
STEPS_S = tuple(1 / 180 / count for count in (1, 2, 4, 8, 16))
RATE_HZ = 180


def euler(acceleration, time_s, step_s, *, step_error=0.0):
    """Semi-implicit Euler, first order; a share of the step is added where the velocity is updated."""
    count = round(time_s / step_s)
    return 0.5 * acceleration * (1.0 + step_error) * step_s**2 * count * (count + 1)


def wrong_step(acceleration, time_s, step_s):
    """An engine that updates velocities with a step that is 20 % too long: no finer step mends it."""
    return euler(acceleration, time_s, step_s, step_error=0.2)


def sticking(acceleration, time_s, step_s):
    """An engine that holds the body at its two coarsest steps."""
    return 0.0 if step_s > STEPS_S[2] + 1e-9 else euler(acceleration, time_s, step_s)


def rounding(acceleration, time_s, step_s):
    """An engine in single precision: rounding adds to the motion as the step shrinks."""
    return euler(acceleration, time_s, step_s) + 3e-9 / step_s**2 * time_s


def made(
    travel=euler,
    step_s=STEPS_S[0],
    *,
    name=WOOD,
    backend="mujoco",
    given=None,
    **changes,
):
    """A result as an engine with that motion would leave it."""
    experiment = load_experiment(name)
    law = slide(experiment.scene, "cube", "board")
    times_s = (
        np.arange(round((experiment.frame_count - 1) / 30 * RATE_HZ) + 1) / RATE_HZ
    )
    way_m = np.array(
        [travel(law.acceleration_m_per_s2, time_s, step_s) for time_s in times_s]
    )
    samples = 1e3 * (law.start_m + way_m[:, None] * law.direction)
    settings = {"timestep_s": step_s} if given is None else given
    values = {
        "id": experiment.id,
        "outcome": Outcome.FINISHED,
        "parameters": "calibrated",
        "score": Score(
            grade="trials",
            unit="mm",
            primary="rmse_aligned",
            rmse_aligned=2.0,
            validation=Validation(rmse_aligned_normalized=0.5),
        ),
        "task_sha256": experiment.file_sha256,
        "revision": experiment.revision,
        "backend": backend,
        "frames": experiment.frame_count,
        "wall_s": 1e-3 / step_s,
        "cpu_s": 5e-4 / step_s,
        "sim_s": float(times_s[-1]),
        "settings": {
            "preset": "contact",
            "timestep_s": step_s,
            "iterations": 10,
            **settings,
        },
        "settings_given": settings,
        "versions": {backend: "1.0", **versions()},
        "seed": 0,
        "trajectory": RecordedTrajectory.of(experiment, times_s, samples),
    }
    return Result(**(values | changes))


def sweep(travel=euler, steps_s=STEPS_S, **changes):
    return [made(travel, step_s, **changes) for step_s in steps_s]
