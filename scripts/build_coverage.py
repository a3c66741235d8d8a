"""Write the tables of coverage: all in `docs/coverage.md`, the first in `docs/scores.md`, a shorter one in `README.md`.

They say what each id is measured against and driven by in the package, and what its number can tell.

The table leaves out imported trials, which differ between users: `gauge list references` reports those.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gauge_envs import load_experiment, reference_band
from gauge_envs.evaluation.deformation import deformation_reference, real_statistics
from gauge_envs.evaluation.deviation import normalizing_baselines
from gauge_envs.evaluation.likely_mistakes import marker_mistake, value_mistake
from gauge_envs.evaluation.power import reference_power
from gauge_envs.evaluation.scatter import (
    LEVEL,
    NOT_TESTED,
    SHORT_VERDICTS,
    differs,
    held_tells,
    published_numbers,
    scatter_text,
)
from gauge_envs.evaluation.verification import (
    solution_uncertainty,
    verification_band,
)
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.variants import Variant, variants
from gauge_envs.references.bands import Band, bundled_band
from gauge_envs.references.deformation import bundled_deformation
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.grips import solved_loads
from gauge_envs.references.models import unsolved_scenes
from gauge_envs.references.published import published_baselines
from gauge_envs.references.scatter import (
    CAUSES,
    FAULTS,
    HELD_FAULTS,
    HeldRow,
    ScatterRow,
    held_rows,
    scatter_rows,
)
from gauge_envs.tools.catalog.words import deformation_text
from scripts.generated import ROOT, markdown_table, page_part

SCRIPT = f"scripts/{Path(__file__).name}"
PAGE = ROOT / "docs" / "coverage.md"

HEAD = """
| column | meaning |
| --- | --- |
| band | grade of the band in use; a *withheld* recording, which is used only if you ask for it; `statistics` |
| known | frames with a known mean, of all frames of the experiment; in brackets, frames known in every coordinate |
| leaves open | scatter of the real trials: of `trials`, or from the published `baseline`; u of a solution, or `exact` |
| driver | source of the motion of the driven body; `-` where nothing is driven |
| over real | scores that are divided by the published score or value of real trials: validation |
| tells | changes that the score tells: distances of 5 or more over what the band or the force leaves open |
| tells not | measured changes below 5; what is in neither column was not measured |
| scatter | whether MuJoCo scatters as real trials do, and what this test tells: [scores](scores.md#scatter) |

`known` and `leaves open` are those of the band in use, of markers where these are compared, or of the withheld band. A
law of a carried, held or strained body covers every frame. Other laws end at an event, as the first contact of a free
flight. Where a solution is exact, `tells` is over 1 % of the motion, or over 1 mm where nothing moves. Changes were
measured with MuJoCo (`scoring/power.csv`).
"""

SCENE_ALONE = "no: engine alone"
"""What a score against a solution of the scene says of reality."""

SUM_NAME = "references"
"""Name of the part with the numbers of ids by their references, in the other pages."""


@dataclass(frozen=True)
class Row:
    """Coverage of one variant; each field is what its column says."""

    variant: str
    used: BandGrade
    withheld: str | None
    statistics: bool
    has_scatter: bool
    known: str
    leaves_open: str
    driver: str
    over_real: str
    told: Mapping[str, float]
    not_told: Sequence[str]
    refuses_zeros: bool | None
    scatter_answer: str

    def cells(self) -> list[str]:
        """Cells of the table."""
        grades = [] if self.used is BandGrade.NONE else [self.used.value]
        grades += ["recording, *withheld*"] if self.withheld else []
        grades += ["statistics"] if self.statistics else []
        band = "; ".join(grades) or self.used.value
        return [
            self.variant,
            band,
            self.known,
            self.leaves_open,
            self.driver,
            self.over_real,
            ", ".join(f"{name} {size:.0f}" for name, size in self.told.items()) or "-",
            ", ".join(self.not_told) or "-",
            self.scatter_answer,
        ]


def coverage(variant: Variant) -> Row:
    """Return what the package holds for one variant."""
    experiment = load_experiment(variant)
    measured, used = bundled_band(variant.name), reference_band(experiment)
    band = measured if used is None else used
    baselines = published_baselines(variant.name)
    compared = used is not None and bool(normalizing_baselines(experiment, used))
    power = reference_power(experiment, used)
    metrics = [
        metric
        for metric in baselines
        if baselines[metric].mean and (compared or metric not in ("rmse", "dtw"))
    ]
    return Row(
        variant=variant.name,
        used=BandGrade.NONE if used is None else used.grade,
        withheld=None if measured is None else measured.withheld,
        statistics=bundled_deformation(variant.name) is not None,
        known="-"
        if band is None
        else f"{known_frames(verification_band(band) or band)} of {experiment.frame_count}",
        has_scatter=published_numbers(baselines) is not None,
        leaves_open="-" if band is None else leaves_open(band),
        driver=experiment.driver_provenance or "-",
        over_real=", ".join(metric.upper() for metric in metrics) or "-",
        told={} if power is None else power.told,
        not_told=[] if power is None else power.not_told,
        refuses_zeros=None if used is None else refuses_zeros(experiment, used),
        scatter_answer=scatter_text(experiment),
    )


def refuses_zeros(experiment: Experiment, band: Band) -> bool:
    """Return whether the first frame refuses a file of zeros."""
    values = np.zeros((experiment.frame_count, len(experiment.coordinates)))
    if value_mistake(experiment, values, band=band):
        return True
    markers = experiment.scene.markers
    return markers is not None and bool(
        marker_mistake(experiment, np.zeros((1, len(markers.positions_m), 3)))
    )


def leaves_open(band: Band) -> str:
    """Return the source of the scatter of real trials, or u of a solution."""
    compared = verification_band(band)
    if compared is None:
        return band.sigma_source.value
    uncertainty = solution_uncertainty(band)
    return "exact" if uncertainty is None else f"u {uncertainty:.2g} {compared.unit}"


def known_frames(band: Band) -> str:
    """Count the frames at which a band has a mean, and, where fewer, those with a mean in every coordinate."""
    known = np.isfinite(band.mean)
    some, full = known.any(axis=1).sum(), known.all(axis=1).sum()
    return str(some) if full == some else f"{some} ({full} in full)"


def coverage_markdown(rows: Sequence[Row]) -> str:
    """Return the text of the block."""
    drivers = Counter(row.driver for row in rows)
    named = [f"{drivers[name]} {name}" for name in sorted(drivers) if name != "-"]
    head = ("id", "band", "known", "leaves open", "driver", "over real", "tells")
    lines = [
        *sum_table(rows),
        "",
        f"Drivers: {', '.join(named)}.",
        "",
        HEAD.strip(),
        "",
        *markdown_table((*head, "tells not", "scatter"), [row.cells() for row in rows]),
        "",
        *told_lines(rows),
        "",
        "Why bands are withheld:",
        "",
    ]
    reasons: dict[str, list[str]] = {}
    for row in rows:
        if row.withheld:
            reasons.setdefault(row.withheld, []).append(row.variant)
    lines += [f"- {', '.join(names)}: {reason}." for reason, names in reasons.items()]
    lines += [*unsolved_lines(), *force_lines(), *deformation_lines()]
    return "\n".join([*lines, *scatter_lines(), *held_lines()])


TOLD_HEAD = """
The same by change. `tells`: ids whose score or force moves by 5 or more over what the reference leaves open. A file of
zeros is refused by its first frame.
"""

ZEROS = "a file of zeros"


def told_lines(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the ids that tell each change, and those that do not."""
    seen: dict[str, list[str]] = defaultdict(list)
    unseen: dict[str, list[str]] = defaultdict(list)
    for row in rows:
        if row.refuses_zeros is not None:
            (seen if row.refuses_zeros else unseen)[ZEROS].append(row.variant)
        for name in row.told:
            seen[name.partition(" by ")[0]].append(row.variant)
        for name in row.not_told:
            unseen[name].append(row.variant)
    changes = sorted({*seen, *unseen} - {ZEROS, "nothing moves"})
    yield from (TOLD_HEAD.strip(), "")
    yield from markdown_table(
        ("change", "tells", "ids", "tells not", "ids"),
        [
            [
                change,
                str(len(seen[change])),
                by_family(seen[change]),
                str(len(unseen[change])),
                by_family(unseen[change]),
            ]
            for change in ("nothing moves", ZEROS, *changes)
        ],
    )


def by_family(names: Sequence[str]) -> str:
    """Return ids by their family, as `TextileBending-rayon, satin`; without materials where it is all of them."""
    groups: dict[str, list[str]] = defaultdict(list)
    sizes = Counter(one.name.rpartition("-")[0] for one in variants())
    for name in names:
        family, _, material = name.rpartition("-")
        groups[family].append(material)
    texts = [
        family
        if len(materials) == sizes[family]
        else f"{family}-{', '.join(materials)}"
        for family, materials in groups.items()
    ]
    return "; ".join(texts) or "-"


SCATTER_HEAD = """
Scatter of the published real trials and of MuJoCo's runs, mean (standard deviation), and
[what is tested](scores.md#scatter). `release`: spread of the release with which E_RMSE is the real one, if the body
moves. p: with half, once and twice the assumed spread of starts, and with uneven trials. The other columns are
percentages of 200 simulated realities that are refused, with the assumed starts / with all, as a verdict needs. `none`
is the size of the test, for these 40 runs. `friction`, `rebound`: 20 % lower; `place`: 2 mm off; `late`: a further
|N(0, 40 ms)| of release. The last column is the factor of E_DTW that is told in 80 % of 50 realities.
"""


HELD_HEAD = """
The same of held cloth and foam, in their first 1.5 s, with what each cause gives alone: `place` of the driven body by
the jitter, `late` by |N(0, 40 ms)|, `noise` of 0.1 mm of each marker coordinate. These spreads are assumed: none is
published. `fitted`: noise that gives the real E_RMSE beside place and delay. Of 100 realities: `frozen`, nothing moves;
stiffness, density or friction 20 % lower; driven body 2 mm off; a further |N(0, 40 ms)| of delay.
"""


def held_lines() -> Iterator[str]:
    """Yield the table of the scatter tests of held cloth and foam."""
    yield from ("", HELD_HEAD.strip(), "")
    yield from markdown_table(
        (
            *("id", "E_RMSE", *CAUSES, "E_DTW", *CAUSES),
            *("fitted", "p", "verdict", *HELD_FAULTS),
        ),
        [
            [
                name,
                f"{pair(row.real, 'rmse')} {row.unit}",
                *(pair(one, "rmse") for one in (row.place, row.late, row.noise)),
                pair(row.real, "dtw"),
                *(pair(one, "dtw") for one in (row.place, row.late, row.noise)),
                f"{row.noise_mm:.2g} mm",
                ", ".join(f"{value:.3f}" for value in row.p.values()),
                SHORT_VERDICTS[differs([*row.p.values()])],
                *(shares(row, fault) for fault in HELD_FAULTS),
            ]
            for name, row in sorted(held_rows().items())
        ],
    )


def shares(row: ScatterRow | HeldRow, fault: str) -> str:
    """Return the percentages of realities with a fault that are refused, with the assumed starts and with all."""
    once, always = row.refused[fault], row.told[fault]
    if once is None or always is None:
        return "-"
    return f"{100.0 * once:.0f} / {100.0 * always:.0f}"


def pair(values: Mapping[str, float], name: str) -> str:
    """Return a mean with its standard deviation."""
    return f"{values[name]:g} ({values[f'{name}_std']:g})"


def scatter_lines() -> Iterator[str]:
    """Yield the table of the scatter tests of MuJoCo."""
    sizes = [
        once
        for row in scatter_rows().values()
        if (once := row.refused["none"]) is not None
    ]
    above = sum(size > LEVEL for size in sizes)
    size_line = (
        f"`none` is of one sample of runs and one of realities, so it scatters about the size of the test: its mean "
        f"over {len(sizes)} ids is {100.0 * np.mean(sizes):.1f} %, and {above} are above {100.0 * LEVEL:.0f} %."
    )
    yield from ("", SCATTER_HEAD.strip(), size_line, "")
    yield from markdown_table(
        (
            "id",
            *("E_RMSE", "MuJoCo", "E_DTW", "MuJoCo", "release", "p", "verdict"),
            *("none", "friction", "rebound", "place", "late", "factor"),
        ),
        [
            [
                name,
                f"{pair(row.real, 'rmse')} {row.unit}",
                pair(row.simulated, "rmse"),
                f"{pair(row.real, 'dtw')} {row.unit}",
                pair(row.simulated, "dtw"),
                f"{1e3 * row.release_s:.0f} ms",
                ", ".join(f"{value:.3f}" for value in row.p.values()),
                SHORT_VERDICTS[differs([*row.p.values()])],
                *(shares(row, fault) for fault in FAULTS),
                "-" if row.factor is None else f"{row.factor:g}",
            ]
            for name, row in sorted(scatter_rows().items())
        ],
    )


def sum_table(rows: Sequence[Row]) -> Iterator[str]:
    """Return how many ids have which reference, by the question that it answers."""
    count = Counter(row.used for row in rows)
    withheld = sum(row.withheld is not None for row in rows)
    events = sum(
        any(metric in ("LSD", "MTE", "PD") for metric in row.over_real.split(", "))
        for row in rows
    )
    tested = sum(row.variant in scatter_rows() for row in rows)
    untested = sum(row.scatter_answer == NOT_TESTED for row in rows)
    published = sum(row.has_scatter for row in rows)
    attached = sum(row.variant in held_rows() for row in rows)
    unknown = published - tested - attached - untested
    telling = sum(held_tells(name) for name in held_rows())
    statistics = sum(row.statistics for row in rows)
    real, solved = "is it like reality?", "does the engine solve the scene?"
    kinds = (
        (real, "trials", count[BandGrade.TRIALS], "score"),
        (real, "recording", count[BandGrade.RECORDING], "score"),
        (real, "recording, withheld", withheld, "with `use_withheld=True`"),
        (real, "scatter", tested, "verdict on repeats"),
        (
            real,
            "scatter, held",
            attached,
            f"verdict on repeats; {telling} tell a wrong constant",
        ),
        (real, "scatter, not tested", untested, "nothing yet"),
        (real, "scatter in another unit", unknown, "nothing"),
        (real, "events", events, "LSD, MTE, PD"),
        (real, "statistics", statistics, "strain, volume"),
        (solved, "law", count[BandGrade.LAW], "score"),
        (solved, "model", count[BandGrade.MODEL], "score"),
        ("neither", "none", count[BandGrade.NONE], "nothing"),
    )
    cells = [
        (one, kind, str(number), what) for one, kind, number, what in kinds if number
    ]
    return markdown_table(("question", "reference", "ids", "gives"), cells)


def short_table(rows: Sequence[Row]) -> Iterator[str]:
    """Return how many ids are scored against what, and whether that is reality."""
    count = Counter(row.used for row in rows)
    beside = len(scatter_rows()) + len(held_rows())
    statistics = sum(row.statistics for row in rows)
    kinds = (
        (BandGrade.TRIALS, "real trials: slides, drops", "yes"),
        (BandGrade.RECORDING, "a recording", "yes"),
        (BandGrade.LAW, "a law: turntables, cradle, pendulum, ramps", SCENE_ALONE),
        (BandGrade.MODEL, "a solved model: most cloth, foam", SCENE_ALONE),
        (BandGrade.NONE, "nothing: rope, funnel, wall", "no"),
    )
    cells = [(str(count[grade]), what, answer) for grade, what, answer in kinds]
    robots = (
        "0",
        "your robot's joints, cameras, grasps",
        "no: [limits](docs/limits.md)",
    )
    yield from markdown_table(("ids", "scored against", "reality?"), [*cells, robots])
    yield from (
        "",
        f"Repeats of {beside} are compared with real scatter, {statistics} with strain. An "
        "[import](docs/dataset.md) adds trials. [Coverage](docs/coverage.md): what each tells.",
    )


def unsolved_lines() -> Iterator[str]:
    """Yield why scenes have no solution."""
    if unsolved_scenes():
        yield from (
            "",
            "Why ids have no solution (their pages have statistics of the last frame):",
            "",
        )
    yield from (f"- {name}: {one.reason}." for name, one in unsolved_scenes().items())


def force_lines() -> Iterator[str]:
    """Yield how many ids have solved forces of rods and grips."""
    solved = sum(bool(solved_loads(one.name)) for one in variants())
    yield from ("", f"Forces of rods and grips are solved for {solved} ids.")


def deformation_lines() -> Iterator[str]:
    """Yield the real statistics of deformation, by the ids that share them."""
    sharing: dict[str, list[str]] = defaultdict(list)
    for variant in variants():
        reference = deformation_reference(load_experiment(variant))
        if reference is not None:
            rows = [asdict(one) for one in real_statistics(reference)]
            sharing[deformation_text(rows)].append(variant.name)
    yield from (
        "",
        "Real deformation, with which runs of these ids are compared ([statistics](scores.md#deformation-of-foam)):",
        "",
    )
    yield from (f"- {', '.join(names)}: {text}." for text, names in sharing.items())


def contents() -> dict[Path, str]:
    """Return the pages with their generated parts replaced."""
    rows = [coverage(variant) for variant in variants()]
    shorter = {
        ROOT / "README.md": "\n".join(short_table(rows)),
        ROOT / "docs" / "scores.md": "\n".join(sum_table(rows)),
    }
    pages = page_part(PAGE, "coverage", SCRIPT, coverage_markdown(rows))
    for file, part in shorter.items():
        pages |= page_part(file, SUM_NAME, SCRIPT, part)
    return pages
