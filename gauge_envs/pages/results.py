"""Results of episodes beside the published scores, and labels that distinguish them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.pages.convergence import convergence_rows, convergence_text
from gauge_envs.pages.estimators import estimator_lines
from gauge_envs.pages.table import Column, Place, Table, as_rich
from gauge_envs.pages.text import (
    ALIGNED_TITLE,
    DEFORMATION_NOTE,
    ENGINE_TITLES,
    GRADE_NOTES,
    METRIC_TITLES,
    NORMALIZED_NOTE,
    interval_text,
    number_text,
    short_id,
    shortened,
    value_text,
)
from gauge_envs.references.bands import BandGrade
from gauge_envs.references.metrics import METRICS
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome, Result

PLAIN = ("parameters", "calibrated")
"""Part of a configuration that labels leave out."""


def configuration_labels(configurations: Sequence[RunConfiguration]) -> list[str]:
    """Return a label for each configuration: the engine, and what the configurations do not all share.

    The label of a single one has all parts, `mujoco, calibrated`. Among several, `calibrated` is left out.
    """
    labels = _labels(configurations, digits=4)
    if len(set(labels)) < len(labels):
        labels = _labels(configurations, digits=17)
    return [
        label if labels.count(label) == 1 else f"{label} ({labels[:index].count(label) + 1})"
        for index, label in enumerate(labels)
    ]


def _labels(configurations: Sequence[RunConfiguration], *, digits: int) -> list[str]:
    exact = [configuration_parts(configuration, digits=17) for configuration in configurations]
    left_out = set.intersection(*map(set, exact)) | {PLAIN} if len(exact) > 1 else set()
    versions_of: dict[str | None, set[str]] = {}
    for configuration in configurations:
        versions_of.setdefault(configuration.backend, set()).add(versions_text(configuration))
    labels = []
    for configuration, parts in zip(configurations, exact, strict=True):
        rounded = configuration_parts(configuration, digits=digits)
        kept = [
            text for part, (kind, text) in zip(parts, rounded, strict=True) if kind == "engine" or part not in left_out
        ]
        if len(versions_of[configuration.backend]) > 1:
            kept.append(versions_text(configuration))
        labels.append(", ".join(kept))
    return labels


def configuration_parts(configuration: RunConfiguration, *, digits: int = 4) -> list[tuple[str, str]]:
    """Return the parts of a configuration as kind and text, with numbers rounded to the digits."""

    def assignments(values: Mapping[str, Any]) -> list[str]:
        return [f"{key}={f'{v:.{digits}g}' if isinstance(v, float) else value_text(v)}" for key, v in values.items()]

    named, proxy = configuration.parameters, configuration.marker_proxy
    return [
        ("engine", configuration.backend or "file"),
        ("parameters", named if isinstance(named, str) else ",".join(assignments(named))),
        *(("setting", text) for text in assignments(configuration.settings_given)),
        *([("jitter", f"jitter {' '.join(assignments(configuration.jitter))}")] if configuration.jitter else []),
        *([("markers", f"markers by {proxy}")] if proxy != MarkerProxy.MATERIAL else []),
        *([("asset", _asset_text(configuration.asset))] if configuration.asset else []),
    ]


def _asset_text(asset: Mapping[str, str]) -> str:
    return f"edited scene {asset['file']} ({asset['sha256'][:8]})"


def versions_text(configuration: RunConfiguration) -> str:
    """Return the versions of a configuration's engine."""
    return " ".join(f"{name} {text}" for name, text in configuration.engine_versions.items())


def result_label(result: Result) -> str:
    """Return the label of a result among others of its experiment: `mujoco, calibrated, timestep_s=0.001, seed 3`."""
    parts = [text for _, text in configuration_parts(RunConfiguration.of(result))]
    return ", ".join([*parts, f"seed {result.seed}"] if result.seed else parts)


RESULT_COLUMNS = (
    Column("id", "experiment", short_id, place=Place.HEADING),
    Column("grade", "grade", place=Place.HEADING),
    Column("label", "", place=Place.HEADING),
    Column("metric", "metric"),
    Column("score", "score", is_number=True, style=lambda text: "red" if text == Outcome.DIVERGED.value else ""),
    Column("normalized", "normalized [95 %]", is_number=True),
    Column("percentile", "%", lambda percentile: f"{percentile:.0f}", is_number=True),
    *(Column(f"engines.{key}", title, number_text, is_number=True) for key, title in ENGINE_TITLES.items()),
    Column("extrapolated", "extrapolated", lambda share: f"{100.0 * share:.0f} %", is_number=True, wide_only=True),
    Column("z", "|z|", number_text, is_number=True, wide_only=True),
    Column("convergence", "discretization", place=Place.BELOW),
    Column("shift", "shift", lambda shift_s: f"{shift_s:+.3f} s", is_number=True, wide_only=True),
)


BUDGET_COLUMNS = (
    Column("id", "experiment", short_id, place=Place.HEADING),
    Column("label", "", place=Place.HEADING),
    Column("name", "contribution"),
    Column("evaluation", "type"),
    Column("standard_uncertainty", "u", lambda value: f"{value:.3f}", is_number=True),
    Column("share", "share", lambda share: f"{100.0 * share:.0f} %", is_number=True),
    Column("source", "source", wide_only=True),
)

BUDGET_NOTE = (
    "u: standard uncertainty of the score that is shown first, normalized. Type A is from observations, B from other "
    "knowledge (GUM). Share: of the variance. --format wide shows the sources."
)


def _statistic_text(value: float) -> str:
    # Adding 0.0 makes a rounded -0.0000 plain zero.
    return f"{round(value, 4) + 0.0:.4f}"


DEFORMATION_COLUMNS = (
    Column("id", "experiment", short_id, place=Place.HEADING),
    Column("label", "", place=Place.HEADING),
    Column("name", "statistic"),
    Column("unit", "unit", wide_only=True),
    Column("frame", "frame", str, is_number=True),
    Column("simulated", "simulated", _statistic_text, is_number=True),
    Column("real", "real", _statistic_text, is_number=True),
    Column("uncertainty", "+-", _statistic_text, is_number=True),
    Column("z", "z", number_text, is_number=True),
    Column("z_rms", "z rms", number_text, is_number=True),
)


def deformation_table(results: Sequence[Result]) -> Table:
    """Return the statistics of deformation of results beside the real ones, grade `statistics`."""
    rows = [
        {"id": result.id, "label": result_label(result), **asdict(statistic)}
        for result in results
        if result.deformation is not None
        for statistic in result.deformation.statistics
    ]
    notes = {
        f"{short_id(result.id)}: {result.deformation.note}."
        for result in results
        if result.deformation is not None and result.deformation.note
    }
    return Table(
        columns=DEFORMATION_COLUMNS,
        rows=rows,
        title="Deformation, grade statistics (no part of the score)",
        notes=(DEFORMATION_NOTE, *sorted(notes)),
    )


def _implied_line(result: Result) -> str:
    """Return the parameters that a result implies beside those of the real trials, in one line."""
    parts = []
    for one in result.score.implied:
        unit = "" if one.unit == "1" else f" {one.unit}"
        spread = "" if one.real_uncertainty is None else f" +- {one.real_uncertainty:.2g}"
        if one.parameter == "release_time":
            parts.append(f"real release {one.real:+.3f}{spread} s")
        elif one.real is None:
            parts.append(f"{one.parameter.replace('_', ' ')} {_rounded(one.value)}{unit}")
        else:
            parts.append(
                f"{one.parameter.replace('_', ' ')} {_rounded(one.value)} (real {_rounded(one.real)}{spread}){unit}"
            )
    return f"{short_id(result.id)} implies {', '.join(parts)}."


def _rounded(value: float) -> str:
    # A pendulum without friction decays by rounding errors.
    return f"{value:.4g}" if abs(value) > 1e-9 else "0"


def budget_table(results: Sequence[Result]) -> Table:
    """Return the uncertainty budgets of results."""
    rows = [
        {"id": result.id, "label": result_label(result), **asdict(entry)}
        for result in results
        for entry in result.score.budget
    ]
    origins = sorted({result.score.sensitivities for result in results if result.score.sensitivities})
    notes = (BUDGET_NOTE, *(f"Sensitivities: {origin}." for origin in origins))
    return Table(columns=BUDGET_COLUMNS, rows=rows, title="Uncertainty budget", notes=notes)


def summary_view(results: Sequence[Result], *, wide: bool = False, budget: bool = False) -> Group:
    """Return scores of results beside the published ones, what the numbers mean, and what was not run and why.

    Args:
        results: The results.
        wide: Show columns that are left out by default.
        budget: Show the uncertainty budgets.
    """
    ran = [result for result in results if result.error is None]
    parts: list[RenderableType] = []
    if ran:
        rows = [row for result in ran for row in _score_rows(result)]
        parts.append(as_rich(Table(columns=RESULT_COLUMNS, rows=rows, notes=_score_notes(ran)), wide=wide))
    if budget and any(result.score.budget for result in ran):
        parts.append(as_rich(budget_table(ran), wide=wide))
    if any(result.deformation is not None for result in ran):
        parts.append(as_rich(deformation_table(ran), wide=wide))
    for result in ran:
        name = short_id(result.id)
        if result.score.implied:
            parts.append(Text(_implied_line(result)))
        if result.score.withheld:
            parts.append(Text(f"{name} is scored on a band that is withheld: {result.score.withheld}."))
        parts += map(Text, estimator_lines(name, result.score))
        if result.is_edited:
            parts.append(Text(f"{name}, {result.asset['file']}: {shortened(result.asset['changes'])}."))
    return Group(*parts, *_outcome_lines(results))


def _score_notes(results: Sequence[Result]) -> tuple[str, ...]:
    grades = sorted({result.score.grade for result in results})
    return (
        "",
        NORMALIZED_NOTE,
        "%: real trials that are closer to their mean. Aligned: after the best time shift. --format wide shows more "
        "columns.",
        *(f"Grade {grade}: {GRADE_NOTES[BandGrade(grade)]}." for grade in grades),
    )


def _outcome_lines(results: Sequence[Result]) -> Iterator[Text]:
    """Yield a line for each reason: a backend declines many experiments for the same one."""
    for outcome, style in ((Outcome.DIVERGED, "red"), (Outcome.FAILED, "red"), (Outcome.DECLINED, "yellow")):
        reasons: dict[str, list[str]] = {}
        for result in results:
            if result.outcome is outcome:
                name = short_id(result.id)
                reason = (result.error or result.diverged_reason or "").replace(f"{result.id}: ", "")
                reasons.setdefault(reason.removeprefix(f"{name} "), []).append(name)
        for reason, ids in reasons.items():
            yield Text.assemble((f"{outcome.value}: ", style), f"{shortened(ids)}: {reason}")


def discretization_text(result: Result) -> str | None:
    """Return what half the step and half the cell change, or None for other settings or another scene."""
    if result.backend is None or result.settings_given or result.is_edited or result.has_experiment_file:
        return None
    name = short_id(result.id)
    has_cells = bool(load_experiment(name).scene.deformables)
    return convergence_text(convergence_rows(result.backend, name), has_cells=has_cells)


def _score_rows(result: Result) -> list[dict[str, Any]]:
    """Return a row for each metric that the result or the paper has."""
    driver = ", nominal driver" if "nominal" in (result.driver_provenance or "") else ""
    common = {"id": result.id, "grade": result.score.grade, "label": result_label(result) + driver}
    if result.diverged:
        return [common | {"score": Outcome.DIVERGED.value}]
    score, baselines = result.score, published_baselines(short_id(result.id))
    rows: list[dict[str, Any]] = []
    if score.rmse_aligned_normalized is not None:
        rows.append(
            common
            | {
                "metric": ALIGNED_TITLE,
                "score": f"{number_text(score.rmse_aligned)} {score.unit}",
                "normalized": interval_text(score.rmse_aligned_normalized, score.rmse_aligned_normalized_95),
                "percentile": score.percentile_aligned,
                "shift": score.release_offset_s,
            }
        )
    for metric, title in METRIC_TITLES.items():
        known, line = METRICS[metric], baselines.get(metric)
        raw = getattr(score, known.score_field)
        if raw is None and line is None:
            continue
        unit = "" if known.unit == "1" else f" {known.unit_of(score.unit)}"
        normalized = getattr(score, f"{metric}_normalized", None)
        is_partial = known.is_normalized and raw is not None and normalized is None
        row: dict[str, Any] = common | {
            "metric": title,
            "score": None if raw is None else f"{number_text(raw)}{unit}",
            "normalized": (
                None
                if normalized is None
                else interval_text(normalized, getattr(score, f"{metric}_normalized_95", None))
            ),
            # Published scores are over the whole motion. Some laws hold for its first frames alone.
            "engines": None if line is None or is_partial else line.engines,
        }
        if metric == "rmse":
            row |= {"z": score.mean_abs_z, "percentile": score.percentile, "extrapolated": score.extrapolated_share}
            row["convergence"] = discretization_text(result)
        rows.append(row)
    # The aligned score comes first where the experiment starts with a release, else after the raw one.
    if score.primary == "rmse" and len(rows) > 1 and rows[0]["metric"] == ALIGNED_TITLE:
        rows[0], rows[1] = rows[1], rows[0]
    return rows or [common]
