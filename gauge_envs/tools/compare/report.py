"""Report a comparison: the answer, tables of scores, ranks and distances, and JSON rows."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from gauge_envs.errors import UnknownNameError
from gauge_envs.files import json_ready
from gauge_envs.pages.document import Document, Paragraph, Part, Tone
from gauge_envs.pages.results import SCORE_METRICS, configuration_parts, versions_text
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import (
    KIND_NOTES,
    counted,
    interval_text,
    quantity_text,
    score_text,
    with_unit,
)
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome
from gauge_envs.scoring.score import FROM_SOLUTION
from gauge_envs.tools.compare.comparison import (
    Cell,
    ExperimentComparison,
    ScoreComparison,
    constants_of,
)
from gauge_envs.tools.compare.distance import MOTION_SHARE, Distance
from gauge_envs.tools.compare.ranks import KindComparison, Mean

ALL_METRICS = tuple(SCORE_METRICS)

NAME = Column("name", "experiment")
REFERENCE = Column("kind", "reference", place=Place.HEADING)

INTERVAL_NOTE = (
    "[low, high]: 95 % interval; about 90 % for slides of wood and plastic, which have trials far from the others. "
    "+-: standard deviation of repeats (how many). -: not run, or not published."
)

WRONG_NOTE = "*: does not solve the scene; without a solution, unlike reality."

SCALE_NOTE = (
    "RMSE and DTW are divided by the mean of real trials; LSD, MTE and PD by the real value. EL: 0 is ideal. "
    "Distances from a solution are divided by its motion."
)

SHORT_NOTE = "Distance over that of real trials, or over the motion of a solution. --format wide: intervals."

EXACT_NOTE = "exact: the exact motion with the same constants."

RANK_NOTE = "[best, worst] rank that the uncertainty allows, among configurations with the same constants."

NO_RANKS = "No ranks: they need two configurations with the same constants and scores of one experiment."

MIN_RANKED = 3
"""Smallest number of experiments whose mean rank the short report shows."""

DISTANCE_NOTE = (
    "Distance between trajectories and displacement from the initial state: root mean squares over common frames. "
    "Neither shows which engine is right. Threshold: published mean RMSE of real trials; "
    f"*: not published, {MOTION_SHARE:.0%} of the motion."
)

PHYSICS = {
    "": "",
    "own defaults": "(its own defaults)",
    "own options": "(its own options)",
    "corrected": "(corrected by this package)",
}
"""Note on the physics of an engine, by `RunConfiguration.physics`."""


def check_metrics(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of metrics without repetition.

    Raises:
        UnknownNameError: A metric does not exist.
    """
    chosen = tuple(dict.fromkeys(names))
    for name in chosen:
        if name not in SCORE_METRICS:
            raise UnknownNameError("metric", name, SCORE_METRICS)
    return chosen


def comparison_document(
    comparison: ScoreComparison,
    metrics: Sequence[str] = (),
    *,
    is_wide: bool = False,
    with_rows: bool = True,
) -> Document:
    """Return the answer, scores and ranks for each kind of reference, and distances without a reference.

    The rows are the scores of each experiment and the ranks within each kind; `record` names the type of a row.

    Args:
        comparison: The comparison.
        metrics: Metrics to show. Empty means all; a terminal then shows the primary metric of each experiment.
        is_wide: Whether a terminal shows the same as Markdown: all metrics, published engines, and all mean ranks.
        with_rows: Whether the document has JSON rows, which need the distance between each pair of configurations.
    """
    rows = []
    if with_rows:
        rows += comparison_rows(comparison, metrics or ALL_METRICS)
        rows += [_kind_row(comparison, kind) for kind in comparison.kinds]
    return Document(
        parts=compared_parts(comparison, metrics, is_full=is_wide),
        rows=rows,
        markdown=compared_parts(comparison, metrics, is_full=True),
    )


def compared_parts(
    comparison: ScoreComparison, metrics: Sequence[str] = (), *, is_full: bool = False
) -> list[Part]:
    """Return the answer, the tables of scores and mean ranks, and distances between engines without a reference.

    Args:
        comparison: The comparison.
        metrics: Metrics to show; empty for all in a full report, and for the primary metrics in a short one.
        is_full: Whether to show answers in words, published engines, and the mean ranks of few experiments.
    """
    parts: list[Part] = [
        Paragraph(answer, Tone.ANSWER) for answer in _answers(comparison)
    ]
    if is_full:
        parts.append(_score_table(comparison, metrics or ALL_METRICS, is_full=True))
        parts += _mean_rank_tables(comparison)
    else:
        parts += short_tables(comparison, metrics)
    return [*parts, *_distance_tables(comparison)]


def short_tables(
    comparison: ScoreComparison, metrics: Sequence[str] = ()
) -> list[Table]:
    """Return the score of each experiment, and mean ranks within kinds of `MIN_RANKED` or more experiments.

    Args:
        comparison: The comparison.
        metrics: Metrics to show; empty for the primary metric of each experiment.
    """
    ranks = _mean_rank_tables(comparison, min_experiments=MIN_RANKED)
    return [_score_table(comparison, metrics), *ranks]


def _answers(comparison: ScoreComparison) -> Iterator[str]:
    """Yield on how many experiments the best configuration is distinguishable, for each set of constants."""
    rankings: dict[str, list[Mapping[int, Mean]]] = {}
    for kind in comparison.kinds:
        ranked = [ranks for ranks in kind.ranks.values() if len(ranks) > 1]
        if ranked:
            rankings.setdefault(kind.constants, []).extend(ranked)
    if not rankings:
        yield NO_RANKS
    for ranked in rankings.values():
        yield _answer(ranked, comparison.labels)


def _answer(rankings: Sequence[Mapping[int, Mean]], all_labels: Sequence[str]) -> str:
    """Return on how many experiments each configuration ranks first.

    Args:
        rankings: Ranks of each experiment, by index of the configuration.
        all_labels: Label of each configuration.
    """
    firsts: Counter[str] = Counter()
    members: set[int] = set()
    for ranks in rankings:
        members.update(ranks)
        for index, rank in ranks.items():
            if rank.interval_95 == (1.0, 1.0):
                firsts[all_labels[index]] += 1
    count = counted(len(rankings), "experiment")
    shared = len(rankings) - firsts.total()
    if len(members) == 2 and shared:
        closer = (f"{label} is closer on {wins}" for label, wins in firsts.items())
        return f"{'; '.join([f'Same on {shared} of {count}', *closer])}."
    closest = [f"{label} on {wins}" for label, wins in firsts.items()]
    if shared:
        closest.append(f"several on {shared}")
    return f"Closest: {', '.join(closest)} of {count}."


# --- JSON ------------------------------------------------------------------------------------------------------------


def comparison_rows(
    comparison: ScoreComparison, metrics: Sequence[str]
) -> list[dict[str, Any]]:
    """Return a JSON-ready object for each experiment and metric.

    An experiment without these metrics has one object with `metric` None.
    """
    rows = []
    for experiment in comparison.experiments:
        distances = []
        for distance in experiment.distances:
            names = {
                "first": comparison.labels[distance.first],
                "second": comparison.labels[distance.second],
            }
            distances.append(asdict(distance) | names)
        shared = {"distances": distances, "notes": comparison.notes}
        shown: list[str | None] = [*experiment.metrics(metrics)]
        for metric in shown or [None]:
            rows.append(_experiment_row(comparison, experiment, metric) | shared)
    return json_ready(rows)


def _experiment_row(
    comparison: ScoreComparison, experiment: ExperimentComparison, metric: str | None
) -> dict[str, Any]:
    """Return the scores of an experiment by a metric."""
    row: dict[str, Any] = {
        "record": "experiment",
        "id": experiment.id,
        "kind": experiment.kind.value,
        "metric": metric,
        "unit": None,
        "real": None,
        "published": None,
    }
    if metric is not None:
        row["unit"] = experiment.unit_of(metric)
        row["published"] = experiment.published(metric)
        baseline = experiment.baselines.get(metric)
        if baseline is not None:
            row["real"] = {"mean": baseline.mean, "std": baseline.std}
    row["configurations"] = []
    for index, configuration in enumerate(comparison.configurations):
        cell = experiment.cells[index] or Cell(results=())
        facts = {"label": comparison.labels[index], **asdict(configuration)}
        row["configurations"].append(facts | _cell_row(cell, metric))
    return row


def _cell_row(cell: Cell, metric: str | None) -> dict[str, Any]:
    ran = next((result for result in cell.results if result.error is None), None)
    return {
        "outcomes": [result.outcome.value for result in cell.results],
        "reasons": [
            result.error or result.diverged_reason or result.score.refused
            for result in cell.results
        ],
        "seeds": [result.seed for result in cell.results],
        "raw": _spread_row(cell, metric, normalized=False),
        "normalized": _spread_row(cell, metric, normalized=True),
        "normalized_95": metric and cell.interval_95(metric),
        "solves": [result.score.solves for result in cell.results],
        "like_reality": [result.score.like_reality for result in cell.results],
        "settings": ran and ran.settings,
        "versions": ran and ran.versions,
    }


def _spread_row(
    cell: Cell, metric: str | None, *, normalized: bool
) -> dict[str, Any] | None:
    """Return mean, scatter and values of a metric over the repeats."""
    if metric is None:
        return None
    spread = cell.spread(metric, normalized=normalized)
    if spread is None:
        return None
    return asdict(spread) | {"values": cell.values(metric, normalized=normalized)}


def _kind_row(comparison: ScoreComparison, kind: KindComparison) -> dict[str, Any]:
    """Return the ranks within a kind."""
    configurations = []
    for index, mean in kind.mean_ranks.items():
        ranks = {
            name: asdict(places[index])
            for name, places in kind.ranks.items()
            if index in places
        }
        facts = {
            "label": comparison.labels[index],
            "mean_rank": mean and mean.value,
            "mean_rank_95": mean and mean.interval_95,
            "ranks": ranks,
        }
        configurations.append(facts)
    return {
        "record": "kind",
        "kind": kind.kind.value,
        "constants": kind.constants,
        "ids": kind.ids,
        "configurations": configurations,
    }


# --- scores ----------------------------------------------------------------------------------------------------------


def score_cell_text(cell: Cell, metric: str, unit: str, *, is_full: bool = True) -> str:
    """Return the mean of a metric over repeats, for example `0.41 [0.17, 1.43] +- 0.05 (3)`; empty without a score.

    Args:
        cell: Repeats of a configuration.
        metric: A key of `SCORE_METRICS`.
        unit: Unit of a score without normalization.
        is_full: Whether to show the interval, the scatter of repeats, and what a solution's score is divided by.
    """
    spread = cell.spread(metric, normalized=True)
    if spread is None:
        spread = cell.spread(metric, normalized=False)
    elif metric == FROM_SOLUTION and is_full:
        unit = "of the motion"
    else:
        unit = "1"
    if spread is None:
        return ""
    if not is_full:
        return with_unit(score_text(spread.mean), unit)
    text = interval_text(spread.mean, cell.interval_95(metric))
    if spread.std is not None:
        text += f" +- {score_text(spread.std)} ({spread.count})"
    return with_unit(text, unit)


def _score_table(
    comparison: ScoreComparison, metrics: Sequence[str], *, is_full: bool = False
) -> Table:
    """Return a table with a row for each experiment and metric, and a column for each configuration.

    Args:
        comparison: The comparison.
        metrics: Metrics to show; empty for the primary metric of each experiment.
        is_full: Whether to show answers in words and published engines as columns.
    """
    rows = []
    for kind in Kind:
        for experiment in comparison.experiments:
            if experiment.kind is kind:
                rows += _score_rows(experiment, metrics, is_full=is_full)
    columns = [REFERENCE, NAME]
    if is_full or not all(row["is_primary"] for row in rows):
        columns.append(Column("metric", "metric"))
    for index, label in enumerate(comparison.labels):
        columns.append(Column(f"scores.{index}", label, is_number=True))
    columns += _exact_columns(comparison, rows)
    if is_full and any(row["published"] for row in rows):
        for engine, title in PUBLISHED_ENGINES.items():
            key, paper_title = f"published.{engine}", f"{title}, paper"
            columns.append(Column(key, paper_title, score_text, is_number=True))
    return Table(
        title="Scores, with 95 % intervals" if is_full else "Scores",
        columns=tuple(columns),
        rows=rows,
        notes=tuple(_score_notes(comparison, columns, rows, is_full=is_full)),
    )


def _exact_columns(
    comparison: ScoreComparison, rows: Sequence[dict[str, Any]]
) -> Iterator[Column]:
    """Add the score of the exact motion to the rows, and yield a column for each set of constants with one."""
    members: dict[str, list[int]] = {}
    for index, constants in enumerate(comparison.constants):
        members.setdefault(constants, []).append(index)
    for indices in members.values():
        key = f"exact {indices[0]}"
        for row in rows:
            exact = [row["exact"][index] for index in indices if row["is_primary"]]
            row[key] = next((value for value in exact if value is not None), None)
        if any(row[key] is not None for row in rows):
            title = "exact"
            if len(members) > 1:
                title += f", {constants_of(comparison.configurations[indices[0]], 6)}"
            yield Column(key, title, score_text, is_number=True)


def _score_rows(
    experiment: ExperimentComparison, metrics: Sequence[str], *, is_full: bool
) -> list[dict[str, Any]]:
    """Return a row for each shown metric of an experiment; an experiment without a score has one row."""
    names: list[str | None] = [*experiment.shown_metrics(metrics or ALL_METRICS)]
    if not metrics:
        names = names[:1]
    return [_score_row(experiment, name, is_full=is_full) for name in names or [None]]


def _score_row(
    experiment: ExperimentComparison, metric: str | None, *, is_full: bool
) -> dict[str, Any]:
    row = {
        "kind": f"{experiment.kind}: {KIND_NOTES[experiment.kind]}",
        "name": experiment.name,
        "metric": "-",
        "is_primary": metric in (experiment.primary, None),
        "scores": [
            _score_text(experiment, cell, metric, is_full=is_full)
            for cell in experiment.cells
        ],
        "published": None,
        "exact": [_exact_score(cell) for cell in experiment.cells],
    }
    if metric is not None:
        row["metric"] = SCORE_METRICS[metric].title
        row["published"] = experiment.published(metric)
    return row


def _exact_score(cell: Cell | None) -> float | None:
    """Return the score of the exact motion of the first result that has one."""
    scores = (result.score.exact for result in cell.results) if cell else ()
    return next((score for score in scores if score is not None), None)


def _score_text(
    experiment: ExperimentComparison,
    cell: Cell | None,
    metric: str | None,
    *,
    is_full: bool,
) -> str:
    """Return the score of a configuration, or the reason for a missing score."""
    if cell is None:
        return "-"
    texts = _outcome_texts(cell)
    if metric is not None:
        unit = experiment.unit_of(metric)
        texts.insert(0, score_cell_text(cell, metric, unit, is_full=is_full))
    text = ", ".join(filter(None, texts))
    if metric in (experiment.primary, None) and cell.is_wrong:
        text += " *"
    return text or "no score"


def _outcome_texts(cell: Cell) -> list[str]:
    """Return each outcome without a score, with its count unless all repeats have it."""
    texts = []
    for outcome in (Outcome.DIVERGED, Outcome.FAILED, Outcome.UNSUPPORTED):
        count = cell.count(outcome)
        if count == len(cell.results):
            texts.append(outcome.value)
        elif count:
            texts.append(f"{count} {outcome}")
    return texts


def _score_notes(
    comparison: ScoreComparison,
    columns: Sequence[Column],
    rows: Sequence[dict[str, Any]],
    *,
    is_full: bool,
) -> Iterator[str]:
    """Yield the notes of the table of scores, those of its columns and marks alone."""
    notes = [SCALE_NOTE, INTERVAL_NOTE] if is_full else [SHORT_NOTE]
    if any(column.title.startswith("exact") for column in columns):
        notes.append(EXACT_NOTE)
    if any(text.endswith("*") for row in rows for text in row["scores"]):
        notes.append(WRONG_NOTE)
    yield " ".join(notes)
    yield " ".join(_configuration_notes(comparison.configurations))
    for note in comparison.notes:
        yield f"Note: {note}."


def _configuration_notes(configurations: Sequence[RunConfiguration]) -> Iterator[str]:
    """Yield the common parts of all configurations, and the versions and physics of the engines."""
    if len(configurations) > 1:
        exact = [
            configuration_parts(configuration, digits=17)
            for configuration in configurations
        ]
        common = set(exact[0]).intersection(*exact[1:])
        shown = configuration_parts(configurations[0])
        shared = [
            text
            for part, (_, text) in zip(exact[0], shown, strict=True)
            if part in common
        ]
        if shared:
            yield f"All configurations: {', '.join(shared)}."
    engines = dict.fromkeys(map(_engine_text, configurations))
    yield f"Engines: {'; '.join(engines)}."


def _engine_text(configuration: RunConfiguration) -> str:
    """Return the versions of an engine with a note on its physics."""
    name = versions_text(configuration) or configuration.backend or "file"
    return f"{name} {PHYSICS[configuration.physics]}".strip()


# --- ranks and distances ----------------------------------------------------------------------------------------------


def _mean_rank_tables(
    comparison: ScoreComparison, *, min_experiments: int = 1
) -> list[Table]:
    """Return the table of mean ranks within each kind of reference; empty without ranks."""
    rows = []
    for kind in comparison.kinds:
        if len(kind.ids) < min_experiments or len(kind.mean_ranks) < 2:
            continue
        title = f"{kind.name}, {counted(len(kind.ids), 'experiment')}"
        ranked = [(mean, index) for index, mean in kind.mean_ranks.items() if mean]
        for mean, index in sorted(ranked, key=lambda pair: pair[0].value):
            label = comparison.labels[index]
            rows.append({"kind": title, "label": label, "mean_rank": mean})
    if not rows:
        return []
    rank = Column("mean_rank", "mean rank", _mean_rank_text, is_number=True)
    return [
        Table(
            title="Mean rank within each kind of reference",
            columns=(REFERENCE, Column("label", "configuration"), rank),
            rows=rows,
            notes=(RANK_NOTE,),
        )
    ]


def _mean_rank_text(mean: Mean) -> str:
    """Return a mean rank with its interval."""
    low, high = mean.interval_95
    return f"{mean.value:.1f} [{low:.1f}, {high:.1f}]"


def _distance_tables(comparison: ScoreComparison) -> list[Table]:
    """Return the table of distances between engines in experiments without a reference; empty without distances."""
    rows = []
    for experiment in comparison.experiments:
        if experiment.kind is not Kind.NONE:
            continue
        for distance in experiment.distances:
            first = comparison.labels[distance.first]
            second = comparison.labels[distance.second]
            row = {"name": experiment.name, "between": f"{first} : {second}"}
            rows.append(row | _distance_texts(distance))
    if not rows:
        return []
    titles = ("distance", "of the motion", "motion", "threshold", "first exceeded")
    numbers = (Column(title, title, is_number=True) for title in titles)
    return [
        Table(
            title="Distances between engines, without a reference",
            columns=(NAME, Column("between", "between"), *numbers),
            rows=rows,
            notes=(DISTANCE_NOTE,),
        )
    ]


def _distance_texts(distance: Distance) -> dict[str, str]:
    texts = {
        "distance": quantity_text(distance.rms.mean),
        "of the motion": distance.share_text,
        "motion": f"{quantity_text(distance.motion_rms)} {distance.unit}",
        "threshold": f"{quantity_text(distance.threshold)} {distance.unit}",
        "first exceeded": "never",
    }
    if distance.rms.std is not None:
        texts["distance"] += f" +- {quantity_text(distance.rms.std)}"
    texts["distance"] += f" {distance.unit}"
    if not distance.threshold_is_scatter:
        texts["threshold"] += " *"
    if distance.apart_at_s is not None:
        texts["first exceeded"] = f"{distance.apart_at_s:.2f} s"
    if distance.diverged:
        texts["first exceeded"] += ", diverged"
    return texts
