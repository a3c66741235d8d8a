"""Uncertain inputs of a control task."""

from __future__ import annotations

import math
from dataclasses import replace

from gauge_envs.envs.control.env import ControlEnv
from gauge_envs.experiments.experiment import TaskExperiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.uncertain import UncertainParameter, uncertain_parameters


def task_uncertainties(env: ControlEnv) -> tuple[UncertainParameter, ...]:
    """Return the uncertain inputs of a control task around its calibrated values.

    A constant that is the task's limit has the uncertainty of the limit, which the task derives from trials of the very
    pair of bodies.

    Args:
        env: The task, without wrappers.
    """
    experiment = env.experiment
    assert isinstance(experiment, TaskExperiment)
    calibrated = load_experiment(experiment.variant)
    found = []
    for parameter in uncertain_parameters(calibrated):
        stated = experiment.overrides.get(parameter.key, parameter.value)
        if isinstance(stated, float) and math.isclose(stated, env.limit.value, rel_tol=1e-12):
            source = f'info["limit"]: {env.limit.sigma_source}'
            parameter = replace(parameter, std=env.limit.sigma, source=source)
        found.append(parameter)
    return tuple(found)
