"""Read trajectories of other simulators: CSV, NPZ or JSON files with g(t).

No physics engine is needed. Values are in the unit of the observable: mm for positions, rad for curvatures, mm^2 for
face areas. Columns are the coordinates of g(t) in the order of `coordinate_names`.

- CSV: one row per sample, an optional header, an optional column `time_s` that the header names. `#` starts a comment.
- NPZ: arrays `g`, shape [T, C]; optionally `time_s`, shape [T], and `markers_m`, shape [T, M, 3], the markers [m].
- JSON: an object with `g`, a list of rows, and optionally `time_s` and `id`; or a result file of this package.

A CSV header that names coordinates (`cube.x` or `cube.x [mm]`) may list them in any order. Any other header is skipped.
Without times, rows are the 30 Hz frames. With times, the first is 0. A sample counts as a frame if it is within 0.5 ms
and within a tenth of the sample spacing. Other frames are interpolated linearly; `interpolated_frames` counts them.
Samples of up to 10 frames after the last published one serve the time alignment: a file that ends with the last
frame is not shifted to earlier times. Later ones are not used; without times they are an error, as another rate.
"""

import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import TrajectoryFileError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import (
    csv_text,
    json_document,
    npz_arrays,
    os_errors,
)
from gauge_envs.observables.kinds import Observable
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.likely_mistakes import count_mistake, time_mistake
from gauge_envs.scoring.metrics import MAX_TIME_OFFSET_S, interpolated

FRAME_TOLERANCE_S = 5e-4
"""Samples this close to a frame count as the frame [s]; it is the error of times printed with three digits."""


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
    """Return what a trajectory file states about its origin."""
    if file.suffix.lower() != ".json":
        return StatedOrigin()
    content = _json_object(file)
    name, parameters = content.get("id"), content.get("parameters")
    if name is not None and not isinstance(name, str):
        raise TrajectoryFileError(
            f"{file}: id is {name!r}, expected text such as 'GAUGE/SlopeSlider-2-wood'"
        )
    jitter = content.get("jitter")
    return StatedOrigin(
        id=name,
        parameters=parameters,
        has_asset=bool(content.get("asset")),
        jitter=jitter if isinstance(jitter, dict) else {},
    )


def read_trajectory(file: Path, experiment: Experiment) -> UserTrajectory:
    """Read the trajectory of an experiment from a CSV, NPZ or JSON file (formats: see the module).

    Args:
        file: The file; its suffix selects the format.
        experiment: Experiment that was simulated.
    """
    readers = {".csv": _read_csv, ".npz": _read_npz, ".json": _read_json}
    reader = readers.get(file.suffix.lower())
    if reader is None:
        raise TrajectoryFileError(
            f"{file}: unknown suffix {file.suffix!r}, expected {', '.join(readers)}"
        )
    known = experiment.scene.markers
    layout = _FileLayout(
        file,
        experiment.coordinates,
        experiment.score.observable.unit,
        marker_count=0 if known is None else len(known.positions_m),
    )
    times, values, markers = reader(layout)
    if times is None:
        fault = count_mistake(len(values), experiment.frame_count)
        if fault is not None:
            raise layout.error("", fault)
        times = np.arange(len(values)) / FRAME_RATE_HZ
    elif len(times) > 1:
        fault = time_mistake(times, experiment.frame_count)
        if fault is not None:
            raise layout.error("", fault)
    width = values.shape[1]
    # A g(t) of marker positions is those of the markers, so theirs add nothing.
    is_of_markers = experiment.score.observable is Observable.MARKER_POSITION
    if markers is not None and not is_of_markers:
        values = np.concatenate([values, markers.reshape(len(values), -1)], axis=1)
    trajectory = _on_frames(file, times, values, experiment.frame_count)
    if is_of_markers:
        rows = _frame_rows(trajectory, experiment.frame_count)
        return replace(
            trajectory, markers_m=1e-3 * rows[:, :width].reshape(-1, width // 3, 3)
        )
    if markers is None:
        return trajectory
    markers_m = _frame_rows(trajectory, experiment.frame_count)[:, width:].reshape(
        -1, *markers.shape[1:]
    )
    return replace(trajectory, values=trajectory.values[:, :width], markers_m=markers_m)


def _frame_rows(trajectory: UserTrajectory, frame_count: int) -> FloatArray:
    """Return the samples at the 30 Hz frames of the experiment, without later ones."""
    frames = np.arange(frame_count) / FRAME_RATE_HZ
    return trajectory.values[np.searchsorted(trajectory.times_s, frames - 1e-9)]


@dataclass(frozen=True)
class _FileLayout:
    """Required content of a file, for checks and messages."""

    file: Path
    names: tuple[str, ...]
    unit: str
    marker_count: int

    def error(self, place: str, reason: str) -> TrajectoryFileError:
        return TrajectoryFileError(
            f"{self.file}: {place}: {reason}" if place else f"{self.file}: {reason}"
        )

    @property
    def expected(self) -> str:
        shown = [f"{name} [{self.unit}]" for name in self.names]
        if len(shown) > 6:
            shown = [*shown[:3], "...", shown[-1]]
        return f"expected {len(self.names)} columns: {', '.join(shown)}"

    def number(self, place: str, column: str, value: Any) -> float:
        """Return the finite number at a place of the file."""
        unit = "s" if column == "time_s" else self.unit
        try:
            if isinstance(value, bool):
                raise ValueError
            number = float(value)
        except (TypeError, ValueError, OverflowError):
            raise self.error(
                place, f"{column} is {_short(value)}, expected a number [{unit}]"
            ) from None
        if not math.isfinite(number):
            raise self.error(
                place, f"{column} is {_short(value)}, expected a finite number [{unit}]"
            )
        if abs(number) > LARGEST:
            raise self.error(
                place,
                f"{column} is {_short(value)}, expected at most {LARGEST:g} [{unit}]",
            )
        return number

    def table(self, rows: Sequence[Any], places: Sequence[str]) -> FloatArray:
        """Return rows of numbers as an array, shape [len(rows), coordinate_count]."""
        values = np.empty((len(rows), len(self.names)))
        for index, (row, place) in enumerate(zip(rows, places, strict=True)):
            if not isinstance(row, list):
                raise self.error(
                    place, f"{_short(row)} is not a list of numbers; {self.expected}"
                )
            if len(row) != len(self.names):
                raise self.error(place, f"{len(row)} columns, {self.expected}")
            values[index] = [
                self.number(place, *entry)
                for entry in zip(self.names, row, strict=True)
            ]
        return values


def _short(value: Any) -> str:
    if isinstance(value, dict | list):
        return f"a {type(value).__name__} of {len(value)}"
    text = (
        repr(value)
        if not isinstance(value, int) or abs(value) <= LARGEST
        else "a huge integer"
    )
    return text if len(text) <= 40 else f"{text[:37]}..."


# --- formats ---------------------------------------------------------------------------------------------------------

Columns = tuple[FloatArray | None, FloatArray, FloatArray | None]
"""Times [s], shape [T], or None; g(t), shape [T, C]; markers [m], shape [T, M, 3], or None."""


def _bytes(file: Path) -> bytes:
    with os_errors(
        lambda cause: TrajectoryFileError(f"{file}: cannot be read: {cause}")
    ):
        content = file.read_bytes()
    if not content.strip():
        raise TrajectoryFileError(f"{file}: the file is empty")
    return content


def _csv_rows(
    layout: _FileLayout,
) -> tuple[list[tuple[str, list[str]]], list[str] | None]:
    """Return place and fields of each row that is no comment; and the comment that is a header, or None."""
    rows: list[tuple[str, list[str]]] = []
    header: list[str] | None = None
    try:
        reader = csv.reader(csv_text(_bytes(layout.file)))
        for fields in reader:
            if not any(field.strip() for field in fields):
                continue
            if not fields[0].lstrip().startswith("#"):
                rows.append(
                    (f"line {reader.line_num}", [field.strip() for field in fields])
                )
            elif not rows and "time_s" in (
                names := [field.strip(" #\t") for field in fields]
            ):
                header = names  # numpy.savetxt writes its header as a comment.
    except (UnicodeDecodeError, csv.Error) as error:
        raise layout.error("", f"not a CSV file: {error}") from error
    if not rows:
        raise layout.error("", "no rows")
    return rows, header


def _read_csv(layout: _FileLayout) -> Columns:
    lines, header = _csv_rows(layout)
    place, first = lines[0]
    if (
        len(first) == 1 < len(layout.names)
        and len(first[0].replace(";", " ").split()) > 1
    ):
        raise layout.error(
            place,
            f"one column, expected columns separated by commas; {layout.expected}",
        )
    if not any(_is_number(field) for field in first) and "" not in first:
        header = lines.pop(0)[1]
    places, rows = [place for place, _ in lines], [fields for _, fields in lines]
    order, time_column = _csv_columns(layout, header)
    width = len(order) + (time_column is not None)
    for place, fields in lines:
        if len(fields) != width:
            timed = (
                "time_s and then "
                if time_column == 0
                else "time_s and "
                if time_column is not None
                else ""
            )
            named = (
                "" if header else "; a time column needs a header that names it time_s"
            )
            raise layout.error(
                place, f"{len(fields)} columns, {timed}{layout.expected}{named}"
            )
    times = None
    if time_column is not None:
        times = np.array(
            [
                layout.number(place, "time_s", row[time_column])
                for place, row in zip(places, rows, strict=True)
            ]
        )
    return times, layout.table([[row[i] for i in order] for row in rows], places), None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _csv_columns(
    layout: _FileLayout, header: list[str] | None
) -> tuple[list[int], int | None]:
    """Return the column of each coordinate, and the column of the time or None."""
    if header is None:
        return list(range(len(layout.names))), None
    named = []
    for column in header:
        name, bracket, rest = column.partition("[")
        name, unit = name.strip(), rest.strip(" ]")
        if TIME_NAME.fullmatch(name) and name != "time_s":
            raise layout.error(
                "header",
                f"column {column!r}: a time column is named time_s, seconds from the start. Rename it",
            )
        wanted = "s" if name == "time_s" else layout.unit
        if bracket and (name in layout.names or name == "time_s") and unit != wanted:
            raise layout.error(
                "header", f"column {name} is in [{unit}], expected [{wanted}]"
            )
        named.append(name)
    if len(set(named)) < len(named):
        twice = next(name for name in named if named.count(name) > 1)
        raise layout.error("header", f"column {twice!r} appears twice")
    time_column = named.index("time_s") if "time_s" in named else None
    others = [index for index in range(len(named)) if index != time_column]
    if set(named) & set(layout.names):
        missing = [name for name in layout.names if name not in named]
        unknown = [named[index] for index in others if named[index] not in layout.names]
        if missing or unknown:
            fault = (
                f"no column {missing[0]!r}"
                if missing
                else f"unknown column {unknown[0]!r}"
            )
            raise layout.error("header", f"{fault}, {layout.expected}")
        return [named.index(name) for name in layout.names], time_column
    if len(others) != len(layout.names):
        raise layout.error(
            "header", f"{len(others)} columns beside time_s, {layout.expected}"
        )
    return others, time_column


def _read_npz(layout: _FileLayout) -> Columns:
    content = _bytes(layout.file)
    try:
        arrays = npz_arrays(content, ("g", "time_s", "markers_m"))
    except ValueError as error:
        raise layout.error("", f"not an NPZ file: {error}") from error
    if "g" not in arrays:
        with np.load(io.BytesIO(content)) as archive:
            names = ", ".join(archive.files[:8]) or "none"
        raise layout.error("", f"no array 'g', it has: {names}; {layout.expected}")
    for name, array in arrays.items():
        if name in ("g", "time_s") and array.dtype.kind not in "fiu":
            raise layout.error(name, f"holds {array.dtype} values, expected numbers")
    with np.errstate(over="ignore"):
        g = np.asarray(arrays["g"], dtype=np.float64)
        times = (
            np.asarray(arrays["time_s"], dtype=np.float64)
            if "time_s" in arrays
            else None
        )
    if g.ndim != 2 or g.shape[1] != len(layout.names):
        raise layout.error(
            "g",
            f"shape is {list(g.shape)}, expected [T, {len(layout.names)}]; {layout.expected}",
        )
    for row, column in np.argwhere(~(np.abs(g) <= LARGEST))[:1]:
        layout.number(f"g, row {row}", layout.names[column], g[row, column].item())
    markers = _markers(layout, arrays.get("markers_m"), len(g))
    if times is None:
        return None, g, markers
    if times.shape != g.shape[:1]:
        raise layout.error(
            "time_s",
            f"shape is {list(times.shape)}, expected [{len(g)}] as g has {len(g)} rows",
        )
    for row in np.flatnonzero(~(np.abs(times) <= LARGEST))[:1]:
        layout.number(f"row {row}", "time_s", times[row].item())
    return times, g, markers


def _markers(
    layout: _FileLayout, markers: NDArray[Any] | None, row_count: int
) -> FloatArray | None:
    """Return the array `markers_m` of a file, shape [T, M, 3]; None without one."""
    if markers is None:
        return None
    wanted = [row_count, layout.marker_count, 3]
    if list(markers.shape) != wanted:
        raise layout.error(
            "markers_m", f"shape is {list(markers.shape)}, expected {wanted}"
        )
    if markers.dtype.kind not in "fiu" or not np.isfinite(markers).all():
        raise layout.error("markers_m", "a value is not a finite number [m]")
    return markers.astype(np.float64)


def _json_object(file: Path) -> dict[str, Any]:
    try:
        content = json_document(_bytes(file))
    except ValueError as error:
        raise TrajectoryFileError(f"{file}: not a JSON file: {error}") from error
    if not isinstance(content, dict):
        raise TrajectoryFileError(
            f"{file}: expected a JSON object with 'g', got a {type(content).__name__}"
        )
    return content


def _read_json(layout: _FileLayout) -> Columns:
    content = _json_object(layout.file)
    key, times = "g", content.get("time_s")
    markers_mm = None
    if "g" not in content and isinstance(content.get("trajectory"), dict):
        content = content["trajectory"]
        key, times = "samples", content.get("times_s")
        markers_mm = content.get("markers_mm")
        later_s, later = content.get("later_times_s"), content.get("later_samples")
        if all(
            isinstance(entry, list)
            for entry in (times, content.get(key), later_s, later)
        ):
            content = content | {key: [*content[key], *later]}
            times = [*times, *later_s]
    rows = content.get(key)
    if not isinstance(rows, list):
        raise layout.error("", f"no list {key!r} of rows; {layout.expected}")
    values = layout.table(rows, [f"{key}, row {index}" for index in range(len(rows))])
    if times is None:
        return None, values, None
    if not isinstance(times, list) or len(times) != len(rows):
        count = f"{len(times)} entries" if isinstance(times, list) else _short(times)
        raise layout.error(
            "time_s",
            f"{count}, expected a list of {len(rows)} times as {key} has {len(rows)} rows",
        )
    times_s = np.array(
        [layout.number(f"row {i}", "time_s", time) for i, time in enumerate(times)]
    )
    if not markers_mm:
        return times_s, values, None
    # A result has markers at the frames alone; those between are not compared.
    rows_mm = np.asarray(markers_mm, dtype=np.float64)
    frames_s = np.arange(len(rows_mm)) / FRAME_RATE_HZ
    markers_m = 1e-3 * interpolated(times_s, frames_s, rows_mm)
    return (
        times_s,
        values,
        _markers(layout, markers_m.reshape(len(values), -1, 3), len(values)),
    )


# --- times -----------------------------------------------------------------------------------------------------------


def _on_frames(
    file: Path,
    times_s: FloatArray,
    values: FloatArray,
    frame_count: int,
) -> UserTrajectory:
    """Check the times, insert every frame, and cut what is too late for the release alignment."""
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
    nearest = np.where(
        frames - times_s[right - 1] <= times_s[right] - frames, right - 1, right
    )
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
    added = interpolated(between, times_s, values)
    order = np.argsort(np.concatenate([times, between]), kind="stable")
    times, values = (
        np.concatenate([times, between])[order],
        np.concatenate([values, added])[order],
    )
    used = times <= frames[-1] + MAX_TIME_OFFSET_S + FRAME_TOLERANCE_S
    return UserTrajectory(
        times_s=times[used], values=values[used], interpolated_frames=len(between)
    )
