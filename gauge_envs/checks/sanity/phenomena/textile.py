"""Cloth: it takes the cube on it along, hangs as its stretch stiffness says, and stays behind a rod that flings it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gauge_envs.checks.conformance.laws import hann_mean
from gauge_envs.checks.sanity.model import Reality
from gauge_envs.checks.sanity.phenomena.facts import RECORDINGS, placing_scatter_mm, recorded
from gauge_envs.checks.sanity.phenomena.kit import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.checks.sanity.scenario import Rollout, Scenario
from gauge_envs.scene import Cloth, Scene

__all__ = [
    "phenomena",
]

RECORDED_S = 2.0
"""The recording shows no more [s]."""

HANG_S, SETTLED_S = 0.8, 0.2
"""Let go unstretched, the cloth swings up and down at 16 Hz about its sag at rest."""

FLING_S = 1.0
"""The rod is fastest after 0.68 s; the cloth is furthest behind it before [s]."""

ROW_M = 1e-3
"""Markers of the same height, closer than this, are a row [m]."""

HUNG = "TextileFlinging-satin"
"""The fabric that stretches most under its own weight."""


def phenomena() -> Iterator[Phenomenon]:
    """Friction on cloth, stretch, swing."""
    yield _carry()
    yield _sag()
    yield _fling()


def _low_m(run: Rollout) -> FloatArray:
    """Middle of the lowest row of markers of a cloth that hangs [m], shape [sample_count, 3]."""
    heights = run.markers_m[0, :, 2]
    return np.asarray(run.markers_m[:, heights - heights.min() < ROW_M].mean(axis=1))


# --- friction --------------------------------------------------------------------------------------------------------


def _carry() -> Phenomenon:
    # The one recorded experiment on cloth whose fabric is known.
    real = recorded("tablecloth_pulling", "slip_of_cube_on_cloth_mm")

    def lag_mm(run: Rollout) -> FloatArray:
        ways = [run.position(name)[:, 0] - run.position(name)[0, 0] for name in ("cube", "rod")]
        return np.asarray(1e3 * (ways[0] - ways[1]))

    return Phenomenon(
        id="cloth-carry",
        title="tablecloth: how far the metal cube stays behind the rod that pulls",
        quantity="lag",
        stage=Scenario(name="cloth", variant="TableclothPulling-metal", seconds=RECORDED_S),
        unit="mm",
        reality=Reality(value=real["value"], scatter=real["sigma"], source=f"one recorded trial ({RECORDINGS})"),
        read=lambda run: PhenomenonValue(value=float(lag_mm(run)[-1])),
        trace=Trace(label="lag behind the rod [mm]", values=lag_mm),
    )


# --- stretch ---------------------------------------------------------------------------------------------------------


def _held(scene: Scene) -> Scene:
    """The rod stays where it is."""
    return replace(scene, drivers=())


def _sag() -> Phenomenon:
    stage = Scenario(name="hang", variant=HUNG, seconds=HANG_S, change=_held)
    (cloth,) = stage.scene.deformables
    assert isinstance(cloth, Cloth)
    load = cloth.areal_density_kg_per_m2 * stage.scene.gravity_m_per_s2
    assert stage.scene.markers is not None
    # The warp, x of the cloth, is upright; the rod holds its upper edge.
    upper = cloth.pose.position_m[2] + 0.5 * cloth.size_m[0]
    depth = upper - min(z for _, _, z in stage.scene.markers.positions_m)
    law_mm = 1e3 * load * (cloth.size_m[0] * depth - 0.5 * depth**2) / cloth.stretch_stiffness_n_per_m

    def sag_mm(run: Rollout) -> FloatArray:
        height = _low_m(run)[:, 2]
        return np.asarray(1e3 * (height[0] - height))

    scatter, origin = placing_scatter_mm()
    return Phenomenon(
        id="cloth-sag",
        title="cloth, satin: sag of its lowest markers under its own weight",
        quantity="sag",
        stage=stage,
        unit="mm",
        reality=Reality(
            value=law_mm,
            scatter=scatter,
            source="rho g (L s - s^2 / 2) / K_s with the measured K_s = "
            f"{cloth.stretch_stiffness_n_per_m:.1f} N/m; scatter: {origin}",
        ),
        read=lambda run: PhenomenonValue(value=float(hann_mean(sag_mm(run)[run.between(SETTLED_S, HANG_S)]))),
        trace=Trace(label="sag of the lowest markers [mm]", values=sag_mm, is_level=True),
    )


# --- swing -----------------------------------------------------------------------------------------------------------


def _fling() -> Phenomenon:
    real = recorded("textile_flinging", "chord_lags_by_deg")
    stage = Scenario(name="fling", variant=HUNG, seconds=FLING_S)

    def angle_deg(run: Rollout) -> FloatArray:
        chord = _low_m(run) - run.position("rod")
        return np.asarray(np.degrees(np.arctan2(chord[:, 1], -chord[:, 2])))

    return Phenomenon(
        id="fling-lag",
        title="cloth, any fabric: how far it swings back when a rod flings it",
        quantity="angle",
        stage=stage,
        unit="deg",
        reality=Reality(
            value=real["value"],
            scatter=real["sigma"],
            source=f"one recorded trial of an unknown fabric ({RECORDINGS}); satin, and leather of 28 times "
            "the mass, swing alike",
        ),
        read=lambda run: PhenomenonValue(value=float(angle_deg(run).max())),
        trace=Trace(label="angle of the cloth [deg]", values=angle_deg),
    )
