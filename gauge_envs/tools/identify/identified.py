"""What logs say about joints: numbers with their intervals, laws that were compared, and lines to paste."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gauge_envs.scene.geometry import FloatArray


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Identified number of one joint.

    Attributes:
        joint: Number of the joint in the log.
        joint_name: Its name.
        name: Field of `JointDynamics` or `Servo`.
        value: Its value, in the unit of its name.
        low, high: 95 % interval of the least squares over all logs; of an offset alone it may be below 0.
        std: Its standard error.
        of_files: Values of fits to each log alone.
        of_files_std: Their standard errors.
        next_low, next_high: 95 % interval of the value of the next file; None without a second file.
        between: Standard deviation between files, beyond the uncertainty of each.
        is_known: Whether it was given.
        unknown: Why the data does not determine it, or "".
        pasted: Its value in the lines to paste, where undetermined numbers are as the scene states; None is left out.
    """

    joint: int
    joint_name: str
    name: str
    value: float
    low: float
    high: float
    unknown: str = ""
    pasted: float | None = None
    std: float = 0.0
    of_files: tuple[float, ...] = ()
    of_files_std: tuple[float, ...] = ()
    next_low: float | None = None
    next_high: float | None = None
    between: float | None = None
    is_known: bool = False


@dataclass(frozen=True, kw_only=True)
class Law:
    """How well a law of friction follows logs, each fitted alone.

    Attributes:
        name: Name of the law.
        fitted_rad: Root mean square error of the fits [rad], each from its fitted start.
        held_out_rad: That of predictions of the other logs, from their recorded starts [rad].
        is_as_good: Whether the logs do not tell it from the law that predicts best.
    """

    name: str
    fitted_rad: float
    held_out_rad: float
    is_as_good: bool = False


@dataclass(frozen=True, kw_only=True)
class Identified:
    """What logs say about joints in an engine.

    Attributes:
        engine: Name of the engine.
        settings: The identified numbers, by joint.
        joints: All numbers of each joint by name, also those that the scene states; 0 is none.
        names: Names of the joints.
        lines: Lines to paste.
        stack_lines: Those of a training stack.
        error_rad: Root mean square error of each log that was fitted [rad], by its name, shape [J] each.
        held_out_rad: The same of logs that were not, each from its recorded start.
        motion_rad: Standard deviation of the measured angles of each log [rad].
        plain_rad: Errors of plain laws without a model [rad], by log and law, shape [J] each; see `baselines`.
        noise_rad: Noise of the sensor, from what is left of a fit [rad], shape [J].
        patterns: What is left of each fitted log looks like: words by joint.
        trades: Sentences about numbers that the logs hardly tell apart.
        laws: Laws of friction that were compared, the chosen one first.
        step_rad: By what the fitted logs move with half the step of the engine, root mean square [rad], shape [J].
        files: Number of logs that were fitted.
        is_replayed: Whether the errors are those of the pasted lines in plain MuJoCo, each log from its recorded start.
        simulations: Number of simulated parts of logs.
    """

    engine: str
    settings: tuple[Setting, ...]
    joints: Sequence[Mapping[str, float]]
    error_rad: Mapping[str, FloatArray]
    names: tuple[str, ...] = ()
    lines: str = ""
    stack_lines: str = ""
    held_out_rad: Mapping[str, FloatArray] = field(default_factory=dict)
    motion_rad: Mapping[str, FloatArray] = field(default_factory=dict)
    plain_rad: Mapping[str, Mapping[str, FloatArray]] = field(default_factory=dict)
    noise_rad: FloatArray = field(default_factory=lambda: np.zeros(0))
    patterns: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    trades: tuple[str, ...] = ()
    step_rad: FloatArray = field(default_factory=lambda: np.zeros(0))
    laws: tuple[Law, ...] = ()
    files: int = 1
    is_replayed: bool = False
    simulations: int = 0

    @property
    def lost(self) -> list[str]:
        """Names of the fitted logs of which the error is above a third of the motion, and above 0.01 rad."""
        motion = self.motion_rad
        return [
            name
            for name, error in self.error_rad.items()
            if (error > np.maximum(motion[name] / 3.0, 0.01)).any()
        ]

    @property
    def behind_a_lag(self) -> list[tuple[str, str]]:
        """Fitted logs and joints that a lag, which has no model, follows better, without the lost ones."""
        return [
            (log, self.names[joint])
            for log, error in self.error_rad.items()
            if log not in self.lost and "lag" in self.plain_rad.get(log, {})
            for joint in np.flatnonzero(error > self.plain_rad[log]["lag"])
        ]
