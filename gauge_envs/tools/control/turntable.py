"""Turn the turntable as fast as the cube holds."""

import math
from collections.abc import Mapping
from typing import ClassVar

from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.control.friction import FrictionLimit
from gauge_envs.tools.control.tasks import EPISODE_STEPS


class TurntableLimit(FrictionLimit):
    """Turn as fast as possible without a slip of the cube, in the scene of Turntable-1.

    On a level plate with angular velocity omega and angular acceleration alpha, a cube at the radius r uses the
    friction sqrt((omega^2 r)^2 + (alpha r)^2) / g. So the law at a steady speed is omega^2 r = mu g: 6.5 to 7.0 rad/s
    here. The cube slips before it tips, because it is as wide as it is high and mu is below 1. See `FrictionLimit` for
    reward and proof.

    A simulated cube creeps outward, so a constant speed uses more and more friction. The observation holds the friction
    used at the current place of the cube.
    """

    SCENE = "Turntable-1"
    LAW = "sqrt((omega^2 r)^2 + (alpha r)^2) / g <= mu, so at a steady speed omega^2 r = mu g"
    SIGMA_SOURCE = (
        "no trial shows where cubes slip on the turntable: the relative uncertainty of the same cube's friction on the "
        "slope, where calibrated coefficients and 19 or 20 trials are known, measured by the same method"
    )

    STEPS = EPISODE_STEPS["Turntable"]
    """Time of an episode: 1.2 s to the limit at full acceleration, and three times as long to hold it."""

    OWN_STEPS_S: ClassVar[Mapping[str, Mapping[str, float]]] = {
        "mujoco": {"training": 1 / 180}
    }

    ACCELERATION_RAD_PER_S2 = 6.0
    """This acceleration reaches the limit in 1.2 s. Its own friction used, 0.046, adds less than 1 % to the limit's."""

    _APPROACH_S = 2.0 / FRAME_RATE_HZ
    """Time constant with which the law's policy approaches its speed; two steps is the shortest that is smooth."""

    def _law_command(self, fraction: float) -> float:
        """Return the action that approaches omega = sqrt(fraction mu g / r), with r the current radius of the cube."""
        gravity = self.experiment.scene.gravity_m_per_s2
        wanted = math.sqrt(fraction * self.limit.value * gravity / self._cube_radius_m)
        return (
            (wanted - float(self._stage.rate[0]))
            / self._APPROACH_S
            / self.ACCELERATION_RAD_PER_S2
        )
