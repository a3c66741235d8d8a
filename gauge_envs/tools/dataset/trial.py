"""Read and check one trial file of the GAUGE dataset.

A trial is a JSON object with `FPS`, `translation unit` and one object per asset. A rigid body has lists `x`, `y`, `z`
and usually `qx`, `qy`, `qz`, `qw`; `ex`, `ey`, `ez` are not used. A marker set has an object with `x`, `y`, `z` per
marker id. Each list has one sample per frame; `null` or NaN is a sample that was not captured.

Unit and rate are never inferred from the values. Where a file has none, the caller states them (`Stated`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gauge_envs.files import json_document
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.dataset.findings import TrialError

POSITION_KEYS = ("x", "y", "z")
QUATERNION_KEYS = ("qx", "qy", "qz", "qw")

MILLIMETRES = {
    "mm": 1.0,
    "millimeter": 1.0,
    "millimetre": 1.0,
    "cm": 10.0,
    "m": 1e3,
    "meter": 1e3,
    "metre": 1e3,
}
"""Millimetres in a unit of length, by its spelling without a plural s."""

NORM_TOLERANCE = 0.01
"""Largest error of the norm of a unit quaternion; files round to three digits or more."""

MAX_COORDINATE_MM = 1e5
"""Largest coordinate; the capture volume is a few metres wide."""


@dataclass(frozen=True, kw_only=True)
class Stated:
    """What a user states for files that do not.

    Attributes:
        unit: `mm`, `cm` or `m`.
        rate_hz: Frames in a second.
    """

    unit: str | None = None
    rate_hz: float | None = None


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Motion of one rigid body.

    Attributes:
        positions_mm: Positions of the origin in the motion-capture frame [mm], shape [frame_count, 3]; NaN is missing.
        quaternions_xyzw: Unit quaternions, body to world, shape [frame_count, 4]; None for a file without them.
    """

    positions_mm: FloatArray
    quaternions_xyzw: FloatArray | None


@dataclass(frozen=True, eq=False)
class Trial:
    """One trial file, checked. Assets may differ in their number of frames.

    Attributes:
        poses: Rigid bodies by name in the file.
        markers: Marker sets by name in the file: marker id to positions [mm], shape [frame_count, 3].
        faults: Errors of assets by name; the experiment decides whether an asset is needed.
    """

    poses: Mapping[str, PoseTrack]
    markers: Mapping[str, Mapping[str, FloatArray]]
    faults: Mapping[str, TrialError]


def parse_trial(content: bytes, stated: Stated | None = None) -> Trial:
    """Read and check one trial file.

    Args:
        content: The file's bytes.
        stated: Unit and rate of files that do not state them.

    Raises:
        TrialError: The file is damaged, or of another rate or unit; errors of a single asset are its `faults`.
    """
    try:
        document = json_document(content)
        if not isinstance(document, dict):
            raise ValueError(f"it is a {type(document).__name__}")
    except ValueError as error:
        expected = "a complete file of objects and lists is expected"
        raise TrialError("(file)", f"it is not JSON: {error}", expected) from None
    scale_mm = _scale_mm(document, stated or Stated())
    poses: dict[str, PoseTrack] = {}
    markers: dict[str, Mapping[str, FloatArray]] = {}
    faults: dict[str, TrialError] = {}
    for name, asset in document.items():
        if not isinstance(asset, dict):
            continue
        try:
            if any(isinstance(entry, dict) for entry in asset.values()):
                markers[name] = _marker_set(name, asset, scale_mm)
            else:
                poses[name] = _pose_track(name, asset, scale_mm)
        except TrialError as error:
            faults[name] = error
    if not (poses or markers or faults):
        expected = "an object such as 'cube' is expected"
        raise TrialError("(file)", "it holds no asset", expected)
    return Trial(poses=poses, markers=markers, faults=faults)


def _scale_mm(document: Mapping[str, Any], stated: Stated) -> float:
    """Check the rate of a file, and return the millimetres in its unit of length."""
    rate_hz = document.get("FPS", stated.rate_hz)
    unit = document.get("translation unit", stated.unit)
    if rate_hz != FRAME_RATE_HZ:
        problem, expected = f"it is {rate_hz!r}", f"{FRAME_RATE_HZ:g} is expected"
        if rate_hz is None:
            problem = "it is missing"
            expected += "; --rate 30 states that of files without one"
        raise TrialError("FPS", problem, expected)
    scale_mm = MILLIMETRES.get(str(unit).lower().rstrip("s"))
    if scale_mm is None:
        problem, expected = f"it is {unit!r}", "'mm' is expected, or 'cm' or 'm'"
        if unit is None:
            problem = "it is missing"
            expected += "; --unit mm states that of files without one"
        raise TrialError("translation unit", problem, expected)
    return scale_mm


def _pose_track(name: str, asset: Mapping[str, Any], scale_mm: float) -> PoseTrack:
    positions_mm = _positions_mm(name, asset, scale_mm)
    if not any(key in asset for key in QUATERNION_KEYS):
        return PoseTrack(positions_mm, None)
    quaternions = _table(name, asset, QUATERNION_KEYS)
    check_lengths({f"{name}.x": positions_mm, f"{name}.qx": quaternions})
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(quaternions, axis=1)
    is_wrong = np.abs(norms - 1.0) > NORM_TOLERANCE
    if is_wrong.any():
        frame = int(is_wrong.argmax())
        problem = f"the quaternion's norm is {norms[frame]:.4g}"
        raise TrialError(f"{name}.q[{frame}]", problem, "1 is expected")
    return PoseTrack(positions_mm, quaternions / norms[:, None])


def _marker_set(
    name: str, asset: Mapping[str, Any], scale_mm: float
) -> dict[str, FloatArray]:
    markers = {}
    for marker, entry in asset.items():
        key = f"{name}.{marker}"
        if not isinstance(entry, dict):
            problem = f"it is {entry!r:.40}"
            raise TrialError(key, problem, "a marker is an object with x, y, z")
        markers[marker] = _positions_mm(key, entry, scale_mm)
        # A marker is captured in all three coordinates or not at all.
        markers[marker][np.isnan(markers[marker]).any(axis=1)] = np.nan
    check_lengths({f"{name}.{marker}": markers[marker] for marker in markers})
    return markers


def _positions_mm(key: str, asset: Mapping[str, Any], scale_mm: float) -> FloatArray:
    """Return the positions of a body or a marker [mm], shape [frame_count, 3]."""
    positions_mm = scale_mm * _table(key, asset, POSITION_KEYS)
    is_far = np.abs(positions_mm) > MAX_COORDINATE_MM
    if is_far.any():
        frame, axis = np.argwhere(is_far)[0]
        place = f"{key}.{POSITION_KEYS[axis]}[{frame}]"
        problem = f"it is {positions_mm[frame, axis]:.4g} mm"
        raise TrialError(place, problem, "the capture volume is a few metres wide")
    return positions_mm


def _table(name: str, asset: Mapping[str, Any], keys: Sequence[str]) -> FloatArray:
    """Return lists of an asset as columns, shape [frame_count, column_count]."""
    columns = {}
    for key in keys:
        place = f"{name}.{key}"
        if key not in asset:
            raise TrialError(place, "it is missing", f"an asset has {', '.join(keys)}")
        expected = "a list of numbers or null, one a frame, is expected"
        try:
            column = np.array(asset[key], dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise TrialError(place, f"{error}", expected) from None
        if column.ndim != 1 or not column.size:
            raise TrialError(place, f"it is {asset[key]!r:.40}", expected)
        columns[place] = column
    check_lengths(columns)
    return np.column_stack([*columns.values()])


def check_lengths(columns: Mapping[str, FloatArray]) -> None:
    """Raise an error if arrays differ in their number of samples."""
    first, *others = columns
    for place in others:
        if len(columns[place]) != len(columns[first]):
            problem = f"it has {len(columns[place])} samples"
            expected = f"{len(columns[first])} are expected, as in {first}"
            raise TrialError(place, problem, expected)
