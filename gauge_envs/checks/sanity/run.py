"""Run a sanity check: measure phenomena with the backend's default and the configuration, and find causes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from gauge_envs.checks.sanity.cause import find_cause
from gauge_envs.checks.sanity.engine import SIMULATION_LIMIT_S, Engine
from gauge_envs.checks.sanity.measure import Measured, Measurements
from gauge_envs.checks.sanity.model import Curve, PhenomenonResult, Report, TrainingConfiguration, Verdict
from gauge_envs.checks.sanity.phenomena import Phenomenon, phenomena
from gauge_envs.checks.sanity.phenomena.phenomenon import FloatArray
from gauge_envs.errors import ParameterError
from gauge_envs.files import versions

__all__ = ["check"]

CURVE_SAMPLES = 200
"""Largest number of samples of a curve; a figure shows fewer."""


def check(
    target: Any,
    *,
    only: Sequence[str] = (),
    include_deformables: bool = False,
    notify: Callable[[PhenomenonResult], None] | None = None,
    time_limit_s: float = SIMULATION_LIMIT_S,
) -> Report:
    """Return what physics a training configuration gets wrong, and which of its settings are responsible.

    Args:
        target: A `TrainingConfiguration`, or a target of `gauge_envs.checks.sanity.configuration`.
        only: Ids of phenomena or patterns such as `creep-*`; all when empty.
        include_deformables: Whether to measure phenomena of deformable bodies.
        notify: Function that is called with each row as soon as it is measured.
        time_limit_s: Time limit of a simulation of an engine outside this package, which runs in another process [s].

    Returns:
        The report, with a row for each phenomenon in a fixed order.

    Raises:
        UnknownNameError: There is no such backend, or a pattern matches no phenomenon.
        MissingExtraError: The backend's engine is not installed.
        ParameterError: The backend refuses the settings for every scene.
    """
    started = time.perf_counter()
    configuration = _configuration(target)
    chosen = phenomena(only, include_deformables=include_deformables)
    rows = []
    with Engine(configuration.backend, time_limit_s) as engine:
        for row in _rows(Measurements(engine), configuration, chosen):
            rows.append(row)
            if notify is not None:
                notify(row)
    if all(row.verdict is Verdict.DECLINED for row in rows) and any(row.default is not None for row in rows):
        raise ParameterError(f"{configuration.name}: {engine.name} refuses these settings: {rows[0].remark}")
    return Report(
        configuration=configuration,
        rows=tuple(rows),
        versions={**engine.versions, **versions()},
        wall_s=time.perf_counter() - started,
    )


def _configuration(target: Any) -> TrainingConfiguration:
    if isinstance(target, TrainingConfiguration):
        return target
    from gauge_envs.checks.sanity.target import configuration

    return configuration(target)


def _rows(
    measurements: Measurements, configuration: TrainingConfiguration, chosen: Sequence[Phenomenon]
) -> Iterator[PhenomenonResult]:
    for phenomenon in chosen:
        configured = measurements.measure(phenomenon, configuration.settings)
        default = measurements.measure(phenomenon, {})
        yield PhenomenonResult(
            phenomenon=phenomenon.id,
            title=phenomenon.title,
            experiment=phenomenon.scenario.id,
            unit=phenomenon.unit,
            reality=phenomenon.reality,
            default=default.value,
            configured=configured.value,
            verdict=configured.verdict,
            default_verdict=default.verdict,
            cause=find_cause(measurements, phenomenon, configuration.settings, configured, default),
            remark=configured.remark,
            curve=_curve(phenomenon, configured, default),
        )


def _curve(phenomenon: Phenomenon, configured: Measured, default: Measured) -> Curve | None:
    trace = phenomenon.trace
    if trace is None:
        return None
    times, values = _thinned(phenomenon, configured)
    default_times, default_values = _thinned(phenomenon, default)
    mean, scatter = _real_curve(phenomenon, np.asarray(default_times))
    return Curve(
        label=trace.label,
        times_s=default_times,
        default=default_values,
        configured_times_s=times,
        configured=values,
        reality=tuple(mean.tolist()),
        scatter=tuple(scatter.tolist()),
    )


def _real_curve(phenomenon: Phenomenon, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard deviation of reality at times; empty when only one value is known."""
    trace, reality = phenomenon.trace, phenomenon.reality
    if trace is not None and trace.reality is not None:
        return trace.reality(times_s)
    if trace is not None and trace.is_level:
        return np.full_like(times_s, reality.value), np.full_like(times_s, reality.scatter)
    return np.zeros(0), np.zeros(0)


def _thinned(phenomenon: Phenomenon, measured: Measured) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return times and values of a trace, at `CURVE_SAMPLES` samples at most; empty without a rollout or a trace."""
    if measured.rollout is None or phenomenon.trace is None:
        return (), ()
    shown = measured.rollout.between(0.0, phenomenon.trace.until_s)
    times, values = measured.rollout.times_s[shown], phenomenon.trace.values(measured.rollout)[shown]
    stride = max(1, -(-len(times) // CURVE_SAMPLES))
    return tuple(times[::stride].tolist()), tuple(values[::stride].tolist())
