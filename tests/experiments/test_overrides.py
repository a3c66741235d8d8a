"""Every override changes the scene, or is refused in words that name what does."""

import numpy as np
import pytest

from gauge_envs import GaugeEnv, beyond_variants, load_experiment, variants
from gauge_envs.backends.registry import backend
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.scene_builder import SceneBuilder
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.variants import task_path
from gauge_envs.scene import Motion, Scene

ALL = (*variants(), *beyond_variants())
SLIDE = "SlopeSlider-2-wood"


def builder_of(variant) -> SceneBuilder:
    return SceneBuilder(
        task_path(variant.family), task_spec(variant.family), variant, {}
    )


def unlike(value):
    """Another value in range."""
    return 0.9 * value or 0.1


def read_parts(scene: Scene) -> tuple:
    """What motion depends on: all but the masses of bodies that forces do not move."""
    bodies = [
        (body.pose, body.mass_kg, body.inertia_kg_m2, body.linear_velocity_m_per_s)
        if body.motion is Motion.DYNAMIC
        else body.pose
        for body in scene.bodies
    ]
    contacts = [one for one in scene.contacts if one.first and one.second]
    fabrics = [
        {name: value for name, value in vars(one).items() if name != "mass_kg"}
        if hasattr(one, "areal_density_kg_per_m2")
        else one
        for one in scene.deformables
    ]
    return bodies, contacts, fabrics, scene.joints


@pytest.mark.parametrize("variant", ALL, ids=lambda one: one.name)
def test_each_constant_changes_the_scene_or_is_refused(variant):
    builder = builder_of(variant)
    calibrated = read_parts(load_experiment(variant).scene)
    calibrated_without_trial = read_parts(builder.build())
    stated = {
        f"{name}.{constant}": value
        for name, constants in builder.constants.items()
        for constant, value in constants.items()
        if value is not None
    }
    assert stated
    for key, value in stated.items():
        override = {key: unlike(value)}
        if key in builder.constants_read:
            changed = load_experiment(variant, override)
            assert read_parts(changed.scene) != calibrated, key
            continue
        with pytest.raises(ParameterError, match="would change nothing") as caught:
            load_experiment(variant, override)
        # What the refusal offers is itself an override that is read.
        _, offers, offered = str(caught.value).rpartition("Override '")
        assert not offers or offered.rstrip("'") in builder.constants_read
        # And it is right: without the check, the scene stays.
        unchecked = SceneBuilder(builder.path, builder.spec, variant, override)
        assert read_parts(unchecked.build()) == calibrated_without_trial


@pytest.mark.parametrize("variant", ALL, ids=lambda one: one.name)
def test_each_start_changes_the_scene_or_is_refused(variant):
    builder = builder_of(variant)
    scene = builder.build()
    for name, placement in builder.placements.items():
        if name not in builder.present:
            continue
        for field, value in placement.model_dump(exclude_none=True).items():
            moved = (np.asarray(value) + 0.01).tolist()
            changed = SceneBuilder(
                builder.path, builder.spec, variant, {f"{name}.{field}": moved}
            )
            assert changed.build() != scene, (name, field)


@pytest.mark.parametrize("variant", ALL, ids=lambda one: one.name)
def test_sets_of_the_file_state_what_is_read(variant):
    builder = builder_of(variant)
    for name in builder.spec.parameters:
        stated = load_experiment(variant, name).overrides
        again = load_experiment(variant, dict(stated))
        assert again.scene == load_experiment(variant, name).scene


def test_refusals_name_what_is_read(approved):
    cases = [
        (SLIDE, {"board.friction": 0.2}),
        (SLIDE, {"board.mass_kg": 0.2}),
        (SLIDE, {"cube.density_kg_per_m3": 700.0}),
        ("CubePush-light", {"cube.velocity_m_per_s": "fast"}),
        ("FoamStretching-soft", {"foam.friction": 0.2}),
        ("Funnel-satin", {"textile.mass_kg": 0.2}),
        ("NewtonsCradle-metal", {"ball-2.restitution": 0.9}),
        (SLIDE, {"cube.friction": "0.3"}),
        (SLIDE, {"cube.friction": True}),
        (SLIDE, {"cube.friction": None}),
        (SLIDE, {"cube.position_m": [0.1, 0.2, "0.3"]}),
        (SLIDE, {"cube.position_m": 0.3}),
        (SLIDE, {"scene.gravity_m_per_s2": -9.8}),
        (SLIDE, {"scene.gravity_m_per_s2": "9.8"}),
        (SLIDE, {"scene.gravity": 9.8}),
        (SLIDE, 3),
        (SLIDE, None),
        ("TextileFlinging-satin", {"air.density_kg_per_m3": "1.2"}),
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
    }
    found = load_experiment(SLIDE, stated)
    assert found.scene.contacts[0].friction == pytest.approx(0.3, rel=1e-7)
    assert found.scene.body("cube").pose.position_m == (0.1, 0.4, 0.36)


def test_gravity_and_start_change_the_motion():
    """The slide of a sixth of the gravity is a sixth as long; one that starts 10 mm higher stays 10 mm higher."""

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
    engine = backend(name)
    scene = load_experiment(
        "BouncingBall-rubber", {"scene.gravity_m_per_s2": 1.6}
    ).scene
    simulation = engine.build(scene)
    simulation.reset()
    start = simulation.body_states(["ball"])[0, 0, 2]
    for _ in range(36):
        simulation.advance(1 / 180)
    fallen = start - simulation.body_states(["ball"])[0, 0, 2]
    simulation.close()
    assert fallen == pytest.approx(0.5 * 1.6 * 0.2**2, rel=0.03)
