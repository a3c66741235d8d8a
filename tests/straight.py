"""The acceleration of a motion from rest, as the paper measures it."""

import numpy as np


def fitted_acceleration(times_s, displacement_m):
    """a [m/s^2] of s = b + a t^2 / 2 by least squares, from displacements along the motion, shape [sample_count]."""
    terms = np.vander(np.square(times_s, dtype=float), 2, increasing=True)
    return 2 * float(
        np.linalg.lstsq(terms, np.asarray(displacement_m, dtype=float), rcond=None)[0][
            1
        ]
    )
