"""Turn the turntable as fast as the cube can take it."""

from __future__ import annotations

import math

from gauge_envs.envs.control.friction import FrictionLimit
from gauge_envs.scene.timing import FRAME_RATE_HZ

__all__ = [
    "TurntableLimit",
]


class TurntableLimit(FrictionLimit):
    """Turn as fast as possible without the cube slipping; the scene is that of Turntable-1.

    On a level plate that turns with omega and speeds up with alpha, a cube at the radius r uses the friction
    sqrt((omega^2 r)^2 + (alpha r)^2) / g. So the law is omega^2 r = mu g at a steady speed, 6.5 to 7.0 rad/s here. The
    cube does not tip first: it is as wide as it is high, and mu is below 1. `FrictionLimit` has reward and proof.

    A simulated cube creeps outward, so that the same speed uses more and more friction; a policy sees the friction that
    is used at the place where the cube is.
    """

    FAMILY = "Turntable"
    SUBTASK = "1"
    LAW = "sqrt((omega^2 r)^2 + (alpha r)^2) / g <= mu, so at a steady speed omega^2 r = mu g"
    SIGMA_SOURCE = (
        "no trial shows where cubes slip on the turntable: the relative uncertainty of the same cube's friction on the "
        "slope, where calibrated coefficients and 19 or 20 trials are known, measured by the same method"
    )

    DURATION_S = 5.0
    """1.2 s to the limit at full acceleration, and three times as long to hold it."""

    ACCELERATION_RAD_PER_S2 = 6.0
    """Reaches the limit in 1.2 s; in itself it uses a friction of 0.046, which adds less than 1 % to the limit's."""

    _APPROACH_S = 2.0 / FRAME_RATE_HZ
    """Time constant with which the law's policy goes to its speed; two steps are the least that is smooth."""

    def _law_command(self, fraction: float) -> float:
        """Towards omega = sqrt(fraction mu g / r), with r where the cube is now."""
        gravity = self.experiment.scene.gravity_m_per_s2
        wanted = math.sqrt(fraction * self.limit.value * gravity / self._cube_radius_m)
        return (wanted - self._rate) / self._APPROACH_S / self.ACCELERATION_RAD_PER_S2
