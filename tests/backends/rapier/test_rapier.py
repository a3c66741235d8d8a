"""The Rapier backend against closed forms, and the choices of its default preset."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gauge_envs import Jitter, load_experiment
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Box,
    Contact,
    ContactMode,
    Cylinder,
    Hinge,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Scene,
    Sphere,
    Tether,
)
from gauge_envs.scene.jitter import jittered

pytest.importorskip("rapier3d")

from gauge_envs.backends import backend
from gauge_envs.backends.rapier.contacts import LARGEST_CONTACT_COUNT, collider_layers
from gauge_envs.backends.rapier.simulation import _mean_velocities
from gauge_envs.backends.shared.rigid import DrivenMotion
from gauge_envs.tools.conformance import Status, run_checks

RAPIER = backend("rapier")
G = GRAVITY_M_PER_S2
SLOPE_DEG = 30.0
DOWNHILL = np.array(
    [np.cos(np.radians(SLOPE_DEG)), 0.0, -np.sin(np.radians(SLOPE_DEG))]
)
NORMAL = np.array([np.sin(np.radians(SLOPE_DEG)), 0.0, np.cos(np.radians(SLOPE_DEG))])
FRICTION = 0.273673


def solid(
    name: str, shape: object, position_m: tuple = (0.0, 0.0, 0.0), **changes
) -> RigidBody:
    values = {
        "motion": Motion.DYNAMIC,
        "pose": Pose(position_m=position_m),
        "mass_kg": 0.1,
    } | changes
    return RigidBody(name=name, shape=shape, **values)


GROUND = solid("ground", Plane(), motion=Motion.FIXED, mass_kg=0.0)


def sampled(
    scene: Scene, name: str, seconds: float, **settings
) -> tuple[np.ndarray, np.ndarray]:
    """Times, shape [n], and states of a body, shape [n, 13], at each step."""
    step_s = settings.get("timestep_s", 1 / 1800)
    simulation = RAPIER.build(scene, settings | {"drive_interval_s": step_s})
    states = []
    for _ in range(round(seconds / step_s)):
        simulation.advance(step_s)
        states.append(simulation.body_states([name])[0])
    return step_s * np.arange(1, len(states) + 1), np.array(states)


def failures(*only: str, **settings) -> list[str]:
    findings = list(run_checks("rapier", only=list(only), settings=settings))
    assert findings
    return sorted(
        f.check for f in findings if f.status not in (Status.PASS, Status.DECLINED)
    )


# --- conformance ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "check"),
    [
        ({"contact_recycling": True}, "rest-box"),
        ({"contact_recycling": True}, "carry-turn"),
        ({"friction_model": "coulomb"}, "slide"),
        ({"sleep": True}, "rebound-slow"),
        ({"hinge_damping_n_m_s": 0.1}, "pendulum-energy"),
        ({"solver_iterations": 4}, "start-velocity"),
        (
            {
                "timestep_s": 1 / 180,
                "contact_frequency_hz": 30.0,
                "static_contact_frequency_hz": 10.0,
            },
            "contact-listed",
        ),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else value,
)
def test_each_choice_of_the_default_preset_is_needed(
    settings: dict, check: str
) -> None:
    assert failures(check, **settings) == [check]


# --- friction and restitution -----------------------------------------------------------------------------------------


def slope(friction: float = FRICTION, edge_m: float = 0.05) -> Scene:
    turned = {"euler_deg": (0.0, SLOPE_DEG, 0.0)}
    board = solid(
        "board",
        Box(size_m=(2.0, 0.4, 0.02)),
        motion=Motion.FIXED,
        pose=Pose.from_euler_deg((0.0, 0.0, 0.0), **turned),
    )
    place = tuple((0.01 + 0.5 * edge_m) * NORMAL)
    cube = solid(
        "cube", Box(size_m=(edge_m,) * 3), pose=Pose.from_euler_deg(place, **turned)
    )
    contact = Contact(
        first=("cube",), second=("board",), friction=friction, restitution=0.0
    )
    return Scene(bodies=(cube, board), contacts=(contact,), duration_s=0.6)


def slide_acceleration(**settings) -> float:
    times, states = sampled(slope(), "cube", 0.6, **settings)
    late = times > 0.1
    return 2.0 * float(np.polyfit(times[late], states[late, :3] @ DOWNHILL, 2)[0])


@pytest.mark.parametrize(
    ("rate_hz", "iterations"), [(180, 1), (180, 4), (1800, 2), (3600, 1)]
)
def test_a_slide_has_coulombs_acceleration_at_every_step(
    rate_hz: int, iterations: int
) -> None:
    measured = slide_acceleration(timestep_s=1 / rate_hz, solver_iterations=iterations)
    assert measured == pytest.approx(
        G * -DOWNHILL[2] - FRICTION * G * NORMAL[2], rel=1e-3
    )


def test_the_coulomb_model_loses_friction_by_the_angle_between_impulse_and_slip() -> (
    None
):
    # The impulse of a corner is along K^-1 v. For a cube K is [[4, 1.5], [1.5, 4]] / m, and the lateral parts cancel.
    share = 4.0 / np.hypot(4.0, 1.5)
    assert slide_acceleration(friction_model="coulomb") == pytest.approx(
        G * -DOWNHILL[2] - share * FRICTION * G * NORMAL[2], rel=1e-3
    )


def dropped(restitution: float, mode: ContactMode = ContactMode.IMPACT) -> Scene:
    ball = solid("ball", Sphere(radius_m=0.02), (0.0, 0.0, 0.52))
    contact = Contact(
        first=("ball",),
        second=("ground",),
        friction=0.3,
        restitution=restitution,
        mode=mode,
    )
    return Scene(bodies=(ball, GROUND), contacts=(contact,), duration_s=1.0)


@pytest.mark.parametrize(
    ("restitution", "rate_hz"), list(product((0.2, 0.576733, 0.9), (180, 900, 1800)))
)
def test_the_speed_of_a_rebound_is_exact_at_every_step(
    restitution: float, rate_hz: int
) -> None:
    _, states = sampled(dropped(restitution), "ball", 0.4, timestep_s=1 / rate_hz)
    speed = states[:, 9]
    hit = int(np.argmax(speed > 0.0))
    assert speed[hit] == pytest.approx(-restitution * speed[hit - 1], rel=1e-4)


# --- errors of the engine that the page states ------------------------------------------------------------------------


def test_a_flat_impact_spins_a_box() -> None:
    brick = solid("ball", Box(size_m=(0.1, 0.06, 0.04)), (0.0, 0.0, 0.22), mass_kg=0.2)
    scene = replace(dropped(0.5), bodies=(brick, GROUND))
    _, states = sampled(scene, "ball", 0.35)
    hit = int(np.argmax(states[:, 9] > 0.0))
    assert np.linalg.norm(states[hit + 5, 10:]) == pytest.approx(6.9, abs=0.3)
    assert np.sqrt((states[hit:, 2].max() - 0.02) / 0.2) == pytest.approx(
        0.35, abs=0.01
    )


def test_a_cylinder_rolls_too_fast_on_a_box_and_right_on_a_plane() -> None:
    slope_deg, radius_m = 3.6, 0.03
    sine, cosine = np.sin(np.radians(slope_deg)), np.cos(np.radians(slope_deg))
    roller = solid(
        "roller",
        Cylinder(radius_m=radius_m, length_m=0.06),
        pose=Pose.from_euler_deg(
            (radius_m * sine, 0.0, radius_m * cosine), (90.0, 0.0, 0.0)
        ),
    )
    ratios = []
    for shape, depth_m in ((Plane(), 0.0), (Box(size_m=(3.0, 1.0, 0.1)), 0.05)):
        lean = Pose.from_euler_deg(
            (-depth_m * sine, 0.0, -depth_m * cosine), (0.0, slope_deg, 0.0)
        )
        ground = solid("ground", shape, motion=Motion.FIXED, pose=lean, mass_kg=depth_m)
        contact = Contact(
            first=("roller",), second=("ground",), friction=0.5, restitution=0.0
        )
        times, states = sampled(
            Scene(bodies=(roller, ground), contacts=(contact,), duration_s=0.8),
            "roller",
            0.8,
        )
        late = times > 0.1
        measured = (
            2.0 * np.polyfit(times[late], states[late, :3] @ [cosine, 0.0, -sine], 2)[0]
        )
        ratios.append(measured / (2.0 / 3.0 * G * sine))
    assert ratios == pytest.approx([1.0, 1.2], abs=0.02)


# --- pairs ------------------------------------------------------------------------------------------------------------


def test_bodies_have_a_collider_for_each_contact_and_meet_only_its_other_side() -> None:
    names = ("a", "b", "c")
    bodies = (*(solid(name, Sphere(radius_m=0.1)) for name in names), GROUND)
    contacts = (
        Contact(
            first=("a", "b"),
            second=("a", "b"),
            friction=0.1,
            restitution=0.5,
            mode=ContactMode.IMPACT,
        ),
        Contact(
            first=("b", "c"),
            second=("ground",),
            friction=0.7,
            restitution=0.5,
            mode=ContactMode.SUSTAINED,
        ),
        Contact(
            first=("c",),
            second=("a",),
            friction=0.4,
            restitution=0.2,
            mode=ContactMode.IMPACT,
        ),
    )
    scene = Scene(bodies=bodies, contacts=contacts, duration_s=1.0)
    layers = collider_layers(scene)
    listed = {
        frozenset(pair): contact
        for contact in contacts
        for pair in scene.colliding_pairs(contact)
    }
    for one, other in product([*names, "ground"], repeat=2):
        met = [
            (mine.friction, theirs.friction, mine.restitution, theirs.restitution)
            for mine in layers[one]
            for theirs in layers[other]
            if mine.memberships & theirs.filter and theirs.memberships & mine.filter
        ]
        contact = listed.get(frozenset((one, other))) if one != other else None
        if contact is None:
            # Rapier ignores pairs of colliders of one body.
            assert met == [] or one == other
        else:
            restitution = (
                contact.restitution if contact.mode is ContactMode.IMPACT else 0.0
            )
            assert met == [
                (contact.friction, contact.friction, restitution, restitution)
            ]


def test_too_many_contacts_are_declined() -> None:
    balls = tuple(
        solid(f"ball-{i}", Sphere(radius_m=0.02), (0.1 * i, 0.0, 0.02))
        for i in range(17)
    )

    def scene(count: int) -> Scene:
        contacts = tuple(
            Contact(
                first=(ball.name,),
                second=("ground",),
                friction=0.01 * (i + 1),
                restitution=0.0,
            )
            for i, ball in enumerate(balls[:count])
        )
        return Scene(bodies=(*balls, GROUND), contacts=contacts, duration_s=1.0)

    assert RAPIER.supports(scene(LARGEST_CONTACT_COUNT))
    (reason,) = RAPIER.supports(scene(LARGEST_CONTACT_COUNT + 1)).missing
    assert reason.startswith("the scene has 17 kinds of contact")
    simulation = RAPIER.build(scene(LARGEST_CONTACT_COUNT))
    simulation.advance(0.2)
    heights = simulation.body_states([ball.name for ball in balls])[:, 2]
    assert heights[:16] == pytest.approx(0.02, abs=1e-4)
    assert heights[16] < -0.1


# --- masses -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("radius_m", "length_m", "mass_kg"),
    [(0.03, 0.06, 0.1), (0.03, 0.06, 0.001), (0.01, 0.2, 0.01)],
)
def test_light_cylinders_turn_by_their_own_inertia(
    radius_m: float, length_m: float, mass_kg: float
) -> None:
    # With masses in kg, Rapier's sum over colliders swaps the moments of such cylinders.
    rod = solid("rod", Cylinder(radius_m=radius_m, length_m=length_m), mass_kg=mass_kg)
    contacts = tuple(
        Contact(first=("rod",), second=(name,), friction=0.1, restitution=0.0)
        for name in ("far", "further")
    )
    far = tuple(
        solid(name, Box(size_m=(1.0,) * 3), (9.0, 0.0, 0.0), motion=Motion.FIXED)
        for name in ("far", "further")
    )
    scene = Scene(
        bodies=(rod, *far), contacts=contacts, duration_s=1.0, gravity_m_per_s2=0.0
    )
    across = mass_kg * (3.0 * radius_m**2 + length_m**2) / 12.0
    for axis, moment in enumerate((across, across, 0.5 * mass_kg * radius_m**2)):
        simulation = RAPIER.build(scene)
        wrench = np.zeros(6)
        wrench[3 + axis] = 0.9 * moment
        simulation.apply_wrench("rod", wrench)
        simulation.advance(0.1)
        assert simulation.body_states(["rod"])[0, 10:] == pytest.approx(
            0.09 * np.eye(3)[axis], abs=1e-4
        )


# --- joints -----------------------------------------------------------------------------------------------------------


def pendulum_energy_j_per_kg(seconds: float, **settings) -> np.ndarray:
    """Kinetic and potential energy of a swing from 90 degrees, 0 at its start and 1.96 J/kg in its motion."""
    bob = solid("bob", Sphere(radius_m=0.02), (0.2, 0.0, 0.0))
    scene = Scene(
        bodies=(bob,),
        joints=(Hinge(body="bob", anchor_m=(0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0)),),
        duration_s=20.0,
    )
    _, states = sampled(scene, "bob", seconds, **settings)
    spin = np.square(states[:, 10:]).sum(axis=1)
    return (
        G * states[:, 2]
        + 0.5 * np.square(states[:, 7:10]).sum(axis=1)
        + 0.2 * 0.02**2 * spin
    )


def test_rapiers_damping_of_hinges_stops_a_pendulum() -> None:
    # Overdamped: 0.1 N m s against 0.004 kg m^2 and 0.2 N m.
    energy = pendulum_energy_j_per_kg(4.0, hinge_damping_n_m_s=0.1)
    assert energy[-1] == pytest.approx(-0.2 * G, abs=0.01)


def test_impulse_hinges_lose_energy_in_the_stabilization() -> None:
    impulse = {"hinge_joint": "impulse", "timestep_s": 1 / 180, "solver_iterations": 4}
    assert pendulum_energy_j_per_kg(20.0, **impulse)[-1] == pytest.approx(
        -0.95, abs=0.05
    )
    assert (
        np.abs(
            pendulum_energy_j_per_kg(20.0, **impulse, stabilization_iterations=0)
        ).max()
        < 0.01
    )


def test_a_string_holds_its_length_and_loses_less_than_a_percent_of_a_swing() -> None:
    start = np.radians(60.0)
    bob = solid(
        "bob", Sphere(radius_m=0.02), (0.5 * np.sin(start), 0.0, -0.5 * np.cos(start))
    )
    scene = Scene(
        bodies=(bob,),
        joints=(Tether(body="bob", anchor_m=(0.0, 0.0, 0.0), length_m=0.5),),
        duration_s=1.5,
    )
    _, states = sampled(scene, "bob", 1.5)
    energy = G * (states[:, 2] + 0.25) + 0.5 * np.square(states[:, 7:10]).sum(axis=1)
    assert np.abs(np.linalg.norm(states[:, :3], axis=1) - 0.5).max() < 1e-5
    assert -0.01 < energy[-1] / (0.25 * G) < 0.001


@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.6, 0.0, 0.8)])
def test_a_hinged_body_starts_with_its_velocity(
    axis: tuple[float, float, float],
) -> None:
    place, spin = np.array([0.1, -0.2, -0.15]), 3.0 * np.array(axis)
    pose = Pose.from_euler_deg(tuple(place), (20.0, 30.0, 40.0))
    velocity = {
        "angular_velocity_rad_per_s": tuple(spin),
        "linear_velocity_m_per_s": tuple(np.cross(spin, place)),
    }
    bob = solid("bob", Box(size_m=(0.1, 0.06, 0.04)), pose=pose, **velocity)
    hinge = Hinge(body="bob", anchor_m=(0.0, 0.0, 0.0), axis=axis)
    scene = Scene(bodies=(bob,), joints=(hinge,), duration_s=1.0, gravity_m_per_s2=0.0)
    times, states = sampled(scene, "bob", 0.5)
    expected = np.array(
        [Rotation.from_rotvec(spin * time).apply(place) for time in times]
    )
    assert states[:, :3] == pytest.approx(expected, abs=1e-4)
    assert states[:, 10:] == pytest.approx(
        np.broadcast_to(spin, (len(times), 3)), abs=1e-3
    )


# --- states -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "acceleration", [(0.0, 0.0, 4.0), (3.0, -2.0, 5.0), (0.0, 0.0, 0.0)]
)
def test_the_velocities_of_all_steps_are_those_of_single_steps(
    acceleration: tuple,
) -> None:
    motion = DrivenMotion(
        Pose(position_m=(0.0, 0.0, 0.0)),
        np.array([0.1, 0.2, 0.3, 0.0, 0.0, 2.0]),
        np.array([1.0, -1.0, 2.0, *acceleration]),
    )
    seconds = 1 / 180
    expected = [
        motion.mean_velocity(k * seconds / 10, (k + 1) * seconds / 10)
        for k in range(10)
    ]
    assert _mean_velocities(motion, seconds, 10) == pytest.approx(
        np.array(expected), abs=1e-12
    )


@pytest.mark.parametrize(
    ("name", "seed"),
    [("NonsmoothContact-1-wood", 11), ("NonsmoothContact-2-wood", 136)],
)
def test_a_body_that_touches_with_two_pieces_at_once_moves_as_alone(
    name: str, seed: int
) -> None:
    # In a shared world these two starts part from their single runs, where two pieces touch in the same step.
    experiment = load_experiment(name)
    scene = jittered(experiment.scene, Jitter(), seed=seed)
    names = [body.name for body in scene.dynamic_bodies]
    worlds, single = RAPIER.build_worlds([scene, scene]), RAPIER.build(scene)
    for _ in range(6 * (experiment.frame_count - 1)):
        worlds.advance(1 / 180)
        single.advance(1 / 180)
    for world in worlds.worlds:
        assert (world.body_states(names) == single.body_states(names)).all()


def test_a_world_that_fails_leaves_its_neighbours_alone() -> None:
    worlds = RAPIER.build_worlds([dropped(0.5)] * 3)
    alone = RAPIER.build(dropped(0.5))
    worlds.worlds[1].apply_wrench("ball", np.array([np.nan, 0, 0, 0, 0, 0]))
    for one in (worlds, alone):
        one.advance(0.5)
    assert [world.fault() is None for world in worlds.worlds] == [True, False, True]
    assert (worlds.worlds[2].body_states(["ball"]) == alone.body_states(["ball"])).all()


# --- settings and installation ----------------------------------------------------------------------------------------


def test_every_setting_reaches_the_engine() -> None:
    """Each setting but the preset's name changes the engine's parameters, the bodies or the joints."""
    from gauge_envs.backends.rapier import model
    from gauge_envs.backends.rapier.settings import PRESETS

    changed = {
        "solver_iterations": 7,
        "pgs_iterations": 3,
        "stabilization_iterations": 5,
        "friction_model": "coulomb",
        "contact_frequency_hz": 55.0,
        "contact_damping_ratio": 4.0,
        "static_contact_frequency_hz": 66.0,
        "static_contact_damping_ratio": 3.0,
        "allowed_linear_error_m": 0.001,
        "max_corrective_velocity_m_per_s": 1.5,
        "prediction_distance_m": 0.011,
        "contact_clustering": False,
        "contact_recycling": True,
        "recycle_distance_m": 0.013,
        "warmstart_coefficient": 0.5,
        "warmstart_joints": True,
        "friction_in_bias_pass": True,
        "max_linear_velocity_m_per_s": 99.0,
    }
    scene = load_experiment("Turntable-1-wood").scene
    plain = PRESETS["default"]

    def held(settings) -> tuple:
        world, (layouts,) = model.build_world([scene], settings)
        body = world.rigid_bodies[layouts["cube"][0]]
        return (
            world.integration_parameters.to_bytes(),
            body.ccd_enabled,
            body.activation.linear_threshold,
        )

    assert set(changed) <= set(type(plain).model_fields)
    for name, value in changed.items():
        assert held(plain.model_copy(update={name: value})) != held(plain), name
    for name in ("sleep", "ccd"):
        assert held(plain.model_copy(update={name: True}))[1:] != held(plain)[1:], name


def test_the_engine_has_the_threads_of_the_settings() -> None:
    simulation = RAPIER.build(dropped(0.5), {"threads": 2})
    simulation.reset(0)
    assert simulation._world.num_threads == 2
    assert RAPIER.build(dropped(0.5))._world.num_threads == 1


@pytest.mark.parametrize("preset", ["default", "out_of_box"])
def test_episodes_end(preset: str) -> None:
    for name in (
        "SlopeSlider-2-wood",
        "BouncingBall-rubber",
        "Turntable-2-wood",
        "NonsmoothContact-2-wood",
    ):
        result = run_episode(
            RunRequest(name, backend="rapier", settings={"preset": preset})
        )
        assert result.outcome == "finished"
        assert result.settings["preset"] == preset and set(result.versions) >= {
            "rapier3d"
        }
