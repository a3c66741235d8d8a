"""Draw one experiment (needs matplotlib): distance over time, and the coordinates that decide the score."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from gauge_envs.errors import ShapeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.pages.figures import (
    REAL,
    color_of,
    legend_above,
    new_figure,
    save_png,
    tidy_axis,
)
from gauge_envs.pages.results import configuration_labels
from gauge_envs.pages.text import KIND_NOTES, short_id
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.configuration import group_by_configuration
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.compare.comparison import Cell
from gauge_envs.tools.compare.distance import trajectory_gaps
from gauge_envs.tools.compare.reference import (
    Reference,
    choose_reference,
    coordinate_words,
    is_aligned,
    judging_band,
    recorded_of,
)
from gauge_envs.tools.compare.report import score_cell_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


WIDTH_IN, HEIGHT_IN, LEGEND_IN = 12.0, 6.5, 0.18
"""Width and height of the picture, and height of a line of the legend [inch]."""
MAX_HEIGHT_IN = 13.2
"""Largest height: 1,584 pixels, which fits on a screen or a page [inch]."""
MAX_COORDINATES = 3
"""Largest number of coordinates that are drawn."""
MAX_MOTION_S, WINDOW_S = 20.0, 10.0
"""Longest motion that is drawn whole, and length of the last part that is drawn otherwise [s]."""
MAX_LINEAR_RATIO = 20.0
"""Largest ratio of distance to spread of the reference on a linear axis."""
LOW_QUANTILE = 0.02
"""Share of the distances that may lie below a logarithmic axis: the distance is 0 where curves cross."""
MIN_RANGE = 0.02
"""Smallest range of a panel, divided by the range of the widest panel. Rounding errors thus do not fill a panel."""
MAX_RANGE = 10.0
"""Largest distance from the reference in a panel, divided by the range of the reference. It cuts diverged curves."""

NARROW, WIDE = "#c4c4c4", "#e3e3e3"

VALIDATION = "Validation: is the motion like reality?"
VERIFICATION = "Verification: does the engine solve the scene?"
"""Questions that references answer. No table, axis or rank mixes the two."""


@dataclass(frozen=True)
class Series:
    """Results of one configuration in one experiment, and the style of their curves."""

    label: str
    color: str
    is_dashed: bool
    width: float
    results: tuple[Result, ...]

    @property
    def has_aligned(self) -> bool:
        """Whether a result is scored after release alignment."""
        return any(map(is_aligned, self.results))

    @property
    def legend(self) -> str:
        """Entry of the legend: label, score, repeats, and the time shift of a single result."""
        score = self.results[0].score
        cell, shift_s = Cell(results=self.results), score.time_offset_s
        parts = [self.label]
        if score.distance is not None and score.primary is not None:
            parts.append(score_cell_text(cell, score.primary, score.distance_unit))
        elif len(self.results) > 1:
            parts.append(f"{len(self.results)} repeats")
        if is_aligned(self.results[0]) and shift_s is not None:
            parts.append(f"shifted by {shift_s:+.3f} s")
        diverged = sum(result.diverged for result in self.results)
        if diverged:
            parts.append(f"{diverged} diverged")
        return ", ".join(filter(None, parts))

    @property
    def style(self) -> dict[str, Any]:
        """Matplotlib style of the curves."""
        style = {"color": self.color, "ls": "-", "lw": self.width, "zorder": 4}
        if self.is_dashed:
            style["ls"] = "--"
        if len(self.results) > 1:
            style |= {"lw": 0.8, "alpha": 0.7}
        return style


def save_figures(results: Sequence[Result], folder: Path) -> Iterator[Path]:
    """Write a PNG for each experiment of the results, named after the experiment.

    A configuration has the same colour in all pictures.

    Yields:
        Path of each picture, as soon as it is written.
    """
    groups: dict[str, list[Result]] = {}
    for result in results:
        if result.trajectory is not None:
            groups.setdefault(result.id, []).append(result)
    for name, group in groups.items():
        figure = draw_experiment(group, among=results)
        yield save_png(figure, folder / f"{short_id(name)}.png")


def draw_experiment(
    results: Sequence[Result], *, among: Sequence[Result] = ()
) -> Figure:
    """Return the picture of one experiment: the curves of all results over the reference.

    Results that differ only in their seed are thin lines of one colour.

    Args:
        results: One or more finished or diverged results of one experiment, of any parameters, backends and seeds.
        among: All results that are shown together; they decide labels and colours. Empty means `results`.

    Raises:
        ShapeError: The results are not of exactly one experiment.
    """
    ids = {result.id for result in results}
    if len(ids) != 1:
        raise ShapeError(
            f"results of one experiment are needed, got {', '.join(sorted(ids)) or 'none'}"
        )
    series = _series(results, among or results)
    first_results = [entry.results[0] for entry in series]
    experiment = recorded_experiment(first_results[0])
    band = judging_band(experiment, results)
    reference = choose_reference(
        first_results, band, labels=[entry.label for entry in series]
    )
    shares = _shares(reference, results)
    order = np.argsort(-shares, kind="stable")[:MAX_COORDINATES]
    legend_in = LEGEND_IN * len(series)
    figure = new_figure(WIDTH_IN, min(HEIGHT_IN + legend_in, MAX_HEIGHT_IN))
    ratios = (1.6 + 0.5 * legend_in, 1.0)
    grid = figure.add_gridspec(2, len(order), height_ratios=ratios)
    _draw_distances(figure.add_subplot(grid[0, :]), series, reference)
    axes = []
    for place, column in enumerate(sorted(order.tolist())):
        axis = figure.add_subplot(grid[1, place])
        _draw_coordinate(axis, series, reference, column)
        title = _coordinate_title(reference, shares, column)
        axis.set_title(title, loc="left", fontsize=9)
        axes.append(axis)
    # The band of real trials fills a panel. The band of a solution may be narrower than rounding errors.
    if not reference.band.kind.is_real:
        _widen(axes)
    heading = [f"{results[0].id}: {experiment.title}", *wrap(_question(reference), 108)]
    figure.suptitle(
        "\n".join(heading), x=0.01, ha="left", fontsize=12, fontweight="bold"
    )
    notes = "\n".join(wrap(" ".join(_notes(experiment, reference)), 195))
    figure.supxlabel(notes, x=0.01, ha="left", fontsize=8, color="#505050")
    return figure


def _coordinate_title(reference: Reference, shares: FloatArray, column: int) -> str:
    """Return a coordinate with its unit, and its share of the squared distance if there are several."""
    words = coordinate_words(reference.band.coordinates[column])
    title = f"{words} [{reference.band.unit}]"
    if len(shares) > 1 and shares.any():
        title += f": {shares[column]:.0%} of the squared distance"
    return title


def _series(results: Sequence[Result], among: Sequence[Result]) -> list[Series]:
    groups = group_by_configuration(among)
    labels = configuration_labels([configuration for configuration, _ in groups])
    shown = {id(result) for result in results}
    series: list[Series] = []
    for index, (_, members) in enumerate(groups):
        drawn = tuple(result for result in members if id(result) in shown)
        if drawn:
            # Later curves are thinner, so that equal ones do not hide each other.
            width = max(1.2, 2.6 - 0.3 * len(series))
            color, is_dashed = color_of(index)
            series.append(Series(labels[index], color, is_dashed, width, drawn))
    return series


def _shares(reference: Reference, results: Sequence[Result]) -> FloatArray:
    """Return the mean share of each coordinate in the squared distance, shape [C]; 0 without a distance."""
    shares = []
    for result in results:
        squares = np.nansum(np.square(reference.deviation(result)), axis=0)
        if 0 < squares.sum() < np.inf:
            shares.append(squares / squares.sum())
    if not shares:
        return np.zeros(len(reference.band.coordinates))
    return np.mean(shares, axis=0)


def _question(reference: Reference) -> str:
    """Return the question that the picture answers, and the origin of the distance."""
    distance = f"Distance from {reference.name}"
    if reference.scored is None:
        return f"No reference: the correct motion is unknown. {distance}"
    kind, count = reference.band.kind, reference.band.marker_count
    if count > 1:
        distance += f", root mean square over {count} markers"
    if kind.is_solution:
        return f"{VERIFICATION} {distance}"
    return f"{VALIDATION} {distance}"


def _notes(experiment: Experiment, reference: Reference) -> Iterator[str]:
    """Yield the meaning of curves and shades, and the source of the reference."""
    band, scored = reference.band, reference.scored
    kind = Kind.NONE
    if scored is not None:
        kind = scored.kind
    if not reference.is_start:
        yield f"Black: {reference.name}, known until {reference.end_s:.3g} s."
    if kind.is_solution:
        yield f"Grey: its standard uncertainty u, and {reference.spread_factor} u."
    elif kind.is_real:
        yield "Grey: one and two standard deviations of real trials."
    elif scored is not None:
        yield "Grey: one and two published standard deviations."
    if scored is not None and (~band.measured & band.known).any():
        yield "Dotted: extrapolated, not measured."
    yield f"Reference {kind.value}: {KIND_NOTES[kind]}."
    if scored is not None:
        yield f"{scored.source[:1].upper()}{scored.source[1:]}."
    if experiment.driver_provenance:
        yield f"Prescribed motion: {experiment.driver_provenance}."


# --- distance over time ----------------------------------------------------------------------------------------------


def _draw_distances(axis: Axes, series: Sequence[Series], reference: Reference) -> None:
    """Draw the distance of each result from the reference, or from the first configuration without a reference."""
    is_between = reference.scored is None and not reference.is_start
    if is_between:
        _draw_gaps(axis, series)
    else:
        are_aligned = any(entry.has_aligned for entry in series)
        _draw_spread(axis, reference, are_aligned)
        for entry in series:
            curves = []
            for result in entry.results:
                lengths = reference.lengths(reference.deviation(result))
                curves += axis.plot(reference.times_s, lengths, **entry.style)
            curves[0].set_label(entry.legend)
    axis.set_ylabel(f"distance [{reference.band.unit}]")
    axis.set_xlabel("time [s]")
    axis.set_xlim(0.0, reference.end_s)
    _scale_distances(axis, reference)
    tidy_axis(axis)
    legend_above(axis)


def _draw_spread(axis: Axes, reference: Reference, aligned: bool) -> None:
    """Draw the distance of each real trial from the mean of the rest; otherwise the scatter or u of the reference."""
    times_s, scored = reference.times_s, reference.scored
    if scored is None:
        return
    of_trials = scored.trial_rmse
    if aligned:
        of_trials = scored.trial_rmse_aligned
    if of_trials is not None:
        label = "score 1: mean distance of a real trial from the mean of the rest"
        height = np.full(len(times_s), of_trials.mean())
        axis.fill_between(times_s, height, facecolor=NARROW, label=label, zorder=1)
        return
    spread, factor = reference.lengths(reference.spread), reference.spread_factor
    is_solution = reference.band.kind.is_solution
    name = "standard deviations of real trials"
    if is_solution:
        name = "u of the solution"
    for multiple, shade in ((factor, WIDE), (1.0, NARROW)):
        label, height = f"{multiple:g} {name}", multiple * spread
        axis.fill_between(times_s, height, facecolor=shade, label=label, zorder=1)
    if is_solution:
        mean = reference.band.mean
        start = mean[int(reference.band.known.argmax())]
        label = "zero-motion baseline"
        still = reference.lengths(mean - start)
        axis.plot(times_s, still, color=REAL, lw=1.1, ls="--", label=label)


def _draw_gaps(axis: Axes, series: Sequence[Series]) -> None:
    """Draw the distance of each configuration from the first, and the published distance of real trials."""
    first, *rest = series
    for entry in rest:
        curves = []
        for gap in trajectory_gaps(first.results, entry.results):
            curves += axis.plot(gap.times_s, gap.distances, **entry.style)
        if curves:
            curves[0].set_label(entry.legend)
    shown = first.results[0]
    baseline = published_baselines(short_id(shown.id)).get("rmse")
    # The published distances of cloth and foam are of curvatures and areas.
    if baseline is not None and not recorded_of(shown).markers_mm.size:
        label = "published distance of real trials from their mean"
        axis.axhline(baseline.mean, color=REAL, lw=1.0, ls="--", label=label)


def _scale_distances(axis: Axes, reference: Reference) -> None:
    """Use a logarithmic axis for solutions, and if the spread of real trials is too small for a linear axis."""
    curves = [line.get_ydata() for line in axis.get_lines() if line.get_color() != REAL]
    distances = np.concatenate([np.zeros(1), *curves])
    largest = float(np.nanmax(distances))
    spread = 0.0
    if reference.scored is not None:
        spread = float(np.nanmax(reference.lengths(reference.spread)))
    axis.set_ylim(bottom=0.0)
    if largest and (
        reference.band.kind.is_solution or largest > MAX_LINEAR_RATIO * spread > 0.0
    ):
        low = float(np.quantile(distances[distances > 0.0], LOW_QUANTILE))
        axis.set_yscale("log")
        axis.set_ylim(bottom=0.5 * min(low, spread or low))


# --- coordinates -----------------------------------------------------------------------------------------------------


def _draw_coordinate(
    axis: Axes, series: Sequence[Series], reference: Reference, column: int
) -> None:
    """Draw a coordinate of all results over its reference."""
    end_s = reference.end_s
    start_s = 0.0
    if end_s > MAX_MOTION_S:
        start_s = end_s - WINDOW_S
    limits = (-np.inf, np.inf)
    if not reference.is_start:
        _draw_mean(axis, reference, column)
        low, high = axis.get_ylim()
        margin = MAX_RANGE * (high - low)
        limits = (low - margin, high + margin)
    for entry in series:
        for result in entry.results:
            times_s, values = reference.motion(result)
            shown = (times_s >= start_s) & (times_s <= end_s + 1.0 / FRAME_RATE_HZ)
            axis.plot(times_s[shown], values[shown, column], **entry.style)
    low, high = axis.get_ylim()
    axis.set_ylim(max(low, limits[0]), min(high, limits[1]))
    axis.set_xlim(start_s, end_s)
    axis.set_xlabel("time [s]", fontsize=9)
    axis.tick_params(labelsize=8)
    tidy_axis(axis)


def _draw_mean(axis: Axes, reference: Reference, column: int) -> None:
    """Draw the mean of a coordinate and its spread; extrapolated parts are dotted."""
    band, times_s = reference.band, reference.times_s
    mean, spread = band.mean[:, column], reference.spread[:, column]
    # Curves of simulations cover a solution, so its line is wide and below them. A measured mean is above them.
    look: dict[str, Any] = {"color": REAL, "lw": 3.0, "zorder": 2}
    if band.kind.is_real:
        look |= {"lw": 1.1, "zorder": 5}
    # An extrapolated part extends to the neighbouring measured frames.
    extrapolated = np.convolve(~band.measured, [1, 1, 1], "same") > 0
    for factor, shade in ((reference.spread_factor, WIDE), (1.0, NARROW)):
        low, high = mean - factor * spread, mean + factor * spread
        axis.fill_between(times_s, low, high, facecolor=shade, zorder=1)
    for flags, style in ((band.measured, "-"), (extrapolated, ":")):
        axis.plot(times_s, np.where(flags, mean, np.nan), ls=style, **look)


def _widen(axes: Sequence[Axes]) -> None:
    """Widen each panel to a share of the range of the widest panel."""
    limits = [axis.get_ylim() for axis in axes]
    min_range = MIN_RANGE * max(high - low for low, high in limits)
    for axis, (low, high) in zip(axes, limits, strict=True):
        missing = max(min_range - (high - low), 0.0)
        axis.set_ylim(low - 0.5 * missing, high + 0.5 * missing)
