"""Genesis's cloth: the stiffness that it has, how it is held and driven, friction, repeatability."""

from dataclasses import replace

import numpy as np
import pytest
from laws_at_rest import ratio_at_rest
from scipy.optimize import curve_fit

from gauge_envs import load_experiment
from gauge_envs.errors import ParameterError, UnsupportedSceneError
from gauge_envs.scene import Attachment, Motion, Pose, Region, Scene

pytest.importorskip("genesis", reason="extra 'genesis' is not installed")

from gauge_envs.backends import backend
from gauge_envs.backends.genesis.presets import unsupported_deformables
from gauge_envs.backends.genesis.settings import (
    cloth_cell_m,
    grid_springs,
    grid_stiffnesses,
    longest_timestep_s,
    pbd_presets,
    spring_stiffnesses,
)
from gauge_envs.backends.shared.cloth_grid import ClothGrid
from gauge_envs.scene.states import nominal_states
from gauge_envs.tools.bench.parts import contact
from gauge_envs.tools.conformance import Status, run_checks
from gauge_envs.tools.conformance.cloth import SHEETS
from gauge_envs.tools.conformance.deformable import (
    clamped,
    fabric,
    rest_error,
    sheet,
)
from gauge_envs.tools.conformance.lab import Lab

FABRICS = ("rayon", "satin", "uniform", "nylon", "oxford", "leather")


def cloth_of(fabric):
    (cloth,) = load_experiment(f"TextileFlinging-{fabric}").scene.deformables
    return cloth


def measured(*patterns, **settings):
    """Return status and measured value of some conformance checks, by id."""
    found = run_checks("genesis", settings=settings, only=patterns)
    return {result.check: (result.status, result.measured) for result in found}


@pytest.mark.parametrize("fabric", FABRICS)
def test_springs_of_a_grid_have_the_stiffnesses_of_the_fabric(fabric):
    """The energy of a cell with springs k and s is minimized over the free transverse strain."""
    cloth = cloth_of(fabric)
    along, diagonal = spring_stiffnesses(cloth)
    assert along > 0.0
    # Springs along x, y and both diagonals, strains (x, y, shear): energy per area is e M e / 2.
    directions = np.array([[1, 0, 0], [0, 1, 0], [0.5, 0.5, 0.5], [0.5, 0.5, -0.5]])
    weights = np.array([along, along, 2.0 * diagonal, 2.0 * diagonal])
    compliance = np.linalg.inv(directions.T @ (weights[:, None] * directions))
    assert 1.0 / compliance[0, 0] == pytest.approx(
        cloth.stretch_stiffness_n_per_m, rel=1e-9
    )
    assert 1.0 / compliance[2, 2] == pytest.approx(
        cloth.shear_stiffness_n_per_m, rel=1e-9
    )


def test_default_cloth_has_its_stretch_shear_and_bending_stiffness():
    assert ratio_at_rest("genesis", "cloth-stretch") == pytest.approx(1.0, rel=2e-3)
    assert ratio_at_rest("genesis", "cloth-shear") == pytest.approx(1.0, rel=0.01)
    assert ratio_at_rest("genesis", "cloth-bending") == pytest.approx(1.0, rel=0.02)


@pytest.mark.slow
def test_the_hinge_of_genesis_does_not_resist_bending():
    status, value = measured("cloth-bending", exact_hinges=False)["cloth-bending"]
    assert status is Status.FAIL
    assert not value < 1e5


@pytest.mark.slow
def test_nominal_compliances_at_the_rate_of_the_paper_give_a_soft_sheet():
    status, value = measured("cloth-stretch", preset="paper")["cloth-stretch"]
    assert status is Status.FAIL
    assert value < 0.01


def test_held_edges_slide_and_rest():
    found = measured("cloth-pinned-edge", "cloth-slide")
    assert {status for status, _ in found.values()} == {Status.PASS}
    # Two sheets that lie on two slabs fly off: docs/engines/genesis.md.
    alone = rest_error(Lab(backend("genesis")), SHEETS[:1], 0.4)
    assert alone.measured < 0.01


@pytest.mark.slow
def test_cloth_slides_without_friction_where_genesis_has_none():
    _, value = measured("cloth-slide", body_friction=False)["cloth-slide"]
    assert value == pytest.approx(9.80665 / 2, rel=0.02)


def test_a_step_in_which_a_spring_would_close_is_an_error():
    scene = load_experiment("TextileFlinging-oxford").scene
    with pytest.raises(ParameterError, match="choose a smaller timestep_s"):
        backend("genesis").build(scene, {"timestep_s": 1 / 900})


@pytest.mark.parametrize("fabric", FABRICS)
def test_the_default_step_is_below_the_longest_one(fabric):
    scene = load_experiment(f"TextileFlinging-{fabric}").scene
    settings = pbd_presets(scene)["default"]
    assert settings.timestep_s <= longest_timestep_s(cloth_of(fabric), cell_m=0.025) * (
        1.0 + 1e-9
    )
    assert settings.timestep_s <= 1 / 3600 * (1.0 + 1e-9)


@pytest.mark.parametrize("fabric", FABRICS)
def test_the_longest_step_is_stable_for_the_fastest_vibration(fabric):
    """A vibration w of the iteration has the characteristic polynomial z^2 - 2 (1 - q) z + (1 - q), q = (w h)^2."""
    cloth = cloth_of(fabric)
    grid = ClothGrid(cloth, 0.025)
    springs = grid_springs(grid)
    ends = grid.plane_m[springs]
    directions = (ends[:, 1] - ends[:, 0]) / np.linalg.norm(
        ends[:, 1] - ends[:, 0], axis=1, keepdims=True
    )
    rows = np.zeros((len(springs), 2 * len(grid.plane_m)))
    for axis in range(2):
        rows[np.arange(len(springs)), 2 * springs[:, 0] + axis] = -directions[:, axis]
        rows[np.arange(len(springs)), 2 * springs[:, 1] + axis] = directions[:, axis]
    root_mass = np.sqrt(
        np.repeat(cloth.areal_density_kg_per_m2 * grid.vertex_areas_m2(), 2)
    )
    scaled = np.sqrt(grid_stiffnesses(cloth, grid, springs))[:, None] * rows / root_mass
    fastest = float(np.linalg.norm(scaled, ord=2)) ** 2
    share = fastest * longest_timestep_s(cloth, cell_m=0.025) ** 2
    roots = np.roots([1.0, -2.0 * (1.0 - share), 1.0 - share])
    assert np.abs(roots).max() < 1.0
    assert share < 4.0 / 3.0


def test_a_cloth_that_nothing_clamps_starts_elsewhere():
    cloth = replace(cloth_of("leather"), name="free", pose=Pose(position_m=(0, 0, 1)))
    scene = Scene(bodies=(), deformables=(cloth,), duration_s=0.2)
    pose = Pose.from_euler_deg((0.1, 0.0, 1.2), (0.0, 10.0, 30.0))
    starts = nominal_states(scene)[None]
    starts[0, 0, :7] = [*pose.position_m, *pose.quaternion]
    simulation = backend("genesis").build(scene)
    rest = simulation.nodes("free")[0]
    simulation.reset(starts)
    moved = simulation.nodes("free")[0]
    simulation.advance(1 / 180)
    simulation.reset()
    again = simulation.nodes("free")[0]
    simulation.close()
    assert moved == pytest.approx(pose.to_world(cloth.pose.to_body(rest)), abs=1e-9)
    assert (again == rest).all()


def test_cells_are_small_enough_for_narrow_bodies():
    assert cloth_cell_m(load_experiment("TextileFlinging-satin").scene) == 0.025
    assert cloth_cell_m(
        load_experiment("TextileStretching-satin").scene
    ) == pytest.approx(1.4 * 0.005)
    assert cloth_cell_m(load_experiment("RotatingBall-satin").scene) == 0.025


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"stretch_iterations": 4}, "nominal"),
        ({"stretch_relaxation": 0.3}, "nominal"),
        ({"mesh": "remeshed"}, "nominal"),
    ],
)
def test_effective_stiffness_needs_one_whole_iteration(changes, field):
    scene = load_experiment("TextileFlinging-satin").scene
    with pytest.raises(ParameterError, match=field):
        backend("genesis").build(scene, changes)


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [3600, 7200])
def test_a_vibration_decays_as_the_step_says(rate_hz):
    """A hanging strip bobs at w = (pi / 2 L) sqrt(K_s / rho), and its amplitude falls at the rate w^2 h / 2."""
    length_m, width_m, density, stretch = 0.3, 0.075, 0.2, 110.0
    pose = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, -90.0, 0.0))
    strip = sheet(fabric(density, stretch, 1e-4), pose, (length_m, width_m))
    simulation = backend("genesis").build(
        clamped(strip, Region(axis="x", side="high"), duration_s=0.8),
        {"timestep_s": 1 / rate_hz},
    )
    heights = []
    for _ in range(144):
        simulation.advance(1 / 180)
        heights.append(simulation.nodes("cloth")[0, :, 2].mean())
    simulation.close()
    times = np.arange(1, 145) / 180

    def bob(t, rest, size, decay, w, phase):
        return rest + size * np.exp(-decay * t) * np.cos(w * t + phase)

    w = np.pi / (2 * length_m) * np.sqrt(stretch / density)
    found, _ = curve_fit(
        bob,
        times,
        np.array(heights),
        p0=[np.mean(heights), 5e-4, 2.0, w, 0.0],
        maxfev=20000,
    )
    assert found[3] == pytest.approx(w, rel=0.02)
    assert found[2] == pytest.approx(0.5 * found[3] ** 2 / rate_hz, rel=0.02)


@pytest.mark.slow
def test_sheets_collide_only_in_the_contacts_of_the_scene():
    """A sheet falls on another that falls more slowly, with no body beside them."""
    square = replace(
        cloth_of("leather"), size_m=(0.1, 0.1), mass_kg=0.02, thickness_m=4e-3
    )
    lower = replace(square, name="lower", pose=Pose(position_m=(0.0, 0.0, 1.0)))
    upper = replace(square, name="upper", pose=Pose(position_m=(0.0, 0.0, 1.01)))
    touch = contact("lower", "upper", friction=0.3)
    gaps = []
    for contacts in ((touch,), ()):
        scene = Scene(
            bodies=(), deformables=(lower, upper), contacts=contacts, duration_s=0.2
        )
        simulation = backend("genesis").build(scene)
        simulation._part._sheets["upper"].entity.set_particles_vel((0.0, 0.0, -0.2))
        for _ in range(18):
            simulation.advance(1 / 180)
        gaps.append((simulation.nodes("upper") - simulation.nodes("lower"))[0, :, 2])
        simulation.close()
    assert gaps[0].min() > 3.5e-3
    # 10 mm less 0.1 s at 0.2 m/s.
    assert gaps[1] == pytest.approx(-0.01, abs=1e-9)


def test_cloth_that_genesis_cannot_simulate_is_declined():
    loaded = tuple(
        unsupported_deformables(load_experiment("TableclothPulling-wood").scene)
    )
    assert len(loaded) == 1
    assert "'cube' is dynamic and touches cloth" in loaded[0]
    scene = load_experiment("TextileFlinging-satin").scene
    dynamic = replace(
        scene,
        bodies=(replace(scene.bodies[0], motion=Motion.DYNAMIC), *scene.bodies[1:]),
        drivers=(),
    )
    assert any(
        "moves under forces" in reason for reason in unsupported_deformables(dynamic)
    )
    face = Attachment(
        deformable="textile", region=Region(axis="z", side="high"), to="rod"
    )
    with pytest.raises(UnsupportedSceneError, match="by its face"):
        backend("genesis").build(replace(scene, attachments=(face,)))
