"""Sanity check of a training configuration: which physics it gets wrong, and which change corrects most.

A target passes through the modules in this order, which `run` calls.

1. `stacks`: a reader returns a `TrainingConfiguration`; `robot` reads models of MuJoCo.
2. `phenomena` state scenes and reality; `measure` runs them by `scenario`, and gives verdicts.
3. `target_checks` judge what is stated: gravity, the time of one action, and the robot's own model.
4. `cure` applies documented changes and measures again.
5. `words` write the report; `comparison` compares two.

Example:
    >>> from gauge_envs.tools.sanity import check
    >>> report = check("mujoco", only=["rebound"])
    >>> [row.verdict.value for row in report.rows]
    ['inside']
"""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.comparison import difference as difference
    from gauge_envs.tools.sanity.model import (
        ContactGroup as ContactGroup,
        Cure as Cure,
        Need as Need,
        PartOutcome as PartOutcome,
        PhenomenonResult as PhenomenonResult,
        Reality as Reality,
        RealityKind as RealityKind,
        Report as Report,
        TrainingConfiguration as TrainingConfiguration,
        Verdict as Verdict,
    )
    from gauge_envs.tools.sanity.robot.foot import FootGeometry as FootGeometry
    from gauge_envs.tools.sanity.run import check as check
    from gauge_envs.tools.sanity.stacks import configuration as configuration
    from gauge_envs.tools.sanity.stacks.gymnasium_env import Target as Target
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".comparison": ["difference"],
            ".model": [
                "ContactGroup",
                "Cure",
                "Need",
                "PartOutcome",
                "PhenomenonResult",
                "Reality",
                "RealityKind",
                "Report",
                "TrainingConfiguration",
                "Verdict",
            ],
            ".robot.foot": ["FootGeometry"],
            ".run": ["check"],
            ".stacks": ["configuration"],
            ".stacks.gymnasium_env": ["Target"],
        },
    )
