"""Noise of residuals that are not white: what a model leaves out lasts.

It is a white part and one that decays by the same share in each sample. Residual maximum likelihood (Patterson and
Thompson, Biometrika 58, 1971) finds both: it counts out what the unknowns take up of the noise.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_banded
from scipy.optimize import minimize
from scipy.special import expit

from gauge_envs.scene.geometry import FloatArray

LASTING = (0.0, 2.0, 4.0)
"""Logits of the decay from which the search for the noise starts."""


def _factor(table: FloatArray) -> FloatArray:
    """Return the triangular factor of a table; that of its Gram matrix is faster, but squares small numbers away."""
    try:
        return np.asarray(np.linalg.cholesky(table.T @ table))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.qr(table, mode="r"))


def _shocks(columns: FloatArray, decay: float, forgotten: float) -> FloatArray:
    """Return e of x[k] - decay x[k-1] = e[k] - forgotten e[k-1] for columns of x; scipy.signal imports in 0.3 s."""
    right = columns.copy()
    right[1:] -= decay * columns[:-1]
    bands = np.ones((2, len(columns)))
    bands[1] = -forgotten
    return np.asarray(solve_banded((1, 0), bands, right))


def lasting_noise(parts: Sequence[FloatArray]) -> tuple[float, float, float]:
    """Return the noise of residuals by residual maximum likelihood.

    Args:
        parts: Of each part of a log columns that span what the unknowns can change, and the residuals.

    Returns:
        Its variance, the covariance of neighbouring samples, and the share of it that each further sample keeps.
    """

    def whitened(logits: FloatArray) -> tuple[float, float, float, float]:
        """Return the two numbers of the process, the sum of its squared shocks, and what is to be minimized."""
        decay = min(float(expit(logits[0])), 1.0 - 1e-6)
        forgotten = decay * float(expit(logits[1]))
        table = np.concatenate([_shocks(part, decay, forgotten) for part in parts])
        # The factor ends with the length of the residual that the other columns leave.
        diagonal = np.abs(np.diag(_factor(table)))
        power = max(float(diagonal[-1] ** 2), 1e-300)
        freedom = len(table) - len(diagonal) + 1
        shock = power / freedom
        return (
            decay,
            forgotten,
            shock,
            freedom * np.log(shock) + 2.0 * np.log(diagonal[:-1]).sum(),
        )

    found = [
        minimize(lambda logits: whitened(logits)[3], [first, 0.0], method="Nelder-Mead")
        for first in LASTING
    ]
    decay, forgotten, shock, _ = whitened(min(found, key=lambda one: float(one.fun)).x)
    apart = shock * (decay - forgotten) / (1.0 - decay**2)
    return shock + apart * (decay - forgotten), apart * (1.0 - decay * forgotten), decay
