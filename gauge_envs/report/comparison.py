"""Engines side by side: tables for a terminal and for Markdown, rows for JSON."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from gauge_envs.analysis.comparison import Cell, Comparison, ExperimentComparison
from gauge_envs.analysis.configuration import RunConfiguration
from gauge_envs.analysis.distance import MOTION_SHARE, Distance
from gauge_envs.analysis.scores import METRICS, Metric, ScoreSpread
from gauge_envs.files import json_ready
from gauge_envs.references.bands import BandGrade
from gauge_envs.report.results import PLAIN, configuration_labels, configuration_parts, versions_text
from gauge_envs.report.text import (
    ALIGNED_TITLE,
    COST_TITLE,
    ENGINE_TITLES,
    GRADE_NOTES,
    METRIC_TITLES,
    NORMALIZED_NOTE,
    heading,
    markdown_row,
    markdown_text,
    plus_minus_text,
    quantity_text,
    score_text,
    shortened,
)
from gauge_envs.runs.result import Outcome

__all__ = [
    "comparison_markdown",
    "comparison_rows",
    "comparison_view",
]


def comparison_rows(comparison: Comparison, metrics: Sequence[str] = tuple(METRICS)) -> list[dict[str, Any]]:
    """One JSON-ready object an experiment and metric, with everything that is known of it.

    An experiment that has none of the metrics has one object with `metric` None.
    """
    labels = configuration_labels(comparison.configurations)
    rows = []
    for one in comparison.experiments:
        names: list[str | None] = [*one.metrics(metrics)]
        for name in names or [None]:
            metric = METRICS[name] if name else None
            line = one.baselines.get((metric.published if metric else None) or "")
            rows.append(
                {
                    "id": one.id,
                    "grade": one.grade,
                    "metric": name,
                    "unit": _metric_unit(one, metric) if metric else None,
                    "real": None if line is None else {"mean": line.mean, "std": line.std},
                    "published": None if line is None else dict(line.engines),
                    "configurations": [
                        _configuration_row(label, configuration, cell, metric)
                        for label, configuration, cell in zip(labels, comparison.configurations, one.cells, strict=True)
                    ],
                    "distances": [
                        dataclasses.asdict(far) | {"first": labels[far.first], "second": labels[far.second]}
                        for far in one.distances
                    ],
                    "notes": list(comparison.notes),
                }
            )
    return json_ready(rows)


def _configuration_row(
    label: str, configuration: RunConfiguration, cell: Cell | None, metric: Metric | None
) -> dict[str, Any]:
    ran = [] if cell is None else [result for result in cell.results if result.error is None]
    return {
        "label": label,
        **dataclasses.asdict(configuration),
        "outcomes": [] if cell is None else [result.outcome.value for result in cell.results],
        "reasons": [] if cell is None else [result.error or result.diverged_reason for result in cell.results],
        "seeds": [] if cell is None else [result.seed for result in cell.results],
        "raw": _spread_row(cell, metric, normalized=False),
        "normalized": _spread_row(cell, metric, normalized=True),
        "wall_s_per_sim_s": None if cell is None else cell.wall_s_per_sim_s,
        "settings": ran[0].settings if ran else None,
        "versions": ran[0].versions if ran else None,
    }


def _spread_row(cell: Cell | None, metric: Metric | None, *, normalized: bool) -> dict[str, Any] | None:
    spread = None if cell is None or metric is None else cell.spread(metric, normalized=normalized)
    if cell is None or metric is None or spread is None:
        return None
    return dataclasses.asdict(spread) | {"values": cell.values(metric, normalized=normalized)}


@dataclasses.dataclass(frozen=True)
class _Section:
    """A table and what is said about it, to be printed in colour or as Markdown."""

    heading: str
    titles: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    text_columns: int
    notes: tuple[str, ...] = ()


def comparison_view(comparison: Comparison, metrics: Sequence[str] = tuple(METRICS)) -> Group:
    """Scores, distances between engines, and a summary, for reading in a terminal."""
    parts: list[Any] = [] if comparison.experiments else [Text("no results to compare")]
    for section in _sections(comparison, metrics):
        table = Table(box=None, header_style="bold", pad_edge=False, padding=(0, 2, 0, 0))
        for index, title in enumerate(section.titles):
            is_text = index < section.text_columns
            lines = title if is_text else title.replace(", ", "\n").replace("=", "=\n")
            table.add_column(escape(lines), justify="left" if is_text else "right", overflow="fold", no_wrap=is_text)
        for row in section.rows:
            table.add_row(*(f"[red]{escape(cell)}[/]" if "diverged" in cell else escape(cell) for cell in row))
        parts += [heading(section.heading), table, *(Text(note, style="dim") for note in section.notes)]
    return Group(*parts)


def comparison_markdown(comparison: Comparison, metrics: Sequence[str] = tuple(METRICS)) -> str:
    """The same as GitHub Markdown."""
    lines: list[str] = []
    for section in _sections(comparison, metrics):
        rule = ["---" if index < section.text_columns else "---:" for index in range(len(section.titles))]
        lines += [f"**{section.heading}**", ""]
        lines += [markdown_row(row) for row in (section.titles, rule, *section.rows)]
        # Two blanks end a line in Markdown.
        lines += ["", *(f"{markdown_text(note)}  " for note in section.notes), ""]
    return "\n".join(lines).rstrip() + "\n"


def _sections(comparison: Comparison, metrics: Sequence[str]) -> list[_Section]:
    if not comparison.experiments:
        return []
    labels = configuration_labels(comparison.configurations)
    far = [one for one in comparison.experiments if one.grade == BandGrade.NONE.value and one.distances]
    sections = [_score_section(comparison, labels, metrics)]
    if far:
        sections.append(_distance_section(far, labels))
    sections.append(_summary_section(comparison, labels))
    return sections


def _score_section(comparison: Comparison, labels: Sequence[str], metrics: Sequence[str]) -> _Section:
    rows = []
    for one in comparison.experiments:
        names = one.metrics(metrics)
        lines = [_score_line(one, name) for name in names] or [
            ("none", "-", *(_cell_text(cell, None) for cell in one.cells), *("-" for _ in ENGINE_TITLES))
        ]
        costs = [_cost_text(None if cell is None else cell.wall_s_per_sim_s) for cell in one.cells]
        lines.append((COST_TITLE, "", *costs, *("" for _ in ENGINE_TITLES)))
        rows += [
            (one.name if index == 0 else "", one.grade if index == 0 else "", *line) for index, line in enumerate(lines)
        ]
    published = (f"{title}, paper" for title in ENGINE_TITLES.values())
    return _Section(
        "Scores over the mean score of the real trials",
        ("experiment", "grade", "metric", "1 = real trials", *labels, *published),
        rows,
        4,
        _legend(comparison, labels, rows),
    )


def _score_line(one: ExperimentComparison, name: str) -> tuple[str, ...]:
    metric = METRICS[name]
    line = one.baselines.get(metric.published or "")
    cells = (_cell_text(cell, metric) for cell in one.cells)
    engines = (score_text(line.engines[engine] if line else None) for engine in ENGINE_TITLES)
    real = "-"
    if name == "el":
        real = "0 is ideal"
    elif (scale := one.baselines.get("rmse") if name == "rmse_aligned" else line) is not None:
        real = plus_minus_text(scale.mean, scale.std, scale.unit)
    return (METRIC_TITLES.get(name, ALIGNED_TITLE), real, *cells, *engines)


def _metric_unit(one: ExperimentComparison, metric: Metric) -> str:
    return one.unit if metric.unit is None else metric.unit


def _cell_text(cell: Cell | None, metric: Metric | None) -> str:
    """Mean and scatter of a cell, or why there is none."""
    if cell is None:
        return "-"
    count = len(cell.results)
    bad = [
        outcome.value if number == count else f"{number} {outcome.value}"
        for outcome in (Outcome.DIVERGED, Outcome.FAILED, Outcome.DECLINED)
        if (number := cell.count(outcome))
    ]
    told = []
    if metric is not None:
        # What has no baseline to be divided by is told in its own unit.
        normalized = cell.spread(metric, normalized=True)
        spread = normalized or cell.spread(metric, normalized=False)
        if spread is not None:
            unit = "" if normalized or metric.unit == "1" else f" {metric.unit or cell.results[0].score.unit}"
            told.append(_spread_text(spread) + unit)
    return ", ".join(told + bad) or "no score"


def _spread_text(spread: ScoreSpread) -> str:
    scatter = "" if spread.std is None else f" +- {score_text(spread.std)} ({spread.count})"
    return f"{score_text(spread.mean)}{scatter}"


def _cost_text(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}" if value < 10.0 else f"{value:.0f}"


def _legend(comparison: Comparison, labels: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    notes = [NORMALIZED_NOTE]
    words = {
        "-": "-: not run, or not published",
        "no score": "no score: it ran, but there is no reference, or what is measured did not happen",
        "diverged": "diverged: the simulation left what is physically possible, so it has no score",
        "declined": "declined: the engine cannot build the scene",
        "failed": "failed: the episode ended in an error",
    }
    used = [cell for row in rows for cell in row[4:]]
    meanings = [
        text for word, text in words.items() if any(word == cell or (word != "-" and word in cell) for cell in used)
    ]
    notes += [f"{'; '.join(meanings)}."] if meanings else []
    if any("+-" in cell for row in rows for cell in row[4 : 4 + len(labels)]):
        notes.append("Repeats, which differ in their seed alone: mean +- sample standard deviation (how many).")
    if any(ALIGNED_TITLE in row for row in rows):
        notes.append(f"{ALIGNED_TITLE}: RMSE after the constant time shift that fits best.")
    grades = sorted({one.grade for one in comparison.experiments})
    notes.append(f"Grades: {'; '.join(f'{grade}: {GRADE_NOTES[BandGrade(grade)]}' for grade in grades)}.")
    first, *others = comparison.configurations
    if others:
        exact = [configuration_parts(one, digits=17) for one in others]
        pairs = zip(configuration_parts(first, digits=17), configuration_parts(first), strict=True)
        shared = [text for part, (_, text) in pairs if all(part in parts for parts in exact)]
        notes += [f"All: {', '.join(shared)}."] if shared else []
        notes += ["Parameters are calibrated unless stated."] if PLAIN[1] not in shared else []
    engines = dict.fromkeys(
        f"{one.backend or 'file'}: {versions_text(one) or '-'}" for one in comparison.configurations
    )
    notes.append(f"Versions: {'; '.join(engines)}.")
    if not others:
        notes.append("One configuration: there is nothing to compare it with but what was published.")
    return (*notes, *(f"Note: {note}." for note in comparison.notes))


def _distance_section(experiments: Sequence[ExperimentComparison], labels: Sequence[str]) -> _Section:
    rows = [
        (
            one.name if index == 0 else "",
            f"{labels[far.first]} : {labels[far.second]}",
            f"{_scattered(far.rms)} {far.unit}",
            f"{quantity_text(far.motion_rms)} {far.unit}",
            f"{quantity_text(far.threshold)} {far.unit}{'' if far.threshold_is_scatter else ' *'}",
            _apart(far),
        )
        for one in experiments
        for index, far in enumerate(one.distances)
    ]
    notes = [
        "Distance: Euclidean over all coordinates at a frame, root mean square over the frames that both have. "
        "Motion: the same of the way from the start. Neither says who is right.",
        "Threshold: published mean RMSE of the real trials, that is how far a typical one is from their mean."
        + (f" * not published: {MOTION_SHARE:.0%} of the motion." if any("*" in row[4] for row in rows) else ""),
    ]
    titles = ("experiment", "between", "distance", "motion", "threshold", "first exceeded")
    return _Section("Where engines disagree: no reference, so distances between them", titles, rows, 2, tuple(notes))


def _scattered(spread: ScoreSpread) -> str:
    scatter = "" if spread.std is None else f" +- {quantity_text(spread.std)}"
    return f"{quantity_text(spread.mean)}{scatter}"


def _apart(far: Distance) -> str:
    ending = ", diverged" if far.diverged else ""
    return ("never" if far.apart_at_s is None else f"{far.apart_at_s:.2f} s") + ending


def _summary_section(comparison: Comparison, labels: Sequence[str]) -> _Section:
    common, ran = comparison.scored_by_all, comparison.run_by_all
    rows: list[tuple[str, ...]] = [
        (
            label,
            str(one.ran),
            str(one.scored),
            str(one.diverged),
            str(one.not_run),
            score_text(one.geometric_mean),
            _cost_text(one.wall_s_per_sim_s),
            _cost_text(one.wall_s_per_sim_s_common),
        )
        for label, one in zip(labels, comparison.summaries(), strict=True)
    ]
    for engine, title in ENGINE_TITLES.items():
        mean = comparison.published_geometric_mean(engine)
        if mean is not None:
            rows.append((f"{title}, paper", "-", "-", "-", "-", score_text(mean), "-", "-"))
    names = [one.name for one in common]
    over = f"over the {len(common)} that all have scored ({shortened(names)})" if common else "none is scored by all"
    notes = (
        f"Geometric mean of the normalized RMSE, {over}. It is descriptive and ranks nothing: experiments differ in "
        "difficulty and in the quality of their reference, the variants of one family are not independent, and release "
        "timing is in it.",
        f"{COST_TITLE}: wall time of reset and steps over simulated time, building the scene not included; repeats "
        f"that ran together share it; in common: over the {len(ran)} that all ran. Comparable only on one machine.",
    )
    titles = ("configuration", "ran", "scored", "diverged", "not run", "geometric mean", COST_TITLE, "in common")
    return _Section("Summary", titles, rows, 1, notes)
