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
import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gauge_envs.files import npz_arrays
from gauge_envs.scene.geometry import FloatArray
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
HEADS = {
    spelling: key
    for key, spellings in SPELLINGS.items()
    for spelling in spellings.split()
}

WRAPPERS = {
    "bodies",
    "rigidbodies",
    "assets",
    "objects",
    "data",
    "trajectory",
    "trajectories",
    "trial",
}
"""Names of objects that hold assets."""

ROWS: dict[str, tuple[str, ...]] = dict.fromkeys(
    ("position", "positions", "pos", "translation"), ("x", "y", "z")
)
ROWS |= dict.fromkeys(
    ("quatxyzw", "quaternionxyzw", "quaternionsxyzw", "xyzw"), ("qx", "qy", "qz", "qw")
)
ROWS |= dict.fromkeys(
    ("quatwxyz", "quaternionwxyz", "quaternionswxyz", "wxyz"), ("qw", "qx", "qy", "qz")
)
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
SECONDS = re.compile(r"[\[(]s[\])]|_s$")
COMMENT = re.compile(r"#\s*([\w ]+?)\s*[:=]\s*(\S+)")
NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?\s*", re.IGNORECASE)

TIME_TOLERANCE_S = 1e-3
"""Largest distance of a time from an even spacing; files print three digits or more."""

Path = tuple[str, ...]
"""Names of the asset, and of the marker, that a list belongs to; empty where its name states them."""


@dataclass(frozen=True, kw_only=True)
class Stated:
    """What a user states for files that do not.

    Attributes:
        unit: `mm`, `cm` or `m`.
        rate_hz: Frames in a second.
    """

    unit: str | None = None
    rate_hz: float | None = None


def published_form(content: bytes, suffix: str, stated: Stated) -> dict[str, Any]:
    """Return the content of a trial file as the object of a published file.

    Args:
        content: The file's bytes.
        suffix: Suffix of the file, in lower case: one of `FORMS`.
        stated: Unit and rate of files that do not state them.
    """
    entries = {".json": _json_entries, ".csv": _csv_entries, ".npz": _npz_entries}[
        suffix
    ](content)
    form = _Form()
    for path, name, values in entries:
        form.add(path, name, values)
    return form.published(stated)


@dataclass
class _Form:
    """A file on its way into the published form.

    Attributes:
        heads: Rate, unit, times and frame numbers, by their published names.
        assets: Lists by published name, of each asset or of each of its markers.
        units: Name of the first column with each unit.
        unknown: Names that are not read.
    """

    heads: dict[str, Any] = field(default_factory=dict)
    assets: dict[str, dict[str, Any]] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    unknown: list[str] = field(default_factory=list)

    def add(self, path: Path, name: str, values: Any) -> None:
        """Add a list of numbers, an array, or a scalar, by its name."""
        head = HEADS.get(_plain(SECONDS.sub("", name)))
        if not path and head is not None:
            self._add_head(head, values)
        elif isinstance(values, np.ndarray) and values.ndim > 1:
            self._add_array(name, values)
        elif path and _plain(name) in ROWS and isinstance(values, list):
            self._add_rows(path, ROWS[_plain(name)], values, ".".join((*path, name)))
        elif found := COLUMN.fullmatch(name):
            axis = found["axis"].lower()
            is_quaternion = axis[0] in "qw" or (found["kind"] or "").lower().startswith(
                "quat"
            )
            key = f"q{axis[-1]}" if is_quaternion else axis[-1]
            listed = (
                values.reshape(-1).tolist()
                if isinstance(values, np.ndarray)
                else values
            )
            self._put(path or _path(found["asset"] or ""), key, listed, name)
            self._note_unit(found["unit"], name)
        elif len(path) == 1:
            # Another entry of an asset, which is a fault among the markers of a marker set.
            self.assets.setdefault(path[0], {})[name] = values
        else:
            self.unknown.append(name)

    def _add_head(self, head: str, values: Any) -> None:
        if isinstance(values, np.ndarray):
            values = values.reshape(-1).tolist()
        if head in (RATE, UNIT):
            self.heads[head] = (
                values[0] if isinstance(values, list) and values else values
            )
        elif isinstance(values, list):
            self.heads[head] = values

    def _add_array(self, name: str, array: FloatArray) -> None:
        """Add an array of rows: those of a body, or of each of several markers."""
        found = ARRAY.fullmatch(name)
        assert found is not None
        columns = ROWS.get(_plain(found["rows"]), ("x", "y", "z"))
        asset = found["asset"]
        if array.ndim == 2 and array.shape[1] == len(columns):
            self._add_rows(_path(asset), columns, array.tolist(), name)
        elif array.ndim == 3 and array.shape[2] == len(columns) == 3:
            for marker in range(array.shape[1]):
                self._add_rows(
                    (asset, str(marker)), columns, array[:, marker].tolist(), name
                )
        else:
            raise TrialError(
                name,
                f"its shape is {list(array.shape)}",
                "[T, 3], [T, M, 3], or [T, 4] with xyzw or wxyz in its name, is expected",
            )
        self._note_unit(found["unit"], name)

    def _add_rows(
        self, path: Path, columns: tuple[str, ...], rows: list[Any], place: str
    ) -> None:
        if not all(isinstance(row, list) and len(row) == len(columns) for row in rows):
            raise TrialError(
                place,
                "its rows differ in length",
                f"rows of {', '.join(columns)} are expected",
            )
        for index, key in enumerate(columns):
            self._put(path, key, [row[index] for row in rows], place)

    def _put(self, path: Path, key: str, values: Any, place: str) -> None:
        # Columns of one body may spell it in several ways.
        name = next(
            (known for known in self.assets if _plain(known) == _plain(path[0])),
            path[0],
        )
        lists = self.assets.setdefault(name, {})
        for marker in path[1:]:
            lists = lists.setdefault(marker, {})
        if key in lists:
            of = ".".join(path) or "the file"
            raise TrialError(
                place,
                f"the key occurs twice, as {key} of {of}",
                "unique names are expected",
            )
        lists[key] = values

    def _note_unit(self, unit: str | None, name: str) -> None:
        if unit:
            self.units.setdefault(unit.lower(), name)

    def published(self, stated: Stated) -> dict[str, Any]:
        """Return the object of a published file."""
        if not self.assets:
            unknown = (
                f"; no name of a column is known: {', '.join(self.unknown[:6])}"
                if self.unknown
                else ""
            )
            raise TrialError(
                "(file)",
                f"it holds no asset{unknown}",
                "an object such as 'cube', or names as cube.x, foam.17.x, are expected",
            )
        if len(self.units) > 1:
            first = next(iter(self.units.values()))
            raise TrialError(
                first, f"columns are in {', '.join(self.units)}", "one unit is expected"
            )
        column_unit = next(iter(self.units), None)
        unit = self.heads.get(UNIT, column_unit)
        if self.units and unit != column_unit:
            raise TrialError(
                UNIT,
                f"it is {unit}, and columns are in {column_unit}",
                "one unit is expected",
            )
        rate = self.heads.get(RATE)
        if TIME in self.heads:
            timed = _rate_hz(self.heads[TIME])
            rate = timed if rate is None else rate
            if not isinstance(rate, int | float) or abs(timed / rate - 1.0) > 1e-2:
                raise TrialError(
                    TIME,
                    f"its spacing is that of {timed:.4g} Hz",
                    f"{rate} Hz is stated",
                )
        if FRAME in self.heads and set(np.diff(_numbers(FRAME, self.heads[FRAME]))) - {
            1.0
        }:
            raise TrialError(
                FRAME,
                "it does not count by 1",
                "a row for each frame is expected, empty where none was captured",
            )
        return {
            RATE: stated.rate_hz if rate is None else rate,
            UNIT: stated.unit if unit is None else unit,
            **self.assets,
        }


def _path(name: str) -> Path:
    """Return the path that a name states: `foam.17` is marker 17 of the foam."""
    marker = MARKER.fullmatch(name)
    return (name,) if marker is None else (marker[1], marker[2])


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _numbers(key: str, values: Any) -> FloatArray:
    try:
        return np.array(values, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError, OverflowError):
        raise TrialError(
            key, "it is not a list of numbers", "one number a frame is expected"
        ) from None


def _rate_hz(values: Any) -> float:
    times = _numbers(TIME, values)
    span = float(times[-1] - times[0]) if len(times) > 1 else 0.0
    even = np.linspace(times[0], times[-1], len(times)) if span > 0.0 else times
    if not span > 0.0 or np.abs(times - even).max() > TIME_TOLERANCE_S:
        raise TrialError(
            TIME,
            "its times [s] are not evenly spaced",
            f"{FRAME_RATE_HZ:g} frames a second are expected",
        )
    rate = (len(times) - 1) / span
    return (
        FRAME_RATE_HZ
        if abs(rate / FRAME_RATE_HZ - 1.0) < TIME_TOLERANCE_S / span + 1e-6
        else rate
    )


# --- the three kinds of files ---

Entry = tuple[Path, str, Any]
"""Path, name and values of a list, an array or a scalar of a file."""


def _json_entries(content: bytes) -> Iterator[Entry]:
    if not content.strip():
        raise TrialError("(file)", "it is empty", "a JSON object is expected")
    try:
        values = json.loads(content, object_pairs_hook=_unique)
    except RecursionError:
        raise TrialError(
            "(file)",
            "its objects are nested too deeply",
            "assets hold lists of numbers",
        ) from None
    except UnicodeDecodeError as error:
        raise TrialError(
            "(file)", f"it is not text: {error.reason}", "JSON in UTF-8 is expected"
        ) from None
    except ValueError as error:
        raise TrialError(
            "(file)", f"it is not JSON: {error}", "a complete JSON object is expected"
        ) from None
    if not isinstance(values, dict):
        raise TrialError(
            "(file)",
            f"it is a JSON {type(values).__name__}",
            "a JSON object is expected",
        )
    yield from _object_entries(values, ())


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        twice = next(
            key for key, count in Counter(key for key, _ in pairs).items() if count > 1
        )
        raise TrialError(
            twice,
            "the key occurs twice",
            "unique names of assets, markers and lists are expected",
        )
    return values


def _object_entries(values: Mapping[str, Any], path: Path) -> Iterator[Entry]:
    for key, value in values.items():
        if not isinstance(value, dict):
            yield path, key, value
        elif not path and _plain(key) in WRAPPERS:
            yield from _object_entries(value, path)
        elif len(path) < 2:
            yield from _object_entries(value, (*path, key))


def _csv_entries(content: bytes) -> Iterator[Entry]:
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise TrialError(
            "(file)", f"it is not text: {error.reason}", "CSV in UTF-8 is expected"
        ) from None
    for line in lines:
        comment = COMMENT.match(line)
        if comment is not None and _plain(comment[1]) in HEADS:
            yield (), comment[1], _value(comment[2])
    rows = [line for line in lines if line.strip() and not line.startswith("#")]
    header = rows[0] if rows else ""
    try:
        table = list(csv.reader(rows, delimiter=max(",;\t", key=header.count)))
    except csv.Error as error:
        raise TrialError(
            "(file)",
            f"it is not CSV: {error}",
            "a header and rows of numbers are expected",
        ) from None
    if len(table) < 2 or any(NUMBER.fullmatch(name) for name in table[0]):
        raise TrialError(
            "(file)",
            "it has no header, or no row",
            "names as cube.x, and a row for each frame, are expected",
        )
    width = len(table[0])
    for number, row in enumerate(table[1:], start=1):
        if len(row) != width:
            expected = f"{width} are expected, as in the header"
            raise TrialError(f"row {number}", f"it has {len(row)} columns", expected)
    for name, *texts in zip(*table, strict=True):
        yield (), name.strip(), [_value(text) for text in texts]


def _value(text: str) -> float | str:
    """Return a number, NaN for an empty field; other text as it is, which is a fault where the column is needed."""
    if NUMBER.fullmatch(text):
        return float(text)
    return float("nan") if text.strip().lower() in ("", "nan", "null") else text.strip()


def _npz_entries(content: bytes) -> Iterator[Entry]:
    try:
        for name, array in npz_arrays(content).items():
            yield (), name, array
    except ValueError as error:
        raise TrialError(
            "(file)",
            f"it is not an NPZ file of numbers: {error}",
            "arrays of numbers are expected",
        ) from None
