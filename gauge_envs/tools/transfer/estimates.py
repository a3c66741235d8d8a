"""A mean with its interval: what a policy reaches."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A mean with its 95 % interval.

    Attributes:
        value: The mean.
        low: Lower end; None with a single episode, which has no interval.
        high: Upper end; None with a single episode.
    """

    value: float
    low: float | None = None
    high: float | None = None
