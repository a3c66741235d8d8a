"""Build bands and events (`scoring/bands/`) and statistics (`scoring/statistics/`) from what recordings show.

`scoring/facts/recordings/recordings.toml` says of each recording what it shows, what was assumed and what it supports;
the tables beside it hold one row a picture. A band has the 30 Hz frames of its experiment. Between two neighbouring
pictures the mean is a monotone cubic; where pictures are missing, or the clip has ended, it is left empty.

`scoring/facts/recordings/statistics.toml` says of which recordings the markers are known, and how well. From them
follow statistics of deformation, with linear propagation of the errors of the markers.
"""

from __future__ import annotations

import csv
import json
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from gauge_envs import load_experiment
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.deformation import (
    STATISTICS,
    MarkedSolid,
    affine_map,
    deformation_statistics,
    independent_noise,
    marked_solid,
    noise_residuals,
)
from gauge_envs.references.published import Baseline, published_baselines
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from scripts.generated import SCORING

GENERATED = "# Written by scripts/build_recordings.py; do not edit."
SOURCE = "Published recording {video} of one trial (GAUGE project page): {method}"
STATISTICS_SOURCE = (
    "Markers of one trial in the published recording {video} (GAUGE project page)"
)
LARGEST_GAP = 1.5
"""Number of intervals between two pictures above which a picture is missing between them."""

ROUNDING_S = 1e-6
"""Largest time outside of the pictures at which a frame counts as on the first or the last of them [s]."""

EVENTS = {
    "leaves": "last_ball_leaves_s",
    "returns": "last_ball_returns_s",
    "rests": "last_ball_at_rest_s",
}
"""Fact of a recording that gives each quantity of an event."""


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


def read_table(file: Path) -> dict[str, FloatArray]:
    """Return the columns of a table of measurements, NaN where a field is empty; its header comments start with `#`."""
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    return {
        name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]
    }


def at_frames(
    times_s: FloatArray,
    values: FloatArray,
    frame_times_s: FloatArray,
    *,
    interval_s: float,
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
    for run_times_s, run in zip(
        np.split(times_s, breaks), np.split(values, breaks), strict=True
    ):
        if len(run) < 2:
            continue
        curve = PchipInterpolator(run_times_s, run, extrapolate=False)
        within_s = np.clip(frame_times_s, run_times_s[0], run_times_s[-1])
        inside = np.abs(frame_times_s - within_s) < ROUNDING_S
        found[inside], rate[inside] = (
            curve(within_s[inside]),
            curve(within_s[inside], 1),
        )
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
    variant: str,
    recording: Mapping[str, Any],
    layout: Mapping[str, Any],
    table: Mapping[str, FloatArray],
) -> RecordedBand:
    """Return the band of a variant from one recording.

    Raises:
        ValueError: A coordinate is measured at no frame, or number of frames or of coordinates is not the experiment's.
    """
    experiment = load_experiment(variant)
    frame_count = experiment.frame_count
    baseline = published_baselines(variant).get("rmse")
    if baseline is not None and baseline.frames != frame_count:
        raise ValueError(
            f"{variant} has {frame_count} frames, published are {baseline.frames}"
        )
    frame_times_s = recording["frame_zero_s"] + np.arange(frame_count) / FRAME_RATE_HZ
    interval_s = 1.0 / recording["pictures_per_s"]
    if (width := len(experiment.coordinates)) != layout["width"]:
        raise ValueError(
            f"{variant} has {width} coordinates, the layout {layout['width']}"
        )
    used = table.get("used", np.ones_like(table["time_s"])) == 1
    mean, uncertainty = [], []
    for coordinate in layout["coordinates"]:
        in_sight = seen_well(
            table[coordinate["column"]], recording.get("pictures_before_hidden", 0)
        )
        seen = np.where(used, in_sight, np.nan)
        values = coordinate.get("offset", 0.0) + coordinate.get("scale", 1.0) * seen
        value, rate = at_frames(
            table["time_s"], values, frame_times_s, interval_s=interval_s
        )
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
    stated: Mapping[str, Any],
    table: Mapping[str, FloatArray],
    value: FloatArray,
    frame_times_s: FloatArray,
) -> FloatArray:
    """Return the 1-sigma uncertainty of a coordinate at the frames without that of their time, [frame_count]."""
    parts = [
        stated.get("constant", 0.0) * np.ones_like(value),
        stated.get("relative", 0.0) * np.abs(value),
    ]
    if "column" in stated:
        parts.append(np.interp(frame_times_s, table["time_s"], table[stated["column"]]))
    return np.sqrt(np.square(parts).sum(axis=0))


def frames_csv(
    names: Sequence[str],
    mean: FloatArray,
    uncertainty: FloatArray,
    *,
    decimals: int,
    states_measured: bool = False,
) -> str:
    """Return the text of a table of values at 30 Hz, down to the last measured frame.

    Args:
        names: Names of the values.
        mean: Values, shape [frame_count, len(names)]; NaN: not measured.
        uncertainty: Their 1-sigma uncertainty, same shape.
        decimals: Number of decimals.
        states_measured: Whether a column says at which frames a value was measured.
    """
    columns = [
        f"{quantity}.{name}" for quantity in ("mean", "uncertainty") for name in names
    ]
    flag = ["measured"] if states_measured else []
    measured = np.isfinite(mean).any(axis=1)
    lines = [",".join(["frame", "time_s", *flag, *columns])]
    for frame in range(int(np.flatnonzero(measured)[-1]) + 1):
        fields = [str(frame), f"{frame / FRAME_RATE_HZ:.6f}"]
        if states_measured:
            fields.append(str(int(measured[frame])))
        for number in (*mean[frame], *uncertainty[frame]):
            fields.append("" if math.isnan(number) else f"{number + 0.0:.{decimals}f}")
        lines.append(",".join(fields))
    return "\n".join(lines) + "\n"


def band_toml(
    variant: str,
    band: RecordedBand,
    name: str,
    recording: Mapping[str, Any],
    layout: Mapping[str, Any],
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
        lines += [
            f"width = {layout['width']}",
            f"indices = {[coordinate['index'] for coordinate in coordinates]}",
        ]
    else:
        lines.append(
            f"projection = {[coordinate['direction'] for coordinate in coordinates]}"
        )
    if band.sigma is not None:
        lines.append(f"sigma = {band.sigma:.6f}  # of each coordinate, at every frame")
    if "withheld" in recording:
        lines.append(f"withheld = {json.dumps(recording['withheld'])}")
    if not recording.get("normalized_by_baseline", True):
        lines.append("normalized_by_baseline = false")
    lines.append(f"source = {json.dumps(SOURCE.format(**recording))}")
    lines += ["", f"# facts/recordings/{name}.csv, recordings.toml", "[recording]"]
    kept = (
        "video",
        "sha256",
        "identity",
        "frame_zero_s",
        "time_sigma_s",
        "pictures_per_s",
        "assumed",
        "not_measured",
    )
    lines += [f"{key} = {json.dumps(recording[key])}" for key in kept]
    return "\n".join(lines) + "\n"


def events_toml(recordings: Mapping[str, Any]) -> str:
    """Return the text of the table of recorded events."""
    lines = [
        GENERATED,
        "# Times of events in the published recordings: facts/recordings/recordings.toml.",
    ]
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


# --- statistics of deformation ---------------------------------------------------------------------------------------


def marker_positions_m(
    stated: Mapping[str, Any], table: Mapping[str, FloatArray]
) -> FloatArray:
    """Return the positions of the stated markers [m], shape [picture_count, marker_count, 3]; NaN: out of sight."""
    fixed = stated.get("fixed_mm", {})
    shape = table["time_s"].shape
    return 1e-3 * np.stack(
        [
            np.stack(
                [
                    np.full(shape, fixed[axis])
                    if axis in fixed
                    else table[f"marker_{marker}_{axis}_mm"]
                    for axis in "xyz"
                ],
                axis=-1,
            )
            for marker in stated["markers"]
        ],
        axis=1,
    )


def section_errors_m(
    stated: Mapping[str, Any],
    rest_m: FloatArray,
    markers_m: FloatArray,
    experiment: Experiment,
) -> FloatArray:
    """Return independent 1-sigma error patterns of markers that a model of cross-sections placed.

    Args:
        stated: Errors of the sections and of their scale.
        rest_m: Marker positions at rest [m], shape [marker_count, 3].
        markers_m: Marker positions in a picture [m], shape [marker_count, 3].
        experiment: Experiment with an upright block.

    Returns:
        Patterns [m], shape [6 * section_count + 1, marker_count, 3].

    Raises:
        ValueError: The experiment has no markers.
    """
    markers = experiment.scene.markers
    if markers is None:
        raise ValueError(f"{experiment.name} has no markers")
    planned = np.asarray(markers.positions_m)[stated["markers"]]
    axis_m = np.append(experiment.scene.deformables[0].pose.position_m[:2], 0.0)
    heights = np.round(planned[:, 2], 4)
    arms = markers_m - axis_m
    for height in np.unique(heights):
        section = heights == height
        # All four markers of a section show where its centre is; fewer ones stay about the axis of the block.
        if section.sum() == 4:
            arms[section, :2] -= (markers_m - rest_m)[section, :2].mean(axis=0)
        arms[section, 2] = 0.0
    errors = stated["sections"]
    generators = [
        *(
            1e-3 * size * np.broadcast_to(unit, arms.shape)
            for size, unit in zip(errors["shift_mm"], np.eye(3), strict=True)
        ),
        errors["rotation_rad"] * np.cross([0.0, 0.0, 1.0], arms),
        *(
            size * np.cross(unit, arms)
            for size, unit in zip(errors["tilt_rad"], np.eye(3)[:2], strict=True)
        ),
    ]
    patterns = [
        np.where((heights == height)[:, None], generator, 0.0)
        for height in np.unique(heights)
        for generator in generators
    ]
    return np.stack([*patterns, stated["scale"] * arms])


def recorded_statistics(
    variant: str,
    recording: Mapping[str, Any],
    stated: Mapping[str, Any],
    table: Mapping[str, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return the statistics of deformation of a variant from the markers of one recording, and their uncertainty.

    Both have shape [frame_count, statistic_count]; NaN: not measured. Rest is the mean over pictures before frame 0.
    Their scatter is the noise that the non-affine residual is corrected for, unless the markers were read by hand.

    Raises:
        ValueError: The markers of the experiment are on no solid, or no statistic is known at any frame.
    """
    experiment = load_experiment(variant)
    solid = marked_solid(experiment.scene)
    if solid is None:
        raise ValueError(f"{variant} has no markers on a solid")
    times_s, positions_m = table["time_s"], marker_positions_m(stated, table)
    if "sigma_mm" in table:
        positions_m[table["sigma_mm"] > min(table["sigma_mm"])] = np.nan
    still = times_s < recording["frame_zero_s"]
    rest_m = positions_m[still].mean(axis=0)
    spread_m = (positions_m[still] - rest_m) / math.sqrt(max(int(still.sum()) - 1, 1))
    columns = [STATISTICS.index(name) for name in stated["statistics"]]
    values, sigmas = np.full((2, len(times_s), len(columns)), np.nan)
    for picture in np.flatnonzero(np.isfinite(positions_m).all(axis=(1, 2))):
        found, sigma = picture_statistics(
            stated, rest_m, positions_m[picture], spread_m, solid, experiment
        )
        values[picture], sigmas[picture] = found[columns], sigma[columns]
    frame_times_s = (
        recording["frame_zero_s"] + np.arange(experiment.frame_count) / FRAME_RATE_HZ
    )
    mean, uncertainty = [], []
    for column, sigma in zip(values.T, sigmas.T, strict=True):
        value, rate = at_frames(
            times_s, column, frame_times_s, interval_s=1.0 / recording["pictures_per_s"]
        )
        known = np.isfinite(sigma)
        at_frame = np.interp(frame_times_s, times_s[known], sigma[known])
        mean.append(value)
        uncertainty.append(np.hypot(at_frame, recording["time_sigma_s"] * rate))
    if not np.isfinite(mean).any():
        raise ValueError(f"{variant}: no statistic is known at any frame")
    return np.column_stack(mean), np.column_stack(uncertainty)


def picture_statistics(
    stated: Mapping[str, Any],
    rest_m: FloatArray,
    markers_m: FloatArray,
    spread_m: FloatArray,
    solid: MarkedSolid,
    experiment: Experiment,
) -> tuple[FloatArray, FloatArray]:
    """Return statistics of one picture and their uncertainty, each of shape [10]."""
    if "sections" in stated:
        noise, unseen = (
            spread_m,
            section_errors_m(stated, rest_m, markers_m, experiment),
        )
    else:
        single = independent_noise(
            np.tile(1e-3 * np.array(stated["markers_mm"]), (len(rest_m), 1))
        )
        none = np.zeros((0, *single.shape[1:]))
        noise, unseen = (single, none) if stated.get("read") else (spread_m, single)
    found = deformation_statistics(rest_m, markers_m[None], solid, noise_m=noise)[0]
    return found, statistic_uncertainty(
        rest_m, markers_m, solid, noise_m=noise, unseen_m=unseen
    )


def statistic_uncertainty(
    rest_m: ArrayLike,
    markers_m: ArrayLike,
    solid: MarkedSolid,
    *,
    noise_m: ArrayLike,
    unseen_m: ArrayLike | None = None,
) -> FloatArray:
    """Return the 1-sigma uncertainty of the statistics of one frame, by linear propagation of marker errors.

    The square of the non-affine residual is propagated to second order, because the residual may be smaller than its
    errors. Its uncertainty u(R) solves (R + u)^2 = R^2 + u(R^2).

    Args:
        rest_m: Marker positions at rest [m], shape [marker_count, 3].
        markers_m: Marker positions in the frame [m], shape [marker_count, 3].
        solid: The marked solid.
        noise_m: Independent 1-sigma error patterns that the displacements hold [m], shape
            [pattern_count, marker_count, 3]. The non-affine residual is corrected for them.
        unseen_m: Independent 1-sigma patterns of displacement that the positions do not show [m], in the same form.

    Returns:
        Uncertainty of each statistic in its unit, shape [10]; NaN where the statistic is.
    """
    noise, markers = np.asarray(noise_m), np.asarray(markers_m)
    if unseen_m is None:
        unseen_m = np.zeros((0, *markers.shape))
    unseen = np.asarray(unseen_m)
    patterns = np.concatenate([noise, unseen])
    value = deformation_statistics(rest_m, markers[None], solid, noise_m=noise)[0]
    forward, backward = (
        deformation_statistics(rest_m, markers + sign * patterns, solid)
        for sign in (1, -1)
    )
    sigma = np.asarray(np.sqrt(np.square(0.5 * (forward - backward)).sum(axis=0)))
    residual = affine_map(rest_m, markers[None]).residual_m[0]
    seen = np.isfinite(residual).all(axis=1)
    left = noise_residuals(rest_m, patterns, seen)
    count = max(int(seen.sum()), 1)
    slopes = 2.0 * np.einsum("mc,kmc->k", np.nan_to_num(residual), left) / count
    gram = np.einsum("kmc,lmc->kl", left, left) / count
    # Displacement that is not seen also adds to the mean square, by the trace of its share.
    added = float(np.trace(gram[len(noise) :, len(noise) :]))
    square_sigma = 1e6 * float(
        np.sqrt(np.square(slopes).sum() + 2.0 * np.square(gram).sum() + added**2)
    )
    sigma[9] = np.sqrt(value[9] ** 2 + square_sigma) - value[9]
    return sigma


def statistics_toml(
    variant: str, recording: Mapping[str, Any], stated: Mapping[str, Any]
) -> str:
    """Return the text of the sidecar of a table of statistics."""
    lines = [
        GENERATED,
        'grade = "statistics"',
        f"statistics = {json.dumps(stated['statistics'])}",
        f"markers = {json.dumps(stated['markers'])}",
        f"frames = {load_experiment(variant).frame_count}",
        "trial_count = 1",
        f"source = {json.dumps(STATISTICS_SOURCE.format(**recording))}",
        f"note = {json.dumps(stated['note'])}",
        "",
        f"# facts/recordings/{stated['table']}.csv, recordings.toml, statistics.toml",
        "[recording]",
        *(
            f"{key} = {json.dumps(recording[key])}"
            for key in ("video", "sha256", "frame_zero_s", "time_sigma_s")
        ),
        *(f"{key} = {json.dumps(stated[key])}" for key in ("assumed", "not_measured")),
    ]
    return "\n".join(lines) + "\n"


def statistics_files(scoring: Path) -> dict[Path, str]:
    """Return every generated file of statistics with its text."""
    folder = scoring / "facts" / "recordings"
    recordings = tomllib.loads((folder / "recordings.toml").read_text(encoding="utf-8"))
    files = {}
    for name, stated in tomllib.loads(
        (folder / "statistics.toml").read_text(encoding="utf-8")
    ).items():
        recording, table = (
            recordings[name],
            read_table(folder / f"{stated['table']}.csv"),
        )
        for variant in recording["variants"]:
            mean, uncertainty = recorded_statistics(variant, recording, stated, table)
            files[scoring / "statistics" / f"{variant}.csv"] = frames_csv(
                stated["statistics"], mean, uncertainty, decimals=4
            )
            files[scoring / "statistics" / f"{variant}.toml"] = statistics_toml(
                variant, recording, stated
            )
    return files


def contents(scoring: Path = SCORING) -> dict[Path, str]:
    """Return every generated file with the text that the measurements give it."""
    folder = scoring / "facts" / "recordings"
    recordings = tomllib.loads((folder / "recordings.toml").read_text(encoding="utf-8"))
    files = {scoring / "bands" / "events.toml": events_toml(recordings)}
    for name, recording, layout in supported(folder):
        table = read_table(folder / f"{name}.csv")
        for variant in recording["variants"]:
            band = recorded_band(variant, recording, layout, table)
            files[scoring / "bands" / f"{variant}.csv"] = frames_csv(
                band.names,
                band.mean,
                band.uncertainty,
                decimals=2,
                states_measured=True,
            )
            files[scoring / "bands" / f"{variant}.toml"] = band_toml(
                variant, band, name, recording, layout
            )
    return files | statistics_files(scoring)
