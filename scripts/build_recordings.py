"""Build the bands of published recordings, and the events to compare with, in `scoring/bands/` from measurements.

    python scripts/build_recordings.py            writes the files
    python scripts/build_recordings.py --check    fails if a file differs from what the measurements give

`scoring/facts/recordings/recordings.toml` says of each recording what it shows, what was assumed and what it supports;
the tables beside it hold one row a picture. A band has the 30 Hz frames of its experiment. Between two neighbouring
pictures the mean is a monotone cubic; where pictures are missing, or the clip has ended, it is left empty.
"""

from __future__ import annotations

import csv
import json
import math
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from generated import write_or_check
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from gauge_envs import load_experiment
from gauge_envs.references.published import Baseline, published_baselines
from gauge_envs.scene.timing import FRAME_RATE_HZ

GENERATED = "# Written by scripts/build_recordings.py; do not edit."
SOURCE = "Published recording {video} of one trial (GAUGE project page): {method}"
LARGEST_GAP = 1.5
"""Number of intervals between two pictures above which a picture is missing between them."""

ROUNDING_S = 1e-6
"""Largest time outside of the pictures at which a frame counts as on the first or the last of them [s]."""

EVENTS = {"leaves": "last_ball_leaves_s", "returns": "last_ball_returns_s", "rests": "last_ball_at_rest_s"}
"""Fact of a recording that gives each quantity of an event."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class RecordedBand:
    """Band of one variant, before it is text.

    Attributes:
        names: Names of the coordinates.
        mean: Mean at the 30 Hz frames of the experiment, shape [frame_count, coordinate_count]; NaN: not measured.
        uncertainty: 1-sigma uncertainty of the mean, same shape.
        sigma: From the published baseline, one number for all frames and coordinates; None where none is published.
    """

    names: tuple[str, ...]
    mean: FloatArray
    uncertainty: FloatArray
    sigma: float | None

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Frames at which a coordinate was measured, shape [frame_count]."""
        return np.isfinite(self.mean).any(axis=1)


def read_table(file: Path) -> dict[str, FloatArray]:
    """Return the columns of a table of measurements, NaN where a field is empty; its header comments start with `#`."""
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]}


def at_frames(
    times_s: FloatArray, values: FloatArray, frame_times_s: FloatArray, *, interval_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return a measured quantity and its rate at the frames.

    Args:
        times_s: Times of the pictures, ascending, shape [picture_count].
        values: Quantity in them, NaN where it was not measured, shape [picture_count].
        frame_times_s: Times of the frames, shape [frame_count].
        interval_s: Time between pictures; where two measured ones are further apart, nothing is known in between.

    Returns:
        Value and rate per second at the frames, each of shape [frame_count]; NaN where no picture is on either side.
    """
    known = np.isfinite(values)
    times_s, values = times_s[known], values[known]
    found, rate = np.full((2, len(frame_times_s)), np.nan)
    breaks = np.flatnonzero(np.diff(times_s) > LARGEST_GAP * interval_s) + 1
    for run_times_s, run in zip(np.split(times_s, breaks), np.split(values, breaks), strict=True):
        if len(run) < 2:
            continue
        curve = PchipInterpolator(run_times_s, run, extrapolate=False)
        within_s = np.clip(frame_times_s, run_times_s[0], run_times_s[-1])
        inside = np.abs(frame_times_s - within_s) < ROUNDING_S
        found[inside], rate[inside] = curve(within_s[inside]), curve(within_s[inside], 1)
    return found, rate


def seen_well(values: FloatArray, before_hidden: int) -> FloatArray:
    """Return a column without the pictures just before each gap; those before the end of the clip stay."""
    seen = values.copy()
    for hidden in np.flatnonzero(np.isnan(values)):
        seen[max(0, hidden - before_hidden) : hidden] = np.nan
    return seen


def sigma_of(baseline: Baseline, width: int) -> float:
    """Return the sigma of each of `width` coordinates of g(t): the published scatter, split evenly over them."""
    return math.hypot(baseline.mean, baseline.std or 0.0) / math.sqrt(width)


def recorded_band(
    variant: str, recording: Mapping[str, Any], layout: Mapping[str, Any], table: Mapping[str, FloatArray]
) -> RecordedBand:
    """Return the band of a variant from one recording.

    Raises:
        ValueError: A coordinate is measured at no frame, or number of frames or of coordinates is not the experiment's.
    """
    experiment = load_experiment(variant)
    frame_count = experiment.frame_count
    baseline = published_baselines(variant).get("rmse")
    if baseline is not None and baseline.frames != frame_count:
        raise ValueError(f"{variant} has {frame_count} frames, published are {baseline.frames}")
    frame_times_s = recording["frame_zero_s"] + np.arange(frame_count) / FRAME_RATE_HZ
    interval_s = 1.0 / recording["pictures_per_s"]
    if (width := len(experiment.coordinates)) != layout["width"]:
        raise ValueError(f"{variant} has {width} coordinates, the layout {layout['width']}")
    used = table.get("used", np.ones_like(table["time_s"])) == 1
    mean, uncertainty = [], []
    for coordinate in layout["coordinates"]:
        in_sight = seen_well(table[coordinate["column"]], recording.get("pictures_before_hidden", 0))
        seen = np.where(used, in_sight, np.nan)
        values = coordinate.get("offset", 0.0) + coordinate.get("scale", 1.0) * seen
        value, rate = at_frames(table["time_s"], values, frame_times_s, interval_s=interval_s)
        if not np.isfinite(value).any():
            raise ValueError(f"{variant}: {coordinate['name']} is measured at no frame")
        mean.append(value)
        at_rest = placement_sigma(recording["uncertainty"], table, value, frame_times_s)
        uncertainty.append(np.hypot(at_rest, recording["time_sigma_s"] * rate))
    return RecordedBand(
        names=tuple(coordinate["name"] for coordinate in layout["coordinates"]),
        mean=np.column_stack(mean),
        uncertainty=np.column_stack(uncertainty),
        sigma=None if baseline is None else sigma_of(baseline, layout["width"]),
    )


def placement_sigma(
    stated: Mapping[str, Any], table: Mapping[str, FloatArray], value: FloatArray, frame_times_s: FloatArray
) -> FloatArray:
    """Return the 1-sigma uncertainty of a coordinate at the frames without that of their time, [frame_count]."""
    parts = [stated.get("constant", 0.0) * np.ones_like(value), stated.get("relative", 0.0) * np.abs(value)]
    if "column" in stated:
        parts.append(np.interp(frame_times_s, table["time_s"], table[stated["column"]]))
    return np.sqrt(np.square(parts).sum(axis=0))


def band_csv(band: RecordedBand) -> str:
    """Return the text of a band's table, down to the last measured frame."""
    columns = [f"{quantity}.{name}" for quantity in ("mean", "uncertainty") for name in band.names]
    lines = [",".join(["frame", "time_s", "measured", *columns])]
    for frame in range(int(np.flatnonzero(band.measured)[-1]) + 1):
        numbers = np.concatenate([band.mean[frame], band.uncertainty[frame]])
        fields = ["" if math.isnan(number) else f"{number + 0.0:.2f}" for number in numbers]
        lines.append(",".join([str(frame), f"{frame / FRAME_RATE_HZ:.6f}", str(int(band.measured[frame])), *fields]))
    return "\n".join(lines) + "\n"


def band_toml(
    variant: str, band: RecordedBand, name: str, recording: Mapping[str, Any], layout: Mapping[str, Any]
) -> str:
    """Return the text of a band's sidecar: what the table's numbers are."""
    coordinates = layout["coordinates"]
    lines = [
        GENERATED,
        'grade = "recording"',
        f'sigma_source = "{"measurement" if band.sigma is None else "baseline"}"',
        f'unit = "{load_experiment(variant).spec.score.observable.unit}"',
        f"frames = {len(band.mean)}",
        f"coordinates = {json.dumps(band.names)}",
    ]
    if "index" in coordinates[0]:
        lines += [f"width = {layout['width']}", f"indices = {[coordinate['index'] for coordinate in coordinates]}"]
    else:
        lines.append(f"projection = {[coordinate['direction'] for coordinate in coordinates]}")
    if band.sigma is not None:
        lines.append(f"sigma = {band.sigma:.6f}  # of each coordinate, at every frame")
    if "withheld" in recording:
        lines.append(f"withheld = {json.dumps(recording['withheld'])}")
    if not recording.get("normalized_by_baseline", True):
        lines.append("normalized_by_baseline = false")
    lines.append(f"source = {json.dumps(SOURCE.format(**recording))}")
    lines += ["", f"# facts/recordings/{name}.csv, recordings.toml", "[recording]"]
    kept = ("video", "sha256", "identity", "frame_zero_s", "time_sigma_s", "pictures_per_s", "assumed", "not_measured")
    lines += [f"{key} = {json.dumps(recording[key])}" for key in kept]
    return "\n".join(lines) + "\n"


def events_toml(recordings: Mapping[str, Any]) -> str:
    """Return the text of the table of recorded events."""
    lines = [GENERATED, "# Times of events in the published recordings: facts/recordings/recordings.toml."]
    for recording in recordings.values():
        facts = recording.get("facts", {})
        for quantity, name in EVENTS.items():
            if name not in facts:
                continue
            for variant in recording["variants"]:
                lines += [
                    "",
                    "[[events]]",
                    f"variant = {json.dumps(variant)}",
                    f"quantity = {json.dumps(quantity)}",
                    f"values_s = {facts[name]['value']}",
                    f"sigma_s = {facts[name]['sigma']}",
                    f"source = {json.dumps(SOURCE.format(**recording))}",
                ]
    return "\n".join(lines) + "\n"


def supported(folder: Path) -> Iterator[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Yield name, description and layout of each recording that supports a band."""
    recordings = tomllib.loads((folder / "recordings.toml").read_text(encoding="utf-8"))
    layouts = recordings.pop("layouts")
    for name, recording in recordings.items():
        if recording["supports"] == "band":
            yield name, recording, layouts[recording["layout"]]


def generated_files(scoring: Path) -> dict[Path, str]:
    """Return every generated file with the text that the measurements give it."""
    folder = scoring / "facts" / "recordings"
    recordings = tomllib.loads((folder / "recordings.toml").read_text(encoding="utf-8"))
    files = {scoring / "bands" / "events.toml": events_toml(recordings)}
    for name, recording, layout in supported(folder):
        table = read_table(folder / f"{name}.csv")
        for variant in recording["variants"]:
            band = recorded_band(variant, recording, layout, table)
            files[scoring / "bands" / f"{variant}.csv"] = band_csv(band)
            files[scoring / "bands" / f"{variant}.toml"] = band_toml(variant, band, name, recording, layout)
    return files


def main(arguments: Sequence[str] | None = None) -> int:
    """Write or check the generated files.

    Returns:
        Exit status: 1 if a check found a file that is missing or not current.
    """
    return write_or_check(
        generated_files,
        script="build_recordings.py",
        what="Build the bands of published recordings from scoring/facts.",
        arguments=arguments,
    )


if __name__ == "__main__":
    sys.exit(main())
