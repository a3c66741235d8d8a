"""All rows on the target's own model: each module registers its rows as it is imported."""

from gauge_envs.tools.sanity.itself import free_rows, rest_rows
from gauge_envs.tools.sanity.robot import (
    ground_rows,
    joint_rows,
    mass_rows,
    rollout,
)
from gauge_envs.tools.sanity.rows import ROWS

__all__ = [
    "ROWS",
    "free_rows",
    "ground_rows",
    "joint_rows",
    "mass_rows",
    "rest_rows",
    "rollout",
]
