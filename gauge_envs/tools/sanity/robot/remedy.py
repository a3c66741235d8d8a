"""A change of a robot's model that may mend a row, and where each row has its own."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from gauge_envs.tools.sanity.model import Settings
from gauge_envs.tools.sanity.robot.mended_model import class_words
from gauge_envs.tools.sanity.robot.robot import ELEMENT, Robot
from gauge_envs.tools.sanity.robot.rows import ROWS


@dataclass(frozen=True, kw_only=True)
class Remedy:
    """A change of the model that may mend a row.

    Attributes:
        text: The change in the words of a model.
        changes: The same, by names that `Robot.changed` knows.
        scales_gains: Whether it makes servos weaker or stronger at will, so that they must hold what they held.
        rival: Remedy of which the model does not say whether it is the right one instead; None without one.
        fair_step_s: Half of a step of like joints of the robot, slower than which no servo becomes [s].
    """

    text: str
    changes: Settings
    fair_step_s: float = 0.0
    scales_gains: bool = False
    rival: "Remedy | None" = None


Finder = Callable[[Robot], Iterator[Remedy]]

REMEDIES: dict[str, Finder] = {}
"""Function that yields the remedies of a row, the preferred ones first."""


def remedies_of(*names: str) -> Callable[[Finder], Finder]:
    """Return a decorator that adds the remedies of rows."""

    def add(function: Finder) -> Finder:
        for name in names:
            REMEDIES[name] = function
        return function

    return add


def stated_remedy(name: str) -> Finder:
    """Return the remedy that a row states itself."""

    def found(robot: Robot) -> Iterator[Remedy]:
        finding = ROWS[name](robot)
        if finding.changes:
            yield Remedy(text=finding.advice, changes=dict(finding.changes))

    return found


def in_words(robot: Robot, changes: Settings) -> Remedy:
    """Return changes as a remedy in the words of the model's classes."""
    return Remedy(text=class_words(robot, changes), changes=changes)


def elements_remedy(robot: Robot, changes: Settings) -> Iterator[Remedy]:
    """Yield a remedy in the words of the model's classes, unless it changes nothing."""
    if changes:
        yield in_words(robot, changes)


def changed_rows(changes: Settings, array: str) -> list[int]:
    """Return the rows of an array of the model that are changed."""
    found = [ELEMENT.fullmatch(name) for name in changes]
    return [int(one[2]) for one in found if one is not None and one[1] == array]


def rounded(value: float) -> float:
    """Return two significant digits, as a person writes a setting."""
    return float(f"{value:.2g}")
