"""Sanity check of a training configuration: which physics it gets wrong, and which setting is responsible.

Example:
    >>> from gauge_envs.tools.sanity import check
    >>> report = check("mujoco", only=["rebound"])
    >>> [row.verdict.value for row in report.rows]
    ['inside']
"""

from gauge_envs.backends import Backend
from gauge_envs.tools.sanity.foot import FootGeometry
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
from gauge_envs.tools.sanity.run import check
from gauge_envs.tools.sanity.target import Target, configuration

__all__ = [
    "Cause",
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
    "configuration",
    "mujoco_warp",
]


def mujoco_warp() -> Backend:
    """Return mujoco_warp on the CPU, with the model that MuJoCo compiles."""
    from gauge_envs.tools.sanity.mujoco_warp_run import BackendMuJoCoWarp

    return BackendMuJoCoWarp()
