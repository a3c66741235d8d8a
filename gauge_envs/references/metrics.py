"""The metrics of the benchmark (paper, Table 5): names, titles and units."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One metric of the benchmark.

    Attributes:
        key: Name in task files, published tables and results.
        title: Name in reports.
        unit: Unit of the raw score; None is the unit of the observable.
        is_event: Whether it is measured from the swing of a hinged body, so that it needs no band.
        is_normalized: Whether it is divided by the published mean; not for energy loss, whose published value
            is the ideal 0.
    """

    key: str
    title: str
    unit: str | None
    is_event: bool = False
    is_normalized: bool = True

    def unit_of(self, observable_unit: str) -> str:
        """Return the unit of the raw score for an observable with a unit."""
        return observable_unit if self.unit is None else self.unit


METRICS: Mapping[str, Metric] = {
    metric.key: metric
    for metric in (
        Metric(key="rmse", title="RMSE", unit=None),
        Metric(key="dtw", title="DTW", unit=None),
        Metric(
            key="lsd",
            title="LSD",
            unit="s",
            is_event=True,
        ),
        Metric(
            key="mte",
            title="MTE",
            unit="1",
            is_event=True,
        ),
        Metric(key="pd", title="PD", unit="s", is_event=True),
        Metric(
            key="el",
            title="EL",
            unit="1",
            is_event=True,
            is_normalized=False,
        ),
    )
}
"""Metrics by key, in the order of tables."""

EVENT_METRICS = tuple(key for key, metric in METRICS.items() if metric.is_event)
"""Keys of the metrics that are measured from the swing of a hinged body."""

MetricKey = Literal["rmse", "dtw", "lsd", "mte", "pd", "el"]
"""Key of a metric, for pydantic models."""
