"""Error budget of one episode: the parts of its stages, the rest, and published scores beside it."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from gauge_envs.evaluation.motion_kinds import Change, MotionKind

MARKERS, SEVERAL_BODIES = "the markers", "the bodies"
"""Subjects of a diagnosis that are not a single body."""

NO_PUBLISHED_SPLIT = (
    "only scalar scores are published: a split of the RMSE needs the trajectory. DTW over RMSE, both in the unit of "
    "g(t), is the share that remains under any warp of time; PD is the period over the real one."
)


class BudgetStage(StrEnum):
    """A stage of the error budget."""

    RELEASE = "release"
    """Constant time shift."""
    OFFSET = "offset"
    """Constant offset of each coordinate."""
    RATE = "rate"
    """Scale or rate of the motion."""


@dataclass(frozen=True, kw_only=True)
class StagePart:
    """Reduction of the error by one stage.

    Squared errors are means over frames of the squared Euclidean deviation, in the squared unit of g(t).

    Attributes:
        stage: The stage.
        missing: Why the stage does not apply, so that it explains 0; None if it applies.
        explained: Reduction of the mean squared error after the stages before it.
        share: `explained` over the whole mean squared error.
        rmse_before: RMSE before the stage.
        rmse_after: RMSE after the stage.
        alone_share: Reduction by the stage as the only one, over the whole.
        last_share: Reduction by the stage after both others, over the whole.
        by_coordinate: Reduction of each coordinate's mean squared error, shape [C]; it sums to `explained`. A
            coordinate whose error grows has a negative entry.
        changes: All changes after the stage, fitted together, including those of the stages before.
        alone_changes: Changes of the stage as the only one.
    """

    stage: BudgetStage
    missing: str | None
    explained: float
    share: float
    rmse_before: float
    rmse_after: float
    alone_share: float
    last_share: float
    by_coordinate: tuple[float, ...]
    changes: tuple[Change, ...]
    alone_changes: tuple[Change, ...]


@dataclass(frozen=True, kw_only=True)
class Remainder:
    """Error that no stage explains.

    Attributes:
        mean_square: Mean squared error.
        share: `mean_square` over that of the unchanged simulation.
        rmse: Root of `mean_square`.
        by_coordinate: Mean squared error of each coordinate, shape [C].
    """

    mean_square: float
    share: float
    rmse: float
    by_coordinate: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class PublishedScore:
    """Published scores of an engine; None for what was not published.

    Attributes:
        rmse: RMSE in the unit of g(t), from the normalized score.
        rmse_normalized: Normalized RMSE.
        dtw_normalized: Normalized DTW.
        dtw_over_rmse: DTW over RMSE, both in the unit of g(t).
        period_ratio: Period over the real mean.
    """

    rmse: float | None
    rmse_normalized: float | None
    dtw_normalized: float | None
    dtw_over_rmse: float | None
    period_ratio: float | None


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """The error budget of one episode.

    Attributes:
        id: Gymnasium id.
        grade: Grade of the band.
        source: Source of the band.
        unit: Unit of g(t) and of every RMSE.
        coordinates: Names of the band coordinates.
        kind: Kind of the simulated motion, which decides the quantity of the stage `rate`.
        subject: What is observed, as `the ball`.
        driven: Whether a body of the scene follows a recorded motion, so that no body is released.
        frames: Number of frames.
        extrapolated_frames: Number of frames that the band extrapolates.
        extrapolated_share: Share of the squared error in extrapolated frames.
        mean_square: Mean squared error.
        rmse: Root of `mean_square`: the RMSE of the score, unless `measured_only`.
        dtw_over_rmse: DTW of the score over its RMSE; None if it is not known.
        measured_only: Whether extrapolated frames were left out.
        by_coordinate: Mean squared error of each coordinate, shape [C].
        parts: Parts of the stages, in their order.
        rest: Error that no stage explains.
        published: Published scores by engine; see `published_note` for their split.
        published_note: Why the published scores have no split.
        notes: Remarks on this budget, a sentence each.
    """

    id: str
    grade: str
    source: str
    unit: str
    coordinates: tuple[str, ...]
    kind: MotionKind
    subject: str
    driven: bool
    frames: int
    extrapolated_frames: int
    extrapolated_share: float
    mean_square: float
    rmse: float
    dtw_over_rmse: float | None
    measured_only: bool
    by_coordinate: tuple[float, ...]
    parts: tuple[StagePart, ...]
    rest: Remainder
    published: Mapping[str, PublishedScore]
    published_note: str = NO_PUBLISHED_SPLIT
    notes: tuple[str, ...] = ()

    def axes(self) -> dict[str, tuple[int, ...]]:
        """Return the indices of coordinates by axis: `marker-3.x` belongs to `x`; a name without an axis is its own."""
        groups: dict[str, list[int]] = {}
        for index, name in enumerate(self.coordinates):
            groups.setdefault(name.rpartition(".")[2], []).append(index)
        return {axis: tuple(indices) for axis, indices in groups.items()}
