"""Logs of a robot: reading CSV, NPZ and Parquet, and naming what is wrong in them before anything is fitted."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from pydantic import BaseModel
from scipy.integrate import cumulative_simpson
from scipy.ndimage import uniform_filter1d
from scipy.optimize import linear_sum_assignment
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from gauge_envs.errors import FileError
from gauge_envs.names import first_names
from gauge_envs.optional import needs_extra
from gauge_envs.reading import reading
from gauge_envs.text import csv_text, toml_document

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
Table: TypeAlias = dict[str, FloatArray]
"""Columns of a quantity by joint."""

COLUMN_NAMES = {
    "command_time": ("command_t", "command_time"),
    "time": ("t", "time_s", "timestamp", "time"),
    "target": ("target", "command_rad", "command", "q_des"),
    "position": (
        "qpos",
        "q",
        "position_rad",
        "position",
        "pos",
        "joint_pos",
        "observation.state",
    ),
    "velocity": (
        "dq",
        "qd",
        "qvel",
        "vel",
        "velocity_rad_per_s",
        "velocity",
        "joint_vel",
    ),
    "action": ("action", "actions"),
    "ctrl": ("ctrl",),
    "tau": ("tau", "torque", "effort"),
    "policy_observation": ("obs", "policy_obs"),
    "base_position": ("base_pos", "base_position"),
    "base_quaternion": ("base_quat", "base_quaternion"),
    "base_linear_velocity": ("base_linvel", "base_linear_velocity"),
    "base_angular_velocity": ("base_angvel", "base_angular_velocity"),
}
"""Names of each quantity in a file; a column of one joint adds a separator and the joint, as `q_hip`."""

QUANTITIES = {
    name: quantity for quantity, names in COLUMN_NAMES.items() for name in names
}
"""Quantity by name."""

LONGEST_FIRST = sorted(QUANTITIES, key=len, reverse=True)
COLUMN = re.compile(
    rf"({'|'.join(map(re.escape, LONGEST_FIRST))})(?:[._/:\[](.*?)\]?)?"
)
"""Title of a column: `q_des` is a name, and not the joint `des` of `q`."""

ANGLES = ("position", "target", "ctrl")
"""Quantities that contain the offset of a joint; with the velocities they have the unit of the map."""

SAMPLED = (
    "time_s",
    "position",
    "velocity",
    "base_pose",
    "base_twist",
    "observation",
)
"""Attributes of a log with a row a sample."""

COMMANDS = ("action", "ctrl", "target", "tau")
"""Kinds of command, the one that is used first where a log has several."""

MIN_SAMPLES = 20
MAX_INTERVAL_S = 1.0
MIN_NOISE = 2e-4
MIN_RATE_NOISE = 2e-3
"""Noise below which a difference has no meaning for a policy; a log of a simulator has none of its own."""

NOISE_WINDOW = 7
MIN_JUMP = 0.02
"""Second difference of positions at a lost sample [rad or m]."""
TURN_S = 0.2
"""Time over which the motion of the base is compared with its velocities."""
MAX_MISFIT = 0.3
"""Squared difference of the motion and the integrated velocities, over the squared motion."""
SURE = 4.0
"""Relative difference of two mean squared errors that is significant in a log of length TURN_S; it decreases with the
length."""
LOST_STEP = 1.5
"""Step after repeated rows, over an ordinary one, from which on they were lost; an encoder of low resolution has 1."""
MAX_RATE_RATIO = 1.5
"""Ratio of velocities and slopes from which on the unit or clock is wrong; motion too fast for the log has less."""
UPRIGHT = {
    up: Rotation.from_euler(axis, angle, degrees=True)
    for up, axis, angle in (
        ("z", "x", 0),
        ("y", "x", 90),
        ("x", "y", -90),
        ("-z", "x", 180),
    )
}
"""Rotation that turns each axis that may be up to z."""
MIN_REGULAR = 0.7
"""Fraction of equal runs of samples from which on the encoder is slower than the log."""


class JointMap(BaseModel, extra="forbid"):
    """What a joint of the model is called in the log, and how its angle reads there: `sign * scale * log + offset`."""

    log: str = ""
    sign: Literal[1, -1] = 1
    scale: float = 1.0
    offset_rad: float = 0.0


class ControlMap(BaseModel, extra="forbid"):
    """The controller outside of the model: a PD law in the robot's drives, and the scale of actions."""

    kp: float | dict[str, float] | None = None
    kd: float | dict[str, float] = 0.0
    action_scale: float | dict[str, float] = 1.0
    default_rad: float | dict[str, float] | None = None
    delay_s: float = 0.0

    def of(self, joint: str) -> dict[str, Any]:
        """Return the values for a joint by field; the default of a field whose table lacks the joint."""
        values: dict[str, Any] = {}
        for name, value in self:
            if isinstance(value, dict):
                value = value.get(joint, getattr(ControlMap(), name))
            values[name] = value
        return values


class LogMap(BaseModel, extra="forbid"):
    """A map file: names, order, signs and units of a log that differ from the model."""

    unit: Literal["rad", "deg"] = "rad"
    command: Literal["action", "ctrl", "target", "tau"] | None = None
    quaternion: Literal["wxyz", "xyzw"] | None = None
    up: Literal["z", "y", "x", "-z"] = "z"
    up_of: Literal["pose", "position"] = "pose"
    observation: list[str] = []
    observation_scale: dict[str, float] = {}
    order: list[str] = []
    joints: dict[str, JointMap] = {}
    control: ControlMap = ControlMap()

    def joint(self, name: str) -> JointMap:
        """Return the entry of a joint; the default without one."""
        return self.joints.get(name, JointMap())

    def check_joints(self, known: Mapping[str, Any]) -> None:
        """Raise an error for a joint of the map that a log lacks."""
        tables = [self.joints, *dict(self.control).values()]
        for table in tables:
            names = [*table] if isinstance(table, dict) else []
            for name in names:
                if name in known:
                    continue
                reason = f"the log has no such joint; it has {first_names([*known])}"
                raise FileError("--map", name, reason)


def with_joints(mapped: LogMap, changes: Mapping[str, dict[str, Any]]) -> LogMap:
    """Return a map with other fields of joints."""
    joints = dict(mapped.joints)
    for name, change in changes.items():
        joints[name] = mapped.joint(name).model_copy(update=change)
    return mapped.model_copy(update={"joints": joints})


@dataclass
class Log:
    """What a robot or a simulator did.

    Attributes:
        name: Name of the file.
        joints: Names of the joints.
        time_s: Times of the samples, shape [N].
        position: Angles [rad] or lengths [m], shape [N, J].
        velocity: Rates, shape [N, J]; differences of the positions where the log has none.
        position_noise, velocity_noise: Standard deviation of the noise of each joint, shape [J].
        command: Commands, shape [M, C]; no column for a passive mechanism.
        command_kind: Quantity of the commands; empty without any.
        command_names: Names of the joints or actuators of the commands.
        command_time_s: From when on each command holds, shape [M].
        base_pose: Position [m] and quaternion w x y z of the base, shape [N, 7]; no column without a base.
        base_twist: Its linear velocity in the world and angular velocity in the body frame, shape [N, 6].
        observation: What the policy saw, shape [N, K]; no column without.
        quaternion: Order of the numbers of a quaternion in the file, as the map gives it.
        up, up_of: Axis that is up in the file, and whether that of the pose or of the position alone.
        findings: What is not known of the log.
        mistakes: What is wrong in the log, and what was done about it.
    """

    name: str
    joints: tuple[str, ...]
    time_s: FloatArray
    position: FloatArray
    velocity: FloatArray
    command: FloatArray
    command_kind: str
    command_names: tuple[str, ...]
    command_time_s: FloatArray
    base_pose: FloatArray
    base_twist: FloatArray
    observation: FloatArray
    quaternion: str | None
    up: str
    up_of: str
    position_noise: FloatArray = field(init=False)
    velocity_noise: FloatArray = field(init=False)
    findings: list[str] = field(default_factory=list)
    mistakes: list[str] = field(default_factory=list)

    @property
    def interval_s(self) -> float:
        """Median interval between samples."""
        return float(np.median(np.diff(self.time_s)))

    @property
    def command_interval_s(self) -> float:
        """Median interval between changes of the command."""
        is_new = np.diff(self.command, axis=0).any(axis=1)
        times_s = self.command_time_s[1:][is_new]
        if len(times_s) < 3:
            return self.interval_s
        return float(np.median(np.diff(times_s)))

    def keep(self, samples: NDArray[Any]) -> None:
        """Leave out all but some samples; the commands stay."""
        for name in SAMPLED:
            setattr(self, name, getattr(self, name)[samples])


def read_map(file: Path | None) -> LogMap:
    """Return the content of a map file; the default without one.

    Raises:
        FileError: The file is missing or wrong.
    """
    if file is None:
        return LogMap()
    with reading(file, FileError) as content:
        return LogMap.model_validate(toml_document(content))


def read_log(
    file: Path, names: Sequence[str] = (), mapped: LogMap | None = None
) -> Log:
    """Return a log, checked, with its flaws named.

    Args:
        file: CSV, NPZ or Parquet.
        names: Joints of the model, which name the columns of a file without names.
        mapped: Names, signs and units that differ.

    Raises:
        FileError: The file has no time or no positions, its columns do not fit each other, or the map does not fit it.
    """
    mapped = mapped or LogMap()
    columns = _read_columns(file)
    by_title = dict(columns)
    order = mapped.order or [str(name) for name in by_title.get("joints", ())]
    found = _by_joint(file, columns, order or names, mapped)
    command_kind = _use_commands(found, mapped)
    for quantity in ("time", "position", command_kind):
        if quantity and not found[quantity]:
            expected = " ".join(COLUMN_NAMES[quantity])
            titles = first_names([*by_title])
            reason = f"no column {quantity} ({expected}); the file has {titles}"
            raise FileError(file, None, reason)
    mapped.check_joints(found["position"] | found[command_kind])
    rates, joints = found["velocity"], tuple(found["position"])
    found["velocity"] = {name: rates[name] for name in joints if name in rates}
    time_s = next(iter(found["time"].values()))
    command_time_s = next(iter(found["command_time"].values()), time_s)

    def sampled(*quantities: str) -> FloatArray:
        return _matrix(file, found, quantities, len(time_s))

    log = Log(
        name=file.name,
        joints=joints,
        time_s=time_s,
        position=sampled("position"),
        velocity=sampled("velocity"),
        command=_matrix(file, found, [command_kind], len(command_time_s)),
        command_kind=command_kind,
        command_names=tuple(found[command_kind]),
        command_time_s=command_time_s,
        base_pose=sampled("base_position", "base_quaternion"),
        base_twist=sampled("base_linear_velocity", "base_angular_velocity"),
        observation=sampled("policy_observation"),
        quaternion=mapped.quaternion,
        up=mapped.up,
        up_of=mapped.up_of,
    )
    if not order and any(QUANTITIES.get(title) == "position" for title in by_title):
        log.findings.append("columns without names are taken in the order of the model")
    for check in CHECKS:
        log.mistakes += check(log)
    log.findings += _unknown(log)
    return log


def _use_commands(found: dict[str, Table], mapped: LogMap) -> str:
    """Return the kind of the commands, whose columns are `found` by it; empty without commands.

    The map may say that actions are commands of another kind.
    """
    kinds = [kind for kind in COMMANDS if found[kind]]
    command_kind: str = mapped.command or next(iter(kinds), "")
    if not found.get(command_kind):
        found[command_kind] = found["action"]
    return command_kind


def _matrix(
    file: Path, found: Mapping[str, Table], quantities: Sequence[str], count: int
) -> FloatArray:
    """Return the columns of quantities, shape [count, columns]."""
    columns: list[FloatArray] = []
    for quantity in quantities:
        columns += found[quantity].values()
    for column in columns:
        if len(column) != count:
            reason = f"{len(column)} rows, but {count} times"
            raise FileError(file, quantities[0], reason)
    return np.reshape(columns, (len(columns), count)).T


def _read_columns(file: Path) -> list[tuple[str, Any]]:
    """Return the titles and values of the columns of a file."""
    with reading(file, FileError, "a CSV, NPZ or Parquet file") as content:
        if file.suffix == ".npz":
            with np.load(io.BytesIO(content)) as archive:
                return list(archive.items())
        if file.suffix == ".parquet":
            with needs_extra("reading Parquet", "data"):
                from pyarrow import parquet
            table = parquet.read_table(io.BytesIO(content))
            return list(table.to_pydict().items())
        rows = csv.reader(csv_text(content))
        return [
            (title.strip("# "), [cell.strip() or "nan" for cell in cells])
            for title, *cells in zip_longest(*rows, fillvalue="")
        ]


def _by_joint(
    file: Path,
    columns: Sequence[tuple[str, Any]],
    names: Sequence[str],
    mapped: LogMap,
) -> dict[str, Table]:
    """Return the columns of each quantity by joint; `names` are the joints of an array that has all of them."""
    found: dict[str, Table] = {quantity: {} for quantity in COLUMN_NAMES}
    model_names = {entry.log: name for name, entry in mapped.joints.items()}
    for title, cells in columns:
        match = COLUMN.fullmatch(title)
        if not match:
            continue
        quantity, joint = QUANTITIES[match[1]], match[2]
        try:
            values = np.atleast_2d(np.array(cells, dtype=float).T)
        except (TypeError, ValueError) as error:
            raise FileError(file, title, f"expected numbers: {error}") from error
        # The map says what an action is.
        kind: str = quantity
        if quantity == "action" and mapped.command:
            kind = mapped.command
        if mapped.unit == "deg" and kind in (*ANGLES, "velocity"):
            values = np.deg2rad(values)
        is_named = len(names) == len(values) and quantity in (*COMMANDS, *SAMPLED)
        for index, column in enumerate(values):
            name = joint or (names[index] if is_named else str(index))
            name = model_names.get(name, name)
            if name in found[quantity]:
                reason = f"a second column of {name}; rename one"
                raise FileError(file, title, reason)
            entry = mapped.joint(name)
            offset = entry.offset_rad if kind in ANGLES else 0.0
            # A force has the sign alone.
            scale = entry.scale if kind in (*ANGLES, "velocity") else 1.0
            if is_named or joint:
                scale *= entry.sign
            found[quantity][name] = scale * column + offset
    return found


# --- checks: each adds its findings to the log -----------------------------------------------------------------------


def _check_numbers(log: Log) -> Iterator[str]:
    """Leave out rows without numbers; raise an error if few are left, or if the times are no clock in seconds."""
    # A lost sample may have a quaternion of zeros.
    log.base_pose[~log.base_pose[:, 3:].any(axis=1), 3:] = np.nan
    is_given = np.isfinite(np.column_stack([log.command_time_s, log.command])).all(
        axis=1
    )
    log.command_time_s = log.command_time_s[is_given]
    log.command = log.command[is_given]
    for name in SAMPLED:
        values = np.column_stack([getattr(log, name)])
        is_whole = np.isfinite(values).all(axis=1)
        log.keep(is_whole)
        if not is_whole.all():
            yield f"rows without a number of {name} are left out: {sum(~is_whole)}"
        if len(log.time_s) < MIN_SAMPLES:
            reason = f"{sum(is_whole)} rows with numbers; a log needs {MIN_SAMPLES}"
            raise FileError(log.name, name, reason)
    steps = np.diff(log.time_s)
    if steps.min() <= 0.0 or log.interval_s >= MAX_INTERVAL_S:
        place = f"time {log.time_s[np.argmin(steps)]:g}"
        reason = (
            f"the next time is {steps.min():g} s later; sort the rows, and give seconds"
        )
        raise FileError(log.name, place, reason)
    if not len(log.command) or (np.diff(log.command_time_s) <= 0.0).any():
        reason = "expected numbers at times that increase"
        raise FileError(log.name, log.command_kind or "time", reason)


def _check_samples(log: Log) -> Iterator[str]:
    """Leave out samples that repeat the one before, lost ones that were written as 0, and spikes."""
    is_fresh = np.append(True, np.diff(log.position, axis=0).any(axis=1))
    fresh = np.flatnonzero(is_fresh)
    gaps = np.diff(fresh[1:])
    period = int(np.median(gaps)) if len(gaps) else 1
    if period > 1 and np.mean(np.abs(gaps - period) <= period // 4) > MIN_REGULAR:
        log.keep(fresh[1:])
        yield f"positions are held for {period} rows: the first of each is used"
    elif (lost := _held_rows(log, is_fresh)).any():
        log.keep(~lost)
        yield f"rows that repeat the position before while the robot moves are left out: {lost.sum()}"
    bend = np.diff(log.position, n=2, axis=0)
    is_jump = np.abs(bend) > MIN_JUMP + 12.0 * np.median(np.abs(bend), axis=0)
    is_lost = (log.position[1:-1] == 0.0).all(axis=1) & is_jump.any(axis=1)
    is_spike = (is_jump & _is_out_and_back(log)).any(axis=1) & ~is_lost
    for rows, words in ((is_lost, "lost samples, written as 0,"), (is_spike, "spikes")):
        if rows.any():
            first_s = log.time_s[1 + np.argmax(rows)]
            yield f"{rows.sum()} {words} are left out, the first at {first_s:.3g} s"
    log.keep(np.concatenate([[True], ~(is_lost | is_spike), [True]]))


def _is_out_and_back(log: Log) -> BoolArray:
    """Return whether a sample leaves its neighbours and what the velocities say, shape [N - 2, J]."""
    step = np.diff(log.position, axis=0)
    if log.velocity.shape == log.position.shape:
        mean = 0.5 * (log.velocity[1:] + log.velocity[:-1])
        rest = step - mean * np.diff(log.time_s)[:, None]
        # Velocities of another joint or unit tell nothing.
        fits = np.median(np.abs(rest), axis=0) < 0.5 * np.median(np.abs(step), axis=0)
        step = np.where(fits, rest, np.nan)
    out, back = step[:-1], -step[1:]
    bend, size = np.diff(log.position, n=2, axis=0), np.abs(out + back)
    is_even = (out * back > 0.0) & (np.abs(out - back) < 0.5 * size)
    return is_even & (size > 0.7 * np.abs(bend))


def _held_rows(log: Log, is_fresh: BoolArray) -> BoolArray:
    """Return the rows that repeat the position before, if the robot has moved by more than a step after them."""
    step = np.abs(np.diff(log.position, axis=0)).sum(axis=1)
    after_held = np.flatnonzero(~is_fresh[:-1] & is_fresh[1:])
    after_fresh = np.flatnonzero(is_fresh[:-1] & is_fresh[1:])
    if not len(after_held) or not len(after_fresh):
        return ~is_fresh & False
    near = [np.abs(after_fresh - row).argsort()[:8] for row in after_held]
    ordinary = np.array([np.median(step[after_fresh[rows]]) for rows in near])
    is_lost = np.mean(step[after_held]) > LOST_STEP * np.mean(ordinary)
    return ~is_fresh & is_lost


def _check_wraps(log: Log) -> Iterator[str]:
    """Unwrap angles modulo 2 pi."""
    turns = np.unwrap(log.position, axis=0)
    # Angles in degrees jump too, but leave one turn.
    is_wrapped = (turns != log.position).any(axis=0)
    is_wrapped &= np.ptp(log.position, axis=0) < 2.0 * np.pi
    if is_wrapped.any():
        turns -= 2.0 * np.pi * np.round(np.median(turns, axis=0) / (2.0 * np.pi))
        log.position = np.where(is_wrapped, turns, log.position)
        yield "angles modulo 2 pi are unwrapped"


def _check_jitter(log: Log) -> Iterator[str]:
    """Replace stamps that jitter by regular ones where the motion is smoother with them."""
    steps = np.diff(log.time_s)
    if steps.max() > 3.0 * log.interval_s:
        return
    regular_s = np.linspace(log.time_s[0], log.time_s[-1], len(log.time_s))
    noise = noise_of(log.time_s, log.position).mean()
    if noise_of(regular_s, log.position).mean() < 0.9 * noise:
        log.command_time_s = np.interp(log.command_time_s, log.time_s, regular_s)
        log.time_s = regular_s
        yield f"stamps jitter by {1e3 * np.std(steps):.2g} ms, and the motion does not: samples are taken as regular"


def noise_of(time_s: FloatArray, values: FloatArray) -> FloatArray:
    """Return the standard deviation of the noise of each column.

    Seven samples in a row are compared with polynomials of degree 5 at the true times. The median of the differences
    ignores contacts and jumps.
    """
    times = sliding_window_view(time_s, NOISE_WINDOW)
    windows = sliding_window_view(values, NOISE_WINDOW, axis=0)
    places = (times - times[:, :1]) / np.ptp(times, axis=1, keepdims=True)
    # The last left singular vector of the powers 0 to 5 is orthogonal to every such polynomial, and of length 1.
    places, kinds = np.unique(places.round(6), axis=0, return_inverse=True)
    powers = places[..., None] ** np.arange(NOISE_WINDOW - 1)
    weights = np.linalg.svd(powers)[0][..., -1]
    residual = np.einsum("nw,njw->nj", weights[kinds.ravel()], windows)
    return 1.4826 * np.median(np.abs(residual), axis=0)


def _check_velocity(log: Log) -> Iterator[str]:
    """Add noise levels, and velocities where the log has none; compare those that it has with the positions."""
    log.position_noise = np.maximum(noise_of(log.time_s, log.position), MIN_NOISE)
    slope, half = np.gradient(log.position, log.time_s, axis=0), NOISE_WINDOW // 2
    if log.velocity.shape != log.position.shape:
        log.velocity = np.where(_is_regular(log.time_s), _smooth_slope(log), slope)
        log.velocity_noise = 0.6 * log.position_noise / log.interval_s
        # A polynomial has no slope at its ends.
        log.keep(np.arange(len(slope))[half:-half])
        log.findings.append(
            "no velocities of all joints: differences of positions are used"
        )
        return
    yield from _check_rates(log)
    spread = 1.4826 * np.median(np.abs(log.velocity - slope), axis=0)
    noise = np.hypot(noise_of(log.time_s, log.velocity), 0.2 * spread)
    log.velocity_noise = np.maximum(noise, MIN_RATE_NOISE)


def _smooth_slope(log: Log) -> FloatArray:
    """Return the slopes of polynomials of degree 4 through seven samples, shape [N, J].

    They have 0.51 of the noise of a position over the interval, and central differences 0.71.
    """
    slopes = (
        savgol_filter(each, NOISE_WINDOW, 4, deriv=1, axis=0)
        for each in (log.position, log.time_s[:, None])
    )
    return np.divide(*slopes)


def _is_regular(time_s: FloatArray) -> BoolArray:
    """Return whether a sample is in the middle of seven with equal intervals, shape [N, 1]."""
    steps = sliding_window_view(np.diff(time_s), NOISE_WINDOW - 1)
    is_even = steps.max(axis=1) < 1.2 * steps.min(axis=1)
    return np.pad(is_even, NOISE_WINDOW // 2)[:, None]


def _check_rates(log: Log) -> Iterator[str]:
    """Bring velocities to the order, signs and unit of the slopes of the positions, where these are clear."""
    path = cumulative_simpson(log.velocity, x=log.time_s, axis=0, initial=0.0)
    length = min(1 + round(TURN_S / log.interval_s), len(path) // 2)
    moved, turned = (each[length:] - each[:-length] for each in (log.position, path))
    count = len(log.joints)
    # Noise moves a joint that rests; the trend avoids a division by zero.
    moves = np.std(moved, axis=0) > 8.0 * log.position_noise
    trend = 1e-9 * np.arange(len(moved))
    match = np.corrcoef(moved.T + trend, turned.T + trend)[:count, count:]
    order = linear_sum_assignment(np.abs(match), maximize=True)[1]
    best = np.abs(match[range(count), order])
    exchanged = moves & (best > 0.9) & (np.abs(np.diag(match)) < best - 0.2)
    if exchanged.sum() > 1:
        order = np.where(exchanged, order, range(count))
        log.velocity, turned = log.velocity[:, order], turned[:, order]
        match = match[:, order]
        pairs = [
            f"{log.joints[k]} has that of {log.joints[order[k]]}"
            for k in np.flatnonzero(exchanged)
        ]
        yield f"velocities are exchanged ({', '.join(pairs)}): they are put back"
    clear = moves & (np.abs(np.diag(match)) > 0.9)
    ratio = np.sum(moved * turned, axis=0) / np.maximum(np.sum(moved**2, axis=0), 1e-12)
    flipped = clear & (ratio < 0.0)
    if flipped.any():
        log.velocity[:, flipped] *= -1.0
        names = first_names([log.joints[k] for k in np.flatnonzero(flipped)])
        yield f"velocities of {names} have the opposite sign of the slope of the positions: it is turned"
    ratio = np.abs(ratio[clear])
    if not len(ratio) or np.exp(np.abs(np.log(np.median(ratio)))) < MAX_RATE_RATIO:
        return
    for unit, factor in (
        ("deg/s", np.rad2deg(1.0)),
        ("turns/s", 0.5 / np.pi),
        ("rpm", 30.0 / np.pi),
    ):
        if np.allclose(ratio, factor, rtol=0.15):
            log.velocity /= factor
            yield f"velocities are in {unit}, by the slope of the positions: they are converted"
            return
    yield (
        f"velocities are {np.median(ratio):.3g} times the slope of the positions: another unit, or the clock runs at "
        "another rate"
    )


def _base_options(log: Log) -> Iterator[tuple[Any, ...]]:
    """Yield each order of quaternions and frame of angular velocities with its base.

    Yields:
        Misfit of the linear and the angular velocities to the pose, over the limit; order; frame; pose and twist in the
        terms of a log; velocities that the pose shows.
    """
    position, quaternion = np.split(log.base_pose, [3], axis=1)
    # Without velocities, zeros are compared with the pose.
    linear, angular = np.hsplit(np.resize(log.base_twist, (len(position), 6)), 2)
    window = 1 + round(TURN_S / log.interval_s)

    def power(rates: FloatArray) -> FloatArray:
        # Mean squares of linear and angular rates without their noise.
        smooth = uniform_filter1d(rates, window, axis=0).reshape(-1, 2, 3)
        return np.mean(smooth**2, axis=(0, 2))

    # A turn has the noise of two quaternions, whose change is half of the angle.
    noise = (noise_of(log.time_s, log.base_pose).max() + MIN_NOISE) / TURN_S
    for order, shift in (("wxyz", 0), ("xyzw", 1)):
        if log.quaternion not in (None, order):
            continue
        pose = np.hstack([position, np.roll(quaternion, shift, axis=1)])
        turn = Rotation.from_quat(pose[:, 3:], scalar_first=True)
        steps = (turn[:-1].inv() * turn[1:]).as_rotvec()
        rate = np.vstack([steps, steps[-1:]]) / np.gradient(log.time_s)[:, None]
        slope = np.hstack([np.gradient(position, log.time_s, axis=0), rate])
        limit = MAX_MISFIT * power(slope) + 8.0 * noise**2
        for frame, rate in (("body", angular), ("world", turn.inv().apply(angular))):
            for moved in (linear, turn.apply(linear)):
                twist = np.hstack([moved, rate])
                yield power(twist - slope) / limit, order, frame, pose, twist, slope


def _check_base(log: Log) -> Iterator[str]:
    """Bring the base to quaternions w x y z and angular velocities in its own frame.

    Each order of quaternions is tried with each frame of angular velocities. Velocities that the pose contradicts are
    replaced by its differences.
    """
    if log.base_pose.shape[1] != 7:
        return
    is_given = log.base_twist.shape[1] == 6
    options = [*_base_options(log)]
    best = min(option[0][1] for option in options)
    sure = 1.0 + SURE * TURN_S / np.ptp(log.time_s)
    limit = min(1.0, sure * best)
    near = [option for option in options if option[0][1] <= limit] or options
    # The second option of each order and frame has linear velocities in the body frame.
    is_body = near[0][0][0] > 1.0 and near[1][0][0] <= 1.0
    misfit, order, frame, log.base_pose, log.base_twist, slope = near[int(is_body)]
    if order == "xyzw":
        yield "base_quat is x y z w: it is turned to w x y z"
    if is_body:
        yield "base_linvel is in the body frame: it is turned"
    if frame == "world":
        yield "base_angvel is in the world frame: it is turned"
    if len({order for _, order, *_ in near}) > 1:
        log.findings.append(
            "base_angvel does not show the order of base_quat: it is taken as w x y z; "
            'if it is x y z w, add quaternion = "xyzw" to --map'
        )
    if (misfit > 1.0).any():
        log.base_twist = slope
        if is_given:
            yield "base velocities do not fit the pose: its differences are used"
        else:
            log.findings.append("no base velocities: differences of the pose are used")
    turn = UPRIGHT[log.up]
    log.base_pose[:, :3] = turn.apply(log.base_pose[:, :3])
    log.base_twist[:, :3] = turn.apply(log.base_twist[:, :3])
    if log.up_of == "pose":
        pose = Rotation.from_quat(log.base_pose[:, 3:], scalar_first=True)
        pose = turn * pose * turn.inv()
        log.base_pose[:, 3:] = pose.as_quat(scalar_first=True)
        log.base_twist[:, 3:] = turn.apply(log.base_twist[:, 3:])


def _check_clocks(log: Log) -> Iterator[str]:
    """Name commands whose clock is not that of the samples."""
    (first_s, last_s), (begin_s, end_s) = (
        log.time_s[[0, -1]],
        log.command_time_s[[0, -1]],
    )
    overlap_s = min(last_s, end_s) - max(first_s, begin_s)
    if overlap_s < 0.5 * (last_s - first_s) and log.command_kind:
        yield (
            f"command_t runs from {begin_s:g} to {end_s:g} s, but t from {first_s:g} to {last_s:g} s: "
            "give both by one clock"
        )


def _unknown(log: Log) -> Iterator[str]:
    """Report what a log does not tell, as what happens between samples with commands that move at each one."""
    is_fast = log.command_interval_s < 1.1 * log.interval_s
    if not log.command_kind:
        yield "no commands: the mechanism is taken as passive"
    elif is_fast and log.command_kind in ("target", "tau"):
        yield f"commands change at every sample: a delay below {1e3 * log.interval_s:.3g} ms may be how they are held"


CHECKS = (
    _check_numbers,
    _check_samples,
    _check_wraps,
    _check_jitter,
    _check_velocity,
    _check_base,
    _check_clocks,
)
"""Checks of a log, in this order."""
