"""Rigid bodies: sharp edges, a dry wall, and a frictionless pendulum.

A tetrahedron slides down a seam, and a pyramid falls on its tip. A wall of 118 bricks settles and drifts. A pendulum
swings for a hundred seconds.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial import ConvexHull

from gauge_envs.references.published import published_baselines
from gauge_envs.scene import ConvexUnion, Hinge, RigidBody, Scene, Sphere, Vector
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.estimators import mean_period_s, pendulum_period_s
from gauge_envs.scoring.events import energy_loss
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.sanity.model import Reality
from gauge_envs.tools.sanity.phenomena.base import (
    RECORDINGS,
    Phenomenon,
    acceleration,
    facts,
    recorded,
    recorded_reality,
    rigid_law,
)
from gauge_envs.tools.sanity.scenario import Scenario

# --- edges -----------------------------------------------------------------------------------------------------------

SEAM_S = (0.04, 0.18)
"""Time between settling and the moment when a third of the tetrahedron's face has left the block [s]."""

FALL_S = 10 / 30
"""Time of the published frames of the pyramid [s]."""


def seam() -> Phenomenon:
    """Return the acceleration of a tetrahedron down a seam."""
    scenario = Scenario("seam", "SlopeContact-wood", SEAM_S[1])
    layout = facts("recordings/recordings")["layouts"]["seam"]["coordinates"][0]
    downwards = np.array(layout["direction"])
    friction = next(c.friction for c in scenario.scene.contacts if "base" in c.second)

    def slide(rollout: Recording) -> float:
        path_mm = 1e3 * rollout.displacement("teh") @ downwards
        return acceleration(rollout, path_mm, *SEAM_S)

    return Phenomenon(
        "sharp edges: tetrahedron slides down its seam",
        scenario,
        "m/s^2",
        recorded_reality(
            "slope_contact",
            "slide_acceleration_m_per_s2",
            trial="one recorded slide",
            more=f"; the tetrahedron has the calibrated mu = {friction:.3f}",
        ),
        slide,
        needs_friction=True,
    )


def point() -> Phenomenon:
    """Return the depth of a falling tip in the base."""

    def depth_mm(rollout: Recording) -> float:
        """Return the largest depth of a vertex of the pyramid in a convex piece of the base."""
        base, pyramid = map(rollout.scene.body, ("squarebase", "pyramid"))
        assert isinstance(base.shape, ConvexUnion)
        turns = rollout.rotation("pyramid").as_matrix()
        vertices = np.einsum("tij,vj->vti", turns, pyramid.shape.corners_m)
        places = base.pose.to_body(
            (vertices + rollout.position("pyramid")).reshape(-1, 3)
        )
        depths = [0.0]
        for piece in base.shape.pieces_m:
            planes = ConvexHull(np.asarray(piece)).equations
            inside = -(places @ planes[:, :3].T + planes[:, 3]).max(axis=1)
            depths.append(inside.max())
        return 1e3 * max(depths)

    return Phenomenon(
        "sharp edges: penetration of a falling tip into the base",
        Scenario("point", "NonsmoothContact-1-wood", FALL_S),
        "mm",
        rigid_law(
            "rigid bodies do not overlap", 1.0, "the height of 75 mm of the pyramid"
        ),
        depth_mm,
    )


# --- a wall ----------------------------------------------------------------------------------------------------------

STAND_S = 0.4
"""Simulated time [s]: soft contacts have settled, and a falling wall has moved by centimetres."""

FALLEN_M = 0.02
"""Displacement of a brick by half of its length [m]: the wall gives way, and bricks inside each other take longest."""

RESTS_M_PER_S = 0.001
"""Speed of the bricks of a wall at rest [m/s]: in the time that is left they move by 0.35 mm at most."""


def _without_ball(scene: Scene) -> Scene:
    return replace(
        scene,
        bodies=tuple(body for body in scene.bodies if body.name != "ball"),
        joints=(),
        contacts=tuple(touch for touch in scene.contacts if "ball" not in touch.first),
    )


def _wall(title: str, of: str, extreme_mm: Callable[[FloatArray], float]) -> Phenomenon:
    """Return a row on a wall, by a function of the bricks' last displacements [mm], shape [brick_count, 3]."""
    scenario = Scenario(
        "wall",
        "WallBreaking-wood",
        STAND_S,
        change=_without_ball,
        ends_beyond_m=FALLEN_M,
        rest_m_per_s=RESTS_M_PER_S,
    )

    def moved_mm(rollout: Recording) -> FloatArray:
        bricks = rollout.scene.dynamic_bodies
        return 1e3 * np.array([rollout.displacement(one.name)[-1] for one in bricks])

    def fallen(rollout: Recording) -> str:
        if np.linalg.norm(moved_mm(rollout), axis=-1).max() <= 1e3 * FALLEN_M:
            return ""
        end_s = f"{rollout.times_s[-1]:.2g} s"
        return f"the wall falls: a brick has moved by half of its length after {end_s}, where the run ends"

    return Phenomenon(
        f"stacking: {title}",
        scenario,
        "mm",
        rigid_law("a dry wall does not move", 1.0, of),
        lambda rollout: extreme_mm(moved_mm(rollout)),
        fallen,
        needs_friction=True,
    )


def wall_sag() -> Phenomenon:
    """Return the settling of a wall."""
    title, of = "settling of a wall of 118 bricks", "eleven layers of 15 mm"
    return _wall(title, of, lambda moved_mm: float(-moved_mm[:, 2].min()))


def wall_drift() -> Phenomenon:
    """Return the drift of the bricks of a wall."""
    return _wall(
        f"drift of the bricks of a wall within {STAND_S:g} s",
        "the length of 40 mm of a brick",
        lambda moved_mm: float(np.linalg.norm(moved_mm[:, :2], axis=-1).max()),
    )


# --- a pendulum ------------------------------------------------------------------------------------------------------

PERIOD_S = 10.0
"""Time of the first 300 frames, for which the period is published [s]."""

SWING_INTERVAL_S = 0.02
"""Time between samples of a pendulum [s]: its period is told to 3e-6 and its energy to 5e-4."""

PRINTED = 0.01
"""Last printed digit of the published energy loss."""

PERIOD_TOLERANCE = 0.01
"""Relative tolerance of the period."""

PENDULUM = "Pendulum-metal"


def _pendulum() -> tuple[Scenario, Vector, RigidBody, FloatArray]:
    """Return the scenario of the pendulum, the place of its hinge [m], its ball, and the arm between them [m]."""
    seconds = (published_baselines(PENDULUM)["el"].frames - 1) / FRAME_RATE_HZ
    scenario = Scenario("pendulum", PENDULUM, seconds, interval_s=SWING_INTERVAL_S)
    hinge = next(joint for joint in scenario.scene.joints if isinstance(joint, Hinge))
    ball = scenario.scene.body(hinge.body)
    arm_m = np.asarray(ball.pose.position_m) - hinge.anchor_m
    return scenario, hinge.anchor_m, ball, arm_m


def period() -> Phenomenon:
    """Return the period of a pendulum."""
    scenario, anchor_m, ball, arm = _pendulum()
    assert isinstance(ball.shape, Sphere)
    length = length_of(arm)

    def measured_s(rollout: Recording) -> float:
        part = rollout.between(0.0, PERIOD_S)
        aside_mm = 1e3 * (rollout.position(ball.name)[part, 0] - anchor_m[0])
        return mean_period_s(rollout.times_s[part], aside_mm)

    real = recorded("pendulum", "period_s")
    law = pendulum_period_s(
        length_m=length,
        gyration_m=float(np.sqrt(0.4)) * ball.shape.radius_m,
        amplitude_rad=float(np.arccos(-arm[2] / length)),
        gravity_m_per_s2=scenario.scene.gravity_m_per_s2,
    )
    return Phenomenon(
        "pendulum: period from 90 degrees",
        scenario,
        "s",
        Reality.law(
            law,
            tolerance=PERIOD_TOLERANCE * law,
            source=f"elliptic integral with the scene's length; a recorded trial shows {real['value']:.3f} +- "
            f"{real['sigma']:.3f} s with real damping ({RECORDINGS})",
            rationale=f"{PERIOD_TOLERANCE:.0%}, an error of one swing in a hundred; the recording resolves no less",
        ),
        measured_s,
    )


def energy() -> Phenomenon:
    """Return the energy that a pendulum loses."""
    scenario, anchor_m, ball, arm = _pendulum()
    rest_mm = 1e3 * (anchor_m[2] - length_of(arm))
    return Phenomenon(
        f"pendulum: energy lost within {scenario.seconds:.0f} s",
        scenario,
        "1",
        Reality.law(
            published_baselines(PENDULUM)["el"].mean,
            tolerance=PRINTED,
            source="energy loss of real trials, published as 0.00 (paper, Table 5)",
            rationale="last printed digit of the published loss",
        ),
        lambda rollout: energy_loss(
            1e3 * rollout.position(ball.name)[:, 2], rest_height_mm=rest_mm
        ),
    )
