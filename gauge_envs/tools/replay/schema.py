"""What `gauge replay` prints with `--json`."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias


class ReplayVerdict(StrEnum):
    """What explains the difference between the model and the log."""

    NOISE = "within the noise"
    """Nothing is left to explain."""
    LOG = "a mistake of the log"
    """The model predicts the log far better by another reading of it."""
    POLICY = "what the policy sees"
    """The observation of the policy is not that of the state."""
    CAUSE = "one cause"
    SEVERAL = "several causes"
    PART = "in part"
    """Causes take most of the error; what is left is no cause of the list."""
    NOTHING = "nothing in the list"


@dataclass(frozen=True)
class Prediction:
    """Predictions of a joint from recorded states.

    Attributes:
        horizon_s: Length of the predictions; one interval of the log for the shortest [s].
        rms: Root mean square of predicted minus recorded [rad or m].
        over_noise: The same over what the noise of the log alone gives.
        over_motion: The same over the motion in that time.
        held_velocity_rms: Error of the baseline that keeps the recorded velocity [rad or m].
    """

    horizon_s: float
    rms: float
    over_noise: float
    over_motion: float
    held_velocity_rms: float


@dataclass(frozen=True)
class JointReport:
    """Predictions of a joint.

    Attributes:
        joint: Name of the joint.
        noise: Standard deviation of the noise of the log [rad or m].
        repeat_rms: Difference to the first log, where two logs have the same commands [rad or m].
        predictions: One for each horizon.
    """

    joint: str
    noise: float
    repeat_rms: float | None
    predictions: tuple[Prediction, ...]


@dataclass(frozen=True)
class Value:
    """A number of a cause.

    Attributes:
        parameter: What it belongs to, as a joint.
        present: Value of the model; None for no limit.
        fitted: Value that explains the log.
        low, high: 95 % interval; None where none was computed.
        changes: Whether there is an interval, and it leaves out the present value.
    """

    parameter: str
    present: float | None
    fitted: float
    low: float | None
    high: float | None
    changes: bool


@dataclass(frozen=True)
class Explained:
    """A candidate.

    Attributes:
        cause: As `delay`.
        text: The cause with its value.
        share: Share of the error beyond the noise that it explains, on pieces of the log that the fit has not seen.
        unit: Unit of the values.
        values: Its numbers.
    """

    cause: str
    text: str
    share: float
    unit: str
    values: tuple[Value, ...]


@dataclass(frozen=True)
class Trial:
    """Predictions before and after the change, from samples spread over the log.

    Attributes:
        joint: The joint that is worst before.
        horizon_s: Length of the predictions.
        before, after: Root mean square error [rad or m].
        unit: Thousandth of their unit, as `mrad`.
    """

    joint: str
    horizon_s: float
    before: float
    after: float
    unit: str


@dataclass(frozen=True)
class ExplanationLine:
    """What a log and a model say of each other.

    Attributes:
        log: The log that is explained.
        baseline: The first of two logs, or None.
        model: The model.
        verdict: What explains the difference.
        sentence: The answer.
        error_over_noise: Mean squared error of predictions of 0.25 s over that of the noise.
        error_after: The same after the best change.
        baseline_over_noise: The same for the first of two logs.
        findings: What the logs do not tell.
        mistakes: What is wrong in the logs; each is corrected where it can be.
        policy: In what observation and action differ from state and command, a sentence each.
        trial: Predictions before and after the change.
        joints: A row a joint.
        candidates: Causes alone, the best first.
        indistinguishable: Causes that the log cannot tell from the first.
        named: The causes that the verdict is about.
        several: Causes that together explain more than one; each share is that of all.
        paste: Lines to paste by stack.
    """

    log: str
    baseline: str | None
    model: str
    verdict: ReplayVerdict
    sentence: str
    error_over_noise: float
    error_after: float
    baseline_over_noise: float | None
    findings: tuple[str, ...]
    mistakes: tuple[str, ...]
    policy: tuple[str, ...]
    trial: Trial
    joints: tuple[JointReport, ...]
    candidates: tuple[Explained, ...]
    indistinguishable: tuple[str, ...]
    named: tuple[Explained, ...]
    several: tuple[Explained, ...]
    paste: Mapping[str, str]


@dataclass(frozen=True)
class ModelLine:
    """Predictions of a model over a horizon, from recorded states.

    Attributes:
        model: The model.
        horizon_s: Length of the predictions [s].
        rms: Root mean square error over the joints [rad or m].
        over_noise: The same over the noise of a motion with the recorded velocity.
        over_nominal: Geometric mean over the pieces of its error over that of the first model.
        low, high: 95 % interval of this ratio.
        better: `nominal`, `yes`, `no`, or `cannot tell`.
    """

    model: str
    horizon_s: float
    rms: float
    over_noise: float
    over_nominal: float
    low: float
    high: float
    better: str


@dataclass(frozen=True)
class ConstantsLine:
    """Constants that were fitted to logs.

    Attributes:
        values: The constants.
        unknown: Constants that the logs do not determine; they keep the present values.
        predictions: Predictions without and with the constants, over each horizon.
        paste: Lines to paste by place.
    """

    values: tuple[Value, ...]
    unknown: tuple[str, ...]
    predictions: tuple[ModelLine, ...]
    paste: Mapping[str, str]


ReplayLine: TypeAlias = ExplanationLine | ModelLine | ConstantsLine
"""A line of `gauge replay --json`: of a log and a model, of each of several models, or of fitted constants."""
