"""Common parts of the pages of a site: names, colours and files of configurations, and texts of scores."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from gauge_envs.pages.document import Heading, Paragraph, Part, Tone
from gauge_envs.pages.figures import color_of
from gauge_envs.pages.html import Html, below, element, join, slug
from gauge_envs.pages.page import page
from gauge_envs.pages.table import Table
from gauge_envs.pages.text import score_text, with_unit
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scoring.score import OVER_U
from gauge_envs.tools.compare import Cell, Comparison, ExperimentComparison

UNSCORED = (Outcome.DIVERGED, Outcome.FAILED, Outcome.UNSUPPORTED)
"""Outcomes without a score."""

COLORS = {"inside": "near", "outside": "far"}
"""CSS class of cells with equal verdicts; the class of mixed verdicts is `even`."""


@dataclass(frozen=True, kw_only=True)
class Site:
    """Comparison of results, and the names of configurations on pages.

    Attributes:
        comparison: The results.
        files: Result file of each result, by the identity of the result.
        command: Command of the site.
    """

    comparison: Comparison
    files: Mapping[int, Path]
    command: str

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Label of each configuration; presets appear without `preset=`."""
        return tuple(label.replace("preset=", "") for label in self.comparison.labels)

    @cached_property
    def names(self) -> tuple[Html, ...]:
        """Label of each configuration after a sample of its line, with a note on its physics below."""
        return tuple(
            join([self.swatch(index), self.labels[index], below(configuration.physics)])
            for index, configuration in enumerate(self.comparison.configurations)
        )

    @staticmethod
    def swatch(index: int) -> Html:
        """Return a sample of the line of a configuration."""
        color, is_dashed = color_of(index)
        dashes = f"repeating-linear-gradient(90deg,{color} 0 .35rem,transparent .35rem .525rem)"
        background = dashes if is_dashed else color
        return element("span", class_="swatch", style=f"background:{background}")


def page_file(experiment: ExperimentComparison) -> str:
    """Return the file name of the page of an experiment."""
    return f"experiment-{slug(experiment.name)}.html"


def site_page(title: str, parts: Iterable[Part], scripts: Sequence[str] = ()) -> str:
    """Return a page of the site; its scripts run in order."""
    overview = element("nav", element("a", "Overview", href="index.html"))
    return page(title, parts, above=overview, style="assets/site.css", scripts=scripts)


def section(title: str, table: Table, *notes: str) -> list[Part]:
    """Return a table with title and notes; nothing without rows."""
    if not table.rows:
        return []
    return [Heading(title), table, *(Paragraph(note, Tone.NOTE) for note in notes)]


def first_results(experiment: ExperimentComparison) -> dict[int, Result]:
    """Return the first result of each configuration that ran an experiment, by index of the configuration."""
    ran = (
        (index, result)
        for index, cell in enumerate(experiment.cells)
        for result in reversed(cell.results if cell else ())
        if result.error is None
    )
    return dict(ran)


# --- scores ---


def verdict_of(*cells: Cell) -> tuple[str, Html | None]:
    """Return CSS class and badge for the verdicts of cells; nothing without a verdict."""
    verdicts = [
        cell.verdict for cell in cells if cell.verdict not in ("", "no reference")
    ]
    if not verdicts:
        return "", None
    text = verdicts[0]
    if len(verdicts) > 1:
        text = f"{verdicts.count('inside')} of {len(verdicts)} inside"
    is_unanimous = len(set(verdicts)) == 1
    color = COLORS.get(verdicts[0], "even") if is_unanimous else "even"
    return color, element("span", text, class_=f"badge {color}")


def score_html(value: float, interval: Sequence[float] | None, unit: str = "1") -> Html:
    """Return a score with its unit, and its 95 % interval below."""
    score = element("span", with_unit(score_text(value), unit), class_="value")
    if interval is None:
        return score
    low, high = map(score_text, interval)
    return join([score, below(f"[{low}, {high}]")])


def score_cell(
    experiment: ExperimentComparison, cell: Cell | None, metric: str
) -> Html:
    """Return mean and interval of a metric, with a badge if it is primary, or the reason for a missing score."""
    if cell is None:
        return element("span", "not run", class_="quiet")
    parts: list[Html | None] = []
    if scaled := cell.spread(metric, normalized=True):
        unit = "u" if metric == OVER_U else "1"
        parts.append(score_html(scaled.mean, cell.interval_95(metric), unit))
    elif raw := cell.spread(metric, normalized=False):
        parts.append(score_html(raw.mean, None, experiment.unit_of(metric)))
    if metric == experiment.primary:
        parts.append(verdict_of(cell)[1])
        refused = {result.score.refused for result in cell.results} - {None}
        parts += [element("span", reason, class_="quiet") for reason in refused]
    parts += [
        element("span", text, class_="badge unsupported") for text in losses(cell)
    ]
    shown = [part for part in parts if part is not None]
    return join(shown, " ") if shown else element("span", "no score", class_="quiet")


def losses(*cells: Cell) -> list[str]:
    """Return the number of results of each outcome without a score, for example `2 diverged`."""
    counts = {
        outcome: sum(cell.count(outcome) for cell in cells) for outcome in UNSCORED
    }
    return [f"{count} {outcome.value}" for outcome, count in counts.items() if count]
