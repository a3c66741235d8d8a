"""Friction of a cube: creep and resting height on a slope, slides, and what a turntable does to it.

A sliding cube has the friction that the same trials show, so that the row judges what an engine makes of it. A cube on
a turntable rotates with the plate if friction suffices, and slips when the plate stops.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.references.published import published_baselines
from gauge_envs.scene import Box, Pose, Scene
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scoring.estimators import steady_speed_m_per_s
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.bench.slope import moved_m
from gauge_envs.tools.sanity.model import COVERAGE, Reality
from gauge_envs.tools.sanity.phenomena.base import (
    RECORDINGS,
    Phenomenon,
    acceleration,
    facts,
    position_scatter_mm,
    recorded,
    rigid_law,
)
from gauge_envs.tools.sanity.scenario import Scenario

HOLD_S, SETTLED_S = 1.0, 0.5
"""Simulated time, and time after which the cube has sunk into a soft contact and only creeps [s]."""

TURN_DEG = 45.0
"""Turn of the board about the vertical [degrees]. Engines choose the tangents of a contact by the axes of the world."""

SLIDE_S, STEADY_SLIDE_S = 0.5, 0.25
"""Simulated time [s], in which a cube that is 20 % too fast does not reach the end of the board, and time after which
it has sunk into soft ground and slides steadily."""

PRINTED_MM = 0.01
"""Last printed digit of the published scores of SlopeSlider-1 [mm]."""

TURN_S = 94 / 30
"""Time of the published frames of the turntable [s]."""

CALM_INTERVAL_S = 0.01
"""Time between samples of a body that rests, or turns with a slow plate [s]: a third of a published frame."""

STEADY_S = (2.3, 3.0)
"""Time between the acceleration after the first stop and the last published frame [s]."""


def _hold_scenario(material: str) -> Scenario:
    return Scenario(
        name=f"hold-{material}",
        variant=f"SlopeSlider-1-{material}",
        seconds=HOLD_S,
        interval_s=CALM_INTERVAL_S,
        released=("cube",),
    )


def _on_board_mm(rollout: Recording) -> FloatArray:
    """Return displacements of the cube [mm], shape [sample_count, 3]: downhill, across, normal to the board."""
    return 1e3 * moved_m(rollout, "cube", "board")


def _downhill_mm(rollout: Recording) -> FloatArray:
    return _on_board_mm(rollout)[:, 0]


# --- holding ---------------------------------------------------------------------------------------------------------


def creep_bound_mm_per_s(variant: str) -> float:
    """Return the fastest creep [mm/s] that the published scores of real cubes allow.

    A cube that moves uniformly by d within the trial, at a distance c from the mean, has E_RMSE - E_DTW = d^2 / (24 c).
    The two published numbers are equal, so they differ by less than one digit. The scatter of positions does not
    measure creep, since most of it comes from placing the cube by hand.
    """
    baselines = published_baselines(variant)
    rmse, dtw = baselines["rmse"], baselines["dtw"]
    assert rmse.mean == dtw.mean, f"{variant}: real cubes move within a trial"
    return float(np.sqrt(24.0 * PRINTED_MM * rmse.mean)) * 30.0 / (rmse.frames - 1)


def creeping(
    title: str,
    scenario: Scenario,
    downhill_mm: Callable[[Recording], FloatArray],
    source: str,
    rationale: str,
) -> Phenomenon:
    """Return the creep of a body at rest on a slope.

    Args:
        title: Title.
        scenario: Scenario of the body.
        downhill_mm: Function from a rollout to the displacement downhill [mm], shape [sample_count].
        source: The law.
        rationale: Reason for the bound that the published scores of a real cube give.
    """
    bound = creep_bound_mm_per_s(scenario.variant)

    def speed_mm_per_s(rollout: Recording) -> float:
        late = rollout.between(SETTLED_S, HOLD_S)
        return steady_speed_m_per_s(rollout.times_s[late], downhill_mm(rollout)[late])

    def reality(times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.zeros_like(times_s), bound * times_s

    return Phenomenon(
        title=title,
        scenario=scenario,
        unit="mm/s",
        reality=Reality.law(0.0, tolerance=bound, source=source, rationale=rationale),
        needs_friction=True,
        value=speed_mm_per_s,
    )


def creep(material: str) -> Phenomenon:
    """Return the creep of a cube at rest."""
    return creeping(
        f"static friction, {material}: creep on 10 degrees",
        _hold_scenario(material),
        _downhill_mm,
        source="Coulomb, tan 10 deg < mu",
        rationale=f"E_RMSE and E_DTW of real {material} cubes on this slope are equal as printed (paper, Table 5), "
        "which allows no faster creep",
    )


def rest_height(material: str) -> Phenomenon:
    """Return the gap between a cube at rest and its board."""
    return Phenomenon(
        title="resting height: gap between cube and board",
        scenario=_hold_scenario(material),
        unit="mm",
        reality=rigid_law("rigid bodies touch", 0.5, "the edge of 50 mm of the cube"),
        needs_friction=True,
        value=lambda rollout: _gaps_mm(rollout)[
            rollout.between(SETTLED_S, HOLD_S)
        ].mean(),
    )


def thrown(material: str) -> Phenomenon:
    """Return the height to which a cube that touches its board at the start is thrown."""
    at_rest = rest_height(material)
    return replace(
        at_rest,
        title="release: height to which a cube that touches its board is thrown, above where it settles",
        scenario=replace(
            at_rest.scenario,
            name=f"release-{material}",
            interval_s=Scenario.interval_s,
            released=(),
        ),
        reality=rigid_law(
            "a body that is laid down stays there", 0.5, "the edge of 50 mm of the cube"
        ),
        value=lambda rollout: _gaps_mm(rollout).max() - max(_gaps_mm(rollout)[-1], 0.0),
    )


def _gaps_mm(rollout: Recording) -> FloatArray:
    """Return the gap between the faces of cube and board [mm], shape [sample_count]."""
    cube, board = rollout.scene.body("cube"), rollout.scene.body("board")
    assert isinstance(cube.shape, Box) and isinstance(board.shape, Box)
    height = board.pose.to_body(np.asarray(cube.pose.position_m))[2]
    start = float(height - 0.5 * (cube.shape.size_m[2] + board.shape.size_m[2]))
    return 1e3 * start + _on_board_mm(rollout)[:, 2]


# --- sliding ---------------------------------------------------------------------------------------------------------


def sliding(
    title: str,
    scenario: Scenario,
    downhill_mm: Callable[[Recording], FloatArray],
    real: Reality,
) -> Phenomenon:
    """Return the acceleration of a body that slides down a slope.

    Args:
        title: Title.
        scenario: Scenario of the body.
        downhill_mm: Function from a rollout to the displacement downhill [mm], shape [sample_count].
        real: The acceleration in reality.
    """

    def reality(times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return 500.0 * real.value * times_s**2, 500.0 * real.tolerance * times_s**2

    return Phenomenon(
        title=title,
        scenario=scenario,
        unit="m/s^2",
        reality=real,
        needs_friction=True,
        value=lambda rollout: acceleration(
            rollout, downhill_mm(rollout), STEADY_SLIDE_S, SLIDE_S
        ),
    )


def real_slides(material: str, source: str = "") -> Reality:
    """Return the acceleration of real cubes on 30 degrees."""
    trials = facts("slope_slider_30deg_summary")[material]
    found = trials["acceleration_m_s2"]
    return Reality.measured(
        found["mean"],
        scatter=found["std"],
        trial_count=trials["trial_count"],
        source=source,
    )


def real_friction(material: str) -> float:
    """Return the friction that real slides of a cube show."""
    return float(facts("slope_slider_30deg_summary")[material]["friction"]["mean"])


def slide(material: str) -> Phenomenon:
    """Return the acceleration of a sliding cube."""
    friction = real_friction(material)
    scenario = Scenario(
        name=f"slide-{material}",
        variant=f"SlopeSlider-2-{material}",
        seconds=SLIDE_S,
        released=("cube",),
        parameters={"cube.friction": friction},
    )
    shown = f"the cube has the friction that they show, mu = {friction:.3f}"
    source = f"real slides (scoring/facts/slope_slider_30deg_summary.toml); {shown}"
    title = f"kinetic friction, {material}: acceleration on 30 degrees"
    return sliding(title, scenario, _downhill_mm, real_slides(material, source))


def _turned(scene: Scene) -> Scene:
    """Return the scene turned about the vertical through the origin."""
    turn = Rotation.from_euler("z", TURN_DEG, degrees=True)

    def turned(pose: Pose) -> Pose:
        return Pose.from_rotation(
            vector(turn.apply(pose.position_m)), turn * pose.rotation
        )

    return replace(
        scene,
        bodies=tuple(replace(body, pose=turned(body.pose)) for body in scene.bodies),
    )


def turned_slide(material: str) -> Phenomenon:
    """Return the acceleration of a cube that slides in another direction."""
    straight = slide(material)
    scenario = replace(
        straight.scenario, name=f"slide-turned-{material}", change=_turned
    )
    friction = next(c.friction for c in scenario.scene.contacts if "board" in c.second)
    downhill = scenario.scene.body("board").pose.rotation.apply([1.0, 0.0, 0.0])
    law = scenario.scene.gravity_m_per_s2 * float(
        -downhill[2] - friction * np.hypot(*downhill[:2])
    )
    return replace(
        straight,
        title=f"isotropic friction, {material}: acceleration on 30 degrees, board turned by {TURN_DEG:.0f} degrees",
        scenario=scenario,
        needs_space=True,
        reality=Reality.law(
            law,
            tolerance=straight.reality.tolerance,
            source=f"g (sin 30 - mu cos 30) with mu = {friction:.3f}, in every direction",
            rationale=f"covers {COVERAGE:.0%} of further real slides on the board that is not turned",
        ),
    )


# --- on a turntable --------------------------------------------------------------------------------------------------


def _on_plate_mm(rollout: Recording) -> FloatArray:
    """Return positions of the cube in the plate's frame [mm], shape [sample_count, 3]."""
    arm = rollout.position("cube") - rollout.position("plate")
    return 1e3 * rollout.rotation("plate").apply(arm, inverse=True)


def carry(material: str) -> Phenomenon:
    """Return the slip of a cube on a slow turntable."""
    scenario = Scenario(
        name=f"turn-{material}",
        variant=f"Turntable-1-{material}",
        seconds=TURN_S,
        interval_s=CALM_INTERVAL_S,
        released=("cube",),
    )

    def slip_mm(rollout: Recording) -> FloatArray:
        place = _on_plate_mm(rollout)[:, :2]
        return np.linalg.norm(place - place[0], axis=1)

    return Phenomenon(
        title=f"static friction, {material}: slip on a slow turntable within 3 s",
        scenario=scenario,
        unit="mm",
        reality=Reality.law(
            0.0,
            # The plane of the plate has two axes.
            tolerance=float(np.sqrt(2.0)) * position_scatter_mm(scenario.variant),
            source="Coulomb, omega^2 r < mu g",
            rationale="standard deviation of a position of this cube on this table in real trials (paper, Table 5)",
        ),
        needs_friction=True,
        needs_space=True,
        value=lambda rollout: slip_mm(rollout)[-1],
    )


def slip() -> Phenomenon:
    """Return the slip of a cube when the turntable reverses."""
    scenario = Scenario(
        name="stop", variant="Turntable-3-metal", seconds=TURN_S, released=("cube",)
    )
    radius_mm = recorded("turntable", "radius_at_start_mm")["value"]

    def slip_deg(rollout: Recording) -> FloatArray:
        place = _on_plate_mm(rollout)
        angle = np.unwrap(np.arctan2(place[:, 1], place[:, 0]))
        return np.degrees(angle - angle[0])

    return Phenomenon(
        title="kinetic friction, metal: slip when the turntable reverses",
        scenario=scenario,
        unit="deg",
        reality=Reality.measured(
            recorded("turntable", "slip_after_first_stop_deg")["value"],
            scatter=float(
                np.degrees(position_scatter_mm(scenario.variant) / radius_mm)
            ),
            trial_count=1,
            source=f"one recorded trial ({RECORDINGS}); scatter: of a position along the circle of {scenario.variant} "
            "(paper, Table 5)",
        ),
        needs_friction=True,
        needs_space=True,
        value=lambda rollout: slip_deg(rollout)[rollout.between(*STEADY_S)].mean(),
    )
