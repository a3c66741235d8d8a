"""The check of a leaderboard, and its table: scores with intervals, and means within each grade alone."""

from collections.abc import Sequence
from typing import Any

from gauge_envs.pages.document import Document, Heading, Paragraph, Part, as_rows
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import shortened
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.compare import compare, comparison_document, short_tables
from gauge_envs.tools.leaderboard import SubmissionCheck

RESULTS = Column(
    "", "results", lambda row: f"{row['results']} of {row['of']}", is_number=True
)
STATED = ("engine", "version", "configuration", "submitter")
GROUPS = {
    "ranked": (
        "Submissions",
        "Means and ranks are within one grade of reference, and over the experiments that all have; nothing is "
        "averaged across grades.",
    ),
    "shown": (
        "Other configurations of these engines",
        "They have scores and no ranks: one configuration of an engine counts, as its submitter stated before it ran.",
    ),
    "reported": (
        "Reported by their submitters",
        "Nothing here ran them, so that they have no ranks.",
    ),
}
"""Title and note of the submissions of each standing."""


def check_document(checks: Sequence[SubmissionCheck]) -> Document:
    """Return the submissions and the faults; `record` of a row states which."""
    submissions = [_submission_row(one) for one in checks]
    faults = [
        {"record": "fault", "folder": one.folder, "reason": reason}
        for one in checks
        for reason in one.faults
    ]
    count = Column("faults", "faults", is_number=True)
    listed = Table(
        title="Submissions",
        columns=(Column("folder", "folder"), RESULTS, count),
        rows=submissions,
    )
    wrong = [Paragraph(f"{fault['folder']}: {fault['reason']}") for fault in faults]
    return Document(parts=(listed, *wrong), rows=submissions + faults)


def _submission_row(one: SubmissionCheck) -> dict[str, Any]:
    stated = (*STATED, "url", "reason", "standing")
    processors = {result.processor for result in one.results} - {""}
    return {
        "record": "submission",
        "folder": one.folder,
        **{key: getattr(one.statement, key, None) for key in stated},
        "processor": "; ".join(sorted(processors)),
        "results": len(one.results),
        "of": len(one.results) + len(one.declined) + len(one.missing),
        "diverged": sum(result.outcome is Outcome.DIVERGED for result in one.results),
        "declined": one.declined,
        "missing": one.missing,
        "faults": len(one.faults),
    }


def _submission_table(title: str, note: str, rows: Sequence[dict[str, Any]]) -> Table:
    stated = [Column(key, key) for key in (*STATED, "processor")]
    diverged = Column("diverged", "diverged", is_number=True)
    reason = Column("reason", "reason", place=Place.BELOW)
    names = [
        Column(key, key, lambda found: shortened(found) or "none", place=Place.BELOW)
        for key in ("declined", "missing")
    ]
    columns = (Column("label", "column"), *stated, RESULTS, diverged, reason, *names)
    return Table(title=title, columns=columns, rows=rows, notes=(note,))


def leaderboard_document(checks: Sequence[SubmissionCheck]) -> Document:
    """Return all submissions without faults, and their comparison; `record` of a row states what it is of."""
    sound = [one for one in checks if not one.faults]
    whole = [one for one in sound if one.results and not one.missing]
    parts: list[Part] = [Heading("Leaderboard", 1)]
    rows: list[dict[str, Any]] = []
    for standing, (title, note) in GROUPS.items():
        group = [
            one for one in whole if one.statement and one.statement.standing == standing
        ]
        if not group:
            continue
        comparison = compare(result for one in group for result in one.results)
        listed = []
        for one in group:
            place = comparison.configurations.index(RunConfiguration.of(one.results[0]))
            label = {"label": comparison.labels[place]}
            listed.append(label | _submission_row(one))
        is_ranked = standing == "ranked"
        parts.append(_submission_table(title, note, listed))
        parts += short_tables(comparison, with_ranks=is_ranked)
        rows += listed
        # Wall times are those of one machine.
        for row in as_rows(comparison_document(comparison, with_costs=False)):
            if is_ranked or row["record"] == "experiment":
                rows.append(row)
    partial = [_submission_row(one) for one in sound if one not in whole]
    if partial:
        note = (
            "They lack episodes of experiments that their engine does not decline. They are not compared, so that the "
            "experiments of the others stay the same."
        )
        parts.append(_submission_table("Partial submissions", note, partial))
    parts.append(Paragraph("All metrics and pairs: gauge leaderboard table --json."))
    return Document(parts=parts, rows=[*rows, *partial])
