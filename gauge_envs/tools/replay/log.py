"""Logs of a robot: reading CSV, NPZ and Parquet, and naming what is wrong in them before anything is fitted."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError
from scipy.spatial.transform import Rotation
from scipy.stats import linregress

from gauge_envs.errors import FileError, first_fault, needs_extra

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]

ALIASES = {
    "time": ("t", "time", "time_s", "timestamp"),
    "position": (
        "q",
        "qpos",
        "pos",
        "position",
        "position_rad",
        "joint_pos",
        "observation.state",
    ),
    "velocity": (
        "dq",
        "qd",
        "qvel",
        "vel",
        "velocity",
        "velocity_rad_per_s",
        "joint_vel",
    ),
    "action": ("action", "actions"),
    "ctrl": ("ctrl",),
    "target": ("target", "command", "command_rad", "q_des"),
    "tau": ("tau", "torque", "effort"),
    "base_position": ("base_pos", "base_position"),
    "base_quaternion": ("base_quat", "base_quaternion"),
    "base_linear_velocity": ("base_linvel", "base_linear_velocity"),
    "base_angular_velocity": ("base_angvel", "base_angular_velocity"),
    "command_time": ("command_t", "command_time", "command_time_s"),
}
"""Names of each quantity in a file; a column of one joint adds a separator and the joint, as `q_hip`."""

COMMANDS = ("action", "ctrl", "target", "tau")
"""Kinds of command, the one that is used first where a log has several."""

MIN_NOISE = 2e-4
MIN_RATE_NOISE = 2e-3
"""Noise below which a difference has no meaning for a policy; a log of a simulator has none of its own."""

LOUD_RAD = 5e-3
MIN_JUMP = 0.02
"""Second difference of positions at a lost sample [rad or m]."""
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

    def of(self, field: str, joint: str) -> Any:
        """Return the value of a field for a joint."""
        given = getattr(self, field)
        return given.get(joint) if isinstance(given, dict) else given


class LogMap(BaseModel):
    """A map file: names, order, signs and units of a log that differ from the model."""

    model_config = ConfigDict(extra="forbid")
    unit: Literal["rad", "deg"] = "rad"
    command: Literal["action", "ctrl", "target", "tau"] | None = None
    order: list[str] = []
    joints: dict[str, JointMap] = {}
    control: ControlMap = ControlMap()

    def renamed(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the model for names of the log."""
        by_log = {entry.log: name for name, entry in self.joints.items()}
        return tuple(by_log.get(name, name) for name in names)

    def correction(self, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """Return sign and offset of each joint of the log."""
        entries = [self.joints.get(name, JointMap()) for name in self.renamed(names)]
        return np.array([e.sign for e in entries]), np.array(
            [e.offset_rad for e in entries]
        )


@dataclass(frozen=True)
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
        base: Position [m], quaternion w x y z, linear velocity in the world and angular velocity in the body frame,
            shapes [N, 3], [N, 4], [N, 3], [N, 3]; empty without a base.
        findings: What is wrong in the log, and what was done about it.
    """

    name: str
    joints: tuple[str, ...]
    time_s: FloatArray
    position: FloatArray
    velocity: FloatArray
    valid: BoolArray
    position_noise: FloatArray
    velocity_noise: FloatArray
    command: FloatArray
    command_kind: str
    command_names: tuple[str, ...]
    command_time_s: FloatArray
    base: Mapping[str, FloatArray]
    findings: tuple[str, ...] = ()

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
    columns = _read_columns(file)
    quantities = _quantities(columns)
    for key in ("time", "position"):
        if not quantities[key]:
            known = ", ".join(list(columns)[:8])
            expected = " or ".join(ALIASES[key][1:4])
            reason = f"no column of this name or {expected}: {known}"
            raise FileError(file, ALIASES[key][0], reason)
    stored = tuple(map(str, columns.get("joints", ())))
    joints, position = _joined(quantities["position"], mapped.order or stored or names)
    _, velocity = _joined(quantities["velocity"], joints)
    time_s = _joined(quantities["time"], ())[1][:, 0]
    command_time = quantities["command_time"] or quantities["time"]
    _check_times(file, time_s, len(position))
    kinds = [kind for kind in (mapped.command, *COMMANDS) if kind and quantities[kind]]
    kind = kinds[0] if kinds else ""
    command_names, command = _joined(quantities.get(kind, {}), joints)
    unit = np.deg2rad(1.0) if mapped.unit == "deg" else 1.0
    signs, shifts = mapped.correction(joints)
    command_signs, command_shifts = mapped.correction(command_names)
    if kind in ("target", "ctrl"):
        command = command * unit + command_signs * command_shifts
    log = Log(
        name=file.name,
        joints=mapped.renamed(joints),
        time_s=time_s,
        position=position * unit * signs + shifts,
        velocity=velocity * unit * signs if velocity.size else position * np.nan,
        valid=np.asarray(np.isfinite(position).all(axis=1)),
        position_noise=np.zeros(len(joints)),
        velocity_noise=np.zeros(len(joints)),
        command=command * command_signs,
        command_kind=kind if command.size else "",
        command_names=mapped.renamed(command_names),
        command_time_s=_joined(command_time, ())[1][:, 0],
        base={
            key.removeprefix("base_"): _joined(values, ())[1]
            for key, values in quantities.items()
            if key.startswith("base_") and values
        },
    )
    for check in CHECKS:
        log = check(log)
    return log


def _read_columns(file: Path) -> dict[str, NDArray[Any]]:
    """Return the columns of a file by name."""
    try:
        if file.suffix == ".npz":
            with np.load(file, allow_pickle=False) as archive:
                return dict(archive)
        if file.suffix == ".parquet":
            with needs_extra("reading Parquet", "parquet"):
                from pyarrow import parquet
            table = parquet.read_table(file)
            return {
                name: np.array(table[name].to_pylist()) for name in table.column_names
            }
        rows = np.genfromtxt(
            file, delimiter=",", names=True, deletechars="", encoding="utf-8-sig"
        )
        return {name: rows[name] for name in rows.dtype.names or ()}
    except (OSError, ValueError, TypeError) as error:
        raise FileError(
            file, None, f"cannot be read as CSV, NPZ or Parquet: {error}"
        ) from error


def _quantities(columns: Mapping[str, FloatArray]) -> dict[str, dict[str, FloatArray]]:
    """Return the columns of each quantity by joint; the empty name has all joints, or the only one."""
    found: dict[str, dict[str, FloatArray]] = {key: {} for key in ALIASES}
    for name, values in columns.items():
        matches = [
            (len(alias), key, name[len(alias) + 1 :].rstrip("]"))
            for key, aliases in ALIASES.items()
            for alias in aliases
            if re.fullmatch(rf"{re.escape(alias)}([._/:\[].*)?", name)
        ]
        if matches:
            _, key, joint = max(matches)
            found[key][joint] = values
    return found


def _joined(
    columns: Mapping[str, FloatArray], names: Sequence[str]
) -> tuple[tuple[str, ...], FloatArray]:
    """Return names and values [N, J] of a quantity; columns without names take those that are given."""
    if not columns:
        return (), np.zeros((0, 0))
    values = np.column_stack(list(columns.values())).astype(float)
    if "" not in columns:
        return tuple(columns), values
    count = values.shape[1]
    return tuple(names) if len(names) == count else tuple(
        map(str, range(count))
    ), values


def _check_times(file: Path, time_s: FloatArray, count: int) -> None:
    """Raise an error for times that are no clock in seconds."""
    steps = np.diff(time_s)
    if len(time_s) != count or count < 20:
        raise FileError(
            file,
            None,
            f"{len(time_s)} times and {count} positions; a log needs 20 or more of both",
        )
    if not (steps > 0.0).all():
        row = int(np.argmin(steps > 0.0)) + 2
        raise FileError(file, row, "the time does not increase; sort the rows")
    if np.median(steps) >= 1.0:
        raise FileError(
            file,
            "t",
            f"{np.median(steps):g} s between samples; give the time in seconds",
        )


# --- checks ----------------------------------------------------------------------------------------------------------


def _with_finding(log: Log, text: str, **changes: Any) -> Log:
    return replace(log, findings=(*log.findings, text), **changes)


def _check_wraps(log: Log) -> Log:
    """Unwrap angles modulo 2 pi."""
    is_lost = log.position == 0.0
    jumps = np.abs(np.diff(log.position, axis=0)) > np.pi
    wrapped = (jumps & ~is_lost[1:] & ~is_lost[:-1]).any(axis=0)
    if not wrapped.any():
        return log
    names = ", ".join(np.array(log.joints)[wrapped])
    turns = np.unwrap(log.position, axis=0)
    turns -= 2.0 * np.pi * np.round(np.median(turns, axis=0) / (2.0 * np.pi))
    position = np.where(wrapped, turns, log.position)
    return _with_finding(
        log, f"angles modulo 2 pi are unwrapped ({names})", position=position
    )


def _check_zeros(log: Log) -> Log:
    """Exclude lost samples that were written as 0."""
    bend = np.abs(2.0 * log.position[1:-1] - log.position[:-2] - log.position[2:])
    is_jump = bend > MIN_JUMP + 12.0 * np.median(bend, axis=0)
    lost = np.zeros(len(log.time_s), bool)
    lost[1:-1] = ((log.position[1:-1] == 0.0) & is_jump).any(axis=1)
    if not lost.any():
        return log
    text = f"{lost.sum()} lost samples, written as 0, are left out; the first at {log.time_s[np.argmax(lost)]:.3g} s"
    return _with_finding(log, text, valid=log.valid & ~lost)


def _check_held(log: Log) -> Log:
    """Keep the first of equal samples where the encoder is slower than the log."""
    fresh = np.flatnonzero((np.diff(log.position, axis=0) != 0.0).any(axis=1)) + 1
    gaps = np.diff(fresh)
    period = int(np.median(gaps)) if len(gaps) else 1
    if period < 2 or np.mean(np.abs(gaps - period) <= period // 4) < MIN_REGULAR:
        return log
    text = f"positions are held for {period} rows: the first of each is used"
    parts = {
        key: getattr(log, key)[fresh]
        for key in ("time_s", "position", "velocity", "valid")
    }
    base = {key: values[fresh] for key, values in log.base.items()}
    return _with_finding(log, text, base=base, **parts)


def _check_jitter(log: Log) -> Log:
    """Replace stamps that jitter by regular ones where the motion is smoother with them."""
    steps = np.diff(log.time_s)
    jitter_s = float(np.std(steps))
    if jitter_s < MAX_JITTER * log.interval_s or steps.max() > 3.0 * log.interval_s:
        return log
    regular_s = np.linspace(log.time_s[0], log.time_s[-1], len(log.time_s))
    rough, smooth = (
        noise_of(each, log.position, log.valid).mean()
        for each in (log.time_s, regular_s)
    )
    text = f"stamps jitter by {1e3 * jitter_s:.2g} ms"
    if smooth < 0.9 * rough:
        return _with_finding(
            log,
            f"{text}, and the motion does not: samples are taken as regular",
            time_s=regular_s,
            command_time_s=np.interp(log.command_time_s, log.time_s, regular_s),
        )
    return _with_finding(log, f"{text}, as the samples do: they are used as they are")


def noise_of(time_s: FloatArray, values: FloatArray, valid: BoolArray) -> FloatArray:
    """Return the standard deviation of the noise of each column.

    Each sample is compared with the polynomial of degree 5 through its six neighbours, at the true times. The median of
    the differences ignores contacts and jumps.
    """
    offsets = np.array([-3, -2, -1, 1, 2, 3])
    rows = np.arange(3, len(values) - 3)
    rows = rows[valid[rows] & valid[rows[:, None] + offsets].all(axis=1)]
    if not len(rows):
        return np.zeros(values.shape[1])
    times = time_s[rows[:, None] + offsets] - time_s[rows][:, None]
    gaps = times[:, None, :] - times[:, :, None] + np.eye(6)
    # Lagrange: the weight of neighbour i at time 0 is the product over the others of t_j / (t_j - t_i).
    weights = np.prod(times[:, None, :] / gaps, axis=2, where=~np.eye(6, dtype=bool))
    residual = values[rows] - np.einsum(
        "ri,rij->rj", weights, values[rows[:, None] + offsets]
    )
    gain = np.sqrt(1.0 + np.sum(weights**2, axis=1, keepdims=True))
    return 1.4826 * np.median(np.abs(residual / gain), axis=0)


def _check_velocity(log: Log) -> Log:
    """Add noise levels, and velocities where the log has none; compare those that it has with the positions."""
    noise = noise_of(log.time_s, log.position, log.valid)
    log = replace(log, position_noise=np.maximum(noise, MIN_NOISE))
    if noise.max() > LOUD_RAD:
        text = f"noise of {1e3 * noise.max():.2g} mrad or mm: small causes stay unseen"
        log = _with_finding(log, text)
    slope = np.gradient(log.position, log.time_s, axis=0)
    if np.isnan(log.velocity).all():
        rate_noise = log.position_noise / (np.sqrt(2.0) * log.interval_s)
        text = "no velocities: differences of positions are used"
        return _with_finding(log, text, velocity=slope, velocity_noise=rate_noise)
    valid = log.valid & np.isfinite(log.velocity).all(axis=1)
    spread = 1.4826 * np.median(np.abs(log.velocity - slope)[valid], axis=0)
    rate_noise = np.hypot(noise_of(log.time_s, log.velocity, valid), 0.2 * spread)
    rate_noise = np.maximum(rate_noise, MIN_RATE_NOISE)
    log = replace(log, valid=valid, velocity_noise=rate_noise)
    line = linregress(slope[valid].ravel(), log.velocity[valid].ravel())
    if abs(line.slope - 1.0) > 0.07 and line.rvalue > 0.95:
        text = f"velocities are {line.slope:.3g} times the slope of the positions: another unit or clock"
        return _with_finding(log, text)
    return log


def _check_base(log: Log) -> Log:
    """Read quaternion and velocities of the base in the order and the frames that fit its motion."""
    if not {"position", "quaternion"} <= log.base.keys():
        return log
    base, steps_s = dict(log.base), np.diff(log.time_s)[:, None]
    slope = np.gradient(base["position"], log.time_s, axis=0)
    linear = base.get("linear_velocity", slope)
    readings, misfits = [], []
    for order in ("w x y z", "x y z w"):
        turn = Rotation.from_quat(base["quaternion"], scalar_first=order[0] == "w")
        rate = (turn[:-1].inv() * turn[1:]).as_rotvec() / steps_s
        rate = np.vstack([rate, rate[-1:]])
        angular = base.get("angular_velocity", rate)
        for frame, each in (("body", angular), ("world", turn.inv().apply(angular))):
            readings.append(
                (
                    f"quaternion {order}, angular velocity in the {frame} frame",
                    turn,
                    each,
                )
            )
            misfits.append(np.mean((rate - each) ** 2))
    best = int(np.argmin(misfits))
    # Without a clear winner the documented convention holds.
    best = best if misfits[best] < 0.5 * misfits[0] else 0
    text, turn, angular = readings[best]
    turned = turn.apply(linear)
    if np.mean((turned - slope) ** 2) < 0.5 * np.mean((linear - slope) ** 2):
        best, linear, text = -1, turned, f"{text}, linear velocity in the body frame"
    base["quaternion"] = turn.as_quat(scalar_first=True)
    base |= {"linear_velocity": linear, "angular_velocity": angular}
    log = replace(log, base=base)
    return _with_finding(log, f"the base is read as {text}") if best else log


def _check_commands(log: Log) -> Log:
    """Say when commands move at every sample, so that what happens between samples is not known."""
    if not log.command_kind:
        return _with_finding(log, "no commands: the mechanism is taken as passive")
    is_held = log.command_interval_s > 1.1 * log.interval_s
    if is_held or log.command_kind in ("action", "ctrl"):
        return log
    text = f"commands change at every sample: a delay below {1e3 * log.interval_s:.3g} ms may be how they are held"
    return _with_finding(log, text)


CHECKS = (
    _check_wraps,
    _check_held,
    _check_zeros,
    _check_jitter,
    _check_velocity,
    _check_base,
    _check_commands,
)
"""Checks of a log, in this order; each returns the log with what it found."""
