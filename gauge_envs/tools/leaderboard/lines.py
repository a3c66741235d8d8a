"""What `gauge leaderboard check` and `table` print with `--json`, a line each; `record` states which."""

from collections.abc import Sequence
from typing import Literal, NotRequired, TypedDict

from gauge_envs.tools.compare import CompareLine


class SubmissionRecord(TypedDict):
    """A submission.

    Attributes:
        folder: Its folder.
        engine: Name of the engine.
        version: Version of the engine.
        configuration: Name of the configuration.
        submitter: Who submits it.
        url: Where the engine is described.
        reason: Why these settings; empty for none.
        standing: `ranked`, `shown` or `reported`.
        processor: Processors of the machines that ran it; empty where a result does not say.
        results: Number of episodes that ran.
        of: Number of experiments that are asked for.
        diverged: Number of episodes that diverged.
        declined: Experiments that the engine cannot build.
        missing: Experiments that failed or did not run.
        faults: Number of faults.
        label: Name of its column in tables; absent for a partial submission, and in a check.
    """

    record: Literal["submission"]
    folder: str
    engine: str | None
    version: str | None
    configuration: str | None
    submitter: str | None
    url: str | None
    reason: str | None
    standing: str | None
    processor: str
    results: int
    of: int
    diverged: int
    declined: Sequence[str]
    missing: Sequence[str]
    faults: int
    label: NotRequired[str]


class FaultRecord(TypedDict):
    """Something that is wrong in a submission.

    Attributes:
        folder: Folder of the submission.
        reason: File in it, what is wrong, and what would be right.
    """

    record: Literal["fault"]
    folder: str
    reason: str


CheckLine = SubmissionRecord | FaultRecord
"""Each submission, then all faults."""

TableLine = SubmissionRecord | CompareLine
"""Each submission without faults, then their comparison."""
