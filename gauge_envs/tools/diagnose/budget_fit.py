"""Nested least-squares fits that split an error into release time, offset and rate."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import minimize

from gauge_envs.evaluation.metrics.trajectory import release_offset
from gauge_envs.evaluation.motion_kinds import RecognizedMotion
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.diagnose.model import BudgetStage

MAX_SHIFT_S = 10.0 / 30.0
"""Largest time shift in either direction [s]; the same as for the score's release offset."""

SHIFT_STEP_S = 1.0 / 180.0
"""Step of the grid of time shifts [s]: one sample."""

RATE_STEP = 0.01
"""Step of the grid of rates."""

CYCLE_STEP = 0.1
"""Largest step of the grid of rates for an oscillation, in cycles at its end; a minimum is half a cycle wide."""

GRID_COORDINATES = 12
"""Number of coordinates in the grid search; the refinement takes all."""

GRID_NUMBERS = 5_000_000
"""Largest count of numbers that a grid search computes; it leaves out frames to stay below."""

CHUNK_NUMBERS = 1_000_000
"""Count of numbers that are computed at once; each array then takes 8 MB."""

START_COUNT = 4
"""Number of local minima of the grid that are refined."""


@dataclass(frozen=True, eq=False)
class StageFit:
    """Best fit of a set of stages.

    Attributes:
        shift_s: Time shift [s]; positive is later.
        rate: Speed of the motion over that of the simulation.
        scale: Change of scale; see `RecognizedMotion.at`.
        offsets: Offset of each coordinate, shape [C].
        mean_squares: Mean squared error of each coordinate, shape [C].
    """

    shift_s: float
    rate: float
    scale: float
    offsets: FloatArray
    mean_squares: FloatArray

    @property
    def mean_square(self) -> float:
        """Mean squared error, the sum over coordinates."""
        return float(self.mean_squares.sum())

    @property
    def rmse(self) -> float:
        """Root mean square error."""
        return math.sqrt(self.mean_square)


class NestedFits:
    """Least-squares fits of a motion to the mean of real trials, for each set of stages.

    Shift and rate are searched on a grid and refined. Offsets and scale are linear, and are solved for at each point.

    Args:
        reference: Mean of the real trials at the frames, shape [frame_count, C]; NaN for a value that is not compared.
        times_s: Times of the simulation [s], shape [S].
        simulated: Band coordinates of the simulation, shape [S, C].
        motion: The recognized motion of the simulation.
        missing: Stages that do not apply, with the reason.

    Attributes:
        known: Frames with a value to compare, shape [frame_count].
        frame_count: Number of those frames.
    """

    def __init__(
        self,
        reference: FloatArray,
        times_s: FloatArray,
        simulated: FloatArray,
        motion: RecognizedMotion,
        missing: Mapping[BudgetStage, str],
    ) -> None:
        # The score, too, divides by the number of frames that have a value to compare.
        self.known = np.isfinite(reference).any(axis=1)
        self.frame_count = int(self.known.sum())
        self.motion = motion
        self.missing = missing
        self._times_s = times_s
        self._simulated = simulated
        self._whole_reference = reference
        self._reference = reference[self.known]
        self._frames_s = np.flatnonzero(self.known) / FRAME_RATE_HZ
        self._fits: dict[frozenset[BudgetStage], StageFit] = {}

    def fit(self, stages: Iterable[BudgetStage]) -> StageFit:
        """Return the best fit of a set of stages, without those that do not apply."""
        wanted = frozenset(stages) - set(self.missing)
        if wanted not in self._fits:
            self._fits[wanted] = self._searched(wanted)
        return self._fits[wanted]

    def deviations(self) -> FloatArray:
        """Return the squared deviation of the unchanged simulation at each known frame, shape [frame_count]."""
        played, _ = self.motion.at(self._frames_s, np.zeros(1), np.ones(1))
        return np.nansum(np.square(self._reference - played[0]), axis=1)

    def continued_frames(self, fit: StageFit) -> int:
        """Return the number of frames at which a fit needs the motion past the end of the simulation."""
        since_start = np.clip(self._frames_s - fit.shift_s, 0.0, self.motion.end_s)
        return (
            int((fit.rate * since_start > self.motion.end_s + 1e-9).sum())
            if fit.rate > 1.0
            else 0
        )

    def likeness(self, fit: StageFit) -> float:
        """Return the squared cosine between changes of rate and of scale at a fit; 0 if the motion has only one."""
        low, high = self.motion.rate_bounds
        if BudgetStage.RATE in self.missing or low == high:
            return 0.0
        rates = np.clip(fit.rate + np.array([-RATE_STEP, RATE_STEP]), low, high)
        played, basis = self.motion.at(self._frames_s, np.full(2, fit.shift_s), rates)
        known = np.isfinite(self._reference)
        faster, larger = (
            np.where(known, change, 0.0)
            for change in (played[1] - played[0], basis.mean(axis=0))
        )
        both = np.square(faster).sum() * np.square(larger).sum()
        return float(np.square((faster * larger).sum()) / both) if both > 0.0 else 0.0

    def _searched(self, stages: frozenset[BudgetStage]) -> StageFit:
        smaller = (
            [self.fit(some) for some in combinations(sorted(stages), len(stages) - 1)]
            if stages
            else []
        )
        if stages == {BudgetStage.RELEASE}:
            # The score's own alignment, so that both give the same number.
            shift_s, _ = release_offset(
                self._times_s,
                self._simulated,
                self._whole_reference,
                frame_rate_hz=FRAME_RATE_HZ,
                max_offset_s=MAX_SHIFT_S,
            )
            found = [np.array([shift_s, 1.0])]
        else:
            found = self._refined(stages, smaller)
        fits = [self._solved(stages, *point) for point in found]
        best = min(fits, key=lambda one: one.mean_square)
        # A larger model contains the smaller one, so its fit is never worse.
        least = min(smaller, key=lambda one: one.mean_square, default=None)
        return best if least is None or best.mean_square <= least.mean_square else least

    def _refined(
        self, stages: frozenset[BudgetStage], smaller: Sequence[StageFit]
    ) -> list[FloatArray]:
        """Return shift and rate of the best local minima, shape [2] each."""
        bounds = np.array([self._shift_bounds(stages), self._rate_bounds(stages)])
        free = bounds[:, 0] < bounds[:, 1]
        if not free.any():
            return [bounds[:, 0]]
        shifts, rates, steps = self._grid(bounds)
        starts = _local_minima(shifts, rates, self._grid_errors(stages, shifts, rates))
        starts += [np.array([one.shift_s, one.rate]) for one in smaller]
        found = []
        for start in starts:
            point = np.clip(start, bounds[:, 0], bounds[:, 1])

            def error(chosen: FloatArray, point: FloatArray = point) -> float:
                full = point.copy()
                full[free] = chosen
                return self._solved(stages, *full).mean_square

            # On a bound, where it is clipped on each reflection, the simplex would collapse after one step.
            low, high = bounds[free].T
            margin = 0.5 * np.minimum(steps[free], high - low)
            inside = np.clip(point[free], low + margin, high - margin)
            corners = np.tile(inside, (int(free.sum()) + 1, 1))
            for axis, step in enumerate(steps[free]):
                corners[axis + 1, axis] += (
                    step if inside[axis] + step <= high[axis] else -step
                )
            options = {
                "initial_simplex": corners,
                "xatol": 1e-7,
                "fatol": math.inf,
                "maxfev": 400,
            }
            fitted = minimize(
                error,
                point[free],
                method="Nelder-Mead",
                bounds=bounds[free],
                options=options,
            )
            full = point.copy()
            full[free] = fitted.x
            found += [point, full]
        # Among equal fits the smallest change comes first, so that a body at rest is not shifted.
        found.append(np.array([0.0, 1.0]))
        return sorted(found, key=lambda one: (abs(one[0]), abs(one[1] - 1.0)))

    def _shift_bounds(self, stages: frozenset[BudgetStage]) -> tuple[float, float]:
        if BudgetStage.RELEASE not in stages:
            return 0.0, 0.0
        # As in the score, a simulation is not shifted past its own end.
        later_s = max(float(self._times_s[-1] - self._frames_s[-1]), 0.0)
        return -min(later_s, MAX_SHIFT_S), MAX_SHIFT_S

    def _rate_bounds(self, stages: frozenset[BudgetStage]) -> tuple[float, float]:
        return self.motion.rate_bounds if BudgetStage.RATE in stages else (1.0, 1.0)

    def _grid(self, bounds: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the values of shift and rate on the grid, and their steps."""
        rate_step = RATE_STEP
        if self.motion.period_s is not None:
            rate_step = min(
                rate_step, CYCLE_STEP * self.motion.period_s / self._frames_s[-1]
            )
        steps = np.array([SHIFT_STEP_S, rate_step])
        counts = np.ceil((bounds[:, 1] - bounds[:, 0]) / steps - 1e-9).astype(int) + 1
        shifts, rates = (
            np.linspace(low, high, count)
            for (low, high), count in zip(bounds, counts, strict=True)
        )
        return shifts, rates, steps

    def _grid_errors(
        self, stages: frozenset[BudgetStage], shifts: FloatArray, rates: FloatArray
    ) -> FloatArray:
        """Return the squared error on the grid, shape [shift_count, rate_count].

        The grid only gives starts for the refinement, so it takes the coordinates with the largest error and, for long
        episodes, a part of the frames.
        """
        squares = np.nansum(np.square(self._reference - self._simulated[0]), axis=0)
        largest_first = np.argsort(squares)[::-1]
        columns = np.sort(largest_first[:GRID_COORDINATES])
        motion = self.motion.select(columns)

        number_count = len(shifts) * len(rates) * len(self._reference) * len(columns)
        stride = max(1, math.ceil(number_count / GRID_NUMBERS))
        reference = self._reference[::stride, columns]
        frames_s = self._frames_s[::stride]

        shift_of_point, rate_of_point = (
            one.ravel() for one in np.meshgrid(shifts, rates, indexing="ij")
        )
        point_count = len(shift_of_point)
        errors = np.zeros(point_count)
        chunk_count = math.ceil(reference.size * point_count / CHUNK_NUMBERS)
        for chunk in np.array_split(np.arange(point_count), chunk_count):
            played, basis = motion.at(
                frames_s, shift_of_point[chunk], rate_of_point[chunk]
            )
            left, _, _ = self._linear(stages, reference, played, basis)
            errors[chunk] = left.sum(axis=1)
        return errors.reshape(len(shifts), len(rates))

    def _solved(
        self, stages: frozenset[BudgetStage], shift_s: float, rate: float
    ) -> StageFit:
        played = self.motion.at(self._frames_s, np.array([shift_s]), np.array([rate]))
        squares, scale, offsets = self._linear(stages, self._reference, *played)
        return StageFit(
            float(shift_s),
            float(rate),
            float(scale[0]),
            offsets[0],
            squares[0] / self.frame_count,
        )

    def _linear(
        self,
        stages: frozenset[BudgetStage],
        reference: FloatArray,
        played: FloatArray,
        basis: FloatArray,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Solve for scale and offsets of G motions.

        With the best offsets the error is a parabola in the scale, so the bounded minimum is the clipped one.

        Returns:
            Remaining summed squared error of each coordinate, shape [G, C]; scales, shape [G]; offsets, shape [G, C].
        """
        known = np.isfinite(reference)
        counts = np.maximum(known.sum(axis=0), 1)

        def centred(values: FloatArray) -> tuple[FloatArray, FloatArray]:
            """Return known values minus their mean over time if the stages have offsets, and that mean."""
            kept = values if known.all() else np.where(known, values, 0.0)
            if BudgetStage.OFFSET not in stages:
                return kept, np.zeros((len(played), reference.shape[1]))
            mean = kept.sum(axis=1) / counts
            kept = kept - mean[:, None]
            return (kept if known.all() else np.where(known, kept, 0.0)), mean

        deviation, offsets = centred(reference - played)
        scale = np.zeros(len(played))
        if BudgetStage.RATE in stages:
            change, mean = centred(basis)
            size, overlap = (
                np.einsum("gtc,gtc->g", change, other) for other in (change, deviation)
            )
            best = np.divide(overlap, size, out=np.zeros_like(size), where=size > 0.0)
            scale = np.clip(best, *self.motion.scale_bounds)
            deviation = deviation - scale[:, None, None] * change
            offsets = offsets - scale[:, None] * mean
        return np.einsum("gtc,gtc->gc", deviation, deviation), scale, offsets


def _local_minima(
    shifts: FloatArray, rates: FloatArray, errors: FloatArray
) -> list[FloatArray]:
    """Return the deepest local minima of a grid, deepest first."""
    padded = np.pad(errors, 1, constant_values=np.inf)
    around = [
        padded[i : i + len(shifts), j : j + len(rates)]
        for i in range(3)
        for j in range(3)
        if (i, j) != (1, 1)
    ]
    rows, columns = np.nonzero(errors <= np.min(around, axis=0))
    order = np.argsort(errors[rows, columns], kind="stable")[:START_COUNT]
    return [np.array([shifts[rows[k]], rates[columns[k]]]) for k in order]
