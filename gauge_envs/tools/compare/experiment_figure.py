"""Pictures of results: simulated curves over the real band, and scores beside the published ones (needs matplotlib)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.verification import frame_errors, point_lengths
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.pages.figures import (
    ENGINES,
    OURS,
    REAL,
    legend_above,
    new_figure,
    save_png,
    tidy_axis,
)
from gauge_envs.pages.results import ALIGNED, SCORE_METRICS, configuration_labels
from gauge_envs.pages.svg import runs
from gauge_envs.pages.text import (
    GRADE_NOTES,
    interval_text,
    score_text,
    short_id,
    with_unit,
)
from gauge_envs.references.bands import Band
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.published import PUBLISHED_ENGINES, published_baselines
from gauge_envs.runs.configuration import group_by_configuration
from gauge_envs.runs.result import RecordedTrajectory, Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from gauge_envs.tools.compare.comparison import Cell
from gauge_envs.tools.compare.distance import distances_over_time

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


ONE_SIGMA = "#c4c4c4"
TWO_SIGMA = "#e3e3e3"
LINE_STYLES = ("-", "--", ":", "-.")
HATCH: dict[str, Any] = {"hatch": "////", "edgecolor": "white", "linewidth": 0.0}
WHISKER: dict[str, Any] = {"ecolor": REAL, "elinewidth": 1.0, "capsize": 2.0}
BACKING: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}

MAX_LEGEND_ENTRIES = 12
MIN_RANGE = 0.02
"""Smallest range of a panel without a band, relative to that of the widest panel of the experiment."""
MOST_PANELS = 6
"""Largest number of coordinates with a panel each."""
SMALLEST_SHARE = 1e-5
"""Smallest distance that is drawn, over the largest one."""
MAX_ALIGNED = 2
"""Largest number of curves that are drawn a second time, aligned to the release."""


@dataclass(frozen=True)
class _Series:
    """Results of one configuration in one experiment, and how they look."""

    label: str
    color: str
    width: float
    results: tuple[Result, ...]

    @property
    def legend(self) -> str:
        """Entry of the legend."""
        diverged, count = (
            sum(result.diverged for result in self.results),
            len(self.results),
        )
        if count == 1:
            return f"{self.label}, diverged" if diverged else self.label
        return f"{self.label}, {count} repeats" + (
            f", {diverged} diverged" if diverged else ""
        )

    @property
    def alpha(self) -> float:
        return 1.0 if len(self.results) == 1 else 0.7


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
    """Return the picture of one experiment: curves of all its results, the band if it has one, and scores.

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
    experiment = recorded_experiment(series[0].results[0])
    band = reference_band(
        experiment, use_withheld=any(result.score.withheld for result in results)
    )
    bars = _bar_groups(results[0].id, series)
    names = band.coordinates if band is not None else _axis_names(results[0])
    # Dozens of curves say nothing on a page; their distance from the mean does.
    has_errors = len(names) > MOST_PANELS
    if has_errors:
        names = ("distance",)
    # Without a reference, how far the engines are apart is all there is to see.
    with_distance = band is None and len(series) > 1
    rows = len(names) + with_distance
    bar_count = sum(len(group) + 1 for group in bars.values())
    figure = new_figure(12.0, max(4.8, 2.1 * rows + 1.2, 0.24 * bar_count + 1.6))
    columns = 2 if bars else 1
    grid = figure.add_gridspec(rows, columns, width_ratios=(1.8, 1.0)[:columns])
    axes: list[Any] = []
    for row in range(rows):
        axes.append(figure.add_subplot(grid[row, 0], sharex=axes[0] if axes else None))
        axes[-1].tick_params(labelbottom=row == rows - 1)
    if with_distance:
        _draw_distances(axes[-1], series)
    if has_errors and band is not None:
        _draw_errors(axes[0], series, band)
    elif band is None:
        _draw_coordinates(axes[: len(names)], series)
    else:
        for column, axis in enumerate(axes):
            _draw_band(axis, band, column)
            _draw_results(axis, series, band, column)
    legend_above(axes[0])
    axes[-1].set_xlabel("time [s]")
    if bars:
        _draw_bars(figure.add_subplot(grid[:, 1]), bars, depth=5.0 * rows)
    title = f"{results[0].id}: {experiment.title}{'' if band is not None else ' (no reference trajectory)'}"
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
    notes = "\n".join(wrap(_notes(experiment, band, has_bars=bool(bars)), 195))
    figure.supxlabel(notes, x=0.01, ha="left", fontsize=8, color="#505050")
    return figure


def _notes(experiment: Experiment, band: Band | None, *, has_bars: bool) -> str:
    grade = BandGrade.NONE if band is None else band.grade
    parts = [f"Grade {grade.value}: {GRADE_NOTES[grade]}."]
    parts += [f"{band.source}."] if band is not None else []
    parts += (
        [f"Driver: {experiment.driver_provenance}."]
        if experiment.driver_provenance
        else []
    )
    parts += ["Grey bars: engines as published (GAUGE, Table 5)."] if has_bars else []
    return " ".join(parts)


def _series(results: Iterable[Result], among: Sequence[Result]) -> list[_Series]:
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
        series.append(_Series(labels[index], OURS[index % len(OURS)], width, drawn))
    return series


# --- curves ----------------------------------------------------------------------------------------------------------


def _draw_band(axis: Axes, band: Band, column: int) -> None:
    """Draw the mean with one and two sigma; extrapolated parts are hatched and dotted."""
    times = np.arange(len(band.mean)) / FRAME_RATE_HZ
    mean = band.mean[:, column]
    sigma = band.sigma[:, column]
    # Simulations lie on the line of a law or a model: wide and below them. A measured mean is dots, and above them.
    is_exact = not band.grade.is_real
    width = 3.0 if is_exact else 1.1
    # A segment belongs to what is measured when both of its ends are; drawn piece by piece, they do not overlap.
    segments = band.measured[:-1] & band.measured[1:]
    for flags, line, hatch in ((segments, "-", {}), (~segments, ":", HATCH)):
        for start, end in runs(flags):
            piece = slice(start, end + 1)
            for reach, shade in ((2.0, TWO_SIGMA), (1.0, ONE_SIGMA)):
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
                ls=line,
                zorder=2 if is_exact else 5,
            )
    if not is_exact:
        for flags, face in ((band.measured, REAL), (~band.measured, "white")):
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
    if column == 0:
        _name_band(axis, band, width)
    axis.set_ylabel(f"{band.coordinates[column]} [{band.unit}]")
    tidy_axis(axis)


def _name_band(axis: Axes, band: Band, width: float) -> None:
    """Add the entries of a band to the legend."""
    trials = f" ({band.trial_count} trials)" if band.trial_count else ""
    names = {
        BandGrade.LAW: ("law", "law"),
        BandGrade.MODEL: ("solved model, not real", "real, published"),
        BandGrade.RECORDING: ("real, one trial", "real"),
    }
    mean, spread = names.get(band.grade, (f"real, mean{trials}", "real"))
    axis.plot(
        [],
        [],
        "o-" if band.grade.is_real else "-",
        ms=3.0,
        color=REAL,
        lw=width,
        label=mean,
    )
    axis.fill_between([], [], facecolor=ONE_SIGMA, label=f"{spread}, 1 sigma")
    axis.fill_between([], [], facecolor=TWO_SIGMA, label=f"{spread}, 2 sigma")
    if (~band.measured & np.isfinite(band.mean[:, 0])).any():
        axis.fill_between(
            [], [], facecolor=ONE_SIGMA, label="extrapolated, not measured", **HATCH
        )


def _draw_results(
    axis: Axes, series: Sequence[_Series], band: Band, column: int
) -> None:
    end = (len(band.mean) - 1) / FRAME_RATE_HZ
    low, high = axis.get_ylim()
    for one in series:
        for number, result in enumerate(one.results):
            times, samples = _recorded(result).arrays()
            values = band.project(samples)[:, column]
            low, high = _span(low, high, values)
            label = one.legend if column == 0 and number == 0 else None
            axis.plot(
                times,
                values,
                color=one.color,
                lw=one.width,
                alpha=one.alpha,
                label=label,
                zorder=4,
            )
        offset = one.results[0].score.release_offset_s
        if offset is not None and len(one.results) == 1 and len(series) <= MAX_ALIGNED:
            moved = np.interp(times - offset, times, values)
            title = (
                f"{one.label}, {offset:+.3f} s to align the release"
                if column == 0
                else None
            )
            axis.plot(
                times, moved, color=one.color, lw=1.2, ls="--", label=title, zorder=3
            )
    margin = 0.04 * (high - low)
    axis.set_ylim(low - margin, high + margin)
    axis.set_xlim(0.0, end)


def _draw_errors(axis: Axes, series: Sequence[_Series], band: Band) -> None:
    """Draw the distance from the mean at each frame, what the reference leaves open, and that of a frozen scene."""
    compared = band.points or band
    start = compared.mean[int(np.isfinite(compared.mean).any(axis=1).argmax())]
    has_markers = compared is not band
    spread = compared.sigma if compared.uncertainty is None else compared.uncertainty
    name = "1 sigma" if compared.uncertainty is None else "u of the reference"
    times_s = np.arange(len(compared.mean)) / FRAME_RATE_HZ
    axis.fill_between(
        times_s, point_lengths(spread, compared), facecolor=ONE_SIGMA, label=name
    )
    axis.plot(
        times_s,
        point_lengths(compared.mean - start, compared),
        color=REAL,
        lw=1.1,
        ls="--",
        label="a scene in which nothing moves",
    )
    for one in series:
        for number, result in enumerate(one.results):
            recorded = _recorded(result)
            errors = frame_errors(
                band,
                frames=recorded.arrays()[1][::SAMPLES_PER_FRAME],
                markers_m=recorded.markers_m(),
            )
            if errors is None:
                continue
            axis.plot(
                times_s,
                errors,
                color=one.color,
                lw=one.width,
                alpha=one.alpha,
                label=one.legend if number == 0 else None,
            )
    axis.set_yscale("log")
    axis.set_ylim(bottom=SMALLEST_SHARE * axis.get_ylim()[1])
    what = "markers" if has_markers else "g(t)"
    axis.set_ylabel(f"distance of {what} from the reference [{compared.unit}]")
    axis.set_xlim(0.0, times_s[-1])
    tidy_axis(axis)


def _span(low: float, high: float, values: NDArray[np.float64]) -> tuple[float, float]:
    """Return limits that include the values, at most ten times as wide: a diverged curve is cut."""
    finite = values[np.isfinite(values)]
    reach = 10.0 * (high - low)
    return (
        max(min(low, float(finite.min(initial=low))), low - reach),
        min(max(high, float(finite.max(initial=high))), high + reach),
    )


def _draw_coordinates(axes: Sequence[Axes], series: Sequence[_Series]) -> None:
    """Draw the curves of an experiment without a band, in one panel each for x, y and z.

    One configuration has a colour for each body; several have a colour each, and a line style for each of a few bodies.
    """
    recorded = _recorded(series[0].results[0])
    unit = recorded.unit
    bodies = list(
        dict.fromkeys(name.rpartition(".")[0] or name for name in recorded.coordinates)
    )
    if len(series) == 1 and len(bodies) > 1:
        _draw_bodies(axes, series[0], bodies)
    else:
        _draw_engines(axes, series, bodies)
    for axis, title in zip(axes, _axis_names(series[0].results[0]), strict=True):
        axis.set_ylabel(f"{title} [{unit}]")
        axis.margins(x=0.0)
        tidy_axis(axis)
    _widen(axes)


def _widen(axes: Sequence[Axes]) -> None:
    """Give each panel a share of the range of the widest one: rounding errors must not fill a panel."""
    limits = [axis.get_ylim() for axis in axes]
    least = MIN_RANGE * max(high - low for low, high in limits)
    for axis, (low, high) in zip(axes, limits, strict=True):
        lacking = max(least - (high - low), 0.0)
        axis.set_ylim(low - 0.5 * lacking, high + 0.5 * lacking)


def _curves(
    result: Result, panels: int
) -> Iterator[tuple[int, str, NDArray[np.float64], NDArray[np.float64]]]:
    """Yield panel, body, times [s] and values of each coordinate."""
    recorded = _recorded(result)
    times, samples = recorded.arrays()
    for index, name in enumerate(recorded.coordinates):
        body, _, direction = name.rpartition(".")
        yield (
            "xyz".index(direction) if panels == 3 else 0,
            body or name,
            times,
            samples[:, index],
        )


def _draw_bodies(axes: Sequence[Axes], one: _Series, bodies: Sequence[str]) -> None:
    many = len(bodies) > MAX_LEGEND_ENTRIES
    seen: set[str] = set()
    for result in one.results:
        for panel, body, times, values in _curves(result, len(axes)):
            # Too many bodies to name: one entry for all.
            label = _crowd(one, bodies) if many else f"{body}, {one.legend}"
            color = OURS[bodies.index(body) % len(OURS)]
            width = 0.9 if many else min(one.width, 1.5)
            axes[panel].plot(
                times,
                values,
                color=color,
                lw=width,
                label=None if label in seen or panel else label,
            )
            seen |= {label} if panel == 0 else set()


def _draw_engines(
    axes: Sequence[Axes], series: Sequence[_Series], bodies: Sequence[str]
) -> None:
    few = len(bodies) <= len(LINE_STYLES)
    for one in series:
        label: str | None = one.legend if few else _crowd(one, bodies)
        for result in one.results:
            for panel, body, times, values in _curves(result, len(axes)):
                style = LINE_STYLES[bodies.index(body)] if few else "-"
                width = one.width if few else 0.7
                alpha = one.alpha if few else 0.6
                axes[panel].plot(
                    times,
                    values,
                    color=one.color,
                    ls=style,
                    lw=width,
                    alpha=alpha,
                    label=label,
                )
                label = None
    if few and len(bodies) > 1:
        for body, style in zip(bodies, LINE_STYLES, strict=False):
            axes[0].plot([], [], color=REAL, ls=style, lw=1.2, label=body)


def _draw_distances(axis: Axes, series: Sequence[_Series]) -> None:
    """Draw the distance of each configuration to the first, and that of the real trials to their mean."""
    first = series[0]
    for one in series[1:]:
        for times, distance in distances_over_time(first.results, one.results):
            axis.plot(
                times,
                distance,
                color=one.color,
                lw=min(one.width, 1.4),
                alpha=one.alpha,
            )
    baseline = published_baselines(short_id(first.results[0].id)).get("rmse")
    if baseline is not None:
        axis.axhline(
            baseline.mean,
            color=REAL,
            lw=1.0,
            ls="--",
            label="published mean RMSE of the real trials",
        )
        legend_above(axis)
    unit = _recorded(first.results[0]).unit
    axis.set_ylabel("\n".join([*wrap(f"distance to {first.label}", 22), f"[{unit}]"]))
    axis.set_ylim(bottom=0.0)
    tidy_axis(axis)


def _crowd(one: _Series, bodies: Sequence[str]) -> str:
    stems = {name.rpartition("-")[0] for name in bodies}
    return f"{one.legend}, {len(bodies)} {f'{stems.pop()}s' if len(stems) == 1 else 'bodies'}"


def _axis_names(result: Result) -> tuple[str, ...]:
    return (
        ("x", "y", "z")
        if all("." in name for name in _recorded(result).coordinates)
        else ("g(t)",)
    )


def _recorded(result: Result) -> RecordedTrajectory:
    if result.trajectory is None:
        raise ShapeError(
            f"{result.id} did not run, there is nothing to draw: {result.error}"
        )
    return result.trajectory


# --- scores ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Bar:
    """A normalized score.

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


def _bar_groups(name: str, series: Sequence[_Series]) -> dict[str, list[_Bar]]:
    """Return normalized scores of the results and of the published engines, for the metrics of the paper."""
    groups: dict[str, list[_Bar]] = {}
    is_solved = any(
        result.score.grade in (BandGrade.LAW, BandGrade.MODEL)
        for one in series
        for result in one.results
    )
    if any(
        result.score.primary == ALIGNED.key for one in series for result in one.results
    ):
        groups[ALIGNED.title] = [_own_bar(one, ALIGNED.key) for one in series]
    for metric, line in published_baselines(short_id(name)).items():
        # Published scores are distances from real trials; those from a law or a solved model are numerical errors.
        if metric == "el" or (is_solved and not SCORE_METRICS[metric].is_event):
            continue
        bars = [_own_bar(one, metric) for one in series]
        for (engine, title), color in zip(
            PUBLISHED_ENGINES.items(), ENGINES, strict=True
        ):
            value = line.engines[engine]
            text = "not published" if value is None else score_text(value)
            bars.append(
                _Bar(
                    f"{title}, paper",
                    color,
                    text,
                    value or 0.0,
                    (value or 0.0, value or 0.0),
                )
            )
        groups[SCORE_METRICS[metric].title] = bars
    return groups


def _own_bar(one: _Series, metric: str) -> _Bar:
    cell = Cell(results=one.results)
    spread, raw = (
        cell.spread(metric, normalized=normalized) for normalized in (True, False)
    )
    if spread is None:
        text = (
            "diverged"
            if any(result.diverged for result in one.results)
            else "no reference"
        )
        if raw is not None:
            unit = SCORE_METRICS[metric].unit_of(one.results[0].score.unit)
            text = f"{with_unit(score_text(raw.mean), unit)}, not normalized"
        return _Bar(one.label, one.color, text)
    interval = cell.interval_95(metric) if len(one.results) == 1 else None
    if interval is not None:
        return _Bar(
            one.label,
            one.color,
            interval_text(spread.mean, interval),
            spread.mean,
            interval,
        )
    reach = spread.std or 0.0
    text = score_text(spread.mean) + (f" +- {score_text(reach)}" if reach else "")
    return _Bar(
        one.label,
        one.color,
        text,
        spread.mean,
        (spread.mean - reach, spread.mean + reach),
    )


def _draw_bars(axis: Axes, groups: dict[str, list[_Bar]], *, depth: float) -> None:
    """Draw bars from the top down; `depth` is the least number that fits, so that no bar is thick."""
    longest = max(
        [
            1.2,
            *(
                max(bar.value, bar.ends[1])
                for group in groups.values()
                for bar in group
            ),
        ]
    )
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
            ticks.append("\n".join(wrap(bar.label, 22)))
            place += 1.0
        place += 1.1
    axis.axvline(1.0, color=REAL, lw=1.0, ls="--", zorder=2)
    axis.set_yticks(places, ticks, fontsize=8)
    axis.set_ylim(max(place - 1.3, depth), -1.3)
    axis.set_xlim(0.0, 1.45 * longest)
    meaning = (
        "mean of the real trials"
        if SCORE_METRICS["rmse"].title in groups
        else "the real mean, ideal"
    )
    axis.set_xlabel(f"normalized score; 1 = {meaning}")
    tidy_axis(axis)
    axis.grid(visible=False, axis="y")
    axis.tick_params(axis="y", length=0)
