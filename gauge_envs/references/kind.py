"""The kind of a reference; this module imports nothing heavy."""

from enum import StrEnum


class Kind(StrEnum):
    """What the motion of a reference is."""

    TRIALS = "trials"
    """Mean of several real trials."""
    RECORDING = "recording"
    """One recorded real trial."""
    ANALYTIC = "analytic"
    """Closed form of the calibrated scene."""
    NUMERICAL = "numerical"
    """Refined numerical solution of the calibrated scene."""
    NONE = "none"
    """No reference motion; events may still have real values."""

    @property
    def is_real(self) -> bool:
        """Whether the motion was measured."""
        return self in (Kind.TRIALS, Kind.RECORDING)

    @property
    def is_solution(self) -> bool:
        """Whether the motion solves the calibrated scene, so that a distance from it is the error of an engine."""
        return self in (Kind.ANALYTIC, Kind.NUMERICAL)
