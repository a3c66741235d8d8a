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

NOISE_WINDOW = 7
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

    def corrected(
        self, names: Sequence[str], values: FloatArray, unit: float, offset: float
    ) -> FloatArray:
        """Return values [N, J] of joints of the log in units and signs of the model, and with the offset times this."""
        entries = [self.joints.get(name, JointMap()) for name in self.renamed(names)]
        signs = np.array([entry.sign for entry in entries])
        offsets = np.array([entry.offset_rad for entry in entries])
        return values * unit * signs + offset * offsets


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
    base: dict[str, FloatArray]
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
    is_angle = kind in ("target", "ctrl")
    command_unit = unit if is_angle else 1.0
    position = mapped.corrected(joints, position, unit, 1.0)
    log = Log(
        name=file.name,
        joints=mapped.renamed(joints),
        time_s=time_s,
        position=position,
        velocity=position * np.nan,
        valid=np.asarray(np.isfinite(position).all(axis=1)),
        position_noise=np.zeros(len(joints)),
        velocity_noise=np.zeros(len(joints)),
        command=mapped.corrected(command_names, command, command_unit, float(is_angle)),
        command_kind=kind if command.size else "",
        command_names=mapped.renamed(command_names),
        command_time_s=_joined(command_time, ())[1][:, 0],
        base={
            key.removeprefix("base_"): _joined(values, ())[1]
            for key, values in quantities.items()
            if key.startswith("base_") and values
        },
    )
    if velocity.size:
        log.velocity = mapped.corrected(joints, velocity, unit, 0.0)
    for check in CHECKS:
        check(log)
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
    return tuple(names if len(names) == count else map(str, range(count))), values


def _check_times(file: Path, time_s: FloatArray, count: int) -> None:
    """Raise an error for times that are no clock in seconds."""
    steps = np.diff(time_s)
    if len(time_s) != count or count < 20:
        reason = (
            f"{len(time_s)} times and {count} positions; a log needs 20 or more of both"
        )
        raise FileError(file, None, reason)
    if not (steps > 0.0).all():
        row = int(np.argmin(steps > 0.0)) + 2
        raise FileError(file, row, "the time does not increase; sort the rows")
    if np.median(steps) >= 1.0:
        reason = f"{np.median(steps):g} s between samples; give the time in seconds"
        raise FileError(file, "t", reason)


# --- checks: each adds what it found to the log ----------------------------------------------------------------------


def _check_wraps(log: Log) -> None:
    """Unwrap angles modulo 2 pi."""
    is_lost = log.position == 0.0
    jumps = np.abs(np.diff(log.position, axis=0)) > np.pi
    wrapped = (jumps & ~is_lost[1:] & ~is_lost[:-1]).any(axis=0)
    if wrapped.any():
        turns = np.unwrap(log.position, axis=0)
        turns -= 2.0 * np.pi * np.round(np.median(turns, axis=0) / (2.0 * np.pi))
        log.position = np.where(wrapped, turns, log.position)
        names = ", ".join(np.array(log.joints)[wrapped])
        log.findings.append(f"angles modulo 2 pi are unwrapped ({names})")


def _check_held(log: Log) -> None:
    """Keep the first of equal samples where the encoder is slower than the log."""
    fresh = np.flatnonzero((np.diff(log.position, axis=0) != 0.0).any(axis=1)) + 1
    gaps = np.diff(fresh)
    period = int(np.median(gaps)) if len(gaps) else 1
    if period > 1 and np.mean(np.abs(gaps - period) <= period // 4) > MIN_REGULAR:
        for key in ("time_s", "position", "velocity", "valid"):
            setattr(log, key, getattr(log, key)[fresh])
        log.base = {key: values[fresh] for key, values in log.base.items()}
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
        first_s = log.time_s[lost[0]]
        text = f"{len(lost)} lost samples, written as 0, are left out; the first at {first_s:.3g} s"
        log.findings.append(text)


def _check_jitter(log: Log) -> None:
    """Replace stamps that jitter by regular ones where the motion is smoother with them."""
    steps = np.diff(log.time_s)
    jitter_s = float(np.std(steps))
    if jitter_s < MAX_JITTER * log.interval_s or steps.max() > 3.0 * log.interval_s:
        return
    regular_s = np.linspace(log.time_s[0], log.time_s[-1], len(log.time_s))
    rough = noise_of(log.time_s, log.position, log.valid).mean()
    result = "as the samples do: they are used as they are"
    if noise_of(regular_s, log.position, log.valid).mean() < 0.9 * rough:
        result = "and the motion does not: samples are taken as regular"
        log.command_time_s = np.interp(log.command_time_s, log.time_s, regular_s)
        log.time_s = regular_s
    log.findings.append(f"stamps jitter by {1e3 * jitter_s:.2g} ms, {result}")


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
    if noise.max() > LOUD_RAD:
        text = f"noise of {1e3 * noise.max():.2g} mrad or mm: small causes stay unseen"
        log.findings.append(text)
    slope = np.gradient(log.position, log.time_s, axis=0)
    if np.isnan(log.velocity).all():
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
    """Read quaternion and velocities of the base in the order and the frames that fit its motion."""
    base = log.base
    if not {"position", "quaternion"} <= base.keys():
        return
    slope = np.gradient(base["position"], log.time_s, axis=0)
    linear = base.get("linear_velocity", slope)
    readings = []
    for order in ("w x y z", "x y z w"):
        turn = Rotation.from_quat(base["quaternion"], scalar_first=order[0] == "w")
        # The rate between two samples, in the frame of the body.
        rate = (turn[:-1].inv() * turn[1:]).as_rotvec() / np.diff(log.time_s)[:, None]
        given = base.get("angular_velocity", rate[[*range(len(rate)), -1]])
        for frame, angular in (("body", given), ("world", turn.inv().apply(given))):
            misfit = np.mean((rate - angular[:-1]) ** 2)
            readings.append(
                (
                    misfit,
                    f"quaternion {order}, angular velocity in the {frame} frame",
                    turn,
                    angular,
                )
            )
    # Without a clear winner the documented convention, the first one, holds.
    best = min(readings, key=lambda reading: reading[0])
    _, text, turn, angular = best if best[0] < 0.5 * readings[0][0] else readings[0]
    turned = turn.apply(linear)
    if np.mean((turned - slope) ** 2) < 0.5 * np.mean((linear - slope) ** 2):
        linear, text = turned, f"{text}, linear velocity in the body frame"
    if text != readings[0][1]:
        log.findings.append(f"the base is read as {text}")
    base["quaternion"] = turn.as_quat(scalar_first=True)
    base |= {"linear_velocity": linear, "angular_velocity": angular}


def _check_commands(log: Log) -> None:
    """Say when commands move at every sample, so that what happens between samples is not known."""
    is_held = log.command_interval_s > 1.1 * log.interval_s
    if not log.command_kind:
        log.findings.append("no commands: the mechanism is taken as passive")
    elif not is_held and log.command_kind in ("target", "tau"):
        text = f"commands change at every sample: a delay below {1e3 * log.interval_s:.3g} ms may be how they are held"
        log.findings.append(text)


CHECKS = (
    _check_wraps,
    _check_held,
    _check_zeros,
    _check_jitter,
    _check_velocity,
    _check_base,
    _check_commands,
)
"""Checks of a log, in this order."""
