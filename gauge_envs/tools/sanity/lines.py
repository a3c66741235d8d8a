"""What `gauge sanity` and `gauge list phenomena` print with `--json`, a line each."""

from typing import Annotated, TypedDict

from gauge_envs.cli.schemas import Form
from gauge_envs.tools.sanity.comparison import ChangeRow, Comparison
from gauge_envs.tools.sanity.model import (
    PhenomenonResult,
    RealityKind,
    Report,
    TrainingConfiguration,
)

Configuration = Annotated[TrainingConfiguration, Form(without=("robot", "stated"))]


class PhenomenonLine(TypedDict):
    """A row that a sanity check can have.

    Attributes:
        id: Its id.
        title: Title.
        kind: What it is compared with.
        reality: Value and interval of reality, in words.
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


class Checked(TypedDict):
    """The checked configuration, without its model."""

    configuration: Configuration


class Both(TypedDict):
    """Both configurations, without their models."""

    trained: Configuration
    deployed: Configuration


ReportLine = Annotated[
    Report,
    Form(
        without=("rows", "configuration"),
        properties=("worst", "unmeasured", "counts"),
        more=Checked,
    ),
]
ResultLine = Annotated[PhenomenonResult, Form(without=("curve",))]
ComparisonLine = Annotated[
    Comparison, Form(without=("rows", "trained", "deployed"), more=Both)
]

SanityLine = ReportLine | ResultLine | ComparisonLine | ChangeRow
"""First the configuration, then each phenomenon; with --against first both configurations, then each quantity."""
