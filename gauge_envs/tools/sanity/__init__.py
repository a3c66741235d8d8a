"""Sanity check of a training configuration: which physics it gets wrong, and which setting is responsible.

Example:
    >>> from gauge_envs.tools.sanity import check
    >>> report = check("mujoco", only=["rebound"])
    >>> [row.verdict.value for row in report.rows]
    ['inside']
"""

from typing import TYPE_CHECKING

from gauge_envs.registry import door

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.comparison import (
        Comparison as Comparison,
        compare as compare,
    )
    from gauge_envs.tools.sanity.model import (
        Cause as Cause,
        ContactGroup as ContactGroup,
        Cure as Cure,
        Curve as Curve,
        GroupOutcome as GroupOutcome,
        Need as Need,
        PhenomenonResult as PhenomenonResult,
        Reality as Reality,
        RealityKind as RealityKind,
        Report as Report,
        SettingTrial as SettingTrial,
        TrainingConfiguration as TrainingConfiguration,
        Verdict as Verdict,
    )
    from gauge_envs.tools.sanity.mujoco_warp_run import (
        BackendMuJoCoWarp as BackendMuJoCoWarp,
    )
    from gauge_envs.tools.sanity.robot.foot import FootGeometry as FootGeometry
    from gauge_envs.tools.sanity.run import check as check
    from gauge_envs.tools.sanity.stacks import configuration as configuration
    from gauge_envs.tools.sanity.stacks.gymnasium_env import Target as Target
    from gauge_envs.tools.sanity.stacks.newton import (
        newton_configuration as newton_configuration,
    )
else:
    __getattr__, __all__ = door(__name__)
