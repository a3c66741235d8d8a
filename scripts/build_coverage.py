"""Write which reference each id has: all in `docs/coverage.md`, counts in `README.md`.

The table leaves out imported trials, which differ between users: `gauge list references` reports those.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gauge_envs import load_experiment, reference_band
from gauge_envs.experiments.variants import Variant, variants
from gauge_envs.references.band import recorded_events
from gauge_envs.references.kind import Kind
from gauge_envs.references.metrics import EVENT_METRICS
from gauge_envs.references.published import published_baselines
from scripts.generated import ROOT, markdown_table, page_part

SCRIPT = f"scripts/{Path(__file__).name}"
PAGE = ROOT / "docs" / "coverage.md"

HEAD = """
| column | meaning |
| --- | --- |
| kind | what the reference motion is; `none` is no motion |
| unit | unit of the distance, of markers where these are compared |
| known | frames with a known mean, of all frames of the experiment |
| u | standard uncertainty of the reference motion, in the unit |
| events | events with a real value: published LSD, MTE and PD, and those measured in recordings |
"""

QUESTIONS = {
    Kind.TRIALS: ("is it like reality?", "real trials: slides, drops, a cradle"),
    Kind.RECORDING: ("is it like reality?", "one recorded real trial"),
    Kind.ANALYTIC: (
        "does the engine solve the scene?",
        "an analytical solution: turntables, pendulum, ramps, foam",
    ),
    Kind.NUMERICAL: (
        "does the engine solve the scene?",
        "a numerical solution: most cloth, foam",
    ),
    Kind.NONE: ("neither", "nothing: rope, funnel, wall"),
}
"""Question that a score answers, and what it is a distance from, by kind of reference."""


@dataclass(frozen=True)
class Row:
    """The reference of one variant; each field is what its column says."""

    variant: str
    kind: Kind
    unit: str
    known: str
    uncertainty: str
    event_count: int

    def cells(self) -> list[str]:
        """Cells of the table."""
        events = str(self.event_count or "-")
        return [
            self.variant,
            self.kind.value,
            self.unit,
            self.known,
            self.uncertainty,
            events,
        ]


def coverage(variant: Variant) -> Row:
    """Return the reference of one variant."""
    experiment = load_experiment(variant)
    band = reference_band(experiment)
    baselines = published_baselines(variant.name)
    published = [one for one in EVENT_METRICS if one in baselines]
    kind, unit, known, uncertainty = Kind.NONE, "-", "-", "-"
    if band is not None:
        kind, unit = band.kind, band.compared.unit
        known = f"{band.compared.known.sum()} of {experiment.frame_count}"
        uncertainty = f"{band.standard_uncertainty:.2g}"
    return Row(
        variant=variant.name,
        kind=kind,
        unit=unit,
        known=known,
        uncertainty=uncertainty,
        event_count=len(published) + len(recorded_events(variant.name)),
    )


def coverage_markdown(rows: Sequence[Row]) -> str:
    """Return the text of the block."""
    head = ("id", "kind", "unit", "known", "u", "events")
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
    count = Counter(row.kind for row in rows)
    cells = [
        (question, kind.value, what, str(count[kind]))
        for kind, (question, what) in QUESTIONS.items()
    ]
    with_events = str(sum(row.event_count > 0 for row in rows))
    cells.append(("is it like reality?", "any", "real values of events", with_events))
    yield from markdown_table(("question", "kind", "compared with", "ids"), cells)


def short_table(rows: Sequence[Row]) -> Iterator[str]:
    """Return how many ids are compared with what."""
    count = Counter(row.kind for row in rows)
    cells = [(str(count[kind]), what) for kind, (_, what) in QUESTIONS.items()]
    yield from markdown_table(("ids", "compared with"), cells)


def contents() -> dict[Path, str]:
    """Return the pages with their generated parts replaced."""
    rows = [coverage(variant) for variant in variants()]
    pages = page_part(PAGE, "coverage", SCRIPT, coverage_markdown(rows))
    short = "\n".join(short_table(rows))
    pages |= page_part(ROOT / "README.md", "references", SCRIPT, short)
    return pages
