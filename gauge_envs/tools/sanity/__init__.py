"""Sanity check of a training configuration: which checks of its physics fail, and which change of settings fixes most.

A target passes through the modules in this order, which `run` calls.

1. `stacks`: a reader returns a `TrainingConfiguration`, with the target's own model where it has one.
2. `itself` and `robot` run and check this model; `rows` defines their checks.
3. `phenomena` are scenes of measured objects; `measure` runs them by `scenario`, and gives verdicts.
4. `fix` applies documented changes and runs the checks again; `fix_file` writes the fixed file.
5. `report` prints one screen; `comparison` compares two reports.

Example:
    >>> from gauge_envs.tools.sanity import check
    >>> report = check("mujoco", only=["rebound"])
    >>> [row.verdict.value for row in report.rows]
    ['passed']
"""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.comparison import difference as difference
    from gauge_envs.tools.sanity.model import (
        ContactGroup as ContactGroup,
        Fix as Fix,
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
    from gauge_envs.tools.sanity.wrapper import (
        SanityWarning as SanityWarning,
        SanityWrapper as SanityWrapper,
    )
else:
    _public_name, __all__ = lazy_names(
        __name__,
        {
            ".comparison": ["difference"],
            ".model": [
                "ContactGroup",
                "Fix",
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
            ".wrapper": ["SanityWarning", "SanityWrapper"],
        },
    )

    def __getattr__(name):
        """Return a public name; `Cure`, the name of `Fix` before 1.0, is read until 1.2."""
        if name != "Cure":
            return _public_name(name)
        from gauge_envs.tools.sanity.model import warn_renamed

        warn_renamed("Cure", "Fix")
        return _public_name("Fix")
