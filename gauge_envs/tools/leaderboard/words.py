"""The check of a leaderboard, and its table: scores with intervals, and means within each grade alone."""

from dataclasses import asdict
from typing import Any

from gauge_envs.pages.document import Document, Heading, Paragraph, Part, as_rows
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
COLUMNS = (
    *(Column(key, key) for key in STATED),
    RESULTS,
    Column("reason", "reason", place=Place.BELOW),
    Column("declined", "declined", lambda names: _names(names), place=Place.BELOW),
)
SUBMITTED = (
    Column("label", "column"),
    *COLUMNS,
    Column("diverged", "diverged", is_number=True),
)
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
        **{
            key: getattr(one.statement, key, None)
            for key in (*STATED, "url", "reason", "standing")
        },
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
    whole = [one for one in sound if one.results and not one.missing]
    partial = [one for one in sound if one not in whole]
    page: list[Part] = [Heading("Leaderboard", 1)]
    parts: list[Part] = []
    rows: list[dict[str, Any]] = []
    for standing, (title, note) in GROUPS.items():
        group = [one for one in whole if one.standing == standing]
        if not group:
            continue
        comparison = compare(result for one in group for result in one.results)
        configurations = [RunConfiguration.of(one.results[0]) for one in group]
        places = map(comparison.configurations.index, configurations)
        listed = [
            {"label": comparison.labels[place]} | _submission_row(one)
            for place, one in zip(places, group, strict=True)
        ]
        table = Table(title=title, columns=SUBMITTED, rows=listed, notes=(note,))
        # Wall times are those of one machine.
        compared = comparison_document(comparison, with_costs=False)
        scores = short_tables(comparison, with_ranks=standing == "ranked")
        page += [table, *scores]
        if standing == "ranked":
            parts += [table, *compared.parts]
            rows += [*listed, *as_rows(compared)]
        else:
            parts += [table, *scores]
            scored = [one for one in as_rows(compared) if one["record"] == "experiment"]
            rows += [*listed, *scored]
    apart = [_submission_row(one) for one in partial]
    if partial:
        missing = Column("missing", "missing", _names, place=Place.BELOW)
        table = Table(
            title="Partial submissions",
            columns=(*COLUMNS, missing),
            rows=apart,
            notes=(
                "They lack episodes of experiments that their engine does not decline. They are not compared, so that "
                "the experiments of the others stay the same.",
            ),
        )
        page.append(table)
        parts.append(table)
    page.append(
        Paragraph(
            "Ranks in each experiment, all metrics and all pairs: gauge leaderboard table."
        )
    )
    return Document(parts=parts, rows=[*rows, *apart], markdown=page)


def _names(names: list[str]) -> str:
    return shortened(names) if names else "none"
