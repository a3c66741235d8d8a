"""Panels of the picture of one experiment: distance over time, and coordinates."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gauge_envs.pages.figures import REAL, legend_above, runs, tidy_axis
from gauge_envs.pages.text import short_id
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.result import Result
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.compare.distance import distances_over_time
from gauge_envs.tools.compare.yardstick import (
    Yardstick,
    coordinate_words,
    is_aligned,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


ONE_SIGMA = "#c4c4c4"
TWO_SIGMA = "#e3e3e3"
HATCH: dict[str, Any] = {"hatch": "////", "edgecolor": "white", "linewidth": 0.0}
MIN_RANGE = 0.02
"""Smallest range of a panel without a band of real trials, relative to that of the widest panel of the experiment."""
LOW_QUANTILE = 0.02
"""Share of the distances that may be below a logarithmic axis: curves that cross have none at all."""
LINEAR_RATIO = 20.0
"""Largest distance over the largest spread that a linear axis shows: beyond it, the spread is a line on the axis."""
MOST_SECONDS = 20.0
"""Longest motion that is drawn whole [s]: in a longer one, swings of a second fill the panel."""
WINDOW_S = 10.0
"""Last part of a longer motion that is drawn [s]."""


@dataclass(frozen=True)
class Series:
    """Results of one configuration in one experiment, and how they look."""

    label: str
    color: str
    is_dashed: bool
    width: float
    results: tuple[Result, ...]

    @property
    def legend(self) -> str:
        """Entry of the legend."""
        count, diverged = len(self.results), sum(one.diverged for one in self.results)
        repeats = f", {count} repeats" if count > 1 else ""
        return f"{self.label}{repeats}" + (f", {diverged} diverged" if diverged else "")

    @property
    def first(self) -> Result:
        """Its first result, which stands for its configuration."""
        return self.results[0]

    @property
    def line(self) -> dict[str, Any]:
        """How its curves look."""
        alpha = 1.0 if len(self.results) == 1 else 0.7
        style = "--" if self.is_dashed else "-"
        return {"color": self.color, "lw": self.width, "ls": style, "alpha": alpha}


# --- distance over time ----------------------------------------------------------------------------------------------


def draw_distances(axis: Axes, series: Sequence[Series], against: Yardstick) -> None:
    """Draw the distance of each result at each frame, over what real trials or the solution leave open."""
    if against.reference is None and not against.of_start:
        _draw_apart(axis, series)
    else:
        aligned = any(is_aligned(result) for one in series for result in one.results)
        _draw_spread(axis, against, aligned=aligned)
        for one in series:
            _draw_lengths(axis, one, against)
    axis.set_ylabel(f"distance [{against.unit}]")
    axis.set_xlabel("time [s]")
    axis.set_xlim(0.0, against.end_s)
    _scale_distances(axis, against)
    tidy_axis(axis)
    legend_above(axis)


def _draw_spread(axis: Axes, against: Yardstick, *, aligned: bool) -> None:
    """Draw the distance of real trials, or their spread or u of the solution, and that of a scene without motion."""
    band = against.band
    distance = against.trial_distance(aligned=aligned)
    if distance is not None:
        how = ", aligned too" if aligned else ""
        axis.fill_between(
            against.times_s,
            distance,
            0.0,
            facecolor=ONE_SIGMA,
            label=f"1: mean of the real trials from the mean of the others{how}",
            zorder=1,
        )
    elif against.reference is not None:
        spread = against.lengths(against.spread)
        shades = ((1.0, ONE_SIGMA, 1.1), (against.reach, TWO_SIGMA, 1.0))
        for (reach, shade, order), name in zip(
            shades, against.spread_words, strict=True
        ):
            axis.fill_between(
                against.times_s,
                reach * spread,
                0.0,
                facecolor=shade,
                label=name,
                zorder=order,
            )
    if not band.kind.is_solution:
        return
    start = band.mean[int(band.known.argmax())]
    axis.plot(
        against.times_s,
        against.lengths(band.mean - start),
        color=REAL,
        lw=1.1,
        ls="--",
        label="a scene in which nothing moves",
    )


def _draw_lengths(axis: Axes, one: Series, against: Yardstick) -> None:
    for number, result in enumerate(one.results):
        aligned = is_aligned(result)
        lengths = against.lengths(against.deviation(result, aligned=aligned))
        offset_s = result.score.time_offset_s
        text = one.legend
        if aligned and offset_s is not None and len(one.results) == 1:
            text += f", moved by {offset_s:+.3f} s to align the release"
        axis.plot(
            against.times_s,
            lengths,
            label=text if number == 0 else None,
            zorder=4,
            **one.line,
        )


def _draw_apart(axis: Axes, series: Sequence[Series]) -> None:
    """Draw the distance of each configuration to the first, and that of the real trials to their mean."""
    first = series[0]
    for one in series[1:]:
        label: str | None = one.legend
        for times, distance in distances_over_time(first.results, one.results):
            axis.plot(times, distance, label=label, **one.line)
            label = None
    baseline = published_baselines(short_id(first.first.id)).get("rmse")
    if baseline is not None:
        axis.axhline(
            baseline.mean,
            color=REAL,
            lw=1.0,
            ls="--",
            label="published distance of real trials from their mean",
        )


def _scale_distances(axis: Axes, against: Yardstick) -> None:
    """Choose a linear or a logarithmic axis, and its lower limit."""
    spread = 0.0
    if against.reference is not None:
        spread = float(np.nanmax(against.lengths(against.spread), initial=0.0))
    results = [
        np.asarray(line.get_ydata(), dtype=float)
        for line in axis.get_lines()
        if line.get_color() != REAL
    ]
    lengths = np.concatenate([*results, np.zeros(1)])
    lengths = lengths[np.isfinite(lengths) & (lengths > 0.0)]
    is_wide = 0.0 < LINEAR_RATIO * spread < lengths.max(initial=0.0)
    if not len(lengths) or not (against.band.kind.is_solution or is_wide):
        axis.set_ylim(bottom=0.0)
        return
    lowest = float(np.quantile(lengths, LOW_QUANTILE))
    axis.set_yscale("log")
    axis.set_ylim(bottom=0.5 * min(lowest, spread or lowest))


# --- coordinates -----------------------------------------------------------------------------------------------------


def draw_coordinates(
    axes: Sequence[Axes],
    columns: Sequence[int],
    series: Sequence[Series],
    against: Yardstick,
    *,
    shares: FloatArray,
) -> None:
    """Draw coordinates over time, one in each panel, with the spread of the reference.

    Args:
        axes: One for each coordinate.
        columns: Index of each coordinate.
        series: The results.
        against: What they are drawn against.
        shares: Share of every coordinate in the squared distance, shape [C].
    """
    start_s = against.end_s - WINDOW_S if against.end_s > MOST_SECONDS else 0.0
    window = (start_s, against.end_s)
    for axis, column in zip(axes, columns, strict=True):
        if not against.of_start:
            _draw_mean(axis, against, column, window)
        _draw_curves(axis, series, against, column, window)
        name = coordinate_words(against.band.coordinates[column])
        title = f"{name} [{against.unit}]"
        if shares.any() and len(shares) > 1:
            title += f": {_share_text(shares[column])}"
        axis.set_title(title, loc="left", fontsize=9)
        axis.tick_params(labelsize=8)
        axis.set_xlim(*window)
        axis.set_xlabel("time [s]", fontsize=9)
        tidy_axis(axis)
    # The band of real trials fills a panel; that of a solution may be narrower than rounding errors.
    if not against.band.kind.is_real:
        _widen(axes)


def _share_text(share: float) -> str:
    percent = 100.0 * share
    return f"{percent:.0f} %" if percent >= 1.0 or percent == 0.0 else "below 1 %"


def _shown(times_s: FloatArray, window: tuple[float, float]) -> BoolArray:
    """Return which times lie in a window, and the ones next to it."""
    margin_s = 1.0 / FRAME_RATE_HZ
    return (times_s >= window[0] - margin_s) & (times_s <= window[1] + margin_s)


def _draw_mean(
    axis: Axes,
    against: Yardstick,
    column: int,
    window: tuple[float, float],
) -> None:
    """Draw the mean and its spread; extrapolated parts are hatched and dotted."""
    band = against.band
    times, mean, sigma = (
        against.times_s,
        band.mean[:, column],
        against.spread[:, column],
    )
    # What lies outside would set the limits of the axis.
    is_shown = _shown(times, window)
    is_real = band.kind.is_real
    # Simulations lie on the line of a solution: wide and below them. A measured mean is dots, and above them.
    width = 1.1 if is_real else 3.0
    # A segment belongs to what is measured when both of its ends are; drawn piece by piece, they do not overlap.
    segments = band.measured[:-1] & band.measured[1:]
    inside = is_shown[:-1] & is_shown[1:]
    for flags, style, hatch in ((segments, "-", {}), (~segments, ":", HATCH)):
        for start, end in runs(flags & inside):
            piece = slice(start, end + 1)
            for reach, shade in ((against.reach, TWO_SIGMA), (1.0, ONE_SIGMA)):
                low = mean[piece] - reach * sigma[piece]
                high = mean[piece] + reach * sigma[piece]
                axis.fill_between(
                    times[piece], low, high, facecolor=shade, zorder=1, **hatch
                )
            axis.plot(
                times[piece],
                mean[piece],
                color=REAL,
                lw=width,
                ls=style,
                zorder=5 if is_real else 2,
            )
    if is_real:
        for flags, face in ((band.measured, REAL), (~band.measured, "white")):
            flags = flags & is_shown
            axis.plot(
                times[flags],
                mean[flags],
                "o",
                ms=3.0,
                mew=0.8,
                mec=REAL,
                mfc=face,
                zorder=6,
            )


def mean_legend(against: Yardstick) -> str:
    """Return what the black curve and the shades of the panels of coordinates are."""
    if against.of_start:
        return ""
    text = f"Black: {against.name}."
    if against.reference is not None:
        narrow, wide = against.spread_words
        text += f" Dark grey: {narrow}; light grey: {wide}."
    known = against.band.known
    if against.reference is not None and (~against.band.measured & known).any():
        text += " Hatched and dotted: extrapolated, not measured."
    return text


def _draw_curves(
    axis: Axes,
    series: Sequence[Series],
    against: Yardstick,
    column: int,
    window: tuple[float, float],
) -> None:
    low, high = axis.get_ylim() if axis.has_data() else (np.inf, -np.inf)
    for one in series:
        for result in one.results:
            times, values = against.motion(result, aligned=is_aligned(result))
            shown = _shown(times, window)
            axis.plot(times[shown], values[shown, column], zorder=4, **one.line)
            low, high = _span(low, high, values[shown, column])
    if not low < high:
        middle = low if np.isfinite(low) else 0.0
        low, high = middle - 1e-9, middle + 1e-9
    margin = 0.04 * (high - low)
    axis.set_ylim(low - margin, high + margin)


def _span(low: float, high: float, values: FloatArray) -> tuple[float, float]:
    """Return limits that include the values, at most ten times as wide: a diverged curve is cut."""
    finite = values[np.isfinite(values)]
    reach = 10.0 * (high - low) if high > low else np.inf
    return (
        max(min(low, float(finite.min(initial=np.inf))), low - reach),
        min(max(high, float(finite.max(initial=-np.inf))), high + reach),
    )


def _widen(axes: Iterable[Axes]) -> None:
    """Give each panel a share of the range of the widest one: rounding errors must not fill a panel."""
    limits = [(axis, *axis.get_ylim()) for axis in axes]
    least = MIN_RANGE * max(high - low for _, low, high in limits)
    for axis, low, high in limits:
        lacking = max(least - (high - low), 0.0)
        axis.set_ylim(low - 0.5 * lacking, high + 0.5 * lacking)
