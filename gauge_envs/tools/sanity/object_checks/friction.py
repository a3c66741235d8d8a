"""Friction of a cube: creep and resting height on a slope, and slides.

A sliding cube has the friction that the same trials show, so that the check compares the engine alone.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.fixtures.recording import Recording
from gauge_envs.fixtures.slope import (
    acceleration_downhill_m_per_s2,
    creep_m_per_s,
    moved_m,
)
from gauge_envs.references.published import published_baselines
from gauge_envs.scene import Box, Pose, RigidBody
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.tools.sanity.object_checks.check import (
    ObjectCheck,
    Scenario,
    facts,
    posed,
    rigid_law,
)
from gauge_envs.tools.sanity.verdict import COVERAGE, Need, Reality

HOLD_S, SETTLED_S = 1.0, 0.5
"""Simulated time, and time after which the cube has sunk into a soft contact and only creeps [s]."""

BOARD_ROTATION = Rotation.from_euler("z", 45.0, degrees=True)
"""Rotation of the board about the vertical. Engines choose the tangents of a contact by the axes of the world."""

SLIDE_S = 0.5
"""Simulated time [s], in which a cube that is 20 % too fast does not reach the end of the board. After half of it, the
cube has sunk into soft ground and slides steadily."""

PRINTED_MM = 0.01
"""Last printed digit of the published scores of SlopeSlider-1 [mm]."""

CALM_INTERVAL_S = 0.01
"""Time between samples of a body that rests [s]: a third of a published frame."""

CUBE = ("cube", "board")
"""The sliding body and its support."""


def _hold_scenario(material: str) -> Scenario:
    return Scenario(
        f"hold-{material}",
        f"SlopeSlider-1-{material}",
        HOLD_S,
        interval_s=CALM_INTERVAL_S,
        released=("cube",),
    )


# --- holding ---------------------------------------------------------------------------------------------------------


def creep_bound_mm_per_s(variant: str) -> float:
    """Return the fastest creep [mm/s] that the published scores of real cubes allow.

    A cube that moves uniformly by d within the trial, at a distance c from the mean, has E_RMSE - E_DTW = d^2 / (24 c).
    The two published numbers are equal, so they differ by less than one digit. The scatter of positions does not
    measure creep, since most of it comes from placing the cube by hand.
    """
    rmse = published_baselines(variant)["rmse"]
    return float(np.sqrt(24.0 * PRINTED_MM * rmse.mean)) * 30.0 / (rmse.frames - 1)


def creep(material: str) -> ObjectCheck:
    """Return the creep of a cube at rest on a slope."""
    scenario = _hold_scenario(material)
    law = Reality(
        0.0,
        creep_bound_mm_per_s(scenario.variant),
        "Coulomb, tan 10 deg < mu",
        f"E_RMSE and E_DTW of real {material} cubes on this slope are equal as printed (paper, Table 5), "
        "which allows no faster creep",
    )
    title = f"creep of a cube of {material} on 10 degrees"
    return ObjectCheck(
        title,
        scenario,
        "mm/s",
        law,
        lambda rollout: 1e3 * creep_m_per_s(rollout, *CUBE, start_s=SETTLED_S),
    )


def rest_height(material: str) -> ObjectCheck:
    """Return the gap between a cube at rest and its board."""
    return ObjectCheck(
        "gap between a cube at rest and its board",
        _hold_scenario(material),
        "mm",
        rigid_law("rigid bodies touch", 0.5, "the edge of 50 mm of the cube"),
        lambda rollout: _gaps_mm(rollout)[rollout.between(SETTLED_S, HOLD_S)].mean(),
    )


def _gaps_mm(rollout: Recording) -> FloatArray:
    """Return the gap between the faces of cube and board [mm], shape [sample_count]."""
    cube, board = map(rollout.scene.body, CUBE)
    assert isinstance(cube.shape, Box) and isinstance(board.shape, Box)
    height = board.pose.to_body(np.asarray(cube.pose.position_m))[2]
    start = float(height - 0.5 * (cube.shape.size_m[2] + board.shape.size_m[2]))
    return 1e3 * start + 1e3 * moved_m(rollout, *CUBE)[:, 2]


# --- sliding ---------------------------------------------------------------------------------------------------------


def real_friction(material: str) -> float:
    """Return the friction that real slides of a cube show."""
    return float(facts("slope_slider_30deg_summary")[material]["friction"]["mean"])


def slide(material: str) -> ObjectCheck:
    """Return the acceleration of a sliding cube."""
    trials = facts("slope_slider_30deg_summary")[material]
    slides = trials["acceleration_m_s2"]
    friction = real_friction(material)
    variant = f"SlopeSlider-2-{material}"
    scene = load_experiment(variant, {"cube.friction": friction}).scene
    return ObjectCheck(
        f"acceleration of a cube of {material} on 30 degrees",
        Scenario(f"slide-{material}", variant, SLIDE_S, scene, released=("cube",)),
        "m/s^2",
        Reality.measured(
            slides["mean"],
            slides["std"],
            trials["trial_count"],
            "real slides (scoring/facts/slope_slider_30deg_summary.toml); "
            f"the cube has the friction that they show, mu = {friction:.3f}",
        ),
        lambda rollout: acceleration_downhill_m_per_s2(
            rollout, *CUBE, start_s=0.5 * SLIDE_S
        ),
    )


def _turned(body: RigidBody) -> Pose:
    """Return the pose of a body, turned about the vertical through the origin."""
    place_m = vector(BOARD_ROTATION.apply(body.pose.position_m))
    return Pose.from_rotation(place_m, BOARD_ROTATION * body.pose.rotation)


def turned_slide(material: str) -> ObjectCheck:
    """Return the acceleration of a cube that slides in another direction."""
    straight = slide(material)
    friction = real_friction(material)
    scene = posed(straight.scenario.scene, _turned)
    downhill = scene.body("board").pose.rotation.apply([1.0, 0.0, 0.0])
    push = -downhill[2] - friction * np.hypot(*downhill[:2])
    return replace(
        straight,
        title="acceleration of a cube on a turned board",
        scenario=replace(
            straight.scenario, name=f"slide-turned-{material}", given=scene
        ),
        needs=(Need.SPACE,),
        reality=Reality(
            scene.gravity_m_per_s2 * float(push),
            straight.reality.tolerance,
            f"g (sin 30 - mu cos 30) with mu = {friction:.3f}, in every direction",
            f"covers {COVERAGE:.0%} of further real slides on the board that is not turned",
        ),
    )
