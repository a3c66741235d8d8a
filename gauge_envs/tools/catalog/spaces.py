"""Describe the action and observation spaces of an experiment as rows of tables."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gauge_envs.envs.spaces import action_space_of, observation_space_of
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.pages.text import shortened
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
        return [_row("action", np.zeros(()), np.zeros(()), "1", "nothing is driven")]
    rows: list[dict[str, Any]] = []
    for driver in experiment.scene.drivers:
        for motion in driver.motions:
            unit, meaning = _driven(driver.body, motion)
            name = f"action[{len(rows)}]"
            rows.append(_row(name, -np.ones(()), np.ones(()), unit, meaning))
    return rows


def _driven(body: str, motion: DriverMotion) -> tuple[str, str]:
    """Return the unit of an entry of the action and its meaning."""
    scale, unit, kind = motion.residual_rate, "m/s", "velocity along"
    if motion.kind == "rotate":
        scale, unit, kind = np.rad2deg(scale), "deg/s", "rate about"
    if not scale:
        return "1", f"no effect on {body}"
    axis = " ".join(f"{value:.3g}" for value in motion.axis)
    relation = "of"
    if motion.profiles:
        relation = "added to the motion of"
    return f"times {scale:.3g} {unit}", f"{kind} ({axis}), {relation} {body}"


def observation_rows(experiment: Experiment) -> list[dict[str, Any]]:
    """Return a row for each entry of the observation: name, shape, range, unit, meaning."""
    space = observation_space_of(experiment)
    assert isinstance(space, spaces.Dict)
    scene, observable = experiment.scene, experiment.score.observable
    marked = ""
    if scene.markers:
        marked = ", ".join(scene.markers.bodies)
    meanings = {
        "observable": (observable.unit, f"g(t): {OBSERVED[observable]}"),
        "bodies": experiment.recorded,
        "markers": ("m", f"x y z of the markers on {marked}"),
        "driver": tuple(driver.body for driver in scene.drivers),
        "time": ("s", "time since the reset"),
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
            unit, text = meaning
            rows.append(_row(key, box.low, box.high, unit, text))
    return rows


def _state_rows(
    key: str, box: spaces.Box, bodies: Sequence[str]
) -> Iterator[dict[str, Any]]:
    """Yield a row for each quantity in the states of bodies; the first row names the bodies."""
    for columns, unit, part in STATE:
        name = f"{key}[:, {columns.start}:{columns.stop}]"
        if columns.start == 0:
            part += f" of {shortened(bodies)}"
        row = _row(name, box.low[:, columns], box.high[:, columns], unit, part)
        yield row | {"entry": key, "whole": list(box.shape)}


def _row(
    name: str,
    low: NDArray[Any],
    high: NDArray[Any],
    unit: str,
    meaning: str,
) -> dict[str, Any]:
    shape = list(low.shape)
    return {
        "entry": name,
        "whole": shape,
        "name": name,
        "shape": shape,
        "low": float(low.min()),
        "high": float(high.max()),
        "unit": unit,
        "meaning": meaning,
    }


def shape_text(shape: Sequence[int]) -> str:
    """Return a shape, for example `[1, 3]`; empty for a number."""
    if not shape:
        return ""
    return str(list(shape))
