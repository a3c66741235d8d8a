"""What `gauge transfer` and the commands below it print with `--json`, a line each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, TypedDict

from gauge_envs.cli.schemas import Form
from gauge_envs.tools.transfer.estimates import Estimate
from gauge_envs.tools.transfer.policy_replays import ReplayWorld
from gauge_envs.tools.transfer.ranges import JustifiedRange, LeftOut
from gauge_envs.tools.transfer.settings_replay import SettingsReport
from gauge_envs.tools.transfer.transfer import WorldTransfer


class Named(TypedDict):
    """The name of a world, as `newton`."""

    world: str


WorldLine = Annotated[
    WorldTransfer,
    Form(
        without=("world",),
        more=Annotated[ReplayWorld, Form(without=("name",), more=Named)],
    ),
]
"""What policies keep in one world, and what that world is."""


class VerdictLine(TypedDict):
    """The result over all worlds.

    Attributes:
        kind: `verdict`.
        task: Id of the task.
        policies: Names of the policies.
        starts: Number of starts.
        kept: Share of the reward that is kept, mean over the other worlds.
        first_fall: Name of the first world in which the policies fall.
        left_out: Why worlds could not be run, by name.
        repeats: First world with the same rewards to the last digit, by the name of each later one.
        verdict: The result in words.
    """

    kind: Literal["verdict"]
    task: str
    policies: Sequence[str]
    starts: int
    kept: Estimate
    first_fall: str | None
    left_out: Mapping[str, str]
    repeats: Mapping[str, str]
    verdict: str


TransferLine = WorldLine | VerdictLine
"""First each world, the training before the others, then the result."""


@dataclass(frozen=True, kw_only=True)
class SettingsLine(SettingsReport):
    """What policies keep with other settings of the engine.

    Attributes:
        verdict: The result in words.
    """

    verdict: str


@dataclass(frozen=True, kw_only=True)
class RangeLine(JustifiedRange):
    """A range that data justify.

    Attributes:
        kind: `range`.
        subject: Id or robot file.
    """

    kind: Literal["range"]
    subject: str


@dataclass(frozen=True, kw_only=True)
class LeftOutLine(LeftOut):
    """A constant without a range.

    Attributes:
        kind: `left_out`.
        subject: Id or robot file.
    """

    kind: Literal["left_out"]
    subject: str


RandomizeLine = RangeLine | LeftOutLine
"""First each range, then what has none."""
