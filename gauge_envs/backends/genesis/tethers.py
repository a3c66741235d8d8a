"""The pull of a string, which Genesis lacks: a stiff spring with critical damping, applied as a force in each step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene import Tether


def pull(
    tether: Tether, state: NDArray[np.float64], mass_kg: float, frequency_per_s: float
) -> NDArray[np.float64] | None:
    """Return the force of a string on the origin of its body [N], shape [3], or None if the string is slack.

    Args:
        tether: The string.
        state: State of the body, shape [13].
        mass_kg: Mass of the body.
        frequency_per_s: Angular frequency of the spring [1/s].
    """
    arm = np.asarray(tether.anchor_m) - state[:3]
    length = float(np.linalg.norm(arm))
    if length <= tether.length_m:
        return None
    along = arm / length
    lengthening = -float(along @ state[7:10])
    size = mass_kg * (frequency_per_s**2 * (length - tether.length_m) + 2.0 * frequency_per_s * lengthening)
    return size * along if size > 0.0 else None
