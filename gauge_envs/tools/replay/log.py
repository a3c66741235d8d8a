"""A log of a robot, and the map that says how its file differs from the model."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import permutations, product
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from gauge_envs.errors import FileError
from gauge_envs.names import first_names, nearest
from gauge_envs.reading import reading
from gauge_envs.text import toml_document

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]

SAMPLED = (
    "time_s",
    "position",
    "velocity",
    "base_pose",
    "base_twist",
    "observation",
    "action",
)
"""Attributes of a log with a row a sample."""

COMMANDS = ("action", "ctrl", "target", "tau")
"""Kinds of command, the one that is used first where a log has several."""

COLUMN_NAMES = {
    "command_time": ("command_t",),
    "time": ("t", "time_s", "timestamp", "stamp", "header.stamp"),
    "target": ("command_rad", "command", "q_des"),
    "position": (
        "qpos",
        "q",
        "position_rad",
        "pos",
        "joint_pos",
        "observation.state",
    ),
    "velocity": ("dq", "qd", "qvel", "vel", "velocity_rad_per_s", "joint_vel"),
    "action": ("actions",),
    "ctrl": (),
    "tau": ("torque", "effort"),
    "policy_observation": ("obs", "policy_obs"),
    "base_position": ("base_pos",),
    "base_quaternion": ("base_quat",),
    "base_linear_velocity": ("base_linvel",),
    "base_angular_velocity": ("base_angvel",),
    "episode": ("episode_index",),
}
"""Other names of each quantity in a file; a column of one joint adds a separator and the joint, as `q_hip`."""

QUANTITIES = {
    name: quantity
    for quantity, names in COLUMN_NAMES.items()
    for name in (quantity, *names)
}
"""Quantity by name."""

ANGLES = ("position", "target", "ctrl")
"""Quantities that contain the offset of a joint; with the velocities they have the unit of the map."""

MIN_NOISE = 2e-4
MIN_RATE_NOISE = 2e-3
"""Noise below which a difference has no meaning for a policy; a log of a simulator has none of its own."""
NOISE_WINDOW = 7


def _axes() -> dict[str, Rotation]:
    turns = {}
    for order in permutations(range(3)):
        for signs in product((1, -1), repeat=3):
            matrix = np.diag(signs) @ np.eye(3)[[*order]]
            names = (
                "-" * (s < 0) + "xyz"[k] for s, k in zip(signs, order, strict=True)
            )
            if np.linalg.det(matrix) > 0.0:
                turns[" ".join(names)] = Rotation.from_matrix(matrix)
    return dict(sorted(turns.items(), key=lambda item: item[1].magnitude()))


AXES = _axes()
"""Rotation to the axes of the model, by the axes of the log that are its x, y and z; the smallest rotation first."""
OWN_AXES = "x y z"


class JointMap(BaseModel, extra="forbid"):
    """What a joint of the model is called in the log, and how its angle reads there: `sign * scale * log + offset`.

    Its velocity and command may be those of another one there; velocities have a further scale, and commands a further
    scale and offset.
    """

    log: str = ""
    velocity: str = ""
    command: str = ""
    sign: Literal[1, -1] = 1
    scale: float = 1.0
    offset_rad: float = 0.0
    velocity_scale: float = 1.0
    command_scale: float = 1.0
    command_offset: float = 0.0


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


def _known_axes(text: str) -> str:
    if text not in AXES:
        raise ValueError("three axes of a right-handed frame, as x -z y")
    return text


Axes: TypeAlias = Annotated[str, AfterValidator(_known_axes)]
Titles: TypeAlias = dict[str, str | list[str]]


def _known_quantities(titles: Titles) -> Titles:
    for name in titles:
        if name not in COLUMN_NAMES:
            quantity = QUANTITIES.get(name)
            hint = f"write {quantity}" if quantity else nearest(name, COLUMN_NAMES)
            raise ValueError(f"{name!r} is no quantity of a log; {hint}")
    return titles


class LogMap(BaseModel, extra="forbid"):
    """A map file: names, order, signs and units of a log that differ from the model."""

    unit: Literal["rad", "deg"] = "rad"
    command: Literal["action", "ctrl", "target", "tau"] | None = None
    quaternion: Literal["wxyz", "xyzw"] | None = None
    angvel_frame: Literal["body", "world"] | None = None
    linvel_frame: Literal["world", "body"] | None = None
    axes: Axes = OWN_AXES
    position_axes: Axes = OWN_AXES
    observation: list[str] = []
    observation_scale: dict[str, float] = {}
    order: list[str] = []
    columns: Annotated[Titles, AfterValidator(_known_quantities)] = {}
    interval_s: float | None = None
    episodes: list[int] = []
    joints: dict[str, JointMap] = {}
    control: ControlMap = ControlMap()

    def joint(self, name: str) -> JointMap:
        """Return the entry of a joint; the default without one."""
        return self.joints.get(name, JointMap())

    def title(self, name: str, quantity: str) -> str:
        """Return what the log calls the joint of a quantity."""
        entry = self.joint(name)
        others = {"velocity": entry.velocity} | dict.fromkeys(COMMANDS, entry.command)
        return others.get(quantity) or entry.log or name

    def converted(self, name: str, kind: str, values: FloatArray) -> FloatArray:
        """Return a column of the file in the terms of the model; a force has the sign alone."""
        entry, values = self.joint(name), self.joint(name).sign * values
        if kind in ANGLES or kind == "velocity":
            unit = np.deg2rad(1.0) if self.unit == "deg" else 1.0
            values = entry.scale * unit * values
        if kind in ANGLES:
            values = values + entry.offset_rad
        if kind == "velocity":
            values = entry.velocity_scale * values
        if kind in COMMANDS:
            values = entry.command_scale * values + entry.command_offset
        return values

    def check_joints(self, known: Mapping[str, Any]) -> None:
        """Raise an error for a joint of the map that a log lacks."""
        tables = [self.joints, *dict(self.control).values()]
        for table in tables:
            for name in table if isinstance(table, dict) else ():
                if name not in known:
                    has = first_names([*known])
                    reason = f"the log has no such joint; it has {has}"
                    raise FileError("--map", name, reason)


def with_joints(mapped: LogMap, changes: Mapping[str, dict[str, Any]]) -> LogMap:
    """Return a map with other fields of joints."""
    joints = dict(mapped.joints)
    for name, change in changes.items():
        joints[name] = mapped.joint(name).model_copy(update=change)
    return mapped.model_copy(update={"joints": joints})


def read_map(file: Path | None) -> LogMap:
    """Return the content of a map file; the default without one.

    Raises:
        FileError: The file is missing or wrong.
    """
    if file is None:
        return LogMap()
    with reading(file, FileError) as content:
        return LogMap.model_validate(toml_document(content))


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
        action: What the policy returned, shape [N, C]; no column without.
        mapped: The map by which it was read.
        findings: What is not known of the log.
        mistakes: What is wrong in the log, and what was done about it.
        is_usable: Whether every mistake is corrected, so that the physics can be compared.
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
    action: FloatArray
    mapped: LogMap
    position_noise: FloatArray = field(init=False)
    velocity_noise: FloatArray = field(init=False)
    findings: list[str] = field(default_factory=list)
    mistakes: list[str] = field(default_factory=list)
    is_usable: bool = True

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

    def held_rows(self) -> NDArray[np.intp]:
        """Return the row of the command that holds at each sample, shape [N]."""
        rows = np.searchsorted(self.command_time_s, self.time_s, side="right") - 1
        return np.maximum(rows, 0)

    def held_command(self) -> FloatArray:
        """Return the command that holds at each sample, shape [N, C]."""
        return self.command[self.held_rows()]


def best_columns(first: FloatArray, second: FloatArray) -> tuple[Any, FloatArray]:
    """Return the column of a table that each column of another one follows, up to its sign, and all correlations."""
    # A constant has no correlation; the trend avoids a division by zero.
    trend, count = 1e-9 * np.arange(len(first)), first.shape[1]
    match = np.corrcoef(np.hstack([first, second]).T + trend)[:count, count:]
    return linear_sum_assignment(np.abs(match), maximize=True)[1], match


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
