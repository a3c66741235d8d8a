"""What the pages of a site show: configurations with their names, colours and files, and scores in words."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from pathlib import Path

from gauge_envs.errors import GaugeError
from gauge_envs.experiments.experiment import TaskExperiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.pages.html import Html, element, join, slug
from gauge_envs.pages.results import configuration_labels
from gauge_envs.pages.text import ALIGNED_TITLE, METRIC_TITLES, score_text
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.tools.compare.comparison import Cell, Comparison, ExperimentComparison
from gauge_envs.tools.compare.scores import COMPARED_METRICS

Interval = tuple[float, float]

COLOR_COUNT = 6
"""Colours of configurations in the style of the pages; further ones repeat them."""

TITLES: Mapping[str, str] = {**METRIC_TITLES, "rmse_aligned": ALIGNED_TITLE}
"""Title of each compared metric."""


class Standing(StrEnum):
    """Standing of a normalized score stands to that of the real trials, by its interval."""

    NEAR = "near"
    """The whole interval is below 1."""
    EVEN = "even"
    """The interval holds 1."""
    FAR = "far"
    """The whole interval is above 1."""


STANDING_TEXTS = {
    Standing.NEAR: "below 1",
    Standing.EVEN: "1 is in the interval",
    Standing.FAR: "above 1",
}

STANDING_MARKS = {Standing.NEAR: "\u2713", Standing.EVEN: "\u2248", Standing.FAR: "\u25b2"}


def standing_of(interval: Sequence[float]) -> Standing:
    """Return how an interval of a normalized score lies to 1, the mean score of the real trials."""
    low, high = interval
    return Standing.NEAR if high < 1.0 else Standing.FAR if low > 1.0 else Standing.EVEN


def badge(standing: Standing) -> Html:
    """Return the badge of a standing: a sign and words, so that the colour alone says nothing."""
    kinds = {Standing.NEAR: "inside", Standing.EVEN: "visible", Standing.FAR: "wrong"}
    return element("span", f"{STANDING_MARKS[standing]} {STANDING_TEXTS[standing]}", class_=f"badge {kinds[standing]}")


def whisker_text(value: float, interval: Sequence[float] | None) -> Html:
    """Return a score with its 95 % interval below it."""
    parts = [element("span", score_text(value), class_="value")]
    if interval is not None:
        parts.append(element("span", f"[{score_text(interval[0])}, {score_text(interval[1])}]", class_="quiet block"))
    return join(parts)


@dataclass(frozen=True, kw_only=True)
class Site:
    """Results side by side, and the names under which the pages show them.

    Attributes:
        comparison: The results.
        files: Result file of each result, by the identity of the result.
    """

    comparison: Comparison
    files: Mapping[int, Path]

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Label of each configuration."""
        return tuple(configuration_labels(self.comparison.configurations))

    @cached_property
    def slugs(self) -> tuple[str, ...]:
        """Part of a file name for each configuration; no two are the same."""
        return tuple(f"{index}-{slug(label)}" for index, label in enumerate(self.labels))

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

    def experiment_link(self, one: ExperimentComparison) -> Html:
        """Return a link to the page of an experiment."""
        # A narrow column may break a long name between its words.
        first, *others = re.split(r"(?<=[a-z])(?=[A-Z])", one.name)
        broken = join([first, *(join([element("wbr"), word]) for word in others)])
        return element("a", broken, href=self.experiment_page(one))

    def configuration_link(self, index: int) -> Html:
        """Return a link to the page of the engine of a configuration, with its label."""
        name = self.comparison.configurations[index].backend or "file"
        return join([self.swatch(index), element("a", self.labels[index], href=self.engine_page(name))])

    @staticmethod
    def color(index: int) -> str:
        """Return the colour of a configuration in CSS."""
        return f"var(--c{index % COLOR_COUNT})"

    def swatch(self, index: int) -> Html:
        """Return a piece of the colour of a configuration."""
        return element("span", Html(""), class_="swatch", style=f"background:{self.color(index)}")

    @staticmethod
    def family(one: ExperimentComparison) -> tuple[str, str]:
        """Return the phenomenon of an experiment and what it tests; the name alone for an experiment file."""
        try:
            experiment = load_experiment(one.name)
        except GaugeError:
            return one.name, ""
        if not isinstance(experiment, TaskExperiment):
            return one.name, ""
        return experiment.spec.title, ", ".join(experiment.spec.evaluates)


def first_result(cell: Cell | None) -> Result | None:
    """Return the first result of a cell that ran; None without one."""
    return None if cell is None else next((one for one in cell.results if one.error is None), None)


def score_cell(one: ExperimentComparison, cell: Cell | None, metric: str) -> Html:
    """Return mean and interval of a metric in one experiment, a badge for the primary one, or why there is no score."""
    if cell is None:
        return element("span", "not run", class_="quiet")
    known = COMPARED_METRICS[metric]
    spread = cell.spread(known, normalized=True)
    interval = cell.interval_95(known)
    parts: list[Html] = []
    if spread is not None:
        parts.append(whisker_text(spread.mean, interval))
        if interval is not None and metric == one.primary:
            parts.append(badge(standing_of(interval)))
    elif (raw := cell.spread(known, normalized=False)) is not None:
        unit = one.unit if known.unit is None else known.unit
        parts.append(element("span", f"{score_text(raw.mean)}{'' if unit == '1' else f' {unit}'}", class_="value"))
    for outcome in (Outcome.DIVERGED, Outcome.FAILED, Outcome.DECLINED):
        if count := cell.count(outcome):
            text = outcome.value if count == len(cell.results) else f"{count} {outcome.value}"
            parts.append(element("span", text, class_="badge declined"))
    return join(parts, " ") if parts else element("span", "no score", class_="quiet")
