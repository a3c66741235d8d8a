"""Solve a scene by one engine at smaller steps and cells with stiffer contacts, and estimate its uncertainty.

Of three runs whose changes point the same way, the last change d and the order p give the grid convergence index
1.25 d / (2^p - 1); p above 1 counts as 1. Otherwise it is three times the largest change, and of the two meshes
3 d / (2^2 - 1), as the order of linear elements is 2 (Roache 1994; Eca and Hoekstra 2009). The finest run keeps its
error, so u is the index and not half of it. A second engine differs by at most the half width of a rectangular
distribution (GUM 4.3.7).
"""

import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gauge_envs.backends.registry import backend_class
from gauge_envs.errors import BackendError, ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.pages.document import save_file
from gauge_envs.references.band import MARKER_SIGMA_MM, read_band_file
from gauge_envs.references.kind import Kind
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.scene import Cloth, Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.answers import mattering_distance

MIN_RATIO = 2.0**0.5
"""Smallest ratio of two changes in sequence that converge: an order of 0.5."""

MIN_COSINE = 0.9
"""Smallest cosine between two changes that point the same way."""

MESH_ORDER = 2
"""Order of the displacements of linear elements."""

SOFTNESS = "softness of contacts"
"""Name of the quantity that stiffer contacts refine."""

SOFTNESS_TEXTS = {
    -1: f",twice the {SOFTNESS}",
    0: "",
    1: f",half the {SOFTNESS}",
}
"""Text of the softness of a run."""

MORE_CELLS = {Cloth: 4, SoftBody: 8}
"""Factor on the number of cells with half their edge; 2 for ropes and rods."""


@dataclass(frozen=True)
class Level:
    """What a run refines.

    Attributes:
        step_s: Time step [s].
        halvings: Number of halvings of the softness of contacts; -1 doubles it.
        cell_m: Edge of the cells [m]; None if nothing has cells.
    """

    step_s: float
    halvings: int
    cell_m: float | None

    def __str__(self) -> str:
        """Return the settings in words, as `timestep_s=1/9000`."""
        text = f"timestep_s=1/{1.0 / self.step_s:.6g}"
        if self.cell_m:
            text += f",cell_m={self.cell_m:.4g}"
        return text + SOFTNESS_TEXTS[self.halvings]


@dataclass(frozen=True, kw_only=True)
class Solution:
    """The finest run and its standard uncertainty: columns of g(t), then of the markers [mm].

    Attributes:
        mean: Motion at the frames, shape [T, D + 3 M].
        uncertainty: Its standard uncertainty, shape [T, D + 3 M].
        orders: Observed order of convergence of each quantity that has three levels and changes the motion; None if
            the changes do not converge.
        width: Number D of coordinates of g(t).
    """

    mean: FloatArray
    uncertainty: FloatArray
    orders: Mapping[str, float | None]
    width: int

    @property
    def u(self) -> float:
        """Standard uncertainty over frames and markers [mm with markers, else unit of g(t)]."""
        return length(self.uncertainty, self.width)

    @property
    def moved(self) -> float:
        """Root mean square displacement, as `u`."""
        return length(self.mean - self.mean[0], self.width)


def length(values: FloatArray, width: int) -> float:
    """Return the root mean square over frames and markers, or over frames of g(t) without markers.

    Args:
        values: Differences of g(t) and markers, shape [T, D + 3 M].
        width: Number D of coordinates of g(t).
    """
    count = (values.shape[1] - width) // 3
    compared = values[:, width:] if count else values
    return math.sqrt(float(np.square(compared).sum(axis=1).mean()) / (count or 1))


def observed_order(first: FloatArray, last: FloatArray, width: int) -> float | None:
    """Return the order of convergence of the changes by two halvings; None if they do not converge.

    Args:
        first: Change by the first halving, shape [T, D + 3 M].
        last: Change by the second, not 0.
        width: Number D of coordinates of g(t).
    """
    sizes = length(first, width), length(last, width)
    both = length(first + last, width)
    # Law of cosines.
    dot_product = (both**2 - sizes[0] ** 2 - sizes[1] ** 2) / 2.0
    same_way = dot_product >= MIN_COSINE * math.prod(sizes)
    ratio = sizes[0] / sizes[1]
    return math.log2(ratio) if same_way and ratio >= MIN_RATIO else None


def solution(
    levels: Mapping[str, Sequence[FloatArray]],
    width: int,
    other: FloatArray | None = None,
) -> Solution:
    """Return the solution from runs; each level halves the step, the softness or the cells of the level before.

    Args:
        levels: Motions from coarse to fine, shape [T, D + 3 M] each, by the name of the refined quantity. Steps and
            softness have three, cells have two. The last motion is that of the finest run.
        width: Number D of coordinates of g(t).
        other: Motion of a second engine.
    """
    *_, (*_, finest) = levels.values()
    orders: dict[str, float | None] = {}
    parts = []
    for name, motions in levels.items():
        changes = [after - before for before, after in pairwise(motions)]
        first, last = changes[0], changes[-1]
        if len(changes) == 1:
            parts.append(3.0 * last / (2.0**MESH_ORDER - 1.0))
        elif last.any():
            order = orders[name] = observed_order(first, last, width)
            if order is None:
                parts.append(3.0 * np.maximum(abs(first), abs(last)))
            else:
                parts.append(1.25 * last / (2.0 ** min(order, 1.0) - 1.0))
    if other is not None:
        parts.append((other - finest) / math.sqrt(3.0))
    uncertainty = np.sqrt(sum(map(np.square, parts), np.zeros_like(finest)))
    return Solution(mean=finest, uncertainty=uncertainty, orders=orders, width=width)


def given_level(coarse: Result) -> Level:
    """Return the level of a coarse run."""
    step_s, cell_m = (coarse.settings.get(name) for name in ("timestep_s", "cell_m"))
    if not step_s:
        raise ParameterError(
            f"backend {coarse.backend!r} has no setting timestep_s that can be refined: choose another one"
        )
    return Level(step_s, 0, cell_m)


def refinements(coarse: Result, scene: Scene) -> dict[str, list[Level]]:
    """Return the levels from coarse to fine, by the name of the refined quantity; the last one is the finest run.

    Steps are refined with contacts that are half as soft, contacts at a quarter of the step, and cells with both.

    Args:
        coarse: The coarse run.
        scene: Its scene.
    """
    given = given_level(coarse)
    stiffest = 1 if softened(coarse, scene, halvings=1) else 0
    steps = [
        replace(given, step_s=given.step_s / parts, halvings=stiffest)
        for parts in (1, 2, 4)
    ]
    finest = steps[-1]
    levels = {"step": steps}
    if stiffest:
        levels[SOFTNESS] = [replace(finest, halvings=power) for power in (-1, 0, 1)]
    if scene.deformables:
        if not given.cell_m:
            names = ", ".join(body.name for body in scene.deformables)
            raise ParameterError(
                f"{coarse.id}: the preset chooses the cells of {names}, so they cannot be halved: give their edge in "
                "metres by --set cell_m=..."
            )
        levels["cells"] = [finest, replace(finest, cell_m=given.cell_m / 2)]
    return levels


def settings_of(level: Level, coarse: Result, scene: Scene) -> dict[str, Any]:
    """Return the settings of a level.

    Args:
        level: The level.
        coarse: The coarse run.
        scene: Its scene.
    """
    cells = {"cell_m": level.cell_m} if level.cell_m else {}
    contacts = softened(coarse, scene, halvings=level.halvings)
    step = {"timestep_s": level.step_s}
    return {**coarse.settings_given, **step, **contacts, **cells}


def softened(coarse: Result, scene: Scene, *, halvings: int) -> dict[str, Any]:
    """Return settings that halve the softness of contacts; empty if nothing touches or the engine declares none.

    Args:
        coarse: The coarse run.
        scene: Its scene.
        halvings: Number of halvings; -1 doubles the softness.
    """
    found: dict[str, Any] = {}
    if not scene.contacts:
        return found
    for name, half in backend_class(coarse.backend or "").contact_softness.items():
        value, factor = coarse.settings.get(name), half**halvings
        if isinstance(value, Sequence):
            time_s, ratio = value
            # Numbers below 0 are minus a stiffness and minus a damping.
            direct = [time_s / factor**2, ratio / factor]
            found[name] = direct if time_s < 0.0 else [time_s * factor, ratio]
        elif value is not None:
            found[name] = value * factor
    return found


def minutes(coarse: Result, scene: Scene, levels: Iterable[Level]) -> float:
    """Return the estimated minutes of processor time of the runs at some levels."""
    given, bodies = given_level(coarse), scene.deformables
    more_cells = max((MORE_CELLS.get(type(body), 2) for body in bodies), default=1)
    parts = [
        (1 if level.cell_m == given.cell_m else more_cells)
        * given.step_s
        / level.step_s
        for level in levels
    ]
    return (coarse.cpu_s or 0.0) * sum(parts) / 60.0


def finished(request: RunRequest) -> Result:
    """Run an episode that must not diverge."""
    result = run_episode(request)
    if result.diverged:
        raise BackendError(
            f"{result.id} on {request.backend} with {dict(request.settings or {})} diverged, so it has no solution: "
            f"{result.diverged_reason}"
        )
    return result


def motion(result: Result) -> FloatArray:
    """Return g(t) and the markers at the frames, shape [T, D + 3 M]."""
    assert result.trajectory is not None, "a finished run has a trajectory"
    g, markers_mm = result.trajectory.frames[1], result.trajectory.markers_mm
    return np.hstack([g, markers_mm]) if markers_mm.size else g


def check_replaceable_band(file: Path) -> None:
    """Raise an error if a file describes a reference that is no numerical solution."""
    if not file.is_file():
        return
    kind = Kind(read_band_file(file).kind)
    if kind is not Kind.NUMERICAL:
        raise ParameterError(
            f"{file}: its kind is {kind}, and only a numerical reference is replaced: move it, or give --out"
        )


def write_solution(
    file: Path, experiment: Experiment, solved: Solution, source: str
) -> None:
    """Write a solution as `<id>.band.toml` and `<id>.band.npz`; events in the first stay.

    Args:
        file: Path of the first.
        experiment: The experiment of the solution.
        solved: The solution.
        source: Origin of the motion, one sentence.
    """
    width, unit = solved.width, experiment.score.observable.unit
    mean, uncertainty = solved.mean[:, :width], solved.uncertainty[:, :width]
    moved = length(mean - mean[0], width)
    scale = MARKER_SIGMA_MM if unit == "mm" else mattering_distance(moved, unit) or 1.0
    arrays: dict[str, Any] = {
        "mean": mean,
        "sigma": np.hypot(uncertainty, scale),
        "uncertainty": uncertainty,
    }
    if solved.mean.shape[1] > width:
        arrays["markers_mm"] = solved.mean[:, width:]
        arrays["markers_uncertainty_mm"] = solved.uncertainty[:, width:]
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    old = file.read_text(encoding="utf-8") if file.is_file() else ""
    facts = {
        "kind": Kind.NUMERICAL.value,
        "unit": unit,
        "coordinates": list(experiment.coordinates),
        "source": source,
    }
    lines = [f"{key} = {json.dumps(value)}\n" for key, value in facts.items()]
    events = "".join(old.partition("\n[[events]]")[1:])
    save_file(file.with_suffix(".npz"), stream.getvalue())
    save_file(file, "".join(lines) + events)
