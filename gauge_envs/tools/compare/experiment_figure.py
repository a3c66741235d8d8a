"""The page of one experiment as a picture (needs matplotlib).

Above, distance over time, which its score is of, beside the scores; below, the coordinates that decide it.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from gauge_envs.errors import ShapeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.pages.figures import color_of, new_figure, save_png
from gauge_envs.pages.results import configuration_labels
from gauge_envs.pages.text import KIND_NOTES, QUESTIONS, quantity_text, short_id
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.runs.configuration import group_by_configuration
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.tools.compare.bars import (
    LEAST_REACH,
    VALIDATION,
    bar_groups,
    draw_bars,
    name_scale,
)
from gauge_envs.tools.compare.panels import (
    Series,
    draw_coordinates,
    draw_distances,
    mean_legend,
)
from gauge_envs.tools.compare.yardstick import (
    Yardstick,
    choose_yardstick,
    is_aligned,
    judging_band,
    points_words,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure


WIDTH_IN = 12.0
BELOW_IN = 2.5
"""Height of the coordinates."""
MOST_HEIGHT_IN = 13.2
"""Largest height of a picture: 1,584 pixels, which fits on a screen or a page."""
DECIDING = 3
"""Number of coordinates that have a large panel."""


def save_figures(results: Sequence[Result], folder: Path) -> Iterator[Path]:
    """Write one PNG for each experiment among the results, named after it.

    A configuration has the same colour in all of them.

    Yields:
        Path of each picture, as soon as it is written.
    """
    groups: dict[str, list[Result]] = {}
    for result in results:
        if result.trajectory is not None:
            groups.setdefault(result.id, []).append(result)
    for name, group in groups.items():
        yield save_png(
            draw_experiment(group, among=results), folder / f"{short_id(name)}.png"
        )


def draw_experiment(
    results: Sequence[Result], *, among: Sequence[Result] = ()
) -> Figure:
    """Return the picture of one experiment: curves of all its results, its reference if it has one, and scores.

    Results that differ in their seed alone are thin lines of one colour.

    Args:
        results: Results of one experiment that ran, one or more; their parameters, backends and seeds may differ.
        among: All results that are shown together, which decide labels and colours; these alone where it is empty.
    """
    ids = {result.id for result in results}
    if len(ids) != 1:
        raise ShapeError(
            f"results of one experiment are needed, got {', '.join(sorted(ids)) or 'none'}"
        )
    series = _series(results, among or results)
    experiment = recorded_experiment(series[0].first)
    band = judging_band(experiment, results)
    against = choose_yardstick(
        [one.first for one in series], band, names=[one.label for one in series]
    )
    bars = bar_groups(results[0].id, series)
    notes = wrap(" ".join([mean_legend(against), *_notes(experiment, band, bars)]), 195)
    counts = [
        sum(len(group) + 1 for group in groups.values()) for groups in bars.values()
    ]
    above_in = max(3.3, 0.24 * sum(counts) + 0.6 * len(bars) + 0.4)
    height_in = above_in + BELOW_IN + 0.75 + 0.16 * len(notes)
    figure = new_figure(WIDTH_IN, min(height_in, MOST_HEIGHT_IN))
    ratios_in = (above_in, BELOW_IN)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=ratios_in)[:, 0]
    _title(above, _distance_title(against))
    grid = above.add_gridspec(1, 2, width_ratios=(1.8, 1.0)) if bars else None
    place = above.add_gridspec(1, 1)[0, 0] if grid is None else grid[0, 0]
    draw_distances(above.add_subplot(place), series, against)
    if grid is not None:
        # Two questions have two axes: no bar of one stands on the scale of the other.
        ratios = [count + 2.0 for count in counts]
        places = grid[0, 1].subgridspec(len(bars), 1, height_ratios=ratios)
        for row, (scale, groups) in enumerate(bars.items()):
            axis = above.add_subplot(places[row, 0])
            depth = 2.4 * above_in if len(bars) == 1 else 0.0
            draw_bars(axis, groups, depth=depth, least=LEAST_REACH.get(scale, 0.0))
            name_scale(axis, groups, scale, several=len(bars) > 1)
    _draw_deciding(below, series, against)
    question = _question(band)
    figure.suptitle(
        f"{results[0].id}: {experiment.title}\n{question}",
        x=0.01,
        ha="left",
        fontsize=12,
        fontweight="bold",
    )
    figure.supxlabel("\n".join(notes), x=0.01, ha="left", fontsize=8, color="#505050")
    return figure


def _question(band: Band | None) -> str:
    """Return what the page answers. No page mixes the two questions but for events, whose bars are apart."""
    if band is None:
        return "No reference: it is not known which motion is right"
    return QUESTIONS["verification" if band.kind.is_solution else "validation"]


def _title(part: SubFigure, text: str) -> None:
    part.suptitle(text, x=0.01, ha="left", fontsize=10, fontweight="bold")


def _distance_title(against: Yardstick) -> str:
    until = ""
    if against.end_s < float(against.times_s[-1]):
        until = f", known until {quantity_text(against.end_s)} of {quantity_text(against.times_s[-1])} s"
    if not against.points:
        return f"Distance from {against.name}{until}"
    what = points_words(against.points)
    if against.reference is None and not against.of_start:
        return f"Distance from {against.name}, of all {what} together (root of the sum of squares)"
    return f"Distance from {against.name}, root mean square over {what}{until}"


def _draw_deciding(
    part: SubFigure, series: Sequence[Series], against: Yardstick
) -> None:
    """Draw the coordinates that decide the score."""
    # The engine that others are compared with is at no distance from itself.
    others = series if against.reference is not None or against.of_start else series[1:]
    deviations = [
        against.deviation(result, aligned=is_aligned(result))
        for one in others
        for result in one.results
    ]
    shares = against.shares(deviations)
    order = np.argsort(-shares, kind="stable")
    count = len(shares)
    deciding = sorted(order[:DECIDING].tolist())

    axes = part.subplots(1, len(deciding), squeeze=False)[0]
    draw_coordinates(axes, deciding, series, against, shares=shares)
    title = "Coordinates, with their share of the squared distance"
    if count == 1:
        title = "The coordinate that is compared"
    elif count > DECIDING:
        title = f"The {DECIDING} of {count} coordinates with the largest share of the squared distance"
    _title(part, title)


def _notes(
    experiment: Experiment, band: Band | None, bars: Container[str]
) -> list[str]:
    kind = Kind.NONE if band is None else band.kind
    parts = [f"Reference {kind.value}: {KIND_NOTES[kind]}."]
    if band is not None:
        parts.append(f"{band.source[:1].upper()}{band.source[1:]}.")
    if experiment.driver_provenance:
        parts.append(f"Driver: {experiment.driver_provenance}.")
    if VALIDATION in bars:
        parts.append("Grey bars: engines as published (GAUGE, Table 5).")
    return parts


def _series(results: Iterable[Result], among: Sequence[Result]) -> list[Series]:
    groups = group_by_configuration(among)
    labels = configuration_labels([configuration for configuration, _ in groups])
    shown = {id(result) for result in results}
    present = []
    for index, (_, members) in enumerate(groups):
        drawn = tuple(result for result in members if id(result) in shown)
        if drawn:
            present.append((index, drawn))
    series = []
    for order, (index, drawn) in enumerate(present):
        # The later ones are thinner, so that one that lies on another does not hide it; repeats are thin anyway.
        width = (
            max(1.2, 1.8 + 0.4 * (len(present) - 1) - 0.6 * order)
            if len(drawn) == 1
            else 0.8
        )
        series.append(Series(labels[index], *color_of(index), width, drawn))
    return series
