"""Find changes of a robot's model that mend its rows, and for which the robot itself is the better.

Rows are mended one after the other, causes before their effects. For each row, changes are tried in a fixed order: the
physical cause, then the solver, then the gains. One is accepted if the row is mended, the robot still holds its pose,
its servos are no slower, and no other row is worse.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from gauge_envs.tools.sanity.robot import row_remedies, servo_remedies
from gauge_envs.tools.sanity.robot.behaviour import ORDER, Behaviour, tried
from gauge_envs.tools.sanity.robot.remedy import REMEDIES, Remedy, stated_remedy
from gauge_envs.tools.sanity.robot.robot import Robot

EITHER_SIDE = "either side can be the wrong one, and the model does not say which"

NO_REMEDY: Mapping[str, str] = {
    "robot-size": "no unit of lengths fits alone: scale every pos, size, fromto and mesh; the rest is judged then",
    "robot-maker": "write the published numbers, or keep yours with --baseline; the rest is judged then",
    "robot-balance": "masses, lengths or the pose can be wrong, and the model does not say which",
    "robot-level": "either leg can be the wrong one, or a foot itself, and the model does not say which",
    "robot-mirror": EITHER_SIDE,
    "robot-sides": EITHER_SIDE,
    "robot-unlimited": "a joint without a range turns as far as the real one, which the model does not say",
}
"""Why no change of a number mends a row for certain, of rows that may have no remedy."""

NO_NUMBER = "no change of a number mends it without harm"
"""The reason for any other row whose remedies fail."""

# Each module adds its remedies to `REMEDIES` as it is imported.
__all__ = [
    "ORDER",
    "Attempt",
    "Remedies",
    "find_remedies",
    "row_remedies",
    "servo_remedies",
]


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """What became of a remedy.

    Attributes:
        row: Row that it was to mend.
        remedy: The remedy.
        refusal: Why it is none, with the values that were measured; empty for an accepted one.
    """

    row: str
    remedy: Remedy
    refusal: str = ""

    @property
    def line(self) -> str:
        """The remedy, and how far it came."""
        return f"{self.remedy.text} for {self.row}: {self.refusal or 'mends it'}"


@dataclass(frozen=True, kw_only=True)
class Remedies:
    """All remedies of a robot.

    Attributes:
        robot: The robot with all accepted changes.
        attempts: All attempts in the order in which they were made.
        unmended: Why each row that is left has no remedy, by its id.
    """

    robot: Robot
    attempts: tuple[Attempt, ...]
    unmended: Mapping[str, str]

    @property
    def changes(self) -> dict[str, Any]:
        """All accepted changes."""
        found: dict[str, Any] = {}
        for one in self.attempts:
            if not one.refusal:
                found |= one.remedy.changes
        return found

    @property
    def texts(self) -> tuple[str, ...]:
        """All accepted changes in words."""
        texts = (one.remedy.text for one in self.attempts if not one.refusal)
        return tuple(dict.fromkeys(texts))


def find_remedies(robot: Robot, flags: Collection[str]) -> Remedies:
    """Return changes that mend flagged rows of a robot, as measured after each was applied.

    Args:
        robot: The robot.
        flags: Flagged rows; rows without a remedy are left out.
    """
    now, attempts, unmended = Behaviour(robot), [], []
    for name in ORDER:
        if name not in flags or not now.row(name).is_flag:
            continue
        for remedy in REMEDIES.get(name, stated_remedy(name))(now.robot):
            after, refusal = tried(now, remedy, name)
            rival = remedy.rival
            if after is not None and rival and tried(now, rival, name)[0]:
                after, refusal = None, f"and so does {rival.text}"
            attempts.append(Attempt(row=name, remedy=remedy, refusal=refusal))
            if after is not None:
                now = after
                break
        else:
            unmended.append(name)
            if name in ("robot-maker", "robot-size"):
                # Nothing else can be judged before published numbers, or the unit of lengths, are right.
                break
    # What mends a row may mend one before it too.
    left = [name for name in unmended if now.row(name).is_flag]
    reasons = {name: NO_REMEDY.get(name, NO_NUMBER) for name in left}
    return Remedies(robot=now.robot, attempts=tuple(attempts), unmended=reasons)
