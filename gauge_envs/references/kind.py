"""The kind of a reference; this module imports nothing heavy."""

from enum import StrEnum


class Kind(StrEnum):
    """What the motion of a reference is."""

    TRIALS = "trials"
    """Mean of several real trials."""
    RECORDING = "recording"
    """One recorded real trial."""
    ANALYTIC = "analytic"
    """Closed form of the scene of the task file."""
    NUMERICAL = "numerical"
    """Refined numerical solution of the scene of the task file."""
    NONE = "none"
    """No reference motion; events may still have real values."""

    @property
    def is_real(self) -> bool:
        """Whether the motion was measured."""
        return self in (Kind.TRIALS, Kind.RECORDING)

    @property
    def is_solution(self) -> bool:
        """Whether the motion solves the scene of the task file: a distance from it is the error of an engine."""
        return self in (Kind.ANALYTIC, Kind.NUMERICAL)
