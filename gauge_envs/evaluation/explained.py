"""What the uncertain inputs of a simulation can explain of its error."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gauge_envs.evaluation.deviation import Deviations, sampled_frames
from gauge_envs.evaluation.metrics.trajectory import release_offsets, trajectory_rmse
from gauge_envs.evaluation.numerics import interpolated
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band
from gauge_envs.references.sensitivities import InputUncertainty, Sensitivities
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.timing import FRAME_RATE_HZ

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
    values = band.project(values)
    changes: list[tuple[InputUncertainty, float]] = []
    moved_values: list[FloatArray] = []
    for one in _inputs(experiment, band, sensitivities):
        below = -one.change if one.change_below is None else one.change_below
        for sign, table in ((1.0, one.change), (-1.0, below)):
            moved = band.project(table[: len(band.mean)])
            change = _at(moved, times_s)
            for share in _lowering_shares(moved, deviations):
                changes.append((one, sign * share))
                moved_values.append(values + share * change)
    if not changes:
        return ()
    errors = _errors(
        experiment,
        band,
        times_s,
        np.array(moved_values),
        is_aligned=deviations.is_aligned,
    )
    found: dict[int, Explained] = {}
    limit = (1.0 - LEAST_SHARE) * deviations.first.rmse
    for (one, change_stds), error in zip(changes, errors.tolist(), strict=True):
        best = found.get(id(one))
        if error < (limit if best is None else best.left):
            found[id(one)] = Explained(
                name=one.name,
                kind=one.kind,
                std=one.std,
                unit=one.unit,
                source=one.source,
                change=change_stds,
                left=error,
            )
    return tuple(sorted(found.values(), key=lambda one: one.left))


def _inputs(
    experiment: Experiment, band: Band, sensitivities: Sensitivities
) -> Iterator[InputUncertainty]:
    """Yield the inputs that the simulation does not share with its reference."""
    for one in sensitivities.inputs:
        fits = (
            len(one.change) >= len(band.mean)
            and one.change.shape[1] == band.projection.shape[1]
        )
        is_shared = not band.grade.is_real and one.kind != "discretization"
        is_replaced = bool(experiment.overrides) and one.kind == "constant"
        if fits and not is_shared and not is_replaced:
            yield one


def _lowering_shares(change: FloatArray, deviations: Deviations) -> set[float]:
    """Return the shares of a change of the motion that may lower the error: all of it, and the best to first order.

    The share s minimizes |d + s c|^2 of the deviation d and the change c, at -(d c) / (c c). Where the motion is
    aligned, the part of c along the velocity is a shift in time, which the alignment takes away.

    Args:
        change: Change of the motion at the frames, shape [T, C].
        deviations: Deviations of the simulation.
    """
    first = deviations.first
    offset_s = (deviations.release_offset_s or 0.0) if deviations.is_aligned else 0.0
    known = np.isfinite(first.values)
    deviation = np.where(known, first.values, 0.0).ravel()
    frames_s = np.arange(len(change)) / FRAME_RATE_HZ
    shape = np.where(known, _at(change, frames_s - offset_s), 0.0).ravel()
    if first.velocity is not None:
        velocity = np.where(known, first.velocity, 0.0).ravel()
        direction = velocity / max(length_of(velocity), 1e-300)
        shape = shape - (shape @ direction) * direction
    slope = float(deviation @ shape)
    square = float(shape @ shape)
    if slope >= 0.0 or square == 0.0:
        return set()
    return {min(-slope / square, 1.0), 1.0}


def _errors(
    experiment: Experiment,
    band: Band,
    times_s: FloatArray,
    motions: FloatArray,
    *,
    is_aligned: bool,
) -> FloatArray:
    """Return the errors of several motions, as the score computes them, shape [motion_count].

    Args:
        experiment: Experiment that was simulated.
        band: Its reference.
        times_s: Times of the samples [s], shape [sample_count].
        motions: Band coordinates at those times, shape [motion_count, sample_count, C].
        is_aligned: Whether each motion is shifted in time first.
    """
    if is_aligned:
        return release_offsets(
            times_s, motions, band.mean, frame_rate_hz=FRAME_RATE_HZ
        )[1]
    frames = (sampled_frames(experiment, times_s, one) for one in motions)
    return np.array([trajectory_rmse(one, band.mean) for one in frames])


def _at(table: FloatArray, times_s: FloatArray) -> FloatArray:
    """Return a change at any times: none before the start, and on the last line after the end."""
    frames_s = np.arange(len(table)) / FRAME_RATE_HZ
    slope_per_s = (table[-1] - table[-2]) * FRAME_RATE_HZ
    after_s = np.maximum(times_s - frames_s[-1], 0.0)
    last = table[-1] + slope_per_s * after_s[:, None]
    inside = interpolated(times_s, frames_s, table)
    return np.where(times_s[:, None] > frames_s[-1], last, inside)
