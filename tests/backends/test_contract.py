"""The contract of simulations, once over all installed engines; the conformance checks state the laws."""

import gc
from contextlib import closing

import numpy as np
import pytest
from programs import run_python
from scipy.spatial.transform import Rotation

from gauge_envs import Jitter, load_experiment
from gauge_envs.backends import backend, backend_names
from gauge_envs.backends.registry import backend_class
from gauge_envs.backends.shared import bundled
from gauge_envs.envs.rollout import intervals
from gauge_envs.errors import MissingExtraError
from gauge_envs.registry import is_installed
from gauge_envs.scene import Box, Pose, Scene
from gauge_envs.scene.jitter import perturbed_states
from gauge_envs.scene.prescribed_motion import prescribed_motions
from gauge_envs.tools.bench.parts import body, driven_box

SLIDE = "SlopeSlider-2-wood"
INTERVAL_S = 1 / 180


def scene_for(engine, name, parameters="calibrated"):
    """Return the scene of an experiment; the test is skipped on an engine that does not build it."""
    scene = load_experiment(name, parameters).scene
    if not engine.supports(scene):
        pytest.skip(f"{engine.name} does not build {name}")
    return scene


def everything(simulation, scene):
    """Return all states and nodes of each world, shape [N, number_count]."""
    parts = [simulation.body_states([one.name for one in scene.bodies])]
    parts += [simulation.nodes(one.name) for one in scene.deformables]
    return np.hstack([part.reshape(len(part), -1) for part in parts])


def course(simulation, scene, count):
    """Drive a simulation by its recorded motion; return what it is after each interval, shape [count, N, ...]."""
    worlds = simulation.world_count
    motions = prescribed_motions(scene, 1.0, world_count=worlds)
    actions = [np.zeros((worlds, one.motion_count)) for one in motions]
    return np.array(
        [
            everything(simulation, scene)
            for _ in intervals(simulation, motions, 0, count, actions)
        ]
    )


# --- starts ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("SlopeSlider-3-wood", "calibrated"),
        ("NewtonsCradle-metal", "calibrated"),
        ("CubeToss-acrylic", "calibrated"),
        ("TextileFlinging-satin", "air"),
        ("RotatingBall-satin", "calibrated"),
        ("FoamBending-soft", "calibrated"),
        ("StickStack-soft", "calibrated"),
    ],
)
def test_a_reset_begins_anew(engine, name, parameters):
    scene = scene_for(engine, name, parameters)
    with closing(engine.build(scene)) as simulation:
        start = everything(simulation, scene)
        first = course(simulation, scene, 4)
        assert np.abs(first[-1] - start).max() > 1e-6
        simulation.reset(None, 1)
        np.testing.assert_allclose(everything(simulation, scene), start, atol=1e-9)
        np.testing.assert_allclose(course(simulation, scene, 4), first, atol=1e-9)


def act(simulation, scene):
    """Drive a turntable from where it is, at 1 rad/s and 6 rad/s^2, and push the cube on it."""
    name = scene.drivers[0].body
    pose = simulation.body_states([name])[:, 0, :7]
    rates = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    simulation.drive(name, np.hstack([pose, rates, 6.0 * rates]))
    simulation.apply_wrench("cube", np.array([[0.0, 0.0, 5.0, 0.0, 0.0, 0.0]]))


def test_a_reset_forgets_what_the_next_step_was_told(engine):
    scene = scene_for(engine, "Turntable-2-wood")
    with closing(engine.build(scene)) as fresh, closing(engine.build(scene)) as used:
        act(used, scene)
        used.advance(INTERVAL_S)
        moved = used.body_states([scene.drivers[0].body, "cube"])[0]
        assert moved[0, 12] == pytest.approx(1.0 + 6.0 * INTERVAL_S, abs=2e-3)
        assert moved[1, 9] > 0.01
        act(used, scene)
        for simulation in (fresh, used):
            simulation.reset()
            simulation.advance(INTERVAL_S)
        expected = everything(fresh, scene)
        np.testing.assert_allclose(everything(used, scene), expected, atol=1e-9)


@pytest.mark.parametrize("engine", ["mujoco", "rapier"], indirect=True)
def test_a_reset_clears_a_divergence(engine):
    with closing(engine.build(load_experiment(SLIDE).scene)) as simulation:
        simulation.apply_wrench("cube", np.array([[np.nan, 0, 0, 0, 0, 0]]))
        simulation.advance(INTERVAL_S)
        assert "not finite" in simulation.diverged()[0]
        simulation.reset()
        simulation.advance(INTERVAL_S)
        assert simulation.diverged() == {}
        assert np.isfinite(simulation.body_states(["cube"])).all()


@pytest.mark.parametrize(
    "name",
    [
        "SlopeSlider-3-wood",
        pytest.param("NonsmoothContact-1-wood", marks=pytest.mark.slow),
        "NewtonsCradle-metal",
        pytest.param("Pendulum-metal", marks=pytest.mark.slow),
        "RotatingBall-satin",
    ],
)
def test_worlds_are_single_simulations_of_their_starts(engine, name):
    scene = scene_for(engine, name)
    scatter = Jitter(velocity_m_per_s=0.01, angular_velocity_rad_per_s=0.1)
    starts = np.array([perturbed_states(scene, scatter, seed=seed) for seed in (0, 1)])
    with closing(engine.build_worlds(scene, 2)) as worlds:
        assert worlds.world_count == 2
        worlds.reset(starts[::-1].copy())
        course(worlds, scene, 2)
        worlds.reset(starts)
        together = course(worlds, scene, 4)
    assert np.abs(together[:, 0] - together[:, 1]).max() > 1e-4
    with closing(engine.build(scene)) as single:
        for world in range(2):
            single.reset(starts[world : world + 1])
            alone = course(single, scene, 4)[:, 0]
            np.testing.assert_allclose(together[:, world], alone, atol=1e-9)


# --- driven and pushed bodies ----------------------------------------------------------------------------------------


def test_a_driven_body_starts_where_it_is_put_and_stays_without_a_drive(engine):
    plate = driven_box("plate", (0.0, 0.0, 1.0), (0.2, 0.2, 0.02))
    with closing(engine.build(Scene(bodies=(plate,), duration_s=1.0))) as simulation:
        simulation.advance(INTERVAL_S)
        place = Pose.from_euler_deg((0.1, 0.2, 0.5), (0.0, 40.0, 0.0))
        speed = np.array([0.3, 0.0, 0.0, 0.0, 0.0, 2.0])
        motion = [*place.position_m, *place.quaternion, *speed, *np.zeros(6)]
        simulation.drive("plate", np.array([motion]))
        if engine.name != "newton":  # It is told at its next step.
            state = simulation.body_states(["plate"])[0, 0]
            assert state[:3] == pytest.approx(place.position_m, abs=1e-6)
        simulation.advance(INTERVAL_S)
        state = simulation.body_states(["plate"])[0, 0]
        assert state[:3] == pytest.approx((0.1 + 0.3 / 180, 0.2, 0.5), abs=1e-6)
        # The angular velocity is about the axes of the world.
        turned = Rotation.from_rotvec(speed[3:] * INTERVAL_S) * place.rotation
        found = Rotation.from_quat(state[3:7], scalar_first=True)
        assert (found * turned.inv()).magnitude() < 1e-4


def test_a_wrench_replaces_the_last_one(engine):
    brick = body("box", Box(size_m=(0.1,) * 3), Pose(position_m=(0.0, 0.0, 0.0)))
    scene = Scene(bodies=(brick,), duration_s=1.0, gravity_m_per_s2=0.0)
    inertia = brick.mass_kg * 0.1**2 / 6.0
    with closing(engine.build(scene)) as simulation:
        for wrench in (
            (0.5, 0.0, 0.0, inertia, 0.0, 0.0),
            (0.0, 0.2, 0.0, 0.0, inertia, 0.0),
            (0.0,) * 6,
        ):
            simulation.apply_wrench("box", np.array([wrench]))
            simulation.advance(0.1)
        expected = [0.5, 0.2, 0.0, 0.1, 0.1, 0.0]
        state = simulation.body_states(["box"])[0, 0]
    assert state[7:] == pytest.approx(expected, abs=1e-3)


# --- settings and installation ---------------------------------------------------------------------------------------


OUT_OF_BOX = {
    "preset": "out_of_box",
    "timestep_s": 1 / 900,
    "drive_interval_s": INTERVAL_S,
}


def test_settings_in_force_are_those_of_the_preset(engine):
    scene = scene_for(engine, SLIDE)
    for given in ({}, OUT_OF_BOX):
        resolved = engine.resolved_settings(scene, given)
        assert given.items() <= resolved.items()
        with closing(engine.build(scene, given)) as simulation:
            assert dict(simulation.settings) == dict(resolved)


@pytest.mark.parametrize(
    ("engine", "name", "settings"),
    [
        ("mujoco", "TextileBending-satin", {"preset": "cloth", "solver": "CG"}),
        ("mujoco", "TextileStretching-satin", {"preset": "cloth_probed"}),
        ("mujoco", "TableclothPulling-wood", {"preset": "cloth_loaded"}),
        ("mujoco", "TableclothPulling-wood", {"solver": "Newton"}),
        ("mujoco", "FoamTwisting-soft", {"preset": "soft_driven", "solver": "Newton"}),
        ("mujoco", "WallBreaking-wood", {"preset": "stack"}),
        ("newton", "FoamStretching-soft", {"preset": "soft", "solver": "SolverVBD"}),
        ("newton", "CantileverBeam-soft", {"preset": "soft_row"}),
        ("newton", "CantileverBeam-soft", {"soft_rigid_ratio": 50.0}),
        ("newton", "StickStack-soft", {"preset": "rod", "cell_m": None}),
        ("newton", "TextileFlinging-satin", {"timestep_s": 1 / 1440}),
        # A stiff fabric gets half the step.
        ("newton", "TextileFlinging-nylon", {"timestep_s": 1 / 2880}),
        ("physx", "BouncingBall-rubber", {"preset": "default"}),
        ("physx", "WallBreaking-wood", {"preset": "stack", "timestep_s": 1 / 900}),
        ("pybullet", "SlopeSlider-1-wood", {"preset": "contact"}),
        ("pybullet", "Pendulum-metal", {"preset": "contact"}),
        ("pybullet", "NewtonsCradle-metal", {"preset": "joint_impact"}),
        ("pybullet", "RopeWinding-rubber", {"preset": "rope"}),
        # A pressure wave of 87 m/s takes 136 us through a tetrahedron of 16.7 mm / sqrt(2).
        ("pybullet", "FoamStretching-soft", {"preset": "soft"}),
        ("pybullet", "FoamStretching-soft", {"timestep_s": 1 / 18000}),
        ("pybullet", "WallBreaking-wood", {"preset": "stack"}),
        ("drake", SLIDE, {"preset": "default"}),
        ("drake", "BouncingBall-rubber", {"preset": "impact"}),
        ("drake", "NewtonsCradle-metal", {"preset": "impact_chain"}),
        ("drake", "Pendulum-metal", {"preset": "contact_free"}),
        ("drake", "WallBreaking-wood", {"preset": "stack"}),
        ("drake", "CubeToss-acrylic", {"preset": "corners"}),
        ("genesis", SLIDE, {"preset": "default"}),
        ("genesis", "BouncingBall-rubber", {"preset": "impact"}),
        ("genesis", "Pendulum-metal", {"preset": "contact_free"}),
        ("genesis", "WallBreaking-wood", {"preset": "stack"}),
    ],
    indirect=["engine"],
)
def test_the_contents_of_a_scene_choose_its_settings(engine, name, settings):
    resolved = engine.resolved_settings(load_experiment(name).scene)
    assert settings.items() <= resolved.items()


PROGRAM = """
import sys
from gauge_envs import load_experiment
from gauge_envs.backends import backend
for name in sys.argv[1:]:
    engine = backend(name)
    print(*sorted(set(engine.modules) & set(sys.modules)))
    scene = load_experiment("NonsmoothContact-1-wood").scene
    simulation = engine.build(scene)
    simulation.reset()
    simulation.advance(0.1)
    print(simulation.body_states([one.name for one in scene.bodies]).tobytes().hex())
    simulation.close()
"""
LOGGING = {"genesis", "newton"}
"""Engines that log to stderr."""


def of_another_process(names):
    """Check the bits of engines in one process that starts from nothing; return what it wrote to stderr."""
    scene = load_experiment("NonsmoothContact-1-wood").scene
    expected = ""
    for name in names:
        with closing(backend(name).build(scene)) as simulation:
            simulation.reset()
            simulation.advance(0.1)
            expected += f"\n{everything(simulation, scene).tobytes().hex()}\n"
    run = run_python("-c", PROGRAM, *names)
    # An engine is imported at its first build.
    assert run.stdout == expected, run.stderr
    return run.stderr


def test_another_process_gives_the_same_bits_and_prints_nothing():
    names = [
        name
        for name in backend_names()
        if name not in LOGGING and all(map(is_installed, backend_class(name).modules))
    ]
    assert of_another_process(names) == ""


@pytest.mark.slow
@pytest.mark.parametrize("engine", sorted(LOGGING), indirect=True)
def test_another_process_gives_the_same_bits_of_an_engine_that_logs(engine):
    of_another_process([engine.name])


@pytest.mark.parametrize("name", backend_names())
def test_a_missing_engine_names_its_extra(name, monkeypatch):
    kind = backend_class(name)
    if not kind.modules:
        pytest.skip("the package needs this engine")
    monkeypatch.setattr(bundled, "is_installed", lambda module: False)
    with pytest.raises(MissingExtraError, match=rf"'gauge-envs\[{name}\]'"):
        kind()


def test_a_folder_with_the_name_of_an_engine_is_no_engine(monkeypatch, tmp_path):
    (tmp_path / "engine_of_a_checkout").mkdir()
    (tmp_path / "engine_of_a_package").mkdir()
    (tmp_path / "engine_of_a_package" / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    assert not is_installed("engine_of_a_checkout")
    assert not is_installed("engine_of_nobody")
    assert is_installed("engine_of_a_package")


@pytest.mark.slow
@pytest.mark.parametrize("is_closed", [True, False])
def test_simulations_that_nobody_uses_free_their_memory(engine, is_closed):
    resource = pytest.importorskip("resource")
    scene = load_experiment(SLIDE).scene

    def largest_mb(count):
        for index in range(count):
            simulation = engine.build(scene)
            simulation.advance(INTERVAL_S)
            simulation.reset()
            if is_closed:
                simulation.close()
                simulation.close()
            # Drake's objects refer to each other, and Python collects them by their number, not by their size.
            if index % 25 == 24:
                gc.collect()
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

    before = largest_mb(50)
    assert largest_mb(150) - before < 10.0
