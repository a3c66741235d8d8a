"""Action and observation spaces of an experiment as rows of tables."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from gauge_envs.envs.spaces import action_space_of, observation_space_of
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.pages.text import quantity_text, shortened
from gauge_envs.scene.drivers import DriverMotion

STATE = (
    (slice(0, 3), "m", "position"),
    (slice(3, 7), "1", "quaternion w x y z"),
    (slice(7, 10), "m/s", "velocity"),
    (slice(10, 13), "rad/s", "angular velocity"),
)
"""Columns of the state of a body, with their units."""

OBSERVED = {
    Observable.POSITION: "x y z of each recorded body",
    Observable.CURVATURE: "angle deficit at each marker",
    Observable.LINE_CURVATURE: "turning angle at each inner marker",
    Observable.FACE_AREA: "area of each marker triangle",
    Observable.MARKER_POSITION: "x y z of each marker",
}


def action_rows(experiment: Experiment) -> list[dict[str, Any]]:
    """Return a row for each entry of the action: name, shape, range, unit, meaning."""
    space = action_space_of(experiment)
    if isinstance(space, spaces.Discrete):
        return [_row("action", (), (0.0, 0.0), "1", "nothing is driven")]
    motions = [
        (driver.body, motion)
        for driver in experiment.scene.drivers
        for motion in driver.motions
    ]
    return [
        _row(f"action[{index}]", (), (-1.0, 1.0), *_driven(body, motion))
        for index, (body, motion) in enumerate(motions)
    ]


def _driven(body: str, motion: DriverMotion) -> tuple[str, str]:
    """Return the unit of an entry of the action and its meaning."""
    scale, unit, kind = motion.residual_rate, "m/s", "velocity along"
    if motion.kind == "rotate":
        scale, unit, kind = np.rad2deg(scale), "deg/s", "rate about"
    if not scale:
        return "1", f"no effect on {body}"
    axis = " ".join(f"{value:.3g}" for value in motion.axis)
    relation = "added to the motion of" if motion.profiles else "of"
    return f"times {scale:.3g} {unit}", f"{kind} ({axis}), {relation} {body}"


def observation_rows(experiment: Experiment) -> list[dict[str, Any]]:
    """Return a row for each entry of the observation: name, shape, range, unit, meaning."""
    space = observation_space_of(experiment)
    assert isinstance(space, spaces.Dict)
    scene, observable = experiment.scene, experiment.score.observable
    marked = ", ".join(scene.markers.bodies) if scene.markers else ""
    meanings = {
        "observable": (observable.unit, f"g(t): {OBSERVED[observable]}"),
        "bodies": experiment.recorded,
        "markers": ("m", f"x y z of the markers on {marked}"),
        "driver": tuple(driver.body for driver in scene.drivers),
        "time": ("s", "time since the start"),
    }
    rows: list[dict[str, Any]] = []
    for key, meaning in meanings.items():
        if key not in space.spaces:
            continue
        box = space[key]
        assert isinstance(box, spaces.Box)
        if key in ("bodies", "driver"):
            rows += _state_rows(key, box, meaning)
        else:
            bounds = (box.low.min(), box.high.max())
            rows.append(_row(key, box.shape, bounds, *meaning))
    return rows


def _state_rows(
    key: str, box: spaces.Box, names: Sequence[str]
) -> Iterator[dict[str, Any]]:
    """Yield a row for each part of the states of bodies."""
    for columns, unit, meaning in STATE:
        low, high = box.low[:, columns], box.high[:, columns]
        name = f"{key}[:, {columns.start}:{columns.stop}]"
        owner = f" of {shortened(names)}" if columns.start == 0 else ""
        row = _row(name, low.shape, (low.min(), high.max()), unit, meaning + owner)
        yield row | {"entry": key, "whole": list(box.shape)}


def _row(
    name: str,
    shape: Sequence[int],
    bounds: tuple[float, float],
    unit: str,
    meaning: str,
) -> dict[str, Any]:
    return {
        "entry": name,
        "whole": list(shape),
        "name": name,
        "shape": list(shape),
        "low": float(bounds[0]),
        "high": float(bounds[1]),
        "unit": unit,
        "meaning": meaning,
    }


def range_text(row: Mapping[str, Any]) -> str:
    """Return the range of a row of a space, as `-1 to 1`; `any` without bounds."""
    low, high = row["low"], row["high"]
    if low is None or high is None or not np.isfinite([low, high]).all():
        return "any"
    return f"{_bound(low)} to {_bound(high)}" if low < high else _bound(low)


def _bound(value: float) -> str:
    return quantity_text(value) if abs(value) >= 1e-3 else "0"


def shape_text(shape: Sequence[int]) -> str:
    """Return a shape, as `[1, 3]`; a number has none."""
    return str(list(shape)) if shape else ""
