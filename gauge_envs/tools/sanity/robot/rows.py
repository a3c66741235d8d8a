"""All rows on a robot: each module adds its functions to `ROWS` as it is imported."""

from gauge_envs.tools.sanity.robot import (
    rollout,
    sides,
    solver_agreement,
    whole_rows,
)
from gauge_envs.tools.sanity.robot.model_rows import ROWS

__all__ = ["ROWS", "rollout", "sides", "solver_agreement", "whole_rows"]
