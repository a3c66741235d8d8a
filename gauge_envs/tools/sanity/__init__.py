"""Sanity check of a training configuration: which physics it gets wrong, and which setting is responsible.

Example:
    >>> from gauge_envs.tools.sanity import check
    >>> report = check("mujoco", only=["rebound"])
    >>> [row.verdict.value for row in report.rows]
    ['inside']
"""

from typing import TYPE_CHECKING

from gauge_envs.tools import door

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.comparison import Comparison, compare
    from gauge_envs.tools.sanity.model import (
        Cause,
        ContactGroup,
        Cure,
        Curve,
        GroupOutcome,
        Need,
        PhenomenonResult,
        Reality,
        RealityKind,
        Report,
        SettingTrial,
        TrainingConfiguration,
        Verdict,
    )
    from gauge_envs.tools.sanity.mujoco_warp_run import BackendMuJoCoWarp
    from gauge_envs.tools.sanity.robot.foot import FootGeometry
    from gauge_envs.tools.sanity.run import check
    from gauge_envs.tools.sanity.stacks import configuration
    from gauge_envs.tools.sanity.stacks.gymnasium_env import Target
    from gauge_envs.tools.sanity.stacks.newton import newton_configuration

__all__ = [
    "BackendMuJoCoWarp",
    "Cause",
    "Comparison",
    "ContactGroup",
    "Cure",
    "Curve",
    "FootGeometry",
    "GroupOutcome",
    "Need",
    "PhenomenonResult",
    "Reality",
    "RealityKind",
    "Report",
    "SettingTrial",
    "Target",
    "TrainingConfiguration",
    "Verdict",
    "check",
    "compare",
    "configuration",
    "newton_configuration",
]

if not TYPE_CHECKING:  # With it, a type checker would accept any name.
    __getattr__ = door(
        __name__,
        *("model", "robot.foot", "stacks", "run", "comparison", "stacks.gymnasium_env", "stacks.newton"),
        "mujoco_warp_run",
    )
