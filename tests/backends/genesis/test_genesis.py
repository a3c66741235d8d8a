"""The Genesis backend against closed forms, its repeatability, and what it declines."""

from dataclasses import replace

import numpy as np
import pytest
from rigid import plane_deg, slide, sliding_scene, solid
from scipy.spatial.transform import Rotation

from gauge_envs.errors import (
    BackendError,
    UnsupportedSceneError,
)
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
from gauge_envs.backends.genesis.engine import EngineLease, engine
from gauge_envs.backends.genesis.model import forget_models
from gauge_envs.backends.genesis.settings import PRESETS

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
        lost = 20.0 - simulation.body_states(["ball"])[0, 12]
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
    start = simulation.body_states(["cube"])[0, :3]
    simulation.advance(0.2)
    travelled = np.linalg.norm(simulation.body_states(["cube"])[0, :3] - start)
    simulation.close()
    assert 2.0 * travelled / 0.2**2 == pytest.approx(G / 2.0, rel=5e-3)
    assert not GENESIS.supports(scene).missing
    with pytest.raises(UnsupportedSceneError):
        GENESIS.build(scene, {"preset": "out_of_box"})


def test_out_of_box_has_the_values_of_a_genesis_scene_that_states_nothing():
    simulation = GENESIS.build(sliding_scene(), {"preset": "out_of_box"})
    ours, step_s = (
        simulation._lent.model.solver._options,
        simulation.settings["timestep_s"],
    )
    simulation.close()
    forget_models()
    gs = engine()
    lease = EngineLease(32)
    plain = gs.Scene(show_viewer=False, sim_options=gs.options.SimOptions(dt=step_s))
    plain.add_entity(gs.morphs.Plane())
    plain.add_entity(gs.morphs.Box(size=(0.05, 0.05, 0.05), pos=(0.0, 0.0, 0.025)))
    plain.build()
    default = plain.sim.rigid_solver._options
    names = (
        *(
            "integrator",
            "constraint_solver",
            "iterations",
            "tolerance",
            "ls_iterations",
            "ls_tolerance",
        ),
        *(
            "noslip_iterations",
            "friction_cone",
            "contact_resolution",
            "impratio",
            "contact_pruning_tolerance",
        ),
        *("enable_multi_contact", "box_box_detection", "use_gjk_collision"),
    )
    both = {name: (getattr(ours, name), getattr(default, name)) for name in names}
    # Genesis computes its tolerance, which rounds.
    wrong = {
        name: pair
        for name, pair in both.items()
        if pair[0] != (pytest.approx(pair[1]) if name == "tolerance" else pair[1])
    }
    constants = plain.sim.rigid_solver.geoms[-1].get_sol_params().cpu().numpy().ravel()
    plain.destroy()
    lease.release()
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
    outgoing = simulation.body_states(["ball"])[0, 9]
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
    simulation.drive("plate", plate.pose, velocity, acceleration)
    simulation.advance(1 / 180)
    place = simulation._lent.model.links["plate"]
    coordinates = simulation._lent.model.solver.get_qpos().numpy()[0]
    end = simulation.body_states(["plate"])[0]
    simulation.close()
    reached = coordinates[place.q_start : place.q_start + 7]
    assert reached[:3] == pytest.approx(end[:3], abs=1e-9)
    # Genesis turns a body that nothing touches by the mean of the old and the new rate, which lags by half a step.
    lag = Rotation.from_quat(reached[3:], scalar_first=True).inv() * Rotation.from_quat(
        end[3:7], scalar_first=True
    )
    assert lag.as_rotvec() == pytest.approx([0.0, 0.0, 3.0 / 1800 / 180 / 2], abs=1e-8)
    assert end[0] == pytest.approx(0.1 / 180 + 1 / 180**2)


# --- repeatability ---------------------------------------------------------------------------------------------------


def rollout(simulation, seconds=0.1):
    states = []
    for _ in range(round(seconds * 180)):
        simulation.advance(1 / 180)
        states.append(simulation.body_states(["cube"])[0])
    return np.array(states)


def test_a_model_that_is_used_again_gives_the_same_bits_as_a_new_one():
    scene = sliding_scene()
    moved = replace(
        scene,
        bodies=(
            scene.bodies[0],
            replace(scene.bodies[1], pose=lifted(scene.bodies[1].pose)),
        ),
    )
    forget_models()
    first = GENESIS.build(moved, FAST)
    new = rollout(first)
    built = first._lent.model.scene
    first.close()
    other = GENESIS.build(scene, FAST)
    rollout(other)
    other.close()
    again = GENESIS.build(moved, FAST)
    assert again._lent.model.scene is built
    assert (rollout(again) == new).all()
    again.reset(0)
    assert (rollout(again) == new).all()
    again.close()
    forget_models()


def lifted(pose):
    return replace(
        pose,
        position_m=(pose.position_m[0], pose.position_m[1], pose.position_m[2] + 0.003),
    )


def test_environments_of_one_genesis_scene_have_their_own_starts():
    scene = sliding_scene()
    moved = replace(
        scene,
        bodies=(
            scene.bodies[0],
            replace(scene.bodies[1], pose=lifted(scene.bodies[1].pose)),
        ),
    )
    worlds = GENESIS.build_worlds([scene, moved], FAST)
    assert type(worlds).__name__ == "WorldsGenesis"
    for _ in range(18):
        worlds.advance(1 / 180)
    states = [world.body_states(["cube"])[0] for world in worlds.worlds]
    worlds.close()
    for one, state in zip((scene, moved), states, strict=True):
        simulation = GENESIS.build(one, FAST)
        assert rollout(simulation)[-1].tolist() == state.tolist()
        simulation.close()


def test_a_closed_simulation_is_an_error():
    simulation = GENESIS.build(sliding_scene(), FAST)
    simulation.close()
    simulation.close()
    with pytest.raises(BackendError, match="closed"):
        simulation.advance(1 / 180)


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
