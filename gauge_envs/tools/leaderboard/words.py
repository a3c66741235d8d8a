"""The check of a leaderboard, and its table: scores with intervals, and means within each grade alone."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from rich.console import Group, RenderableType

from gauge_envs.experiments.variants import variants
from gauge_envs.files import json_ready
from gauge_envs.pages.results import configuration_labels
from gauge_envs.pages.table import Column, Place, Table, as_markdown, as_rich
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.compare.comparison import Comparison, compare
from gauge_envs.tools.compare.words import comparison_json, comparison_tables
from gauge_envs.tools.leaderboard import LeaderboardCheck, SubmissionCheck

# --- check -----------------------------------------------------------------------------------------------------------


def check_records(check: LeaderboardCheck) -> list[dict[str, Any]]:
    """Return a JSON-ready object for each submission, fault and repeated episode; the key `record` states which."""
    records: list[dict[str, Any]] = []
    for one in check.submissions:
        records.append({"record": "submission"} | _submission_row(one) | {"notes": list(one.notes)})
        records += [{"record": "rerun", "folder": one.folder} | asdict(again) for again in one.reruns]
    records += [{"record": "fault"} | asdict(fault) for fault in check.all_faults]
    ready: list[dict[str, Any]] = json_ready(records)
    return ready


def _submission_row(one: SubmissionCheck) -> dict[str, Any]:
    said = one.statement
    return {
        "folder": one.folder,
        "engine": said and said.engine,
        "version": said and said.version,
        "configuration": said and said.configuration,
        "submitter": said and said.submitter,
        "url": said and said.url,
        "results": len(one.results),
        "of": len(variants()),
        "diverged": sum(result.outcome is Outcome.DIVERGED for result in one.results),
        "left_out": dict(said.left_out) if said else {},
        "ok": one.ok,
        "faults": len(one.faults),
        "content_sha256": one.content_sha256,
    }


def check_view(check: LeaderboardCheck) -> RenderableType:
    """Return the submissions, the episodes that were run again, and the faults, for a terminal."""
    rows = [_submission_row(one) for one in check.submissions]
    submissions = Table(
        title="Submissions",
        columns=(
            Column("folder", "folder"),
            Column("", "results", lambda row: f"{row['results']} of {row['of']}", is_number=True),
            Column("faults", "faults", is_number=True, style=lambda count: "red" if count else "green"),
        ),
        rows=rows,
        notes=tuple(note for one in check.submissions for note in one.notes),
    )
    reruns = Table(
        title="Run again",
        columns=(
            Column("folder", "", place=Place.HEADING),
            Column("id", "experiment"),
            Column("status", "trajectory"),
            Column("largest_difference", "largest", lambda value: f"{value:.3g}", is_number=True),
            Column("rmse", "RMS", lambda value: f"{value:.3g}", is_number=True),
            Column("allowed", "allowed RMS", lambda value: f"{value:.3g}", is_number=True),
            Column("unit", "unit"),
            Column("cause", "cause", place=Place.BELOW),
        ),
        rows=[{"folder": one.folder} | asdict(again) for one in check.submissions for again in one.reruns],
    )
    faults = Table(
        title="Faults",
        columns=(
            Column("file", "file", place=Place.HEADING),
            Column("key", "key", lambda key: key or "(file)"),
            Column("reason", "", place=Place.BELOW),
        ),
        rows=check.all_faults,
    )
    tables = [submissions, *([reruns] if reruns.rows else []), *([faults] if faults.rows else [])]
    return Group(*(as_rich(table) for table in tables))


# --- table -----------------------------------------------------------------------------------------------------------


def leaderboard_records(check: LeaderboardCheck) -> list[dict[str, Any]]:
    """Return JSON-ready objects: the submissions without faults, and what `comparison_json` returns for them."""
    comparison = _comparison(check)
    records: list[dict[str, Any]] = json_ready(
        [{"record": "submission"} | row for row in _standing_rows(check, comparison)]
    )
    return records + comparison_json(comparison)


def leaderboard_markdown(check: LeaderboardCheck) -> str:
    """Return the table of all submissions without faults as GitHub Markdown."""
    return "# Leaderboard\n\n" + "\n".join(map(as_markdown, _tables(check))).rstrip() + "\n"


def leaderboard_view(check: LeaderboardCheck, *, wide: bool = False) -> RenderableType:
    """Return the same tables for a terminal."""
    return Group(*(as_rich(table, wide=wide) for table in _tables(check)))


def _comparison(check: LeaderboardCheck) -> Comparison:
    return compare(result for one in check.submissions if one.ok for result in one.results)


def _standing_rows(check: LeaderboardCheck, comparison: Comparison) -> list[dict[str, Any]]:
    """Return a row for each submission without faults, with the label that the other tables give it."""
    labels = configuration_labels(comparison.configurations)
    rows = []
    for one in check.submissions:
        if one.ok and one.results:
            place = comparison.configurations.index(RunConfiguration.of(one.results[0]))
            rows.append({"label": labels[place]} | _submission_row(one))
    return rows


def _tables(check: LeaderboardCheck) -> list[Table]:
    comparison = _comparison(check)
    standing = Table(
        title="Submissions",
        columns=(
            Column("label", "column"),
            Column("engine", "engine"),
            Column("version", "version"),
            Column("configuration", "configuration"),
            Column("submitter", "submitter"),
            Column("", "results", lambda row: f"{row['results']} of {row['of']}", is_number=True),
            Column("diverged", "diverged", is_number=True),
            Column("left_out", "left out", _left_out_text, place=Place.BELOW),
        ),
        rows=_standing_rows(check, comparison),
        notes=(
            "Scores are computed from the submitted trajectories. Means and ranks are within one grade of reference, "
            "and over the experiments that all have; nothing is averaged across grades.",
        ),
    )
    if not comparison.experiments:
        return [standing]
    # Wall times are those of the submitters' machines, which no trajectory proves.
    kept = [table for table in comparison_tables(comparison) if not table.title.startswith(("Cost", "Summary"))]
    return [standing, *kept]


def _left_out_text(reasons: dict[str, str]) -> str:
    """Return each reason once, with the patterns that it is for."""
    by_reason: dict[str, list[str]] = {}
    for pattern, reason in reasons.items():
        by_reason.setdefault(reason, []).append(pattern)
    return "; ".join(f"{', '.join(patterns)}: {reason}" for reason, patterns in by_reason.items()) or "none"
