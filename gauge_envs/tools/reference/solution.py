"""Solve a scene by one engine at smaller steps and cells with stiffer contacts, and estimate its uncertainty.

The observed order of convergence p gives the error of the finest of three runs as |x3 - x2| / (2^p - 1) (Roache 1998).
Contacts and mesh have two levels, whose difference is the error of an order of 1. A second engine differs by at most
the half width of a rectangular distribution (GUM 4.3.7).
"""

import io
import json
import math
from collections.abc import Mapping, Sequence
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

RATIOS = 2.0**0.5, 2.0**4
"""Range of the ratio of two changes in sequence, of an order from 0.5 to 4."""

MORE_CELLS = {Cloth: 4, SoftBody: 8}
"""Factor on the number of cells with half their edge; 2 for ropes and rods."""


@dataclass(frozen=True, kw_only=True)
class Solution:
    """The finest run and its standard uncertainty: columns of g(t), then of the markers [mm].

    Attributes:
        mean: Motion at the frames, shape [T, D + 3 M].
        uncertainty: Its standard uncertainty, shape [T, D + 3 M].
        ratio: Change by the first halving of the step over that by the second.
        width: Number D of coordinates of g(t).
    """

    mean: FloatArray
    uncertainty: FloatArray
    ratio: float
    width: int

    @property
    def u(self) -> float:
        """Standard uncertainty over frames and markers [mm with markers, else unit of g(t)]."""
        return length(self.uncertainty, self.width)

    @property
    def moved(self) -> float:
        """Root mean square displacement, as `u`."""
        return length(self.mean - self.mean[0], self.width)

    @property
    def order(self) -> float:
        """Observed order of convergence in the step, from 0.5 to 4."""
        return math.log2(min(max(self.ratio, RATIOS[0]), RATIOS[1]))

    @property
    def converges(self) -> bool:
        """Whether the observed order is at least 0.5."""
        return self.ratio >= RATIOS[0]


def length(values: FloatArray, width: int) -> float:
    """Return the root mean square over frames and markers, or over frames of g(t) without markers.

    Args:
        values: Differences of g(t) and markers, shape [T, D + 3 M].
        width: Number D of coordinates of g(t).
    """
    count = (values.shape[1] - width) // 3
    compared = values[:, width:] if count else values
    return math.sqrt(float(np.square(compared).sum(axis=1).mean()) / (count or 1))


def solution(
    runs: Sequence[FloatArray], width: int, other: FloatArray | None = None
) -> Solution:
    """Return the solution of runs at the steps h, h/2 and h/4, then with stiffer contacts and half the cells.

    Args:
        runs: Their motions, shape [T, D + 3 M] each; each run after the third refines one thing more.
        width: Number D of coordinates of g(t).
        other: Motion of a second engine.
    """
    coarse, middle, fine = runs[:3]
    first, second = length(coarse - middle, width), length(middle - fine, width)
    found = Solution(
        mean=runs[-1],
        uncertainty=np.zeros_like(fine),
        ratio=first / second if second else math.inf,
        width=width,
    )
    parts = [(fine - middle) / (2.0**found.order - 1.0)]
    parts += [after - before for before, after in pairwise(runs[2:])]
    if other is not None:
        parts.append((other - runs[-1]) / math.sqrt(3.0))
    uncertainty = np.sqrt(np.square(parts).sum(axis=0))
    return replace(found, uncertainty=uncertainty)


def finer_settings(
    coarse: Result, scene: Scene, stiffer: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return the settings of the runs after the coarse one, from cheap to expensive.

    Args:
        coarse: The coarse run.
        scene: Its scene.
        stiffer: Settings of stiffer contacts; empty without contacts.
    """
    step_s, cell_m = (coarse.settings.get(name) for name in ("timestep_s", "cell_m"))
    if not step_s:
        raise ParameterError(
            f"backend {coarse.backend!r} has no setting timestep_s that can be refined: choose another one"
        )
    given = coarse.settings_given
    finer = [{**given, "timestep_s": step_s / parts} for parts in (2, 4)]
    if stiffer:
        finer.append({**finer[-1], **stiffer})
    if scene.deformables:
        if not cell_m:
            names = ", ".join(body.name for body in scene.deformables)
            raise ParameterError(
                f"{coarse.id}: the preset chooses the cells of {names}, so they cannot be halved: give their edge in "
                "metres by --set cell_m=..."
            )
        finer.append(finer[-1] | {"cell_m": cell_m / 2})
    return finer


def stiffer_contacts(coarse: Result, scene: Scene) -> dict[str, Any]:
    """Return settings with which contacts are half as soft; empty if nothing touches or the engine declares none."""
    stiffer: dict[str, Any] = {}
    if not scene.contacts:
        return stiffer
    for name, factor in backend_class(coarse.backend or "").contact_softness.items():
        value = coarse.settings.get(name)
        if isinstance(value, Sequence):
            time_s, ratio = value
            # Numbers below 0 are minus a stiffness and minus a damping.
            direct = [time_s / factor**2, ratio / factor]
            stiffer[name] = direct if time_s < 0.0 else [time_s * factor, ratio]
        elif value is not None:
            stiffer[name] = value * factor
    return stiffer


def minutes(coarse: Result, scene: Scene, finer: Sequence[Mapping[str, Any]]) -> float:
    """Return the estimated minutes of processor time of the finer runs."""
    parts = [2, *[4] * (len(finer) - 1)]
    if scene.deformables:
        parts[-1] *= max(MORE_CELLS.get(type(body), 2) for body in scene.deformables)
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
