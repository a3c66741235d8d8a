"""Traps of Genesis with rigid bodies: friction that it changes, contact laws, worlds that it stops, precision.

Expected values follow from Coulomb's law, a spring that only pushes, and Genesis's own objects.
"""

from dataclasses import replace

import numpy as np
import pytest
from rigid import plane_deg, scene_of, slide, sliding_scene, solid, states, target
from scipy.spatial.transform import Rotation

from gauge_envs.backends import backend
from gauge_envs.errors import BackendError, UnsupportedSceneError
from gauge_envs.fixtures.parts import contact
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Box,
    Capsule,
    Compound,
    Cylinder,
    Ellipsoid,
    Motion,
    Part,
    Pose,
    Sphere,
)

pytest.importorskip("genesis.version", reason="extra 'genesis' is not installed")

from gauge_envs.backends.genesis.document import CONTACT_LIMIT, damping_ratio
from gauge_envs.backends.genesis.engine import claim, engine, release
from gauge_envs.backends.genesis.settings import PRESETS

GENESIS = backend("genesis")
G = GRAVITY_M_PER_S2
FAST = {"timestep_s": 1 / 1800}
GROUND = plane_deg()


# --- friction and impacts --------------------------------------------------------------------------------------------


def test_convex_contacts_lift_a_sliding_box_and_signorini_contacts_do_not():
    ratio, rise_m = slide(GENESIS, 0.3, **FAST)
    assert ratio == pytest.approx(1.0, abs=1e-4)
    assert rise_m < 1e-6
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
        touch = replace(contact("ball", "ground", friction=0.3), torsion_m=arm_m)
        scene = scene_of(GROUND, ball, contacts=(touch,))
        rows = states(GENESIS, scene, ["ball"], 0.2, **FAST)
        lost = 20.0 - rows[-1, 0, 12]
        expected = 0.2 * 2.5 * G * arm_m / 0.03**2
        assert lost == pytest.approx(expected, rel=0.01, abs=1e-6)


@pytest.mark.parametrize("friction", [0.0099, 5.1])
def test_friction_that_genesis_would_change_is_unsupported(friction):
    contacts = (
        contact("cube", "board", friction=friction),
        contact("cube", "ground", friction=0.3),
    )
    slope = sliding_scene()
    scene = replace(slope, bodies=(*slope.bodies, GROUND), contacts=contacts)
    (reason,) = GENESIS.supports(scene).missing
    assert "raises the friction of each contact to 0.01" in reason
    with pytest.raises(UnsupportedSceneError, match="'cube' and 'board'"):
        GENESIS.build(scene)


def test_a_scene_without_friction_has_no_friction_in_genesis():
    touch = contact("cube", "board", friction=0.0)
    scene = replace(sliding_scene(), contacts=(touch,))
    places_m = states(GENESIS, scene, ["cube"], 0.2, **FAST)[:, 0, :3]
    travelled_m = np.linalg.norm(places_m[-1] - places_m[0])
    assert 2.0 * travelled_m / 0.2**2 == pytest.approx(G / 2.0, rel=5e-3)
    with pytest.raises(UnsupportedSceneError):
        GENESIS.build(scene, {"preset": "out_of_box"})


@pytest.mark.parametrize("restitution", [0.2, 0.577, 0.95])
def test_the_damping_ratio_fits_a_spring_that_only_pushes(restitution):
    """In continuous time: exp(-z / sqrt(1 - z^2) times the angle at which the force vanishes)."""
    ratio = damping_ratio(restitution, 2000)
    root = np.sqrt(1.0 - ratio**2)
    end_rad = np.arctan2(2.0 * ratio * root, 2.0 * ratio**2 - 1.0)
    assert np.exp(-ratio / root * end_rad) == pytest.approx(restitution, abs=2e-3)


def test_more_contacts_than_genesis_holds_are_unsupported():
    can = Cylinder(radius_m=0.03, length_m=0.1)
    names = [f"can-{number}" for number in range(CONTACT_LIMIT + 1)]
    cans = (solid(name, can) for name in names)
    contacts = tuple(contact(name, "ground", friction=0.3) for name in names)
    (reason,) = GENESIS.supports(scene_of(GROUND, *cans, contacts=contacts)).missing
    assert str(CONTACT_LIMIT) in reason


# --- driven bodies and worlds ----------------------------------------------------------------------------------------


def test_the_parts_of_a_compound_have_contacts():
    """A lying capsule and an ellipsoid, 0.1 m apart, rest at half their heights."""
    parts = (
        Part(
            shape=Capsule(radius_m=0.02, length_m=0.06),
            pose=Pose.from_euler_deg((0.1, 0.0, 0.0), (90.0, 0.0, 0.0)),
        ),
        Part(
            shape=Ellipsoid(radii_m=(0.03, 0.04, 0.02)), pose=Pose(position_m=(0, 0, 0))
        ),
    )
    foot = solid("foot", Compound(parts=parts), (0.0, 0.0, 0.02))
    scene = scene_of(GROUND, foot, contacts=(contact("foot", "ground", friction=0.5),))
    rows = states(GENESIS, scene, ["foot"], 0.2, **FAST)
    assert np.ptp(rows[:, 0, 2]) < 1e-4


def test_the_engine_takes_a_driven_body_to_the_end_of_its_interval():
    """Genesis turns a body that nothing touches by the mean of the old and the new rate, which lags by half a step."""
    flat, pose = Box(size_m=(0.5, 0.3, 0.02)), Pose(position_m=(0.0, 0.0, 0.5))
    plate = solid("plate", flat, pose=pose, motion=Motion.KINEMATIC)
    simulation = GENESIS.build(scene_of(plate), FAST)
    velocity = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 1.0])
    acceleration = np.array([2.0, 0.0, -1.0, 0.0, 0.0, 3.0])
    simulation.drive("plate", target(pose, velocity, acceleration))
    simulation.advance(1 / 180)
    start = simulation._links["plate"].q_start
    reached = simulation._solver.get_qpos().numpy()[0, start : start + 7]
    end = simulation.body_states(["plate"])[0, 0]
    simulation.close()
    assert end[0] == pytest.approx(0.1 / 180 + 1 / 180**2)
    assert reached[:3] == pytest.approx(end[:3], abs=1e-9)
    turned, expected = Rotation.from_quat([reached[3:], end[3:7]], scalar_first=True)
    lag = (turned.inv() * expected).as_rotvec()
    assert lag == pytest.approx([0.0, 0.0, 3.0 / 1800 / 180 / 2], abs=1e-8)


def test_a_world_that_genesis_stops_does_not_affect_the_others():
    simulation = GENESIS.build_worlds(sliding_scene(), 2, FAST)
    simulation.advance(0.1)
    expected = simulation.body_states(["cube"])[0]
    simulation.reset()
    simulation.apply_wrench("cube", np.array([[0.0] * 6, [np.nan] * 6]))
    simulation.advance(0.1)
    states, diverged = simulation.body_states(["cube"])[0], simulation.diverged()
    simulation.reset()
    assert simulation.diverged() == {}
    simulation.close()
    assert states == pytest.approx(expected, abs=1e-9)
    assert set(diverged) == {1}
    assert "Genesis stopped" in diverged[1]


# --- settings --------------------------------------------------------------------------------------------------------


def test_the_other_precision_is_an_error_while_a_simulation_lives():
    simulation = GENESIS.build(sliding_scene(), FAST)
    with pytest.raises(BackendError, match="one precision per process"):
        GENESIS.build(sliding_scene(), FAST | {"precision": 32})
    simulation.close()


@pytest.fixture
def genesis_32():
    """Genesis in single precision, as a user starts it."""
    gs = engine()
    claim(gs, 32)
    yield gs
    release(gs)


def test_out_of_box_has_genesis_defaults(request):
    simulation = GENESIS.build(sliding_scene(), {"preset": "out_of_box"})
    ours, step_s = simulation._solver._options, simulation.settings["timestep_s"]
    simulation.close()
    gs = request.getfixturevalue("genesis_32")
    plain = gs.Scene(show_viewer=False, sim_options=gs.options.SimOptions(dt=step_s))
    plain.add_entity(gs.morphs.Plane())
    plain.add_entity(gs.morphs.Box(size=(0.05, 0.05, 0.05), pos=(0.0, 0.0, 0.025)))
    plain.build()
    default = plain.sim.rigid_solver._options
    constants = plain.sim.rigid_solver.geoms[-1].get_sol_params().cpu().numpy().ravel()
    plain.destroy()
    names = [
        *("integrator", "constraint_solver", "iterations", "ls_iterations"),
        *("ls_tolerance", "noslip_iterations", "friction_cone", "contact_resolution"),
        *("impratio", "contact_pruning_tolerance", "enable_multi_contact"),
        *("box_box_detection", "use_gjk_collision"),
    ]
    assert {n: getattr(ours, n) for n in names} == {
        n: getattr(default, n) for n in names
    }
    # Genesis computes its tolerance, which rounds.
    assert ours.tolerance == pytest.approx(default.tolerance)
    preset = PRESETS["out_of_box"]
    solref = (preset.sustained_timeconst_s, preset.sustained_dampratio)
    assert constants[:5] == pytest.approx(
        (*solref, *preset.sustained_impedance), rel=1e-5
    )
