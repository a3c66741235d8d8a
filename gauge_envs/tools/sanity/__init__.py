"""Sanity check of a training configuration: which checks of its physics fail, and which change of settings fixes most.

A target passes through the modules in this order, which `run` calls.

1. `readers` return a `TrainingConfiguration`, with the target's own model, a `robot`, where it has one.
2. `model_checks` run and check the target itself.
3. `object_checks` run scenes of measured objects with the target's settings.
4. `fixes` apply documented changes, run the checks again, and write the fixed file.
5. `screen` shows the `report`; `comparison` compares two reports.

Example:
    >>> from gauge_envs.tools.sanity import check
    >>> report = check("mujoco", only=["rebound"])
    >>> [result.verdict.value for result in report.checks]
    ['passed']
"""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.comparison import difference as difference
    from gauge_envs.tools.sanity.readers import configuration as configuration
    from gauge_envs.tools.sanity.readers.gymnasium_env import Target as Target
    from gauge_envs.tools.sanity.report import Fix as Fix, Report as Report
    from gauge_envs.tools.sanity.robot.foot import FootGeometry as FootGeometry
    from gauge_envs.tools.sanity.run import check as check
    from gauge_envs.tools.sanity.training import (
        ContactGroup as ContactGroup,
        Need as Need,
        TrainingConfiguration as TrainingConfiguration,
    )
    from gauge_envs.tools.sanity.verdict import (
        PartOutcome as PartOutcome,
        Reality as Reality,
        RealityKind as RealityKind,
        SanityResult as SanityResult,
        SanityVerdict as SanityVerdict,
    )
    from gauge_envs.tools.sanity.wrapper import (
        SanityWarning as SanityWarning,
        SanityWrapper as SanityWrapper,
    )
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".comparison": ["difference"],
            ".readers": ["configuration"],
            ".readers.gymnasium_env": ["Target"],
            ".report": ["Fix", "Report"],
            ".robot.foot": ["FootGeometry"],
            ".run": ["check"],
            ".training": ["ContactGroup", "Need", "TrainingConfiguration"],
            ".verdict": [
                "PartOutcome",
                "Reality",
                "RealityKind",
                "SanityResult",
                "SanityVerdict",
            ],
            ".wrapper": ["SanityWarning", "SanityWrapper"],
        },
    )
