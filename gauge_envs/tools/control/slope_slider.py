"""Tilt the board as far as the cube holds."""

import math
from collections.abc import Mapping
from typing import ClassVar

from gauge_envs.tools.control.friction import FrictionLimit
from gauge_envs.tools.control.tasks import EPISODE_STEPS


class SlopeSliderLimit(FrictionLimit):
    """Tilt as far as possible without a slip of the cube, in the scene of SlopeSlider-3.

    At rest at the tilt theta the cube uses the friction tan theta. So the law is tan theta = mu: 14.7 to 15.4 degrees
    here. The axle is 38 mm below the board's centre and 0.24 m from the cube. An acceleration of the tilt therefore
    changes the friction used, by up to 3 % of the limit; `FrictionLimit` includes that. See there for reward and proof.
    """

    SCENE = "SlopeSlider-3"
    LAW = "tan(theta) <= mu at rest; while the board accelerates, tangential over normal specific force <= mu"
    SIGMA_SOURCE = (
        "friction of the same cube on the same board in 19 or 20 real trials at 30 degrees: root mean square distance "
        "from the calibrated coefficient"
    )

    STEPS = EPISODE_STEPS["SlopeSlider"]
    """Time of an episode: 1.0 s to the limit at full acceleration and braking, and 4 s to hold it."""

    ACCELERATION_RAD_PER_S2 = 1.0
    """This acceleration reaches the limit in 1.0 s; the real motor takes 1.2 s to 15 degrees."""

    OWN_STEPS_S: ClassVar[Mapping[str, Mapping[str, float]]] = {
        "mujoco": {"default": 1 / 1800, "training": 1 / 180}
    }

    _RAMP_S = 3.0
    """Time in which the law's policy tilts; its acceleration uses only 0.4 % of the friction."""

    def _law_command(self, fraction: float) -> float:
        """Return the action that tilts to tan theta = fraction mu along two parabolas, and stays there."""
        half_s = 0.5 * self._RAMP_S
        command = (
            math.atan(fraction * self.limit.value)
            / half_s**2
            / self.ACCELERATION_RAD_PER_S2
        )
        if self.time_s < half_s:
            return command
        return -command if self.time_s < self._RAMP_S else 0.0
