"""Rigid scenes on Newton's MuJoCo solver."""

import importlib
from collections import Counter

import gymnasium
import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene import GRAVITY_M_PER_S2, Scene
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


def test_models_share_the_kernels_of_their_collision_pipelines():
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
        simulation.reset(0)
        simulation.advance(scene.duration_s)
        top_m = simulation.body_states(names)[-1, 2]
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


@pytest.mark.slow
def test_a_frame_of_driven_worlds_is_copied_as_often_with_more_worlds(monkeypatch):
    """Six drives are sent, and six positions, and states of free and driven bodies read; a restart copies nothing."""
    warp_array = importlib.import_module("warp").array
    counts = Counter()
    for name in ("numpy", "assign"):
        call = getattr(warp_array, name)

        def counted(array, *values, name=name, call=call):
            counts[name] += 1
            return call(array, *values)

        monkeypatch.setattr(warp_array, name, counted)
    for world_count in (2, 5):
        envs = gymnasium.make_vec(
            "GAUGE/Turntable-1-wood", num_envs=world_count, backend="newton"
        )
        envs.reset(seed=0)
        counts.clear()
        envs.step(np.zeros(envs.action_space.shape))
        assert counts == {"numpy": 10, "assign": 6}
        counts.clear()
        envs.unwrapped.worlds.restart(1)
        assert not counts
        envs.close()
