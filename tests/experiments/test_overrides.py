"""Every override changes the scene, or is an error that names those that do."""

import math

import numpy as np
import pytest

from gauge_envs import GaugeEnv, beyond_variants, load_experiment, variants
from gauge_envs.backends.registry import backend
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.scene_builder import SceneBuilder
from gauge_envs.experiments.task_files import task_spec

ALL = (*variants(), *beyond_variants())
SLIDE = "SlopeSlider-2-wood"


def built(variant, overrides):
    builder = SceneBuilder(task_spec(variant.family), variant, overrides)
    return builder, builder.build()


@pytest.mark.parametrize("variant", ALL, ids=lambda one: one.name)
def test_each_constant_changes_the_scene_or_is_an_error(variant):
    builder, calibrated = built(variant, {})
    assert builder.read
    for name, constants in builder.constants.items():
        for constant, value in constants.items():
            key = f"{name}.{constant}"
            if value is None:
                continue
            override = {key: 0.9 * value or 0.1}
            if key in builder.read:
                assert built(variant, override)[1] != calibrated, key
                continue
            with pytest.raises(ParameterError, match="would change nothing") as caught:
                load_experiment(variant, override)
            offered = str(caught.value).rpartition(": ")[2].split(", ")
            assert set(offered) <= builder.read


@pytest.mark.parametrize("variant", ALL, ids=lambda one: one.name)
def test_each_start_changes_the_scene(variant):
    builder, scene = built(variant, {})
    present = {builder.spec.entry(body.name) for body in scene.bodies}
    for name in present | {body.name for body in scene.deformables}:
        placement = builder.placements[name].model_dump(exclude_none=True)
        for field, value in placement.items():
            moved = {f"{name}.{field}": np.asarray(value) + 0.01}
            assert built(variant, moved)[1] != scene, (name, field)


@pytest.mark.parametrize("variant", ALL, ids=lambda one: one.name)
def test_sets_of_the_file_state_what_is_read(variant):
    for name in task_spec(variant.family).parameters:
        stated = load_experiment(variant, name)
        again = load_experiment(variant, dict(stated.overrides))
        assert again.scene == stated.scene


def test_errors_say_what_would_be_right(approved):
    cases = [
        (SLIDE, {"board.friction": 0.2}),
        (SLIDE, {"board.mass_kg": 0.2}),
        (SLIDE, {"cube.density_kg_per_m3": 700.0}),
        ("CubePush-light", {"cube.velocity_m_per_s": "fast"}),
        ("FoamStretching-soft", {"foam.friction": 0.2}),
        ("Funnel-satin", {"textile.mass_kg": 0.2}),
        ("Funnel-satin", {"air.density": 1.2}),
        ("NewtonsCradle-metal", {"ball-2.restitution": 0.9}),
        (SLIDE, {"cub.friction": 0.3}),
        (SLIDE, {"cube.frction": 0.3}),
        (SLIDE, {"cube.friction": "0.3"}),
        (SLIDE, {"cube.friction": True}),
        (SLIDE, {"cube.friction": None}),
        (SLIDE, {"cube.friction": math.nan}),
        (SLIDE, {"cube.friction": -0.1}),
        (SLIDE, {"cube.position_m": [0.1, 0.2, "0.3"]}),
        (SLIDE, {"cube.position_m": 0.3}),
        (SLIDE, {"cube.velocity_m_per_s": (1.0, 0.0)}),
        (SLIDE, {"board.velocity_m_per_s": (1.0, 0.0, 0.0)}),
        (SLIDE, {"air.density_kg_per_m3": 1.2}),
        (SLIDE, {"scene.gravity_m_per_s2": -9.8}),
        (SLIDE, {"scene.gravity_m_per_s2": "9.8"}),
        (SLIDE, {"scene.gravity": 9.8}),
        (SLIDE, "efective"),
        (SLIDE, 3),
        (SLIDE, None),
        ("TextileFlinging-satin", {"air.density_kg_per_m3": "1.2"}),
        ("TextileBending-rayon", {"textile.velocity_m_per_s": (1.0, 0.0, 0.0)}),
        ("Pendulum-metal", {"ball.velocity_m_per_s": (1.0, 2.0, 3.0)}),
    ]
    lines = []
    for name, parameters in cases:
        with pytest.raises(ParameterError) as caught:
            load_experiment(name, parameters)
        lines.append(str(caught.value))
    approved("experiments/overrides", "\n".join(lines))


def test_numbers_of_numpy_are_numbers():
    stated = {
        "cube.friction": np.float32(0.3),
        "cube.position_m": np.array([0.1, 0.4, 0.36]),
        "cube.velocity_m_per_s": (0.1, 0, 0.2),
    }
    scene = load_experiment(SLIDE, stated).scene
    assert scene.contacts[0].friction == pytest.approx(0.3, rel=1e-7)
    assert scene.body("cube").pose.position_m == (0.1, 0.4, 0.36)
    assert scene.body("cube").linear_velocity_m_per_s == (0.1, 0.0, 0.2)


def test_the_velocity_of_a_pendulum_follows_from_its_angular_velocity():
    axis = np.array(load_experiment("Pendulum-metal").scene.joints[0].axis)
    override = {"ball.angular_velocity_deg_per_s": tuple(90.0 * axis)}
    scene = load_experiment("Pendulum-metal", override).scene
    ball, hinge = scene.body("ball"), scene.joints[0]
    arm_m = np.subtract(ball.pose.position_m, hinge.anchor_m)
    assert ball.linear_velocity_m_per_s == pytest.approx(
        np.cross(0.5 * math.pi * axis, arm_m)
    )


def test_gravity_and_start_change_the_motion():
    """The slide of a sixth of the gravity is a sixth as long; one that starts 10 mm aside stays 10 mm aside."""

    def path_mm(parameters):
        env = GaugeEnv(SLIDE, parameters=parameters)
        env.reset(seed=0)
        for _ in range(env.experiment.frame_count - 1):
            env.step(0)
        return env.trajectory().dense[1]

    calibrated = path_mm("calibrated")
    moon = path_mm({"scene.gravity_m_per_s2": 9.80665 / 6.0})
    slid, slid_on_the_moon = (
        np.linalg.norm(one[-1] - one[0]) for one in (calibrated, moon)
    )
    assert slid_on_the_moon == pytest.approx(slid / 6.0, rel=0.03)
    x, y, z = load_experiment(SLIDE).scene.body("cube").pose.position_m
    beside = path_mm({"cube.position_m": (x, y + 0.01, z)})
    assert beside - calibrated == pytest.approx(
        np.broadcast_to([0.0, 10.0, 0.0], calibrated.shape), abs=0.05
    )


@pytest.mark.parametrize("name", ["mujoco", "pybullet", "rapier"])
def test_engines_fall_with_the_gravity_of_the_scene(name):
    scene = load_experiment(
        "BouncingBall-rubber", {"scene.gravity_m_per_s2": 1.6}
    ).scene
    simulation = backend(name).build(scene)
    simulation.reset()
    start = simulation.body_states(["ball"])[0, 0, 2]
    for _ in range(36):
        simulation.advance(1 / 180)
    fallen = start - simulation.body_states(["ball"])[0, 0, 2]
    simulation.close()
    assert fallen == pytest.approx(0.5 * 1.6 * 0.2**2, rel=0.03)
