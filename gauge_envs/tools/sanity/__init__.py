"""Sanity check of a training configuration: which physics it gets wrong, and which setting is responsible.

A target passes through the modules in this order. `run` calls them for a check, `comparison` for two targets.

1. `stacks`: a reader returns a `TrainingConfiguration`; `robot` reads models of MuJoCo.
2. `phenomena` state scenes and reality; `measure` runs them by `scenario`, and gives verdicts.
3. `target_checks` judge what is stated: gravity, memory for contacts, and the robot's own model.
4. `cause` finds the setting that is responsible for a row.
5. `cure` proposes changes, applies them and measures again.
6. `words` and `formats` write the report.

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
        Need as Need,
        PartOutcome as PartOutcome,
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
    from gauge_envs.tools.sanity.robot.solver_agreement import (
        solver_differences as solver_differences,
    )
    from gauge_envs.tools.sanity.run import check as check
    from gauge_envs.tools.sanity.stacks import configuration as configuration
    from gauge_envs.tools.sanity.stacks.gymnasium_env import Target as Target
    from gauge_envs.tools.sanity.stacks.newton import (
        newton_configuration as newton_configuration,
    )
else:
    __getattr__, __all__ = door(__name__)
