"""Bars of the scores of one experiment, on one scale for each question, with the published scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from gauge_envs.pages.figures import ENGINES, REAL, tidy_axis
from gauge_envs.pages.results import (
    ALIGNED,
    SCORE_METRICS,
    VERIFIED,
    score_text_of,
)
from gauge_envs.pages.text import (
    QUESTIONS,
    interval_text,
    score_text,
    short_id,
)
from gauge_envs.references.published import PUBLISHED_ENGINES, published_baselines
from gauge_envs.scoring.score import COVERAGE_FACTOR
from gauge_envs.tools.compare.comparison import Cell
from gauge_envs.tools.compare.panels import Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes


WHISKER: dict[str, Any] = {"ecolor": REAL, "elinewidth": 1.0, "capsize": 2.0}
BACKING: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}

VALIDATION = "over real trials"
"""Scale of bars: 1 is the mean of real trials, or the real value of an event."""
LEAST_REACH = {VALIDATION: 1.2, "u": 1.2 * COVERAGE_FACTOR}
"""Value that the axis of a scale reaches at least, so that it has the line that bars are compared with."""


@dataclass(frozen=True)
class Bar:
    """A score over its scale.

    Attributes:
        label: Its configuration or engine.
        color: Its colour.
        text: The score in words, or why there is none.
        value: The score; 0 without one.
        ends: Ends of the whisker: the 95 % interval of a single run, or one standard deviation of repeats.
    """

    label: str
    color: str
    text: str
    value: float = 0.0
    ends: tuple[float, float] = (0.0, 0.0)


def bar_groups(name: str, series: Sequence[Series]) -> dict[str, dict[str, list[Bar]]]:
    """Return bars by their scale and their metric.

    On the scale `VALIDATION` are the metrics of the paper, with the published engines. Distances from a solution have
    the scale `u`.
    """
    groups: dict[str, list[Bar]] = {}
    scores = [result.score for one in series for result in one.results]
    is_solved = any(one.over_uncertainty is not None for one in scores)
    if any(one.primary == ALIGNED.key for one in scores):
        groups[ALIGNED.title] = [_own_bar(one, ALIGNED.key) for one in series]
    for metric, line in published_baselines(short_id(name)).items():
        # Published scores are distances from real trials; those from a solution are numerical errors.
        if metric == "el" or (is_solved and not SCORE_METRICS[metric].is_event):
            continue
        bars = [_own_bar(one, metric) for one in series]
        for (engine, title), color in zip(
            PUBLISHED_ENGINES.items(), ENGINES, strict=True
        ):
            value = line.engines[engine]
            text = "not published" if value is None else score_text(value)
            place = value or 0.0
            bars.append(Bar(f"{title}, paper", color, text, place, (place, place)))
        groups[SCORE_METRICS[metric].title] = bars
    scales: dict[str, dict[str, list[Bar]]] = {}
    if is_solved:
        scales["u"] = {VERIFIED.title: [_own_bar(one, VERIFIED.key) for one in series]}
    return scales | ({VALIDATION: groups} if groups else {})


def _own_bar(one: Series, metric: str) -> Bar:
    cell = Cell(results=one.results)
    spread = cell.spread(metric, normalized=True)
    if spread is None:
        is_diverged = any(result.diverged for result in one.results)
        text = "diverged" if is_diverged else score_text_of(one.first.score, metric)
        if one.first.score.refused is not None:
            text = "not scored"
        return Bar(one.label, one.color, text)
    reach, text = spread.std or 0.0, score_text(spread.mean)
    ends = (spread.mean - reach, spread.mean + reach)
    if reach:
        text += f" +- {score_text(reach)}"
    elif (interval := cell.interval_95(metric)) is not None:
        ends, text = interval, interval_text(spread.mean, interval)
    return Bar(one.label, one.color, text, spread.mean, ends)


def draw_bars(
    axis: Axes, groups: dict[str, list[Bar]], *, depth: float, least: float
) -> None:
    """Draw bars from the top down.

    Args:
        axis: The axis.
        groups: Bars by metric.
        depth: Least number of bars that fits, so that no bar is thick.
        least: Least value that the axis reaches.
    """
    every = [bar for group in groups.values() for bar in group]
    longest = max(least, 1e-9, *(max(bar.value, bar.ends[1]) for bar in every))
    unit = 0.015 * longest
    ticks, places = [], []
    place = 0.0
    for metric, group in groups.items():
        axis.text(
            unit,
            place - 0.75,
            metric,
            fontsize=9,
            fontweight="bold",
            va="center",
            bbox=BACKING,
        )
        for bar in group:
            low, high = bar.ends
            # The end of an interval may be the score itself, but for its last digit.
            whisker = (
                [[max(bar.value - low, 0.0)], [max(high - bar.value, 0.0)]]
                if low < high
                else None
            )
            axis.barh(
                place,
                bar.value,
                color=bar.color,
                height=0.78,
                xerr=whisker,
                error_kw=WHISKER,
            )
            end = max(bar.value, high) + unit
            axis.text(
                end,
                place,
                bar.text,
                va="center",
                fontsize=8,
                color="#404040",
                bbox=BACKING,
            )
            places.append(place)
            # The legend of the curves has the whole name.
            lines = wrap(bar.label, 22, max_lines=2, placeholder=" ...")
            ticks.append("\n".join(lines))
            place += 1.0
        place += 1.1
    axis.set_yticks(places, ticks, fontsize=8)
    axis.set_ylim(max(place - 1.3, depth), -1.3)
    axis.set_xlim(0.0, 1.6 * longest)
    tidy_axis(axis)
    axis.grid(visible=False, axis="y")
    axis.tick_params(axis="y", length=0)


def name_scale(
    axis: Axes, groups: dict[str, list[Bar]], scale: str, *, several: bool
) -> None:
    """Write what bars are measured in, and draw the line to which they are compared.

    Args:
        axis: The axis.
        groups: Bars by metric.
        scale: Their scale, as of `bar_groups`.
        several: Whether another scale is beside it, so that each needs its question.
    """
    question, line, text = "validation", 1.0, "over real trials; 1 = their mean"
    if scale == "u":
        question, line = "verification", COVERAGE_FACTOR
        text = f"over u of the solution;\nup to {line} u is inside"
    elif SCORE_METRICS["rmse"].title not in groups:
        text = "over the mean of real trials; 1 is ideal"
    axis.axvline(line, color=REAL, lw=1.0, ls="--", zorder=2)
    axis.set_xlabel(text, fontsize=9)
    if several:
        axis.set_title(QUESTIONS[question], loc="right", fontsize=9, fontweight="bold")
