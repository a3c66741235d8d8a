"""The recorded mean in the coordinates of a simulation, to be drawn beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gauge_envs.evaluation.reference_path import ReferencePath
from gauge_envs.references.bands import Band, BandGrade
from gauge_envs.scene.timing import FRAME_RATE_HZ

FloatArray = NDArray[np.float64]


def ghost_trajectory(band: Band, g: FloatArray) -> FloatArray:
    """Return the trajectory that is nearest to a simulated one and has the recorded mean.

    A band may state fewer coordinates than g(t) has, as the place along a slope alone. The others are those of the
    simulation, so that a ghost differs from the simulated body only where reality was measured.

    Args:
        band: The band.
        g: Simulated g(t) at the 30 Hz frames in the band's unit, shape [frame_count, coordinate_count].

    Returns:
        Trajectory in the coordinates and the unit of g(t), shape [frame_count, coordinate_count]; NaN where the mean is
        not known.
    """
    count = min(len(g), len(band.mean))
    missing = band.mean[:count] - band.project(g[:count])
    ghost = np.full_like(g, np.nan)
    ghost[:count] = g[:count] + missing @ np.linalg.pinv(band.projection).T
    return ghost


def reference_words(grade: BandGrade, trial_count: int | None) -> str:
    """Return what the mean of a band is, in words.

    Args:
        grade: Grade of the band.
        trial_count: Number of its trials; None is unknown.
    """
    if grade is BandGrade.TRIALS:
        if trial_count == 1:
            return "one real trial"
        return f"the mean of {trial_count} real trials" if trial_count else "the mean of the real trials"
    return "one recorded real trial" if grade is BandGrade.RECORDING else "the law that the score compares with"


def reference_text(band: Band | None, path: ReferencePath | None, *, end_s: float, trial: int | None = None) -> str:
    """Return what is drawn of a reference, in words; empty if nothing is.

    Args:
        band: The band, or None.
        path: Its places in space, or None.
        end_s: Time of the last picture [s]. A reference that ends before it has its end in the text.
        trial: Number of the single trial that it is; None for others.
    """
    if band is None or path is None:
        return ""
    text = reference_words(band.grade, band.trial_count) if trial is None else f"real trial {trial}"
    if band.withheld is not None:
        text += ", withheld from scores"
    if not path.is_full:
        text += ", in the measured directions"
    return f"{text}, until {path.last_s:.2f} s" if path.last_s < end_s - 0.5 / FRAME_RATE_HZ else text
