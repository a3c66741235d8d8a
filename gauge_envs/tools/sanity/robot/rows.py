"""All rows on a robot: each module adds its functions to `ROWS` as it is imported."""

from gauge_envs.tools.sanity.robot import (
    ground_rows,
    joint_rows,
    mass_rows,
    rollout,
)
from gauge_envs.tools.sanity.robot.finding import ROWS

__all__ = ["ROWS", "ground_rows", "joint_rows", "mass_rows", "rollout"]
