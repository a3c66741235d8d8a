"""Logs of joints: what was commanded and measured over time, from CSV and NPZ files."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from gauge_envs.errors import AssetError
from gauge_envs.scene.geometry import FloatArray

POSITION, COMMAND, TORQUE = "position_rad", "command_rad", "torque_n_m"


@dataclass(frozen=True, eq=False)
class Log:
    """What was measured at the joints of a machine, with N samples of J joints.

    Attributes:
        name: Name of the file, or of the file and the part.
        times_s: Times of the samples, ascending [s], shape [N].
        position_rad: Measured angles [rad], shape [N, J].
        command_rad: Commanded angles of position servos [rad], shape [N, J]; None without servos.
        torque_n_m: Torques of the motors [N m], shape [N, J]; None without torque motors.
    """

    name: str
    times_s: FloatArray
    position_rad: FloatArray
    command_rad: FloatArray | None = None
    torque_n_m: FloatArray | None = None

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.times_s[-1] - self.times_s[0])

    def pieces(self, length_s: float) -> Iterator[Log]:
        """Yield the log in parts of equal length, at most the given one [s]."""
        count = max(1, int(np.ceil(self.duration_s / length_s - 1e-9)))
        edges = np.searchsorted(self.times_s, np.linspace(self.times_s[0], self.times_s[-1], count + 1))
        edges[-1] = len(self.times_s)
        for number, (first, last) in enumerate(pairwise(edges.tolist())):
            name = self.name if count == 1 else f"{self.name}, part {number + 1}"
            command, torque = (None if one is None else one[first:last] for one in (self.command_rad, self.torque_n_m))
            yield Log(name, self.times_s[first:last], self.position_rad[first:last], command, torque)

    def start(self) -> tuple[FloatArray, FloatArray]:
        """Return angles [rad] and rates [rad/s] at the first sample, shape [J] each, of parabolas through 0.05 s."""
        count = max(4, int(np.searchsorted(self.times_s, self.times_s[0] + 0.05)))
        times_s = self.times_s[:count] - self.times_s[0]
        rate, angle = np.polyfit(times_s, self.position_rad[:count], 2)[1:]
        return angle, rate


def read_log(path: Path) -> Log:
    """Read a log.

    A CSV file has a header with `time_s`, `position_rad` and one of `command_rad` and `torque_n_m`, or none of both for
    a joint that swings freely. Several joints have columns with a name behind a dot each, as `position_rad.elbow`. An
    NPZ file has arrays of these names, shape [N] or [N, J].

    Raises:
        AssetError: The file cannot be read, a column is missing or unknown, numbers are not finite, or times do not
            ascend.
    """
    try:
        columns = _npz(path) if path.suffix == ".npz" else _csv(path)
    except (OSError, ValueError, KeyError) as error:
        raise AssetError(path, "log", f"cannot be read as CSV or NPZ: {error}") from None
    for name in ("time_s", POSITION):
        if name not in columns:
            raise AssetError(path, name, f"the column is missing; the file has {', '.join(columns) or 'none'}")
    if COMMAND in columns and TORQUE in columns:
        raise AssetError(path, TORQUE, f"a log states {COMMAND} of servos or {TORQUE} of motors, not both: remove one")
    times_s, shape = columns["time_s"][:, 0], columns[POSITION].shape
    for name, values in columns.items():
        if not np.isfinite(values).all():
            row = int(np.argwhere(~np.isfinite(values))[0][0])
            raise AssetError(path, name, f"row {row + 1} is not a finite number")
        if name != "time_s" and values.shape != shape:
            raise AssetError(path, name, f"{values.shape} numbers, where {POSITION} has {shape}")
    if len(times_s) < 20:
        raise AssetError(path, "time_s", f"{len(times_s)} samples: 20 or more are needed")
    late = np.flatnonzero(np.diff(times_s) <= 0.0)
    if len(late):
        raise AssetError(path, "time_s", f"row {late[0] + 2} is not later than the row before it")
    return Log(path.name, times_s, columns[POSITION], columns.get(COMMAND), columns.get(TORQUE))


KNOWN = ("time_s", POSITION, COMMAND, TORQUE)


def _npz(path: Path) -> dict[str, FloatArray]:
    with np.load(path, allow_pickle=False) as data:
        columns = {name: np.asarray(data[name], dtype=np.float64) for name in KNOWN if name in data}
    return {name: values.reshape(len(values), -1) for name, values in columns.items()}


def _csv(path: Path) -> dict[str, FloatArray]:
    with path.open(newline="", encoding="utf-8") as file:
        names = next(csv.reader(file), [])
    table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    kinds = [name.strip().split(".")[0] for name in names]
    return {
        kind: table[:, [column for column, one in enumerate(kinds) if one == kind]]
        for kind in dict.fromkeys(kinds)
        if kind in KNOWN
    }
