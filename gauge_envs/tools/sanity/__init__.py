"""Sanity check of a training configuration: which physics it gets wrong, and which setting is responsible.

Example:
    >>> from gauge_envs.tools.sanity import check
    >>> report = check("mujoco", only=["rebound"])
    >>> [row.verdict.value for row in report.rows]
    ['inside']
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.against import Change, ChangeRow, Comparison, compare
    from gauge_envs.tools.sanity.exchange.export import export
    from gauge_envs.tools.sanity.exchange.judge import judge
    from gauge_envs.tools.sanity.exchange.loop import run as run_exported
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
    from gauge_envs.tools.sanity.page import save_sanity_page
    from gauge_envs.tools.sanity.robot.foot import FootGeometry
    from gauge_envs.tools.sanity.run import check
    from gauge_envs.tools.sanity.stacks import configuration
    from gauge_envs.tools.sanity.stacks.gymnasium_env import Target
    from gauge_envs.tools.sanity.stacks.newton import newton_configuration

__all__ = [
    "BackendMuJoCoWarp",
    "Cause",
    "Change",
    "ChangeRow",
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
    "export",
    "judge",
    "newton_configuration",
    "run_exported",
    "save_sanity_page",
]

_LAZY = {
    **dict.fromkeys(("Change", "ChangeRow", "Comparison", "compare"), "against"),
    "BackendMuJoCoWarp": "mujoco_warp_run",
    "FootGeometry": "robot.foot",
    "Target": "stacks.gymnasium_env",
    "check": "run",
    "configuration": "stacks",
    "export": "exchange.export",
    "judge": "exchange.judge",
    "newton_configuration": "stacks.newton",
    "run_exported": "exchange.loop:run",
    "save_sanity_page": "page",
}
"""Modules of the names, which are imported at first use; of all others, `model`."""


if not TYPE_CHECKING:  # With this function, a type checker would accept any name.

    def __getattr__(name: str) -> Any:
        """Return a name of this tool, imported at its first use (PEP 562)."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        module, _, other = _LAZY.get(name, "model").partition(":")
        value = getattr(import_module(f"{__name__}.{module}"), other or name)
        globals()[name] = value
        return value
