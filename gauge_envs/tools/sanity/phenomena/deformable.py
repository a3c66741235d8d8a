"""Deformable bodies: cloth, foam, a beam of rubber blocks, a rope, and an elastic rod.

Cloth carries a cube, sags under its weight, and lags behind a rod that flings it. Foam is pulled and compressed. A beam
oscillates, two balls fall into a rope, and the foot of a rod is dragged over a board.
"""

from dataclasses import replace

import numpy as np

from gauge_envs.observables.functions import face_areas_mm2
from gauge_envs.scene import Cloth, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.estimators import hann_mean
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.sanity.model import Reality
from gauge_envs.tools.sanity.phenomena.base import (
    RECORDINGS,
    Phenomenon,
    facts,
    recorded,
    recorded_reality,
    rigid_law,
)
from gauge_envs.tools.sanity.scenario import Scenario

# --- cloth -----------------------------------------------------------------------------------------------------------

RECORDED_S = 2.0
"""Length of the recording of a tablecloth [s]."""

HANG_S, HANGING_S = 0.8, 0.2
"""Simulated time, and time of the first sample of the mean [s]. The cloth oscillates at 16 Hz about its equilibrium."""

FLING_S = 1.0
"""Simulated time [s]: the rod is fastest at 0.68 s, and the cloth lags most before that."""

SAG_TOLERANCE = 0.2
"""Relative tolerance of the sag of a hanging cloth."""

ROW_M = 1e-3
"""Difference in height within which markers are in one row [m]."""

HUNG = "TextileFlinging-satin"
"""Variant with the fabric that stretches most under its own weight."""


def _low_m(rollout: Recording) -> FloatArray:
    """Return the mean position of the lowest row of markers of a hanging cloth [m], shape [sample_count, 3]."""
    heights = rollout.markers_m[0, :, 2]
    return rollout.markers_m[:, heights - heights.min() < ROW_M].mean(axis=1)


def cloth_carry() -> Phenomenon:
    """Return the lag of a cube on a tablecloth, the one recorded experiment on cloth whose fabric is known."""

    def lag_mm(rollout: Recording) -> FloatArray:
        return 1e3 * (rollout.displacement("cube") - rollout.displacement("rod"))[:, 0]

    return Phenomenon(
        title="tablecloth: lag of the metal cube behind the pulling rod",
        scenario=Scenario(
            name="cloth", variant="TableclothPulling-metal", seconds=RECORDED_S
        ),
        unit="mm",
        reality=recorded_reality("tablecloth_pulling", "slip_of_cube_on_cloth_mm"),
        needs_friction=True,
        value=lambda rollout: lag_mm(rollout)[-1],
    )


def _hung(scene: Scene) -> Scene:
    """Return the scene with a rod that does not move."""
    return replace(scene, drivers=())


def cloth_sag() -> Phenomenon:
    """Return the sag of a hanging cloth under its own weight."""
    scenario = Scenario(name="hang", variant=HUNG, seconds=HANG_S, change=_hung)
    (cloth,) = scenario.scene.deformables
    assert isinstance(cloth, Cloth)
    load = cloth.areal_density_kg_per_m2 * scenario.scene.gravity_m_per_s2
    assert scenario.scene.markers is not None
    # The warp, x of the cloth, is vertical; the rod holds the upper edge.
    upper = cloth.pose.position_m[2] + 0.5 * cloth.size_m[0]
    depth = upper - min(z for _, _, z in scenario.scene.markers.positions_m)
    law_mm = (
        1e3
        * load
        * (cloth.size_m[0] * depth - 0.5 * depth**2)
        / cloth.stretch_stiffness_n_per_m
    )

    def sag_mm(rollout: Recording) -> FloatArray:
        height = _low_m(rollout)[:, 2]
        return 1e3 * (height[0] - height)

    return Phenomenon(
        title="cloth, satin: sag of its lowest markers under its own weight",
        scenario=scenario,
        unit="mm",
        reality=Reality.law(
            law_mm,
            tolerance=SAG_TOLERANCE * law_mm,
            source=f"rho g (L s - s^2 / 2) / K_s with the measured K_s = {cloth.stretch_stiffness_n_per_m:.1f} N/m",
            rationale=f"{SAG_TOLERANCE:.0%} of the sag: an effective stiffness that is off by as much",
        ),
        value=lambda rollout: float(
            hann_mean(sag_mm(rollout)[rollout.between(HANGING_S, HANG_S)])
        ),
    )


def fling_lag() -> Phenomenon:
    """Return the largest angle of a cloth behind a rod that flings it."""

    def angle_deg(rollout: Recording) -> FloatArray:
        chord = _low_m(rollout) - rollout.position("rod")
        return np.degrees(np.arctan2(chord[:, 1], -chord[:, 2]))

    return Phenomenon(
        title="cloth, any fabric: largest angle behind a rod that flings it",
        scenario=Scenario(name="fling", variant=HUNG, seconds=FLING_S),
        unit="deg",
        reality=recorded_reality(
            "textile_flinging",
            "chord_lags_by_deg",
            trial="one recorded trial of an unknown fabric",
            more="; satin swings like leather, which has 28 times its mass",
        ),
        value=lambda rollout: angle_deg(rollout).max(),
    )


# --- solids ----------------------------------------------------------------------------------------------------------

GRIPPED_S = 1.2
"""Time after which the grips rest; they stop at 1.10 and 1.15 s [s]."""

SWING_S = 1.1
"""Time of three extrema at the recorded frequency, or five at that of the scene's constants [s]."""

TIP_M = 1e-3
"""Distance from the furthest marker within which a marker belongs to the tip of the beam [m]."""


def foam(name: str, variant: str, recording: str, verb: str) -> Phenomenon:
    """Return the change of the area of a face of foam that grips pull or compress."""
    grip = recorded(recording, "grip_mm")["value"]

    def change(rollout: Recording) -> FloatArray:
        assert rollout.scene.markers is not None
        area = face_areas_mm2(rollout.markers_m, rollout.scene.markers.faces).sum(
            axis=1
        )
        return 100.0 * (area / area[0] - 1.0)

    return Phenomenon(
        title=f"foam, {verb} by {abs(grip):.0f} mm: change of the area of its marked face",
        scenario=Scenario(name=f"foam-{name}", variant=variant, seconds=GRIPPED_S),
        unit="%",
        reality=Reality.measured(
            100.0 * recorded(recording, "area_change_ratio")["value"],
            scatter=100.0
            * facts("recordings/recordings")[recording]["uncertainty"]["relative"],
            trial_count=1,
            source=f"one recorded trial of soft or hard foam; scatter: of the measurement ({RECORDINGS})",
        ),
        value=lambda rollout: change(rollout)[-1],
    )


def beam() -> Phenomenon:
    """Return the frequency of an oscillating beam."""

    def height_mm(rollout: Recording) -> FloatArray:
        # The beam starts level, along y, from its pedestal.
        reach = np.abs(
            rollout.markers_m[0, :, 1] - rollout.scene.body("base").pose.position_m[1]
        )
        tip = reach > reach.max() - TIP_M
        return 1e3 * rollout.markers_m[:, tip, 2].mean(axis=1)

    return Phenomenon(
        title="beam of rubber blocks: frequency of its oscillation",
        scenario=Scenario(name="beam", variant="CantileverBeam-soft", seconds=SWING_S),
        unit="Hz",
        reality=recorded_reality("cantilever_beam", "frequency_hz"),
        advisory="the modulus of the blocks is not published, and the scene has that of the rubber rod",
        value=lambda rollout: _frequency_hz(rollout.times_s, height_mm(rollout)),
    )


def _frequency_hz(times_s: FloatArray, height: FloatArray) -> float:
    """Return the frequency [Hz] from the times between extrema; NaN for fewer than two of them."""
    slopes = np.sign(np.diff(height))
    extrema = 1 + np.flatnonzero(slopes[:-1] * slopes[1:] < 0.0)
    if len(extrema) < 2:
        return float("nan")
    # Apex of the parabola through three samples.
    before, at, after = height[extrema - 1], height[extrema], height[extrema + 1]
    apex = times_s[extrema] + 0.5 * (before - after) / (before - 2.0 * at + after) * (
        times_s[1] - times_s[0]
    )
    return float(0.5 * (len(apex) - 1) / (apex[-1] - apex[0]))


# --- lines -----------------------------------------------------------------------------------------------------------

JERK_S = 1.0
"""Simulated time [s]: the balls leave their posts at 0.5 s, and the rope stops their fall at 0.7 s."""

DRAG_S, STEADY_S = 3.0, 0.5
"""Length of the recording, and time after which the foot slides [s]."""


def rope_length() -> Phenomenon:
    """Return the largest change of the length of a rope under the jerk of two balls."""

    def stretch_mm(rollout: Recording) -> FloatArray:
        # Nodes are in their order along the rope.
        lengths = np.linalg.norm(np.diff(rollout.nodes_m["rope"], axis=1), axis=2).sum(
            axis=1
        )
        return 1e3 * (lengths - lengths[0])

    def largest_mm(rollout: Recording) -> float:
        stretch = stretch_mm(rollout)
        return float(stretch[np.abs(stretch).argmax()])

    return Phenomenon(
        title="rope: largest change of its length while two balls fall into it",
        scenario=Scenario(
            name="rope",
            variant="RopeWinding-rubber",
            seconds=JERK_S,
            nodes_of=("rope",),
        ),
        unit="mm",
        reality=rigid_law(
            "the rope does not visibly stretch", 2.0, "the length of 340 mm of the rope"
        ),
        value=largest_mm,
    )


def foot_lag() -> Phenomenon:
    """Return the lag of the foot of an elastic rod behind its base."""
    real = recorded("stick_stack", "mean_lag_of_foot_mm")
    low, high = real["low"], real["high"]

    def lag_mm(rollout: Recording) -> FloatArray:
        foot = rollout.markers_m[:, rollout.markers_m[0, :, 2].argmin(), 0]
        return 1e3 * (rollout.displacement("base")[:, 0] - (foot - foot[0]))

    return Phenomenon(
        title="elastic rod dragged over a board: lag of its foot",
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
        value=lambda rollout: lag_mm(rollout)[rollout.between(STEADY_S, DRAG_S)].mean(),
    )
