"""Read trajectories of other simulators: CSV, NPZ or JSON files with g(t).

No physics engine is needed. Values are in the unit of the observable: mm for positions, rad for curvatures, mm^2 for
face areas. Columns are the coordinates of g(t) in the order of `coordinate_names`.

- CSV: one row per sample, an optional header, an optional column `time_s` that the header names. `#` starts a comment.
- NPZ: arrays `g`, shape [T, C]; optionally `time_s`, shape [T], and `markers_m`, shape [T, M, 3], the markers [m].
- JSON: an object with `g`, a list of rows, and optionally `time_s` and `id`; or a result file of this package.

A CSV header that names coordinates (`cube.x` or `cube.x [mm]`) may list them in any order. Any other header is skipped.
Without times, rows are the 30 Hz frames. With times, the first is 0. A sample counts as a frame if it is within 0.5 ms
and within a tenth of the sample spacing. Other frames are interpolated linearly; `interpolated_frames` counts them.
Samples of up to 10 frames after the last published one serve the time alignment: a file that ends with the last frame
is not shifted to earlier times. Later ones are not used; without times they are an error, as another rate.
"""

import csv
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.errors import TrajectoryFileError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import csv_text, json_document, npz_arrays, os_errors
from gauge_envs.observables.kinds import Observable
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.likely_mistakes import count_mistake, time_mistake
from gauge_envs.scoring.metrics import MAX_TIME_OFFSET_S, interpolated

FRAME_TOLERANCE_S = 5e-4
"""Samples this close to a frame count as the frame [s]; it is the error of times printed with three digits."""

TIME = "time_s"
"""Name of the column of times."""

TIME_NAME = re.compile(
    r"(?i)(t|time|timestamp|sim_?time|seconds?|(t|time)[ _-]*\(?(s|sec|ms|seconds?)\)?)"
)
"""Names of columns that hold times."""

LARGEST = 10**12
"""Larger values are mistakes, and their squares overflow."""


@dataclass(frozen=True, kw_only=True)
class UserTrajectory:
    """A generalized trajectory that covers every frame of its experiment.

    Attributes:
        times_s: Strictly increasing times from 0 to the last frame or later [s], the 30 Hz frames among them, shape
            [sample_count].
        values: g(t) at those times in the observable's unit, shape [sample_count, coordinate_count].
        interpolated_frames: Number of frames without a sample in the file.
        markers_m: Marker positions at the 30 Hz frames [m], shape [frame_count, marker_count, 3]; None if the file does
            not give them. A g(t) of marker positions gives them too.
    """

    times_s: FloatArray
    values: FloatArray
    interpolated_frames: int
    markers_m: FloatArray | None = None


@dataclass(frozen=True, kw_only=True)
class StatedOrigin:
    """What a trajectory file states about its origin; only JSON files state any of it.

    Attributes:
        id: Id of the experiment.
        parameters: Parameters of the scene, not checked.
        has_asset: Whether the file is a result whose scene was that of an asset.
        jitter: Standard deviations of its start, or its trial, as `Result.jitter`; empty for none.
    """

    id: str | None = None
    parameters: Any = None
    has_asset: bool = False
    jitter: Mapping[str, Any] = field(default_factory=dict)


def stated_origin(file: Path) -> StatedOrigin:
    """Return what a trajectory file states about its origin.

    Raises:
        TrajectoryFileError: The file cannot be read, or its id is no text.
    """
    if file.suffix.lower() != ".json":
        return StatedOrigin()
    content = _json_object(file)
    name, jitter = content.get("id"), content.get("jitter")
    if name is not None and not isinstance(name, str):
        raise TrajectoryFileError(
            f"{file}: id is {name!r}, expected text such as 'GAUGE/SlopeSlider-2-wood'"
        )
    return StatedOrigin(
        id=name,
        parameters=content.get("parameters"),
        has_asset=bool(content.get("asset")),
        jitter=jitter if isinstance(jitter, dict) else {},
    )


def read_trajectory(file: Path, experiment: Experiment) -> UserTrajectory:
    """Read the trajectory of an experiment from a CSV, NPZ or JSON file (formats: see the module).

    Args:
        file: The file; its suffix selects the format.
        experiment: Experiment that was simulated.

    Raises:
        TrajectoryFileError: The file cannot be read, or a row, a column or a time is wrong; the message names it.
    """
    readers = {".csv": _read_csv, ".npz": _read_npz, ".json": _read_json}
    reader = readers.get(file.suffix.lower())
    if reader is None:
        raise TrajectoryFileError(
            f"{file}: unknown suffix {file.suffix!r}, expected {', '.join(readers)}"
        )
    names, frame_count = experiment.coordinates, experiment.frame_count
    layout = _Layout(file, names, experiment.score.observable.unit)
    table = reader(layout)
    columns = layout.columns(table)
    values = columns[:, -len(names) :]
    if table.has_times:
        times_s = columns[:, 0]
        fault = time_mistake(times_s, frame_count) if len(times_s) > 1 else None
    else:
        times_s = np.arange(len(values)) / FRAME_RATE_HZ
        fault = count_mistake(len(values), frame_count)
    if fault is not None:
        raise layout.error("", fault)
    markers = experiment.scene.markers
    places_m = table.markers_m
    if experiment.score.observable is Observable.MARKER_POSITION:
        # A g(t) of marker positions is those of the markers.
        places_m = 1e-3 * values.reshape(len(values), -1, 3)
    width = values.shape[1]
    if places_m is not None:
        count = 0 if markers is None else len(markers.positions_m)
        layout.check_markers(places_m, [len(values), count, 3])
        values = np.concatenate([values, places_m.reshape(len(values), -1)], axis=1)
    times_s, values, interpolated_frames = _on_frames(
        file, times_s, values, frame_count
    )
    markers_m = None
    if places_m is not None:
        frames_s = np.arange(frame_count) / FRAME_RATE_HZ
        rows = values[np.searchsorted(times_s, frames_s - 1e-9)]
        markers_m = rows[:, width:].reshape(-1, *places_m.shape[1:])
    return UserTrajectory(
        times_s=times_s,
        values=values[:, :width],
        interpolated_frames=interpolated_frames,
        markers_m=markers_m,
    )


# --- tables ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Table:
    """Cells of a file: the coordinates of g(t) in their order, after the time if there is one.

    Attributes:
        rows: Cells of each row.
        places: Place of each row in the file, for messages.
        has_times: Whether the first cell is the time.
        markers_m: Markers at the rows [m], shape [T, M, 3]; None without any.
    """

    rows: Sequence[Any]
    places: Sequence[str]
    has_times: bool
    markers_m: FloatArray | None = None


@dataclass(frozen=True)
class _Layout:
    """Required content of a file, for checks and messages."""

    file: Path
    names: tuple[str, ...]
    unit: str

    def error(self, place: str, reason: str) -> TrajectoryFileError:
        where = f"{self.file}: {place}" if place else str(self.file)
        return TrajectoryFileError(f"{where}: {reason}")

    @property
    def expected(self) -> str:
        shown = [f"{name} [{self.unit}]" for name in self.names]
        if len(shown) > 6:
            shown = [*shown[:3], "...", shown[-1]]
        return f"expected {len(self.names)} columns: {', '.join(shown)}"

    def columns(self, table: _Table) -> FloatArray:
        """Return the cells of a table as numbers, shape [T, column_count]."""
        names = (TIME, *self.names) if table.has_times else self.names
        values = np.empty((len(table.rows), len(names)))
        for index, (row, place) in enumerate(
            zip(table.rows, table.places, strict=True)
        ):
            values[index] = [
                self._number(place, name, cell)
                for name, cell in zip(names, row, strict=True)
            ]
        return values

    def _number(self, place: str, name: str, cell: Any) -> float:
        """Return the finite number at a place of the file."""
        unit = "s" if name == TIME else self.unit
        wanted = ""
        number = math.nan
        try:
            if isinstance(cell, bool):
                raise ValueError
            number = float(cell)
        except (TypeError, ValueError, OverflowError):
            wanted = "a number"
        if not wanted and not math.isfinite(number):
            wanted = "a finite number"
        elif not wanted and abs(number) > LARGEST:
            wanted = f"at most {LARGEST:g}"
        if wanted:
            raise self.error(
                place, f"{name} is {_short(cell)}, expected {wanted} [{unit}]"
            )
        return number

    def check_markers(self, markers_m: FloatArray, shape: list[int]) -> None:
        """Raise an error for markers of another shape, or with a value that is not finite."""
        if list(markers_m.shape) != shape:
            raise self.error(
                "markers_m", f"shape is {list(markers_m.shape)}, expected {shape}"
            )
        if not np.isfinite(markers_m).all():
            raise self.error("markers_m", "a value is not a finite number [m]")


def _short(value: Any) -> str:
    if isinstance(value, dict | list):
        return f"a {type(value).__name__} of {len(value)}"
    is_huge = isinstance(value, int) and abs(value) > LARGEST
    text = "a huge integer" if is_huge else repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _content(file: Path) -> bytes:
    with os_errors(
        lambda cause: TrajectoryFileError(f"{file}: cannot be read: {cause}")
    ):
        content = file.read_bytes()
    if not content.strip():
        raise TrajectoryFileError(f"{file}: the file is empty")
    return content


# --- CSV -------------------------------------------------------------------------------------------------------------


def _read_csv(layout: _Layout) -> _Table:
    lines, header = _csv_lines(layout)
    place, first = lines[0]
    if len(first) == 1 < len(layout.names) and len(re.split(r"[;\s]+", first[0])) > 1:
        raise layout.error(
            place,
            f"one column, expected columns separated by commas; {layout.expected}",
        )
    if not any(_is_number(cell) for cell in first) and "" not in first:
        header = lines.pop(0)[1]
    order, has_times = list(range(len(layout.names))), False
    if header is not None:
        order, has_times = _csv_order(layout, header)
    for place, cells in lines:
        if len(cells) != len(order):
            timed = f"{TIME} and then " if has_times else ""
            named = "; a time column needs a header that names it time_s"
            named = "" if header else named
            raise layout.error(
                place, f"{len(cells)} columns, {timed}{layout.expected}{named}"
            )
    rows = [[cells[column] for column in order] for _, cells in lines]
    places = [place for place, _ in lines]
    return _Table(rows=rows, places=places, has_times=has_times)


def _csv_lines(
    layout: _Layout,
) -> tuple[list[tuple[str, list[str]]], list[str] | None]:
    """Return place and cells of each row that is no comment; and the comment that is a header, or None."""
    lines: list[tuple[str, list[str]]] = []
    header = None
    try:
        reader = csv.reader(csv_text(_content(layout.file)))
        for raw in reader:
            cells = [cell.strip() for cell in raw]
            if not any(cells):
                continue
            if not cells[0].startswith("#"):
                lines.append((f"line {reader.line_num}", cells))
                continue
            # numpy.savetxt writes its header as a comment.
            names = [cell.strip(" #\t") for cell in cells]
            if not lines and TIME in names:
                header = names
    except (UnicodeDecodeError, csv.Error) as error:
        raise layout.error("", f"not a CSV file: {error}") from error
    if not lines:
        raise layout.error("", "no rows")
    return lines, header


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _csv_order(layout: _Layout, header: Sequence[str]) -> tuple[list[int], bool]:
    """Return the column of the time, if there is one, and of each coordinate; and whether there is a time."""
    names = []
    for column in header:
        name, bracket, rest = (part.strip(" ]") for part in column.partition("["))
        if TIME_NAME.fullmatch(name) and name != TIME:
            raise layout.error(
                "header",
                f"column {column!r}: a time column is named {TIME}, seconds from the start. Rename it",
            )
        wanted = "s" if name == TIME else layout.unit
        if bracket and name in (*layout.names, TIME) and rest != wanted:
            raise layout.error(
                "header", f"column {name} is in [{rest}], expected [{wanted}]"
            )
        names.append(name)
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise layout.error("header", f"column {twice[0]!r} appears twice")
    has_times = TIME in names
    others = [name for name in names if name != TIME]
    if not set(others) & set(layout.names):
        if len(others) != len(layout.names):
            raise layout.error(
                "header", f"{len(others)} columns beside {TIME}, {layout.expected}"
            )
        chosen = others
    else:
        missing = [name for name in layout.names if name not in others]
        unknown = [name for name in others if name not in layout.names]
        if missing:
            raise layout.error("header", f"no column {missing[0]!r}, {layout.expected}")
        if unknown:
            raise layout.error(
                "header", f"unknown column {unknown[0]!r}, {layout.expected}"
            )
        chosen = list(layout.names)
    return [names.index(name) for name in [TIME] * has_times + chosen], has_times


# --- NPZ and JSON ----------------------------------------------------------------------------------------------------


def _read_npz(layout: _Layout) -> _Table:
    try:
        arrays = npz_arrays(_content(layout.file))
    except ValueError as error:
        raise layout.error("", f"not an NPZ file: {error}") from error
    if "g" not in arrays:
        names = ", ".join([*arrays][:8]) or "none"
        raise layout.error("", f"no array 'g', it has: {names}; {layout.expected}")
    g, times = arrays["g"], arrays.get(TIME)
    if g.ndim != 2 or g.shape[1] != len(layout.names):
        raise layout.error(
            "g",
            f"shape is {list(g.shape)}, expected [T, {len(layout.names)}]; {layout.expected}",
        )
    if times is not None and times.shape != g.shape[:1]:
        raise layout.error(
            TIME,
            f"shape is {list(times.shape)}, expected [{len(g)}] as g has {len(g)} rows",
        )
    rows = g if times is None else np.column_stack([times, g])
    markers = arrays.get("markers_m")
    return _Table(
        rows=rows.tolist(),
        places=[f"g, row {index}" for index in range(len(g))],
        has_times=times is not None,
        markers_m=None if markers is None else markers.astype(np.float64),
    )


def _json_object(file: Path) -> dict[str, Any]:
    try:
        content = json_document(_content(file))
    except ValueError as error:
        raise TrajectoryFileError(f"{file}: not a JSON file: {error}") from error
    if not isinstance(content, dict):
        raise TrajectoryFileError(
            f"{file}: expected a JSON object with 'g', got a {type(content).__name__}"
        )
    return content


def _read_json(layout: _Layout) -> _Table:
    content = _json_object(layout.file)
    key, times, markers_mm = "g", content.get(TIME), None
    rows = content.get(key)
    if "g" not in content and isinstance(content.get("trajectory"), dict):
        # A result file: samples after the last frame serve the time alignment.
        recorded = content["trajectory"]
        key, markers_mm = "samples", recorded.get("markers_mm")
        rows = _joined(recorded, "samples", "later_samples")
        times = _joined(recorded, "times_s", "later_times_s")
    if not isinstance(rows, list):
        raise layout.error("", f"no list {key!r} of rows; {layout.expected}")
    places = [f"{key}, row {index}" for index in range(len(rows))]
    for row, place in zip(rows, places, strict=True):
        if not isinstance(row, list):
            raise layout.error(
                place, f"{_short(row)} is not a list of numbers; {layout.expected}"
            )
        if len(row) != len(layout.names):
            raise layout.error(place, f"{len(row)} columns, {layout.expected}")
    if times is None:
        return _Table(rows=rows, places=places, has_times=False)
    if not isinstance(times, list) or len(times) != len(rows):
        count = f"{len(times)} entries" if isinstance(times, list) else _short(times)
        raise layout.error(
            TIME,
            f"{count}, expected a list of {len(rows)} times as {key} has {len(rows)} rows",
        )
    timed = [[time, *row] for time, row in zip(times, rows, strict=True)]
    markers_m = _frame_markers(times, markers_mm) if markers_mm else None
    return _Table(rows=timed, places=places, has_times=True, markers_m=markers_m)


def _joined(recorded: Mapping[str, Any], first: str, later: str) -> Any:
    """Return the list of a result file with that of the samples after the last frame."""
    values, added = recorded.get(first), recorded.get(later)
    if isinstance(values, list) and isinstance(added, list):
        return [*values, *added]
    return values


def _frame_markers(times_s: ArrayLike, markers_mm: ArrayLike) -> FloatArray:
    """Return the markers of a result file, which has them at the frames alone, at all samples [m]."""
    rows_mm = np.asarray(markers_mm, dtype=np.float64)
    frames_s = np.arange(len(rows_mm)) / FRAME_RATE_HZ
    at_s = np.asarray(times_s, dtype=np.float64)
    return 1e-3 * interpolated(at_s, frames_s, rows_mm).reshape(len(at_s), -1, 3)


# --- times -----------------------------------------------------------------------------------------------------------


def _on_frames(
    file: Path, times_s: FloatArray, values: FloatArray, frame_count: int
) -> tuple[FloatArray, FloatArray, int]:
    """Check the times, insert every frame, and cut what is too late for the time alignment.

    Returns:
        Times and values, and the number of frames that were interpolated.
    """
    frames = np.arange(frame_count) / FRAME_RATE_HZ
    needed = (
        f"{frame_count} frames are needed, 30 a second from 0 to {frames[-1]:.4f} s"
    )
    if len(times_s) < 2:
        raise TrajectoryFileError(f"{file}: {len(times_s)} rows; {needed}")
    steps = np.diff(times_s)
    if (steps <= 0.0).any():
        row = int(np.argmax(steps <= 0.0)) + 1
        raise TrajectoryFileError(
            f"{file}: row {row}: time_s is {times_s[row]:g} after {times_s[row - 1]:g}, expected increasing times"
        )
    tolerance = min(FRAME_TOLERANCE_S, 0.1 * float(np.median(steps))) + 1e-9
    if abs(times_s[0]) > tolerance:
        raise TrajectoryFileError(
            f"{file}: row 0: time_s is {times_s[0]:g}, expected 0: the episode starts there"
        )
    if times_s[-1] < frames[-1] - tolerance:
        raise TrajectoryFileError(
            f"{file}: {len(times_s)} rows end at {times_s[-1]:.4f} s; {needed}"
        )
    # A frame takes the nearest sample, if that is near enough. The times stay increasing.
    right = np.clip(np.searchsorted(times_s, frames), 1, len(times_s) - 1)
    is_left = frames - times_s[right - 1] <= times_s[right] - frames
    nearest = np.where(is_left, right - 1, right)
    hit = np.abs(times_s[nearest] - frames) <= tolerance
    gap = times_s[right] - times_s[right - 1]
    wide = ~hit & (gap > 1.0 / FRAME_RATE_HZ + 2.0 * tolerance)
    if wide.any():
        frame = int(wide.argmax())
        before, after = times_s[right[frame] - 1], times_s[right[frame]]
        raise TrajectoryFileError(
            f"{file}: no sample at frame {frame} (t = {frames[frame]:.4f} s), the nearest are at {before:.4f} and "
            f"{after:.4f} s; {needed}"
        )
    times = times_s.copy()
    times[nearest[hit]] = frames[hit]
    between = frames[~hit]
    all_times = np.concatenate([times, between])
    all_values = np.concatenate([values, interpolated(between, times_s, values)])
    order = np.argsort(all_times, kind="stable")
    last_s = frames[-1] + MAX_TIME_OFFSET_S + FRAME_TOLERANCE_S
    order = order[all_times[order] <= last_s]
    return all_times[order], all_values[order], len(between)
