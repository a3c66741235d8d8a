"""Tables of distances between engines where there is no reference, and a summary."""

from typing import Any

from gauge_envs.pages.table import Column, Table
from gauge_envs.pages.text import quantity_text
from gauge_envs.references.kind import Kind
from gauge_envs.tools.compare.comparison import Comparison
from gauge_envs.tools.compare.distance import MOTION_SHARE, Distance
from gauge_envs.tools.compare.score_tables import EXPERIMENT


def distance_table(comparison: Comparison) -> Table:
    """Return how far engines are from each other in experiments without a reference."""
    rows: list[dict[str, Any]] = [
        {
            "id": one.id,
            "between": " : ".join(comparison.names(far).values()),
            "far": far,
        }
        for one in comparison.experiments
        if one.grade == Kind.NONE.value
        for far in one.distances
    ]

    def distance(far: Distance) -> str:
        scatter = "" if far.rms.std is None else f" +- {quantity_text(far.rms.std)}"
        return f"{quantity_text(far.rms.mean)}{scatter} {far.unit}"

    def threshold(far: Distance) -> str:
        return far.text(far.threshold) + ("" if far.threshold_is_scatter else " *")

    def exceeded(far: Distance) -> str:
        return far.apart_text + (", diverged" if far.diverged else "")

    is_published = all(row["far"].threshold_is_scatter for row in rows)
    share = (
        "" if is_published else f" * not published: {MOTION_SHARE:.0%} of the motion."
    )
    return Table(
        title="Where engines disagree: no reference, so distances between them",
        columns=(
            EXPERIMENT,
            Column("between", "between"),
            Column("far", "distance", distance, is_number=True),
            Column(
                "far", "motion", lambda far: far.text(far.motion_rms), is_number=True
            ),
            Column("far", "threshold", threshold, is_number=True),
            Column("far", "first exceeded", exceeded, is_number=True),
        ),
        rows=rows,
        notes=(
            "Distance: Euclidean over all coordinates at a frame, root mean square over the frames that both have. "
            "Motion: the same for the displacement from the start. Neither shows which engine is right.",
            f"Threshold: published mean RMSE of the single real trials, relative to their mean.{share}",
        ),
    )


def summary_table(comparison: Comparison) -> Table:
    """Return how many episodes of each configuration ran and have a score."""
    summaries = zip(comparison.labels, comparison.summaries(), strict=True)
    counts = {
        "ran": "ran",
        "scored": "scored",
        "diverged": "diverged",
        "not_run": "not run",
    }
    return Table(
        title="Summary",
        columns=(
            Column("label", "configuration"),
            *(Column(key, title, is_number=True) for key, title in counts.items()),
        ),
        rows=[{"label": label} | vars(one) for label, one in summaries],
    )
