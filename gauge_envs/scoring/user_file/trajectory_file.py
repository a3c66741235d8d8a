"""Read trajectories of other simulators: CSV, NPZ or JSON files with g(t).

No physics engine is needed. Values are in the unit of the observable: mm for positions, rad for curvatures, mm^2 for
face areas. Columns are the coordinates of g(t) in the order of `coordinate_names`.

- CSV: one row per sample, an optional header, and an optional column `time_s` in the header. `#` starts a comment.
  Commas, semicolons, tabs or spaces separate columns. The text is in UTF-8, or in UTF-16 with a byte-order mark.
- NPZ: arrays `g`, shape [T, C]; optionally `time_s`, shape [T], and `markers_m`, shape [T, M, 3], the markers [m].
- JSON: an object with `g`, a list of rows, and optionally `time_s` and `id`; or a result file of this package.

A CSV header with names of coordinates (`cube.x` or `cube.x [mm]`) may list them in any order. Any other header is
skipped. Without times, rows are the 30 Hz frames. With times, the first is 0. A sample counts as a frame if it is
within 0.5 ms and within a tenth of the sample spacing. Other frames are interpolated linearly from samples within half
a frame, as those of a clock that jitters by up to 5 ms; `interpolated_frames` counts them. Samples after the last frame
are ignored; without times they raise an error, because they suggest another rate. A rest of more than 1/3 s before the
release is cropped if a whole episode follows, and no motion is prescribed.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from gauge_envs.errors import TrajectoryFileError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import npz_arrays
from gauge_envs.observables.kinds import Observable
from gauge_envs.reading import faults_of, reading
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, frame_times_s
from gauge_envs.scoring.metrics import frame_index, interpolated, nearest_sample
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.user_file.motion_checks import (
    MAX_JITTER_S,
    likely_rate_hz,
    lost_marker,
    release_row,
)
from gauge_envs.text import csv_text, json_document

FILE_TOLERANCE_S = 5e-4
"""Largest time between a frame and its sample in a file [s]: the error of times printed with three digits."""

TIME = "time_s"
"""Name of the column of times."""

MAX_HEADER = 200
"""Longest header of a file in an error [characters]."""

LARGEST = 10**12
"""Largest value; larger ones are mistakes, and their squares overflow."""


@dataclass(frozen=True, kw_only=True)
class UserTrajectory:
    """A generalized trajectory that covers every frame of its experiment.

    Attributes:
        times_s: Strictly increasing times from 0 to the last frame [s], the 30 Hz frames among them, shape
            [sample_count].
        values: g(t) at those times in the observable's unit, shape [sample_count, coordinate_count].
        interpolated_frames: Number of frames without a sample in the file.
        rest_s: Duration of the rest before the release that was cropped [s]; 0 without one.
        likely_rate_hz: Rate at which rows without times follow the reference, if it is not 30 Hz.
        markers_m: Marker positions at the 30 Hz frames [m], shape [frame_count, marker_count, 3], from the file or from
            a g(t) of marker positions; None without either.
    """

    times_s: FloatArray
    values: FloatArray
    interpolated_frames: int
    rest_s: float = 0.0
    likely_rate_hz: int | None = None
    markers_m: FloatArray | None = None


class FileOrigin(BaseModel):
    """The origin that a trajectory file gives; only JSON files give one.

    Attributes:
        id: Id of the experiment.
        task_file: Task file of the user with the id, as `Result.task_file`.
        parameters: Parameters of the scene, not checked.
        asset: `Result.asset` of a result whose scene came from an asset; not checked.
        jitter: Standard deviations of its initial state, or its trial, as `Result.jitter`; empty for neither.
    """

    model_config = ConfigDict(allow_inf_nan=False)

    id: str | None = None
    task_file: str | None = None
    parameters: Any = None
    asset: Any = None
    jitter: dict[str, float] = {}


def file_origin(file: Path) -> FileOrigin:
    """Return the origin that a trajectory file gives.

    Raises:
        TrajectoryFileError: The file cannot be read, or its id is not text.
    """
    if file.suffix.lower() != ".json":
        return FileOrigin()
    with faults_of(file, TrajectoryFileError):
        return FileOrigin.model_validate(_json_object(file))


def read_trajectory(file: Path, experiment: Experiment) -> UserTrajectory:
    """Read the trajectory of an experiment from a CSV, NPZ or JSON file (formats: see the module).

    Args:
        file: The file; its suffix selects the format.
        experiment: Experiment that was simulated.

    Raises:
        TrajectoryFileError: The file cannot be read, or a row, a column or a time is wrong.
    """
    readers = {".csv": _read_csv, ".npz": _read_npz, ".json": _read_json}
    with faults_of(file, TrajectoryFileError):
        if file.suffix.lower() not in readers:
            raise ValueError(
                f"unknown suffix {file.suffix!r}, expected {', '.join(readers)}"
            )
        return _at_frames(experiment, *readers[file.suffix.lower()](file, experiment))


# --- formats ---------------------------------------------------------------------------------------------------------

Samples = tuple[FloatArray, FloatArray | None, FloatArray | None]
"""g(t) at the rows of a file, shape [T, C]; their times [s], shape [T], if given; and markers [m], if given.

Markers have the shape [T, M, 3]. A file may have fewer rows of markers, which belong to its first 30 Hz frames."""


def _read_csv(file: Path, experiment: Experiment) -> Samples:
    names = [*experiment.coordinates]
    rows: list[list[str]] = []
    places = []
    header: list[str] = []
    with reading(file, TrajectoryFileError, "a CSV file") as content:
        reader = csv.reader(csv_text(content))
        for line in reader:
            cells = [cell.strip() for cell in line]
            # Spreadsheets write separators of empty columns.
            while cells and not cells[-1]:
                cells.pop()
            if not cells:
                continue
            if cells[0].startswith("#"):
                # numpy.savetxt writes its header as a comment.
                titles = [title for cell in cells if (title := cell.strip("# "))]
                header = titles if TIME in titles else header
            elif not rows and all(map(_is_name, cells)):
                header = cells
            else:
                rows.append(cells)
                places.append(f"line {reader.line_num}")
    if header:
        names = _column_names(header, experiment)
    table = dict(zip(names, _numbers(rows, places, names, experiment).T, strict=True))
    columns = [table[name] for name in experiment.coordinates]
    return np.stack(columns, axis=1), table.get(TIME), None


def _column_names(header: Sequence[str], experiment: Experiment) -> list[str]:
    """Return the coordinate or `time_s` of each column of a header."""
    coordinates = experiment.coordinates
    names = []
    for column in header:
        name, bracket, unit = (part.strip(" ]") for part in column.partition("["))
        wanted = _unit_of(name, experiment)
        if bracket and name in (TIME, *coordinates) and unit != wanted:
            raise ValueError(
                f"header: column {name} is in [{unit:.20}], expected [{wanted}]"
            )
        names.append(name)
    columns = {*names} - {TIME}
    if len(columns) == len(coordinates) and not columns & {*coordinates}:
        # The names are from another simulator; the columns have the order of the coordinates.
        in_order = iter(coordinates)
        names = [name if name == TIME else next(in_order, "") for name in names]
    is_complete = {TIME, *names} == {TIME, *coordinates}
    if not is_complete or len(names) > len({*names}):
        titles = shorten(", ".join(header), MAX_HEADER, placeholder=" ...")
        raise ValueError(
            f"header: the columns are {titles}; {_expected(experiment)}, "
            f"separated by commas, and {TIME} for the times"
        )
    return names


def _read_npz(file: Path, experiment: Experiment) -> Samples:
    with reading(file, TrajectoryFileError, "an NPZ file") as content:
        arrays = npz_arrays(content, ("g", TIME, "markers_m"))
    rows, times_s = (
        arrays[name].tolist() if name in arrays else None for name in ("g", TIME)
    )
    return _of_rows(experiment, rows, times_s, arrays.get("markers_m"))


def _read_json(file: Path, experiment: Experiment) -> Samples:
    content = _json_object(file)
    recorded = content.get("trajectory")
    if "g" in content or not isinstance(recorded, dict):
        return _of_rows(experiment, content.get("g"), content.get(TIME))
    # It is a result file.
    markers_m = None
    if recorded.get("markers_mm"):
        with faults_of(file, TrajectoryFileError, "a result file"):
            markers_mm = np.asarray(recorded["markers_mm"], dtype=np.float64)
            markers_m = 1e-3 * markers_mm.reshape(len(markers_mm), -1, 3)
    times_s = recorded.get("times_s")
    return _of_rows(experiment, recorded.get("samples"), times_s, markers_m)


def _of_rows(
    experiment: Experiment,
    rows: Any,
    times_s: Any,
    markers_m: FloatArray | None = None,
) -> Samples:
    """Return the samples of a list of rows, and of a list of times or None."""
    if not isinstance(rows, list):
        raise ValueError(f"no list 'g' of rows; {_expected(experiment)}")
    places = [f"row {number}" for number in range(len(rows))]
    of_g = [f"g, {place}" for place in places]
    values = _numbers(rows, of_g, experiment.coordinates, experiment)
    if times_s is None:
        return values, None, markers_m
    if not isinstance(times_s, list) or len(times_s) != len(rows):
        raise ValueError(
            f"{TIME}: expected a list of {len(rows)} times, as g has {len(rows)} rows"
        )
    column = _numbers([[time_s] for time_s in times_s], places, [TIME], experiment)
    return values, column[:, 0], markers_m


def _numbers(
    rows: Sequence[Any],
    places: Sequence[str],
    names: Sequence[str],
    experiment: Experiment,
) -> FloatArray:
    """Return rows of cells as finite numbers, shape [row_count, column_count]."""
    values = np.empty((len(rows), len(names)))
    for row, place, numbers in zip(rows, places, values, strict=True):
        if not isinstance(row, list) or len(row) != len(names):
            count = f"{len(row)} columns" if isinstance(row, list) else "no list"
            raise ValueError(
                f"{place}: {count}, {_expected(experiment)}; a column of times needs a header with {TIME}"
            )
        numbers[:] = [*map(_number, row)]
        wrong = np.flatnonzero(~(np.abs(numbers) <= LARGEST))
        if len(wrong):
            name, cell = names[wrong[0]], row[wrong[0]]
            raise ValueError(
                f"{place}: {name} is {cell!r:.40}, expected a finite number [{_unit_of(name, experiment)}] "
                f"of at most {LARGEST:g}"
            )
    return values


def _number(cell: Any) -> float:
    """Return a cell as a number; NaN if it is not one."""
    try:
        return float(cell)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _is_name(cell: str) -> bool:
    return cell != "" and math.isnan(_number(cell))


def _unit_of(name: str, experiment: Experiment) -> str:
    return "s" if name == TIME else experiment.score.observable.unit


def _expected(experiment: Experiment) -> str:
    names, unit = experiment.coordinates, experiment.score.observable.unit
    shown = names if len(names) <= 6 else (*names[:3], "...", names[-1])
    return f"expected {len(names)} columns [{unit}]: {', '.join(shown)}"


def _json_object(file: Path) -> dict[str, Any]:
    with reading(file, TrajectoryFileError, "a JSON file") as text:
        content = json_document(text)
    if not isinstance(content, dict):
        raise ValueError(
            f"expected a JSON object with 'g', got a {type(content).__name__}"
        )
    return content


# --- times -----------------------------------------------------------------------------------------------------------


def _at_frames(
    experiment: Experiment,
    values: FloatArray,
    given_s: FloatArray | None,
    markers_m: FloatArray | None,
) -> UserTrajectory:
    """Return the trajectory of samples with a sample at each frame; see `Samples` for the arguments."""
    from scipy.interpolate import make_interp_spline

    frame_count, observable = experiment.frame_count, experiment.score.observable
    frames_s = frame_times_s(frame_count)
    needed = (
        f"{frame_count} frames are needed, 30 a second from 0 to {frames_s[-1]:.4f} s"
    )
    if len(values) < 2:
        raise ValueError(f"{len(values)} rows; {needed}")
    times_s = frame_times_s(len(values)) if given_s is None else given_s
    row = release_row(experiment, times_s, values) if markers_m is None else 0
    rest_s = float(times_s[row] - times_s[0])
    if row:
        times_s, values = times_s[row:] - times_s[row], values[row:]
    rate_hz = None
    if given_s is None:
        rate_hz = likely_rate_hz(reference_band(experiment), values)
        if len(values) > frame_count:
            rate = "another rate" if rate_hz is None else f"{rate_hz} Hz"
            raise ValueError(
                f"{len(values)} rows without {TIME} look like {rate}; {needed}. Add a column {TIME} [s]"
            )
    times_s = _times_at_frames(times_s, frames_s, needed)
    lost = lost_marker(experiment.coordinates, observable.unit, times_s, values)
    if lost is not None:
        raise ValueError(str(lost))
    all_times_s = np.union1d(times_s, frames_s)
    all_times_s = all_times_s[(all_times_s >= 0.0) & (all_times_s <= frames_s[-1])]
    # A clock may start up to 5 ms late or stop up to 5 ms early: lines go on there.
    all_values = make_interp_spline(times_s, values, k=1)(all_times_s)
    if observable is Observable.MARKER_POSITION:
        at_frames = all_values[frame_index(all_times_s, frame_count)]
        markers_m = 1e-3 * at_frames.reshape(frame_count, -1, 3)
    elif markers_m is not None:
        markers_m = _markers_at_frames(experiment, times_s, markers_m, frames_s)
    return UserTrajectory(
        times_s=all_times_s,
        values=all_values,
        interpolated_frames=len(np.setdiff1d(frames_s, times_s)),
        rest_s=rest_s,
        likely_rate_hz=rate_hz,
        markers_m=markers_m,
    )


def _times_at_frames(
    times_s: FloatArray, frames_s: FloatArray, needed: str
) -> FloatArray:
    """Return the times of samples [s]; a sample near a frame gets the time of the frame.

    Args:
        times_s: Times of the samples [s].
        frames_s: Times of the frames [s].
        needed: Text of the rows and times that a file needs, for errors.

    Raises:
        ValueError: Times do not increase from 0 to the last frame, or a frame has no sample nearby.
    """
    steps_s = np.diff(times_s)
    tolerance_s = min(FILE_TOLERANCE_S, 0.1 * float(np.median(steps_s))) + 1e-9
    if (steps_s <= 0.0).any():
        row = int(np.argmax(steps_s <= 0.0)) + 1
        raise ValueError(
            f"row {row}: {TIME} is {times_s[row]:g} after {times_s[row - 1]:g}, but times must increase"
        )
    if abs(times_s[0]) > MAX_JITTER_S:
        raise ValueError(
            f"row 0: {TIME} is {times_s[0]:g}: subtract it, as an episode starts at 0"
        )
    if times_s[-1] < frames_s[-1] - MAX_JITTER_S:
        raise ValueError(f"{len(times_s)} rows end at {times_s[-1]:.4f} s; {needed}")
    nearest = nearest_sample(times_s, frames_s)
    distances_s = np.abs(times_s[nearest] - frames_s)
    is_far = distances_s > 0.5 / FRAME_RATE_HZ + tolerance_s
    if is_far.any():
        frame = int(is_far.argmax())
        raise ValueError(
            f"no sample at frame {frame} (t = {frames_s[frame]:.4f} s), the nearest is at "
            f"{times_s[nearest[frame]]:.4f} s; {needed}. {_time_unit_text(times_s, frames_s)}"
        )
    is_near = distances_s <= tolerance_s
    snapped_s = times_s.copy()
    snapped_s[nearest[is_near]] = frames_s[is_near]
    return snapped_s


def _time_unit_text(times_s: FloatArray, frames_s: FloatArray) -> str:
    """Return the unit that the times seem to have, by their last value."""
    ratio = times_s[-1] / frames_s[-1]
    for unit, per_second in (("milliseconds", 1e3), ("frame numbers", FRAME_RATE_HZ)):
        if math.isclose(ratio, per_second, rel_tol=0.2):
            return f"The times look like {unit}. Divide them by {per_second:,.0f}"
    return "Are the times in seconds?"


def _markers_at_frames(
    experiment: Experiment,
    times_s: FloatArray,
    markers_m: FloatArray,
    frames_s: FloatArray,
) -> FloatArray:
    """Return the markers of a file at the frames [m], shape [frame_count, marker_count, 3]."""
    markers = experiment.scene.markers
    count = 0 if markers is None else len(markers.positions_m)
    # Result files have markers only at the frames.
    rows_s = times_s if len(markers_m) == len(times_s) else frames_s
    if markers_m.shape != (len(rows_s), count, 3) or not np.isfinite(markers_m).all():
        raise ValueError(
            f"markers_m: shape is {list(markers_m.shape)}; finite numbers [m] of shape "
            f"{[len(times_s), count, 3]} are expected"
        )
    flat = markers_m.reshape(len(rows_s), -1)
    return interpolated(frames_s, rows_s, flat).reshape(-1, count, 3)
