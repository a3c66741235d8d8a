"""Results of episodes beside the published scores, and what sets results apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from gauge_envs.analysis.configuration import RunConfiguration
from gauge_envs.references.bands import BandGrade
from gauge_envs.references.metrics import METRICS
from gauge_envs.references.published import published_baselines
from gauge_envs.report.text import (
    ENGINE_TITLES,
    GRADE_NOTES,
    METRIC_TITLES,
    NORMALIZED_NOTE,
    number_text,
    shortened,
    value_text,
)
from gauge_envs.runs.result import Outcome, Result

__all__ = [
    "PLAIN",
    "configuration_labels",
    "configuration_parts",
    "result_label",
    "summary_view",
    "versions_text",
]


PLAIN = ("parameters", "calibrated")
"""What a configuration has where nothing else is said."""


def configuration_labels(configurations: Sequence[RunConfiguration]) -> list[str]:
    """What sets each configuration apart from the others: the engine, and whatever they do not all share.

    A single one is told in full, `mujoco, calibrated`; among several, `calibrated` goes without saying.
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
    """What a configuration consists of, as kind and text; numbers are rounded to the digits."""

    def told(values: Mapping[str, Any]) -> list[str]:
        return [f"{key}={f'{v:.{digits}g}' if isinstance(v, float) else value_text(v)}" for key, v in values.items()]

    named = configuration.parameters
    return [
        ("engine", configuration.backend or "file"),
        ("parameters", named if isinstance(named, str) else ",".join(told(named))),
        *(("setting", text) for text in told(configuration.settings_given)),
        *([("jitter", f"jitter {' '.join(told(configuration.jitter))}")] if configuration.jitter else []),
        *([("markers", f"markers by {configuration.marker_proxy}")] if configuration.marker_proxy != "node" else []),
        *([("asset", _asset_text(configuration.asset))] if configuration.asset else []),
    ]


def _asset_text(asset: Mapping[str, str]) -> str:
    return f"edited scene {asset['file']} ({asset['sha256'][:8]})"


def versions_text(configuration: RunConfiguration) -> str:
    """Versions of a configuration's engine."""
    return " ".join(f"{name} {text}" for name, text in configuration.engine_versions.items())


def result_label(result: Result) -> str:
    """What sets a result apart from others of its experiment: `mujoco, calibrated, timestep_s=0.001, seed 3`."""
    told = [text for _, text in configuration_parts(RunConfiguration.of(result))]
    return ", ".join([*told, f"seed {result.seed}"] if result.seed else told)


def summary_view(results: Sequence[Result]) -> Group:
    """Scores of results beside the published ones, with grades and what the numbers mean; then what was not run."""
    ran = [result for result in results if result.error is None]
    parts: list[Any] = []
    if ran:
        parts += [_ScoreTable(ran), Text("")]
        parts.append(Text(NORMALIZED_NOTE, style="dim"))
        parts.append(
            Text(
                "Aligned: normalized RMSE after the constant time shift in brackets (reality is let go later when +). "
                "|z|: mean deviation in sigma of the real trials; one more real trial has 0.80.",
                style="dim",
            )
        )
        grades = sorted({result.score.grade for result in ran})
        parts += [Text(f"Grade {grade}: {GRADE_NOTES[BandGrade(grade)]}.", style="dim") for grade in grades]
        parts += [
            Text(f"{result.id.removeprefix('GAUGE/')} is scored on a band that is withheld: {result.score.withheld}.")
            for result in ran
            if result.score.withheld
        ]
        parts += [
            Text(f"{result.id.removeprefix('GAUGE/')}, {result.asset['file']}: {shortened(result.asset['changes'])}.")
            for result in ran
            if result.is_edited
        ]
    for outcome, style in ((Outcome.DIVERGED, "red"), (Outcome.FAILED, "red"), (Outcome.DECLINED, "yellow")):
        # One line for each reason: a backend declines many experiments for the same one.
        reasons: dict[str, list[str]] = {}
        for result in results:
            if result.outcome is outcome:
                name = result.id.removeprefix("GAUGE/")
                reason = (result.error or result.diverged_reason or "").replace(f"{result.id}: ", "")
                reasons.setdefault(reason.removeprefix(f"{name} "), []).append(name)
        parts += [
            Text.assemble((f"{outcome.value}: ", style), f"{shortened(ids)}: {reason}")
            for reason, ids in reasons.items()
        ]
    return Group(*parts)


WIDE = 110
"""Characters from which on the published engines stand beside the scores."""


class _ScoreTable:
    """Scores, and where the terminal is wide enough those of the published engines: numbers must not be cut short."""

    def __init__(self, results: Sequence[Result]) -> None:
        self._results = results

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield _score_table(self._results, with_engines=options.max_width >= WIDE)


def _score_table(results: Sequence[Result], *, with_engines: bool) -> Table:
    engines = ENGINE_TITLES.values() if with_engines else ()
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("experiment", overflow="fold", min_width=16)
    table.add_column("grade", min_width=5)
    table.add_column("metric", min_width=6)
    for title in ("score", "normalized", *engines, "aligned", "|z|"):
        table.add_column(title, justify="right", no_wrap=True)
    for result in results:
        rows = [(*row[:3], *(row[3:-2] if with_engines else ()), *row[-2:]) for row in _score_rows(result)]
        driven = ", nominal driver" if "nominal" in (result.driver_provenance or "") else ""
        names = [result.id.removeprefix("GAUGE/"), f"[dim]{escape(result_label(result) + driven)}[/]"]
        for index in range(max(len(rows), len(names))):
            name = names[index] if index < len(names) else ""
            table.add_row(name, result.score.grade if index == 0 else "", *(rows[index] if index < len(rows) else ()))
    return table


def _score_rows(result: Result) -> list[tuple[str, ...]]:
    """Rows of metric, score, normalized score, three engines, aligned, |z|: every metric that we or the paper have."""
    if result.diverged:
        return [("", "[red]diverged[/]", "-", "-", "-", "-", "-", "-")]
    score, baselines = result.score, published_baselines(result.id.removeprefix("GAUGE/"))
    rows = []
    for metric, title in METRIC_TITLES.items():
        raw = getattr(score, METRICS[metric].score_field)
        line = baselines.get(metric)
        if raw is None and line is None:
            continue
        unit = "" if METRICS[metric].unit == "1" else METRICS[metric].unit_of(score.unit)
        aligned, z = "", ""
        if metric == "rmse":
            z = number_text(score.mean_abs_z)
            if score.rmse_aligned_normalized is not None and score.release_offset_s is not None:
                aligned = f"{number_text(score.rmse_aligned_normalized)} ({score.release_offset_s:+.3f} s)"
        rows.append(
            (
                title,
                "-" if raw is None else f"{number_text(raw)} {unit}".strip(),
                number_text(getattr(score, f"{metric}_normalized", None)),
                *(number_text(line.engines[engine] if line else None) for engine in ENGINE_TITLES),
                aligned,
                z,
            )
        )
    return rows or [("none", "-", "-", "-", "-", "-", "", "")]
