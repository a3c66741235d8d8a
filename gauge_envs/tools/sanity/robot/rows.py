"""All rows on a robot: each module adds its functions to `ROWS` as it is imported."""

from gauge_envs.tools.sanity.robot import (
    alike,
    command_rows,
    consistency_rows,
    ground_rows,
    joint_rows,
    maker_rows,
    mass_rows,
    rollout,
    sides,
    solver_agreement,
    stance_rows,
    stop_rows,
    whole_rows,
    wiring_rows,
)
from gauge_envs.tools.sanity.robot.finding import OF_DRIVES, ROWS
from gauge_envs.tools.sanity.robot.likeness import advised

for _name in OF_DRIVES | {"robot-feet"}:
    ROWS[_name] = advised(_name, ROWS[_name])

__all__ = [
    "ROWS",
    "alike",
    "command_rows",
    "consistency_rows",
    "ground_rows",
    "joint_rows",
    "maker_rows",
    "mass_rows",
    "rollout",
    "sides",
    "solver_agreement",
    "stance_rows",
    "stop_rows",
    "whole_rows",
    "wiring_rows",
]
