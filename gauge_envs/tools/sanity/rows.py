"""Make rows of a report from what was measured."""

from __future__ import annotations

from typing import Any

import numpy as np

from gauge_envs.tools.sanity.measure import Measured
from gauge_envs.tools.sanity.model import Curve, PhenomenonResult, Verdict
from gauge_envs.tools.sanity.phenomena.base import FloatArray, Phenomenon

CURVE_SAMPLES = 200
"""Largest number of samples of a curve; a figure shows fewer."""


def result_of(
    phenomenon: Phenomenon, configured: Measured, default: Measured | None, **details: Any
) -> PhenomenonResult:
    """Return the row of a phenomenon.

    Args:
        phenomenon: The phenomenon.
        configured: Outcome in the configuration.
        default: Outcome with the backend's default; None when there is none.
        details: Further attributes of the row.
    """
    return PhenomenonResult(
        phenomenon=phenomenon.id,
        title=phenomenon.title,
        experiment=phenomenon.scenario.id,
        unit=phenomenon.unit,
        reality=phenomenon.reality,
        default=None if default is None else default.value,
        configured=configured.value,
        verdict=configured.verdict,
        default_verdict=Verdict.DECLINED if default is None else default.verdict,
        remark=configured.remark,
        **details,
    )


def curve_of(phenomenon: Phenomenon, configured: Measured, default: Measured | None) -> Curve | None:
    """Return the curves of a phenomenon that has one; reality is at the times of the default, if there is a default."""
    trace, reality = phenomenon.trace, phenomenon.reality
    if trace is None:
        return None
    times, values = _thinned(phenomenon, configured)
    default_times, default_values = (times, ()) if default is None else _thinned(phenomenon, default)
    shown: FloatArray = np.asarray(default_times)
    centre = tolerance = np.zeros(0)
    if trace.reality is not None:
        centre, tolerance = trace.reality(shown)
    elif trace.is_level:
        centre, tolerance = np.full_like(shown, reality.value), np.full_like(shown, reality.tolerance)
    return Curve(
        label=trace.label,
        times_s=default_times,
        default=default_values,
        configured_times_s=times,
        configured=values,
        reality=tuple(centre.tolist()),
        tolerance=tuple(tolerance.tolist()),
    )


def _thinned(phenomenon: Phenomenon, measured: Measured) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return times and values of a trace, at `CURVE_SAMPLES` samples at most; empty without a rollout or a trace."""
    if measured.rollout is None or phenomenon.trace is None:
        return (), ()
    shown = measured.rollout.between(0.0, phenomenon.trace.until_s)
    times, values = measured.rollout.times_s[shown], phenomenon.trace.values(measured.rollout)[shown]
    stride = max(1, -(-len(times) // CURVE_SAMPLES))
    return tuple(times[::stride].tolist()), tuple(values[::stride].tolist())
