"""Bring a trial file of another form into that of the published files, by the names and shapes in it.

A published file is a JSON object with `FPS`, `translation unit`, and an object of lists `x`, `y`, `z` for each asset.
The same is read from

- JSON with other spellings: `X` or `pos_x`, `positions` as rows, assets one level down in `bodies` or `data`,
- CSV with a header: `cube.x`, `Cube_qw`, `foam.17.x [mm]`; comments as `# fps: 30`, `# unit: mm`,
- NPZ: `cube` [T, 3], `cube_quat_xyzw` [T, 4], `foam` [T, M, 3] in the metadata's order, or columns as in a CSV file.

The rate is that of the file, or of its time column. Unit and rate are never inferred from the values: where the file
has none, the caller states them (`Stated`). Columns of other names are not read.
"""

import csv
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gauge_envs.files import npz_arrays, npz_names
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.dataset.findings import TrialError

FORMS = (".json", ".npz", ".csv")
"""Suffixes of trial files; the first counts where a trial is there in several."""

RATE, UNIT, TIME, FRAME = "FPS", "translation unit", "time", "frame"
SPELLINGS = {
    RATE: "fps framerate frameratehz rate ratehz samplerate frequency hz",
    UNIT: "translationunit unit units lengthunit positionunit",
    TIME: "time times timestamp t",
    FRAME: "frame frames frameindex framenumber",
}
HEADS = {spelling: key for key, spellings in SPELLINGS.items() for spelling in spellings.split()}

WRAPPERS = {"bodies", "rigidbodies", "assets", "objects", "data", "trajectory", "trajectories", "trial"}
"""Names of objects that hold assets."""

ROWS = {"position": "xyz", "positions": "xyz", "pos": "xyz", "translation": "xyz"}
ROWS |= {f"{name}xyzw": "xyzw" for name in ("quat", "quaternion", "quaternions", "")}
ROWS |= {f"{name}wxyz": "wxyz" for name in ("quat", "quaternion", "quaternions", "")}
"""Columns of rows of numbers, by the name of the list or array."""

COLUMN = re.compile(
    r"(?:(?P<asset>.*?)[ ._:/-])?(?:(?P<kind>positions?|pos|translation|quaternion|quat)[ ._]*)?"
    r"(?P<axis>q?[xyzw]|[tp][xyz])(?:[ ._]*[\[(]?(?P<unit>mm|cm|m)[\])]?)?",
    re.IGNORECASE,
)
ARRAY = re.compile(
    r"(?P<asset>.*?)[ ._:/-]*(?P<rows>positions?|pos|translation|(?:quaternions?|quat)?[ ._]*(?:xyzw|wxyz)|)"
    r"(?:[ ._]+(?P<unit>mm|cm|m))?",
    re.IGNORECASE,
)
MARKER = re.compile(r"(.+)[./:](\d+)")
COMMENT = re.compile(r"#\s*([\w ]+?)\s*[:=]\s*(\S+)")

MOST_ARRAY_BYTES = 64 * 1024**2

TIME_TOLERANCE_S = 1e-3
"""Largest distance of a time from an even spacing; files print three digits or more."""


@dataclass(frozen=True, kw_only=True)
class Stated:
    """What a user states for files that do not.

    Attributes:
        unit: `mm`, `cm` or `m`.
        rate_hz: Frames in a second.
    """

    unit: str | None = None
    rate_hz: float | None = None


@dataclass
class _Form:
    """A file on its way into the published form."""

    heads: dict[str, Any] = field(default_factory=dict)
    assets: dict[str, dict[str, Any]] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)

    def add(self, path: str, name: str, values: Any) -> bool:
        """Add one column by its name; return whether the name is that of a column."""
        found = COLUMN.fullmatch(name)
        if found is None:
            return False
        axis = found["axis"].lower()[-1]
        turns = axis == "w" or (found["kind"] or "").lower().startswith("quat") or found["axis"].lower().startswith("q")
        self._put(path or found["asset"] or "", f"q{axis}" if turns else axis, values, name)
        if found["unit"]:
            self.units[found["unit"].lower()] = name
        return True

    def add_rows(self, path: str, columns: str, rows: Any, place: str) -> None:
        """Add the columns of rows of numbers, shape [T, len(columns)]."""
        if isinstance(rows, list) and not all(isinstance(row, list) and len(row) == len(columns) for row in rows):
            raise TrialError(place, "its rows differ in length", f"rows of {', '.join(columns)} are expected")
        for axis, values in zip(columns, zip(*rows, strict=True), strict=True):
            self._put(path, f"q{axis}" if len(columns) == 4 else axis, list(values), place)

    def _put(self, path: str, key: str, values: Any, place: str) -> None:
        marker = MARKER.fullmatch(path)
        name = marker[1] if marker else path
        # Columns of one body may spell it in several ways.
        name = next((known for known in self.assets if _plain(known) == _plain(name)), name)
        asset = self.assets.setdefault(name, {})
        asset = asset.setdefault(marker[2], {}) if marker else asset
        if key in asset:
            raise TrialError(
                place, f"the key occurs twice, as {key} of {path or 'the file'}", "unique names are expected"
            )
        asset[key] = values

    def published(self, stated: Stated) -> dict[str, Any]:
        """Return the object of a published file."""
        if len(self.units) > 1:
            raise TrialError(
                next(iter(self.units.values())), f"columns are in {', '.join(self.units)}", "one unit is expected"
            )
        rate, unit = self.heads.get(RATE), self.heads.get(UNIT, next(iter(self.units), None))
        if self.units and unit not in self.units:
            raise TrialError(UNIT, f"it is {unit}, and columns are in {next(iter(self.units))}", "one unit is expected")
        if TIME in self.heads:
            timed = _rate_hz(self.heads[TIME])
            rate = timed if rate is None else rate
            if not isinstance(rate, int | float) or abs(timed / rate - 1.0) > 1e-2:
                raise TrialError(TIME, f"its spacing is that of {timed:.4g} Hz", f"{rate} Hz is stated")
        if FRAME in self.heads and set(np.diff(_numbers(FRAME, self.heads[FRAME]))) - {1.0}:
            raise TrialError(
                FRAME, "it does not count by 1", "a row for each frame is expected, empty where none was captured"
            )
        return {
            RATE: stated.rate_hz if rate is None else rate,
            UNIT: stated.unit if unit is None else unit,
            **self.assets,
        }


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _numbers(key: str, values: Any) -> Any:
    try:
        return np.array(values, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError, OverflowError):
        raise TrialError(key, "it is not a list of numbers", "one number a frame is expected") from None


def _rate_hz(values: Any) -> float:
    times = _numbers(TIME, values)
    span = times[-1] - times[0] if len(times) > 1 else 0.0
    if not span > 0.0 or np.abs(times - np.linspace(times[0], times[-1], len(times))).max() > TIME_TOLERANCE_S:
        raise TrialError(TIME, "its times [s] are not evenly spaced", f"{FRAME_RATE_HZ:g} frames a second are expected")
    rate = (len(times) - 1) / float(span)
    return FRAME_RATE_HZ if abs(rate / FRAME_RATE_HZ - 1.0) < TIME_TOLERANCE_S / float(span) + 1e-6 else rate


def from_json(values: Mapping[str, Any], stated: Stated) -> dict[str, Any]:
    """Return the published form of a JSON object."""
    form = _Form()
    _add_object(form, values)
    return form.published(stated)


def _add_object(form: _Form, values: Mapping[str, Any]) -> None:
    for key, value in values.items():
        head = HEADS.get(_plain(key))
        if head is not None and isinstance(value, list) == (head in (TIME, FRAME)) and not isinstance(value, dict):
            form.heads[head] = value
        elif isinstance(value, dict) and _plain(key) in WRAPPERS:
            _add_object(form, value)
        elif isinstance(value, dict):
            form.assets[key] = _asset(form, key, value)
        elif isinstance(value, list):
            form.add("", key, value)


def _asset(form: _Form, path: str, asset: Mapping[str, Any]) -> dict[str, Any]:
    """Return an asset, or a marker, with the published names of its lists."""
    own = _Form(units=form.units)
    for key, value in asset.items():
        if isinstance(value, dict):
            own.assets.setdefault(path, {})[key] = _asset(form, f"{path}.{key}", value)
        elif _plain(key) in ROWS and isinstance(value, list):
            own.add_rows("", ROWS[_plain(key)], value, f"{path}.{key}")
        elif not (COLUMN.fullmatch(key) and "." not in key and own.add(" ", key, value)):
            own.assets.setdefault(path, {})[key] = value
    return {**own.assets.get(" ", {}), **own.assets.get("", {}), **own.assets.get(path, {})}


def from_csv(content: bytes, stated: Stated) -> dict[str, Any]:
    """Return the published form of a CSV file."""
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise TrialError("(file)", f"it is not text: {error.reason}", "CSV in UTF-8 is expected") from None
    form = _Form()
    for line in lines:
        if (found := COMMENT.match(line)) and (head := HEADS.get(_plain(found[1]))):
            form.heads[head] = float(found[2]) if head == RATE and _is_number(found[2]) else found[2]
    rows = [line for line in lines if line.strip() and not line.startswith("#")]
    header = rows[0] if rows else ""
    try:
        table = list(csv.reader(rows, delimiter=max(",;\t", key=header.count)))
    except csv.Error as error:
        raise TrialError("(file)", f"it is not CSV: {error}", "a header and rows of numbers are expected") from None
    if len(table) < 2 or any(_is_number(name) for name in table[0]):
        raise TrialError(
            "(file)", "it has no header, or no row", "names as cube.x, and a row for each frame, are expected"
        )
    for number, row in enumerate(table[1:], start=1):
        if len(row) != len(table[0]):
            raise TrialError(
                f"row {number}", f"it has {len(row)} columns", f"{len(table[0])} are expected, as in the header"
            )
    _add_columns(form, ((name.strip(), [_value(name, text) for text in of]) for name, *of in zip(*table, strict=True)))
    return form.published(stated)


def _is_number(text: str) -> bool:
    return re.fullmatch(r"\s*[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?\s*", text, re.IGNORECASE) is not None


def _value(name: str, text: str) -> float | str:
    """Return a number, NaN for an empty field; other text as it is, which is a fault where the column is needed."""
    plain = text.strip()
    return float(plain) if _is_number(plain) else float("nan") if plain.lower() in ("", "nan", "null") else plain


def _add_columns(form: _Form, columns: Iterable[tuple[str, list[Any]]]) -> None:
    left: list[str] = []
    for name, values in columns:
        head = HEADS.get(_plain(re.sub(r"[\[(]s[\])]|_s$", "", name)))
        if head is not None:
            form.heads[head] = values[0] if head in (RATE, UNIT) else values
        elif not form.add("", name, values):
            left.append(name)
    if not form.assets:
        raise TrialError(
            "(file)", f"no name of a column is known: {', '.join(left[:6])}", "names as cube.x, foam.17.x are expected"
        )


def from_npz(content: bytes, stated: Stated) -> dict[str, Any]:
    """Return the published form of an NPZ file."""
    form = _Form()
    columns: list[tuple[str, list[Any]]] = []
    left = MOST_ARRAY_BYTES
    try:
        for name in npz_names(content):
            array = npz_arrays(content, [name], left)[name]
            left -= array.nbytes
            if array.ndim < 2:
                columns.append((name, array.reshape(-1).tolist()))
            else:
                _add_array(form, name, array)
    except ValueError as error:
        raise TrialError(
            "(file)", f"it is not an NPZ file of numbers: {error}", "arrays of numbers are expected"
        ) from None
    if columns or not form.assets:
        _add_columns(form, columns)
    return form.published(stated)


def _add_array(form: _Form, name: str, array: Any) -> None:
    found = ARRAY.fullmatch(name)
    assert found is not None
    columns = ROWS.get(_plain(found["rows"]), "xyz")
    if array.ndim == 2 and array.shape[1] == len(columns):
        form.add_rows(found["asset"], columns, array.tolist(), name)
    elif array.ndim == 3 and array.shape[2] == 3 and columns == "xyz":
        for marker in range(array.shape[1]):
            form.add_rows(f"{found['asset']}.{marker}", columns, array[:, marker].tolist(), name)
    else:
        raise TrialError(
            name,
            f"its shape is {list(array.shape)}",
            "[T, 3], [T, M, 3], or [T, 4] with xyzw or wxyz in its name, is expected",
        )
    if found["unit"]:
        form.units[found["unit"].lower()] = name
