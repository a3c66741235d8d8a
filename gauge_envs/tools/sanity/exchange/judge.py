"""Judge the motion that another simulator wrote for the scenes of an exported folder.

Example:
    >>> from pathlib import Path
    >>> from gauge_envs.tools.sanity import judge
    >>> report = judge(Path("my_engine"))  # doctest: +SKIP
"""

import csv
import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.errors import TargetError, TrajectoryFileError
from gauge_envs.files import MEGABYTE, csv_text, json_document, os_errors, read_regular, versions
from gauge_envs.runs.rollout import DivergedError, Rollout
from gauge_envs.scene import Box, Motion, Pose, RigidBody, Sphere
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.sanity.exchange import scenes as exported
from gauge_envs.tools.sanity.exchange.scenes import COLUMNS, MANIFEST, MOTION, ExportedScene
from gauge_envs.tools.sanity.measure import Measured, curve_of, judged, result_of
from gauge_envs.tools.sanity.model import PhenomenonResult, Report, TrainingConfiguration, Verdict
from gauge_envs.tools.sanity.phenomena import GRAVITY_ID, selection
from gauge_envs.tools.sanity.phenomena.base import Phenomenon
from gauge_envs.tools.sanity.phenomena.impact import CLEAR_MM
from gauge_envs.tools.sanity.stacks.dialect import TOML
from gauge_envs.tools.sanity.stated import gravity_row

UNKNOWN_ENGINE = "recorded motion"
"""Name of an engine that the user does not state."""

FREE_FALL = "drop"
"""Scene whose balls fall freely, from which gravity is measured."""

SAME_NUMBER = 1e-9
"""Relative difference up to which numbers of a manifest are those of this version."""

DRIVER_MM, DRIVER_DEG = 1.0, 1.0
"""Distance and angle of a driven body from its driver that are reported."""


def judge(folder: Path, *, only: Sequence[str] = (), engine: str = "") -> Report:
    """Return what physics a simulator gets wrong, from the motion that it wrote for exported scenes.

    Gravity is measured in the free fall of the balls of the scene `drop`. A scene without a motion file is declined.

    Args:
        folder: Folder that `gauge_envs.tools.sanity.export` wrote.
        only: Ids of phenomena or patterns such as `creep-*`; all that were exported when empty.
        engine: Name of the simulator for the report.

    Returns:
        The report, with a row for each phenomenon in a fixed order, and neither causes nor values of a preset.
    """
    started = time.perf_counter()
    chosen = selection(only)
    outcomes = {
        scene: _read(folder, scene)
        for scene in _exported(folder)
        if any(one.id in chosen for one in scene.phenomena) or (GRAVITY_ID in chosen and scene.name == FREE_FALL)
    }
    configuration = _configuration(folder, engine, outcomes)
    rows = [_row(one, outcomes[scene]) for scene in outcomes for one in scene.phenomena if one.id in chosen]
    rows.sort(key=lambda row: chosen.index(row.phenomenon))
    if GRAVITY_ID in chosen:
        rows = [_gravity_row(configuration, outcomes), *rows]
    return Report(
        configuration=configuration, rows=tuple(rows), versions=versions(), wall_s=time.perf_counter() - started
    )


def _exported(folder: Path) -> tuple[ExportedScene, ...]:
    """Return the scenes of a folder, which must be those of this version of the package."""
    path = folder / MANIFEST
    with os_errors(lambda cause: TargetError(f"{path}: cannot be read: {cause}: export with gauge sanity export")):
        raw = read_regular(path, exported.MOST_MANIFEST_BYTES)
    try:
        content = json_document(raw)
    except ValueError as error:
        raise TargetError(f"{path}: {error}: export again with gauge sanity export") from None
    if not isinstance(content, dict) or content.get("format") != exported.FORMAT:
        raise TargetError(f"{path}: is no manifest of gauge sanity export")
    if content.get("version") != exported.VERSION:
        raise TargetError(f"{path}: has version {content.get('version')!r}, expected {exported.VERSION}: export again")
    listed = content.get("scenes")
    named = (one for one in (listed if isinstance(listed, list) else ()) if isinstance(one, dict))
    entries = {one["name"]: one for one in named if isinstance(one.get("name"), str)}
    known = {scene.name: scene for scene in exported.scenes()}
    if not entries or not set(entries) <= set(known):
        raise TargetError(f"{path}: lists no scenes, or unknown ones: export again")
    for name, entry in entries.items():
        place = _difference(known[name].entry(), entry)
        if place is not None:
            raise TargetError(
                f"{path}: scene {name!r}: {place} is not that of this version of gauge-envs: export again, and run the "
                "scenes again"
            )
    return tuple(scene for name, scene in known.items() if name in entries)


def _difference(expected: Any, found: Any, place: str = "") -> str | None:
    """Return the place of the first difference between two JSON documents beyond rounding; None without one."""
    if isinstance(expected, dict) and isinstance(found, dict) and expected.keys() == found.keys():
        parts = ((key, expected[key], found[key]) for key in expected)
    elif isinstance(expected, list) and isinstance(found, list) and len(expected) == len(found):
        parts = ((str(i), one, other) for i, (one, other) in enumerate(zip(expected, found, strict=True)))
    elif isinstance(expected, float) and isinstance(found, int | float) and abs(found) < 1e300:
        return None if math.isclose(expected, found, rel_tol=SAME_NUMBER, abs_tol=1e-12) else place
    else:
        return None if type(expected) is type(found) and expected == found else place
    for key, one, other in parts:
        different = _difference(one, other, f"{place}.{key}".lstrip("."))
        if different is not None:
            return different
    return None


_Outcome = Rollout | DivergedError | str
"""Motion of a scene, why it diverged, or why there is none."""

_Outcomes = Mapping[ExportedScene, _Outcome]


def _read(folder: Path, scene: ExportedScene) -> _Outcome:
    file = folder / scene.name / MOTION
    if not file.exists():
        return f"{scene.name}/{MOTION} is missing"
    try:
        return read_motion(file, scene)
    except DivergedError as error:
        return error


def _configuration(folder: Path, engine: str, outcomes: _Outcomes) -> TrainingConfiguration:
    rollouts = {scene: one for scene, one in outcomes.items() if isinstance(one, Rollout)}
    missing = [scene.name for scene, one in outcomes.items() if isinstance(one, str)]
    notes = []
    if missing:
        notes.append(f"{len(missing)} of {len(outcomes)} scenes have no {MOTION}: {', '.join(missing)}")
    slow = sum(one.interval_s > 1.01 * scene.scenario.interval_s for scene, one in rollouts.items())
    if slow:
        notes.append(f"samples of {slow} scenes are farther apart than asked for: write more if your step is shorter")
    for scene, rollout in rollouts.items():
        for body, (millimetres, degrees) in driver_misses(rollout).items():
            if millimetres > DRIVER_MM or degrees > DRIVER_DEG:
                off = f"{millimetres:.3g} mm and {degrees:.3g} deg"
                notes.append(f"{scene.name}: driven body {body!r} is up to {off} off its driver")
    notes.append("nothing was simulated here: there is no preset to compare with, and no change was tried")
    intervals = sorted({float(f"{one.interval_s:.6g}") for one in rollouts.values()})
    settings = {"sample_interval_s": intervals[0] if len(intervals) == 1 else intervals} if intervals else {}
    return TrainingConfiguration(
        name=engine or folder.resolve().name,
        source=f"motion files in {folder}",
        backend=engine or UNKNOWN_ENGINE,
        settings=settings,
        origins=dict.fromkeys(settings, MOTION),
        notes=tuple(notes),
        gravity_m_per_s2=next((_gravity(one) for scene, one in rollouts.items() if scene.name == FREE_FALL), None),
    )


# --- rows ------------------------------------------------------------------------------------------------------------


def _row(phenomenon: Phenomenon, outcome: _Outcome) -> PhenomenonResult:
    measured = _measured(phenomenon, outcome)
    return result_of(phenomenon, measured, None, curve=curve_of(phenomenon, measured, None))


def _measured(phenomenon: Phenomenon, outcome: _Outcome) -> Measured:
    if isinstance(outcome, DivergedError):
        return Measured(verdict=Verdict.WRONG, remark=f"diverged: {outcome}")
    if isinstance(outcome, str):
        return Measured(verdict=Verdict.DECLINED, remark=outcome)
    measured = judged(phenomenon, outcome)
    if measured.verdict.is_off and measured.value is not None:
        text = _friction_text(phenomenon, measured.value)
        return replace(measured, remark="; ".join(part for part in (measured.remark, text) if part))
    return measured


def _friction_text(phenomenon: Phenomenon, value: float) -> str:
    """Return the coefficient of friction with which a cube slides at an acceleration; empty for other phenomena."""
    scene = phenomenon.scenario.scene
    if not phenomenon.id.startswith("slide-") or not isinstance(scene.body("board").shape, Box):
        return ""
    downhill = scene.body("board").pose.rotation.apply([1.0, 0.0, 0.0])
    friction = (-float(downhill[2]) - value / scene.gravity_m_per_s2) / float(np.hypot(*downhill[:2]))
    stated = next(contact.friction for contact in scene.contacts if "board" in contact.second)
    return f"as with a friction of {friction:.3f}, stated is {stated:.3f}"


def _gravity_row(configuration: TrainingConfiguration, outcomes: _Outcomes) -> PhenomenonResult:
    row = gravity_row(configuration, TOML)
    if row.configured is not None:
        return replace(row, default=None, default_verdict=Verdict.DECLINED)
    reason = next((str(one) for scene, one in outcomes.items() if scene.name == FREE_FALL), "was not exported")
    return replace(row, remark=f"measured in the fall of the balls of the scene {FREE_FALL!r}: {reason}")


def _gravity(rollout: Rollout) -> tuple[float, float, float] | None:
    """Return the mean acceleration of the balls before they reach the ground [m/s^2], shape [3]."""
    ground = rollout.scene.body("ground").pose.position_m[2]
    fits = []
    for ball in rollout.scene.dynamic_bodies:
        assert isinstance(ball.shape, Sphere)
        place = rollout.position(ball.name)
        low = place[:, 2] - ground - ball.shape.radius_m < 1e-3 * CLEAR_MM
        flight = slice(0, int(low.argmax()) if low.any() else len(low))
        if flight.stop >= 4:
            # The first sample is left out: the first step of some integrators is half a step of gravity off.
            fits.append(2.0 * np.polyfit(rollout.times_s[1 : flight.stop], place[1 : flight.stop], 2)[0])
    if not fits:
        return None
    return vector(np.mean(fits, axis=0))


# --- motion files ----------------------------------------------------------------------------------------------------

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
        with os_errors(lambda cause: self.error(f"cannot be read: {cause}")):
            content = read_regular(self.file, MOST_BYTES)
        try:
            rows = list(csv.reader(csv_text(content)))
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
        """Raise an error for numbers that are no motion, shape [body_count, sample_count, width]."""
        bad = ~(np.abs(numbers) <= LARGEST)
        if bad.any():
            body, row, column = (int(index) for index in np.argwhere(bad)[bad.nonzero()[1].argmin()])
            raise DivergedError(
                f"{self.file.parent.name}/{self.file.name}: {COLUMNS[2 + column]} of {self.scene.recorded[body]!r} is "
                f"{numbers[body, row, column]:g} at {times_s[row]:.3g} s"
            )
        for body, row in np.argwhere(np.linalg.norm(numbers[..., 3:7], axis=2) < UNIT_LENGTH):
            raise self.error(f"a quaternion of {self.scene.recorded[body]!r} has no length at {times_s[row]:.3g} s")

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
            turns = Rotation.from_quat(state[:, 3:7], scalar_first=True)
            state[:-1, 10:] = (turns[1:] * turns[:-1].inv()).as_rotvec() / interval_s
            state[-1, 10:] = state[-2, 10:]
        states[body.name] = state
    return Rollout(scene=scene.scenario.scene, times_s=interval_s * np.arange(count, dtype=np.float64), states=states)
