"""A rope keeps its length when heavy balls jerk it; the foot of an elastic rod is dragged over a board."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gauge_envs.checks.sanity.model import Reality
from gauge_envs.checks.sanity.phenomena.facts import RECORDINGS, placing_scatter_mm, recorded
from gauge_envs.checks.sanity.phenomena.kit import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.checks.sanity.scenario import Rollout, Scenario

__all__ = [
    "phenomena",
]

JERK_S = 1.0
"""The balls are pushed off their posts after 0.5 s, and the rope stops their fall at 0.7 s [s]."""

DRAG_S, STEADY_S = 3.0, 0.5
"""The recording shows three seconds; the foot has broken loose after half a second [s]."""


def phenomena() -> Iterator[Phenomenon]:
    """Length of a rope, lag of a rod's foot."""
    yield _rope()
    yield _foot()


def _rope() -> Phenomenon:
    def stretch_mm(run: Rollout) -> FloatArray:
        # Nodes run from one end to the other.
        lengths = np.linalg.norm(np.diff(run.nodes_m["rope"], axis=1), axis=2).sum(axis=1)
        return np.asarray(1e3 * (lengths - lengths[0]))

    def read(run: Rollout) -> PhenomenonValue:
        stretch = stretch_mm(run)
        return PhenomenonValue(value=float(stretch[np.abs(stretch).argmax()]))

    scatter, origin = placing_scatter_mm()
    return Phenomenon(
        id="rope-length",
        title="rope: largest change of its length while two balls fall into it",
        quantity="stretch",
        stage=Scenario(name="rope", variant="RopeWinding-rubber", seconds=JERK_S, nodes_of=("rope",)),
        unit="mm",
        reality=Reality(value=0.0, scatter=scatter, source=f"the rope does not visibly stretch; scatter: {origin}"),
        read=read,
        trace=Trace(label="stretch of the rope [mm]", values=stretch_mm, is_level=True),
    )


def _foot() -> Phenomenon:
    real = recorded("stick_stack", "mean_lag_of_foot_mm")
    low, high = real["low"], real["high"]

    def lag_mm(run: Rollout) -> FloatArray:
        foot = run.markers_m[:, run.markers_m[0, :, 2].argmin(), 0]
        base = run.position("base")[:, 0]
        return np.asarray(1e3 * ((base - base[0]) - (foot - foot[0])))

    return Phenomenon(
        id="foot-lag",
        title="elastic rod, dragged over a board: how far its foot stays behind",
        quantity="lag",
        stage=Scenario(name="foot", variant="StickStack-soft", seconds=DRAG_S),
        unit="mm",
        reality=Reality(
            value=0.5 * (low + high),
            scatter=(high - low) / float(np.sqrt(12.0)),
            source=f"one recorded trial, between {low:g} and {high:g} mm; scatter: of an even distribution "
            f"({RECORDINGS})",
        ),
        read=lambda run: PhenomenonValue(value=float(lag_mm(run)[run.between(STEADY_S, DRAG_S)].mean())),
        trace=Trace(label="lag of the foot [mm]", values=lag_mm),
    )
