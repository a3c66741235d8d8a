"""Logs of a robot: reading CSV, NPZ and Parquet, and naming what is wrong in them before anything is fitted."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError
from scipy.spatial.transform import Rotation
from scipy.stats import linregress

from gauge_envs.errors import FileError, first_fault, first_names, needs_extra

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
Columns: TypeAlias = Mapping[str, NDArray[Any]]
Quantity: TypeAlias = tuple[tuple[str, ...], FloatArray]
"""Names of the joints, and values of shape [N, J]; neither where the log has none."""

ALIASES = {
    "time": "t time time_s timestamp",
    "position": "q qpos pos position position_rad joint_pos observation.state",
    "velocity": "dq qd qvel vel velocity velocity_rad_per_s joint_vel",
    "action": "action actions",
    "ctrl": "ctrl",
    "target": "target command command_rad q_des",
    "tau": "tau torque effort",
    "base_position": "base_pos base_position",
    "base_quaternion": "base_quat base_quaternion",
    "base_linear_velocity": "base_linvel base_linear_velocity",
    "base_angular_velocity": "base_angvel base_angular_velocity",
    "command_time": "command_t command_time command_time_s",
}
"""Names of each quantity in a file; a column of one joint adds a separator and the joint, as `q_hip`."""

ANGLES = {"position": 1.0, "target": 1.0, "ctrl": 1.0, "velocity": 0.0}
"""Quantities with the unit of the map, and the factor of the offset of a joint that they contain."""

SAMPLED = ("time_s", "position", "velocity", "valid", "base_pose", "base_twist")
"""Attributes of a log with a row a sample."""

COMMANDS = ("action", "ctrl", "target", "tau")
"""Kinds of command, the one that is used first where a log has several."""

MIN_SAMPLES = 20
MIN_NOISE = 2e-4
MIN_RATE_NOISE = 2e-3
"""Noise below which a difference has no meaning for a policy; a log of a simulator has none of its own."""

NOISE_WINDOW = 7
MIN_JUMP = 0.02
"""Second difference of positions at a lost sample [rad or m]."""
MAX_MISFIT = 0.3
"""Difference of the velocities of the base to the slope of its pose, over that slope, both squared."""
MIN_REGULAR = 0.7
"""Fraction of equal runs of samples from which on the encoder is slower than the log."""

MAX_JITTER = 0.03
"""Scatter of the interval between samples, over the interval, that counts as regular."""


class JointMap(BaseModel):
    """What a joint of the model is called in the log, and how its angle reads there."""

    model_config = ConfigDict(extra="forbid")
    log: str = ""
    sign: Literal[1, -1] = 1
    offset_rad: float = 0.0


class ControlMap(BaseModel):
    """The controller outside of the model: a PD law in the robot's drives, and the scale of actions."""

    model_config = ConfigDict(extra="forbid")
    kp: float | dict[str, float] | None = None
    kd: float | dict[str, float] = 0.0
    action_scale: float | dict[str, float] = 1.0
    default_rad: float | dict[str, float] | None = None

    def of(self, joint: str) -> dict[str, Any]:
        """Return the values for a joint by field."""
        return {
            field: value.get(joint) if isinstance(value, dict) else value
            for field, value in self
        }


class LogMap(BaseModel):
    """A map file: names, order, signs and units of a log that differ from the model."""

    model_config = ConfigDict(extra="forbid")
    unit: Literal["rad", "deg"] = "rad"
    command: Literal["action", "ctrl", "target", "tau"] | None = None
    order: list[str] = []
    joints: dict[str, JointMap] = {}
    control: ControlMap = ControlMap()

    def converted(self, key: str, names: Sequence[str], values: FloatArray) -> Quantity:
        """Return a quantity in the terms of the model.

        Args:
            key: Its key in ALIASES.
            names: Names of the joints in the log.
            values: Values of the log, shape [N, J].
        """
        by_log = {entry.log: name for name, entry in self.joints.items()}
        renamed = tuple(by_log.get(name, name) for name in names)
        entries = [self.joints.get(name, JointMap()) for name in renamed]
        values = values * np.array([entry.sign for entry in entries])
        if key in ANGLES and self.unit == "deg":
            values = np.deg2rad(values)
        offsets = np.array([entry.offset_rad for entry in entries])
        return renamed, values + ANGLES.get(key, 0.0) * offsets


@dataclass
class Log:
    """What a robot or a simulator did.

    Attributes:
        name: Name of the file.
        joints: Names of the joints.
        time_s: Times of the samples, shape [N].
        position: Angles [rad] or lengths [m], shape [N, J].
        velocity: Rates, shape [N, J]; differences of the positions where the log has none.
        valid: Whether a sample can be used, shape [N].
        position_noise, velocity_noise: Standard deviation of the noise of each joint, shape [J].
        command: Commands, shape [M, C]; no column for a passive mechanism.
        command_kind: Quantity of the commands; empty without any.
        command_names: Names of the joints or actuators of the commands.
        command_time_s: From when on each command holds, shape [M].
        base_pose: Position [m] and quaternion w x y z of the base, shape [N, 7]; no column without a base.
        base_twist: Its linear velocity in the world and angular velocity in the body frame, shape [N, 6].
        findings: What is wrong in the log, and what was done about it.
    """

    name: str
    joints: tuple[str, ...]
    time_s: FloatArray
    position: FloatArray
    velocity: FloatArray
    valid: BoolArray
    command: FloatArray
    command_kind: str
    command_names: tuple[str, ...]
    command_time_s: FloatArray
    base_pose: FloatArray
    base_twist: FloatArray
    position_noise: FloatArray = field(init=False)
    velocity_noise: FloatArray = field(init=False)
    findings: list[str] = field(default_factory=list)

    @property
    def interval_s(self) -> float:
        """Median interval between samples."""
        return float(np.median(np.diff(self.time_s)))

    @property
    def command_interval_s(self) -> float:
        """Median interval between changes of the command."""
        changed = np.flatnonzero((np.diff(self.command, axis=0) != 0.0).any(axis=1))
        if len(changed) < 3:
            return self.interval_s
        return float(np.median(np.diff(self.command_time_s[changed + 1])))


def read_map(file: Path | None) -> LogMap:
    """Return the content of a map file; the default without one.

    Raises:
        FileError: The file is missing or wrong.
    """
    if file is None:
        return LogMap()
    try:
        return LogMap.model_validate(tomllib.loads(file.read_text(encoding="utf-8")))
    except ValidationError as error:
        raise FileError(file, *first_fault(error)) from error
    except (OSError, ValueError) as error:
        raise FileError(file, None, f"cannot be read as TOML: {error}") from error


def read_log(
    file: Path, names: Sequence[str] = (), mapped: LogMap | None = None
) -> Log:
    """Return a log, checked, with its flaws named.

    Args:
        file: CSV, NPZ or Parquet.
        names: Joints of the model, which name the columns of a file without names.
        mapped: Names, signs and units that differ.

    Raises:
        FileError: The file has no time or no positions, or its columns do not fit each other.
    """
    mapped = mapped or LogMap()
    try:
        columns = _read_columns(file)
        stored = [str(name) for name in columns.get("joints", names)]
        quantities = _quantities(columns, mapped.order or stored, mapped)
    except (OSError, ValueError, TypeError) as error:
        reason = f"cannot be read as CSV, NPZ or Parquet: {error}"
        raise FileError(file, None, reason) from error
    for key in ("time", "position"):
        if not quantities[key][0]:
            expected = ALIASES[key].replace(" ", " or ")
            reason = f"no column {expected}; the file has {first_names(list(columns))}"
            raise FileError(file, None, reason)
    time_s = quantities["time"][1][:, 0]
    joints, position = quantities["position"]
    _check_times(file, time_s, len(position))
    kinds = [
        kind for kind in (mapped.command, *COMMANDS) if kind and quantities[kind][0]
    ]
    kind = kinds[0] if kinds else ""
    command_names, command = quantities[kind or "action"]
    command_times = quantities["command_time"][1]
    base = [quantities[key][1] for key in ALIASES if key.startswith("base_")]
    log = Log(
        name=file.name,
        joints=joints,
        time_s=time_s,
        position=position,
        velocity=quantities["velocity"][1],
        valid=np.asarray(np.isfinite(position).all(axis=1)),
        command=command,
        command_kind=kind,
        command_names=command_names,
        command_time_s=command_times[:, 0] if command_times.size else time_s,
        base_pose=np.hstack(base[:2]),
        base_twist=np.hstack(base[2:]),
    )
    for check in CHECKS:
        check(log)
    return log


def _read_columns(file: Path) -> Columns:
    """Return the columns of a file by name."""
    if file.suffix == ".npz":
        with np.load(file, allow_pickle=False) as archive:
            return dict(archive)
    if file.suffix == ".parquet":
        with needs_extra("reading Parquet", "parquet"):
            from pyarrow import parquet
        table = parquet.read_table(file).to_pydict()
        return {name: np.array(values) for name, values in table.items()}
    rows = np.genfromtxt(
        file, delimiter=",", names=True, deletechars="", encoding="utf-8-sig"
    )
    return {name: rows[name] for name in rows.dtype.names or ()}


def _quantities(
    columns: Columns, names: Sequence[str], mapped: LogMap
) -> dict[str, Quantity]:
    """Return the quantities in columns; `names` are the joints of a column that has all of them."""
    keys = {alias: key for key, text in ALIASES.items() for alias in text.split()}
    longest_first = "|".join(sorted(keys, key=len, reverse=True))
    pattern = re.compile(rf"({longest_first})(?:[._/:\[](.*?)\]?)?")
    by_joint: dict[str, dict[str, Any]] = {key: {} for key in ALIASES}
    for name, array in columns.items():
        if match := pattern.fullmatch(name):
            by_joint[keys[match[1]]][match[2] or ""] = array
    rows = len(next(iter(by_joint["time"].values()), ()))
    quantities = {}
    for key, arrays in by_joint.items():
        values = np.column_stack([*arrays.values()] or [np.zeros((rows, 0))])
        joints = list(arrays)
        if "" in arrays:
            numbers = list(map(str, range(values.shape[1])))
            joints = list(names) if len(names) == len(numbers) else numbers
        quantities[key] = mapped.converted(key, joints, values.astype(float))
    return quantities


def _check_times(file: Path, time_s: FloatArray, count: int) -> None:
    """Raise an error for times that are no clock in seconds."""
    if len(time_s) != count or count < MIN_SAMPLES:
        reason = f"{len(time_s)} times and {count} positions; a log needs {MIN_SAMPLES} or more of both"
        raise FileError(file, None, reason)
    steps = np.diff(time_s)
    if steps.min() <= 0.0 or np.median(steps) >= 1.0:
        row = int(np.argmin(steps)) + 2
        reason = "the time does not increase, or not in seconds; sort the rows"
        raise FileError(file, row, reason)


# --- checks: each adds its findings to the log -----------------------------------------------------------------------


def _check_wraps(log: Log) -> None:
    """Unwrap angles modulo 2 pi."""
    is_usable = log.valid[1:] & log.valid[:-1]
    jumps = np.abs(np.diff(log.position, axis=0)) > np.pi
    wrapped = jumps[is_usable].any(axis=0)
    if wrapped.any():
        turns = np.unwrap(log.position, axis=0)
        turns -= 2.0 * np.pi * np.round(np.median(turns, axis=0) / (2.0 * np.pi))
        log.position = np.where(wrapped, turns, log.position)
        log.findings.append("angles modulo 2 pi are unwrapped")


def _check_held(log: Log) -> None:
    """Keep the first of equal samples where the encoder is slower than the log."""
    fresh = np.flatnonzero((np.diff(log.position, axis=0) != 0.0).any(axis=1)) + 1
    gaps = np.diff(fresh)
    period = int(np.median(gaps)) if len(gaps) else 1
    if period > 1 and np.mean(np.abs(gaps - period) <= period // 4) > MIN_REGULAR:
        for key in SAMPLED:
            setattr(log, key, getattr(log, key)[fresh])
        text = f"positions are held for {period} rows: the first of each is used"
        log.findings.append(text)


def _check_zeros(log: Log) -> None:
    """Exclude lost samples that were written as 0."""
    bend = np.abs(np.diff(log.position, n=2, axis=0))
    is_jump = bend > MIN_JUMP + 12.0 * np.median(bend, axis=0)
    is_lost = ((log.position[1:-1] == 0.0) & is_jump).any(axis=1)
    lost = np.flatnonzero(is_lost) + 1
    if len(lost):
        log.valid[lost] = False
        text = f"{len(lost)} lost samples, written as 0, are left out"
        log.findings.append(text)


def _check_jitter(log: Log) -> None:
    """Replace stamps that jitter by regular ones where the motion is smoother with them."""
    steps = np.diff(log.time_s)
    jitter_s = float(np.std(steps))
    if jitter_s < MAX_JITTER * log.interval_s or steps.max() > 3.0 * log.interval_s:
        return
    regular_s = np.linspace(log.time_s[0], log.time_s[-1], len(log.time_s))
    stamped, regular = (
        noise_of(time_s, log.position, log.valid).mean()
        for time_s in (log.time_s, regular_s)
    )
    if regular < 0.9 * stamped:
        log.command_time_s = np.interp(log.command_time_s, log.time_s, regular_s)
        log.time_s = regular_s
        text = f"stamps jitter by {1e3 * jitter_s:.2g} ms, and the motion does not: samples are taken as regular"
        log.findings.append(text)


def noise_of(time_s: FloatArray, values: FloatArray, valid: BoolArray) -> FloatArray:
    """Return the standard deviation of the noise of each column.

    Seven samples in a row are compared with polynomials of degree 5 at the true times. The median of the differences
    ignores contacts and jumps.
    """
    is_whole = sliding_window_view(valid, NOISE_WINDOW).all(axis=1)
    times = sliding_window_view(time_s, NOISE_WINDOW)[is_whole]
    windows = sliding_window_view(values, NOISE_WINDOW, axis=0)[is_whole]
    if not len(times):
        return np.zeros(values.shape[1])
    places = (times - times[:, :1]) / np.ptp(times, axis=1, keepdims=True)
    # The last left singular vector of the powers 0 to 5 is orthogonal to every such polynomial, and of length 1.
    powers = places[..., None] ** np.arange(NOISE_WINDOW - 1)
    weights = np.linalg.svd(powers)[0][..., -1]
    residual = np.einsum("nw,njw->nj", weights, windows)
    return 1.4826 * np.median(np.abs(residual), axis=0)


def _check_velocity(log: Log) -> None:
    """Add noise levels, and velocities where the log has none; compare those that it has with the positions."""
    noise = noise_of(log.time_s, log.position, log.valid)
    log.position_noise = np.maximum(noise, MIN_NOISE)
    slope = np.gradient(log.position, log.time_s, axis=0)
    if not log.velocity.size:
        log.velocity = slope
        log.velocity_noise = log.position_noise / (np.sqrt(2.0) * log.interval_s)
        log.findings.append("no velocities: differences of positions are used")
        return
    log.valid &= np.isfinite(log.velocity).all(axis=1)
    rates, slopes = log.velocity[log.valid], slope[log.valid]
    spread = 1.4826 * np.median(np.abs(rates - slopes), axis=0)
    noise = np.hypot(noise_of(log.time_s, log.velocity, log.valid), 0.2 * spread)
    log.velocity_noise = np.maximum(noise, MIN_RATE_NOISE)
    line = linregress(slopes.ravel(), rates.ravel())
    if abs(line.slope - 1.0) > 0.07 and line.rvalue > 0.95:
        text = f"velocities are {line.slope:.3g} times the slope of the positions: another unit or clock"
        log.findings.append(text)


def _check_base(log: Log) -> None:
    """Replace velocities of the base that its pose contradicts, as those in another frame or unit."""
    if log.base_pose.shape[1] != 7:
        return
    position, quaternion = np.split(log.base_pose, [3], axis=1)
    turn = Rotation.from_quat(quaternion, scalar_first=True)
    rotation = (turn[:-1].inv() * turn[1:]).as_rotvec()
    rate = rotation[[*range(len(rotation)), -1]] / np.gradient(log.time_s)[:, None]
    slope = np.hstack([np.gradient(position, log.time_s, axis=0), rate])
    if log.base_twist.shape == slope.shape:
        changes = np.array([log.base_twist - slope, slope]).reshape(2, -1, 2, 3)
        misfit, size = np.mean(changes**2, axis=(1, 3))
        # Noise of the pose makes its slope noisy.
        noise = noise_of(log.time_s, log.base_pose, log.valid).max()
        limit = np.maximum(MAX_MISFIT * size, (4.0 * noise / log.interval_s) ** 2)
        if (misfit <= limit).all():
            return
        log.findings.append(
            "base velocities do not fit the pose (w x y z; linear in the world, angular in the body frame): "
            "its differences are used"
        )
    log.base_twist = slope


def _check_commands(log: Log) -> None:
    """Report commands that move at every sample: what happens between samples is not known."""
    is_held = log.command_interval_s > 1.1 * log.interval_s
    if not log.command_kind:
        log.findings.append("no commands: the mechanism is taken as passive")
    elif not is_held and log.command_kind in ("target", "tau"):
        text = f"commands change at every sample: a delay below {1e3 * log.interval_s:.3g} ms may be how they are held"
        log.findings.append(text)


CHECKS = (
    _check_held,
    _check_zeros,
    _check_wraps,
    _check_jitter,
    _check_velocity,
    _check_base,
    _check_commands,
)
"""Checks of a log, in this order."""
