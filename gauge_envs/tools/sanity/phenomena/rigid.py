"""Rigid bodies: sharp edges, a dry wall, and a frictionless pendulum.

A tetrahedron slides down a seam, and a pyramid falls on its tip. A wall of 118 bricks settles and drifts. A pendulum
swings for a hundred seconds.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial import ConvexHull

from gauge_envs.references.published import published_baselines
from gauge_envs.scene import ConvexUnion, Hinge, RigidBody, Scene, Sphere
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
    scenario = Scenario(name="seam", variant="SlopeContact-wood", seconds=SEAM_S[1])
    downwards = np.array(
        facts("recordings/recordings")["layouts"]["seam"]["coordinates"][0]["direction"]
    )
    friction = next(c.friction for c in scenario.scene.contacts if "base" in c.second)

    def slid_mm(rollout: Recording) -> FloatArray:
        return 1e3 * rollout.displacement("teh") @ downwards

    return Phenomenon(
        title="sharp edges: tetrahedron slides down its seam",
        scenario=scenario,
        unit="m/s^2",
        reality=recorded_reality(
            "slope_contact",
            "slide_acceleration_m_per_s2",
            trial="one recorded slide",
            more=f"; the tetrahedron has the calibrated mu = {friction:.3f}",
        ),
        needs_friction=True,
        value=lambda rollout: acceleration(rollout, slid_mm(rollout), *SEAM_S),
    )


def point() -> Phenomenon:
    """Return the depth of a falling tip in the base."""

    def depth_mm(rollout: Recording) -> FloatArray:
        return _depths_mm(rollout, "pyramid", "squarebase")

    return Phenomenon(
        title="sharp edges: penetration of a falling tip into the base",
        scenario=Scenario(
            name="point", variant="NonsmoothContact-1-wood", seconds=FALL_S
        ),
        unit="mm",
        reality=rigid_law(
            "rigid bodies do not overlap", 1.0, "the height of 75 mm of the pyramid"
        ),
        value=lambda rollout: depth_mm(rollout).max(),
    )


def _depths_mm(rollout: Recording, body: str, fixed: str) -> FloatArray:
    """Return the depth of a body's deepest vertex in a fixed body [mm], shape [sample_count]."""
    shape, solid = rollout.scene.body(body).shape, rollout.scene.body(fixed).shape
    assert isinstance(solid, ConvexUnion)
    rotations = rollout.rotation(body).as_matrix()
    vertices = (
        np.einsum("tij,vj->tvi", rotations, shape.corners_m)
        + rollout.position(body)[:, None]
    )
    places = rollout.scene.body(fixed).pose.to_body(vertices.reshape(-1, 3))
    depth = np.zeros(len(places))
    for piece in solid.pieces_m:
        planes = ConvexHull(np.asarray(piece)).equations
        depth = np.maximum(
            depth, -(places @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        )
    return 1e3 * depth.reshape(vertices.shape[:2]).max(axis=1)


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
        contacts=tuple(
            contact for contact in scene.contacts if "ball" not in contact.first
        ),
    )


def _wall(
    title: str, extreme_mm: Callable[[FloatArray], FloatArray], of: str
) -> Phenomenon:
    """Return a row on a wall, by a function of the bricks' displacements [mm], shape [brick_count, sample_count, 3]."""
    scenario = Scenario(
        name="wall",
        variant="WallBreaking-wood",
        seconds=STAND_S,
        change=_without_ball,
        ends_beyond_m=FALLEN_M,
        rest_m_per_s=RESTS_M_PER_S,
    )
    bricks = [body.name for body in scenario.scene.dynamic_bodies]

    def moved_mm(rollout: Recording) -> FloatArray:
        return 1e3 * np.array([rollout.displacement(name) for name in bricks])

    def values(rollout: Recording) -> FloatArray:
        return extreme_mm(moved_mm(rollout))

    def fallen(rollout: Recording) -> str:
        if np.linalg.norm(moved_mm(rollout)[:, -1], axis=-1).max() <= 1e3 * FALLEN_M:
            return ""
        end_s = f"{rollout.times_s[-1]:.2g} s"
        return f"the wall falls: a brick has moved by half of its length after {end_s}, where the run ends"

    return Phenomenon(
        title=f"stacking: {title}",
        scenario=scenario,
        unit="mm",
        reality=rigid_law("a dry wall does not move", 1.0, of),
        needs_friction=True,
        value=lambda rollout: values(rollout)[-1],
        failure=fallen,
    )


def wall_sag() -> Phenomenon:
    """Return the settling of a wall."""
    title = "settling of a wall of 118 bricks"
    return _wall(
        title, lambda moved: -moved[..., 2].min(axis=0), "eleven layers of 15 mm"
    )


def wall_drift() -> Phenomenon:
    """Return the drift of the bricks of a wall."""

    def drift_mm(moved_mm: FloatArray) -> FloatArray:
        aside: FloatArray = np.linalg.norm(moved_mm[..., :2], axis=-1).max(axis=0)
        return aside

    title = f"drift of the bricks of a wall within {STAND_S:g} s"
    return _wall(title, drift_mm, "the length of 40 mm of a brick")


# --- a pendulum ------------------------------------------------------------------------------------------------------

PERIOD_S = 10.0
"""Time of the first 300 frames, for which the period is published [s]."""

SWING_INTERVAL_S = 0.02
"""Time between samples of a pendulum [s]: its period is told to 3e-6 and its energy to 5e-4."""

PRINTED = 0.01
"""Last printed digit of the published energy loss."""

PERIOD_TOLERANCE = 0.01
"""Relative tolerance of the period."""


def _pendulum() -> tuple[Scenario, Hinge, RigidBody, FloatArray]:
    """Return the scenario of the pendulum, its hinge and ball, and the arm between them [m], shape [3]."""
    variant = "Pendulum-metal"
    seconds = (published_baselines(variant)["el"].frames - 1) / FRAME_RATE_HZ
    scenario = Scenario(
        name="pendulum", variant=variant, seconds=seconds, interval_s=SWING_INTERVAL_S
    )
    hinge = next(joint for joint in scenario.scene.joints if isinstance(joint, Hinge))
    ball = scenario.scene.body(hinge.body)
    return scenario, hinge, ball, np.asarray(ball.pose.position_m) - hinge.anchor_m


def period() -> Phenomenon:
    """Return the period of a pendulum."""
    scenario, hinge, ball, arm = _pendulum()
    assert isinstance(ball.shape, Sphere)
    length = length_of(arm)

    def aside_mm(rollout: Recording) -> FloatArray:
        return 1e3 * (rollout.position(ball.name)[:, 0] - hinge.anchor_m[0])

    def measured_s(rollout: Recording) -> float:
        part = rollout.between(0.0, PERIOD_S)
        return mean_period_s(rollout.times_s[part], aside_mm(rollout)[part])

    real = recorded("pendulum", "period_s")
    law = pendulum_period_s(
        length_m=length,
        gyration_m=float(np.sqrt(0.4)) * ball.shape.radius_m,
        amplitude_rad=float(np.arccos(-arm[2] / length)),
        gravity_m_per_s2=scenario.scene.gravity_m_per_s2,
    )
    return Phenomenon(
        title="pendulum: period from 90 degrees",
        scenario=scenario,
        unit="s",
        reality=Reality.law(
            law,
            tolerance=PERIOD_TOLERANCE * law,
            source=f"elliptic integral with the scene's length; a recorded trial shows {real['value']:.3f} +- "
            f"{real['sigma']:.3f} s with real damping ({RECORDINGS})",
            rationale=f"{PERIOD_TOLERANCE:.0%}, an error of one swing in a hundred; the recording resolves no less",
        ),
        value=measured_s,
    )


def energy() -> Phenomenon:
    """Return the energy that a pendulum loses."""
    scenario, hinge, ball, arm = _pendulum()
    rest_mm = 1e3 * (hinge.anchor_m[2] - length_of(arm))
    return Phenomenon(
        title=f"pendulum: energy lost within {scenario.seconds:.0f} s",
        scenario=scenario,
        unit="1",
        reality=Reality.law(
            published_baselines(scenario.variant)["el"].mean,
            tolerance=PRINTED,
            source="energy loss of real trials, published as 0.00 (paper, Table 5)",
            rationale="last printed digit of the published loss",
        ),
        value=lambda rollout: energy_loss(
            1e3 * rollout.position(ball.name)[:, 2], rest_height_mm=rest_mm
        ),
    )
