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

from gauge_envs.errors import AssetError, ParameterError
from gauge_envs.files import csv_text
from gauge_envs.scene.geometry import FloatArray

POSITION, COMMAND, TORQUE = "position_rad", "command_rad", "torque_n_m"
RATE = "rate_rad_per_s"
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
    rates are `rate_rad_per_s`. Other columns do not matter to a joint with a motor.

    Raises:
        AssetError: The file cannot be read, a column is missing, numbers are not finite, times do not ascend, or
            the log of a free swing has an unknown column.
    """
    try:
        named = _npz(path) if path.suffix == ".npz" else _csv(path)
    except (OSError, ValueError, KeyError) as error:
        raise AssetError(
            path, "log", f"cannot be read as CSV or NPZ: {error}"
        ) from None
    kinds = {name: name.split(".")[0] for name in named}
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
        strange := [
            name
            for name, kind in kinds.items()
            if kind not in ("time_s", POSITION, RATE)
        ]
    ):
        free = f"without {COMMAND} of a servo or {TORQUE} of a motor, a joint swings freely"
        raise AssetError(path, strange[0], f"{free}: rename this column, or remove it")
    columns = {
        kind: np.hstack([named[kind + joint] for joint in joints])
        for kind in (POSITION, *motors, *rates)
    }
    names = _npz_names(path) or tuple(one.lstrip(".") for one in joints)
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
    late = np.flatnonzero(np.diff(log.times_s) <= 0.0)
    if len(late):
        reason = f"row {late[0] + 2} is not later than the row before it"
        raise AssetError(path, "time_s", reason)
    return log


def _npz(path: Path) -> dict[str, FloatArray]:
    with np.load(path, allow_pickle=False) as data:
        return {
            name: np.asarray(data[name], dtype=np.float64).reshape(len(data[name]), -1)
            for name in data
            if name != NAMES
        }


def _npz_names(path: Path) -> tuple[str, ...]:
    """Return the names that an NPZ file has for its joints."""
    if path.suffix != ".npz":
        return ()
    with np.load(path, allow_pickle=False) as data:
        return tuple(map(str, data[NAMES])) if NAMES in data else ()


def _csv(path: Path) -> dict[str, FloatArray]:
    """Return the columns by name, NaN where there is no number."""
    header, _, rows = csv_text(path.read_bytes()).read().partition("\n")
    table = np.genfromtxt(io.StringIO(rows or "nan"), delimiter=",", ndmin=2)
    return {
        name.strip(): table[:, [place]]
        for place, name in enumerate(next(csv.reader([header]), []))
    }
