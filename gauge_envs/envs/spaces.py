"""Action and observation space of an experiment, from its scene alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from gymnasium import spaces

from gauge_envs.envs.reach import Reach
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.scene.geometry import FloatArray

Observation = dict[str, FloatArray]


def action_space_of(experiment: Experiment) -> spaces.Space[Any]:
    """Return the action space of an experiment: one entry for each motion of a driver; `Discrete(1)` without any."""
    motions = sum(len(driver.motions) for driver in experiment.scene.drivers)
    # Learners act in single precision.
    return (
        spaces.Box(-1.0, 1.0, (motions,), np.float32) if motions else spaces.Discrete(1)
    )


STILL_RAD_PER_S = 0.01
"""Angular speed that a driven body which does not turn may seem to have, by the rounding of engines."""


def observation_space_of(experiment: Experiment) -> spaces.Space[Observation]:
    """Return the observation space of an experiment; `GaugeEnv` says what each entry holds."""
    scene = experiment.scene
    reach = Reach(scene)

    def states(names: Sequence[str]) -> spaces.Box:
        high = np.empty((len(names), 13))
        high[:, 3:7], high[:, 7:10] = 1.0 + 1e-9, scene.speed_limit_m_per_s
        for row, name in zip(high, names, strict=True):
            row[10:] = scene.spin_limit_rad_per_s(scene.body(name)) + STILL_RAD_PER_S
        low = -high
        for index, name in enumerate(names):
            low[index, :3], high[index, :3] = reach.box_m(name)
        return spaces.Box(low, high, dtype=np.float64)

    low, high = reach.observable(
        experiment.score.observable, experiment.recorded, len(experiment.coordinates)
    )
    entries: dict[str, spaces.Space[Any]] = {
        "observable": spaces.Box(low, high, dtype=np.float64),
        "time": spaces.Box(0.0, scene.duration_s + 1e-9, (1,), np.float64),
    }
    if experiment.recorded:
        entries["bodies"] = states(experiment.recorded)
    else:
        markers = scene.markers
        count = 0 if markers is None else len(markers.positions_m)
        low_m, high_m = reach.box_m(*(() if markers is None else markers.bodies))
        entries["markers"] = spaces.Box(
            np.tile(low_m, (count, 1)), np.tile(high_m, (count, 1)), dtype=np.float64
        )
    if scene.drivers:
        entries["driver"] = states([driver.body for driver in scene.drivers])
    return cast("spaces.Space[Observation]", spaces.Dict(entries))
