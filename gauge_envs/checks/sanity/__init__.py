"""The sanity check of a training configuration: which physics it gets wrong, and which setting is responsible.

Example:
    >>> from gauge_envs.checks.sanity import check
    >>> report = check("mujoco", only=["rebound"])
    >>> [row.verdict.value for row in report.rows]
    ['inside']
"""

from gauge_envs.checks.sanity.check import check
from gauge_envs.checks.sanity.model import (
    Cause,
    Configuration,
    ContactGroup,
    Curve,
    Reality,
    Report,
    Row,
    Trial,
    Verdict,
)
from gauge_envs.checks.sanity.target import Target, configuration

__all__ = [
    "Cause",
    "Configuration",
    "ContactGroup",
    "Curve",
    "Reality",
    "Report",
    "Row",
    "Target",
    "Trial",
    "Verdict",
    "check",
    "configuration",
]
