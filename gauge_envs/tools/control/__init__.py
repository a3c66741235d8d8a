"""Control tasks with a true optimum from a law: a policy that earns more exploits an error of the simulator."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.control.env import ControlEnv as ControlEnv
    from gauge_envs.tools.control.limit import LimitReport as LimitReport
    from gauge_envs.tools.control.play import Policy as Policy, play_paid as play_paid
    from gauge_envs.tools.control.tasks import (
        control_tasks as control_tasks,
        find_control_task as find_control_task,
    )
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".env": ["ControlEnv"],
            ".limit": ["LimitReport"],
            ".play": ["Policy", "play_paid"],
            ".tasks": ["control_tasks", "find_control_task"],
        },
    )
