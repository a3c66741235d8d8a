"""Pictures of results: simulated curves over the real band, and scores beside the published ones (needs matplotlib)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.env import reference_band
from gauge_envs.errors import MissingExtraError, ResultFileError, ShapeError
from gauge_envs.experiment import Experiment, experiment
from gauge_envs.reference import Band, BandGrade, published_baselines
from gauge_envs.report import ENGINE_TITLES, GRADE_NOTES, METRIC_TITLES, result_label
from gauge_envs.result import RecordedTrajectory, Result
from gauge_envs.task_format import FRAME_RATE_HZ

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_experiment", "save_figures"]

OURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of results: Okabe and Ito's, which colour-blind readers can tell apart."""

ENGINES = ("#8c8c8c", "#b0b0b0", "#d0d0d0")
REAL = "#303030"
HATCH: dict[str, Any] = {"hatch": "////", "edgecolor": "white", "linewidth": 0.0}
BACKING: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
LINE_STYLES = ("-", "--", ":", "-.")
MOST_LEGEND_ENTRIES = 12


def save_figures(results: Sequence[Result], folder: Path) -> Iterator[Path]:
    """Write one PNG for each experiment among the results, named after it.

    Yields:
        Path of each picture, as soon as it is written.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ResultFileError: The folder cannot be written.
    """
    groups: dict[str, list[Result]] = {}
    for result in results:
        groups.setdefault(result.id, []).append(result)
    for name, group in groups.items():
        figure = draw_experiment(group)
        path = folder / f"{name.removeprefix('GAUGE/')}.png"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            figure.savefig(path, dpi=120)
        except OSError as error:
            raise ResultFileError(f"{path}: cannot be written: {error.strerror or error}") from error
        yield path


def draw_experiment(results: Sequence[Result]) -> Figure:
    """Picture of one experiment: curves of all its results, the band where there is one, and scores.

    Args:
        results: Results of one experiment that ran, one or more; their parameters, backends and seeds may differ.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ShapeError: There is no result, or they are of different experiments.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("plotting", "plot", error) from error
    ids = {result.id for result in results}
    if len(ids) != 1:
        raise ShapeError(f"results of one experiment are needed, got {', '.join(sorted(ids)) or 'none'}")
    resolved = experiment(results[0].id, results[0].parameters)
    band = reference_band(resolved)
    bars = _bar_groups(results)
    names = band.coordinates if band is not None else _axis_names(results[0])
    rows = len(names)
    figure = Figure(figsize=(11.0, max(4.6, 2.0 * rows + 1.2)), layout="constrained")
    columns = 2 if bars else 1
    grid = figure.add_gridspec(rows, columns, width_ratios=(2.0, 1.0)[:columns])
    axes: list[Any] = []
    for row in range(rows):
        axes.append(figure.add_subplot(grid[row, 0], sharex=axes[0] if axes else None))
        axes[-1].tick_params(labelbottom=row == rows - 1)
    if band is None:
        _draw_coordinates(axes, results)
    else:
        for column, axis in enumerate(axes):
            _draw_band(axis, band, column)
            _draw_results(axis, results, band, column)
    axes[0].legend(fontsize=8, frameon=False, loc="best")
    axes[-1].set_xlabel("time [s]")
    if bars:
        _draw_bars(figure.add_subplot(grid[:, 1]), bars, depth=5.0 * rows)
    figure.suptitle(_title(resolved, results, band), x=0.01, ha="left", fontsize=12, fontweight="bold")
    notes = wrap(_subtitle(resolved, band, has_bars=bool(bars)), 185)
    figure.supxlabel("\n".join(notes), x=0.01, ha="left", fontsize=8, color="#505050")
    return figure


# --- curves ----------------------------------------------------------------------------------------------------------


def _draw_band(axis: Axes, band: Band, column: int) -> None:
    """Mean with one and two sigma; where it is extrapolated, hatched and dotted instead of solid."""
    times = np.arange(len(band.mean)) / FRAME_RATE_HZ
    mean, sigma = band.mean[:, column], band.sigma[:, column]
    # A law is a line that simulations lie on: wide and below them. A measured mean is dots, and above them.
    is_law = band.grade is BandGrade.LAW
    width, order = (3.0, 2) if is_law else (1.1, 5)
    for measured in (True, False):
        # A segment belongs to what is measured when both of its ends are; drawn piece by piece, they do not overlap.
        for start, end in _runs(band.measured[:-1] & band.measured[1:], measured):
            piece = slice(start, end + 1)
            hatch = {} if measured else HATCH
            for reach, shade in ((2.0, "#e3e3e3"), (1.0, "#c4c4c4")):
                low, high = mean[piece] - reach * sigma[piece], mean[piece] + reach * sigma[piece]
                axis.fill_between(times[piece], low, high, facecolor=shade, zorder=1, **hatch)
            axis.plot(times[piece], mean[piece], color=REAL, lw=width, ls="-" if measured else ":", zorder=order)
    if not is_law:
        for flags, face in ((band.measured, REAL), (~band.measured, "white")):
            axis.plot(times[flags], mean[flags], "o", ms=3.0, mew=0.8, mec=REAL, mfc=face, zorder=6)
    if column == 0:
        axis.plot([], [], "-" if is_law else "o-", ms=3.0, color=REAL, lw=width, label=_mean_label(band))
        axis.fill_between([], [], facecolor="#c4c4c4", label="real, 1 sigma")
        axis.fill_between([], [], facecolor="#e3e3e3", label="real, 2 sigma")
        if not band.measured.all():
            axis.fill_between([], [], facecolor="#c4c4c4", label="extrapolated, not measured", **HATCH)
    axis.set_ylabel(f"{band.coordinates[column]} [{band.unit}]")
    _tidy(axis)


def _mean_label(band: Band) -> str:
    count = f" ({band.trial_count} trials)" if band.trial_count else ""
    return "law" if band.grade is BandGrade.LAW else f"real, mean{count}"


def _runs(flags: NDArray[np.bool_], wanted: bool) -> Iterator[tuple[int, int]]:
    """Half-open ranges of segments whose flag is as wanted."""
    padded = np.concatenate([[False], flags == wanted, [False]]).astype(int)
    edges = np.diff(padded)
    yield from zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True)


def _draw_results(axis: Axes, results: Sequence[Result], band: Band, column: int) -> None:
    end = (len(band.mean) - 1) / FRAME_RATE_HZ
    low, high = axis.get_ylim()
    for result, color, label in zip(results, _colors(results), _labels(results), strict=True):
        times, samples = _recorded(result).arrays()
        values = band.project(samples)[:, column]
        low, high = _span(low, high, values)
        ending = ", diverged" if result.diverged else ""
        axis.plot(times, values, color=color, lw=1.8, label=label + ending if column == 0 else None, zorder=4)
        offset = result.score.release_offset_s
        if offset is not None:
            moved = np.interp(times - offset, times, values)
            title = f"{label}, {offset:+.3f} s to align the release" if column == 0 else None
            axis.plot(times, moved, color=color, lw=1.2, ls="--", label=title, zorder=3)
    margin = 0.04 * (high - low)
    axis.set_ylim(low - margin, high + margin)
    axis.set_xlim(0.0, end)


def _span(low: float, high: float, values: NDArray[np.float64]) -> tuple[float, float]:
    """Limits that show the values too, but no more than ten times what they showed: a diverged curve goes anywhere."""
    finite = values[np.isfinite(values)]
    reach = 10.0 * (high - low)
    return (
        max(min(low, float(finite.min(initial=low))), low - reach),
        min(max(high, float(finite.max(initial=high))), high + reach),
    )


def _draw_coordinates(axes: Sequence[Axes], results: Sequence[Result]) -> None:
    """Curves of an experiment without a band: a panel each for x, y and z, a colour a body, a line style a result."""
    recorded = _recorded(results[0])
    names, unit = recorded.coordinates, recorded.unit
    bodies = list(dict.fromkeys(name.rpartition(".")[0] or name for name in names))
    many = len(bodies) * len(results) > MOST_LEGEND_ENTRIES
    for position, (result, label) in enumerate(zip(results, _labels(results), strict=True)):
        times, samples = _recorded(result).arrays()
        style = LINE_STYLES[position % len(LINE_STYLES)]
        for index, name in enumerate(names):
            body, _, direction = name.rpartition(".")
            axis = axes["xyz".index(direction) if len(axes) == 3 else 0]
            body = body or name
            number = bodies.index(body) if len(bodies) > 1 else position
            first = axis is axes[0]
            told = None
            if first and not many:
                told = f"{body}, {label}"
            elif index == 0:
                stems = {name.rpartition("-")[0] for name in bodies}
                told = f"{label}, {len(bodies)} {f'{stems.pop()}s' if len(stems) == 1 else 'bodies'}"
            color = OURS[number % len(OURS)]
            axis.plot(times, samples[:, index], color=color, ls=style, lw=1.5 if not many else 0.9, label=told)
    for axis, title in zip(axes, _axis_names(results[0]), strict=True):
        axis.set_ylabel(f"{title} [{unit}]")
        axis.margins(x=0.0)
        _tidy(axis)


def _axis_names(result: Result) -> tuple[str, ...]:
    return ("x", "y", "z") if all("." in name for name in _recorded(result).coordinates) else ("g(t)",)


def _recorded(result: Result) -> RecordedTrajectory:
    if result.trajectory is None:
        raise ShapeError(f"{result.id} did not run, there is nothing to draw: {result.error}")
    return result.trajectory


def _tidy(axis: Axes) -> None:
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(color="#ececec", lw=0.7)
    axis.set_axisbelow(True)


def _colors(results: Sequence[Result]) -> list[str]:
    return [OURS[index % len(OURS)] for index in range(len(results))]


def _labels(results: Sequence[Result]) -> list[str]:
    """Labels of the results, numbered where they do not tell them apart."""
    labels = [result_label(result) for result in results]
    if len(set(labels)) == len(labels):
        return labels
    return [f"{label} ({number})" for number, label in enumerate(labels, start=1)]


# --- scores ----------------------------------------------------------------------------------------------------------

Bars = dict[str, list[tuple[str, float | None, str]]]
"""Label, value and colour of each bar, by metric."""


def _bar_groups(results: Sequence[Result]) -> Bars:
    """Normalized scores of the results and of the published engines, for the metrics that the paper has."""
    groups: Bars = {}
    for metric, line in published_baselines(results[0].id.removeprefix("GAUGE/")).items():
        if metric == "el":
            continue
        ours = [
            (label, getattr(result.score, f"{metric}_normalized"), color)
            for result, label, color in zip(results, _labels(results), _colors(results), strict=True)
        ]
        engines = zip(ENGINE_TITLES.items(), ENGINES, strict=True)
        groups[METRIC_TITLES[metric]] = ours + [(title, line.engines[name], color) for (name, title), color in engines]
    return groups


def _draw_bars(axis: Axes, groups: Bars, *, depth: float) -> None:
    """Bars from the top down; `depth` is how many fit at the least, so that a tall panel has no thick bars."""
    longest = max([1.2, *(value for group in groups.values() for _, value, _ in group if value is not None)])
    unit = 0.015 * longest
    ticks, places = [], []
    place = 0.0
    for metric, group in groups.items():
        axis.text(unit, place - 0.75, metric, fontsize=9, fontweight="bold", va="center", bbox=BACKING)
        for label, value, color in group:
            axis.barh(place, value or 0.0, color=color, height=0.78)
            missing = "not published" if color in ENGINES else "no reference"
            told = missing if value is None else f"{value:.2f}"
            axis.text((value or 0.0) + unit, place, told, va="center", fontsize=8, color="#404040", bbox=BACKING)
            places.append(place)
            ticks.append("\n".join(wrap(label, 22)))
            place += 1.0
        place += 1.1
    axis.axvline(1.0, color=REAL, lw=1.0, ls="--", zorder=2)
    axis.set_yticks(places, ticks, fontsize=8)
    axis.set_ylim(max(place - 1.3, depth), -1.3)
    axis.set_xlim(0.0, 1.2 * longest)
    meaning = "a typical real trial" if METRIC_TITLES["rmse"] in groups else "the real mean, ideal"
    axis.set_xlabel(f"normalized score; 1 = {meaning}")
    _tidy(axis)
    axis.grid(visible=False, axis="y")
    axis.tick_params(axis="y", length=0)


# --- words -----------------------------------------------------------------------------------------------------------


def _title(resolved: Experiment, results: Sequence[Result], band: Band | None) -> str:
    spec, variant = resolved.spec, resolved.variant
    subtask = f", {spec.subtasks[variant.subtask].title}" if variant.subtask else ""
    reference = "" if band is not None else " (no reference trajectory)"
    return f"{results[0].id}: {spec.title}{subtask}{reference}"


def _subtitle(resolved: Experiment, band: Band | None, *, has_bars: bool) -> str:
    grade = BandGrade.NONE if band is None else band.grade
    parts = [f"Grade {grade.value}: {GRADE_NOTES[grade]}."]
    parts += [f"{band.source}."] if band is not None else []
    parts += [f"Driver: {resolved.driver_provenance}."] if resolved.driver_provenance else []
    parts += ["Engines: as published (GAUGE, Table 5)."] if has_bars else []
    return " ".join(parts)
