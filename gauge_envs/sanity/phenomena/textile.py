"""A cloth that is pulled along a table takes the cube on it along."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gauge_envs.sanity.model import Reality
from gauge_envs.sanity.phenomena.facts import RECORDINGS, recorded
from gauge_envs.sanity.phenomena.kit import FloatArray, Phenomenon, Reading, Trace
from gauge_envs.sanity.rollout import Rollout, Stage

__all__ = ["phenomena"]

RECORDED_S = 2.0
"""The recording shows no more [s]."""


def phenomena() -> Iterator[Phenomenon]:
    """The one phenomenon of a deformable body that a recording measures and that no unknown material decides."""
    real = recorded("tablecloth_pulling", "slip_of_cube_on_cloth_mm")

    def lag_mm(run: Rollout) -> FloatArray:
        ways = [run.position(name)[:, 0] - run.position(name)[0, 0] for name in ("cube", "rod")]
        return np.asarray(1e3 * (ways[0] - ways[1]))

    yield Phenomenon(
        id="cloth-carry",
        title="tablecloth: how far the metal cube stays behind the rod that pulls",
        quantity="lag",
        stage=Stage(name="cloth", variant="TableclothPulling-metal", seconds=RECORDED_S),
        unit="mm",
        reality=Reality(value=real["value"], scatter=real["sigma"], source=f"one recorded trial ({RECORDINGS})"),
        read=lambda run: Reading(value=float(lag_mm(run)[-1])),
        trace=Trace(label="lag behind the rod [mm]", values=lag_mm),
    )
