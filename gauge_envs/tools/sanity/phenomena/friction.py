"""Friction on a slope: creep of a cube at rest, its resting height, and the acceleration of a sliding cube.

A sliding cube has the friction that the same trials show, so that the row judges what an engine makes of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.evaluation.metrics.law import fitted_acceleration
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import Box, Pose, Scene
from gauge_envs.tools.sanity.model import COVERAGE, Reality
from gauge_envs.tools.sanity.phenomena.facts import facts, rigid_tolerance
from gauge_envs.tools.sanity.phenomena.phenomenon import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.tools.sanity.scenario import Scenario

MATERIALS = ("wood", "plastic", "metal")

HOLD_S, SETTLED_S = 1.0, 0.5
"""Simulated time, and time after which the cube has sunk into a soft contact and only creeps [s]."""

TURN_DEG = 45.0
"""Turn of the board about the vertical [degrees]. Engines choose the tangents of a contact by the axes of the world."""

SLIDE_S = 0.5
"""Simulated time [s]; a cube that is 20 % too fast reaches the end of the board at 0.53 s."""

PRINTED_MM = 0.01
"""Last printed digit of the published scores of SlopeSlider-1 [mm]."""


def phenomena() -> Iterator[Phenomenon]:
    """Yield creep and sliding of three materials, and the resting height of a cube."""
    for material in MATERIALS:
        yield _creep(material)
    yield _rest(MATERIALS[0])
    for material in MATERIALS:
        yield _slide(material)
    yield _turned_slide(MATERIALS[0])


def _hold_scenario(material: str) -> Scenario:
    return Scenario(name=f"hold-{material}", variant=f"SlopeSlider-1-{material}", seconds=HOLD_S)


def _on_board_mm(rollout: Rollout) -> FloatArray:
    """Return displacements of the cube [mm], shape [sample_count, 3]: downhill, across, normal to the board."""
    board = rollout.scene.body("board").pose.rotation
    return np.asarray(1e3 * board.apply(rollout.displacement("cube"), inverse=True))


def _downhill_mm(rollout: Rollout) -> FloatArray:
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


def _creep(material: str) -> Phenomenon:
    scenario = _hold_scenario(material)

    def read(rollout: Rollout) -> PhenomenonValue:
        late = rollout.between(SETTLED_S, HOLD_S)
        return PhenomenonValue(value=float(np.polyfit(rollout.times_s[late], _downhill_mm(rollout)[late], 1)[0]))

    bound = creep_bound_mm_per_s(scenario.variant)

    def reality(times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.zeros_like(times_s), bound * times_s

    return Phenomenon(
        id=f"creep-{material}",
        title=f"static friction, {material}: creep on 10 degrees",
        quantity="creep",
        scenario=scenario,
        unit="mm/s",
        reality=Reality.law(
            0.0,
            tolerance=bound,
            source="Coulomb, tan 10 deg < mu",
            rationale=f"E_RMSE and E_DTW of real {material} cubes on this slope are equal as printed (paper, Table 5), "
            "which allows no faster creep",
        ),
        needs_friction=True,
        read=read,
        trace=Trace(label="displacement downhill [mm]", values=_downhill_mm, reality=reality),
    )


def _rest(material: str) -> Phenomenon:
    scenario = _hold_scenario(material)

    def heights_mm(rollout: Rollout) -> FloatArray:
        return _gap_mm(rollout.scene) + _on_board_mm(rollout)[:, 2]

    def read(rollout: Rollout) -> PhenomenonValue:
        return PhenomenonValue(value=float(heights_mm(rollout)[rollout.between(SETTLED_S, HOLD_S)].mean()))

    return Phenomenon(
        id="rest-height",
        title="resting height: gap between cube and board",
        quantity="gap",
        scenario=scenario,
        unit="mm",
        reality=Reality.law(0.0, source="rigid bodies touch", **rigid_tolerance(0.5, "the edge of 50 mm of the cube")),
        needs_friction=True,
        read=read,
        trace=Trace(label="gap [mm]", values=heights_mm, is_level=True),
    )


def _gap_mm(scene: Scene) -> float:
    """Return the gap between the faces of cube and board at the start [mm]."""
    cube, board = scene.body("cube"), scene.body("board")
    assert isinstance(cube.shape, Box) and isinstance(board.shape, Box)
    height = board.pose.to_body(np.asarray(cube.pose.position_m))[2]
    return 1e3 * float(height - 0.5 * (cube.shape.size_m[2] + board.shape.size_m[2]))


# --- sliding ---------------------------------------------------------------------------------------------------------


def _slide(material: str) -> Phenomenon:
    trials = facts("slope_slider_30deg_summary")[material]
    friction = float(trials["friction"]["mean"])
    scenario = Scenario(
        name=f"slide-{material}",
        variant=f"SlopeSlider-2-{material}",
        seconds=SLIDE_S,
        parameters={"cube.friction": friction},
    )
    real = Reality.measured(
        trials["acceleration_m_s2"]["mean"],
        scatter=trials["acceleration_m_s2"]["std"],
        trial_count=trials["trial_count"],
        source="real slides (scoring/facts/slope_slider_30deg_summary.toml); the cube has the friction that they "
        f"show, mu = {friction:.3f}",
    )

    def read(rollout: Rollout) -> PhenomenonValue:
        # The fit is that of the paper for real slides, from rest. The speed that a cube gains while it sinks into soft
        # ground counts, since a camera would record it.
        return PhenomenonValue(value=1e-3 * fitted_acceleration(rollout.times_s, _downhill_mm(rollout)))

    def reality(times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return 500.0 * real.value * times_s**2, 500.0 * real.tolerance * times_s**2

    return Phenomenon(
        id=f"slide-{material}",
        title=f"kinetic friction, {material}: acceleration on 30 degrees",
        quantity="acceleration",
        scenario=scenario,
        unit="m/s^2",
        reality=real,
        needs_friction=True,
        read=read,
        trace=Trace(label="displacement downhill [mm]", values=_downhill_mm, reality=reality),
    )


def _turned(scene: Scene) -> Scene:
    """Return the scene turned about the vertical through the origin."""
    turn = Rotation.from_euler("z", TURN_DEG, degrees=True)
    return replace(scene, bodies=tuple(replace(body, pose=_turned_pose(body.pose, turn)) for body in scene.bodies))


def _turned_pose(pose: Pose, turn: Rotation) -> Pose:
    x, y, z = turn.apply(pose.position_m).tolist()
    w, i, j, k = (turn * pose.rotation).as_quat(scalar_first=True).tolist()
    return replace(pose, position_m=(x, y, z), quaternion=(w, i, j, k))


def _turned_slide(material: str) -> Phenomenon:
    straight = _slide(material)
    scenario = replace(straight.scenario, name=f"slide-turned-{material}", change=_turned)
    friction = next(c.friction for c in scenario.scene.contacts if "board" in c.second)
    downhill = scenario.scene.body("board").pose.rotation.apply([1.0, 0.0, 0.0])
    law = scenario.scene.gravity_m_per_s2 * float(-downhill[2] - friction * np.hypot(*downhill[:2]))
    return replace(
        straight,
        id="slide-turned",
        title=f"isotropic friction, {material}: acceleration on 30 degrees, board turned by {TURN_DEG:.0f} degrees",
        scenario=scenario,
        reality=Reality.law(
            law,
            tolerance=straight.reality.tolerance,
            source=f"g (sin 30 - mu cos 30) with mu = {friction:.3f}, in every direction",
            rationale=f"covers {COVERAGE:.0%} of further real slides on the board that is not turned",
        ),
    )
