"""The kind of a reference; this module imports nothing heavy."""

from enum import StrEnum


class Kind(StrEnum):
    """What the motion of a reference is."""

    TRIALS = "trials"
    """Mean and scatter of several measured motions."""
    RECORDING = "recording"
    """One measured motion."""
    PUBLISHED = "published"
    """Mean and scatter computed from published numbers of real trials; no motion was measured."""
    ANALYTIC = "analytic"
    """Closed form of the scene of the task file."""
    NUMERICAL = "numerical"
    """Refined numerical solution of the scene of the task file."""
    NONE = "none"
    """No reference motion; events may still have real values."""

    @property
    def is_real(self) -> bool:
        """Whether the motion was measured, so that a distance from it is a distance from reality."""
        return self in (Kind.TRIALS, Kind.RECORDING)

    @property
    def is_mean_of_trials(self) -> bool:
        """Whether the motion is the mean of real trials, measured or computed from published numbers."""
        return self in (Kind.TRIALS, Kind.PUBLISHED)

    @property
    def is_solution(self) -> bool:
        """Whether the motion solves the scene of the task file: a distance from it is the error of an engine."""
        return self in (Kind.ANALYTIC, Kind.NUMERICAL)
