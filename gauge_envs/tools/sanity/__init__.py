"""Sanity check of a training configuration: which checks of its physics fail, and which change of settings fixes most.

A target passes through the modules in this order, which `run` calls.

1. `readers` return a `TrainingConfiguration`, with the target's own model, a `robot`, where it has one.
2. `static_rules` compare the numbers of the target with each other, `model_checks` run it, and `causes` joins
   effects to their causes.
3. `object_checks` run scenes of measured objects with the target's settings.
4. `fixes` apply documented changes, run the checks again, and write the fixed file.
5. `report` shows what `verdict` defines; `comparison` compares two reports.

Example:
    >>> from gauge_envs.tools.sanity import check
    >>> report = check("mujoco", only=["rest-height"])
    >>> [result.verdict.value for result in report.checks]
    ['passed']
"""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.readers import configuration as configuration
    from gauge_envs.tools.sanity.run import check as check
    from gauge_envs.tools.sanity.verdict import (
        Fix as Fix,
        Reality as Reality,
        Report as Report,
        SanityResult as SanityResult,
        SanityVerdict as SanityVerdict,
        TrainingConfiguration as TrainingConfiguration,
    )
    from gauge_envs.tools.sanity.wrapper import (
        SanityWarning as SanityWarning,
        SanityWrapper as SanityWrapper,
    )
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".readers": ["configuration"],
            ".run": ["check"],
            ".verdict": [
                "Fix",
                "Reality",
                "Report",
                "SanityResult",
                "SanityVerdict",
                "TrainingConfiguration",
            ],
            ".wrapper": ["SanityWarning", "SanityWrapper"],
        },
    )
