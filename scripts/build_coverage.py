"""Write the table of coverage in `docs/coverage.md`: what each id is measured against and driven by in the package.

The table leaves out imported trials, which differ between users: `gauge list references` reports those.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gauge_envs import load_experiment, reference_band
from gauge_envs.evaluation.deviation import normalizing_baselines
from gauge_envs.evaluation.power import reference_power
from gauge_envs.evaluation.reference import reward_band
from gauge_envs.experiments.variants import Variant, variants
from gauge_envs.references.bands import Band, bundled_band
from gauge_envs.references.deformation import bundled_deformation
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.models import unsolved_scenes
from gauge_envs.references.published import published_baselines
from scripts.generated import ROOT, SCORING, markdown_table, with_part

SCRIPT = f"scripts/{Path(__file__).name}"
PAGE = ROOT / "docs" / "coverage.md"

HEAD = """
| column | meaning |
| --- | --- |
| band | grade of the band in use; a *withheld* recording, which is used only if you ask for it; `statistics` |
| known | frames with a known mean, of all frames of the experiment; in brackets, frames known in every coordinate |
| sigma | source of the scatter: `trials`, the published `baseline`, the uncertainty of the `measurement` or `model` |
| driver | source of the motion of the driven body; `-` where nothing is driven |
| normalized | scores that are divided by the published score of real trials; `no` without a band or a published score |
| tells | changes of the scene that the band tells: distances over what the band leaves open, of 5 or more |

`known` and `sigma` are those of the band in use, or of the withheld band if none is in use. A law of a carried, held or
strained body covers every frame. Other laws end at an event, as the first contact of a free flight. Scores against
these are not normalized, because the published baseline covers the whole motion. `end`: engines disagree, and the mean
height at the last frame is rewarded, but nothing is scored. `statistics` are those of the
deformation of foam, which are not scored.
"""
SCORED = (BandGrade.TRIALS, BandGrade.RECORDING, BandGrade.LAW, BandGrade.MODEL)


@dataclass(frozen=True)
class Row:
    """Coverage of one variant; each field is what its column says."""

    variant: str
    used: BandGrade
    withheld: str | None
    statistics: bool
    known: str
    sigma: str
    driver: str
    normalized: str
    tells: str

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
            self.sigma,
            self.driver,
            self.normalized,
            self.tells,
        ]


def coverage(variant: Variant) -> Row:
    """Return what the package holds for one variant."""
    experiment = load_experiment(variant)
    measured, used = bundled_band(variant.name), reference_band(experiment)
    rewarded = reward_band(experiment, used)
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
        used=BandGrade.NONE if rewarded is None else rewarded.grade,
        withheld=None if measured is None else measured.withheld,
        statistics=bundled_deformation(variant.name) is not None,
        known="-"
        if band is None
        else f"{known_frames(band)} of {experiment.frame_count}",
        sigma="-" if band is None else band.sigma_source.value,
        driver=experiment.driver_provenance or "-",
        normalized=", ".join(metric.upper() for metric in metrics) or "no",
        tells="-"
        if power is None
        else ", ".join(f"{name} {size:.0f}" for name, size in power.told.items()),
    )


def known_frames(band: Band) -> str:
    """Count the frames at which a band has a mean, and, where fewer, those with a mean in every coordinate."""
    known = np.isfinite(band.mean)
    some, full = known.any(axis=1).sum(), known.all(axis=1).sum()
    return str(some) if full == some else f"{some} ({full} in full)"


def coverage_markdown(rows: Sequence[Row]) -> str:
    """Return the text of the block."""
    count = Counter(row.used for row in rows)
    withheld = [row for row in rows if row.withheld is not None]
    drivers = Counter(row.driver for row in rows)
    lines = [HEAD.strip(), "", f"{len(rows)} ids:", ""]
    lines += [f"- {grade.value}: {count[grade]} scored on" for grade in SCORED]
    lines += [f"- end: {count[BandGrade.END]}, rewarded at the last frame, not scored"]
    lines += [
        f"- none: {count[BandGrade.NONE]}",
        f"- recording, withheld: {len(withheld)}, of which {sum(row.used is BandGrade.LAW for row in withheld)} are "
        "scored on a law",
        f"- statistics of deformation: {sum(row.statistics for row in rows)}",
        f"- drivers: {', '.join(f'{drivers[name]} {name}' for name in sorted(drivers) if name != '-')}",
        "",
        *markdown_table(
            ("id", "band", "known", "sigma", "driver", "normalized", "tells"),
            [row.cells() for row in rows],
        ),
        "",
        "Why bands are withheld:",
        "",
    ]
    reasons: dict[str, list[str]] = {}
    for row in rows:
        if row.withheld:
            reasons.setdefault(row.withheld, []).append(row.variant)
    lines += [f"- {', '.join(names)}: {reason}." for reason, names in reasons.items()]
    return "\n".join([*lines, *unsolved_lines()])


def unsolved_lines() -> Iterator[str]:
    """Yield why scenes have no solution."""
    if unsolved_scenes():
        yield from (
            "",
            "Why ids have no solution (their pages have statistics of the last frame):",
            "",
        )
    yield from (f"- {name}: {one.reason}." for name, one in unsolved_scenes().items())


def contents(scoring: Path = SCORING) -> dict[Path, str]:
    """Return the page with its generated part replaced."""
    block = coverage_markdown([coverage(variant) for variant in variants()])
    page = PAGE.read_text(encoding="utf-8")
    return {PAGE: with_part(page, "coverage", SCRIPT, block)}
