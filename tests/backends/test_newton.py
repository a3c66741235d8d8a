"""Traps of Newton's MuJoCo solver in single precision, its presets, and the scenes that it takes.

Depths follow from the impedance of contacts in MuJoCo's documentation, scores from Table 5 of GAUGE.
"""

import numpy as np
import pytest

from gauge_envs import load_experiment, variants
from gauge_envs.backends import backend
from gauge_envs.fixtures.parts import box, contact, ground
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene import GRAVITY_M_PER_S2, Scene
from gauge_envs.scene.states import nominal_states, row_of

pytest.importorskip("newton")

from gauge_envs.backends.newton.settings import settings_for

NEWTON = backend("newton")


def score_of(name, parameters="published", **settings):
    """Score of an episode."""
    request = RunRequest(
        name, backend="newton", settings=settings, parameters=parameters
    )
    return run_episode(request).score


@pytest.mark.parametrize(
    ("count", "preset", "impedance"), [(2, "rigid", 0.5), (3, "stack", 0.99)]
)
def test_a_tower_sinks_by_the_compliance_of_its_contacts(count, preset, impedance):
    """Depth of a contact: (1 - impedance) T^2 times its load over the mass that it moves."""
    size_m = (0.1, 0.1, 0.05)
    boxes = [
        box(str(index), (0.0, 0.0, 0.05 * (index + 0.5)), size_m)
        for index in range(count)
    ]
    names = tuple(brick.name for brick in boxes)
    touch = [contact(names, partner, friction=0.4) for partner in (names, "ground")]
    scene = Scene(bodies=(*boxes, ground()), contacts=tuple(touch), duration_s=0.3)
    simulation = NEWTON.build(scene)
    simulation.advance(scene.duration_s)
    top_m = simulation.body_states(names)[0, -1, 2]
    sink_m = boxes[-1].pose.position_m[2] - top_m
    time_constant_s = simulation.settings["sustained_solref"][0]
    depth_m = (1.0 - impedance) * time_constant_s**2 * GRAVITY_M_PER_S2
    assert simulation.settings["preset"] == preset
    assert sink_m == pytest.approx(depth_m * count**2 / 4, rel=0.02)


@pytest.mark.slow
def test_stiff_contacts_make_a_cube_hop_and_slide_too_far_in_single_precision():
    stiff = {"sustained_solimp": (0.95, 0.95, 0.001), "impratio": 10.0}
    name = "SlopeSlider-3-wood"
    assert score_of(name).rmse < 0.11 < 1.0 < score_of(name, **stiff).rmse


def test_restitution_has_no_effect_out_of_the_box_as_published():
    scores = [
        score_of(
            "BouncingBall-rubber", {"ball.restitution": value}, preset="out_of_box"
        ).rmse_normalized
        for value in (0.0, 0.9)
    ]
    assert scores[0] == scores[1] == pytest.approx(22.71, rel=0.005)


def test_meshes_that_touch_in_one_point_creep_as_published():
    """The published Newton creeps by 14.6 mm on 10 degrees; boxes with four contact points hold."""
    name = "SlopeSlider-1-wood"
    baseline = published_baselines(name)["rmse"]
    meshes = score_of(name, preset="paper").rmse / baseline.mean
    assert meshes == pytest.approx(baseline.engines["newton"], rel=0.1)
    assert score_of(name, preset="out_of_box").rmse / baseline.mean < 0.5


def test_contact_forces_belong_to_each_world():
    """A box at rest weighs on the ground in one world, and flies in the other."""
    brick = box("box", (0.0, 0.0, 0.05), (0.1, 0.1, 0.1))
    touch = contact("box", "ground", friction=0.4)
    scene = Scene(bodies=(brick, ground()), contacts=(touch,), duration_s=0.3)
    simulation = NEWTON.build_worlds(scene, 2)
    read = simulation.contact_forces([("box", "ground"), ("ground", "box")])
    initial_states = np.stack([nominal_states(scene)] * 2)
    initial_states[1, 0, 2] += 0.5
    simulation.reset(initial_states)
    for _ in range(36):
        simulation.advance(1 / 180)
    weight_n = brick.mass_kg * GRAVITY_M_PER_S2
    forces_n = read()
    assert forces_n[0, :, 2] == pytest.approx([weight_n, -weight_n], rel=0.02)
    assert (forces_n[1] == 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SlopeSlider-2-wood", "BouncingBall-rubber"])
def test_a_world_does_not_depend_on_size_and_place_of_its_batch(name):
    """On the CPU the bits are equal; a kernel that adds in another order would move them."""
    scene = load_experiment(name).scene
    (body,) = (body.name for body in scene.dynamic_bodies)

    def motion(numbers):
        states = np.stack([nominal_states(scene)] * len(numbers))
        states[:, row_of(scene, body), 7] += 0.01 * np.array(numbers)
        simulation = NEWTON.build_worlds(scene, len(numbers))
        simulation.reset(states)
        rows = []
        for _ in range(60):
            simulation.advance(1 / 180)
            rows.append(simulation.body_states([body]).copy())
        return np.array(rows)

    alone = motion([3])[:, 0]
    for numbers in ([3, 1], [0, 1, 2, 3, 4], range(9)):
        assert (motion(numbers)[:, numbers.index(3)] == alone).all()
    assert np.ptp(alone[:, 0], axis=0)[:3].max() > 0.05


# --- settings and support --------------------------------------------------------------------------------------------


def test_newton_takes_all_families_but_the_rope_that_rebounds():
    for variant in variants():
        missing = NEWTON.supports(load_experiment(variant.name).scene).missing
        assert bool(missing) == (variant.family == "RopeWinding"), missing
        assert not missing or "no restitution" in "; ".join(missing)


@pytest.mark.parametrize(
    ("name", "solver", "rate_hz"),
    [
        ("SlopeSlider-2-wood", "SolverMuJoCo", 180),
        ("TextileFlinging-satin", "SolverVBD", 180),
        ("FoamBending-hard", "SolverImplicitMPM", 900),
    ],
)
def test_preset_paper_has_the_solver_and_the_rate_of_the_paper(name, solver, rate_hz):
    settings = settings_for(load_experiment(name).scene, {"preset": "paper"})
    assert settings.solver == solver
    assert settings.timestep_s == pytest.approx(1 / rate_hz)


def test_a_setting_may_be_rounded_to_single_precision():
    scene = load_experiment("SlopeSlider-2-wood").scene
    assert NEWTON.build(scene, {"impratio": 440.0}).settings["impratio"] == 440.0
