"""Measure how often 95 % intervals hold the true score in simulated realities, and write the table of it.

python studies/coverage/interval_coverage.py measure [TABLE [WORLD ...]]   measures, half an hour in all
python studies/coverage/interval_coverage.py                               writes the tables of the note
python studies/coverage/interval_coverage.py --check                       fails if the note is not current
"""

from __future__ import annotations

import csv
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from scripts.generated import markdown_table, settle
from trial_worlds import (
    CHOSEN_ON,
    HELD_OUT,
    WORLDS,
    FloatArray,
    World,
    align,
    band_of,
    leave_one_out,
    rms,
)

from gauge_envs.evaluation.deviation import percentile_interval
from gauge_envs.evaluation.uncertainty import BandErrors, band_errors
from gauge_envs.tools.compare.draws import ScoreDraws
from gauge_envs.tools.compare.grades import GradedExperiment, compare_pairs

TABLE = Path(__file__).with_name("coverage.csv")
NOTE = Path(__file__).with_name("README.md")
BEGIN, END = (
    "<!-- tables, written by interval_coverage.py -->",
    "<!-- end of tables -->",
)
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
    def held(self) -> float:
        """Percentage of the intervals that hold the truth."""
        shown = self.realities - self.refused
        return 100.0 * (shown - self.missed) / shown if shown else 100.0

    @property
    def share_refused(self) -> float:
        """Percentage of the realities without an interval."""
        return 100.0 * self.refused / self.realities

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


def measure(
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
        own = [
            aligned_errors(
                world, engine, errors, *shifted[engine][1:], one
            ).with_baseline(others)
            for engine in engines
        ]
        _measure_kind(
            world, "aligned", own, aligned, others, float(others.mean()), tally
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
    for engine, (own, deviation) in enumerate(zip(errors, deviations, strict=True)):
        size = float(np.linalg.norm(own.flat(deviation)))
        if engine != 1:
            name = "ABC"[engine]
            mm, ends = (
                own.interval(deviation, over_baseline=False),
                own.interval(deviation),
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
            own.draws(deviation)[None] / baseline,
        )
        influences = own.influences(deviation)[None] / baseline
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
        measure(WORLDS[name], count, realities=realities, seed=seed, tally=tally)
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
        writer.writerows(asdict(row) for row in sorted(rows, key=lambda row: row.held))


def read(file: Path = TABLE) -> list[Row]:
    """Return the measured table, worst first."""
    with file.open(newline="") as stream:
        return [
            Row(
                one["world"],
                int(one["trials"]),
                one["quantity"],
                one["engines"],
                *(int(one[key]) for key in COUNTED),
            )
            for one in csv.DictReader(stream)
        ]


COUNTED = ("realities", "refused", "missed")


SHOWN = {"beyond": 2, "held out": 5, "chosen": 3}
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
                f"{one.held:.0f}",
            ]
            for one in found[:shown]
        ]
        least, over = (
            sum(row.held >= HOLDS for row in found),
            sum(row.held > OVER for row in found),
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, or write the tables of the note."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] != ["measure"]:
        before, _, rest = NOTE.read_text(encoding="utf-8").partition(BEGIN)
        text = f"{before}{BEGIN}\n\n{tables(read())}\n\n{END}{rest.partition(END)[2]}"
        return settle(
            {NOTE: text},
            "../studies/coverage/interval_coverage.py",
            check="--check" in words,
        )
    file = Path(words[1]) if len(words) > 1 else TABLE
    rows: list[Row] = []
    started = time.process_time()
    for name in words[2:] or WORLDS:
        for count in counts(name):
            rows += coverage(name, count)
            _write(file, rows)
            print(
                f"{name}, {count} trials: {time.process_time() - started:.0f} s",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
