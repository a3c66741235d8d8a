"""What `gauge backend versions` prints with `--json`, a line for each pair of sides."""

from dataclasses import dataclass
from typing import TypeAlias

from gauge_envs.tools.versions.model import (
    Comparison,
    MotionComparison,
    Release,
    ReturnComparison,
)


@dataclass(frozen=True, kw_only=True)
class StepComparison(Comparison):
    """What two versions make of a model.

    Attributes:
        tried: Releases that a bisection tried, in their order; empty without one.
    """

    tried: tuple[Release, ...]


VersionsLine: TypeAlias = StepComparison | MotionComparison | ReturnComparison
"""Steps of a model, motions of an experiment, or returns of a policy."""
