"""What `gauge sanity` and `gauge list phenomena` print with `--json`, a line each."""

from typing import Annotated, TypedDict

from gauge_envs.cli.schemas import Form
from gauge_envs.tools.sanity.comparison import CheckDifference, TargetDifference
from gauge_envs.tools.sanity.verdict import (
    RealityKind,
    Report,
    SanityResult,
    TrainingConfiguration,
)

Configuration = Annotated[TrainingConfiguration, Form(without=("robot",))]


class SanityCheckLine(TypedDict):
    """A check that `gauge sanity` can run.

    Attributes:
        id: Its id.
        title: Title.
        kind: What it compares with.
        reality: Value and interval of reality, as a text.
        trial_count: Number of real trials; 0 for a law.
        source: Source of the value.
        rationale: Reason for the interval.
    """

    id: str
    title: str
    kind: RealityKind
    reality: str
    trial_count: int
    source: str
    rationale: str


class CheckedConfiguration(TypedDict):
    """The checked configuration, without its model."""

    configuration: Configuration


ReportLine = Annotated[
    Report,
    Form(
        without=("checks", "configuration", "screen"),
        properties=("worst", "unmeasured", "counts"),
        more=CheckedConfiguration,
    ),
]
DifferenceLine = Annotated[TargetDifference, Form(without=("checks",))]

ResultLine = Annotated[SanityResult, Form(properties=("severity",))]

SanityLine = ReportLine | ResultLine | DifferenceLine | CheckDifference
"""First the configuration, then each check; with --against first both targets, then each check."""
