"""Tables of the world-model track: tasks, and scores of videos with their intervals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.console import Group
from rich.text import Text

from gauge_envs.pages.table import Column, Table, as_rich
from gauge_envs.pages.text import value_text
from gauge_envs.tools.video import METRICS, VideoScore, VideoTask

TITLES = {
    "a_m_s2": "acceleration [m/s^2]",
    "qfi": "QFI",
    "r2": "R^2",
    "pd_s": "period [s]",
    "mte": "momentum transfer",
    "de_n": "dynamic error [N]",
}
"""Titles of the metrics by name."""


def task_rows(tasks: Iterable[VideoTask]) -> list[dict[str, Any]]:
    """Return the tasks with their object, scale and real values."""
    return [
        {
            "task": task.id,
            "motion": task.motion.value,
            "size_mm": 1000.0 * task.size_m,
            "size_px": task.size_px,
            "metrics": ", ".join(f"{TITLES[name]} {value:g}" for name, value in task.real.items()),
        }
        for task in tasks
    ]


def task_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return a table of tasks."""
    columns = (
        Column("task", "task"),
        Column("motion", "motion"),
        Column("size_mm", "object", format=value_text, unit="mm", is_number=True),
        Column("size_px", "object", format=value_text, unit="px", is_number=True),
        Column("metrics", "real values"),
    )
    return Table(columns=columns, rows=tuple(rows))


def score_view(result: VideoScore, real: Mapping[str, float]) -> Group:
    """Return the result of one video: its grade with the reasons, and each metric with its interval.

    Args:
        result: The result.
        real: Real values by the name of the metric.
    """
    rows = [
        {
            "metric": TITLES[name],
            "value": result.metrics[name],
            "interval": _interval_text(result.uncertainty[name]),
            "real": real.get(name),
        }
        for name in METRICS
        if result.metrics[name] is not None
    ]
    columns = (
        Column("metric", "metric"),
        Column("value", "video", format=short_text, is_number=True),
        Column("interval", "95 % interval"),
        Column("real", "real", format=short_text, is_number=True),
    )
    span = result.interval_frames
    frames = "no frame is retained" if span is None else f"frames {span[0]} to {span[1]} are retained"
    scale = f"{1000.0 * result.scale_m_per_px:.3f} mm a pixel of the first frame"
    if result.track.registration is not None:
        scale += f"; registered by {result.track.registration.method}"
    parts: list[Any] = [Text(f"{result.video}: {result.grade.value} for {result.task}; {frames}; {scale}")]
    parts += [Text(f"  {reason}") for reason in result.reasons]
    if rows:
        parts.append(as_rich(Table(columns=columns, rows=tuple(rows))))
    return Group(*parts)


def short_text(value: float) -> str:
    """Return a value with four digits."""
    return f"{value:.4g}"


def _interval_text(interval: tuple[float, float] | None) -> str:
    return "" if interval is None else f"{short_text(interval[0])} to {short_text(interval[1])}"
