"""Read and check one trial file of the GAUGE dataset.

A trial is a JSON object with `FPS`, `translation unit` and one object per asset, which `forms` also makes of CSV.
A rigid body has lists `x`, `y`, `z` and usually `qx`, `qy`, `qz`, `qw`; `ex`, `ey`, `ez` are not used. A marker set has
an object with `x`, `y`, `z` per marker id. Each list has one sample per frame; `null` or NaN is a sample that was not
captured.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.dataset.findings import TrialError
from gauge_envs.tools.dataset.forms import RATE, UNIT, Stated, published_form

Lengths = dict[str, int]
"""Number of samples of each list of an asset, by its place; all have as many as the first."""

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


LARGEST_MM = 1e5
"""Largest coordinate; the capture volume is a few metres wide, and squares of larger values may overflow."""


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


def parse_trial(
    content: bytes, suffix: str = ".json", stated: Stated | None = None
) -> Trial:
    """Read and check one trial file.

    Args:
        content: The file's bytes.
        suffix: Suffix of the file, in lower case: one of `FORMS`.
        stated: Unit and rate of files that do not state them.
    """
    values = published_form(content, suffix, stated or Stated())
    rate, unit = values[RATE], values[UNIT]
    if rate != FRAME_RATE_HZ:
        advice = "; --rate 30 states that of files without one" if rate is None else ""
        expected = f"{FRAME_RATE_HZ:g} is expected{advice}"
        raise TrialError(RATE, f"it is {_shown(rate)}", expected)
    scale = MILLIMETRES.get(str(unit).lower().rstrip("s"))
    if scale is None:
        advice = "; --unit mm states that of files without one" if unit is None else ""
        expected = f"'mm' is expected, or 'cm' or 'm'{advice}"
        raise TrialError(UNIT, f"it is {_shown(unit)}", expected)
    poses: dict[str, PoseTrack] = {}
    markers: dict[str, dict[str, FloatArray]] = {}
    faults: dict[str, TrialError] = {}
    assets = {name: one for name, one in values.items() if isinstance(one, dict)}
    if not assets:
        expected = (
            "an object such as 'cube', or columns as cube.x, foam.17.x, are expected"
        )
        raise TrialError("(file)", "it holds no asset", expected)
    for name, asset in assets.items():
        lengths: Lengths = {}
        try:
            if any(isinstance(entry, dict) for entry in asset.values()):
                markers[name] = {
                    marker: _marker(f"{name}.{marker}", entry, lengths, scale)
                    for marker, entry in asset.items()
                }
            else:
                poses[name] = _pose(name, asset, lengths, scale)
        except TrialError as error:
            faults[name] = error
    return Trial(poses=poses, markers=markers, faults=faults)


def _positions(
    name: str, asset: Mapping[str, Any], lengths: Lengths, scale: float
) -> FloatArray:
    positions = scale * _table(name, asset, POSITION_KEYS, lengths)
    far = np.abs(positions) > LARGEST_MM
    if far.any():
        frame, axis = np.argwhere(far)[0]
        raise TrialError(
            f"{name}.{POSITION_KEYS[axis]}[{frame}]",
            f"it is {positions[frame, axis]:.4g} mm",
            "the capture volume is a few metres wide",
        )
    return positions


def _pose(
    name: str, asset: Mapping[str, Any], lengths: Lengths, scale: float
) -> PoseTrack:
    positions = _positions(name, asset, lengths, scale)
    given = [key for key in QUATERNION_KEYS if key in asset]
    if not given:
        return PoseTrack(positions, None)
    quaternions = _table(name, asset, QUATERNION_KEYS, lengths)
    with np.errstate(
        over="ignore"
    ):  # a component whose square is no float has an infinite norm
        norms = np.linalg.norm(quaternions, axis=1)
    wrong = np.abs(norms - 1.0) > NORM_TOLERANCE
    if wrong.any():
        frame = int(wrong.argmax())
        raise TrialError(
            f"{name}.q[{frame}]",
            f"the quaternion's norm is {norms[frame]:.4g}",
            "1 is expected",
        )
    return PoseTrack(positions, quaternions / norms[:, None])


def _marker(key: str, entry: Any, lengths: Lengths, scale: float) -> FloatArray:
    if not isinstance(entry, dict):
        raise TrialError(
            key, f"it is {_shown(entry)}", "a marker is an object with x, y, z"
        )
    positions = _positions(key, entry, lengths, scale)
    # A marker is captured in all three coordinates or not at all.
    positions[np.isnan(positions).any(axis=1)] = np.nan
    return positions


def _table(
    name: str, asset: Mapping[str, Any], keys: tuple[str, ...], lengths: Lengths
) -> FloatArray:
    """Return lists of an asset as columns, shape [frame_count, column_count]."""
    missing = [key for key in keys if key not in asset]
    if missing:
        raise TrialError(
            f"{name}.{missing[0]}", "it is missing", f"an asset has {', '.join(keys)}"
        )
    columns = [_numbers(f"{name}.{key}", asset[key]) for key in keys]
    for key, column in zip(keys, columns, strict=True):
        lengths[f"{name}.{key}"] = len(column)
        first, count = next(iter(lengths.items()))
        if len(column) != count:
            raise TrialError(
                f"{name}.{key}",
                f"it has {len(column)} samples",
                f"{count} are expected, as in {first}",
            )
    return np.column_stack(columns)


def _numbers(key: str, values: Any) -> FloatArray:
    if not isinstance(values, list) or not values:
        expected = "a list of numbers, one a frame, is expected"
        raise TrialError(key, f"it is {_shown(values)}", expected)
    for frame, value in enumerate(values):
        # A boolean is an integer in Python.
        if type(value) not in (int, float, type(None)):
            place = f"{key}[{frame}]"
            expected = "a number or null is expected"
            raise TrialError(place, f"it is {_shown(value)}", expected)
    try:
        numbers = np.array(values, dtype=np.float64)
    except OverflowError:
        expected = "finite numbers are expected"
        raise TrialError(key, "a number is too large", expected) from None
    if np.isinf(numbers).any():
        place = f"{key}[{np.isinf(numbers).argmax()}]"
        raise TrialError(
            place, "it is infinite", "a finite number, or null, is expected"
        )
    return numbers


def _shown(value: Any) -> str:
    """Return a short text of a value, for a message."""
    if value is None:
        return "missing"
    if isinstance(value, list):
        return "a list" if value else "an empty list"
    text = repr(value) if isinstance(value, str | int | float) else type(value).__name__
    return text if len(text) <= 40 else f"{text[:37]}..."
