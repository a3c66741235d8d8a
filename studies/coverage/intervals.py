"""How often the intervals of scores hold the truth, in worlds resampled from real trials and in own worlds.

    python studies/coverage/intervals.py --worlds 400 --seed 2

In a resampled world, the trials of an id are all trials that exist, and a score sees N of them, drawn with replacement.
In an own world, slides differ by their release, their acceleration, a drift, each with a constant of the shape, and
noise. The true distance is that from the mean of all trials; the true mean distance of trials is that of many worlds.

The instrument and the tilt have no error here, so `uncertainty` of the bands is left out.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from gauge_envs import load_experiment, reference_band
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from gauge_envs.scoring.exact import exact_motion
from gauge_envs.scoring.interval import (
    COVERAGE_FACTOR,
    distances_without,
    jackknife_interval,
    prediction_limit,
    student_limit,
    student_t,
    trials_interval,
)
from gauge_envs.scoring.metrics import MAX_TIME_OFFSET_S, MIN_OVERLAP, shifted_frames
from gauge_envs.tools.compare.statistics import (
    Deviations,
    difference_interval,
    without_shift,
)

REAL = (
    "SlopeSlider-2-wood",
    "SlopeSlider-2-plastic",
    "SlopeSlider-2-metal",
    "BouncingBall-rubber",
)
"""Ids with single trials and a release."""

FACTORS = (0.0, 0.5, 2.0, 8.0)
"""Distances of the motions in own worlds, over the mean distance of a trial, before the time shift."""

FRAMES = 19
"""Frames of a slide in an own world."""

BASELINE_WORLDS = 800
"""Worlds that give the true mean distance of trials."""

Draw = Callable[[np.random.Generator, int], FloatArray]
"""Draw constants with mean 0 and variance 1."""


def two_clusters(random: np.random.Generator, count: int) -> FloatArray:
    """Draw constants of which 15 % are 2.7 standard deviations from the others."""
    is_far = random.random(count) < 0.15
    scatter = np.sqrt(1.0 - 0.95**2) * random.standard_normal(count)
    return 0.95 * (is_far - 0.15) / np.sqrt(0.15 * 0.85) + scatter


def lognormal(random: np.random.Generator, count: int) -> FloatArray:
    """Draw constants whose logarithms have the standard deviation 0.8."""
    variance = np.expm1(0.8**2) * np.exp(0.8**2)
    drawn = random.lognormal(sigma=0.8, size=count)
    return (drawn - np.exp(0.5 * 0.8**2)) / np.sqrt(variance)


def contaminated(random: np.random.Generator, count: int) -> FloatArray:
    """Draw normal constants of which a tenth scatters three times as much."""
    scale = np.where(random.random(count) < 0.1, 3.0, 1.0)
    return scale * random.standard_normal(count) / np.sqrt(1.8)


def in_order(random: np.random.Generator, count: int) -> FloatArray:
    """Draw constants with a correlation of 0.35 from trial to trial, AR(1)."""
    drawn = random.standard_normal(count)
    for index in range(1, count):
        drawn[index] = 0.35 * drawn[index - 1] + np.sqrt(1 - 0.35**2) * drawn[index]
    return drawn


SHAPES: dict[str, Draw] = {
    "normal": lambda random, count: random.standard_normal(count),
    "lognormal": lognormal,
    "t3": lambda random, count: random.standard_t(3, count) / np.sqrt(3.0),
    "two-clusters": two_clusters,
    "ar1": in_order,
}
"""Shapes on which the interval was developed."""

UNSEEN_SHAPES: dict[str, Draw] = {
    "laplace": lambda random, count: random.laplace(size=count) / np.sqrt(2.0),
    "uniform": lambda random, count: random.uniform(-np.sqrt(3.0), np.sqrt(3.0), count),
    "gamma": lambda random, count: random.gamma(1.5, size=count) / 1.5**0.5 - 1.5**0.5,
    "contaminated": contaminated,
    "t5": lambda random, count: random.standard_t(5, count) / np.sqrt(5.0 / 3.0),
}
"""Shapes that were drawn once the interval was fixed."""


class AlignedDistances:
    """Distances of motions from weighted means of trials, after the time shift with the smallest distance.

    Between two shifts by whole samples, a shifted motion is linear in the shift, so its square is a parabola.
    """

    def __init__(self, motions: FloatArray, trials: FloatArray, rate_hz: float) -> None:
        """Prepare motions at a rate, shape [M, S, C], and trials at 30 Hz, shape [N, T, C]."""
        frame_count, per_frame = trials.shape[1], round(rate_hz / FRAME_RATE_HZ)
        step_count = round(MAX_TIME_OFFSET_S * rate_hz)
        self.starts_s = np.arange(-step_count, step_count) / rate_hz
        self.step_s = 1.0 / rate_hz
        delays = np.arange(-step_count, step_count)[:, None]
        index = per_frame * np.arange(frame_count) - delays
        seen = index < motions.shape[1]
        self.counts = seen.sum(axis=1)
        self.is_allowed = self.counts >= np.ceil(MIN_OVERLAP * frame_count)
        self._ends = [
            np.where(
                seen[..., None], motions[:, np.clip(at, 0, motions.shape[1] - 1)], 0.0
            )
            for at in (index, index - 1)
        ]
        first, second = self._ends
        self._squares = [
            np.einsum("mstc,mstc->ms", a, b)
            for a, b in ((first, first), (first, second), (second, second))
        ]
        self._products = [
            np.einsum("mstc,ntc->msn", end, trials, optimize=True) for end in self._ends
        ]
        self._of_trials = np.einsum(
            "jtc,st,ktc->sjk", trials, seen.astype(float), trials, optimize=True
        )

    def __call__(
        self, motions: IntArray, weights: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return distances and shifts [s] of motions, shape [...], from means with weights, shape [..., N]."""
        mean = np.einsum(
            "...j,sjk,...k->...s", weights, self._of_trials, weights, optimize=True
        )
        first, second = (
            np.einsum("...sn,...n->...s", products[motions], weights)
            for products in self._products
        )
        at_start = self._squares[0][motions] - 2.0 * first + mean
        between = self._squares[1][motions] - first - second + mean
        at_end = self._squares[2][motions] - 2.0 * second + mean
        curvature = np.maximum(at_start - 2.0 * between + at_end, 1e-12)
        share = np.clip((at_start - between) / curvature, 0.0, 1.0)
        squares = (1.0 - share) ** 2 * at_start + share**2 * at_end
        squares += 2.0 * share * (1.0 - share) * between
        squares = np.where(self.is_allowed, squares / self.counts, np.inf)
        best = squares.argmin(axis=-1)[..., None]
        smallest = np.take_along_axis(squares, best, -1)[..., 0]
        shares = np.take_along_axis(share, best, -1)[..., 0]
        shifts_s = self.starts_s[best[..., 0]] + self.step_s * shares
        return np.sqrt(np.maximum(smallest, 0.0)), shifts_s


@dataclass(frozen=True)
class World:
    """Trials that a score sees, shape [N, T, C], and motions of unknown distance at 180 Hz, shape [M, S, C]."""

    trials: FloatArray
    motions: FloatArray

    @cached_property
    def _of_trials(self) -> AlignedDistances:
        return AlignedDistances(self.trials, self.trials, FRAME_RATE_HZ)

    @cached_property
    def trial_distances(self) -> FloatArray:
        """Distance of each trial from the mean of the others."""
        count = len(self.trials)
        weights = (1.0 - np.eye(count)) / (count - 1)
        return self._of_trials(np.arange(count), weights)[0]

    @cached_property
    def baselines_without(self) -> FloatArray:
        """Mean distance of the trials without each of them."""
        count = len(self.trials)
        own = np.eye(count)
        weights = (1.0 - own[:, None] - own[None]) / (count - 2)
        index = np.repeat(np.arange(count)[:, None], count, axis=1)
        distances, _ = self._of_trials(index, weights)
        np.fill_diagonal(distances, 0.0)
        return distances.sum(axis=0) / (count - 1)

    def distances(self) -> tuple[FloatArray, FloatArray]:
        """Return distances and shifts of the motions."""
        rate_hz = FRAME_RATE_HZ * SAMPLES_PER_FRAME
        aligned = AlignedDistances(self.motions, self.trials, rate_hz)
        equal = np.full((len(self.motions), len(self.trials)), 1.0 / len(self.trials))
        return aligned(np.arange(len(self.motions)), equal)

    def aligned_frames(self) -> Iterator[tuple[FloatArray, FloatArray | None]]:
        """Yield each motion at the frames after its time shift, and its velocity, None for a shift at the bound."""
        frame_count = self.trials.shape[1]
        times_s = np.arange(self.motions.shape[1]) / FRAME_RATE_HZ / SAMPLES_PER_FRAME
        for motion, shift_s in zip(self.motions, self.distances()[1], strict=True):
            both = np.hstack([motion, np.gradient(motion, times_s, axis=0)])
            shifted = shifted_frames(times_s, both, shift_s, frame_count=frame_count)
            frames, velocity = np.split(shifted, 2, axis=1)
            velocity[np.arange(frame_count) / FRAME_RATE_HZ < shift_s] = 0.0
            is_inside = abs(shift_s) < MAX_TIME_OFFSET_S - 1e-6
            yield frames, velocity if is_inside else None

    def intervals(self) -> Iterator[tuple[tuple[float, float], tuple[float, float]]]:
        """Yield the interval of the distance and that of the normalized distance of each motion."""
        mean = self.trials.mean(axis=0)
        distances, _ = self.distances()
        for (frames, velocity), distance in zip(
            self.aligned_frames(), distances, strict=True
        ):
            deviation = frames - mean
            interval = trials_interval(deviation, self.trials, velocity=velocity)
            yield (
                interval,
                jackknife_interval(
                    distance / self.trial_distances.mean(),
                    np.divide(interval, distance),
                    baselines=self.baselines_without,
                    distances=distances_without(deviation, self.trials),
                ),
            )


@dataclass(frozen=True)
class Population:
    """A source of worlds.

    Attributes:
        name: Name.
        draw: Draw the trials of a world.
        mean: Mean of all trials, shape [T, C].
        motions: Motions, shape [M, S, C].
    """

    name: str
    draw: Callable[[np.random.Generator], FloatArray]
    mean: FloatArray
    motions: FloatArray

    def coverage(self, count: int, seed: int) -> tuple[FloatArray, FloatArray]:
        """Return true distances, and normalized ones, shape [2, M], and the shares of intervals that hold them."""
        random = np.random.default_rng([seed, 1])
        baseline = np.mean(
            [
                World(self.draw(random), self.motions).trial_distances.mean()
                for _ in range(BASELINE_WORLDS)
            ]
        )
        distances, _ = World(self.mean[None], self.motions).distances()
        truth = np.array([distances, distances / baseline])
        random = np.random.default_rng(seed)
        held = np.zeros(truth.shape)
        for _ in range(count):
            world = World(self.draw(random), self.motions)
            ends = np.array([*world.intervals()])
            held += (truth >= ends[..., 0].T) & (truth <= ends[..., 1].T)
        return truth, held / count

    def differences(self, count: int, seed: int) -> FloatArray:
        """Return how often the interval of a difference, as in `gauge compare`, holds that of two neighbours."""
        truth = np.diff(World(self.mean[None], self.motions).distances()[0])
        random = np.random.default_rng([seed, 3])
        held = np.zeros(len(truth))
        for _ in range(count):
            trials = self.draw(random)
            errors = (trials - trials.mean(axis=0)) / np.sqrt(trials.shape[1])
            errors = without_shift(errors, trials.mean(axis=0))
            errors /= np.sqrt(len(trials) * (len(trials) - 1.0))
            frames = World(trials, self.motions).aligned_frames()
            sides = [
                Deviations(
                    seeds=(0,),
                    vectors=_scaled(motion - trials.mean(axis=0)),
                    trials=errors.reshape(len(trials), -1),
                    shared=np.zeros((0, errors[0].size)),
                    uncertainty=0.0,
                )
                for motion, _ in frames
            ]
            ends = [difference_interval(b, a) for a, b in pairwise(sides)]
            held += [
                low <= value <= high
                for (low, high), value in zip(ends, truth, strict=True)
            ]
        return held / count

    def prediction(self, count: int, seed: int) -> float:
        """Return how often one more trial is within the limit of the others."""
        random = np.random.default_rng([seed, 2])
        within = 0
        for _ in range(count):
            first, second = self.draw(random), self.draw(random)
            world = World(first, second[:1].repeat(SAMPLES_PER_FRAME, axis=1))
            more = AlignedDistances(second[:1], first, FRAME_RATE_HZ)
            equal = np.full((1, len(first)), 1.0 / len(first))
            distance = more(np.array([0]), equal)[0][0]
            within += distance <= prediction_limit(world.trial_distances)
        return within / count


def _scaled(deviation: FloatArray) -> FloatArray:
    """Return a deviation as a row whose length is the distance; frames after the motion do not count."""
    seen = np.isfinite(deviation).all(axis=1)
    return np.nan_to_num(deviation).reshape(1, -1) / np.sqrt(seen.sum())


def resampled(name: str) -> Population:
    """Return worlds of the real trials of an id; the exact motions, and the mean and 1 % more, have a distance."""
    band = reference_band(load_experiment(name))
    assert band is not None and band.trials is not None
    trials = band.trials
    count, frame_count, _ = trials.shape
    times_s = np.arange((frame_count - 1) * SAMPLES_PER_FRAME + 1) / FRAME_RATE_HZ
    times_s /= SAMPLES_PER_FRAME
    mean = trials.mean(axis=0)
    motions = [
        np.stack(
            [
                np.interp(times_s, np.arange(frame_count) / FRAME_RATE_HZ, column)
                for column in mean.T
            ],
            axis=-1,
        )
    ]
    for parameters in ("published", "measured"):
        exact = exact_motion(load_experiment(name, parameters), times_s)
        assert exact is not None
        motions.append(band.project(exact))
    return Population(
        name,
        lambda random: trials[random.integers(count, size=count)],
        mean,
        np.array(motions),
    )


def own(name: str, shape: Draw, count: int) -> Population:
    """Return worlds of slides of a shape; their motions are farther and farther from the mean."""
    frames_s = np.arange(FRAMES) / FRAME_RATE_HZ

    def draw(random: np.random.Generator, number: int = count) -> FloatArray:
        late_s = np.maximum(0.06 + 0.03 * shape(random, number), 0.0)
        acceleration = 2.7e3 * (1.0 + 0.025 * shape(random, number))
        drift = np.outer(
            2.0 * shape(random, number), np.sin(np.pi * frames_s / frames_s[-1])
        )
        since_s = np.maximum(frames_s - late_s[:, None], 0.0)
        noise = 0.3 * random.standard_normal(since_s.shape)
        trials = 0.5 * acceleration[:, None] * since_s**2 + drift + noise
        return trials[..., None]

    random = np.random.default_rng(0)
    mean = draw(random, 100_000).mean(axis=0)
    times_s = np.arange((FRAMES - 1) * SAMPLES_PER_FRAME + 1) / FRAME_RATE_HZ
    times_s /= SAMPLES_PER_FRAME
    base = np.interp(times_s, frames_s, mean[:, 0])
    away = np.sqrt(1.28) * np.sin(2.0 * np.pi * times_s / times_s[-1])
    away += 0.6 * np.sqrt(5.0) * (times_s / times_s[-1]) ** 2
    size = np.mean(
        [World(draw(random), mean[None]).trial_distances.mean() for _ in range(50)]
    )
    motions = base + size * np.outer(FACTORS, away)
    return Population(f"{name}, {count} trials", draw, mean, motions[..., None])


def of_numbers(shape: Draw, count: int, worlds: int, seed: int) -> FloatArray:
    """Return how often Student's interval of a mean, 1.96 u of it, and Student's limit of one more number hold."""
    random = np.random.default_rng([seed, 4])
    drawn = np.array([shape(random, count + 1) for _ in range(worlds)])
    known, more = drawn[:, :-1], drawn[:, -1]
    mean, scatter = known.mean(axis=1), known.std(axis=1, ddof=1)
    u = scatter / np.sqrt(count)
    inside = [
        np.abs(mean) <= student_t(count - 1) * u,
        np.abs(mean) <= COVERAGE_FACTOR * u,
        np.abs(more - mean) <= student_limit(count) * scatter,
    ]
    return np.mean(inside, axis=1)


def populations(unseen: bool) -> Iterator[Population]:
    """Yield the sources of worlds."""
    yield from map(resampled, REAL)
    for name, shape in (UNSEEN_SHAPES if unseen else SHAPES).items():
        for count in (5, 10, 20):
            yield own(name, shape, count)


def main() -> None:
    """Print a row for each motion of each source of worlds."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--worlds", type=int, default=400)
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--unseen", action="store_true")
    arguments = parser.parse_args()
    for name, shape in (UNSEEN_SHAPES if arguments.unseen else SHAPES).items():
        for count in (5, 10, 20):
            shares = of_numbers(shape, count, 10 * arguments.worlds, arguments.seed)
            print(f"{count} {name} numbers: mean, 1.96 u, one more {shares}")
    print(
        "worlds: true normalized distance; share of intervals of it, and of the distance, that hold it"
    )
    for population in populations(arguments.unseen):
        truth, held = population.coverage(arguments.worlds, arguments.seed)
        for ratio, of_ratio, of_distance in zip(
            truth[1], held[1], held[0], strict=True
        ):
            print(f"{population.name}: {ratio:.2f}; {of_ratio:.3f}, {of_distance:.3f}")
        differences = population.differences(arguments.worlds, arguments.seed)
        print(f"{population.name}: differences of neighbours {differences}")
        limit = population.prediction(arguments.worlds, arguments.seed)
        print(
            f"{population.name}: one more trial within the limit {limit:.3f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
