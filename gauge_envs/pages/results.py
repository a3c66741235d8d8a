"""Texts of results: labels of configurations, metrics of scores, and convergence."""

from collections.abc import Mapping, Sequence
from typing import Any

from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.pages.text import (
    quantity_text,
    value_text,
)
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


# --- convergence ---

NAMES = {
    "timestep_s": "half step",
    "cell_m": "half cell",
    "training": "preset training",
}


def convergence_text(
    rows: Mapping[str, Mapping[str, Any]],
    *,
    has_cells: bool,
    with_unit: bool = False,
    over_trials: bool = True,
) -> str:
    """Return the effect of half the step, half the cell and the preset `training`, in one line.

    Args:
        rows: Rows of `references.convergence.convergence_rows`.
        has_cells: Whether the experiment has deformable bodies with cells.
        with_unit: Whether to add the root mean square and the maximum over frames in the unit of g(t), and the preset
            `training`.
        over_trials: Whether a change is a share of the scatter of real trials; else it is the root mean square of g(t).

    Example:
        >>> row = {"unit": "mm", "rms": 0.062, "max": 0.18, "share": 0.0034}
        >>> convergence_text({"timestep_s": row}, has_cells=True)
        'half step moves the trajectory by 0.34 % of the real scatter; half cell: not measured'
    """
    parts = []
    for setting, name in NAMES.items():
        if setting == "cell_m" and not has_cells:
            continue
        row = rows.get(setting)
        if setting == "training" and (row is None or not with_unit):
            continue
        if row is None:
            parts.append(f"{name}: not measured")
        elif row["rms"] is None:
            parts.append(f"{name}: diverged")
        else:
            parts.append(
                f"{name} moves the trajectory by "
                f"{_amount(row, with_unit=with_unit, over_trials=over_trials)}"
            )
            if setting == "training":
                parts[-1] += (
                    f", points by {quantity_text(row['points_rms_mm'])} mm rms; {_speeds(row)}"
                )
    return "; ".join(parts)


def _speeds(row: Mapping[str, Any]) -> str:
    """Return the steps per second of a row of the preset `training`."""
    return f"{row['refined']:.0f} env-steps/s, by default {row['default']:.0f}"


def _amount(row: Mapping[str, Any], *, with_unit: bool, over_trials: bool) -> str:
    """Return the share of the published scatter; without one, the distance of the observed points."""
    rms, largest = quantity_text(row["rms"]), quantity_text(row["max"])
    ends = f" and {largest} {row['unit']} at most" if with_unit else ""
    if not over_trials:
        return f"{rms} {row['unit']} rms{ends}"
    if row["share"] is None:
        amount = (
            f"{quantity_text(row['points_rms_mm'])} mm (rms of the observed points)"
        )
    else:
        amount = f"{percent_text(row['share'])} % of the real scatter"
    return f"{amount}, g(t) by {rms} {row['unit']} rms{ends}" if with_unit else amount


def percent_text(share: float) -> str:
    """Return a share in percent with two digits, or `less than 0.01`."""
    percent = 100.0 * share
    return (
        "less than 0.01"
        if percent < 0.01
        else f"{percent:.0f}"
        if percent >= 99.5
        else f"{percent:.2g}"
    )
