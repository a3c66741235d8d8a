"""What `gauge recipe joint` prints with `--json`."""

from collections.abc import Sequence
from typing import Literal, NotRequired, TypedDict

from gauge_envs.tools.identify.fit import Setting


class LogError(TypedDict):
    """Error of a joint over a log.

    Attributes:
        log: Name of the log.
        used: Whether it was fitted.
        joint: Number of the joint.
        joint_name: Its name.
        error: Root mean square error [mrad], for servos in MuJoCo that of the pasted lines from the recorded start.
        command: Of servos: the error if the angle is the command [mrad].
        lag: Of servos: the error of a lag of five numbers, which is fitted to the same logs [mrad].
        motion: Root mean square of the motion [mrad].
    """

    log: str
    used: Literal["fitted", "held out"]
    joint: int
    joint_name: str
    error: float
    command: NotRequired[float]
    lag: NotRequired[float]
    motion: float


class JointLine(TypedDict):
    """Identified settings of joints in an engine, and the errors that are left."""

    engine: str
    settings: Sequence[Setting]
    errors: Sequence[LogError]
