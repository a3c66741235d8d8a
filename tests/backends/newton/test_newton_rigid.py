"""Rigid scenes on Newton's MuJoCo solver."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene import GRAVITY_M_PER_S2, Scene
from gauge_envs.scene.states import nominal_states
from gauge_envs.tools.bench.parts import box, contact, ground

pytest.importorskip("newton")

from gauge_envs.backends import backend

NEWTON = backend("newton")


@pytest.mark.slow
def test_the_same_scene_in_two_engines_moves_alike(rollout):
    for name in ("Turntable-2-metal", "NonsmoothContact-1-wood", "Pendulum-metal"):
        courses = []
        for engine in ("mujoco", "newton"):
            # Two swings of the pendulum, whose episode has 3000 frames.
            _, course, _ = rollout(name, frames=66, backend=engine)
            courses.append(course.samples)
        moved = np.linalg.norm(np.ptp(courses[0], axis=0))
        assert (
            np.sqrt(np.square(courses[0] - courses[1]).sum(axis=1).mean())
            < 0.03 * moved
        )


def test_a_tower_sinks_by_the_compliance_of_its_contacts():
    """Depth of a contact: (1 - impedance) T^2 of its load over the mass that it moves, of MuJoCo's documentation."""
    size_m = (0.1, 0.1, 0.05)
    for count, preset, impedance in ((2, "rigid", 0.5), (3, "stack", 0.99)):
        boxes = [
            box(str(i), (0.0, 0.0, 0.05 * (i + 0.5)), size_m) for i in range(count)
        ]
        names = tuple(one.name for one in boxes)
        touch = [contact(names, other, friction=0.4) for other in (names, "ground")]
        scene = Scene(bodies=(*boxes, ground()), contacts=tuple(touch), duration_s=0.3)
        simulation = NEWTON.build(scene)
        simulation.advance(scene.duration_s)
        top_m = simulation.body_states(names)[0, -1, 2]
        sink_m = boxes[-1].pose.position_m[2] - top_m
        time_constant_s = simulation.settings["sustained_solref"][0]
        law_m = (1.0 - impedance) * time_constant_s**2 * GRAVITY_M_PER_S2 * count**2 / 4
        assert simulation.settings["preset"] == preset
        assert sink_m == pytest.approx(law_m, rel=0.02)


def test_a_slide_is_within_the_uncertainty_of_its_solution():
    """Hops cost a cube friction in single precision, less with a smaller impedance (studies/steps)."""
    stiff = {"sustained_solimp": (0.95, 0.95, 0.001), "impratio": 10.0}
    errors_mm = [
        run_episode(
            RunRequest("SlopeSlider-3-wood", backend="newton", settings=settings)
        ).score.rmse
        for settings in ({}, stiff)
    ]
    assert errors_mm[0] < 0.11 < 1.0 < errors_mm[1]


def test_a_setting_may_be_rounded_to_single_precision():
    scene = load_experiment("SlopeSlider-2-wood").scene
    assert NEWTON.build(scene, {"impratio": 440.0}).settings["impratio"] == 440.0


def test_out_of_the_box_restitution_has_no_effect_as_published():
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


def test_meshes_that_touch_in_one_point_creep_as_published():
    """The published Newton creeps by 14.6 mm on 10 degrees; boxes with four contact points hold."""
    baseline = published_baselines("SlopeSlider-1-wood")["rmse"]
    scores = {
        preset: run_episode(
            RunRequest(
                "SlopeSlider-1-wood", backend="newton", settings={"preset": preset}
            )
        ).score.rmse
        / baseline.mean
        for preset in ("paper", "out_of_box")
    }
    assert scores["paper"] == pytest.approx(baseline.engines["newton"], rel=0.1)
    assert scores["out_of_box"] < 0.5


def test_worlds_start_and_move_on_their_own():
    """One of two worlds starts and is pushed as a single world is; a reset forgets both."""
    scene = load_experiment("SlopeSlider-2-wood").scene
    names = [body.name for body in scene.bodies]
    cube = scene.dynamic_bodies[0].name
    nominal = nominal_states(scene)
    moved = nominal.copy()
    moved[names.index(cube)] += [0.01, 0.02, 0.03, *np.zeros(4), 0.1, 0.2, 0.3, 1, 2, 3]
    push = np.array([[0.0, 0.0, 0.2, 0.0, 0.001, 0.0]])
    worlds, single = NEWTON.build_worlds(scene, 2), NEWTON.build(scene)
    worlds.reset(np.stack([nominal, moved]))
    single.reset(moved[None])
    assert worlds.body_states(names)[1] == pytest.approx(moved, abs=1e-7)
    worlds.apply_wrench(cube, np.vstack([np.zeros((1, 6)), push]))
    single.apply_wrench(cube, push)
    for simulation in (worlds, single):
        simulation.advance(0.1)
    ends = worlds.body_states(names)
    assert (ends[1] == single.body_states(names)[0]).all()
    worlds.reset()
    worlds.advance(0.1)
    assert (worlds.body_states(names) == ends[0]).all()


def test_a_body_on_a_hinge_starts_where_the_array_says():
    scene = load_experiment("Pendulum-metal").scene
    hinge = scene.joints[0]
    row = [body.name for body in scene.bodies].index(hinge.body)
    starts = nominal_states(scene)[None]
    turn = Rotation.from_rotvec(0.3 * np.array(hinge.axis))
    arm_m = turn.apply(starts[0, row, :3] - hinge.anchor_m)
    spin = 1.5 * np.array(hinge.axis)
    orientation = turn * Rotation.from_quat(starts[0, row, 3:7], scalar_first=True)
    starts[0, row, :3] = hinge.anchor_m + arm_m
    starts[0, row, 3:7] = orientation.as_quat(scalar_first=True)
    starts[0, row, 7:] = [*np.cross(spin, arm_m), *spin]
    simulation = NEWTON.build(scene)
    simulation.reset(starts)
    simulation.advance(1 / 1800)
    state = simulation.body_states([hinge.body])[0, 0]
    assert state[:3] == pytest.approx(starts[0, row, :3], abs=2e-3)
    assert state[10:] == pytest.approx(spin, abs=0.02)


def test_contact_forces_are_those_of_each_world():
    """A box at rest weighs on the ground in one world, and flies in the other."""
    scene = Scene(
        bodies=(box("box", (0.0, 0.0, 0.05), (0.1, 0.1, 0.1)), ground()),
        contacts=(contact("box", "ground", friction=0.4),),
        duration_s=0.3,
    )
    simulation = NEWTON.build_worlds(scene, 2)
    read = simulation.contact_forces([("box", "ground"), ("ground", "box")])
    starts = np.stack([nominal_states(scene)] * 2)
    starts[1, 0, 2] += 0.5
    simulation.reset(starts)
    for _ in range(36):
        simulation.advance(1 / 180)
    weight_n = scene.bodies[0].mass_kg * GRAVITY_M_PER_S2
    forces_n = read()
    assert forces_n[0, :, 2] == pytest.approx([weight_n, -weight_n], rel=0.02)
    assert (forces_n[1] == 0.0).all()
