"""The Genesis backend against closed forms, its starts and worlds, and what it declines."""

from dataclasses import replace

import numpy as np
import pytest
from rigid import plane_deg, slide, sliding_scene, solid
from scipy.spatial.transform import Rotation

from gauge_envs.errors import BackendError, UnsupportedSceneError
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Box,
    Contact,
    ContactMode,
    Cylinder,
    Motion,
    Scene,
    Sphere,
)

pytest.importorskip("genesis", reason="extra 'genesis' is not installed")

from gauge_envs.backends import backend
from gauge_envs.backends.genesis.document import CONTACT_LIMIT, damping_ratio
from gauge_envs.backends.genesis.engine import claim, engine, release
from gauge_envs.backends.genesis.settings import PRESETS
from gauge_envs.scene.states import nominal_states, row_of

GENESIS = backend("genesis")
G = GRAVITY_M_PER_S2
FAST = {"timestep_s": 1 / 1800}


GROUND = plane_deg()


def touching(first, second, friction=0.3, **changes):
    return Contact(
        **{
            "first": (first,),
            "second": (second,),
            "friction": friction,
            "restitution": 0.0,
        }
        | changes
    )


# --- friction --------------------------------------------------------------------------------------------------------


def test_signorini_contacts_slide_by_coulombs_law():
    ratio, rise_m = slide(GENESIS, 0.3, **FAST)
    assert ratio == pytest.approx(1.0, abs=1e-4)
    assert rise_m < 1e-6


def test_convex_contacts_lift_a_sliding_box():
    ratio, rise_m = slide(GENESIS, 0.3, **FAST, contact_resolution="convex")
    assert 1e-3 < ratio - 1.0 < 1e-2
    assert rise_m > 1e-4


def test_torsional_friction_does_not_depend_on_earlier_scenes():
    """A ball of 30 mm that spins loses 5/2 g arm / r^2 in 1 s, also after scenes with the same geoms and other arms."""
    ball = solid(
        "ball",
        Sphere(radius_m=0.03),
        (0.0, 0.0, 0.03),
        angular_velocity_rad_per_s=(0.0, 0.0, 20.0),
    )
    for arm_m in (0.0, 2e-4, 4e-4):
        touch = touching("ball", "ground", torsion_m=arm_m)
        simulation = GENESIS.build(
            Scene(bodies=(GROUND, ball), contacts=(touch,), duration_s=1.0), FAST
        )
        simulation.advance(36 / 180)
        lost = 20.0 - simulation.body_states(["ball"])[0, 0, 12]
        simulation.close()
        assert lost == pytest.approx(0.2 * 2.5 * G * arm_m / 0.03**2, rel=0.01)


@pytest.mark.parametrize("friction", [0.0, 0.0099, 5.1])
def test_friction_that_genesis_would_change_is_declined(friction):
    bodies = (*sliding_scene().bodies, GROUND)
    contacts = (touching("cube", "board", friction), touching("cube", "ground", 0.3))
    scene = replace(sliding_scene(), bodies=bodies, contacts=contacts)
    (reason,) = GENESIS.supports(scene).missing
    assert "raises the friction of each contact to 0.01" in reason
    with pytest.raises(UnsupportedSceneError, match="'cube' and 'board'"):
        GENESIS.build(scene)


def test_a_scene_whose_contacts_all_lack_friction_has_none():
    scene = replace(sliding_scene(), contacts=(touching("cube", "board", 0.0),))
    simulation = GENESIS.build(scene, FAST)
    assert simulation.settings["impratio"] == 1e-9
    start = simulation.body_states(["cube"])[0, 0, :3]
    simulation.advance(0.2)
    travelled = np.linalg.norm(simulation.body_states(["cube"])[0, 0, :3] - start)
    simulation.close()
    assert 2.0 * travelled / 0.2**2 == pytest.approx(G / 2.0, rel=5e-3)
    assert not GENESIS.supports(scene).missing
    with pytest.raises(UnsupportedSceneError):
        GENESIS.build(scene, {"preset": "out_of_box"})


def test_out_of_box_has_the_values_of_a_genesis_scene_that_states_nothing():
    simulation = GENESIS.build(sliding_scene(), {"preset": "out_of_box"})
    ours, step_s = simulation._solver._options, simulation.settings["timestep_s"]
    simulation.close()
    gs = engine()
    claim(gs, 32)
    plain = gs.Scene(show_viewer=False, sim_options=gs.options.SimOptions(dt=step_s))
    plain.add_entity(gs.morphs.Plane())
    plain.add_entity(gs.morphs.Box(size=(0.05, 0.05, 0.05), pos=(0.0, 0.0, 0.025)))
    plain.build()
    default = plain.sim.rigid_solver._options
    names = [
        *("integrator", "constraint_solver", "iterations", "tolerance"),
        *("ls_iterations", "ls_tolerance", "noslip_iterations", "friction_cone"),
        *("contact_resolution", "impratio", "contact_pruning_tolerance"),
        *("enable_multi_contact", "box_box_detection", "use_gjk_collision"),
    ]
    both = {name: (getattr(ours, name), getattr(default, name)) for name in names}
    # Genesis computes its tolerance, which rounds.
    wrong = {
        name: pair
        for name, pair in both.items()
        if pair[0] != (pytest.approx(pair[1]) if name == "tolerance" else pair[1])
    }
    constants = plain.sim.rigid_solver.geoms[-1].get_sol_params().cpu().numpy().ravel()
    plain.destroy()
    release(gs)
    assert wrong == {}
    preset = PRESETS["out_of_box"]
    solref = (
        preset.sustained_timeconst_s,
        preset.sustained_dampratio,
        *preset.sustained_impedance,
    )
    assert constants[:5] == pytest.approx(solref, rel=1e-5)


# --- impacts ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("restitution", [0.2, 0.577, 0.95])
def test_the_damping_ratio_is_that_of_a_spring_that_only_pushes(restitution):
    # Continuous time: exp(-z / sqrt(1 - z^2) * (angle at which the force vanishes)).
    ratio = damping_ratio(restitution, 2000)
    root = np.sqrt(1.0 - ratio**2)
    ending = np.arctan2(2.0 * ratio * root, 2.0 * ratio**2 - 1.0)
    assert np.exp(-ratio / root * ending) == pytest.approx(restitution, abs=2e-3)


def test_impacts_without_the_recipe_have_no_restitution():
    ball = solid(
        "ball",
        Sphere(radius_m=0.03),
        (0.0, 0.0, 0.13),
        linear_velocity_m_per_s=(0.0, 0.0, -2.0),
    )
    contact = touching("ball", "ground", 0.5, restitution=0.9, mode=ContactMode.IMPACT)
    scene = Scene(bodies=(GROUND, ball), contacts=(contact,), duration_s=0.2)
    simulation = GENESIS.build(scene, {"impact_steps": None})
    simulation.advance(18 / 180)
    outgoing = simulation.body_states(["ball"])[0, 0, 9]
    simulation.close()
    assert outgoing < 0.3


# --- driven bodies and joints ----------------------------------------------------------------------------------------


def test_the_engine_takes_a_driven_body_to_the_end_of_its_interval():
    plate = solid(
        "plate", Box(size_m=(0.5, 0.3, 0.02)), (0.0, 0.0, 0.5), motion=Motion.KINEMATIC
    )
    simulation = GENESIS.build(Scene(bodies=(plate,), duration_s=1.0), FAST)
    velocity, acceleration = (
        np.array([0.1, 0, 0, 0, 0, 1.0]),
        np.array([2.0, 0, -1.0, 0, 0, 3.0]),
    )
    start = nominal_states(Scene(bodies=(plate,), duration_s=1.0))[0, :7]
    simulation.drive("plate", np.hstack([start, velocity, acceleration])[None])
    simulation.advance(1 / 180)
    place = simulation._links["plate"]
    coordinates = simulation._solver.get_qpos().numpy()[0]
    end = simulation.body_states(["plate"])[0, 0]
    simulation.close()
    reached = coordinates[place.q_start : place.q_start + 7]
    assert reached[:3] == pytest.approx(end[:3], abs=1e-9)
    # Genesis turns a body that nothing touches by the mean of the old and the new rate, which lags by half a step.
    lag = Rotation.from_quat(reached[3:], scalar_first=True).inv() * Rotation.from_quat(
        end[3:7], scalar_first=True
    )
    assert lag.as_rotvec() == pytest.approx([0.0, 0.0, 3.0 / 1800 / 180 / 2], abs=1e-8)
    assert end[0] == pytest.approx(0.1 / 180 + 1 / 180**2)


# --- starts and worlds -----------------------------------------------------------------------------------------------


def rollout(simulation, count=18):
    """States of the cube in each world, shape [count, N, 13]."""
    states = []
    for _ in range(count):
        simulation.advance(1 / 180)
        states.append(simulation.body_states(["cube"])[:, 0])
    return np.array(states)


def lifted_starts(scene, world_count):
    """Starts of worlds whose cube is 3 mm higher in each than in the one before."""
    starts = np.tile(nominal_states(scene), (world_count, 1, 1))
    starts[:, row_of(scene, "cube"), 2] += 0.003 * np.arange(world_count)
    return starts


def test_a_reset_forgets_contacts_wrenches_and_other_starts():
    scene = sliding_scene()
    simulation = GENESIS.build(scene, FAST)
    new = rollout(simulation)
    simulation.reset(lifted_starts(scene, 2)[1:])
    simulation.apply_wrench("cube", np.full((1, 6), 0.1))
    assert np.abs(rollout(simulation) - new).max() > 1e-3
    simulation.reset()
    again = rollout(simulation)
    simulation.close()
    assert (again == new).all()


def test_worlds_have_their_own_starts_and_wrenches():
    scene = sliding_scene()
    starts, wrenches = lifted_starts(scene, 3), np.zeros((3, 6))
    wrenches[2, 1] = 0.1
    together = GENESIS.build_worlds(scene, 3, FAST)
    together.reset(starts)
    together.apply_wrench("cube", wrenches)
    states = rollout(together)
    together.close()
    alone = GENESIS.build(scene, FAST)
    for world in range(3):
        alone.reset(starts[world : world + 1])
        alone.apply_wrench("cube", wrenches[world : world + 1])
        assert rollout(alone)[:, 0] == pytest.approx(states[:, world], abs=1e-9)
    alone.close()


def test_a_world_that_genesis_gives_up_leaves_the_others():
    scene = sliding_scene()
    simulation = GENESIS.build_worlds(scene, 2, FAST)
    expected = rollout(simulation)[:, 0]
    simulation.reset()
    simulation.apply_wrench("cube", np.array([[0.0] * 6, [np.nan] * 6]))
    found = rollout(simulation)[:, 0]
    diverged = simulation.diverged()
    simulation.reset()
    assert simulation.diverged() == {}
    simulation.close()
    assert found == pytest.approx(expected, abs=1e-9)
    assert set(diverged) == {1}
    assert "Genesis stopped" in diverged[1]


# --- settings and support --------------------------------------------------------------------------------------------


def test_the_other_precision_is_an_error_while_a_simulation_lives():
    simulation = GENESIS.build(sliding_scene(), FAST)
    with pytest.raises(BackendError, match="one precision per process"):
        GENESIS.build(sliding_scene(), FAST | {"precision": 32})
    simulation.close()


def test_what_genesis_lacks_is_declined():
    cube = solid("cube", Box(size_m=(0.05, 0.05, 0.05)))
    names = [f"can-{number}" for number in range(CONTACT_LIMIT + 1)]
    cans = tuple(solid(name, Cylinder(radius_m=0.03, length_m=0.1)) for name in names)
    contacts = tuple(touching(name, "ground") for name in names)
    (reason,) = GENESIS.supports(
        Scene(bodies=(GROUND, *cans), contacts=contacts, duration_s=1.0)
    ).missing
    assert str(CONTACT_LIMIT) in reason
    bouncy = touching("cube", "ground", restitution=1.1, mode=ContactMode.IMPACT)
    (reason,) = GENESIS.supports(
        Scene(bodies=(GROUND, cube), contacts=(bouncy,), duration_s=1.0)
    ).missing
    assert "1.1" in reason
