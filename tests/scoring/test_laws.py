"""Laws that hold until an event: the condition is checked on the scenes, and each end against a simulation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gauge_envs import load_experiment, reference_band
from gauge_envs.backends import backend
from gauge_envs.errors import ShapeError
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.scene import Box, ConvexUnion, Motion, Plane, Pose, RigidBody, Scene
from gauge_envs.scene.scene import GRAVITY_M_PER_S2
from gauge_envs.scoring.laws import distance_to_contact_m, free_flight, slide
from gauge_envs.scoring.score import score_trajectory

FALLS = tuple(
    f"NonsmoothContact-{subtask}-{material}"
    for subtask in "123"
    for material in ("wood", "plastic")
)
SLIDES = ("SlopeContact-wood", "SlopeContact-plastic")
DOWN = np.array([0.0, 0.0, -1.0])
FIRST_TURN_DEG = 0.2
"""Rotation above which a simulated body no longer falls or slides without turning."""


def box(
    name: str,
    position_m: tuple[float, float, float],
    euler_deg=(0.0, 0.0, 0.0),
    size_m=(0.1, 0.1, 0.1),
) -> RigidBody:
    pose = Pose.from_euler_deg(position_m, euler_deg)
    return RigidBody(
        name=name,
        shape=Box(size_m=size_m),
        motion=Motion.DYNAMIC,
        pose=pose,
        mass_kg=1.0,
    )


def band_of(variant: str) -> Band:
    band = reference_band(load_experiment(variant))
    assert band is not None
    return band


def first_turn_s(variant: str) -> float:
    """Time at which the recorded body has turned, in a simulation that is sampled 1800 times a second."""
    experiment = load_experiment(variant)
    simulation = backend("mujoco").build(experiment.scene)
    simulation.reset(0)
    start = Pose(
        position_m=(0.0, 0.0, 0.0),
        quaternion=experiment.scene.body(experiment.recorded[0]).pose.quaternion,
    )
    for sample in range(1, 361):
        simulation.advance(1 / 1800)
        turned = simulation.body_states(experiment.recorded)[0, 3:7]
        apart = (
            start.rotation.inv()
            * replace(start, quaternion=tuple(turned.tolist())).rotation
        ).magnitude()
        if math.degrees(apart) > FIRST_TURN_DEG:
            return sample / 1800
    raise AssertionError(f"{variant} never turns")


# Distance to a contact


def test_boxes_meet_face_to_face_and_corner_to_face() -> None:
    below = box("below", (0.0, 0.0, 0.0))
    assert distance_to_contact_m(
        box("above", (0.03, 0.0, 0.4)), below, DOWN
    ) == pytest.approx(0.3, abs=1e-7)
    turned = box("turned", (0.0, 0.0, 0.4), (45.0, 0.0, 0.0))
    assert distance_to_contact_m(turned, below, DOWN) == pytest.approx(
        0.35 - 0.05 * math.sqrt(2), abs=1e-7
    )


def test_crossed_edges_meet_where_no_corner_is() -> None:
    """Two prisms on edge, at right angles: the edges meet, and the corners are far away."""
    below = box("below", (0.0, 0.0, 0.0), (45.0, 0.0, 0.0), (1.0, 0.1, 0.1))
    above = box("above", (0.0, 0.0, 0.5), (0.0, 45.0, 0.0), (0.1, 1.0, 0.1))
    assert distance_to_contact_m(above, below, DOWN) == pytest.approx(
        0.5 - 0.1 * math.sqrt(2), abs=1e-7
    )


def test_what_passes_by_never_meets() -> None:
    assert (
        distance_to_contact_m(
            box("a", (0.2, 0.0, 0.4)), box("b", (0.0, 0.0, 0.0)), DOWN
        )
        == math.inf
    )
    assert (
        distance_to_contact_m(
            box("a", (0.0, 0.0, 0.4)), box("b", (0.0, 0.0, 0.0)), -DOWN
        )
        == math.inf
    )


def test_a_plane_is_met_by_the_lowest_corner() -> None:
    ground = RigidBody(
        name="ground",
        shape=Plane(),
        motion=Motion.FIXED,
        pose=Pose(position_m=(5.0, 0.0, 0.1)),
        mass_kg=0.0,
    )
    turned = box("turned", (0.0, 0.0, 0.4), (45.0, 0.0, 0.0))
    assert distance_to_contact_m(turned, ground, DOWN) == pytest.approx(
        0.3 - 0.05 * math.sqrt(2), abs=1e-9
    )
    assert distance_to_contact_m(turned, ground, np.array([1.0, 0.0, 0.0])) == math.inf


def test_a_union_is_met_at_its_nearest_piece() -> None:
    """A point falls into a recess: its floor is met, and not the walls beside it."""
    corners = Box(size_m=(0.1, 0.1, 0.1)).corners_m
    pieces = tuple(
        tuple(map(tuple, (corners + shift).tolist()))
        for shift in ([0, 0, -0.1], [0.1, 0, 0], [-0.1, 0, 0])
    )
    pose = Pose(position_m=(0.0, 0.0, 0.0))
    cup = RigidBody(
        name="cup",
        shape=ConvexUnion(pieces_m=pieces),
        motion=Motion.FIXED,
        pose=pose,
        mass_kg=1.0,
    )
    assert distance_to_contact_m(
        box("pin", (0.0, 0.0, 0.4), size_m=(0.02,) * 3), cup, DOWN
    ) == pytest.approx(0.44)
    assert distance_to_contact_m(
        box("wide", (0.0, 0.0, 0.4), size_m=(0.12,) * 3), cup, DOWN
    ) == pytest.approx(0.29)


# Free flight


@pytest.mark.parametrize("variant", FALLS)
def test_nothing_is_touched_at_the_start_of_a_fall(variant: str) -> None:
    """Gravity alone acts from frame 0 on: nothing holds, drives or touches the body."""
    experiment = load_experiment(variant)
    scene, (body,) = experiment.scene, experiment.recorded
    assert not scene.joints and not scene.attachments and not scene.drivers
    gaps = [
        distance_to_contact_m(scene.body(body), other, DOWN)
        for other in scene.bodies
        if other.name != body
    ]
    assert min(gaps) > 0.05


@pytest.mark.parametrize("variant", FALLS)
def test_a_fall_ends_where_the_simulated_body_first_turns(variant: str) -> None:
    flight = free_flight(
        load_experiment(variant).scene, load_experiment(variant).recorded[0]
    )
    assert flight.end_s < first_turn_s(variant) < flight.end_s + 0.006
    band = band_of(variant)
    times_s = np.arange(len(band.mean)) / 30
    assert band.measured.tolist() == (times_s < flight.end_s).tolist()
    assert band.measured.sum() == 4
    fallen_mm = band.mean[0, 2] - band.mean[:4, 2]
    assert fallen_mm == pytest.approx(0.5e3 * GRAVITY_M_PER_S2 * times_s[:4] ** 2)
    assert np.isnan(band.mean[4:]).all()


def test_a_body_that_touches_another_one_does_not_fall_freely() -> None:
    with pytest.raises(ShapeError, match="teh touches another body at the start"):
        free_flight(load_experiment("SlopeContact-wood").scene, "teh")


# Slide


@pytest.mark.parametrize("variant", SLIDES)
def test_a_slide_ends_where_the_simulated_body_first_turns(variant: str) -> None:
    scene = load_experiment(variant).scene
    motion = slide(scene, "teh", "base")
    friction = next(
        c.friction for c in scene.contacts if "base" in (*c.first, *c.second)
    )
    angle = math.atan(math.sqrt(2))
    coulomb = GRAVITY_M_PER_S2 * (math.sin(angle) - friction * math.cos(angle))
    assert motion.acceleration_m_per_s2 == pytest.approx(coulomb, rel=1e-6)
    assert motion.direction == pytest.approx(
        [1 / math.sqrt(3), 0.0, -math.sqrt(2 / 3)], abs=1e-8
    )
    # Two thirds of the face's height lie below the centroid, which is a quarter of the body's height above the face.
    face_mm, height_mm = 100 * math.sqrt(1.5), 100 / math.sqrt(3) / 4
    assert 1e3 * motion.distance_m == pytest.approx(
        2 / 3 * face_mm - friction * height_mm, abs=0.01
    )
    assert first_turn_s(variant) == pytest.approx(motion.end_s, abs=0.008)
    assert band_of(variant).measured.sum() == 5


def test_the_recorded_slide_ends_with_the_law() -> None:
    """The recording slides without turning until 0.16 s after the release."""
    assert slide(
        load_experiment("SlopeContact-wood").scene, "teh", "base"
    ).end_s == pytest.approx(0.16, abs=0.04)


def test_friction_that_holds_and_a_gap_are_no_slide() -> None:
    held = load_experiment("SlopeContact-wood", {"teh.friction": 1.5})
    with pytest.raises(ShapeError, match="holds teh on base"):
        slide(held.scene, "teh", "base")
    scene = load_experiment("SlopeContact-wood").scene
    away = replace(scene.body("teh"), pose=Pose(position_m=(0.6, 0.408961, 0.180622)))
    apart = Scene(
        bodies=tuple(away if one.name == "teh" else one for one in scene.bodies),
        contacts=scene.contacts,
        duration_s=scene.duration_s,
    )
    with pytest.raises(ShapeError, match="mm away from base: it does not slide on it"):
        slide(apart, "teh", "base")


# Scores


@pytest.mark.parametrize("variant", [FALLS[0], SLIDES[1]])
def test_scores_against_such_a_law_are_not_normalized(variant: str) -> None:
    """Only frames before the end count: later ones may be anything."""
    experiment, band = load_experiment(variant), band_of(variant)
    values = np.where(
        np.isfinite(band.mean), band.mean + np.array([3.0, 0.0, 4.0]), 1e3
    )
    score = score_trajectory(
        experiment,
        band,
        times_s=np.arange(len(values)) / 30,
        values=values,
        is_checked=True,
    )
    assert (score.grade, score.rmse) == (Kind.ANALYTIC, pytest.approx(5.0))
    assert (score.validation, score.rmse_aligned) == (None, None)
    # The solution is exact: the distance stays in mm.
    solved = score.verification
    assert (solved.scaled, solved.scale_unit) == (pytest.approx(5.0), "mm")
    assert score.primary_normalized == solved.scaled


def test_changed_parameters_do_not_move_the_law() -> None:
    changed = load_experiment("SlopeContact-wood", {"teh.friction": 0.1})
    band = reference_band(changed)
    assert band is not None
    assert np.array_equal(band.mean, band_of("SlopeContact-wood").mean, equal_nan=True)


def test_rewards_end_with_the_law(rollout) -> None:
    env, _, info = rollout("NonsmoothContact-1-wood")
    assert info["score"].grade == "law"
    rewards = []
    env.reset(seed=0)
    for _ in range(10):
        rewards.append(env.step(0)[1])
    assert all(-0.1 < reward < 0.0 for reward in rewards[:3])
    assert rewards[3:] == [0.0] * 7
