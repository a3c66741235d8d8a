"""Control tasks whose true optimum a law gives: what a policy earns beyond it, reality will not pay."""

from gauge_envs.envs.control.env import ControlEnv
from gauge_envs.envs.control.limit import Ending, Limit, LimitReport
from gauge_envs.envs.control.pendulum import PendulumLimit
from gauge_envs.envs.control.play import Policy, engine_limit, play
from gauge_envs.envs.control.slope_slider import SlopeSliderLimit
from gauge_envs.envs.control.tasks import ControlTask, control_tasks, find_control_task, register_control_tasks
from gauge_envs.envs.control.turntable import TurntableLimit
from gauge_envs.envs.control.wrapper import ReportLimit

__all__ = [
    "ControlEnv",
    "ControlTask",
    "Ending",
    "Limit",
    "LimitReport",
    "PendulumLimit",
    "Policy",
    "ReportLimit",
    "SlopeSliderLimit",
    "TurntableLimit",
    "control_tasks",
    "engine_limit",
    "find_control_task",
    "play",
    "register_control_tasks",
]
