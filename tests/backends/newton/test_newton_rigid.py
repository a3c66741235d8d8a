"""Rigid scenes on Newton's MuJoCo solver."""

from __future__ import annotations

import importlib

import gymnasium
import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene import (
    Box,
    ConvexUnion,
    Cylinder,
    Sphere,
)

pytest.importorskip("newton")

from gauge_envs.backends import backend
from gauge_envs.scene.meshes import mass_properties

NEWTON = backend("newton")


@pytest.mark.slow
def test_the_same_scene_in_two_engines_moves_alike() -> None:
    for name in ("Turntable-2-metal", "NonsmoothContact-1-wood", "Pendulum-metal"):
        courses = []
        for engine in ("mujoco", "newton"):
            env = gymnasium.make(f"GAUGE/{name}", backend=engine).unwrapped
            env.reset(seed=0)
            # Two swings of the pendulum, whose episode has 3000 frames.
            for _ in range(min(66, env.experiment.frame_count - 1)):
                env.step(
                    np.zeros(env.action_space.shape) if env.action_space.shape else 0
                )
            courses.append(env.trajectory().samples)
        moved = np.linalg.norm(np.ptp(courses[0], axis=0))
        assert (
            np.sqrt(np.square(courses[0] - courses[1]).sum(axis=1).mean())
            < 0.03 * moved
        )


@pytest.mark.parametrize(
    ("shape", "inertia"),
    [
        (Box(size_m=(0.1, 0.2, 0.3)), np.array([0.13, 0.10, 0.05]) / 12),
        (Sphere(radius_m=0.1), np.full(3, 0.4 * 0.01)),
        (Cylinder(radius_m=0.1, length_m=0.3), np.array([0.12 / 12, 0.12 / 12, 0.005])),
    ],
)
def test_inertia_of_solids(shape: object, inertia: np.ndarray) -> None:
    centre, matrix = mass_properties(shape, 1.0)
    assert centre == pytest.approx(np.zeros(3))
    assert matrix == pytest.approx(np.diag(inertia))


def test_inertia_of_a_union_is_that_of_its_pieces_about_their_common_centre() -> None:
    """A box cut in two unequal pieces is the box; one of the pieces alone lies off the origin."""
    corners = np.array(
        [[x, y, z] for x in (-0.1, 0.1) for y in (-0.05, 0.05) for z in (-0.02, 0.02)]
    )
    low, high = corners.copy(), corners.copy()
    low[:, 0] = np.where(low[:, 0] > 0, 0.03, -0.1)
    high[:, 0] = np.where(high[:, 0] < 0, 0.03, 0.1)
    pieces = tuple(tuple(map(tuple, piece.tolist())) for piece in (low, high))
    centre, matrix = mass_properties(ConvexUnion(pieces_m=pieces), 2.0)
    assert centre == pytest.approx(np.zeros(3), abs=1e-12)
    assert matrix == pytest.approx(
        mass_properties(Box(size_m=(0.2, 0.1, 0.04)), 2.0)[1], abs=1e-12
    )
    assert mass_properties(ConvexUnion(pieces_m=pieces[:1]), 2.0)[0] == pytest.approx(
        [-0.035, 0.0, 0.0]
    )


def test_models_share_the_kernels_of_their_collision_pipelines() -> None:
    """Newton would make them for each model, which takes longer than all the rest of it; outside, Newton still does."""
    narrow_phase = importlib.import_module("newton._src.geometry.narrow_phase")
    own = narrow_phase.create_narrow_phase_primitive_kernel
    kernels = [
        NEWTON.build(
            load_experiment(f"SlopeSlider-2-{material}").scene
        )._stepper._pipeline.narrow_phase.primitive_kernel
        for material in ("wood", "metal")
    ]
    assert kernels[0] is kernels[1]
    assert narrow_phase.create_narrow_phase_primitive_kernel is own


def test_out_of_the_box_restitution_has_no_effect_as_published() -> None:
    """The published Newton scores 22.71 (GAUGE, Table 5): its solver ignores the ball's coefficient of restitution."""
    scores = {
        e: run_episode(
            RunRequest(
                "BouncingBall-rubber",
                backend="newton",
                settings={"preset": "out_of_box"},
                parameters={"ball.restitution": e},
            )
        ).score.rmse_normalized
        for e in (0.0, 0.9)
    }
    assert scores[0.0] == scores[0.9] == pytest.approx(22.71, rel=0.005)


def test_meshes_that_touch_in_one_point_creep_as_published() -> None:
    """The published Newton creeps by 14.6 mm on 10 degrees; boxes with four contact points hold."""
    scores = {
        preset: run_episode(
            RunRequest(
                "SlopeSlider-1-wood", backend="newton", settings={"preset": preset}
            )
        ).score.rmse_normalized
        for preset in ("paper", "out_of_box")
    }
    assert scores["paper"] == pytest.approx(24.68, rel=0.1)
    assert scores["out_of_box"] < 0.5
