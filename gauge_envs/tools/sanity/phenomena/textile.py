"""Cloth: it carries a cube, sags under its weight, and lags behind a rod that flings it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import Cloth, Scene
from gauge_envs.tools.conformance import hann_mean
from gauge_envs.tools.sanity.model import Reality
from gauge_envs.tools.sanity.phenomena.facts import RECORDINGS, recorded
from gauge_envs.tools.sanity.phenomena.phenomenon import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.tools.sanity.scenario import Scenario

RECORDED_S = 2.0
"""Length of the recording [s]."""

HANG_S, SETTLED_S = 0.8, 0.2
"""Simulated time, and time of the first sample of the mean [s]. The cloth oscillates at 16 Hz about its equilibrium."""

FLING_S = 1.0
"""Simulated time [s]: the rod is fastest at 0.68 s, and the cloth lags most before that."""

SAG_TOLERANCE = 0.2
"""Relative tolerance of the sag of a hanging cloth."""

ROW_M = 1e-3
"""Difference in height within which markers are in one row [m]."""

HUNG = "TextileFlinging-satin"
"""Variant with the fabric that stretches most under its own weight."""


def phenomena() -> Iterator[Phenomenon]:
    """Yield friction on cloth, stretch and swing."""
    yield _carry()
    yield _sag()
    yield _fling()


def _low_m(rollout: Rollout) -> FloatArray:
    """Return the mean position of the lowest row of markers of a hanging cloth [m], shape [sample_count, 3]."""
    heights = rollout.markers_m[0, :, 2]
    return np.asarray(rollout.markers_m[:, heights - heights.min() < ROW_M].mean(axis=1))


# --- friction --------------------------------------------------------------------------------------------------------


def _carry() -> Phenomenon:
    # The one recorded experiment on cloth whose fabric is known.
    real = recorded("tablecloth_pulling", "slip_of_cube_on_cloth_mm")

    def lag_mm(rollout: Rollout) -> FloatArray:
        return np.asarray(1e3 * (rollout.displacement("cube") - rollout.displacement("rod"))[:, 0])

    return Phenomenon(
        id="cloth-carry",
        title="tablecloth: lag of the metal cube behind the pulling rod",
        quantity="lag",
        scenario=Scenario(name="cloth", variant="TableclothPulling-metal", seconds=RECORDED_S),
        unit="mm",
        reality=Reality.measured(
            real["value"], scatter=real["sigma"], trial_count=1, source=f"one recorded trial ({RECORDINGS})"
        ),
        needs_friction=True,
        read=lambda rollout: PhenomenonValue(value=float(lag_mm(rollout)[-1])),
        trace=Trace(label="lag behind the rod [mm]", values=lag_mm),
    )


# --- stretch ---------------------------------------------------------------------------------------------------------


def _held(scene: Scene) -> Scene:
    """Return the scene with a rod that does not move."""
    return replace(scene, drivers=())


def _sag() -> Phenomenon:
    scenario = Scenario(name="hang", variant=HUNG, seconds=HANG_S, change=_held)
    (cloth,) = scenario.scene.deformables
    assert isinstance(cloth, Cloth)
    load = cloth.areal_density_kg_per_m2 * scenario.scene.gravity_m_per_s2
    assert scenario.scene.markers is not None
    # The warp, x of the cloth, is vertical; the rod holds the upper edge.
    upper = cloth.pose.position_m[2] + 0.5 * cloth.size_m[0]
    depth = upper - min(z for _, _, z in scenario.scene.markers.positions_m)
    law_mm = 1e3 * load * (cloth.size_m[0] * depth - 0.5 * depth**2) / cloth.stretch_stiffness_n_per_m

    def sag_mm(rollout: Rollout) -> FloatArray:
        height = _low_m(rollout)[:, 2]
        return np.asarray(1e3 * (height[0] - height))

    def read(rollout: Rollout) -> PhenomenonValue:
        return PhenomenonValue(value=float(hann_mean(sag_mm(rollout)[rollout.between(SETTLED_S, HANG_S)])))

    return Phenomenon(
        id="cloth-sag",
        title="cloth, satin: sag of its lowest markers under its own weight",
        quantity="sag",
        scenario=scenario,
        unit="mm",
        reality=Reality.law(
            law_mm,
            tolerance=SAG_TOLERANCE * law_mm,
            source=f"rho g (L s - s^2 / 2) / K_s with the measured K_s = {cloth.stretch_stiffness_n_per_m:.1f} N/m",
            rationale=f"{SAG_TOLERANCE:.0%} of the sag: an effective stiffness that is off by as much",
        ),
        read=read,
        trace=Trace(label="sag of the lowest markers [mm]", values=sag_mm, is_level=True),
    )


# --- swing -----------------------------------------------------------------------------------------------------------


def _fling() -> Phenomenon:
    real = recorded("textile_flinging", "chord_lags_by_deg")
    scenario = Scenario(name="fling", variant=HUNG, seconds=FLING_S)

    def angle_deg(rollout: Rollout) -> FloatArray:
        chord = _low_m(rollout) - rollout.position("rod")
        return np.asarray(np.degrees(np.arctan2(chord[:, 1], -chord[:, 2])))

    return Phenomenon(
        id="fling-lag",
        title="cloth, any fabric: largest angle behind a rod that flings it",
        quantity="angle",
        scenario=scenario,
        unit="deg",
        reality=Reality.measured(
            real["value"],
            scatter=real["sigma"],
            trial_count=1,
            source=f"one recorded trial of an unknown fabric ({RECORDINGS}); satin swings "
            "like leather, which has 28 times its mass",
        ),
        read=lambda rollout: PhenomenonValue(value=float(angle_deg(rollout).max())),
        trace=Trace(label="angle of the cloth [deg]", values=angle_deg),
    )
