"""Action and observation spaces of an experiment; `gauge_envs.envs.limits` bounds observations."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from gymnasium import spaces

from gauge_envs.envs.limits import DISTANCE_LIMIT_M, STATE_LIMITS
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.scene.geometry import FloatArray

Observation = dict[str, FloatArray]

LARGEST_VALUE = {
    Observable.POSITION: 1e3 * DISTANCE_LIMIT_M,
    Observable.MARKER_POSITION: 1e3 * DISTANCE_LIMIT_M,
    # An angle deficit is 2 pi minus the angles of at most eight triangles.
    Observable.CURVATURE: 8.0 * np.pi,
    Observable.LINE_CURVATURE: np.pi,
    # Two sides of a triangle are at most the diagonal of the space.
    Observable.FACE_AREA: 0.5 * (2e3 * np.sqrt(3.0) * DISTANCE_LIMIT_M) ** 2,
}
"""Largest absolute value of g(t), in its unit: mm, rad or mm^2."""


def action_space_of(experiment: Experiment) -> spaces.Space[Any]:
    """Return the action space of an experiment: an entry for each driven degree of freedom, or `Discrete(1)`."""
    motions = sum(len(driver.motions) for driver in experiment.scene.drivers)
    # Learning algorithms act in single precision.
    return (
        spaces.Box(-1.0, 1.0, (motions,), np.float32) if motions else spaces.Discrete(1)
    )


def observation_space_of(experiment: Experiment) -> spaces.Space[Observation]:
    """Return the observation space of an experiment; `GaugeEnv` describes each entry."""
    scene = experiment.scene

    def box(limit: float | FloatArray, *shape: int) -> spaces.Box:
        high = np.broadcast_to(limit, shape).astype(np.float64)
        return spaces.Box(-high, high, dtype=np.float64)

    entries: dict[str, spaces.Space[Any]] = {
        "observable": box(
            LARGEST_VALUE[experiment.score.observable], len(experiment.coordinates)
        ),
        "time": spaces.Box(0.0, scene.duration_s + 1e-9, (1,), np.float64),
    }
    if experiment.recorded:
        entries["bodies"] = box(STATE_LIMITS, len(experiment.recorded), 13)
    else:
        count = 0 if scene.markers is None else len(scene.markers.positions_m)
        entries["markers"] = box(DISTANCE_LIMIT_M, count, 3)
    if scene.drivers:
        entries["driver"] = box(STATE_LIMITS, len(scene.drivers), 13)
    return cast("spaces.Space[Observation]", spaces.Dict(entries))
