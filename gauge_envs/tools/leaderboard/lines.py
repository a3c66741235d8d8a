"""What `gauge leaderboard check` and `table` print with `--json`, a line each; `record` states which."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, NotRequired, TypedDict

from gauge_envs.cli.schemas import Form
from gauge_envs.tools.compare import CompareLine
from gauge_envs.tools.leaderboard.reruns import Rerun
from gauge_envs.tools.leaderboard.submission import Fault


class SubmissionFacts(TypedDict):
    """A submission.

    Attributes:
        folder: Its folder.
        engine: Name of the engine.
        version: Version of the engine.
        package_sha256: Hash of the engine's package.
        configuration: Name of the configuration.
        submitter: Who submits it.
        url: Where the engine is described.
        results: Number of results.
        of: Number of experiments that are asked for.
        diverged: Number of results that diverged.
        left_out: Why experiments are left out, by pattern.
        ok: Whether it has no fault.
        unverified: What could not be checked.
        faults: Number of faults.
        content_sha256: Hash of the results.
    """

    folder: str
    engine: str | None
    version: str | None
    package_sha256: str | None
    configuration: str | None
    submitter: str | None
    url: str | None
    results: int
    of: int
    diverged: int
    left_out: Mapping[str, str]
    ok: bool
    unverified: Sequence[str]
    faults: int
    content_sha256: str


class SubmissionRecord(SubmissionFacts):
    """A submission that was checked, with notes on it."""

    record: Literal["submission"]
    notes: Sequence[str]


class RerunRecord(TypedDict):
    """Folder of the submission whose episode was run again."""

    record: Literal["rerun"]
    folder: str


class FaultRecord(TypedDict):
    """Something that is wrong in a submission."""

    record: Literal["fault"]


CheckLine = (
    SubmissionRecord
    | Annotated[Rerun, Form(more=RerunRecord)]
    | Annotated[Fault, Form(more=FaultRecord)]
)
"""Each submission, then its episodes that were run again; then all faults."""


class StandingRecord(SubmissionFacts):
    """A submission that stands.

    Attributes:
        label: Name of its column in tables; absent for a partial submission.
    """

    record: Literal["submission"]
    label: NotRequired[str]


TableLine = StandingRecord | CompareLine
"""Each submission without faults, then their comparison."""
