"""What the pages of a site share: configurations with their names, colours and files, and scores in words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from gauge_envs.errors import GaugeError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.pages.document import Heading, Paragraph, Part, Tone
from gauge_envs.pages.figures import color_of
from gauge_envs.pages.html import Html, below, element, join, slug
from gauge_envs.pages.page import page
from gauge_envs.pages.table import Table
from gauge_envs.pages.text import score_text, with_unit
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scoring.score import OVER_U
from gauge_envs.tools.compare import Cell, Comparison, ExperimentComparison

Results = Mapping[int, Result]
"""First result of each configuration that ran, by its index."""

Parts = list[Part]

LOST = (Outcome.DIVERGED, Outcome.FAILED, Outcome.DECLINED)
"""Outcomes without a score."""


SHARES = {"inside": ("near", "inside"), "outside": ("far", "wrong")}
"""Classes of a cell and of a badge whose experiments all have a verdict; others are between."""


def standing(cells: Iterable[Cell | None]) -> tuple[str, Html | None]:
    """Return the class of a cell over experiments, and a badge with their verdicts; nothing without a verdict."""
    words = [cell.verdict for cell in cells if cell is not None and cell.verdict]
    known = [word for word in words if word != "no reference"]
    if not known:
        return "", None
    text = known[0]
    if len(known) > 1:
        text = f"{known.count('inside')} of {len(known)} inside"
    same = known[0] if len(set(known)) == 1 else ""
    style, look = SHARES.get(same, ("even", "visible"))
    return style, element("span", text, class_=f"badge {look}")


def whisker_text(
    value: float, interval: Sequence[float] | None, unit: str = "1"
) -> Html:
    """Return a score in a unit with its 95 % interval below it."""
    score = element("span", with_unit(score_text(value), unit), class_="value")
    return (
        score
        if interval is None
        else join(
            [score, below(f"[{score_text(interval[0])}, {score_text(interval[1])}]")]
        )
    )


def section(title: str, table: Table, *notes: str) -> list[Part]:
    """Return a table below its title, with notes below it; nothing without rows."""
    return (
        [Heading(title), table, *(Paragraph(note, Tone.NOTE) for note in notes)]
        if table.rows
        else []
    )


def site_page(
    title: str, parts: Iterable[Part], *, here: str, scripts: Sequence[str] = ()
) -> str:
    """Return a page of the site; the navigation marks its file name, and its scripts run in their order."""
    pages = {"index.html": "Overview", "reproduce.html": "How to reproduce"}
    links = (
        element("a", text, href=file, aria_current="page" if file == here else None)
        for file, text in pages.items()
    )
    return page(
        title,
        parts,
        above=element("nav", *links),
        style="assets/site.css",
        scripts=scripts,
    )


@dataclass(frozen=True, kw_only=True)
class Site:
    """Results side by side, and the names under which the pages show them.

    Attributes:
        comparison: The results.
        files: Result file of each result, by the identity of the result.
    """

    comparison: Comparison
    files: Mapping[int, Path]

    @property
    def labels(self) -> tuple[str, ...]:
        """Label of each configuration; a preset is known by its name alone."""
        return tuple(label.replace("preset=", "") for label in self.comparison.labels)

    @cached_property
    def slugs(self) -> tuple[str, ...]:
        """Part of a file name for each configuration; no two are the same."""
        return tuple(
            f"{index}-{slug(label)}" for index, label in enumerate(self.labels)
        )

    @cached_property
    def engines(self) -> dict[str, list[int]]:
        """Indices of the configurations of each engine, by its name."""
        found: dict[str, list[int]] = {}
        for index, one in enumerate(self.comparison.configurations):
            found.setdefault(one.backend or "file", []).append(index)
        return found

    def engine_page(self, name: str) -> str:
        """Return the file name of the page of an engine."""
        return f"engine-{list(self.engines).index(name)}-{slug(name)}.html"

    @staticmethod
    def experiment_page(one: ExperimentComparison) -> str:
        """Return the file name of the page of an experiment."""
        return f"experiment-{slug(one.name)}.html"

    def experiment_link(self, one: ExperimentComparison, *notes: str | Html) -> Html:
        """Return a link to the page of an experiment, with quiet lines below it."""
        # A narrow column may break a long name between its words.
        words = re.split(r"(?<=[a-z])(?=[A-Z])", one.name)
        broken = [part for word in words for part in (element("wbr"), word)][1:]
        return join(
            [element("a", *broken, href=self.experiment_page(one)), *map(below, notes)]
        )

    @cached_property
    def links(self) -> tuple[Html, ...]:
        """Link of each configuration to the page of its engine, with its label."""
        names = [one.backend or "file" for one in self.comparison.configurations]
        return tuple(
            join(
                [
                    self.swatch(index),
                    element("a", self.labels[index], href=self.engine_page(name)),
                ]
            )
            for index, name in enumerate(names)
        )

    @cached_property
    def headings(self) -> tuple[Html, ...]:
        """Link of each configuration, with whose physics it is below."""
        physics = (one.physics for one in self.comparison.configurations)
        return tuple(
            join([link, below(text)])
            for link, text in zip(self.links, physics, strict=True)
        )

    def swatch(self, index: int) -> Html:
        """Return a piece of the line of a configuration."""
        color, is_dashed = color_of(index)
        dashes = f"repeating-linear-gradient(90deg,{color} 0 .35rem,transparent .35rem .525rem)"
        return element(
            "span",
            class_="swatch",
            style=f"background:{dashes if is_dashed else color}",
        )

    @staticmethod
    def family(one: ExperimentComparison) -> tuple[str, str]:
        """Return the phenomenon of an experiment and what it tests; the name alone for one that is not installed."""
        try:
            experiment = load_experiment(one.name)
        except GaugeError:
            return one.name, ""
        return experiment.spec.title, ", ".join(experiment.spec.evaluates)


def first_result(cell: Cell | None) -> Result | None:
    """Return the first result of a cell that ran; None without one."""
    return (
        None
        if cell is None
        else next((one for one in cell.results if one.error is None), None)
    )


def first_results(one: ExperimentComparison) -> dict[int, Result]:
    """Return the first result of each configuration that ran an experiment, by its index."""
    return {
        index: result
        for index, cell in enumerate(one.cells)
        if (result := first_result(cell)) is not None
    }


def score_cell(one: ExperimentComparison, cell: Cell | None, metric: str) -> Html:
    """Return mean and interval of a metric in one experiment, a badge for the primary one, or why there is no score."""
    if cell is None:
        return element("span", "not run", class_="quiet")
    spread, raw = (
        cell.spread(metric, normalized=normalized) for normalized in (True, False)
    )
    parts: list[Html] = []
    if spread is not None:
        unit = "u" if metric == OVER_U else "1"
        parts.append(whisker_text(spread.mean, cell.interval_95(metric), unit))
    elif raw is not None:
        parts.append(whisker_text(raw.mean, None, one.unit_of(metric)))
    if metric == one.primary:
        badge = standing([cell])[1]
        parts += [] if badge is None else [badge]
        refused = {result.score.refused for result in cell.results} - {None}
        parts += [element("span", str(reason), class_="quiet") for reason in refused]
    for outcome in LOST:
        if count := cell.count(outcome):
            text = (
                outcome.value
                if count == len(cell.results)
                else f"{count} {outcome.value}"
            )
            parts.append(element("span", text, class_="badge declined"))
    return join(parts, " ") if parts else element("span", "no score", class_="quiet")
