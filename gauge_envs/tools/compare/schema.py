"""JSON lines of `gauge compare --json`; `record` names the type of each line."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, TypedDict

from gauge_envs.cli.schemas import Form
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.scoring.answers import Answer
from gauge_envs.scoring.score import Interval
from gauge_envs.tools.compare.distance import Distance
from gauge_envs.tools.compare.ranks import Mean
from gauge_envs.tools.compare.statistics import ScoreSpread


class RealFacts(TypedDict):
    """Published scores of real trials.

    Attributes:
        mean: Mean.
        std: Standard deviation; null if it was not published.
    """

    mean: float
    std: float | None


class Values(TypedDict):
    """Values of the repeats.

    Attributes:
        values: Value of each repeat; null for a repeat without the metric.
    """

    values: Sequence[float | None]


SpreadFacts = Annotated[ScoreSpread, Form(more=Values)]


class CellFacts(TypedDict):
    """Results of a configuration in an experiment.

    Attributes:
        label: Name of the configuration in tables.
        outcomes: How each repeat ended.
        reasons: Why a repeat was unsupported, failed or diverged, or why its reference does not score it.
        seeds: Seed of each repeat.
        raw: Metric in its unit.
        normalized: Metric divided by its value for real trials, or by the motion of a solution.
        normalized_95: 95 % interval of the mean of `normalized`.
        solves: Whether each repeat solves the scene; null without a solution.
        like_reality: Whether each repeat is like reality; null if nothing real is known.
        settings: Numerical settings of the engine.
        versions: Versions of the packages.
    """

    label: str
    outcomes: Sequence[str]
    reasons: Sequence[str | None]
    seeds: Sequence[int | None]
    raw: SpreadFacts | None
    normalized: SpreadFacts | None
    normalized_95: Interval | None
    solves: Sequence[Answer | None]
    like_reality: Sequence[Answer | None]
    settings: Mapping[str, Any] | None
    versions: Mapping[str, str] | None


CellLine = Annotated[RunConfiguration, Form(more=CellFacts)]


class Between(TypedDict):
    """The two configurations.

    Attributes:
        first: Name of the first configuration in tables.
        second: Name of the second configuration in tables.
    """

    first: str
    second: str


DistanceFacts = Annotated[Distance, Form(without=("first", "second"), more=Between)]


class ExperimentLine(TypedDict):
    """The scores of an experiment by one metric.

    Attributes:
        record: `experiment`.
        id: Gymnasium id.
        kind: Kind of the reference.
        metric: Name of the metric; null without a score.
        unit: Unit of the metric.
        real: Scores of real trials.
        published: Published scores by engine.
        configurations: Results of each configuration.
        distances: Distances between trajectories of two configurations.
        notes: Results that are left out or inconsistent.
    """

    record: Literal["experiment"]
    id: str
    kind: str
    metric: str | None
    unit: str | None
    real: RealFacts | None
    published: Mapping[str, float | None] | None
    configurations: Sequence[CellLine]
    distances: Sequence[DistanceFacts]
    notes: Sequence[str]


class RankedFacts(TypedDict):
    """Ranks of a configuration.

    Attributes:
        label: Name of the configuration in tables.
        mean_rank: Mean of the ranks in the experiments of all configurations.
        mean_rank_95: 95 % interval of the mean rank.
        ranks: Rank in each experiment, by id.
    """

    label: str
    mean_rank: float | None
    mean_rank_95: Interval | None
    ranks: Mapping[str, Mean]


class KindLine(TypedDict):
    """Ranks within a kind of reference.

    Attributes:
        record: `kind`.
        kind: Kind of the references.
        constants: Constants that the configurations share.
        ids: Experiments in which all configurations have a score.
        configurations: Ranks of each configuration.
    """

    record: Literal["kind"]
    kind: str
    constants: str
    ids: Sequence[str]
    configurations: Sequence[RankedFacts]


CompareLine = ExperimentLine | KindLine
"""The scores of each experiment, then the ranks of each kind."""
