"""Measure how often 95 % intervals hold the true score in simulated realities, and write the table of it.

python -m studies.coverage.interval_coverage TABLE [WORLD ...]    half an hour for all worlds
"""

from __future__ import annotations

import csv
import math
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gauge_envs.evaluation.deviation import (
    LEAST_OVERLAP,
    SHIFT_STEP_S,
    percentile_interval,
)
from gauge_envs.evaluation.metrics.trajectory import MAX_RELEASE_OFFSET_S
from gauge_envs.evaluation.uncertainty import BandErrors, band_errors
from gauge_envs.references.bands import Band
from gauge_envs.references.grades import BandGrade
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.compare.draws import ScoreDraws
from gauge_envs.tools.compare.grades import GradedExperiment, compare_pairs
from scripts.generated import (
    SCORING,
    Request,
    markdown_table,
    page_part,
    read_rows,
)

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


def heavy(random: np.random.Generator, realities: int, trials: int) -> FloatArray:
    """Student's law with 4 degrees of freedom."""
    return random.standard_t(4.0, (realities, trials)) / math.sqrt(2.0)


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


def sessions(
    random: np.random.Generator,
    realities: int,
    trials: int,
    *,
    count: int,
    share: float,
) -> FloatArray:
    """A part of the variance is shared by the trials of a session; sessions are equally long."""
    session = np.arange(trials) * count // trials
    shared = random.standard_normal((realities, count))[:, session]
    return math.sqrt(share) * shared + math.sqrt(1.0 - share) * random.standard_normal(
        (realities, trials)
    )


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
class Swing:
    """A damped pendulum that is let go; its constant is the frequency [Hz]."""

    constant: float = 0.9
    constant_std: float = 0.006
    start_std_mm: float = 2.0
    release_s: float = 0.05
    release_std_s: float = 0.02
    frame_count: int = 60

    def positions_mm(
        self, constant: FloatArray, release_s: FloatArray, start_mm: FloatArray
    ) -> FloatArray:
        """Return displacements [mm], shape [..., frame_count], of arrays of one shape; the amplitude is 200 mm."""
        times_s = np.arange(self.frame_count) / FRAME_RATE_HZ
        since_s = np.maximum(times_s - release_s[..., None], 0.0)
        phase = 2.0 * math.pi * constant[..., None] * since_s
        return np.asarray(
            (200.0 + start_mm[..., None]) * np.exp(-0.3 * since_s) * np.cos(phase)
        )


@dataclass(frozen=True, kw_only=True)
class World:
    """How trials scatter, and three engines.

    Attributes:
        motion: What moves.
        release: Scatter of the release time.
        constant: Scatter of the constant.
        engine_errors: Error of the constant of each engine.
    """

    motion: Slide | Drop | Swing
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
    grid_s = np.arange(
        -MAX_RELEASE_OFFSET_S, MAX_RELEASE_OFFSET_S + 1e-9, OFFSET_STEP_S
    )
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
    coarse = round(MAX_RELEASE_OFFSET_S / SHIFT_STEP_S)
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
        grade=BandGrade.TRIALS,
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


DROP_ERRORS = (-0.03, 0.02, 0.0)
SWING_ERRORS = (0.03, -0.02, 0.0)

CHOSEN_ON = {
    "slide": World(motion=Slide()),
    "slide, skewed release": World(motion=Slide(), release=partial(skewed, shape=4.0)),
    "slide, 5 % outliers": World(
        motion=Slide(),
        release=partial(outliers, size=5.0),
        constant=partial(outliers, size=5.0),
    ),
    "slide, release correlated 0.4": World(
        motion=Slide(), release=partial(consecutive, correlation=0.4)
    ),
    "drop": World(motion=Drop(), engine_errors=DROP_ERRORS),
    "slide, small release scatter": World(
        motion=Slide(release_std_s=0.005), engine_errors=(0.02, -0.01, 0.0)
    ),
    "slide, exponential release": World(
        motion=Slide(release_s=0.03), release=partial(skewed, shape=1.0)
    ),
    "slide, heavy tails": World(motion=Slide(), release=heavy, constant=heavy),
    "slide, friction correlated 0.3": World(
        motion=Slide(), constant=partial(consecutive, correlation=0.3)
    ),
    "slide, 4 sessions 20 %": World(
        motion=Slide(), constant=partial(sessions, count=4, share=0.2)
    ),
    "slide, 3 sessions 20 %": World(
        motion=Slide(), constant=partial(sessions, count=3, share=0.2)
    ),
    "slide, 4 sessions 50 %": World(
        motion=Slide(), constant=partial(sessions, count=4, share=0.5)
    ),
    "drop, 18 frames": World(motion=Drop(frame_count=18), engine_errors=DROP_ERRORS),
    "drop, release correlated 0.4": World(
        motion=Drop(),
        release=partial(consecutive, correlation=0.4),
        engine_errors=DROP_ERRORS,
    ),
    "drop, 5 % outliers": World(
        motion=Drop(),
        release=partial(outliers, size=5.0),
        constant=partial(outliers, size=5.0),
        engine_errors=DROP_ERRORS,
    ),
    "drop, skewed release": World(
        motion=Drop(), release=partial(skewed, shape=4.0), engine_errors=DROP_ERRORS
    ),
}
"""Worlds on which the method and its numbers were chosen, or whose results were known when it was changed."""

HELD_OUT = {
    "swing": World(motion=Swing(), engine_errors=SWING_ERRORS),
    "swing, release correlated 0.3": World(
        motion=Swing(),
        release=partial(consecutive, correlation=0.3),
        engine_errors=SWING_ERRORS,
    ),
    "swing, exponential release": World(
        motion=Swing(release_s=0.02),
        release=partial(skewed, shape=1.0),
        engine_errors=SWING_ERRORS,
    ),
    "drop, 40 frames": World(motion=Drop(frame_count=40), engine_errors=DROP_ERRORS),
    "drop, heavy tails": World(
        motion=Drop(), release=heavy, constant=heavy, engine_errors=DROP_ERRORS
    ),
}
"""Worlds on which it was tested alone."""

BEYOND = {
    "slide, 2 sessions 20 %": World(
        motion=Slide(), constant=partial(sessions, count=2, share=0.2)
    ),
    "slide, 2 sessions 50 %": World(
        motion=Slide(), constant=partial(sessions, count=2, share=0.5)
    ),
    "slide, 2 sessions 90 %": World(
        motion=Slide(), constant=partial(sessions, count=2, share=0.9)
    ),
    "slide, 4 sessions 90 %": World(
        motion=Slide(), constant=partial(sessions, count=4, share=0.9)
    ),
    "slide, release correlated 0.7": World(
        motion=Slide(), release=partial(consecutive, correlation=0.7)
    ),
}
"""Worlds that no method holds in without knowing the sessions: equal sessions look like independent trials."""

WORLDS = CHOSEN_ON | HELD_OUT | BEYOND


TABLE = Path(__file__).with_name("coverage.csv")
NOTE = Path(__file__).with_name("README.md")
HOLDS = 92.0
"""Percentage from which a row holds."""
OVER = 98.0
"""Percentage from which on intervals are wider than they need be."""
COUNTS = {"slide": (5, 10, 20), "drop": (5, 10, 22), "swing": (5, 10, 20)}
"""Numbers of trials; the real slides have 20, the drops 22."""
SEEDS = (41, 42, 43, 44, 45, 46)
"""Seeds of the table. The method was chosen with the seeds 1 and 2."""
REALITIES = 84
"""Realities of each seed."""
PAIRS = ((0, 1), (0, 2))
HELD, MISSED, REFUSED = "held", "missed", "refused"
Tally = dict[tuple[str, str], Counter[str]]


@dataclass(frozen=True)
class Row:
    """Coverage of one quantity in one world.

    Attributes:
        world: Name of the world.
        trials: Number of trials in each reality.
        quantity: `raw` or `aligned`, and `mm`, `ratio`, `percentile` or `pair`.
        engines: Engines, A to C.
        realities: Number of realities.
        refused: Realities without an interval.
        missed: Realities whose interval does not hold the truth.
    """

    world: str
    trials: int
    quantity: str
    engines: str
    realities: int
    refused: int
    missed: int

    @property
    def coverage_percent(self) -> float:
        """Percentage of the intervals that hold the truth."""
        shown = self.realities - self.refused
        return 100.0 * (shown - self.missed) / shown if shown else 100.0

    @property
    def part(self) -> str:
        """Whether the method was chosen on the world."""
        return (
            "chosen"
            if self.world in CHOSEN_ON
            else "held out"
            if self.world in HELD_OUT
            else "beyond"
        )


def counts(name: str) -> tuple[int, ...]:
    """Return the numbers of trials that a world is measured with."""
    return COUNTS[name.split(",")[0]]


def verdict(interval: tuple[float, float] | None, truth: float) -> str:
    if interval is None or not np.isfinite(interval).all():
        return REFUSED
    return HELD if interval[0] <= truth <= interval[1] else MISSED


def count_verdicts(
    world: World, count: int, *, realities: int, seed: int, tally: Tally
) -> None:
    """Count verdicts of all intervals over simulated realities, by quantity and engines."""
    trials = world.trials(np.random.default_rng([seed, count]), realities, count)
    means = trials.mean(axis=1)
    distances = dict(zip(("raw", "aligned"), leave_one_out(trials), strict=True))
    engines = range(len(world.engine_errors))
    shifted = [align(world, engine, means) for engine in engines]
    inside = rms(trials - means[:, None]).mean(axis=1)
    for one in range(realities):
        errors = band_errors(band_of(trials[one]), None)
        raw = [
            (world.engine(engine, np.zeros(())) - means[one])[:, None]
            for engine in engines
        ]
        _measure_kind(
            world,
            "raw",
            [errors] * len(raw),
            raw,
            distances["raw"][one],
            float(inside[one]),
            tally,
        )
        others = distances["aligned"][one]
        aligned = [deviation[one][:, None] for deviation, *_ in shifted]
        errors_of_one = [
            aligned_errors(
                world, engine, errors, *shifted[engine][1:], one
            ).with_baseline(others)
            for engine in engines
        ]
        _measure_kind(
            world,
            "aligned",
            errors_of_one,
            aligned,
            others,
            float(others.mean()),
            tally,
        )


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


def _measure_kind(
    world: World,
    kind: str,
    errors: Sequence[BandErrors],
    deviations: Sequence[FloatArray],
    distances: FloatArray,
    baseline: float,
    tally: Tally,
) -> None:
    truth, scores = world.truth, []
    for engine, (errors_of_one, deviation) in enumerate(
        zip(errors, deviations, strict=True)
    ):
        size = float(np.linalg.norm(errors_of_one.flat(deviation)))
        if engine != 1:
            name = "ABC"[engine]
            mm, ends = (
                errors_of_one.interval(deviation, over_baseline=False),
                errors_of_one.interval(deviation),
            )
            ratio = None if ends is None else (ends[0] / baseline, ends[1] / baseline)
            percentile = percentile_interval(distances, size, mm)
            tally[f"{kind} mm", name][verdict(mm, truth.mm[kind][engine])] += 1
            tally[f"{kind} ratio", name][verdict(ratio, truth.ratio(kind, engine))] += 1
            tally[f"{kind} percentile", name][
                verdict(percentile, truth.percentile(kind, engine))
            ] += 1
        score, drawn = (
            np.array([size / baseline]),
            errors_of_one.draws(deviation)[None] / baseline,
        )
        influences = errors_of_one.influences(deviation)[None] / baseline
        scores.append(
            ScoreDraws(
                seeds=(0,),
                raw=score,
                primary=score,
                draws=drawn,
                influences=influences,
            )
        )
    experiment = GradedExperiment(id="one", draws=tuple(scores))
    for pair in PAIRS:
        (found,) = compare_pairs([experiment], [pair])[0].experiments
        difference = truth.ratio(kind, pair[0]) - truth.ratio(kind, pair[1])
        tally[f"{kind} pair", "".join("ABC"[one] for one in pair)][
            verdict(found.difference_95, difference)
        ] += 1


def coverage(
    name: str, count: int, *, realities: int = REALITIES, seeds: Iterable[int] = SEEDS
) -> list[Row]:
    """Return the coverage of every quantity in a world, with a number of realities for each seed."""
    tally: Tally = defaultdict(Counter)
    for seed in seeds:
        count_verdicts(WORLDS[name], count, realities=realities, seed=seed, tally=tally)
    return [
        Row(
            name, count, quantity, engines, found.total(), found[REFUSED], found[MISSED]
        )
        for (quantity, engines), found in tally.items()
    ]


def _write(file: Path, rows: Iterable[Row]) -> None:
    with file.open("w", newline="") as stream:
        writer = csv.DictWriter(
            stream, [one.name for one in fields(Row)], lineterminator="\n"
        )
        writer.writeheader()
        writer.writerows(
            asdict(row) for row in sorted(rows, key=lambda row: row.coverage_percent)
        )


def read(file: Path = TABLE) -> list[Row]:
    """Return the measured table, worst first."""
    return [
        Row(
            one["world"],
            int(one["trials"]),
            one["quantity"],
            one["engines"],
            *(int(one[key]) for key in COUNTED),
        )
        for one in read_rows(file)
    ]


COUNTED = ("realities", "refused", "missed")


SHOWN = {"beyond": 2, "held out": 1, "chosen": 1}
"""Worst rows of each part that the note lists."""


def tables(rows: Sequence[Row]) -> str:
    """Return the tables of the note: the worst rows, and how many rows hold."""
    lines = [
        f"{len(rows)} rows of {rows[0].realities} realities, seeds {SEEDS[0]} to {SEEDS[-1]}.",
        "",
    ]
    cells, counted = [], []
    for part, shown in SHOWN.items():
        found = [row for row in rows if row.part == part]
        cells += [
            [
                f"{one.world}, {one.trials}",
                f"{one.quantity} {one.engines}",
                f"{one.coverage_percent:.0f}",
            ]
            for one in found[:shown]
        ]
        least, over = (
            sum(row.coverage_percent >= HOLDS for row in found),
            sum(row.coverage_percent > OVER for row in found),
        )
        counted.append(
            [
                part,
                f"{len(found)}",
                f"{len(found) - least}",
                f"{least - over}",
                f"{over}",
            ]
        )
    lines += [
        *markdown_table(["part", "rows", "below 92 %", "92 to 98 %", "above"], counted),
        "",
    ]
    lines += markdown_table(["worst rows: world, trials", "quantity", "holds %"], cells)
    return "\n".join(lines)


def contents(scoring: Path = SCORING) -> dict[Path, str]:
    """Return the note with the tables of the measured rows."""
    script = "studies/coverage/interval_coverage.py"
    return page_part(NOTE, "tables", script, tables(read()))


def measure(request: Request) -> None:
    """Measure all worlds, half an hour."""
    measure_worlds(TABLE, list(WORLDS))


def measure_worlds(file: Path, names: Sequence[str]) -> None:
    """Measure some worlds, and write the table after each."""
    rows: list[Row] = []
    started = time.process_time()
    for name in names:
        for count in counts(name):
            rows += coverage(name, count)
            _write(file, rows)
            spent = f"{time.process_time() - started:.0f} s"
            print(f"{name}, {count} trials: {spent}", flush=True)


if __name__ == "__main__":
    measure_worlds(Path(sys.argv[1]), sys.argv[2:] or list(WORLDS))
