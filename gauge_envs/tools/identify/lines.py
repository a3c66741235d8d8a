"""What `gauge recipe joint` prints with `--json`."""

from collections.abc import Sequence
from typing import Literal, NotRequired, TypedDict

from gauge_envs.tools.identify.identified import Setting


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
        cosine: Of free swings: the error of a decaying cosine of three numbers, fitted to the same logs [mrad].
        motion: Root mean square of the motion, which is the error of a constant [mrad].
        noise: White noise of the sensor, from what the fit leaves [mrad].
        pattern: What is left looks like: offset, lag or drag, with its share of the squares; or "".
    """

    log: str
    used: Literal["fitted", "held out"]
    joint: int
    joint_name: str
    error: float
    command: NotRequired[float]
    lag: NotRequired[float]
    cosine: NotRequired[float]
    motion: float
    noise: float
    pattern: str


class LawLine(TypedDict):
    """A law of friction.

    Attributes:
        name: Its name.
        fitted: Root mean square error of fits to each log alone [mrad].
        held_out: That of predictions of the other logs [mrad].
        is_as_good: Whether the logs do not tell it from the law that predicts best.
    """

    name: str
    fitted: float
    held_out: float
    is_as_good: bool


class JointLine(TypedDict):
    """Identified settings of joints in an engine, and the errors that are left."""

    engine: str
    files: int
    laws: Sequence[LawLine]
    settings: Sequence[Setting]
    trades: Sequence[str]
    errors: Sequence[LogError]
