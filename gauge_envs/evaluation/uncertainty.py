"""Uncertainty of a score, after the Guide to the Expression of Uncertainty in Measurement (GUM) and its Supplement 1.

Measurement model. A score is S = |g - r| / B: g is the simulated trajectory, r the mean of the real trials, B the mean
score of the real trials, and |.| the root mean square over frames. The observed deviation d = g - r differs from the
true one by an error e, a sum of contributions. Each has a shape over frames and coordinates, and a random factor:

- `sampling`: r and B are from a sample of trials. They are resampled together, so that their errors are correlated.
- `release`: the part of the sampling that shifts the mean in time, because trials are released at different times.
- `constant`, `start`, `tilt`: inputs of the simulation, by `references.sensitivities`.
- `discretization`: half the time step, half the cell.
- `extrapolation`: frames of r that no trial shows.
- `measurement`: the uncertainty of the measured mean, where it is stated.
- `projection`: motion across the measured coordinates, which a small error of their direction mixes in.

Interval. With a unit vector u, a true distance L would have been observed as |L u + e|. For each draw of e, the L that
gives the observed distance is the root of a quadratic; u is drawn too, as the direction of d plus another draw of e.
The 95 % interval is between percentiles of these roots. This inverts the test of each L (Neyman), so it does not count
the error of the mean twice, as adding e to d would. The upper percentile is divided by the share of draws that have a
root (CLs), so that a distance below its own errors gives no empty interval. The mean of a law is not observed; there e
is added to d. `tests/evaluation/test_coverage.py` measures the coverage. Over several worlds and seeds, 500 repeats
each, it was 92 to 97 % for a distance above its errors, 94 % pooled, and 98 to 99 % for one below.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from gauge_envs.references.bands import Band, BandGrade
from gauge_envs.references.published import Baseline
from gauge_envs.references.sensitivities import Sensitivities, input_uncertainties

FloatArray = NDArray[np.float64]

DRAW_COUNT = 4000
"""Number of random draws; it gives the ends of an interval to about 2 % of its width."""

LEVEL = 0.95
"""Coverage of an interval."""

BELOW_NOISE = 0.01
"""Share of draws below which an observed distance counts as smaller than its own errors."""

SEED = 20_260_711
"""Seed of the draws. It is fixed, so that scores repeat and engines are compared on the same draws."""

LEAST_RESAMPLED = 8
"""Number of trials from which their mean score is resampled."""

SIMULATION_KINDS = ("constant", "start", "tilt", "discretization", "projection")
"""Kinds of contributions that belong to the simulation; the others belong to the mean of the trials."""

PATH_NUMBERS = 2_000_000
"""Largest count of numbers in the draws of a warping path."""

PROJECTION_FLOOR_MM = 1.0
"""Motion across the measured coordinates below which their direction does not matter: 0.3 degrees of it is 5 um."""


def _reported(value: float) -> float:
    """Return six significant digits: the last bits of a matrix product depend on the memory that holds it."""
    return float(f"{value:.6g}")


@dataclass(frozen=True, kw_only=True)
class BudgetEntry:
    """One line of an uncertainty budget.

    Attributes:
        name: Name of the contribution.
        kind: Kind, as in the module's list; `baseline` is the mean score of the real trials.
        evaluation: `A`, by statistics of observations, or `B`, by other knowledge (GUM 4.2, 4.3).
        standard_uncertainty: Effect on the normalized score for one standard uncertainty.
        share: Share of the variance.
        source: Origin of the number.
    """

    name: str
    kind: str
    evaluation: str
    standard_uncertainty: float
    share: float
    source: str


@dataclass(frozen=True, kw_only=True)
class _Source:
    """A group of error shapes with one origin; `columns` selects them."""

    name: str
    kind: str
    evaluation: str
    source: str
    columns: slice


@dataclass(frozen=True, eq=False, kw_only=True)
class BandErrors:
    """Errors of the deviation between a simulation and a band, as shapes with random factors.

    Frames without a mean are left out, and shapes are divided by the square root of the number of frames, so that a
    norm is a root mean square over frames.

    Attributes:
        known: Entries of the mean that are compared, shape [T, C].
        shapes: Error shapes, shape [shape_count, entry_count].
        factors: Random factors of the shapes, shape [draw_count, shape_count].
        baseline_ratio: Baseline of each draw over the baseline, shape [draw_count].
        baseline_source: Origin of that ratio.
        sources: Origin of each group of shapes.
        is_observed: Whether the mean was observed; the mean of a law was not.
    """

    known: NDArray[np.bool_]
    shapes: FloatArray
    factors: FloatArray
    baseline_ratio: FloatArray
    baseline_source: str
    sources: tuple[_Source, ...]
    is_observed: bool

    def flat(self, deviation: FloatArray) -> FloatArray:
        """Return a deviation of shape [T, C] as a vector whose norm is its root mean square over frames."""
        return np.asarray(np.where(self.known, deviation, 0.0).ravel() / _root_of_frames(self.known))

    def aligned(self, velocity: FloatArray) -> BandErrors:
        """Return the errors that a shift in time leaves, to first order.

        Args:
            velocity: Velocity of the shifted simulation at the frames, shape [T, C], any scale.
        """
        direction = self.flat(velocity)
        size = float(direction @ direction)
        if size == 0.0:
            return self
        return replace(self, shapes=self.shapes - np.outer(self.shapes @ direction, direction) / size)

    def with_baseline(self, distances: FloatArray) -> BandErrors:
        """Return the errors with the mean distance of other trials as the baseline.

        Args:
            distances: Distance of each trial, shape [trial_count].
        """
        count, mean = len(distances), float(distances.mean())
        if count >= LEAST_RESAMPLED:
            ratio = _weights(count) @ distances / mean
            return replace(self, baseline_ratio=ratio, baseline_source=f"bootstrap over {count} trials")
        relative = float(distances.std(ddof=1)) / mean / math.sqrt(count) if count > 1 else 0.0
        source = f"standard deviation over the root of {count} trials"
        return replace(self, baseline_ratio=_baseline_ratio(relative), baseline_source=source)

    def redrawn(self, kind: str, stream: str) -> BandErrors:
        """Return the errors with other random factors for one kind, which two simulations do not share.

        Args:
            kind: Kind of the sources, as `discretization`.
            stream: Name of the simulation; each name has its own random numbers.
        """
        factors = self.factors.copy()
        for source in self.sources:
            if source.kind == kind:
                shape = factors[:, source.columns].shape
                factors[:, source.columns] = _random(f"{source.name}: {stream}").standard_normal(shape)
        return replace(self, factors=factors)

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
        across = np.linalg.norm(moved - moved @ np.linalg.pinv(band.projection) @ band.projection, axis=1)
        tilt = input_uncertainties().tilt
        if np.abs(across).max() < PROJECTION_FLOOR_MM:
            return self
        shape = self.flat(math.radians(tilt.std) * across[:, None] * np.ones(len(band.projection)))
        start = len(self.shapes)
        source = _Source(
            name="direction of the measured coordinate",
            kind="projection",
            evaluation="B",
            source=f"{tilt.std:.4g} {tilt.unit}: {tilt.source}",
            columns=slice(start, start + 1),
        )
        factors = _random("projection").standard_normal((DRAW_COUNT, 1))
        return replace(
            self,
            shapes=np.vstack([self.shapes, shape]),
            factors=np.hstack([self.factors, factors]),
            sources=(*self.sources, source),
        )

    def _moments(self, vector: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return |d|, and for each draw e . u and |e|^2."""
        size = float(np.linalg.norm(vector))
        unit = vector / size if size > 0.0 else vector
        along = self.factors @ (self.shapes @ unit)
        squares = np.einsum("ks,ks->k", self.factors @ (self.shapes @ self.shapes.T), self.factors)
        return size, along, np.maximum(squares, np.square(along))

    def interval(self, deviation: FloatArray, *, over_baseline: bool = True) -> tuple[float, float]:
        """Return the 95 % interval of a root-mean-square distance, in the unit of the deviation.

        Args:
            deviation: Simulation minus mean, shape [T, C].
            over_baseline: Whether the interval is that of the ratio to the baseline, times the baseline; else it is of
                the distance alone.
        """
        if not over_baseline:
            return replace(self, baseline_ratio=np.ones(DRAW_COUNT)).interval(deviation)
        vector = self.flat(deviation)
        size = float(np.linalg.norm(vector))
        low, high = self._interval(vector)
        return min(_reported(low), size), max(_reported(high), size)

    def _interval(self, vector: FloatArray) -> tuple[float, float]:
        tail = 0.5 * (1.0 - LEVEL)
        if not self.is_observed:
            low, high = np.quantile(self._added(vector), [tail, 1.0 - tail])
            # The law itself is one of the possible truths.
            return min(float(low), float(np.linalg.norm(vector))), float(high)
        size, along, squares = self._moments(vector)
        # The direction of the true deviation is not that of the observed one: it has its own errors.
        gram = self.shapes @ self.shapes.T
        others = np.roll(self.factors, 1, axis=0)
        lengths = np.sqrt(np.maximum(size**2 + 2.0 * size * along + squares, 1e-300))
        products = np.einsum("ks,ks->k", self.factors @ gram, others)
        along = (size * np.roll(along, 1) + products) / lengths
        squares = np.roll(squares, 1)
        observed = np.square(size * self.baseline_ratio)
        excess = np.square(along) - squares + observed
        roots = np.where(excess >= 0.0, -along + np.sqrt(np.maximum(excess, 0.0)), -np.inf)
        reached = float(np.mean(squares <= observed))
        if reached < BELOW_NOISE:
            return 0.0, float(np.quantile(self._added(vector), LEVEL))
        low = max(float(np.quantile(roots, tail, method="lower")), 0.0)
        high = float(np.quantile(roots, 1.0 - tail * reached, method="higher"))
        return min(low, size), max(high, size)

    def path_interval(self, path: NDArray[np.intp], simulated: FloatArray, mean: FloatArray) -> tuple[float, float]:
        """Return the 95 % interval of a mean distance along a warping path, in the unit of the band.

        To first order an error does not change the best path. The errors of a cell are those of the simulation at its
        one frame and those of the mean at its other frame.

        Args:
            path: Frames (simulated, real) of the cells, shape [cell_count, 2].
            simulated: Band coordinates of the simulation, shape [T, C].
            mean: Mean of the real trials, shape [T, C].
        """
        shapes = (self.shapes * _root_of_frames(self.known)).reshape(-1, *self.known.shape)
        of_simulation = np.zeros(len(shapes), dtype=bool)
        for source in self.sources:
            of_simulation[source.columns] = source.kind in SIMULATION_KINDS
        frames = np.where(of_simulation[:, None], path[:, 0], path[:, 1])
        errors = shapes[np.arange(len(shapes))[:, None], frames].reshape(len(shapes), -1)
        difference = np.nan_to_num(simulated[path[:, 0]] - mean[path[:, 1]])
        count = max(min(len(self.factors), PATH_NUMBERS // difference.size), 100)
        cells = (self.factors[:count] @ errors).reshape(count, *difference.shape) + difference
        distances = np.linalg.norm(cells, axis=2).mean(axis=1) / self.baseline_ratio[:count]
        observed = float(np.linalg.norm(difference, axis=1).mean())
        half = float(stdtrit(1e9, 0.5 * (1.0 + LEVEL)) * distances.std(ddof=1))
        return _reported(max(observed - half, 0.0)), _reported(observed + half)

    def draws(self, deviation: FloatArray) -> FloatArray:
        """Return the normalized distance of each draw times the baseline, shape [draw_count].

        Two simulations that are compared on one band have the same draws of its mean, baseline and inputs.

        Args:
            deviation: Simulation minus mean, shape [T, C].
        """
        return self._added(self.flat(deviation))

    def _added(self, vector: FloatArray) -> FloatArray:
        size, along, squares = self._moments(vector)
        return np.asarray(np.sqrt(np.maximum(size**2 + 2.0 * size * along + squares, 0.0)) / self.baseline_ratio)

    def budget(self, deviation: FloatArray, *, baseline: float) -> tuple[BudgetEntry, ...]:
        """Return the contributions to the uncertainty of a normalized score, largest first.

        Each is the standard deviation along the observed deviation. Of a law, whose deviation is often zero, it is the
        root mean square over all directions.

        Args:
            deviation: Simulation minus mean, shape [T, C].
            baseline: Baseline that normalizes, in the unit of the deviation.
        """
        vector = self.flat(deviation)
        size = float(np.linalg.norm(vector))
        stds: list[tuple[_Source, float]] = []
        for source in self.sources:
            factors, shapes = self.factors[:, source.columns], self.shapes[source.columns]
            if size > 0.0 and self.is_observed:
                std = float(np.std(factors @ (shapes @ (vector / size))))
            else:
                std = float(np.sqrt(np.mean(np.square(factors @ shapes).sum(axis=1))))
            stds.append((source, std / baseline))
        own = _Source(
            name="baseline", kind="baseline", evaluation="A", source=self.baseline_source, columns=slice(0, 0)
        )
        stds.append((own, float(np.std(1.0 / self.baseline_ratio)) * size / baseline))
        total = sum(std**2 for _, std in stds)
        entries = [
            BudgetEntry(
                name=one.name,
                kind=one.kind,
                evaluation=one.evaluation,
                standard_uncertainty=_reported(std),
                share=_reported(std**2 / total) if total > 0.0 else 0.0,
                source=one.source,
            )
            for one, std in stds
        ]
        return tuple(sorted(entries, key=lambda entry: -entry.share))


@dataclass
class _Shapes:
    """Error shapes under construction."""

    shapes: list[FloatArray]
    factors: list[FloatArray]
    sources: list[_Source]

    def add(
        self, name: str, kind: str, evaluation: str, source: str, shapes: Sequence[FloatArray], factors: FloatArray
    ) -> None:
        start = sum(len(one) for one in self.shapes)
        kept = np.array([np.nan_to_num(shape) for shape in shapes])
        self.shapes.append(kept.reshape(len(kept), -1))
        self.factors.append(factors)
        columns = slice(start, start + len(kept))
        self.sources.append(_Source(name=name, kind=kind, evaluation=evaluation, source=source, columns=columns))


def band_errors(band: Band, baseline: Baseline | None, sensitivities: Sensitivities | None) -> BandErrors:
    """Return the errors of deviations from a band.

    Args:
        band: The band.
        baseline: Published score of the real trials; None without one.
        sensitivities: Uncertain inputs of the simulation; None leaves them out.
    """
    published = None if baseline is None or not baseline.std else baseline.std / baseline.mean
    return _band_errors(band, published, sensitivities)


@lru_cache(maxsize=64)
def _band_errors(band: Band, baseline_spread: float | None, sensitivities: Sensitivities | None) -> BandErrors:
    """Return the errors; `baseline_spread` is the relative standard deviation of the published score of trials."""
    known, shapes = np.isfinite(band.mean), _Shapes([], [], [])
    ratio, baseline_source = _sampling(band, baseline_spread, shapes)
    _measurement(band, shapes)
    if sensitivities is not None:
        _inputs(band, sensitivities, shapes)
    return BandErrors(
        known=known,
        shapes=np.concatenate(shapes.shapes) * known.ravel() / _root_of_frames(known),
        factors=np.concatenate(shapes.factors, axis=1),
        baseline_ratio=ratio,
        baseline_source=baseline_source,
        sources=tuple(shapes.sources),
        is_observed=band.grade is not BandGrade.LAW,
    )


def _root_of_frames(known: NDArray[np.bool_]) -> float:
    """Return the square root of the number of frames with a mean."""
    return math.sqrt(max(int(known.any(axis=1).sum()), 1))


def _random(name: str) -> np.random.Generator:
    """Return the random numbers of one contribution; the same name gives the same numbers on every engine."""
    return np.random.default_rng([SEED, *name.encode()])


def _sampling(band: Band, baseline_spread: float | None, shapes: _Shapes) -> tuple[FloatArray, str]:
    """Add the errors of the mean that follow from the number of trials; return the baseline's ratio and its source."""
    if band.grade is BandGrade.TRIALS and band.trials is not None and len(band.trials) > 1:
        return _resampled(band, band.trials, shapes)
    trial_count = input_uncertainties().trials.count
    shared = 1 if band.grade is BandGrade.RECORDING else band.trial_count or trial_count
    known = "one trial" if shared == 1 else f"{shared} trials"
    columns = [
        np.eye(band.mean.shape[1])[column] * band.sigma / math.sqrt(shared) for column in range(band.mean.shape[1])
    ]
    shapes.add(
        "mean of the trials",
        "sampling",
        "B",
        f"scatter of the trials over the root of their number ({known}), taken as constant in time",
        columns,
        _random("sampling").standard_normal((DRAW_COUNT, len(columns))),
    )
    if baseline_spread is None:
        return np.ones(DRAW_COUNT), "not published"
    count = band.trial_count or trial_count
    ratio = _baseline_ratio(baseline_spread / math.sqrt(count))
    return ratio, f"published standard deviation over the root of {count}"


def _baseline_ratio(relative: float) -> FloatArray:
    """Return draws of the baseline over the baseline, with a relative standard uncertainty."""
    return np.maximum(1.0 + relative * _random("baseline").standard_normal(DRAW_COUNT), 0.1)


def _weights(count: int) -> FloatArray:
    """Return the weights of trials that are drawn with replacement, the same for the mean and each baseline."""
    return np.asarray(_random("sampling").multinomial(count, np.full(count, 1.0 / count), DRAW_COUNT) / count)


def _resampled(band: Band, trials: FloatArray, shapes: _Shapes) -> tuple[FloatArray, str]:
    """Add the bootstrap of trials, in two parts: the shift of the mean in time, and the rest."""
    count = len(trials)
    residuals = np.nan_to_num(trials - band.mean).reshape(count, -1)
    weights = _weights(count)
    # A bootstrap has the variance of n instead of n - 1, and the tails of a normal instead of Student's distribution.
    tail = 0.5 * (1.0 + LEVEL)
    wider = math.sqrt(count / (count - 1)) * float(stdtrit(count - 1, tail) / stdtrit(1e9, tail))
    factors = wider * (weights - 1.0 / count)
    velocity = np.nan_to_num(np.gradient(np.nan_to_num(band.mean), axis=0) * np.isfinite(band.mean)).ravel()
    size = float(velocity @ velocity)
    shift = np.outer(residuals @ velocity, velocity) / size if size > 0.0 else np.zeros_like(residuals)
    source = f"bootstrap over {count} trials"
    # The mean is subtracted, so an error of the mean enters with the other sign.
    shapes.add("release time of the mean", "release", "A", source, list(-shift), factors)
    shapes.add("mean of the trials", "sampling", "A", source, list(shift - residuals), factors)
    if count < LEAST_RESAMPLED:
        # A resample of so few may hold one of them alone.
        distances = np.linalg.norm(residuals, axis=1)
        mean = float(distances.mean())
        relative = float(distances.std(ddof=1)) / mean / math.sqrt(count) if mean > 0.0 else 0.0
        return _baseline_ratio(relative), f"standard deviation over the root of {count} trials"
    gram = residuals @ residuals.T
    own = np.einsum("kj,kj->k", weights @ gram, weights)
    squares = np.maximum(np.diag(gram) - 2.0 * weights @ gram + own[:, None], 0.0)
    baselines = np.einsum("kj,kj->k", weights, np.sqrt(squares))
    # Trials are closer to their own mean than to the true one.
    ratio = math.sqrt((count - 1) / count) * baselines / baselines.mean()
    return ratio, f"{source}, the same as for the mean"


def _measurement(band: Band, shapes: _Shapes) -> None:
    if band.uncertainty is None:
        return
    for name, kind, frames in (
        ("measured frames", "measurement", band.measured),
        ("extrapolated frames", "extrapolation", ~band.measured),
    ):
        spread = np.where(frames[:, None] & np.isfinite(band.uncertainty), band.uncertainty, 0.0)
        if spread.any():
            columns = [unit * spread for unit in np.eye(spread.shape[1])]
            factors = _random(kind).standard_normal((DRAW_COUNT, len(columns)))
            shapes.add(name, kind, "B", "uncertainty of the mean in the band's table", columns, factors)


def _inputs(band: Band, sensitivities: Sensitivities, shapes: _Shapes) -> None:
    for one in sensitivities.inputs:
        if len(one.change) < len(band.mean) or one.change.shape[1] != band.projection.shape[1]:
            continue
        # A law keeps the body where it starts, so another start moves simulation and mean alike.
        if band.grade is BandGrade.LAW and one.kind == "start":
            continue
        change = band.project(one.change[: len(band.mean)])
        if np.abs(change).max() > 0.0:
            factors = _random(one.name).standard_normal((DRAW_COUNT, 1))
            shapes.add(one.name, one.kind, "B", f"{one.std:.4g} {one.unit}: {one.source}", [change], factors)
