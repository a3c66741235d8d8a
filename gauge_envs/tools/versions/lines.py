"""What `gauge backend versions` prints with `--json`, a line for each pair of versions."""

from dataclasses import dataclass

from gauge_envs.tools.versions.model import Comparison, Release


@dataclass(frozen=True, kw_only=True)
class VersionsLine(Comparison):
    """What two versions make of a model.

    Attributes:
        tried: Releases that a bisection tried, in their order; empty without one.
    """

    tried: tuple[Release, ...]
