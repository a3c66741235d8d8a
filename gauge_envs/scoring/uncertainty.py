"""Uncertainty of a score, after the Guide to the Expression of Uncertainty in Measurement (GUM) and its Supplement 1.

Measurement model. A score is S = |g - r| / B: g is the simulated trajectory, r the mean of infinitely many trials like
those measured, B their mean distance from it, and |.| the root mean square over frames. The score is that of the engine
with its constants, start and step as they are, so g is exact. The observed deviation d = g - r differs from the true
one by an error e of the reference, a sum of contributions. Each has a shape over frames and coordinates, and a random
factor:

- `sampling`: r and B are from a sample of trials, whose errors are correlated.
- `release`: the part of the sampling that shifts the mean in time, because trials are released at different times.
- `smear`: trials with different releases smear r, above all at impacts, and a sample of few smears less.
- `extrapolation`: frames of r that no trial shows.
- `measurement`: the uncertainty of the measured mean, where it is stated.
- `projection`: motion across the measured coordinates, which a small error of their direction mixes in.

Single trials. A drawn e is a random combination of the trials, such that its component in each direction has the law of
Student's t with N - 1 degrees of freedom. That is exact for normal scatter, and robust for other scatter. The logarithm
of B has the same combination of the trials' effects on it: by their distances, and by the mean, which they move
(`scoring.error_sources`). Trials in recorded order may be alike. So an interval is widened by the correlation that
they show in the direction of the error, and a margin (`scoring.dependence`). Nothing is cut off: an outlier widens
an interval as it moves the mean. Fewer than three trials, or too few independent ones, have no interval.

Interval. With a unit vector u, a true distance L would have been observed as |L u + e|. For each draw of e, the L that
gives the observed distance is the root of a quadratic; u is drawn too, as the direction of d minus another draw of e.
The 95 % interval is between percentiles of these roots. This inverts the test of each L (Neyman), so it does not count
the error of the mean twice, as adding e to d would. The upper percentile is divided by the share of draws that have a
root (CLs), so that a distance below its own errors gives no empty interval. `studies/coverage` measures how often the
intervals hold the truth. Laws and solved models have an error of their own (`scoring.verification`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from statistics import NormalDist

import numpy as np

from gauge_envs.references.bands import Band
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.published import Baseline
from gauge_envs.references.uncertainties import TILT_DEG
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray, length_of
from gauge_envs.scoring.dependence import LEAST_TRIALS, LEVEL, refusal, widening
from gauge_envs.scoring.error_sources import (
    DRAW_COUNT,
    ErrorShapes,
    ErrorSource,
    add_measurement,
    add_spread,
    add_trials,
    baseline_draws,
    random_numbers,
    relative_influence,
    trial_weights,
)
from gauge_envs.scoring.metrics.trajectory import MAX_RELEASE_OFFSET_S
from gauge_envs.scoring.numerics import tall_product

BELOW_NOISE = 0.01
"""Share of draws below which an observed distance counts as smaller than its own errors."""

SMEARS = np.array([0.0, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0, 5.0])
"""Standard deviations of releases, over that of the trials, between which the smear of the mean is interpolated."""

_QUANTILES = np.array([NormalDist().inv_cdf((i + 0.5) / 9.0) for i in range(9)])

RELEASES = _QUANTILES / np.std(_QUANTILES)
"""Nine releases that stand for normal ones, over their standard deviation."""

NEGLIGIBLE = 1e-5
"""Size of an error shape over the largest one below which it is left out."""

TRIAL_KINDS = ("release", "sampling")
"""Kinds with a shape for each trial, if there are single trials."""

PATH_NUMBERS = 2_000_000
"""Largest count of numbers in the draws of a warping path."""

PROJECTION_FLOOR_MM = 1.0
"""Motion across the measured coordinates below which their direction does not matter: 0.3 degrees of it is 5 um."""


def _reported(value: float) -> float:
    """Return six significant digits: the last bits of a matrix product depend on the memory that holds it."""
    return float(f"{value:.6g}")


@dataclass(frozen=True, eq=False, kw_only=True)
class _Components:
    """Errors by their components along orthonormal shapes.

    Attributes:
        shapes: Orthonormal shapes, shape [component_count, entry_count].
        of_trials: Components of the error of the sample of trials in each draw, shape [draw_count, component_count].
        of_others: Those of all other errors, same shape.
        of_smear: Those of the smear of the mean, which others contain, same shape; their mean is not 0.
        variance: Mean square of the error but for the smear, unbiased.
    """

    shapes: FloatArray
    of_trials: FloatArray
    of_others: FloatArray
    of_smear: FloatArray
    variance: float

    def drawn(self, wider: float) -> FloatArray:
        """Return the components of each draw, with a widening for trials that depend on each other."""
        drawn = wider * self.of_trials
        drawn += self.of_others
        return drawn


@dataclass(frozen=True, eq=False, kw_only=True)
class BandErrors:
    """Errors of the deviation between a simulation and a band, as shapes with random factors.

    Frames without a mean are left out, and shapes are divided by the square root of the number of frames, so that a
    norm is a root mean square over frames.

    Attributes:
        known: Entries of the mean that are compared, shape [T, C].
        shapes: Error shapes, shape [shape_count, entry_count].
        factors: Random factors of the shapes of each source, shape [draw_count, shape_count] each.
        baseline: Logarithm of the measured over the true baseline in each draw, shape [draw_count].
        baseline_bias: Measured baseline over the true one on average: trials are nearer to a mean that they are part
            of, and farther from that of the others.
        sources: Kind of each group of shapes.
        trial_count: Number of trials with a shape of their own in each group `release` and `sampling`; 0 without.
        influence: Relative effect of each trial on the baseline, shape [trial_count].
    """

    known: BoolArray
    shapes: FloatArray
    factors: tuple[FloatArray, ...]
    baseline: FloatArray
    baseline_bias: float
    sources: tuple[ErrorSource, ...]
    trial_count: int
    influence: FloatArray

    def flat(self, deviation: FloatArray) -> FloatArray:
        """Return deviations of shape [..., T, C] as vectors whose norm is their root mean square over frames."""
        known = np.where(self.known, deviation, 0.0)
        return np.asarray(
            known.reshape(*known.shape[:-2], -1) / _root_of_frames(self.known)
        )

    def aligned(
        self, velocity: FloatArray, moved: Callable[[FloatArray], FloatArray]
    ) -> BandErrors:
        """Return the errors that a shift in time leaves, with that of the smear of the mean.

        To first order, a shift takes away all errors along the velocity. Beyond it, a mean of trials with different
        releases is smeared, most of all at an impact. How much depends on their standard deviation. It is drawn from
        its law for normal releases, and the simulation is smeared as much.

        Args:
            velocity: Velocity of the shifted simulation at the frames [unit/s], shape [T, C].
            moved: The shifted simulation at the frames, later by K times [s], shape [K, T, C]; NaN where not known.
        """
        direction = self.flat(velocity)
        size = float(direction @ direction)
        if size == 0.0:
            return self

        def left(shapes: FloatArray) -> FloatArray:
            return np.asarray(shapes - np.outer(shapes @ direction, direction) / size)

        aligned = replace(self, shapes=left(self.shapes))
        count, releases_s = self.trial_count, self._trials @ direction / size
        if count < LEAST_TRIALS or not releases_s.any():
            return aligned
        std_s = length_of(releases_s) / math.sqrt(count - 1)
        late_s = np.concatenate(
            [[0.0], releases_s, np.outer(SMEARS, std_s * RELEASES).ravel()]
        )
        curves = moved(np.clip(late_s, -MAX_RELEASE_OFFSET_S, MAX_RELEASE_OFFSET_S))
        away = left(self.flat(np.nan_to_num(curves - curves[0])))
        of_trials, smears = (
            away[1 : count + 1],
            away[count + 1 :].reshape(len(SMEARS), len(RELEASES), -1).mean(axis=1),
        )
        # The variance of a sample has the law of chi-squared. Kurtosis and trials that are alike take degrees of it.
        squares = np.square(releases_s / std_s)
        kurtosis = max(
            float(np.mean(np.square(squares))) / float(squares.mean()) ** 2 - 1.0, 2.0
        )
        degrees = 2.0 * (count - 1) / kurtosis / widening(squares) ** 2
        drawn = np.sqrt(
            degrees / random_numbers("smear").chisquare(degrees, DRAW_COUNT)
        )
        place = np.interp(drawn, SMEARS, np.arange(len(SMEARS)))
        factors = np.maximum(1.0 - np.abs(place[:, None] - np.arange(len(SMEARS))), 0.0)
        return aligned.with_source("smear", smears - of_trials.mean(axis=0), factors)

    def with_source(
        self, kind: str, shapes: FloatArray, factors: FloatArray
    ) -> BandErrors:
        """Return the errors with those of one more source."""
        columns = slice(len(self.shapes), len(self.shapes) + len(shapes))
        added = ErrorSource(kind=kind, columns=columns)
        return replace(
            self,
            shapes=np.vstack([self.shapes, shapes]),
            factors=(*self.factors, factors),
            sources=(*self.sources, added),
        )

    def with_baseline(self, distances: FloatArray) -> BandErrors:
        """Return the errors with the mean distance of the trials, each from the mean of the others, as the baseline.

        Args:
            distances: Distance of each trial, shape [trial_count].
        """
        count = len(distances)
        if count < LEAST_TRIALS:
            return self
        influence = relative_influence(distances, -self._trials)
        return replace(
            self,
            baseline=baseline_draws(influence),
            baseline_bias=math.sqrt(count / (count - 1)),
            influence=influence,
        )

    def with_projection(self, band: Band, frames: FloatArray) -> BandErrors:
        """Return the errors with that of the band's directions, for a band that has fewer coordinates than g(t).

        Directions lean by the standard uncertainty of the tilt, so motion across them changes the coordinates.

        Args:
            band: The band.
            frames: g(t) at the frames, shape [T, D].
        """
        if band.unit != "mm" or len(band.projection) >= band.projection.shape[1]:
            return self
        moved = frames - frames[0]
        across = np.linalg.norm(
            moved - moved @ np.linalg.pinv(band.projection) @ band.projection, axis=1
        )
        if np.abs(across).max() < PROJECTION_FLOOR_MM:
            return self
        shape = self.flat(
            math.radians(TILT_DEG) * across[:, None] * np.ones(len(band.projection))
        )
        factors = random_numbers("projection").standard_normal((DRAW_COUNT, 1))
        return self.with_source("projection", shape[None], factors)

    @cached_property
    def _components(self) -> _Components:
        """The errors by their components."""
        count = self.trial_count
        of_trials = TRIAL_KINDS if count else ()
        others = [
            (one, factors)
            for one, factors in zip(self.sources, self.factors, strict=True)
            if one.kind not in of_trials
        ]
        shapes = [self._trials, *(self.shapes[one.columns] for one, _ in others)]
        left, sizes, right = np.linalg.svd(np.concatenate(shapes), full_matrices=False)
        kept = sizes > NEGLIGIBLE * sizes[0]
        along = left[:, kept] * sizes[kept]
        variance = float(np.square(along[:count]).sum()) / max(count * (count - 1), 1)
        of_others = np.zeros((DRAW_COUNT, along.shape[1]))
        of_smear = np.zeros_like(of_others)
        first = count
        for one, factors in others:
            rows = along[first : first + factors.shape[1]]
            first += len(rows)
            errors = tall_product(factors, rows)
            of_others += errors
            if one.kind == "smear":
                of_smear = errors
            else:
                variance += float(np.square(rows).sum())
        return _Components(
            shapes=right[kept],
            of_trials=tall_product(trial_weights(count), along[:count]),
            of_others=of_others,
            of_smear=of_smear,
            variance=variance,
        )

    @cached_property
    def _trials(self) -> FloatArray:
        """Error shape of each trial, shape [trial_count, entry_count]."""
        groups = [
            self.shapes[one.columns]
            for one in self.sources
            if self.trial_count and one.kind in TRIAL_KINDS
        ]
        return np.sum(groups, axis=0) if groups else np.zeros((0, self.shapes.shape[1]))

    def influences(
        self, deviation: FloatArray, *, over_baseline: bool = True
    ) -> FloatArray:
        """Return the effect of each trial on a distance, to first order, in the unit of the deviation.

        Args:
            deviation: Simulation minus mean, shape [T, C].
            over_baseline: Whether the distance is divided by the baseline, and multiplied by its measured value.

        Returns:
            Effects in the order of the trials, shape [trial_count]; empty without single trials.
        """
        vector = self.flat(deviation)
        size = length_of(vector)
        along = (
            self._trials @ (vector / size)
            if size > 0.0
            else np.linalg.norm(self._trials, axis=1)
        )
        return np.asarray(along - size * self.influence if over_baseline else along)

    def refusal(
        self, deviation: FloatArray, *, over_baseline: bool = True
    ) -> str | None:
        """Return why a distance has no interval; None if it has one.

        Args:
            deviation: Simulation minus mean, shape [T, C].
            over_baseline: As for `interval`.
        """
        return refusal(self.influences(deviation, over_baseline=over_baseline))

    def interval(
        self, deviation: FloatArray, *, over_baseline: bool = True
    ) -> tuple[float, float] | None:
        """Return the 95 % interval of a root-mean-square distance, in the unit of the deviation; None if refused.

        Args:
            deviation: Simulation minus mean, shape [T, C].
            over_baseline: Whether the interval is that of the ratio to the baseline, times the baseline; else it is of
                the distance alone.
        """
        series = self.influences(deviation, over_baseline=over_baseline)
        if refusal(series) is not None:
            return None
        vector = self.flat(deviation)
        size = length_of(vector)
        low, high = self._interval(
            vector, widening(series), over_baseline=over_baseline
        )
        return min(_reported(low), size), max(_reported(high), size)

    def _ratio(self, wider: float, *, over_baseline: bool) -> FloatArray:
        """Return the measured over the true baseline of each draw; 1 for a distance alone."""
        if not over_baseline:
            return np.ones(DRAW_COUNT)
        return np.asarray(
            self.baseline_bias * np.exp(np.clip(wider * self.baseline, -10.0, 10.0))
        )

    def _interval(
        self, vector: FloatArray, wider: float, *, over_baseline: bool
    ) -> tuple[float, float]:
        tail = 0.5 * (1.0 - LEVEL)
        ratio = self._ratio(wider, over_baseline=over_baseline)
        drawn, size = self._components.drawn(wider), length_of(vector)
        squares = np.einsum("kc,kc->k", drawn, drawn)
        # e . d and |d - e| of each draw
        along = tall_product(drawn, self._components.shapes @ vector)
        added = np.sqrt(np.maximum(size**2 - 2.0 * along + squares, 0.0))
        # The direction of the true deviation is not that of the observed one: it has the errors of the next draw.
        products = np.einsum("kc,kc->k", drawn[:-1], drawn[1:])
        along = (along[:-1] - products) / np.maximum(added[1:], 1e-150)
        excess = np.square(along) - squares[:-1] + size**2
        roots = np.where(
            excess >= 0.0,
            ratio[:-1] * (np.sqrt(np.maximum(excess, 0.0)) - along),
            -np.inf,
        )
        reached = float(np.mean(squares <= size**2))
        if reached < BELOW_NOISE:
            return 0.0, float(np.quantile(added * ratio, LEVEL))
        low = max(float(np.quantile(roots, tail, method="lower")), 0.0)
        high = float(np.quantile(roots, 1.0 - tail * reached, method="higher"))
        return min(low, size), max(high, size)

    def path_interval(
        self, path: IntArray, simulated: FloatArray, mean: FloatArray
    ) -> tuple[float, float] | None:
        """Return the 95 % interval of a mean distance along a warping path, in the unit of the band; None if refused.

        To first order an error does not change the best path. The errors of a cell are those of the mean at its frame.

        Args:
            path: Frames (simulated, real) of the cells, shape [cell_count, 2].
            simulated: Band coordinates of the simulation, shape [T, C].
            mean: Mean of the real trials, shape [T, C].
        """
        errors = self._components
        scale = _root_of_frames(self.known)
        difference = np.nan_to_num(simulated[path[:, 0]] - mean[path[:, 1]])
        lengths = np.linalg.norm(difference, axis=1)
        observed = float(lengths.mean())
        units = difference / np.maximum(lengths, 1e-300)[:, None]
        trials = (self._trials * scale).reshape(-1, *self.known.shape)[:, path[:, 1]]
        series = (
            np.einsum("npc,pc->n", trials, units) / len(path)
            - observed * self.influence
        )
        if refusal(series) is not None:
            return None
        wider = widening(series)
        shapes = (errors.shapes * scale).reshape(-1, *self.known.shape)[:, path[:, 1]]
        count = max(min(DRAW_COUNT, PATH_NUMBERS // difference.size), 100)
        flat = shapes.reshape(len(shapes), -1)
        cells = tall_product(errors.drawn(wider)[:count], flat)
        cells = cells.reshape(-1, *difference.shape) + difference
        drawn = np.sqrt(np.einsum("kpc,kpc->kp", cells, cells)).mean(axis=1)
        ratio = self._ratio(wider, over_baseline=True)[:count]
        tail = 0.5 * (1.0 - LEVEL)
        low, high = np.quantile(drawn / ratio, [tail, 1.0 - tail])
        half = 0.5 * float(high - low)
        return _reported(max(observed - half, 0.0)), _reported(observed + half)

    def draws(self, deviation: FloatArray) -> FloatArray:
        """Return draws of the normalized distance times the baseline, shape [draw_count].

        Simulations that are compared on one band have the same draws of its mean and baseline. A draw is the root of
        the squared distance from a drawn mean, less what the errors of both means add to it. Below zero it is minus the
        root of the amount. So the difference of two squared distances is linear in the error, as it is in truth, and
        the sign of the difference of two draws has the law of Student's test.

        Args:
            deviation: Simulation minus mean, shape [T, C].
        """
        vector, drawn = self.flat(deviation), self._components.drawn(1.0)
        expected = (
            float(np.square(drawn - self._components.of_smear).sum(axis=1).mean())
            + self._components.variance
        )
        ratio, square = self._ratio(1.0, over_baseline=True), float(vector @ vector)
        along = 2.0 * tall_product(drawn, self._components.shapes @ vector)
        squares = np.square(drawn).sum(axis=1)
        lengths = square - along + squares - expected
        return np.asarray(np.sign(lengths) * np.sqrt(np.abs(lengths)) * ratio)


def band_errors(band: Band, baseline: Baseline | None) -> BandErrors:
    """Return the errors of deviations from a band.

    Args:
        band: The band.
        baseline: Published score of the real trials; None without one.
    """
    published = (
        None if baseline is None or not baseline.std else baseline.std / baseline.mean
    )
    return _band_errors(band, published)


@lru_cache(maxsize=64)
def _band_errors(band: Band, baseline_spread: float | None) -> BandErrors:
    """Return the errors; `baseline_spread` is the relative standard deviation of the published score of trials."""
    known = np.isfinite(band.mean)
    shapes = ErrorShapes([], [], [])
    trials = band.trials if band.grade is BandGrade.TRIALS else None
    trial_count = 0
    influence = np.zeros(0)
    bias = 1.0
    if trials is not None and len(trials) > 1:
        trial_count = len(trials)
        influence = add_trials(band, trials, shapes)
        baseline = baseline_draws(influence)
        bias = math.sqrt((trial_count - 1) / trial_count)
    else:
        baseline = add_spread(band, baseline_spread, shapes)
    add_measurement(band, shapes)
    return BandErrors(
        known=known,
        shapes=np.concatenate(shapes.shapes) * known.ravel() / _root_of_frames(known),
        factors=tuple(shapes.factors),
        baseline=baseline,
        baseline_bias=bias,
        sources=tuple(shapes.sources),
        trial_count=trial_count,
        influence=influence,
    )


def _root_of_frames(known: BoolArray) -> float:
    """Return the square root of the number of frames with a mean."""
    return math.sqrt(max(int(known.any(axis=1).sum()), 1))
