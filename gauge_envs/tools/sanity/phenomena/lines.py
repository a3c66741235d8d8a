"""Lines: a rope under the jerk of two balls, and the foot of an elastic rod dragged over a board."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gauge_envs.runs.rollout import Rollout
from gauge_envs.tools.sanity.model import Reality
from gauge_envs.tools.sanity.phenomena.facts import RECORDINGS, recorded, rigid_tolerance
from gauge_envs.tools.sanity.phenomena.phenomenon import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.tools.sanity.scenario import Scenario

JERK_S = 1.0
"""Simulated time [s]: the balls leave their posts at 0.5 s, and the rope stops their fall at 0.7 s."""

DRAG_S, STEADY_S = 3.0, 0.5
"""Length of the recording, and time after which the foot slides [s]."""


def phenomena() -> Iterator[Phenomenon]:
    """Yield the length of a rope and the lag of a rod's foot."""
    yield _rope()
    yield _foot()


def _rope() -> Phenomenon:
    def stretch_mm(rollout: Rollout) -> FloatArray:
        # Nodes are in their order along the rope.
        lengths = np.linalg.norm(np.diff(rollout.nodes_m["rope"], axis=1), axis=2).sum(axis=1)
        return np.asarray(1e3 * (lengths - lengths[0]))

    def read(rollout: Rollout) -> PhenomenonValue:
        stretch = stretch_mm(rollout)
        return PhenomenonValue(value=float(stretch[np.abs(stretch).argmax()]))

    return Phenomenon(
        id="rope-length",
        title="rope: largest change of its length while two balls fall into it",
        quantity="stretch",
        scenario=Scenario(name="rope", variant="RopeWinding-rubber", seconds=JERK_S, nodes_of=("rope",)),
        unit="mm",
        reality=Reality.law(
            0.0, source="the rope does not visibly stretch", **rigid_tolerance(2.0, "the length of 340 mm of the rope")
        ),
        read=read,
        trace=Trace(label="stretch of the rope [mm]", values=stretch_mm, is_level=True),
    )


def _foot() -> Phenomenon:
    real = recorded("stick_stack", "mean_lag_of_foot_mm")
    low, high = real["low"], real["high"]

    def lag_mm(rollout: Rollout) -> FloatArray:
        foot = rollout.markers_m[:, rollout.markers_m[0, :, 2].argmin(), 0]
        return np.asarray(1e3 * (rollout.displacement("base")[:, 0] - (foot - foot[0])))

    return Phenomenon(
        id="foot-lag",
        title="elastic rod dragged over a board: lag of its foot",
        quantity="lag",
        scenario=Scenario(name="foot", variant="StickStack-soft", seconds=DRAG_S),
        unit="mm",
        reality=Reality.measured(
            0.5 * (low + high),
            scatter=(high - low) / float(np.sqrt(12.0)),
            trial_count=1,
            source=f"one recorded trial, between {low:g} and {high:g} mm; scatter: of a uniform distribution "
            f"({RECORDINGS})",
        ),
        needs_friction=True,
        read=lambda rollout: PhenomenonValue(value=float(lag_mm(rollout)[rollout.between(STEADY_S, DRAG_S)].mean())),
        trace=Trace(label="lag of the foot [mm]", values=lag_mm),
    )
