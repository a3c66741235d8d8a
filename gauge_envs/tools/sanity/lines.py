"""What `gauge sanity` and `gauge list phenomena` print with `--json`, a line each."""

from typing import Annotated, TypedDict

from gauge_envs.cli.schemas import Form
from gauge_envs.tools.sanity.comparison import Difference, DifferenceRow
from gauge_envs.tools.sanity.model import (
    PhenomenonResult,
    RealityKind,
    Report,
    TrainingConfiguration,
)

Configuration = Annotated[TrainingConfiguration, Form(without=("robot",))]


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


ReportLine = Annotated[
    Report,
    Form(
        without=("rows", "configuration"),
        properties=("worst", "unmeasured", "counts"),
        more=Checked,
    ),
]
DifferenceLine = Annotated[Difference, Form(without=("rows",))]

SanityLine = ReportLine | PhenomenonResult | DifferenceLine | DifferenceRow
"""First the configuration, then each phenomenon; with --against first both targets, then each row."""
