"""Measure how often the 95 % intervals of scores hold the true score, and write the table of it."""

from __future__ import annotations

import sys
import time
from collections import Counter, defaultdict
from collections.abc import Sequence

import numpy as np
from trial_worlds import WORLDS, FloatArray, World, align, band_of, leave_one_out, rms

from gauge_envs.evaluation.deviation import percentile_interval
from gauge_envs.evaluation.uncertainty import BandErrors, band_errors
from gauge_envs.tools.compare.draws import ScoreDraws
from gauge_envs.tools.compare.grades import GradedExperiment, compare_pair

COUNTS = (5, 10, 20, 22)
PAIRS = ((0, 1), (0, 2))
HELD, MISSED, REFUSED = "held", "missed", "refused"
Tally = dict[tuple[str, str], Counter[str]]


def verdict(interval: tuple[float, float] | None, truth: float) -> str:
    if interval is None or not np.isfinite(interval).all():
        return REFUSED
    return HELD if interval[0] <= truth <= interval[1] else MISSED


def measure(world: World, count: int, *, realities: int, seed: int, tally: Tally) -> None:
    """Count verdicts of all intervals over simulated realities, by quantity and engines."""
    random = np.random.default_rng([seed, count])
    trials = world.trials(random, realities, count)
    means = trials.mean(axis=1)
    loo = dict(zip(("raw", "aligned"), leave_one_out(trials), strict=True))
    deviations: dict[str, list[FloatArray]] = {"raw": [], "aligned": []}
    velocities = []
    for engine in range(len(world.engine_errors)):
        deviations["raw"].append(world.engine(engine, np.zeros(())) - means)
        shifted, velocity = align(world, engine, means)
        deviations["aligned"].append(shifted)
        velocities.append(velocity)
    inside = rms(trials - means[:, None]).mean(axis=1)
    for one in range(realities):
        of_band = band_errors(band_of(trials[one]), None, None)
        for kind in ("raw", "aligned"):
            baseline = float(inside[one] if kind == "raw" else loo[kind][one].mean())
            errors = []
            for engine in range(len(world.engine_errors)):
                own = of_band
                if kind == "aligned":
                    own = of_band.aligned(velocities[engine][one][:, None]).with_baseline(loo[kind][one])
                errors.append(own)
            chosen = [each[one][:, None] for each in deviations[kind]]
            _measure_one(world, kind, errors, chosen, loo[kind][one], baseline, tally)


def _measure_one(
    world: World,
    kind: str,
    errors: Sequence[BandErrors],
    deviations: Sequence[FloatArray],
    distances: FloatArray,
    baseline: float,
    tally: Tally,
) -> None:
    truth = world.truth
    scores = []
    for engine, (own, deviation) in enumerate(zip(errors, deviations, strict=True)):
        name = "ABC"[engine]
        if engine != 1:
            mm = own.interval(deviation, over_baseline=False)
            tally[f"{kind} mm", name][verdict(mm, truth.mm[kind][engine])] += 1
            ends = own.interval(deviation)
            ratio = None if ends is None else (ends[0] / baseline, ends[1] / baseline)
            tally[f"{kind} ratio", name][verdict(ratio, truth.ratio(kind, engine))] += 1
            distance = float(np.linalg.norm(own.flat(deviation)))
            percent = percentile_interval(distances, distance, mm)
            tally[f"{kind} percentile", name][verdict(percent, truth.percentile(kind, engine))] += 1
        score = np.array([float(np.linalg.norm(own.flat(deviation)))]) / baseline
        drawn = own.draws(deviation)[None] / baseline
        influences = own.influences(deviation)[None] / baseline
        scores.append(
            ScoreDraws(
                seeds=(0,),
                raw=score,
                raw_draws=drawn,
                raw_influences=influences,
                primary=score,
                primary_draws=drawn,
                primary_influences=influences,
            )
        )
    experiment = GradedExperiment(id="one", draws=tuple(scores), published={})
    for pair in PAIRS:
        found = compare_pair([experiment], pair)
        assert found is not None
        true = truth.ratio(kind, pair[0]) - truth.ratio(kind, pair[1])
        tally[f"{kind} pair", "".join("ABC"[one] for one in pair)][verdict(found.difference_95, true)] += 1


def main(arguments: Sequence[str]) -> None:
    names = [name for name in WORLDS if not arguments[2:] or any(word in name for word in arguments[2:])]
    counts = [int(one) for one in arguments[1].split(",")]
    realities = int(arguments[0])
    for name in names:
        WORLDS[name].truth
        for count in counts:
            started = time.process_time()
            tally: Tally = defaultdict(Counter)
            for seed in (1, 2):
                measure(WORLDS[name], count, realities=realities // 2, seed=seed, tally=tally)
            text = []
            for (quantity, engine), found in sorted(tally.items()):
                shown = found[HELD] + found[MISSED]
                held = 100.0 * found[HELD] / shown if shown else float("nan")
                mark = "*" if held < 92 else "+" if held > 98 else " "
                text.append(f"{quantity} {engine} {held:.0f}{mark}({100 * found[REFUSED] / realities:.0f})")
            print(f"{name} N={count} [{time.process_time() - started:.0f}s]:\n   " + "; ".join(text), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
