"""Logs of joints: what was commanded and measured over time, from CSV and NPZ files."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import AssetError, ParameterError
from gauge_envs.files import (
    MEGABYTE,
    NUMBERS,
    csv_text,
    npz_arrays,
    npz_names,
    read_regular,
)
from gauge_envs.scene.geometry import FloatArray

POSITION, COMMAND, TORQUE = "position_rad", "command_rad", "torque_n_m"
RATE = "rate_rad_per_s"
KINDS = ("time_s", POSITION, COMMAND, TORQUE, RATE)
"""What the columns of a log hold."""
SLIDING = {"position_m": POSITION, "command_m": COMMAND, "force_n": TORQUE, "rate_m_per_s": RATE}  # fmt: skip
"""Columns of a joint that slides, and those of a hinge that hold the same."""
MOST_LOG_BYTES = 50 * MEGABYTE
"""Largest size of a log, as a file and as arrays in memory: three minutes of seven joints at 1 kHz as text."""
AT_REST = 0.01
"""Largest distance from the last angle, over the largest of a swing, at which a joint rests."""
NAMES = "joints"
"""Array of an NPZ file with the names of its joints."""


@dataclass(frozen=True, eq=False)
class Log:
    """What was measured at the joints of a machine, with N samples of J joints.

    Attributes:
        name: The file, or the file and the part.
        times_s: Times of the samples, ascending [s], shape [N].
        position_rad: Measured angles [rad], shape [N, J].
        command_rad: Commanded angles of position servos [rad], shape [N, J]; None without servos.
        torque_n_m: Torques of the motors [N m], shape [N, J]; None without torque motors.
        joints: Names of the joints; none where the log names none.
        rate_rad_per_s: Measured rates [rad/s], shape [N, J]; None without them. The first ones start predictions.
    """

    name: str
    times_s: FloatArray
    position_rad: FloatArray
    command_rad: FloatArray | None = None
    torque_n_m: FloatArray | None = None
    joints: tuple[str, ...] = ()
    rate_rad_per_s: FloatArray | None = None

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.times_s[-1] - self.times_s[0])

    @property
    def columns(self) -> dict[str, Any]:
        """What was measured and commanded, by the name of its column, shape [N, J] each."""
        columns = (POSITION, COMMAND, TORQUE, RATE)
        named = {name: getattr(self, name) for name in columns}
        return {name: values for name, values in named.items() if values is not None}

    def pieces(self, length_s: float) -> Iterator[Log]:
        """Yield the log in parts of equal length, at most the given one [s]."""
        count = max(1, int(np.ceil(self.duration_s / length_s - 1e-9)))
        edges = np.searchsorted(
            self.times_s, np.linspace(self.times_s[0], self.times_s[-1], count + 1)
        )
        edges[-1] = len(self.times_s)
        for number, (first, last) in enumerate(pairwise(edges.tolist())):
            name = self.name if count == 1 else f"{self.name}, part {number + 1}"
            rows = {key: values[first:last] for key, values in self.columns.items()}
            yield replace(self, name=name, times_s=self.times_s[first:last], **rows)

    def moving(self) -> Log:
        """Return a free swing without the time after it came to rest, of which a fifth of the swing's is left.

        A joint that rests tells only that friction holds it.
        """
        if self.command_rad is not None or self.torque_n_m is not None:
            return self
        from_end = np.abs(self.position_rad - self.position_rad[-1])
        is_moving = (from_end > AT_REST * from_end.max(axis=0)).any(axis=1)
        last = int(np.flatnonzero(is_moving)[-1]) if is_moving.any() else 0
        end_s = self.times_s[0] + 1.2 * (self.times_s[last] - self.times_s[0])
        count = max(int(np.searchsorted(self.times_s, end_s, side="right")), 10)
        rows = {key: values[:count] for key, values in self.columns.items()}
        return replace(self, times_s=self.times_s[:count], **rows)

    def thinned(self, apart_s: float) -> Log:
        """Return the log with samples at most this far apart, or as it is if they are further [s]."""
        every = max(int(apart_s / np.median(np.diff(self.times_s)) + 1e-9), 1)
        rows = {key: values[::every] for key, values in self.columns.items()}
        return replace(self, times_s=self.times_s[::every], **rows)

    def only(self, names: Sequence[str]) -> Log:
        """Return the log of some of its joints."""
        if strange := [one for one in names if one not in self.joints]:
            known = ", ".join(self.joints) or "none with a name"
            raise ParameterError(
                f"{self.name} has no joint {strange[0]}; it has {known}"
            )
        places = [self.joints.index(one) for one in names]
        some = {key: values[:, places] for key, values in self.columns.items()}
        return replace(self, joints=tuple(names), **some)

    def times(self, factor: float) -> Log:
        """Return the log with all angles and rates times a factor."""
        angles = {
            key: values if key == TORQUE else factor * values
            for key, values in self.columns.items()
        }
        return replace(self, **angles)

    def start(self) -> tuple[FloatArray, FloatArray]:
        """Return angles [rad] and rates [rad/s] at the first sample, shape [J] each.

        They are the measured ones, or of parabolas through 0.05 s where no rates were measured.
        """
        if self.rate_rad_per_s is not None:
            return self.position_rad[0], self.rate_rad_per_s[0]
        count = max(4, int(np.searchsorted(self.times_s, self.times_s[0] + 0.05)))
        times_s = self.times_s[:count] - self.times_s[0]
        rate, angle = np.polyfit(times_s, self.position_rad[:count], 2)[1:]
        return angle, rate


def read_log(path: Path) -> Log:
    """Read a log.

    A CSV file has a header with `time_s`, `position_rad` and one of `command_rad` and `torque_n_m`, or none of both for
    a joint that swings freely. Several joints have columns with a name behind a dot each, as `position_rad.elbow`. An
    NPZ file has arrays of these names, shape [N] or [N, J], and may have names in `joints`, shape [J]. Measured
    rates are `rate_rad_per_s`. A joint that slides has the columns of `SLIDING`. Other columns do not matter to a joint
    with a motor.

    Raises:
        AssetError: The file cannot be read, a column is missing, numbers are not finite, times do not ascend, or
            the log of a free swing has an unknown column.
    """
    try:
        named, named_joints = _npz(path) if path.suffix == ".npz" else (_csv(path), ())
    except FileNotFoundError:
        raise AssetError(path, "", "there is no such file") from None
    except (OSError, ValueError, TypeError) as error:
        raise AssetError(
            path, "log", f"cannot be read as CSV or NPZ: {error}"
        ) from None
    kinds = {name: _kind(name) for name in named}
    motors = [kind for kind in (COMMAND, TORQUE) if kind in kinds.values()]
    rates = [RATE] if RATE in kinds.values() else []
    joints = [
        name.removeprefix(POSITION) for name, kind in kinds.items() if kind == POSITION
    ] or [""]
    for name in (
        "time_s",
        *(kind + joint for kind in (POSITION, *motors, *rates) for joint in joints),
    ):
        if name not in named:
            raise AssetError(
                path,
                name,
                f"the column is missing; the file has {', '.join(named) or 'none'}",
            )
        if not np.isfinite(named[name]).all():
            row = int(np.argwhere(~np.isfinite(named[name]))[0][0])
            raise AssetError(path, name, f"row {row + 1} is not a finite number")
    if len(motors) > 1:
        raise AssetError(
            path,
            TORQUE,
            f"a log states {COMMAND} of servos or {TORQUE} of motors, not both: remove one",
        )
    if not motors and (
        strange := [name for name, kind in kinds.items() if kind not in KINDS]
    ):
        free = f"without {COMMAND} of a servo or {TORQUE} of a motor, a joint swings freely"
        raise AssetError(path, strange[0], f"{free}: rename this column, or remove it")
    columns = {
        kind: np.hstack([named[kind + joint] for joint in joints])
        for kind in (POSITION, *motors, *rates)
    }
    names = named_joints or tuple(one.lstrip(".") for one in joints)
    if names != ("",) and len(names) != columns[POSITION].shape[1]:
        count = columns[POSITION].shape[1]
        raise AssetError(path, NAMES, f"{len(names)} names for {count} joints")
    return checked(
        path,
        Log(
            str(path),
            named["time_s"][:, 0],
            columns[POSITION],
            columns.get(COMMAND),
            columns.get(TORQUE),
            names if all(names) else (),
            columns.get(RATE),
        ),
    )


def checked(path: Path, log: Log) -> Log:
    """Return a log, or raise `AssetError` where numbers lack, are not finite, or times do not ascend."""
    if log.times_s.ndim != 1 or log.position_rad.ndim != 2:
        reason = f"expected a row of angles for each time; it has {log.position_rad.shape} for {log.times_s.shape}"
        raise AssetError(path, POSITION, reason)
    shape = len(log.times_s), log.position_rad.shape[1]
    for name, values in log.columns.items():
        if values.shape != shape:
            reason = f"{values.shape} numbers, where time_s and {POSITION} have {shape}"
            raise AssetError(path, name, reason)
        if not np.isfinite(values).all():
            row = int(np.argwhere(~np.isfinite(values))[0][0])
            raise AssetError(path, name, f"row {row + 1} is not a finite number")
    if len(log.times_s) < 20:
        reason = f"{len(log.times_s)} samples: 20 or more are needed"
        raise AssetError(path, "time_s", reason)
    steps_s = np.diff(log.times_s)
    late = np.flatnonzero(~(np.isfinite(steps_s) & (steps_s > 0.0)))
    if len(late):
        reason = f"row {late[0] + 2} is not later than the row before it"
        raise AssetError(path, "time_s", reason)
    return log


def npz_of_log(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an NPZ file, numbers and texts, within the limits of a file of a stranger.

    Raises:
        AssetError: The file is missing, too large or damaged, or holds other types.
    """
    try:
        content = read_regular(path, MOST_LOG_BYTES)
        names = npz_names(content)
        return npz_arrays(content, names, MOST_LOG_BYTES, kinds=NUMBERS + "U")
    except (OSError, ValueError) as error:
        raise AssetError(path, "log", f"cannot be read as NPZ: {error}") from None


def _npz(path: Path) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    """Return the columns by name, shape [N, J] each, and the names of the joints."""
    arrays = npz_of_log(path)
    names = tuple(map(str, arrays.pop(NAMES, ())))
    columns = {
        _as_of_hinge(name): np.asarray(values, dtype=np.float64).reshape(
            len(values), -1
        )
        for name, values in arrays.items()
    }
    return columns, names


def _csv(path: Path) -> dict[str, FloatArray]:
    """Return the columns by name, shape [N, 1] each, and [0, 1] for those that no log has."""
    content = read_regular(path, MOST_LOG_BYTES)
    header, _, rows = csv_text(content).read().partition("\n")
    titles = next(csv.reader([header]), [])
    names = [_as_of_hinge(name.strip()) for name in titles]
    columns = {name: np.empty((0, 1)) for name in names}
    places = [place for place, name in enumerate(names) if _kind(name) in KINDS]
    if rows.strip() and places:
        table = np.loadtxt(io.StringIO(rows), delimiter=",", usecols=places, ndmin=2)
        for place, values in zip(places, table.T, strict=True):
            columns[names[place]] = values[:, np.newaxis]
    return columns


def _as_of_hinge(name: str) -> str:
    """Return the name that the column of a slider would have if it were one of a hinge."""
    kind = _kind(name)
    return SLIDING.get(kind, kind) + name.removeprefix(kind)


def _kind(name: str) -> str:
    """Return what a column holds, without the name of its joint."""
    return name.split(".")[0]
