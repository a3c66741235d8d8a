"""Write which reference each id has: all in `docs/coverage.md`, counts in `docs/scores.md` and in `README.md`.

The table leaves out imported trials, which differ between users: `gauge list references` reports those.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gauge_envs import load_experiment, reference_band
from gauge_envs.experiments.variants import Variant, variants
from gauge_envs.references.band import Band, bundled_band
from gauge_envs.references.deformation import bundled_deformation
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import published_baselines
from gauge_envs.scoring.verification import solution_uncertainty, verification_band
from scripts.generated import ROOT, markdown_table, page_part

SCRIPT = f"scripts/{Path(__file__).name}"
PAGE = ROOT / "docs" / "coverage.md"

HEAD = """
| column | meaning |
| --- | --- |
| reference | kind of the band in use; a *withheld* recording, used only if asked; `events`, `statistics`: see below |
| unit | unit of the distance, of markers where these are compared |
| known | frames with a known mean, of all frames of the experiment |
| u | standard uncertainty of a solution, or `exact` |

`events` have published real values, as LSD, MTE and PD. `statistics` are real strains and volumes of foam.
"""

SUM_NAME = "references"
"""Name of the part with the numbers of ids by their references, in the other pages."""

EVENTS = ("lsd", "mte", "pd")
"""Metrics of events that are divided by a published real value."""


@dataclass(frozen=True)
class Row:
    """The reference of one variant; each field is what its column says."""

    variant: str
    used: Kind
    is_withheld: bool
    has_events: bool
    has_statistics: bool
    unit: str
    known: str
    uncertainty: str

    def cells(self) -> list[str]:
        """Cells of the table."""
        kinds = [] if self.used is Kind.NONE else [self.used.value]
        kinds += ["recording, *withheld*"] if self.is_withheld else []
        kinds += ["events"] if self.has_events else []
        kinds += ["statistics"] if self.has_statistics else []
        return [
            self.variant,
            "; ".join(kinds) or self.used.value,
            self.unit,
            self.known,
            self.uncertainty,
        ]


def coverage(variant: Variant) -> Row:
    """Return the reference of one variant."""
    experiment = load_experiment(variant)
    measured, used = bundled_band(variant.name), reference_band(experiment)
    baselines = published_baselines(variant.name)
    unit = known = uncertainty = "-"
    if used is not None:
        compared = verification_band(used) or used
        count = int(np.isfinite(compared.mean).any(axis=1).sum())
        unit, known = compared.unit, f"{count} of {experiment.frame_count}"
        uncertainty = uncertainty_text(used)
    return Row(
        variant=variant.name,
        used=Kind.NONE if used is None else used.grade,
        is_withheld=measured is not None and measured.withheld is not None,
        has_events=any(
            metric in baselines and baselines[metric].mean for metric in EVENTS
        ),
        has_statistics=bundled_deformation(variant.name) is not None,
        unit=unit,
        known=known,
        uncertainty=uncertainty,
    )


def uncertainty_text(band: Band) -> str:
    """Return u of a solution; `-` for other references."""
    compared = verification_band(band)
    if compared is None:
        return "-"
    uncertainty = solution_uncertainty(band)
    return "exact" if uncertainty is None else f"{uncertainty:.2g} {compared.unit}"


def coverage_markdown(rows: Sequence[Row]) -> str:
    """Return the text of the block."""
    head = ("id", "reference", "unit", "known", "u")
    lines = [
        *sum_table(rows),
        "",
        HEAD.strip(),
        "",
        *markdown_table(head, [row.cells() for row in rows]),
    ]
    return "\n".join(lines)


def sum_table(rows: Sequence[Row]) -> Iterator[str]:
    """Return how many ids have which reference, by the question that it answers."""
    count = Counter(row.used for row in rows)
    real, solved = "is it like reality?", "does the engine solve the scene?"
    kinds = (
        (real, "trials", count[Kind.TRIALS]),
        (real, "recording", count[Kind.RECORDING]),
        (real, "recording, withheld", sum(row.is_withheld for row in rows)),
        (real, "events", sum(row.has_events for row in rows)),
        (real, "statistics", sum(row.has_statistics for row in rows)),
        (solved, "law", count[Kind.ANALYTIC]),
        (solved, "model", count[Kind.NUMERICAL]),
        ("neither", "none", count[Kind.NONE]),
    )
    cells = [(one, kind, str(number)) for one, kind, number in kinds if number]
    return markdown_table(("question", "reference", "ids"), cells)


def short_table(rows: Sequence[Row]) -> Iterator[str]:
    """Return how many ids are scored against what."""
    count = Counter(row.used for row in rows)
    kinds = (
        (Kind.TRIALS, "real trials: slides, drops"),
        (Kind.RECORDING, "a recording of one real trial"),
        (Kind.ANALYTIC, "an analytical solution: turntables, cradle, pendulum, ramps"),
        (Kind.NUMERICAL, "a numerical solution: most cloth, foam"),
        (Kind.NONE, "nothing: rope, funnel, wall"),
    )
    yield from markdown_table(
        ("ids", "scored against"), [(str(count[grade]), what) for grade, what in kinds]
    )


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
