"""Define what a foot meets on the ground: friction and restitution of both materials combined."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FootContact:
    """Friction and restitution of a foot on the ground, after the materials of both are combined.

    Ranges have equal ends where training does not randomize.

    Attributes:
        friction: Least and greatest coefficient of sliding friction.
        static_friction: Least and greatest coefficient of static friction.
        restitution: Least and greatest restitution.
        source: Origin of both materials, and how they are combined.
    """

    friction: tuple[float, float]
    static_friction: tuple[float, float]
    restitution: tuple[float, float]
    source: str

    @property
    def mean_friction(self) -> float:
        """Centre of the range of sliding friction."""
        return 0.5 * sum(self.friction)

    @property
    def mean_restitution(self) -> float:
        """Centre of the range of restitution."""
        return 0.5 * sum(self.restitution)

    @property
    def text(self) -> str:
        """Coefficients and their origin in one line."""
        static = "" if self.static_friction == self.friction else f" (static {_range_text(self.static_friction)})"
        restitution = _range_text(self.restitution)
        return f"friction {_range_text(self.friction)}{static}, restitution {restitution}: {self.source}"


def _range_text(ends: tuple[float, float]) -> str:
    low, high = ends
    return f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
