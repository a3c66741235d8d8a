"""Limit of a law in a control task, its uncertainty, and the result of a policy relative to it."""

from dataclasses import dataclass
from enum import StrEnum


class Ending(StrEnum):
    """How an episode of a control task ended."""

    HELD = "held"
    """The last frame is reached and the cube has not slipped."""
    SLIPPED = "slipped"
    """The cube moved on its carrier."""
    REACHED = "reached"
    """The ball was at its height, or the cube came to rest at its goal."""
    MISSED = "missed"
    """The last frame is reached, and the ball or the cube has not reached its goal."""
    LOST = "lost"
    """The ball or the cube can no longer reach its goal."""
    DIVERGED = "diverged"
    """The simulation diverged."""


FAILED = (Ending.MISSED, Ending.LOST, Ending.DIVERGED)
"""Endings of episodes without a result."""


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The best that a law allows.

    Attributes:
        quantity: The limited quantity, in words.
        unit: Its unit; `1` for a ratio.
        value: The limit, with the constants of the scene.
        sigma: Its standard uncertainty, from the uncertainty of the measured constants.
        law: The law, in words and symbols.
        sigma_source: Source of the uncertainty.
    """

    quantity: str
    unit: str
    value: float
    sigma: float
    law: str
    sigma_source: str


@dataclass(frozen=True, kw_only=True)
class LimitReport:
    """Result of a policy in an episode, and the limit of the law.

    Attributes:
        limit: The best that the law allows.
        reached: Value that the policy reached, in the limit's unit; 0 if the episode failed.
        ending: How the episode ended.
        time_s: Time of the ending [s].
    """

    limit: Limit
    reached: float
    ending: Ending
    time_s: float

    @property
    def ratio(self) -> float:
        """Reached over the limit; above 1 the policy exploits an error of the simulator."""
        return self.reached / self.limit.value

    @property
    def z(self) -> float:
        """Reached minus the limit, in standard uncertainties of the limit."""
        return (self.reached - self.limit.value) / self.limit.sigma
