"""Simulated realities whose true scores are known: slides and drops, whose trials scatter, and three engines each."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from gauge_envs.scoring.deviation import (
    LEAST_OVERLAP,
    SHIFT_STEP_S,
    percentile_interval,
)
from gauge_envs.scoring.uncertainty import BandErrors, band_errors
from numpy.typing import NDArray

from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.metrics import MAX_TIME_OFFSET_S

FloatArray = NDArray[np.float64]
Scatter = Callable[[np.random.Generator, int, int], FloatArray]
"""Random numbers of mean 0 and variance 1 of shape [reality_count, trial_count], from these two counts."""

GRAVITY = 9.80665
SLOPE = math.radians(30.0)
POPULATION = 100_000
"""Trials that stand for infinitely many."""
OFFSET_STEP_S = 1.0 / 600.0
"""Step of the grid of time shifts of an engine [s]; the best one is refined by a parabola."""


# --- how trials scatter ---


def normal(random: np.random.Generator, realities: int, trials: int) -> FloatArray:
    return random.standard_normal((realities, trials))


def skewed(
    random: np.random.Generator, realities: int, trials: int, *, shape: float
) -> FloatArray:
    """Gamma law; its skewness is 2 over the root of the shape, 2 for the exponential law."""
    return (random.gamma(shape, size=(realities, trials)) - shape) / math.sqrt(shape)


def outliers(
    random: np.random.Generator, realities: int, trials: int, *, size: float
) -> FloatArray:
    """One trial in twenty is off by a number of standard deviations of the others, always to the same side."""
    is_off = random.random((realities, trials)) < 0.05
    values = random.standard_normal((realities, trials)) + size * is_off - 0.05 * size
    return values / math.sqrt(1.0 + 0.0475 * size**2)


def consecutive(
    random: np.random.Generator, realities: int, trials: int, *, correlation: float
) -> FloatArray:
    """Each trial is correlated with the one before it."""
    values = random.standard_normal((realities, trials))
    for trial in range(1, trials):
        values[:, trial] *= math.sqrt(1.0 - correlation**2)
        values[:, trial] += correlation * values[:, trial - 1]
    return values


# --- motions ---


@dataclass(frozen=True, kw_only=True)
class Slide:
    """A Coulomb slide; its constant is the friction, and trials start in the same place."""

    constant: float = 0.257
    constant_std: float = 0.008
    start_std_mm: float = 0.0
    release_s: float = 0.06
    release_std_s: float = 0.03
    frame_count: int = 19

    def positions_mm(
        self, constant: FloatArray, release_s: FloatArray, start_mm: FloatArray
    ) -> FloatArray:
        """Return downhill positions [mm], shape [..., frame_count], of arrays of one shape."""
        times_s = np.arange(self.frame_count) / FRAME_RATE_HZ
        acceleration = GRAVITY * (math.sin(SLOPE) - constant * math.cos(SLOPE))
        since_s = np.maximum(times_s - release_s[..., None], 0.0)
        return np.asarray(
            start_mm[..., None] + 500.0 * acceleration[..., None] * since_s**2
        )


@dataclass(frozen=True, kw_only=True)
class Drop:
    """A ball that falls and bounces; its constant is the restitution."""

    constant: float = 0.737
    constant_std: float = 0.004
    start_std_mm: float = 1.0
    release_s: float = 0.04
    release_std_s: float = 0.012
    frame_count: int = 66

    def positions_mm(
        self, constant: FloatArray, release_s: FloatArray, start_mm: FloatArray
    ) -> FloatArray:
        """Return heights [mm], shape [..., frame_count], of arrays of one shape; `start_mm` is added to 406 mm."""
        times_s = np.arange(self.frame_count) / FRAME_RATE_HZ
        since_s = np.maximum(times_s - release_s[..., None], 0.0)
        height_m = 0.406 + 1e-3 * start_mm[..., None]
        speed = np.sqrt(2.0 * GRAVITY * height_m)
        heights = height_m - 0.5 * GRAVITY * since_s**2
        left_s = since_s - speed / GRAVITY
        for _ in range(12):
            speed = speed * constant[..., None]
            heights = np.where(
                left_s > 0.0, speed * left_s - 0.5 * GRAVITY * left_s**2, heights
            )
            left_s = left_s - 2.0 * speed / GRAVITY
        return np.asarray(1e3 * np.where(left_s > 0.0, 0.0, heights))


@dataclass(frozen=True, kw_only=True)
class World:
    """How trials scatter, and three engines.

    Attributes:
        motion: What moves.
        release: Scatter of the release time.
        constant: Scatter of the constant.
        engine_errors: Error of the constant of each engine.
    """

    motion: Slide | Drop
    release: Scatter = normal
    constant: Scatter = normal
    engine_errors: tuple[float, float, float] = (0.03, -0.02, 0.0)

    def trials(
        self, random: np.random.Generator, realities: int, count: int
    ) -> FloatArray:
        """Return trials [mm], shape [realities, count, frame_count]."""
        motion = self.motion
        constant = motion.constant + motion.constant_std * self.constant(
            random, realities, count
        )
        release_s = motion.release_s + motion.release_std_s * self.release(
            random, realities, count
        )
        start_mm = motion.start_std_mm * random.standard_normal((realities, count))
        return motion.positions_mm(constant, release_s, start_mm)

    def engine(self, number: int, shift_s: FloatArray) -> FloatArray:
        """Return the motion of an engine [mm] after a shift in time, shape [..., frame_count]."""
        constant = np.full(
            np.shape(shift_s), self.motion.constant + self.engine_errors[number]
        )
        return self.motion.positions_mm(constant, shift_s, np.zeros(np.shape(shift_s)))

    @cached_property
    def truth(self) -> Truth:
        """True scores."""
        population = self.trials(np.random.default_rng(12345), POPULATION, 1)[:, 0]
        mean = population.mean(axis=0)
        engines = range(len(self.engine_errors))
        raw = [float(rms(self.engine(one, np.zeros(())) - mean)) for one in engines]
        aligned = [float(rms(align(self, one, mean[None])[0][0])) for one in engines]
        distances = (
            rms(population - mean),
            aligned_distances(population[:10_000], mean[None]),
        )
        return Truth(
            mm={"raw": raw, "aligned": aligned},
            distances={"raw": np.sort(distances[0]), "aligned": np.sort(distances[1])},
        )


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Against infinitely many trials, `raw` and `aligned`.

    Attributes:
        mm: Distance of each engine [mm].
        distances: Distances of trials [mm], ascending.
    """

    mm: dict[str, list[float]]
    distances: dict[str, FloatArray]

    def ratio(self, kind: str, engine: int) -> float:
        """Return the true ratio of an engine."""
        return self.mm[kind][engine] / float(self.distances[kind].mean())

    def percentile(self, kind: str, engine: int) -> float:
        """Return the percentage of all trials that are closer than an engine."""
        values = self.distances[kind]
        return (
            100.0 * float(np.searchsorted(values, self.mm[kind][engine])) / len(values)
        )


def rms(deviations: FloatArray) -> FloatArray:
    """Return the root mean square over frames, the last axis."""
    return np.asarray(np.sqrt(np.mean(np.square(deviations), axis=-1)))


def align(
    world: World, engine: int, means: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the deviation of an engine that is shifted in time to fit best, its velocity [mm/s], and the shift [s].

    Args:
        world: The world.
        engine: Number of the engine.
        means: Means of trials, shape [reality_count, frame_count].

    Returns:
        Two of the shape of `means`, and one of shape [reality_count].
    """
    grid_s = np.arange(-MAX_TIME_OFFSET_S, MAX_TIME_OFFSET_S + 1e-9, OFFSET_STEP_S)
    moved = world.engine(engine, grid_s)
    squares = np.square(moved).sum(axis=1) - 2.0 * means @ moved.T
    best = np.clip(squares.argmin(axis=1), 1, len(grid_s) - 2)
    rows = np.arange(len(means))
    before, here, after = (squares[rows, best + side] for side in (-1, 0, 1))
    shift_s = grid_s[best] + 0.5 * OFFSET_STEP_S * (before - after) / (
        before - 2.0 * here + after
    )
    velocity = (
        world.engine(engine, shift_s - 5e-4) - world.engine(engine, shift_s + 5e-4)
    ) / 1e-3
    return world.engine(engine, shift_s) - means, velocity, shift_s


def aligned_distances(trials: FloatArray, means: FloatArray) -> FloatArray:
    """Return the distance of each trial after the time shift that fits best, as `deviation.trial_distances` does.

    Args:
        trials: Trials, shape [count, frame_count].
        means: Mean that each is compared with, shape [count or 1, frame_count].
    """
    coarse = round(MAX_TIME_OFFSET_S / SHIFT_STEP_S)
    best, found = np.zeros(len(trials)), np.full(len(trials), np.inf)
    for step in range(-coarse, coarse + 1):
        distance = _shifted_distance(
            trials, means, np.full(len(trials), step * SHIFT_STEP_S)
        )
        better = distance < found
        best[better], found[better] = step * SHIFT_STEP_S, distance[better]
    for fine in np.linspace(-SHIFT_STEP_S, SHIFT_STEP_S, 17)[1:-1]:
        found = np.minimum(found, _shifted_distance(trials, means, best + fine))
    return found


def _shifted_distance(
    trials: FloatArray, means: FloatArray, shift_s: FloatArray
) -> FloatArray:
    count = trials.shape[1]
    frames = np.arange(count) - shift_s[:, None] * FRAME_RATE_HZ
    usable = frames <= count - 1 + 1e-6
    left = np.clip(np.floor(frames).astype(int), 0, count - 2)
    weight = np.clip(frames - left, 0.0, 1.0)
    rows = np.arange(len(trials))[:, None]
    shifted = (1.0 - weight) * trials[rows, left] + weight * trials[rows, left + 1]
    squares = np.where(usable, np.square(shifted - means), 0.0).sum(axis=1)
    frame_count = usable.sum(axis=1)
    distances = np.sqrt(squares / np.maximum(frame_count, 1))
    return np.where(frame_count >= LEAST_OVERLAP * count, distances, np.inf)


def leave_one_out(trials: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the raw and aligned distance of each trial from the mean of the others, shape [realities, count].

    Args:
        trials: Trials, shape [realities, count, frame_count].
    """
    count = trials.shape[1]
    others = (trials.sum(axis=1, keepdims=True) - trials) / (count - 1)
    flat, means = (one.reshape(-1, trials.shape[2]) for one in (trials, others))
    return rms(trials - others), aligned_distances(flat, means).reshape(
        trials.shape[:2]
    )


def band_of(trials: FloatArray) -> Band:
    """Return the band of trials of shape [count, frame_count]."""
    values = trials[:, :, None]
    return Band(
        grade=Kind.TRIALS,
        unit="mm",
        coordinates=("x",),
        projection=np.eye(1),
        mean=values.mean(axis=0),
        sigma=values.std(axis=0, ddof=1),
        measured=np.ones(trials.shape[1], dtype=bool),
        trial_count=len(trials),
        source="simulated",
        trials=values,
    )


HELD, MISSED, REFUSED = "held", "missed", "refused"


WORLDS = {
    "slide, 5 % outliers": World(
        motion=Slide(),
        release=partial(outliers, size=5.0),
        constant=partial(outliers, size=5.0),
    ),
    "drop, skewed release": World(
        motion=Drop(),
        release=partial(skewed, shape=4.0),
        engine_errors=(-0.03, 0.02, 0.0),
    ),
    "drop, release correlated 0.4": World(
        motion=Drop(),
        release=partial(consecutive, correlation=0.4),
        engine_errors=(-0.03, 0.02, 0.0),
    ),
}


def aligned_errors(
    world: World,
    engine: int,
    errors: BandErrors,
    velocities: FloatArray,
    shifts_s: FloatArray,
    one: int,
) -> BandErrors:
    """Return the errors of one reality after the alignment of an engine, from velocities and shifts of all."""
    return errors.aligned(
        velocities[one][:, None],
        lambda late_s: world.engine(engine, shifts_s[one] + late_s)[..., None],
    )


def intervals(
    world: World, trials: FloatArray
) -> Iterator[tuple[str, tuple[float, float] | None, float]]:
    """Yield quantity, interval and truth of each engine's scores in a reality.

    Args:
        world: The world.
        trials: Trials of the reality [mm], shape [count, frame_count].
    """
    mean = trials.mean(axis=0)
    others = dict(zip(("raw", "aligned"), leave_one_out(trials[None]), strict=True))
    baselines = {
        "raw": float(rms(trials - mean).mean()),
        "aligned": float(others["aligned"][0].mean()),
    }
    band = band_errors(band_of(trials), None)
    for engine in range(len(world.engine_errors)):
        deviation, velocities, shifts_s = align(world, engine, mean[None])
        found = {
            "raw": (world.engine(engine, np.zeros(())) - mean, band),
            "aligned": (
                deviation[0],
                aligned_errors(
                    world, engine, band, velocities, shifts_s, 0
                ).with_baseline(others["aligned"][0]),
            ),
        }
        for kind, (apart, errors) in found.items():
            apart = apart[:, None]
            mm = errors.interval(apart, over_baseline=False)
            ends = errors.interval(apart)
            ratio = ends and (ends[0] / baselines[kind], ends[1] / baselines[kind])
            size = float(np.linalg.norm(errors.flat(apart)))
            yield f"{kind} mm", mm, world.truth.mm[kind][engine]
            yield f"{kind} ratio", ratio, world.truth.ratio(kind, engine)
            yield (
                f"{kind} percentile",
                percentile_interval(others[kind][0], size, mm),
                world.truth.percentile(kind, engine),
            )


def held_percent(
    name: str, count: int, *, realities: int, seed: int
) -> dict[str, float]:
    """Return the percentage of intervals that hold the truth in a world, by quantity."""
    world = WORLDS[name]
    held = defaultdict(list)
    for trials in world.trials(np.random.default_rng([seed, count]), realities, count):
        for quantity, interval, truth in intervals(world, trials):
            if interval is not None and np.isfinite(interval).all():
                held[quantity].append(interval[0] <= truth <= interval[1])
    return {quantity: 100.0 * float(np.mean(found)) for quantity, found in held.items()}
