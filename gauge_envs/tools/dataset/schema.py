"""JSON lines of `gauge data import` and `gauge list references`."""

from collections.abc import Sequence
from typing import TypedDict

from gauge_envs.references.imported import DriverRecord
from gauge_envs.references.kind import Kind
from gauge_envs.tools.dataset.findings import ImportFinding


class BaselineLine(TypedDict):
    """Baseline of one metric: mean and standard deviation of imported trials and of the paper.

    Attributes:
        metric: Name of the metric.
        unit: Unit of the metric.
        own_mean: Mean of the imported trials.
        own_std: Standard deviation of the imported trials.
        own_trial_count: Number of imported trials.
        published_mean: Mean of the paper.
        published_std: Standard deviation of the paper.
        difference: Imported mean / published mean - 1.
        flagged: Whether the means differ by more than 5 %.
    """

    metric: str
    unit: str
    own_mean: float | None
    own_std: float | None
    own_trial_count: int
    published_mean: float | None
    published_std: float | None
    difference: float | None
    flagged: bool


class ImportedLine(TypedDict):
    """Outcome of the import of one experiment.

    Attributes:
        id: Gymnasium id.
        imported: Whether enough trials are usable.
        trials: Number of trials of the band.
        left_out: Number of files that are left out.
        frames: Number of frames.
        revision: Revision of the dataset.
        sha256: Hash of the trials.
        baselines: Imported and published baselines.
        drivers: Recorded prescribed motions.
    """

    id: str
    imported: bool
    trials: int
    left_out: int
    frames: int | None
    revision: str | None
    sha256: str | None
    baselines: Sequence[BaselineLine]
    drivers: Sequence[DriverRecord]


class FindingLine(TypedDict):
    """Problem of a file."""

    finding: ImportFinding


ImportLine = ImportedLine | FindingLine
"""Lines of all experiments, then lines of all findings."""


class StatusDriver(TypedDict):
    """A driven body, the source of its motion, and the record of an imported motion."""

    body: str
    provenance: str
    recorded: DriverRecord | None


class StatusLine(TypedDict):
    """Reference and prescribed motions of an experiment.

    Attributes:
        id: Gymnasium id.
        kind: Kind of the reference.
        imported: Whether trials are imported.
        fault: Why the reference cannot be read, and the fix; null if it can. The other entries are then empty.
        trials: Number of trials of the reference.
        revision: Revision of the imported dataset.
        is_current: Whether the task file is unchanged since the import; null without an import.
        drivers: Driven bodies.
        baselines: Baselines of the metrics.
    """

    id: str
    kind: Kind
    imported: bool
    fault: str | None
    trials: int | None
    revision: str | None
    is_current: bool | None
    drivers: Sequence[StatusDriver]
    baselines: Sequence[BaselineLine]
