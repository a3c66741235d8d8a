"""Deformable bodies: cloth, foam, a rope, and an elastic rod.

Cloth carries a cube, sags under its weight, and lags behind a rod that flings it. Foam is pulled and compressed. Two
balls fall into a rope, and the foot of a rod is dragged over a board.
"""

from dataclasses import replace

import numpy as np

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.fixtures.recording import Recording
from gauge_envs.observables.functions import face_areas_mm2
from gauge_envs.scene import Cloth
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.estimators import hann_mean
from gauge_envs.tools.sanity.object_checks.check import (
    RECORDINGS,
    ObjectCheck,
    Scenario,
    facts,
    recorded,
    recorded_reality,
    rigid_law,
)
from gauge_envs.tools.sanity.training import Need
from gauge_envs.tools.sanity.verdict import Reality

# --- cloth -----------------------------------------------------------------------------------------------------------

RECORDED_S = 2.0
"""Length of the recording of a tablecloth [s]."""

HANG_S, MEAN_FROM_S = 0.8, 0.2
"""Simulated time, and first time of the mean [s]. The cloth oscillates at 16 Hz about its equilibrium."""

FLING_S = 1.0
"""Simulated time [s]: the rod is fastest at 0.68 s, and the cloth lags most before that."""

SAG_TOLERANCE = 0.2
"""Relative tolerance of the sag of a hanging cloth."""

ROW_M = 1e-3
"""Difference in height within which markers are in one row [m]."""

SATIN = "TextileFlinging-satin"
"""Variant with the fabric that stretches most under its own weight."""


def _low_m(rollout: Recording) -> FloatArray:
    """Return the mean position of the lowest row of markers of a hanging cloth [m], shape [sample_count, 3]."""
    heights = rollout.markers_m[0, :, 2]
    return rollout.markers_m[:, heights - heights.min() < ROW_M].mean(axis=1)


def cloth_carry() -> ObjectCheck:
    """Return the lag of a cube on a tablecloth, the only recorded experiment with a known fabric."""

    def lag_mm(rollout: Recording) -> float:
        lag_m = rollout.displacement("cube")[-1] - rollout.displacement("rod")[-1]
        return float(1e3 * lag_m[0])

    return ObjectCheck(
        "lag of a metal cube on a pulled tablecloth",
        Scenario("cloth", "TableclothPulling-metal", RECORDED_S),
        "mm",
        recorded_reality("tablecloth_pulling", "slip_of_cube_on_cloth_mm"),
        lag_mm,
        needs=(Need.FRICTION,),
    )


def cloth_sag() -> ObjectCheck:
    """Return the sag of a hanging cloth under its own weight."""
    scene = load_experiment(SATIN).scene
    (cloth,) = scene.deformables
    assert isinstance(cloth, Cloth) and scene.markers is not None
    load = cloth.areal_density_kg_per_m2 * scene.gravity_m_per_s2
    # The warp, x of the cloth, is vertical; the rod holds the upper edge.
    length, stiffness = cloth.size_m[0], cloth.stretch_stiffness_n_per_m
    upper = cloth.pose.position_m[2] + 0.5 * length
    depth = upper - min(z for _, _, z in scene.markers.positions_m)
    law_mm = 1e3 * load * (length * depth - 0.5 * depth**2) / stiffness

    def sag_mm(rollout: Recording) -> float:
        height = _low_m(rollout)[:, 2]
        late = rollout.between(MEAN_FROM_S, HANG_S)
        return float(hann_mean(1e3 * (height[0] - height)[late]))

    return ObjectCheck(
        "sag of the lowest markers of a hanging satin cloth",
        Scenario("hang", SATIN, HANG_S, replace(scene, drivers=())),
        "mm",
        Reality(
            law_mm,
            SAG_TOLERANCE * law_mm,
            f"rho g (L s - s^2 / 2) / K_s with the measured K_s = {stiffness:.1f} N/m",
            f"{SAG_TOLERANCE:.0%} of the sag: an effective stiffness that is off by as much",
        ),
        sag_mm,
    )


def fling_lag() -> ObjectCheck:
    """Return the largest angle of a cloth behind a rod that flings it."""

    def angle_deg(rollout: Recording) -> float:
        _, y, z = (_low_m(rollout) - rollout.position("rod")).T
        return float(np.degrees(np.arctan2(y, -z)).max())

    return ObjectCheck(
        "largest angle of a cloth behind the rod of a fling",
        Scenario("fling", SATIN, FLING_S),
        "deg",
        recorded_reality(
            "textile_flinging",
            "chord_lags_by_deg",
            "one recorded trial of an unknown fabric; satin swings like leather of 28 times its mass",
        ),
        angle_deg,
    )


# --- foam ------------------------------------------------------------------------------------------------------------

GRIPPED_S = 1.2
"""Time after which the grips rest; they stop at 1.10 and 1.15 s [s]."""


def foam(kind: str) -> ObjectCheck:
    """Return the change of the area of a face of foam in an experiment with a kind, `stretching` or `compressing`."""
    recording = f"foam_{kind}"
    trial = facts("recordings/recordings")[recording]
    measured = trial["facts"]

    def change(rollout: Recording) -> float:
        markers = rollout.scene.markers
        assert markers is not None
        area = face_areas_mm2(rollout.markers_m, markers.faces).sum(axis=1)
        return float(100.0 * (area[-1] / area[0] - 1.0))

    return ObjectCheck(
        f"area change of a face of foam, {kind} by {abs(measured['grip_mm']['value']):.0f} mm",
        Scenario(recording, f"Foam{kind.title()}-soft", GRIPPED_S),
        "%",
        Reality.measured(
            100.0 * measured["area_change_ratio"]["value"],
            100.0 * trial["uncertainty"]["relative"],
            1,
            f"one recorded trial of soft or hard foam; scatter: of the measurement ({RECORDINGS})",
        ),
        change,
    )


# --- lines -----------------------------------------------------------------------------------------------------------

JERK_S = 1.0
"""Simulated time [s]: the balls leave their posts at 0.5 s, and the rope stops their fall at 0.7 s."""

DRAG_S, STEADY_S = 3.0, 0.5
"""Length of the recording, and time after which the foot slides [s]."""


def rope_length() -> ObjectCheck:
    """Return the largest change of the length of a rope under the jerk of two balls."""

    def largest_mm(rollout: Recording) -> float:
        # Nodes are in their order along the rope.
        pieces_m = np.diff(rollout.nodes_m["rope"], axis=1)
        lengths = np.linalg.norm(pieces_m, axis=2).sum(axis=1)
        stretch = 1e3 * (lengths - lengths[0])
        return float(stretch[np.abs(stretch).argmax()])

    return ObjectCheck(
        "largest length change of a rope as balls fall in",
        Scenario("rope", "RopeWinding-rubber", JERK_S, recorded={"nodes_of": ["rope"]}),
        "mm",
        rigid_law(
            "the rope does not visibly stretch", 2.0, "the length of 340 mm of the rope"
        ),
        largest_mm,
    )


def foot_lag() -> ObjectCheck:
    """Return the lag of the foot of an elastic rod behind its base."""
    lag_range_mm = recorded("stick_stack", "mean_lag_of_foot_mm")
    low, high = lag_range_mm["low"], lag_range_mm["high"]

    def lag_mm(rollout: Recording) -> float:
        foot = rollout.markers_m[:, rollout.markers_m[0, :, 2].argmin(), 0]
        lag = 1e3 * (rollout.displacement("base")[:, 0] - (foot - foot[0]))
        return float(lag[rollout.between(STEADY_S, DRAG_S)].mean())

    return ObjectCheck(
        "lag of the foot of an elastic rod that is dragged",
        Scenario("foot", "StickStack-soft", DRAG_S),
        "mm",
        Reality.measured(
            0.5 * (low + high),
            (high - low) / float(np.sqrt(12.0)),
            1,
            f"one recorded trial, uniform between {low:g} and {high:g} mm ({RECORDINGS})",
        ),
        lag_mm,
        needs=(Need.FRICTION,),
    )
