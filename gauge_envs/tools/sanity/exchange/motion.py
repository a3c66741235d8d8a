"""Read the motion of a scene that another simulator wrote, and check that it is the motion of that scene."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.errors import TrajectoryFileError
from gauge_envs.files import MEGABYTE, read_regular
from gauge_envs.runs.rollout import DivergedError, Rollout
from gauge_envs.scene import Motion, Pose, RigidBody
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.sanity.exchange.scenes import COLUMNS, ExportedScene
from gauge_envs.tools.sanity.phenomena.base import FloatArray

MOST_BYTES = 128 * MEGABYTE
"""Largest size of a motion file: the wall at a step of 0.1 ms has 60 MB."""

LARGEST = 1e9
"""Larger numbers are mistakes, and their squares overflow."""

REQUIRED = COLUMNS[:9]
"""Columns that every motion file has."""

LONGEST_INTERVAL_S = 1.0 / FRAME_RATE_HZ
"""Longest time between samples with which phenomena can be measured [s]."""

UNEVEN = 0.02
"""Largest deviation of a sample's time, in intervals, beside `ROUNDED_S`."""

ROUNDED_S = 1e-5
"""Error of times that are printed with few digits [s]."""

SAME_PLACE_M = 1e-4
"""Largest distance from the scene's start that single precision and printed digits explain [m]."""

SAME_ANGLE_RAD = 2e-3
"""Largest angle from the scene's start that they explain [rad]."""

UNIT_LENGTH = 0.01
"""Largest deviation of the length of a quaternion from 1."""

COMPARED_SAMPLES = 100
"""Number of samples at which driven bodies are compared with their drivers."""


def read_motion(file: Path, scene: ExportedScene) -> Rollout:
    """Return the motion of a scene from a CSV file, for the time that its phenomena need.

    Bodies that are not recorded stay where they start. Without velocities in the file, they are the displacements to
    the next sample over the time between.

    Args:
        file: The file, with the columns of `COLUMNS` in any order.
        scene: The scene.
    """
    motion = _Motion(file, scene)
    times, states = motion.table()
    interval_s = motion.interval_s(times)
    count = round(scene.scenario.seconds / interval_s) + 1
    numbers = np.stack([states[name] for name in scene.recorded])
    motion.check_finite(times, numbers)
    for index, name in enumerate(scene.recorded):
        motion.check_start(scene.scenario.scene.body(name), numbers[index, 0])
    rollout = _rollout(scene, interval_s, numbers[:, :count])
    _check_speed(rollout)
    return rollout


def driver_misses(rollout: Rollout) -> dict[str, tuple[float, float]]:
    """Return how far driven bodies are from their drivers, by name, as distance [mm] and angle [degrees]."""
    misses = {}
    scene, shown = rollout.scene, slice(None, None, max(1, len(rollout.times_s) // COMPARED_SAMPLES))
    for driver in scene.drivers:
        start = scene.body(driver.body).pose
        poses = [driver.pose(start, time_s) for time_s in rollout.times_s[shown].tolist()]
        apart = np.linalg.norm(rollout.position(driver.body)[shown] - [pose.position_m for pose in poses], axis=1)
        planned = Rotation.from_quat([pose.quaternion for pose in poses], scalar_first=True)
        angles = (rollout.rotation(driver.body)[shown] * planned.inv()).magnitude()
        misses[driver.body] = (1e3 * float(apart.max()), math.degrees(float(angles.max())))
    return misses


@dataclass(frozen=True)
class _Motion:
    """A motion file and the scene that it must show."""

    file: Path
    scene: ExportedScene

    def error(self, text: str) -> TrajectoryFileError:
        """Return an error about the file."""
        return TrajectoryFileError(f"{self.file}: {text}")

    def table(self) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return the times [s], shape [sample_count], and other columns by body, shape [sample_count, 7 or 10]."""
        header, *rows = self._rows()
        order = self._columns(header)
        samples: dict[str, list[list[float]]] = {name: [] for name in self.scene.recorded}
        for line, fields in enumerate(rows, start=2):
            if not fields:
                continue
            if len(fields) != len(header):
                raise self.error(f"line {line}: {len(fields)} columns, the header has {len(header)}")
            name = fields[order[1]].strip()
            if name not in samples:
                names = ", ".join(sorted(samples)[:8]) + (", ..." if len(samples) > 8 else "")
                raise self.error(f"line {line}: {name!r} is no recorded body of this scene: it has {names}")
            columns = [order[0], *order[2:]]
            samples[name].append([self._number(line, header[i], fields[i]) for i in columns])
        first = self.scene.recorded[0]
        for name, values in samples.items():
            if len(values) != len(samples[first]) or not values:
                raise self.error(
                    f"body {name!r} has {len(values)} rows and {first!r} has {len(samples[first])}: write one row for "
                    "each recorded body at each sample"
                )
        arrays = {name: np.array(values, dtype=np.float64) for name, values in samples.items()}
        times = arrays[first][:, 0]
        for name, array in arrays.items():
            if not np.array_equal(array[:, 0], times, equal_nan=True):
                row = int((array[:, 0] != times).argmax())
                raise self.error(
                    f"sample {row} of {name!r} is at {array[row, 0]:g} s, that of {first!r} at {times[row]:g} s: write "
                    "all bodies at the same times"
                )
        return times, {name: array[:, 1:] for name, array in arrays.items()}

    def _rows(self) -> list[list[str]]:
        try:
            text = read_regular(self.file, MOST_BYTES).decode("utf-8-sig")
            rows = list(csv.reader(io.StringIO(text, newline="")))
        except OSError as error:
            raise self.error(f"cannot be read: {error.strerror or error}") from None
        except (UnicodeDecodeError, csv.Error) as error:
            raise self.error(f"is no CSV file in UTF-8: {error}") from None
        if len(rows) < 2:
            raise self.error("has no rows; it needs a header, and a row for each body and sample")
        return rows

    def _columns(self, header: Sequence[str]) -> list[int]:
        """Return the place of each column of `COLUMNS` in a header, without the velocities if it has none."""
        names = [name.strip() for name in header]
        wanted = COLUMNS if any(name in names for name in COLUMNS[9:]) else REQUIRED
        faults = [f"column {name!r} appears twice" for name in names if names.count(name) > 1]
        faults += [f"unknown column {name[:40]!r}" for name in names if name not in COLUMNS]
        faults += [f"no column {name!r}" for name in wanted if name not in names]
        if faults:
            expected = f"expected the header {','.join(REQUIRED)}, and {','.join(COLUMNS[9:])} if you have them"
            raise self.error(f"line 1: {faults[0]}; {expected}")
        return [names.index(name) for name in wanted]

    def _number(self, line: int, column: str, text: str) -> float:
        try:
            return float(text)
        except ValueError:
            shown = text if len(text) <= 40 else f"{text[:37]}..."
            raise self.error(f"line {line}: {column.strip()} is {shown!r}, expected a number") from None

    def interval_s(self, times_s: FloatArray) -> float:
        """Return the interval of evenly spaced times that cover the scene [s]."""
        seconds, longest_s = self.scene.scenario.seconds, self.scene.scenario.interval_s
        rate = f"write a sample at least every {longest_s:.3g} s, or every step if it is longer"
        if not np.isfinite(times_s).all():
            row = int((~np.isfinite(times_s)).argmax())
            raise self.error(f"sample {row}: time_s is {times_s[row]}, expected a finite number")
        if abs(times_s[0]) > ROUNDED_S:
            raise self.error(
                f"the first sample is at {times_s[0]:g} s, expected 0: write the start before the first step"
            )
        if len(times_s) < 3:
            raise self.error(f"{len(times_s)} samples; {seconds:g} s are needed, {rate}")
        interval_s = float(times_s[-1] / (len(times_s) - 1))
        if interval_s <= 0.0:
            raise self.error(f"the times do not increase: the last one is {times_s[-1]:g} s")
        even = interval_s * np.arange(len(times_s))
        uneven = np.abs(times_s - even) > UNEVEN * interval_s + ROUNDED_S
        if uneven.any():
            row = int(uneven.argmax())
            raise self.error(
                f"sample {row} is at {times_s[row]:g} s, evenly spaced samples have {even[row]:g} s there: write a "
                "sample every step, or every so many steps"
            )
        if interval_s > LONGEST_INTERVAL_S + ROUNDED_S:
            raise self.error(f"one sample in {interval_s:.3g} s is too few; {rate}")
        if times_s[-1] < seconds - 0.5 * interval_s - ROUNDED_S:
            raise self.error(f"the samples end at {times_s[-1]:g} s; {seconds:g} s are needed")
        return interval_s

    def check_finite(self, times_s: FloatArray, numbers: FloatArray) -> None:
        """Raise an error for numbers that are not finite or huge, shape [body_count, sample_count, width]."""
        bad = ~(np.abs(numbers) <= LARGEST)
        if bad.any():
            body, row, column = (int(index) for index in np.argwhere(bad)[bad.nonzero()[1].argmin()])
            raise DivergedError(
                f"{self.file.parent.name}/{self.file.name}: {COLUMNS[2 + column]} of {self.scene.recorded[body]!r} is "
                f"{numbers[body, row, column]:g} at {times_s[row]:.3g} s"
            )

    def check_start(self, body: RigidBody, numbers: FloatArray) -> None:
        """Raise an error if a body does not start as in the scene; numbers have the shape [7 or 10]."""
        place, quaternion = numbers[:3], numbers[3:7]
        length = float(np.linalg.norm(quaternion))
        if abs(length - 1.0) > UNIT_LENGTH:
            raise self.error(f"the first quaternion of {body.name!r} has the length {length:.3g}, not 1")
        if np.linalg.norm(place - np.asarray(body.pose.position_m)) > SAME_PLACE_M:
            raise self.error(
                f"{body.name!r} starts at {_text(place)} m, in the scene at {_text(body.pose.position_m)} m: write the "
                "start before the first step, in metres, of the body's origin and not of its centre of mass"
            )
        if _angle_rad(body.pose, quaternion) > SAME_ANGLE_RAD:
            order, hint = "another order or frame", "check its frame and its order"
            if _angle_rad(body.pose, np.roll(quaternion, 1)) <= SAME_ANGLE_RAD:
                order, hint = "x, y, z, w", "write w first"
            raise self.error(
                f"{body.name!r} starts with the quaternion {_text(quaternion)}, in the scene with "
                f"{_text(body.pose.quaternion)} (w, x, y, z): the file seems to have {order}; {hint}"
            )


def _angle_rad(pose: Pose, quaternion: NDArray[np.float64]) -> float:
    other = Rotation.from_quat(quaternion, scalar_first=True)
    return float((other * pose.rotation.inv()).magnitude())


def _text(numbers: Iterable[float]) -> str:
    return f"({', '.join(f'{number:.4g}' for number in numbers)})"


def _check_speed(rollout: Rollout) -> None:
    """Raise an error if a dynamic body is faster along an axis than the scene allows."""
    limit = rollout.scene.speed_limit_m_per_s
    for body in rollout.scene.dynamic_bodies:
        between = np.abs(np.diff(rollout.position(body.name), axis=0)).max(axis=1) / rollout.interval_s
        reported = np.abs(rollout.velocity(body.name)[1:]).max(axis=1)
        speeds = np.maximum(between, reported)
        if speeds.max() > limit:
            row = int((speeds > limit).argmax())
            raise DivergedError(
                f"after {rollout.times_s[row + 1]:.3g} s {body.name!r} moves at {speeds[row]:.3g} m/s; the scene "
                f"allows {limit:.3g} m/s at most"
            )


def _rollout(scene: ExportedScene, interval_s: float, numbers: FloatArray) -> Rollout:
    """Return a rollout from numbers of the recorded bodies, shape [body_count, sample_count, 7 or 10]."""
    count = numbers.shape[1]
    states = {}
    for body in scene.scenario.scene.bodies:
        state = np.zeros((count, 13))
        if body.motion is Motion.FIXED:
            state[:, :3], state[:, 3:7] = body.pose.position_m, body.pose.quaternion
        else:
            own = numbers[scene.recorded.index(body.name)]
            state[:, : own.shape[1]] = own
            state[:, 3:7] /= np.linalg.norm(own[:, 3:7], axis=1, keepdims=True)
            if own.shape[1] == 7:
                state[:-1, 7:10] = np.diff(own[:, :3], axis=0) / interval_s
                state[-1, 7:10] = state[-2, 7:10]
            state[:, 10:] = _turn_rates(state[:, 3:7], interval_s)
        states[body.name] = state
    return Rollout(scene=scene.scenario.scene, times_s=interval_s * np.arange(count, dtype=np.float64), states=states)


def _turn_rates(quaternions: FloatArray, interval_s: float) -> FloatArray:
    """Return angular velocities from each sample to the next [rad/s], shape [sample_count, 3]; the last one again."""
    turns = Rotation.from_quat(quaternions, scalar_first=True)
    rates = (turns[1:] * turns[:-1].inv()).as_rotvec() / interval_s
    return np.concatenate([rates, rates[-1:]])
