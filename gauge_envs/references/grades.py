"""The grade of a reference, in a module that imports nothing heavy."""

from enum import StrEnum


class BandGrade(StrEnum):
    """Quality of the real reference of a variant, best first."""

    TRIALS = "trials"
    """Mean and sigma per frame over real trials."""
    RECORDING = "recording"
    """Mean from the published recording of one trial, sigma from the published baseline or the measurement."""
    LAW = "law"
    """Mean from a closed form that holds under a stated condition, sigma from the published baseline or measurement."""
    MODEL = "model"
    """Solution of the calibrated scene by several engines, with its uncertainty. It says nothing of reality."""
    NONE = "none"
    """No reference: no score."""

    @property
    def is_real(self) -> bool:
        """Whether the mean was measured. The motion of a law or a model starts at frame 0, so it is not aligned."""
        return self in (BandGrade.TRIALS, BandGrade.RECORDING)

    @property
    def is_solution(self) -> bool:
        """Whether the mean solves the stated scene: a distance from it is an error of the engine, not of reality."""
        return self in (BandGrade.LAW, BandGrade.MODEL)
