"""Texts of results: labels of configurations, and metrics of scores."""

from collections.abc import Mapping, Sequence
from typing import Any

from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.pages.text import value_text
from gauge_envs.references.metrics import METRICS, Metric
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.scoring.score import OVER_U, Score

# --- labels ---

PLAIN = ("parameters", "calibrated")
"""Part of a configuration that labels omit."""


def configuration_labels(configurations: Sequence[RunConfiguration]) -> list[str]:
    """Return a label for each configuration: the engine, and the parts that are not common to all.

    A single configuration has all parts, `mujoco, calibrated`. For several, `calibrated` is omitted.
    """
    labels = _labels(configurations, digits=4)
    if len(set(labels)) < len(labels):
        labels = _labels(configurations, digits=17)
    return [
        label
        if labels.count(label) == 1
        else f"{label} ({labels[:index].count(label) + 1})"
        for index, label in enumerate(labels)
    ]


def _labels(configurations: Sequence[RunConfiguration], *, digits: int) -> list[str]:
    exact = [
        configuration_parts(configuration, digits=17)
        for configuration in configurations
    ]
    rounded = [
        configuration_parts(configuration, digits=digits)
        for configuration in configurations
    ]
    left_out = set.intersection(*map(set, exact)) | {PLAIN} if len(exact) > 1 else set()
    versions = [
        (configuration.backend, versions_text(configuration))
        for configuration in configurations
    ]
    engines_of_versions = [backend for backend, _ in set(versions)]
    labels = []
    for parts, shown, (backend, text) in zip(exact, rounded, versions, strict=True):
        kept = [
            words
            for part, (kind, words) in zip(parts, shown, strict=True)
            if kind == "engine" or part not in left_out
        ]
        if engines_of_versions.count(backend) > 1:
            kept.append(text)
        labels.append(", ".join(kept))
    return labels


def configuration_parts(
    configuration: RunConfiguration, *, digits: int = 4
) -> list[tuple[str, str]]:
    """Return the parts of a configuration as kind and text, with numbers rounded to the digits."""

    def assignments(values: Mapping[str, Any]) -> list[str]:
        return [
            f"{key}={f'{v:.{digits}g}' if isinstance(v, float) else value_text(v)}"
            for key, v in values.items()
        ]

    named, asset = configuration.parameters, configuration.asset
    constants = named if isinstance(named, str) else ",".join(assignments(named))
    parts = [("engine", configuration.backend or "file"), ("parameters", constants)]
    parts += [
        ("setting", setting) for setting in assignments(configuration.settings_given)
    ]
    if configuration.jitter:
        parts.append(
            ("jitter", f"jitter {' '.join(assignments(configuration.jitter))}")
        )
    if configuration.marker_proxy != MarkerProxy.MATERIAL:
        parts.append(("markers", f"markers by {configuration.marker_proxy}"))
    if asset:
        parts.append(("asset", f"edited scene {asset['file']} ({asset['sha256'][:8]})"))
    return parts


def versions_text(configuration: RunConfiguration) -> str:
    """Return the versions of a configuration's engine."""
    return " ".join(
        f"{name} {text}" for name, text in configuration.engine_versions.items()
    )


# --- scores ---

ALIGNED = Metric(key="rmse_aligned", title="RMSE aligned", unit=None)
"""The RMSE after the best constant time shift, which was not published."""

VERIFIED = Metric(key=OVER_U, title="distance from the solution", unit=None)
"""The distance from a solution of the scene, in its unit and over u."""

SCORE_METRICS: Mapping[str, Metric] = {
    metric.key: metric
    for is_event in (False, True)
    for metric in (*METRICS.values(), ALIGNED, VERIFIED)
    if metric.is_event is is_event
}
"""Metrics of a score by key, in the order of tables: first those that need a reference motion, then events."""


def raw_score(score: Score, metric: str) -> float | None:
    """Return a metric in its unit; None if the score does not have it."""
    if SCORE_METRICS[metric].is_event:
        event = score.events.get(metric)
        return None if event is None else event.value
    if metric == OVER_U:
        return score.distance if score.primary == OVER_U else None
    value: float | None = getattr(score, metric)
    return value


def normalized_score(score: Score, metric: str) -> float | None:
    """Return a metric over its value for real trials, or over u of a solution; None without these."""
    if SCORE_METRICS[metric].is_event:
        event = score.events.get(metric)
        return None if event is None else event.over_real
    if metric == OVER_U:
        return score.over_uncertainty
    value: float | None = getattr(score, f"{metric}_normalized")
    return value


def score_interval(score: Score, metric: str) -> tuple[float, float] | None:
    """Return the 95 % interval of the normalized metric; None if it is not the primary one."""
    return score.primary_interval if metric == score.primary else None
