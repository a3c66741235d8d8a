"""Texts of results: labels of configurations, and metrics of scores."""

from collections import Counter
from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import Any

from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.pages.text import value_text
from gauge_envs.references.metrics import METRICS, Metric
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.scoring.score import FROM_SOLUTION, Score

# --- labels ---

PLAIN = ("parameters", "published")
"""Part of a configuration that labels omit."""


def configuration_labels(configurations: Sequence[RunConfiguration]) -> list[str]:
    """Return a label for each configuration: the engine, and the parts that are not common to all.

    A single configuration has all parts, `mujoco, published`. For several, `published` is omitted.
    """
    labels = _labels(configurations, digits=4)
    if len(set(labels)) < len(labels):
        labels = _labels(configurations, digits=17)
    seen: Counter[str] = Counter()
    numbered = []
    for label in labels:
        seen[label] += 1
        if labels.count(label) > 1:
            label = f"{label} ({seen[label]})"
        numbered.append(label)
    return numbered


def _labels(configurations: Sequence[RunConfiguration], *, digits: int) -> list[str]:
    exact = [
        configuration_parts(configuration, digits=17)
        for configuration in configurations
    ]
    left_out: set[tuple[str, str]] = set()
    if len(exact) > 1:
        left_out = set(exact[0]).intersection(*exact[1:]) | {PLAIN}
    versions = {(item.backend, versions_text(item)) for item in configurations}
    version_counts = Counter(backend for backend, _ in versions)
    labels = []
    for index, configuration in enumerate(configurations):
        shown = configuration_parts(configuration, digits=digits)
        kept = []
        for part, (kind, text) in zip(exact[index], shown, strict=True):
            if kind == "engine" or part not in left_out:
                kept.append(text)
        if version_counts[configuration.backend] > 1:
            kept.append(versions_text(configuration))
        labels.append(", ".join(kept))
    return labels


def configuration_parts(
    configuration: RunConfiguration, *, digits: int = 4
) -> list[tuple[str, str]]:
    """Return the parts of a configuration as kind and text, with numbers rounded to the digits."""
    named, asset = configuration.parameters, configuration.asset
    if not isinstance(named, str):
        named = ",".join(_assignments(named, digits))
    parts = [("engine", configuration.backend or "file"), ("parameters", named)]
    for setting in _assignments(configuration.settings_given, digits):
        parts.append(("setting", setting))
    if configuration.jitter:
        noise = " ".join(_assignments(configuration.jitter, digits))
        parts.append(("jitter", f"jitter {noise}"))
    if configuration.marker_proxy != MarkerProxy.MATERIAL:
        parts.append(("markers", f"markers by {configuration.marker_proxy}"))
    if asset:
        parts.append(("asset", f"edited scene {asset['file']} ({asset['sha256'][:8]})"))
    return parts


def _assignments(values: Mapping[str, Any], digits: int) -> list[str]:
    """Return `key=value` of each value, with numbers rounded to the digits."""
    texts = []
    for key, value in values.items():
        text = value_text(value)
        if isinstance(value, float):
            text = f"{value:.{digits}g}"
        texts.append(f"{key}={text}")
    return texts


def versions_text(configuration: RunConfiguration) -> str:
    """Return the versions of a configuration's engine."""
    return " ".join(
        f"{name} {text}" for name, text in configuration.engine_versions.items()
    )


# --- scores ---

ALIGNED = Metric(key="rmse_aligned", title="RMSE aligned", unit=None)
"""The RMSE after the best constant time shift, which was not published."""

VERIFIED = Metric(key=FROM_SOLUTION, title="distance from the solution", unit=None)
"""The distance from a solution of the scene, in its unit and over the motion."""

SCORE_METRICS: Mapping[str, Metric] = {
    metric.key: metric
    for metric in sorted(
        (*METRICS.values(), ALIGNED, VERIFIED), key=attrgetter("is_event")
    )
}
"""Metrics of a score by key, in the order of tables: first those that need a reference motion, then events."""


def raw_and_normalized(score: Score, metric: str) -> tuple[float | None, float | None]:
    """Return a metric in its unit, and over its value for real trials or the motion of a solution; None if unknown."""
    if SCORE_METRICS[metric].is_event:
        event = score.events.get(metric)
        return (None, None) if event is None else (event.value, event.over_real)
    if metric != FROM_SOLUTION:
        return getattr(score, metric), getattr(score, f"{metric}_normalized")
    if score.primary != metric:
        return None, None
    return score.solution_distance, score.primary_normalized
