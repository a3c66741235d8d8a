"""Measure how often 95 % intervals hold true distances of 0, 0.5, 1, 2 and 5 times that of real trials.

python -m studies.coverage.levels TABLE [WORLD ...]    10 minutes for all worlds
"""

from __future__ import annotations

import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.optimize import brentq

from gauge_envs.evaluation.uncertainty import band_errors
from gauge_envs.scene.timing import FRAME_RATE_HZ
from scripts.generated import append_rows
from studies.coverage.interval_coverage import (
    MISSED,
    REFUSED,
    Drop,
    FloatArray,
    Slide,
    Swing,
    World,
    align,
    aligned_distances,
    aligned_errors,
    band_of,
    leave_one_out,
    outliers,
    rms,
    skewed,
    verdict,
)

LEVELS = (0.0, 0.5, 1.0, 2.0, 5.0)
"""True distances over the mean distance of real trials."""
KINDS = ("raw", "aligned")
POPULATION = 20_000
"""Trials that stand for infinitely many."""
LEAD_S = 0.5
"""Time before the first frame, and after the last one, at which the mean is known: shifts reach 1/3 s."""
STEP_S = 1.0 / 600.0
"""Step of the mean of infinitely many trials [s]; frames are multiples of it."""


@dataclass(frozen=True, kw_only=True)
class Leveled(World):
    """Engines that are at stated distances from the mean of infinitely many trials.

    Engine `5 k + l` is the mean plus a multiple of the error of a wrong constant. The multiple gives the distance of
    level l, as it is (k = 0) or after alignment (k = 1).
    """

    @cached_property
    def _fine(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Times [s], mean of infinitely many trials, and change of the motion by a wrong constant [mm]."""
        frame_count = self.motion.frame_count
        steps = round(1.0 / FRAME_RATE_HZ / STEP_S)
        lead = round(LEAD_S / STEP_S)
        times_s = STEP_S * np.arange(-lead, (frame_count - 1) * steps + lead + 1)
        total = np.zeros(len(times_s))
        # A motion at other times is one with another release, so the same draws give all phases between frames.
        longer = replace(
            self, motion=replace(self.motion, frame_count=frame_count + 15)
        )
        for phase in range(steps):
            early = replace(
                longer,
                motion=replace(
                    longer.motion, release_s=self.motion.release_s - phase * STEP_S
                ),
            )
            mean = early.trials(np.random.default_rng(4321), POPULATION, 1)[:, 0].mean(
                axis=0
            )
            total[lead + phase :: steps] = mean[: len(total[lead + phase :: steps])]
        total[:lead] = total[lead]
        since_s = np.maximum(times_s, 0.0)
        curves = [
            self._single(self.motion.constant + error, since_s)
            for error in (0.0, self.engine_errors[0])
        ]
        return times_s, total, curves[1] - curves[0]

    def _single(self, constant: float, times_s: FloatArray) -> FloatArray:
        """Return one motion at any times [mm]."""
        late_s = self.motion.release_s - times_s
        one_frame = replace(self.motion, frame_count=1)
        zero = np.zeros(len(times_s))
        return one_frame.positions_mm(np.full(len(times_s), constant), late_s, zero)[
            :, 0
        ]

    def moved(self, factor: float, shift_s: FloatArray) -> FloatArray:
        """Return the mean plus a multiple of the error, later by a shift [s], shape [..., frame_count]."""
        times_s, mean, change = self._fine
        frames_s = np.arange(self.motion.frame_count) / FRAME_RATE_HZ
        wanted_s = frames_s - np.asarray(shift_s)[..., None]
        return np.asarray(np.interp(wanted_s, times_s, mean + factor * change))

    @cached_property
    def baselines(self) -> dict[str, float]:
        """Mean distance of infinitely many trials [mm], by kind."""
        trials = self.trials(np.random.default_rng(77), POPULATION, 1)[:, 0]
        mean = self.moved(0.0, np.zeros(()))
        aligned = aligned_distances(trials[:6000], mean[None])
        return {
            "raw": float(rms(trials - mean).mean()),
            "aligned": float(aligned.mean()),
        }

    @cached_property
    def factors(self) -> tuple[float, ...]:
        """Multiple of the error of each engine."""
        mean = self.moved(0.0, np.zeros(()))
        found = []
        for kind in KINDS:
            for level in LEVELS:
                target = level * self.baselines[kind]

                def excess(
                    factor: float, kind: str = kind, target: float = target
                ) -> float:
                    if kind == "raw":
                        return (
                            float(rms(self.moved(factor, np.zeros(())) - mean)) - target
                        )
                    moved = partial(self.moved, factor)
                    probe = SimpleNamespace(engine=lambda _, shift_s: moved(shift_s))
                    return float(rms(align(probe, 0, mean[None])[0][0])) - target

                found.append(
                    0.0 if level == 0.0 else float(brentq(excess, 0.0, 60.0, xtol=1e-4))
                )
        return tuple(found)

    def engine(self, number: int, shift_s: FloatArray) -> FloatArray:
        """Return the motion of an engine [mm] after a shift in time."""
        return self.moved(self.factors[number], shift_s)


FIVE_PERCENT = partial(outliers, size=5.0)
LATE = partial(skewed, shape=1.0)
DROP_ERRORS = (-0.03, 0.02, 0.0)

CHOSEN_ON = {
    "slide": Leveled(motion=Slide()),
    "slide, 5 % outliers": Leveled(
        motion=Slide(), release=FIVE_PERCENT, constant=FIVE_PERCENT
    ),
    "slide, late releases": Leveled(motion=Slide(release_s=0.03), release=LATE),
    "slide, both": Leveled(
        motion=Slide(release_s=0.03), release=LATE, constant=FIVE_PERCENT
    ),
}
"""Worlds on which the allowance for unseen outliers was chosen."""

FRESH = {
    "swing": Leveled(motion=Swing()),
    "swing, 5 % outliers": Leveled(
        motion=Swing(), release=FIVE_PERCENT, constant=FIVE_PERCENT
    ),
    "swing, late releases": Leveled(motion=Swing(release_s=0.02), release=LATE),
    "swing, both": Leveled(
        motion=Swing(release_s=0.02), release=LATE, constant=FIVE_PERCENT
    ),
    "drop, 18 frames": Leveled(motion=Drop(frame_count=18), engine_errors=DROP_ERRORS),
    "drop, 18 frames, 5 % outliers": Leveled(
        motion=Drop(frame_count=18),
        release=FIVE_PERCENT,
        constant=FIVE_PERCENT,
        engine_errors=DROP_ERRORS,
    ),
    "drop, 18 frames, late releases": Leveled(
        motion=Drop(frame_count=18, release_s=0.012),
        release=LATE,
        engine_errors=DROP_ERRORS,
    ),
    "slide, outliers of 8": Leveled(
        motion=Slide(),
        release=partial(outliers, size=8.0),
        constant=partial(outliers, size=8.0),
    ),
}
"""Worlds on which it was tested alone."""
WORLDS = CHOSEN_ON | FRESH
COUNTS = (5, 10, 20)
SEEDS = (61,)
"""Seed of the table. The method was chosen with seed 1."""
REALITIES = 60
TABLE = Path(__file__).with_name("levels.csv")


@dataclass(frozen=True)
class LevelRow:
    """Coverage of one quantity at one true distance.

    Attributes:
        world: Name of the world.
        trials: Number of trials in each reality.
        quantity: `raw` or `aligned`, and `mm` or `ratio`.
        level: True distance over the mean distance of trials.
        realities: Number of realities.
        refused: Realities without an interval.
        missed: Realities whose interval does not hold the truth.
        width: Median width of the interval, over the mean distance of trials.
    """

    world: str
    trials: int
    quantity: str
    level: float
    realities: int
    refused: int
    missed: int
    width: float

    @property
    def holds(self) -> float:
        """Percentage of the intervals that hold the truth."""
        shown = self.realities - self.refused
        return 100.0 * (shown - self.missed) / shown if shown else 100.0


def coverage(
    name: str, count: int, *, realities: int = REALITIES, seeds: Iterable[int] = SEEDS
) -> list[LevelRow]:
    """Return the coverage of distances and ratios at each level in a world."""
    world = WORLDS[name]
    tally: dict[tuple[str, float], Counter[str]] = defaultdict(Counter)
    widths: dict[tuple[str, float], list[float]] = defaultdict(list)
    for seed in seeds:
        trials = world.trials(np.random.default_rng([seed, count]), realities, count)
        means = trials.mean(axis=1)
        distances = dict(zip(KINDS, leave_one_out(trials), strict=True))
        inside = rms(trials - means[:, None]).mean(axis=1)
        shifted = [
            align(world, len(LEVELS) + number, means) for number in range(len(LEVELS))
        ]
        for one in range(realities):
            errors = band_errors(band_of(trials[one]), None)
            for number, level in enumerate(LEVELS):
                for kind in KINDS:
                    if kind == "raw":
                        used = errors
                        deviation = (world.engine(number, np.zeros(())) - means[one])[
                            :, None
                        ]
                        baseline = float(inside[one])
                    else:
                        engine = len(LEVELS) + number
                        deviation = shifted[number][0][one][:, None]
                        used = aligned_errors(
                            world, engine, errors, *shifted[number][1:], one
                        ).with_baseline(distances["aligned"][one])
                        baseline = float(distances["aligned"][one].mean())
                    true = world.baselines[kind]
                    for quantity, over, scale, truth in (
                        ("mm", False, true, level),
                        ("ratio", True, baseline, level),
                    ):
                        ends = used.interval(deviation, over_baseline=over)
                        found = (
                            None if ends is None else (ends[0] / scale, ends[1] / scale)
                        )
                        key = (f"{kind} {quantity}", level)
                        tally[key][verdict(found, truth)] += 1
                        if found is not None:
                            widths[key].append(found[1] - found[0])
    return [
        LevelRow(
            name,
            count,
            quantity,
            level,
            found.total(),
            found[REFUSED],
            found[MISSED],
            round(float(np.median(widths[quantity, level])), 2),
        )
        for (quantity, level), found in tally.items()
    ]


def measure_worlds(file: Path, names: Sequence[str]) -> None:
    """Measure some worlds, and add their rows to a table."""
    for name in names:
        for count in COUNTS:
            rows = [asdict(row) for row in coverage(name, count)]
            append_rows(file, list(rows[0]), rows)


if __name__ == "__main__":
    measure_worlds(Path(sys.argv[1]), sys.argv[2:] or list(FRESH))
