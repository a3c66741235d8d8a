"""Agreement of a motion with a physical law, after the paper's physical-consistency analysis (appendix)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.errors import ShapeError


def fitted_acceleration(times_s: ArrayLike, displacement_m: ArrayLike) -> float:
    """Return the acceleration of a motion from rest, by least squares of s = b + a t^2 / 2 (paper).

    Args:
        times_s: Times since the release, shape [sample_count], s.
        displacement_m: Signed displacement along the direction of motion, shape [sample_count], m.

    Returns:
        The acceleration a, m/s^2.
    """
    times_s, displacement_m = np.asarray(times_s, dtype=np.float64), np.asarray(displacement_m, dtype=np.float64)
    if times_s.ndim != 1 or displacement_m.shape != times_s.shape:
        raise ShapeError(f"times_s has shape {times_s.shape}, displacement_m {displacement_m.shape}; one for each time")
    if not (np.isfinite(times_s).all() and np.isfinite(displacement_m).all()):
        raise ShapeError("times and values must be finite; leave missing samples out, with their times")
    if len(np.unique(times_s)) < 2:
        raise ShapeError(f"{len(np.unique(times_s))} different times; at least 2 are needed")
    terms = np.vander(times_s**2, 2, increasing=True)
    return 2 * float(np.linalg.lstsq(terms, displacement_m, rcond=None)[0][1])
