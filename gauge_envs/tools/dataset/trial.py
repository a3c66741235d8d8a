"""Read and check one trial file of the GAUGE dataset.

A trial is a JSON object with `FPS`, `translation unit` and one object per asset. A rigid body has lists `x`, `y`, `z`
and usually `qx`, `qy`, `qz`, `qw`; `ex`, `ey`, `ez` are not used. A marker set has an object with `x`, `y`, `z` per
marker id. Each list has one sample per frame; `null` or NaN is a missing sample.

Unit and rate are never inferred from the values; the caller gives them for files without these values.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gauge_envs.names import first_names
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.text import json_document
from gauge_envs.tools.dataset.findings import TrialError
from gauge_envs.tools.dataset.layout import plain_name

POSITION_KEYS = ("x", "y", "z")
QUATERNION_KEYS = ("qx", "qy", "qz", "qw")

MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1e3}
"""Millimetres in a unit of length."""

NORM_TOLERANCE = 0.01
"""Largest error of the norm of a unit quaternion; files have at least three digits."""

MAX_COORDINATE_MM = 1e5
"""Largest coordinate; the capture volume has a width of a few metres."""


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Motion of one rigid body.

    Attributes:
        positions_mm: Positions of the origin in the motion-capture frame [mm], shape [frame_count, 3]; NaN if missing.
        quaternions_xyzw: Unit quaternions, body to world, shape [frame_count, 4]; NaN if missing.
    """

    positions_mm: FloatArray
    quaternions_xyzw: FloatArray


@dataclass(frozen=True, eq=False)
class Trial:
    """One trial file. Assets are checked on access, and may differ in their number of frames.

    Attributes:
        assets: Objects of the file by name.
        scale_mm: Millimetres in the file's unit of length.
    """

    assets: Mapping[str, Mapping[str, Any]]
    scale_mm: float

    def pose_track(self, body: str) -> PoseTrack:
        """Return the motion of a rigid body.

        Raises:
            TrialError: The body is missing or damaged.
        """
        names = self._named([body])
        if len(names) > 1:
            problem = f"it is a second {body!r}"
            raise TrialError(names[1], problem, "each body occurs once")
        for name in names:
            asset = self.assets[name]
            positions_mm = _positions_mm(name, asset, self.scale_mm)
            if not any(key in asset for key in QUATERNION_KEYS):
                unknown = np.full((len(positions_mm), 4), np.nan)
                return PoseTrack(positions_mm, unknown)
            quaternions = _table(name, asset, QUATERNION_KEYS)
            check_lengths({f"{name}.x": positions_mm, f"{name}.qx": quaternions})
            return PoseTrack(positions_mm, _unit_quaternions(name, quaternions))
        raise TrialError(body, "the rigid body is missing", self._contents())

    def markers_mm(self, bodies: Iterable[str]) -> dict[str, FloatArray]:
        """Return the positions of markers [mm], shape [frame_count, 3] each, by id.

        Args:
            bodies: Names of bodies with markers; a file without these sets gives all sets.

        Raises:
            TrialError: Markers are missing or damaged.
        """
        sets = [
            name
            for name, asset in self.assets.items()
            if any(isinstance(entry, dict) for entry in asset.values())
        ]
        positions_mm = {}
        for name in self._named([*bodies, "markers"]) or sets:
            for marker, entry in self.assets[name].items():
                place = f"{name}.{marker}"
                if marker in positions_mm:
                    expected = "each marker occurs once"
                    raise TrialError(place, "its id occurs twice", expected)
                positions_mm[marker] = _positions_mm(place, entry, self.scale_mm)
        if not positions_mm:
            raise TrialError("markers", "the marker set is missing", self._contents())
        check_lengths(positions_mm)
        return positions_mm

    def _named(self, names: Iterable[str]) -> list[str]:
        """Return the assets with these names, in any spelling."""
        plain_names = {plain_name(name) for name in names}
        return [name for name in self.assets if plain_name(name) in plain_names]

    def _contents(self) -> str:
        return f"the file has {first_names([*self.assets])}"


def parse_trial(content: bytes, defaults: Mapping[str, Any] | None = None) -> Trial:
    """Read one trial file, and check its rate and unit.

    Args:
        content: Bytes of the file.
        defaults: `translation unit` and `FPS` of files without these values.

    Raises:
        TrialError: The file is damaged, or its rate or unit is wrong.
    """
    try:
        document = json_document(content)
        if not isinstance(document, dict):
            raise ValueError(f"it is a {type(document).__name__}")
    except ValueError as error:
        expected = "expected a complete file of objects and lists"
        raise TrialError("(file)", f"it is not JSON: {error}", expected) from None
    scale_mm = _scale_mm({**(defaults or {}), **document})
    assets = {
        name: asset for name, asset in document.items() if isinstance(asset, dict)
    }
    return Trial(assets, scale_mm)


def _scale_mm(document: Mapping[str, Any]) -> float:
    """Check the rate of a file, and return the millimetres in its unit of length."""
    rate_hz, unit = document.get("FPS"), document.get("translation unit")
    if rate_hz != FRAME_RATE_HZ:
        problem = f"it is {_shown(rate_hz)}"
        expected = "expected 30; --rate 30 sets it for files without a rate"
        raise TrialError("FPS", problem, expected)
    scale_mm = MILLIMETRES.get(str(unit))
    if scale_mm is None:
        problem = f"it is {_shown(unit)}"
        expected = (
            "expected 'mm', 'cm' or 'm'; --unit mm sets it for files without a unit"
        )
        raise TrialError("translation unit", problem, expected)
    return scale_mm


def _shown(value: Any) -> str:
    return "missing" if value is None else repr(value)


def _unit_quaternions(name: str, quaternions: FloatArray) -> FloatArray:
    """Return normalized quaternions: files have rounding errors."""
    norms = np.linalg.norm(quaternions, axis=1)
    is_wrong = np.abs(norms - 1.0) > NORM_TOLERANCE
    if is_wrong.any():
        frame = int(is_wrong.argmax())
        problem = f"the quaternion's norm is {norms[frame]:.4g}"
        raise TrialError(f"{name}.q[{frame}]", problem, "expected 1")
    return quaternions / norms[:, None]


def _positions_mm(key: str, asset: Mapping[str, Any], scale_mm: float) -> FloatArray:
    """Return the positions of a body or a marker [mm], shape [frame_count, 3]."""
    positions_mm = scale_mm * _table(key, asset, POSITION_KEYS)
    is_far = (np.abs(positions_mm) > MAX_COORDINATE_MM).any(axis=1)
    if is_far.any():
        problem = f"it is more than {1e-3 * MAX_COORDINATE_MM:g} m away"
        place = f"{key}[{is_far.argmax()}]"
        raise TrialError(place, problem, "the capture volume is a few metres wide")
    return positions_mm


def _table(name: str, asset: Mapping[str, Any], keys: Sequence[str]) -> FloatArray:
    """Return lists of an asset as columns, shape [frame_count, column_count]."""
    columns = {}
    for key in keys:
        place = f"{name}.{key}"
        if not isinstance(asset, dict) or key not in asset:
            raise TrialError(place, "it is missing", f"an asset has {', '.join(keys)}")
        expected = "expected a list with a number or null for each frame"
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
    first, *rest = columns
    for place in rest:
        if len(columns[place]) != len(columns[first]):
            problem = f"it has {len(columns[place])} samples"
            expected = f"expected {len(columns[first])}, as in {first}"
            raise TrialError(place, problem, expected)
