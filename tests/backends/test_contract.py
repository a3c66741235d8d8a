"""The contract of simulations on all installed engines; the conformance checks have the laws.

A reset restores the start, and worlds are independent. Driven bodies follow closed forms. The contents of a scene
choose the preset of its settings.
"""

import gc
from contextlib import closing

import numpy as np
import pytest
from programs import run_python
from rigid import target
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.backends import backend_names
from gauge_envs.backends.registry import backend_class
from gauge_envs.backends.shared import bundled
from gauge_envs.envs.rollout import simulate
from gauge_envs.errors import MissingExtraError
from gauge_envs.fixtures.parts import driven_box
from gauge_envs.registry import is_installed
from gauge_envs.scene import Pose, Scene
from gauge_envs.scene.prescribed_motion import prescribed_motions

SLIDE = "SlopeSlider-2-wood"
INTERVAL_S = 1 / 180


def scene_for(engine, name, parameters="published"):
    """Return the scene of an experiment; the test is skipped on an engine that does not build it."""
    scene = load_experiment(name, parameters).scene
    if not engine.supports(scene):
        pytest.skip(f"{engine.name} does not build {name}")
    return scene


def everything(simulation, scene):
    """Return all states and nodes of each world, shape [N, number_count]."""
    parts = [simulation.body_states([body.name for body in scene.bodies])]
    parts += [simulation.nodes(body.name) for body in scene.deformables]
    return np.hstack([part.reshape(len(part), -1) for part in parts])


def course(simulation, scene, count):
    """Drive a simulation by its recorded motion; return its states after each interval, shape [count, N, ...]."""
    worlds = simulation.world_count
    motions = prescribed_motions(scene, 1.0, world_count=worlds)
    actions = [np.zeros((worlds, motion.motion_count)) for motion in motions]
    states = []

    def observe(_):
        states.append(everything(simulation, scene))

    simulate(simulation, motions, 0, count, actions, observers=[observe])
    return np.array(states)


# --- resets and worlds -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("NewtonsCradle-metal", "published"),
        ("TextileFlinging-satin", "air"),
        ("FoamBending-soft", "published"),
        ("StickStack-soft", "published"),
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


# --- driven bodies ---------------------------------------------------------------------------------------------------


def test_a_driven_body_accelerates_about_the_axes_of_the_world(engine):
    """In t it moves by v t + a t^2 / 2, and turns by the rotation vector of the same form; without a drive it stays."""
    plate = driven_box("plate", (0.0, 0.0, 1.0), (0.2, 0.2, 0.02))
    start = Pose.from_euler_deg((0.1, 0.2, 0.5), (0.0, 40.0, 0.0))
    velocity = np.array([0.3, 0.0, 0.0, 0.0, 0.0, 2.0])
    acceleration = np.array([0.0, 9.0, 0.0, 0.0, 0.0, 36.0])
    with closing(engine.build(Scene(bodies=(plate,), duration_s=1.0))) as simulation:
        simulation.advance(INTERVAL_S)
        state = simulation.body_states(["plate"])[0, 0]
        assert state[:3] == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)
        simulation.drive("plate", target(start, velocity, acceleration))
        simulation.advance(INTERVAL_S)
        state = simulation.body_states(["plate"])[0, 0]
    moved = velocity * INTERVAL_S + 0.5 * acceleration * INTERVAL_S**2
    assert state[:3] == pytest.approx(start.position_m + moved[:3], abs=1e-6)
    turned = Rotation.from_rotvec(moved[3:]) * start.rotation
    rotation = Rotation.from_quat(state[3:7], scalar_first=True)
    assert (rotation * turned.inv()).magnitude() < 1e-4


# --- settings --------------------------------------------------------------------------------------------------------


def test_a_simulation_has_the_settings_that_were_resolved(engine):
    scene = scene_for(engine, SLIDE)
    coarse = {
        "preset": "out_of_box",
        "timestep_s": 1 / 900,
        "drive_interval_s": INTERVAL_S,
    }
    for changes in ({}, coarse):
        resolved = engine.resolved_settings(scene, changes)
        assert changes.items() <= resolved.items()
        with closing(engine.build(scene, changes)) as simulation:
            assert dict(simulation.settings) == dict(resolved)


@pytest.mark.parametrize(
    ("engine", "name", "settings"),
    [
        ("mujoco", "TextileBending-satin", {"preset": "cloth", "solver": "CG"}),
        ("mujoco", "TextileStretching-satin", {"preset": "cloth_probed"}),
        ("mujoco", "TableclothPulling-wood", {"preset": "cloth_loaded"}),
        ("mujoco", "FoamTwisting-soft", {"preset": "soft_driven", "solver": "Newton"}),
        ("mujoco", "WallBreaking-wood", {"preset": "stack"}),
        ("newton", "FoamStretching-soft", {"preset": "soft", "solver": "SolverVBD"}),
        ("newton", "CantileverBeam-soft", {"preset": "soft_row"}),
        ("newton", "TextileFlinging-satin", {"timestep_s": 1 / 1440}),
        # A stiff fabric gets half the step.
        ("newton", "TextileFlinging-nylon", {"timestep_s": 1 / 2880}),
        ("physx", "WallBreaking-wood", {"preset": "stack", "timestep_s": 1 / 900}),
        ("pybullet", "Pendulum-metal", {"preset": "contact"}),
        ("pybullet", "NewtonsCradle-metal", {"preset": "joint_impact"}),
        # A pressure wave of 87 m/s takes 136 us through a tetrahedron of 16.7 mm / sqrt(2).
        ("pybullet", "FoamStretching-soft", {"timestep_s": 1 / 18000}),
        ("drake", "NewtonsCradle-metal", {"preset": "impact_chain"}),
        ("drake", "CubeToss-acrylic", {"preset": "corners"}),
        ("genesis", "BouncingBall-rubber", {"preset": "impact"}),
        ("genesis", "WallBreaking-wood", {"preset": "stack"}),
    ],
    indirect=["engine"],
)
def test_the_contents_of_a_scene_choose_its_settings(engine, name, settings):
    resolved = engine.resolved_settings(load_experiment(name).scene)
    assert settings.items() <= resolved.items()


@pytest.mark.parametrize(
    ("name", "frames", "limit_mm"),
    [
        # The cloth is accelerated through 1 cm; cells twice as wide move its hem late.
        ("TextileFlinging-satin", 12, 1.0),
        # The slide starts within a step of 0.56 ms, at 3.5 m/s^2 after 0.4 s: 0.8 mm.
        ("SlopeSlider-2-wood", 12, 0.8),
    ],
)
def test_a_trajectory_for_training_is_near(name, frames, limit_mm, rollout):
    paths_mm = []
    for settings in ({}, {"preset": "training"}):
        env, trajectory, _ = rollout(
            name, frames=frames, settings=settings, marker_proxy="material"
        )
        env.close()
        bodies_m = trajectory.bodies[..., :3]
        paths_mm.append(1e3 * (bodies_m if bodies_m.size else trajectory.markers_m))
    apart_mm = np.linalg.norm(paths_mm[1] - paths_mm[0], axis=-1)
    assert 0.0 < apart_mm.max() < limit_mm
    assert np.ptp(paths_mm[0], axis=0).max() > 3.0 * limit_mm


# --- installation ----------------------------------------------------------------------------------------------------

PROGRAM = """
import sys
from gauge_envs import load_experiment
from gauge_envs.backends import backend
for name in sys.argv[1:]:
    engine = backend(name)
    print(*sorted(set(engine.modules) & set(sys.modules)))
    simulation = engine.build(load_experiment("NonsmoothContact-1-wood").scene)
    simulation.advance(0.1)
    simulation.close()
"""


def test_an_engine_is_imported_at_its_first_build_and_prints_nothing():
    """Genesis and Newton log to stderr."""
    names = [
        name
        for name in backend_names()
        if name not in ("genesis", "newton")
        and all(map(is_installed, backend_class(name).modules))
    ]
    run = run_python("-c", PROGRAM, *names)
    assert (run.stdout, run.stderr) == ("\n" * len(names), "")


@pytest.mark.parametrize("name", backend_names())
def test_a_missing_engine_names_its_extra(name, monkeypatch):
    kind = backend_class(name)
    if not kind.modules:
        pytest.skip("the package needs this engine")
    monkeypatch.setattr(bundled, "is_installed", lambda module: False)
    with pytest.raises(MissingExtraError, match=rf"pip install .*\[{name}\]'"):
        kind()


def test_a_folder_with_the_name_of_an_engine_is_not_an_engine(monkeypatch, tmp_path):
    (tmp_path / "engine_of_a_checkout").mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    assert not is_installed("engine_of_a_checkout")


@pytest.mark.slow
@pytest.mark.parametrize("is_closed", [True, False])
def test_simulations_that_nobody_uses_free_their_memory(engine, is_closed):
    resource = pytest.importorskip("resource")
    scene = load_experiment(SLIDE).scene

    def peak_mb(count):
        for index in range(count):
            simulation = engine.build(scene)
            simulation.advance(INTERVAL_S)
            if is_closed:
                simulation.close()
                simulation.close()
            # Drake's objects refer to each other, and Python collects them by their number, not by their size.
            if index % 25 == 24:
                gc.collect()
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

    before_mb = peak_mb(50)
    assert peak_mb(150) - before_mb < 10.0
