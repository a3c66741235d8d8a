"""How much of an error the uncertain inputs of a simulation can explain.

A score is that of an engine with the published constants, so their uncertainty is no part of its interval. Beside it
stands, for each input, the error that another value of it would leave: at most one standard uncertainty from the
published one (`scoring/uncertainties.toml`). That of a constant is its distance from single real trials.

The motion with another value is taken as straight between the simulated one and that with the input one standard
uncertainty away, which was simulated (`references.sensitivities`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gauge_envs.evaluation.deviation import Deviations, sampled_frames
from gauge_envs.evaluation.metrics.trajectory import release_offset, trajectory_rmse
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band
from gauge_envs.references.sensitivities import InputUncertainty, Sensitivities
from gauge_envs.scene.timing import FRAME_RATE_HZ

FloatArray = NDArray[np.float64]

LEAST_SHARE = 0.01
"""Share of an error below which an input explains nothing."""


@dataclass(frozen=True, kw_only=True)
class Explained:
    """What one uncertain input can explain of the error that reports show first.

    Attributes:
        name: Name of the input, as `restitution ball/ground`.
        kind: `constant`, `start`, `tilt` or `discretization`.
        std: Its standard uncertainty, in `unit`.
        unit: Unit of `std`.
        source: Origin of `std`.
        change: Change of the input that leaves the smallest error, in standard uncertainties, -1 to 1.
        left: That error, in the unit of the score.
    """

    name: str
    kind: str
    std: float
    unit: str
    source: str
    change: float
    left: float


def explained(
    experiment: Experiment,
    band: Band,
    sensitivities: Sensitivities,
    deviations: Deviations,
    *,
    times_s: FloatArray,
    values: FloatArray,
) -> tuple[Explained, ...]:
    """Return what each input can explain of an error, the one that leaves the smallest first.

    The change of an input is chosen to first order; the error that it leaves is then computed as that of a simulation.

    Args:
        experiment: Experiment that was simulated. An overridden constant has no published uncertainty.
        band: Its reference. A law has the constants, the start and the tilt of the simulation.
        sensitivities: Changes of the motion.
        deviations: Deviations of the simulation from the band.
        times_s: Times of its samples [s], shape [sample_count].
        values: g(t) at those times, shape [sample_count, coordinate_count].
    """
    first, values = deviations.first, band.project(values)
    offset_s = (deviations.release_offset_s or 0.0) if deviations.is_aligned else 0.0

    def distance(moved: FloatArray) -> float:
        if deviations.is_aligned:
            return release_offset(times_s, moved, band.mean, frame_rate_hz=FRAME_RATE_HZ)[1]
        return trajectory_rmse(sampled_frames(experiment, times_s, moved), band.mean)

    frames_s = np.arange(len(band.mean)) / FRAME_RATE_HZ
    known = np.isfinite(first.values)
    flat = np.where(known, first.values, 0.0).ravel()
    along = np.zeros_like(flat) if first.velocity is None else np.where(known, first.velocity, 0.0).ravel()
    along = along / max(float(np.linalg.norm(along)), 1e-300)
    found = []
    for one in _inputs(experiment, band, sensitivities):
        best, left = 0.0, (1.0 - LEAST_SHARE) * first.rmse
        below = -one.change if one.change_below is None else one.change_below
        for sign, table in ((1.0, one.change), (-1.0, below)):
            moved = band.project(table[: len(band.mean)])
            shape = np.where(known, _at(moved, frames_s - offset_s), 0.0).ravel()
            shape = shape - (shape @ along) * along
            slope, size = float(flat @ shape), float(shape @ shape)
            if slope >= 0.0 or size == 0.0:
                continue
            for share in {min(-slope / size, 1.0), 1.0}:
                rest = distance(values + share * _at(moved, times_s))
                if rest < left:
                    best, left = sign * share, rest
        if best:
            found.append(
                Explained(
                    name=one.name,
                    kind=one.kind,
                    std=one.std,
                    unit=one.unit,
                    source=one.source,
                    change=best,
                    left=left,
                )
            )
    return tuple(sorted(found, key=lambda one: one.left))


def _inputs(experiment: Experiment, band: Band, sensitivities: Sensitivities) -> Iterator[InputUncertainty]:
    for one in sensitivities.inputs:
        fits = len(one.change) >= len(band.mean) and one.change.shape[1] == band.projection.shape[1]
        is_shared = not band.grade.is_real and one.kind != "discretization"
        is_replaced = bool(experiment.overrides) and one.kind == "constant"
        if fits and not is_shared and not is_replaced:
            yield one


def _at(table: FloatArray, times_s: FloatArray) -> FloatArray:
    """Return a change at any times: none before the start, and on the last line after the end."""
    frames_s = np.arange(len(table)) / FRAME_RATE_HZ
    last = table[-1] + (table[-1] - table[-2]) * FRAME_RATE_HZ * np.maximum(times_s - frames_s[-1], 0.0)[:, None]
    inside = np.column_stack([np.interp(times_s, frames_s, column) for column in table.T])
    return np.where(times_s[:, None] > frames_s[-1], last, inside)
