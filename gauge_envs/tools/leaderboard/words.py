"""The check of a leaderboard, and its table: scores with intervals, and means within each grade alone."""

from dataclasses import asdict
from typing import Any

from gauge_envs.pages.document import Document, Heading, Paragraph, as_rows
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import shortened
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.compare import compare, comparison_document, short_tables
from gauge_envs.tools.leaderboard import LeaderboardCheck, SubmissionCheck

RESULTS = Column(
    "", "results", lambda row: f"{row['results']} of {row['of']}", is_number=True
)
STATED = ("engine", "version", "configuration", "submitter")


def check_document(check: LeaderboardCheck) -> Document:
    """Return the submissions and the faults; `record` of a row states which."""
    submissions = [_submission_row(one) for one in check.submissions]
    faults = Column(
        "faults",
        "faults",
        is_number=True,
        style=lambda count: "red" if count else "green",
    )
    listed = Table(
        title="Submissions",
        columns=(Column("folder", "folder"), RESULTS, faults),
        rows=submissions,
    )
    wrong = Table(
        title="Faults",
        columns=(
            Column("file", "file", place=Place.HEADING),
            Column("key", "key", lambda key: key or "(file)"),
            Column("reason", "", place=Place.BELOW),
        ),
        rows=check.faults,
    )
    rows = submissions + [{"record": "fault"} | asdict(fault) for fault in check.faults]
    return Document(parts=(listed, wrong) if check.faults else (listed,), rows=rows)


def _submission_row(one: SubmissionCheck) -> dict[str, Any]:
    return {
        "record": "submission",
        "folder": one.folder,
        **{key: getattr(one.statement, key, None) for key in (*STATED, "url")},
        "results": len(one.results),
        "of": len(one.experiments),
        "diverged": sum(result.outcome is Outcome.DIVERGED for result in one.results),
        "declined": list(one.declined),
        "missing": list(one.missing),
        "faults": len(one.faults),
    }


def leaderboard_document(check: LeaderboardCheck) -> Document:
    """Return all submissions without faults, and their comparison; `record` of a row states what it is of."""
    sound = [one for one in check.submissions if one.ok]
    partial = [one for one in sound if one.missing or not one.results]
    ranked = [one for one in sound if one not in partial]
    comparison = compare(result for one in ranked for result in one.results)
    columns = (
        *(Column(key, key) for key in STATED),
        RESULTS,
        Column("declined", "declined", _names, place=Place.BELOW),
    )
    standing = Table(
        title="Submissions",
        columns=(
            Column("label", "column"),
            *columns,
            Column("diverged", "diverged", is_number=True),
        ),
        rows=[
            {
                "label": comparison.labels[
                    comparison.configurations.index(RunConfiguration.of(one.results[0]))
                ]
            }
            | _submission_row(one)
            for one in ranked
        ],
        notes=(
            "Means and ranks are within one grade of reference, and over the experiments that all have; nothing is "
            "averaged across grades.",
        ),
    )
    apart = Table(
        title="Partial submissions",
        columns=(*columns, Column("missing", "missing", _names, place=Place.BELOW)),
        rows=[_submission_row(one) for one in partial],
        notes=(
            "They lack episodes of experiments that their engine does not decline. They are not compared, so that the "
            "experiments of the others stay the same.",
        ),
    )
    # Wall times are those of one machine.
    compared = comparison_document(comparison, with_costs=False)
    tables = (standing, apart) if partial else (standing,)
    has_scores = bool(comparison.experiments)
    page = (
        Heading("Leaderboard", 1),
        *tables,
        *(short_tables(comparison) if has_scores else ()),
        Paragraph(
            "Ranks in each experiment, all metrics and all pairs: gauge leaderboard table."
        ),
    )
    return Document(
        parts=(*tables, *(compared.parts if has_scores else ())),
        rows=[*standing.rows, *apart.rows, *as_rows(compared)],
        markdown=page,
    )


def _names(names: list[str]) -> str:
    return shortened(names) if names else "none"
