"""The check of a leaderboard, and its table: scores with intervals, and means within each grade alone."""

from dataclasses import asdict
from typing import Any

from gauge_envs.pages.document import Document, Heading, Paragraph, as_rows
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.compare import compare, comparison_document, short_tables
from gauge_envs.tools.leaderboard import LeaderboardCheck, SubmissionCheck

RESULTS = Column(
    "", "results", lambda row: f"{row['results']} of {row['of']}", is_number=True
)


def check_document(check: LeaderboardCheck) -> Document:
    """Return the submissions, the episodes that were run again, and the faults; `record` of a row states which."""
    submissions = [
        _submission_row(one) | {"notes": list(one.notes)} for one in check.submissions
    ]
    reruns = {
        one.folder: [{"folder": one.folder} | asdict(two) for two in one.reruns]
        for one in check.submissions
    }
    numbers = {"largest_difference": "largest", "rmse": "RMS", "allowed": "allowed RMS"}
    tables = (
        Table(
            title="Run again",
            columns=(
                Column("folder", "", place=Place.HEADING),
                Column("id", "experiment"),
                Column("status", "trajectory"),
                *(
                    Column(key, title, lambda value: f"{value:.3g}", is_number=True)
                    for key, title in numbers.items()
                ),
                Column("unit", "unit"),
                Column("cause", "cause", place=Place.BELOW),
            ),
            rows=[row for rows in reruns.values() for row in rows],
        ),
        Table(
            title="Faults",
            columns=(
                Column("file", "file", place=Place.HEADING),
                Column("key", "key", lambda key: key or "(file)"),
                Column("reason", "", place=Place.BELOW),
            ),
            rows=check.all_faults,
        ),
    )
    listed = Table(
        title="Submissions",
        columns=(
            Column("folder", "folder"),
            RESULTS,
            Column(
                "faults",
                "faults",
                is_number=True,
                style=lambda count: "red" if count else "green",
            ),
        ),
        rows=submissions,
        notes=tuple(note for one in check.submissions for note in one.notes),
    )
    rows: list[dict[str, Any]] = []
    for row in submissions:
        rows += [
            {"record": "submission"} | row,
            *({"record": "rerun"} | again for again in reruns[row["folder"]]),
        ]
    rows += [{"record": "fault"} | asdict(fault) for fault in check.all_faults]
    return Document(
        parts=(listed, *(table for table in tables if table.rows)), rows=rows
    )


def _submission_row(one: SubmissionCheck) -> dict[str, Any]:
    statement = one.statement
    keys = ("engine", "version", "package_sha256", "configuration", "submitter", "url")
    return {
        "folder": one.folder,
        **{key: getattr(statement, key, None) for key in keys},
        "results": len(one.results),
        "of": one.asked,
        "diverged": sum(result.outcome is Outcome.DIVERGED for result in one.results),
        "left_out": dict(statement.left_out) if statement else {},
        "ok": one.ok,
        "unverified": list(one.unverified),
        "faults": len(one.faults),
        "content_sha256": one.content_sha256,
    }


def leaderboard_document(check: LeaderboardCheck) -> Document:
    """Return all submissions without faults, and their comparison; `record` of a row states what it is of."""
    comparison = compare(result for one in _ranked(check) for result in one.results)
    left_out = Column("left_out", "left out", _left_out_text, place=Place.BELOW)
    columns = (
        *(
            Column(key, key)
            for key in ("engine", "version", "configuration", "submitter")
        ),
        RESULTS,
        left_out,
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
            for one in _ranked(check)
        ],
        notes=(
            "Scores are computed from the submitted trajectories. Means and ranks are within one grade of reference, "
            "and over the experiments that all have; nothing is averaged across grades.",
        ),
    )
    apart = Table(
        title="Partial submissions",
        columns=columns,
        rows=[
            _submission_row(one)
            for one in check.submissions
            if one.ok and one.is_partial
        ],
        notes=(
            "They lack results of experiments that their engine builds, or an engine that is installed here. They are "
            "not compared, so that the experiments of the others stay the same.",
        ),
    )
    # Wall times are those of the submitters' machines, which no trajectory proves.
    compared = comparison_document(comparison, with_costs=False)
    parts = (
        standing,
        *([apart] if apart.rows else ()),
        *(compared.parts if comparison.experiments else ()),
    )
    page = (
        standing,
        *([apart] if apart.rows else ()),
        *(short_tables(comparison) if comparison.experiments else ()),
        Paragraph(
            "Ranks in each experiment, all metrics and all pairs: gauge leaderboard table."
        ),
    )
    rows = [{"record": "submission"} | row for row in (*standing.rows, *apart.rows)]
    return Document(
        parts=parts,
        rows=rows + as_rows(compared),
        markdown=(Heading("Leaderboard", 1), *page),
    )


def _ranked(check: LeaderboardCheck) -> list[SubmissionCheck]:
    return [
        one
        for one in check.submissions
        if one.ok and one.results and not one.is_partial
    ]


def _left_out_text(reasons: dict[str, str]) -> str:
    """Return each reason once, with the patterns that it is for."""
    by_reason: dict[str, list[str]] = {}
    for pattern, reason in reasons.items():
        by_reason.setdefault(reason, []).append(pattern)
    return (
        "; ".join(
            f"{', '.join(patterns)}: {reason}" for reason, patterns in by_reason.items()
        )
        or "none"
    )
