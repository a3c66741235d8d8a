"""The world-model track in words: tasks, and scores of videos with their intervals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from gauge_envs.pages.document import Document, Paragraph
from gauge_envs.pages.table import Column, Table
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


def task_table(tasks: Iterable[VideoTask]) -> Table:
    """Return the tasks with their object, scale and real values."""
    return Table(
        columns=(
            Column("task", "task"),
            Column("motion", "motion"),
            Column("size_mm", "object", unit="mm", is_number=True),
            Column("size_px", "object", unit="px", is_number=True),
            Column("metrics", "real values"),
        ),
        rows=[
            {
                "task": task.id,
                "motion": task.motion.value,
                "size_mm": 1000.0 * task.size_m,
                "size_px": task.size_px,
                "metrics": ", ".join(f"{TITLES[name]} {value:g}" for name, value in task.real.items()),
            }
            for task in tasks
        ],
    )


def score_document(result: VideoScore, real: Mapping[str, float]) -> Document:
    """Return the result of one video: its grade with the reasons, and each metric with its interval.

    Args:
        result: The result.
        real: Real values by the name of the metric.
    """
    scale = f"{1000.0 * result.scale_m_per_px:.3f} mm a pixel of the first frame"
    if result.track.registration is not None:
        scale += f"; registered by {result.track.registration.method}"
    known = [name for name in METRICS if result.metrics[name] is not None]
    table = Table(
        columns=(
            Column("", "metric", TITLES.__getitem__),
            Column("", "video", lambda name: short_text(result.metrics[name]), is_number=True),
            Column("", "95 % interval", lambda name: interval_text(result.uncertainty[name])),
            Column("", "real", lambda name: short_text(real[name]) if name in real else "-", is_number=True),
        ),
        rows=known,
    )
    return Document(
        parts=(
            Paragraph(f"{result.video}: {result.grade.value} for {result.task}; {span_text(result)}; {scale}"),
            *(Paragraph(f"  {reason}") for reason in result.reasons),
            *([table] if known else []),
        ),
        rows=[result.to_dict()],
    )


def span_text(result: VideoScore) -> str:
    """Return the frames that a law was fitted to."""
    span = result.interval_frames
    return "no frame is retained" if span is None else f"frames {span[0]} to {span[1]} are retained"


def short_text(value: float | None) -> str:
    """Return a value with four digits; a dash for None."""
    return "\u2013" if value is None else f"{value:.4g}"


def interval_text(interval: tuple[float, float] | None) -> str:
    """Return both ends of an interval; empty for None."""
    return "" if interval is None else f"{short_text(interval[0])} to {short_text(interval[1])}"
