"""Genesis's cloth by springs and hinges, and its foam by finite elements and material points.

Stiffnesses and steps follow from the energy of a cell and from the characteristic polynomial of an iteration.
"""

from dataclasses import replace

import numpy as np
import pytest
from laws_at_rest import ratio_at_rest
from scipy.optimize import curve_fit

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.shared.cloth_grid import ClothGrid
from gauge_envs.backends.shared.soft_rows import soft_rows
from gauge_envs.errors import ParameterError, UnsupportedSceneError
from gauge_envs.fixtures.parts import contact
from gauge_envs.fixtures.recording import DivergedError, record
from gauge_envs.scene import Motion, Pose, Region, Scene
from gauge_envs.tools.conformance import Status, run_checks
from gauge_envs.tools.conformance.deformable import clamped, fabric, sheet

pytest.importorskip("genesis.version", reason="extra 'genesis' is not installed")

from gauge_envs.backends.genesis.engine import engine
from gauge_envs.backends.genesis.foam import fitted_voxel_m
from gauge_envs.backends.genesis.presets import unsupported_deformables
from gauge_envs.backends.genesis.settings import (
    cloth_cell_m,
    grid_springs,
    grid_stiffnesses,
    longest_mpm_timestep_s,
    longest_timestep_s,
    pbd_presets,
    soft_presets,
    sound_time_s,
    spring_stiffnesses,
)

GENESIS = backend("genesis")
SATIN = load_experiment("TextileFlinging-satin").scene
FOAM = load_experiment("FoamTwisting-soft").scene
FABRICS = ("satin", "nylon", "leather")


def cloth_of(name):
    (cloth,) = load_experiment(f"TextileFlinging-{name}").scene.deformables
    return cloth


def measured(check, **settings):
    """Return status and measured value of a conformance check."""
    (result,) = run_checks("genesis", settings=settings, only=(check,))
    return result.status, result.measured


# --- cloth -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("warp_angle_deg", [-45.0, 0.0, 45.0, 90.0])
@pytest.mark.parametrize("name", FABRICS)
def test_springs_of_a_grid_have_the_stiffnesses_of_the_fabric(name, warp_angle_deg):
    """The energy of a cell with springs k and s is minimized over the free transverse strain."""
    angle_rad = np.radians(warp_angle_deg)
    cloth = replace(cloth_of(name), warp_angle_rad=float(angle_rad))
    along, diagonal = spring_stiffnesses(cloth)
    assert along > 0.0
    # Springs along x, y and both diagonals, strains (x, y, shear): energy per area is e M e / 2.
    angles_rad = np.radians([0.0, 90.0, 45.0, -45.0]) - angle_rad
    cosines, sines = np.cos(angles_rad), np.sin(angles_rad)
    directions = np.column_stack([cosines**2, sines**2, cosines * sines])
    weights = np.array([along, along, 2.0 * diagonal, 2.0 * diagonal])
    compliance = np.linalg.inv(directions.T @ (weights[:, None] * directions))
    stiffnesses = 1.0 / np.diag(compliance)
    assert stiffnesses[0] == pytest.approx(cloth.stretch_stiffness_n_per_m, rel=1e-9)
    assert stiffnesses[2] == pytest.approx(cloth.shear_stiffness_n_per_m, rel=1e-9)


def test_a_warp_between_the_springs_is_an_error():
    cloth = replace(cloth_of("satin"), warp_angle_rad=0.3)
    with pytest.raises(UnsupportedSceneError, match="multiples of 45"):
        spring_stiffnesses(cloth)


@pytest.mark.parametrize(
    ("law", "error"),
    [("cloth-stretch", 2e-3), ("cloth-shear", 0.01), ("cloth-bending", 0.02)],
)
def test_cloth_has_its_stiffnesses(law, error):
    assert ratio_at_rest("genesis", law) == pytest.approx(1.0, rel=error)


@pytest.mark.slow
def test_settings_of_genesis_itself_lose_bending_stretch_and_friction():
    """Its hinge does not resist, the compliances are soft at the rate of the paper, and particles have no friction."""
    status, compliance = measured("cloth-bending", exact_hinges=False)
    assert status is Status.FAIL
    assert not compliance < 1e5
    status, stretch = measured("cloth-stretch", preset="paper")
    assert status is Status.FAIL
    assert stretch < 0.01
    status, friction_share = measured("cloth-slide", body_friction=False)
    assert status is Status.FAIL
    assert friction_share == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("name", FABRICS)
def test_the_longest_step_is_stable_for_the_fastest_vibration(name):
    """A vibration w of the iteration has the characteristic polynomial z^2 - 2 (1 - q) z + (1 - q), q = (w h)^2."""
    cloth = cloth_of(name)
    grid = ClothGrid(cloth, 0.025)
    springs = grid_springs(grid)
    ends_m = grid.plane_m[springs]
    directions = ends_m[:, 1] - ends_m[:, 0]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rows = np.zeros((len(springs), 2 * len(grid.plane_m)))
    for axis in range(2):
        rows[np.arange(len(springs)), 2 * springs[:, 0] + axis] = -directions[:, axis]
        rows[np.arange(len(springs)), 2 * springs[:, 1] + axis] = directions[:, axis]
    masses_kg = cloth.areal_density_kg_per_m2 * grid.vertex_areas_m2()
    root_mass = np.sqrt(np.repeat(masses_kg, 2))
    scaled = np.sqrt(grid_stiffnesses(cloth, grid, springs))[:, None] * rows / root_mass
    longest_s = longest_timestep_s(cloth, cell_m=0.025)
    share = (np.linalg.norm(scaled, ord=2) * longest_s) ** 2
    roots = np.roots([1.0, -2.0 * (1.0 - share), 1.0 - share])
    assert np.abs(roots).max() < 1.0
    assert share < 4.0 / 3.0
    scene = load_experiment(f"TextileFlinging-{name}").scene
    default_s = pbd_presets(scene)["default"].timestep_s
    assert default_s <= min(longest_s, 1 / 3600) * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("oxford", {"timestep_s": 1 / 900}, "choose a smaller timestep_s"),
        ("satin", {"stretch_iterations": 4}, "nominal"),
        ("satin", {"stretch_relaxation": 0.3}, "nominal"),
        ("satin", {"mesh": "remeshed"}, "nominal"),
    ],
)
def test_settings_with_which_springs_lose_their_stiffness_are_errors(
    name, changes, message
):
    scene = load_experiment(f"TextileFlinging-{name}").scene
    with pytest.raises(ParameterError, match=message):
        GENESIS.build(scene, changes)


def test_cells_are_small_enough_for_narrow_bodies():
    probed = load_experiment("TextileStretching-satin").scene
    assert cloth_cell_m(SATIN) == 0.025
    assert cloth_cell_m(probed) == pytest.approx(1.4 * 0.005)
    assert cloth_cell_m(load_experiment("RotatingBall-satin").scene) == 0.025


@pytest.mark.slow
def test_a_vibration_decays_as_the_step_says():
    """A hanging strip bobs at w = (pi / 2 L) sqrt(K_s / rho), and its amplitude falls at the rate w^2 h / 2."""
    length_m, width_m, density, stretch = 0.3, 0.075, 0.2, 110.0
    pose = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, -90.0, 0.0))
    strip = sheet(fabric(density, stretch, 1e-4), pose, (length_m, width_m))
    simulation = GENESIS.build(
        clamped(strip, Region(axis="x", side="high"), duration_s=0.8),
        {"timestep_s": 1 / 3600},
    )
    heights_m = []
    for _ in range(144):
        simulation.advance(1 / 180)
        heights_m.append(simulation.nodes("cloth")[0, :, 2].mean())
    simulation.close()

    def bob(t, rest, size, decay, rate, phase):
        return rest + size * np.exp(-decay * t) * np.cos(rate * t + phase)

    expected = np.pi / (2 * length_m) * np.sqrt(stretch / density)
    guess = [np.mean(heights_m), 5e-4, 2.0, expected, 0.0]
    times_s = np.arange(1, 145) / 180
    (_, _, decay, rate, _), _ = curve_fit(
        bob, times_s, np.array(heights_m), p0=guess, maxfev=20000
    )
    assert rate == pytest.approx(expected, rel=0.02)
    assert decay == pytest.approx(0.5 * rate**2 / 3600, rel=0.02)


@pytest.mark.slow
def test_sheets_collide_only_in_the_contacts_of_the_scene():
    """A sheet falls on a sheet that falls more slowly; there is no other body."""
    square = replace(
        cloth_of("leather"), size_m=(0.1, 0.1), mass_kg=0.02, thickness_m=4e-3
    )
    lower = replace(square, name="lower", pose=Pose(position_m=(0.0, 0.0, 1.0)))
    upper = replace(square, name="upper", pose=Pose(position_m=(0.0, 0.0, 1.01)))
    touch = contact("lower", "upper", friction=0.3)
    gaps_m = []
    for contacts in ((touch,), ()):
        scene = Scene(
            bodies=(), deformables=(lower, upper), contacts=contacts, duration_s=0.2
        )
        simulation = GENESIS.build(scene)
        simulation._part._sheets["upper"].entity.set_particles_vel((0.0, 0.0, -0.2))
        simulation.advance(0.1)
        gaps_m.append((simulation.nodes("upper") - simulation.nodes("lower"))[0, :, 2])
        simulation.close()
    assert gaps_m[0].min() > 3.5e-3
    # 10 mm less 0.1 s at 0.2 m/s.
    assert gaps_m[1] == pytest.approx(-0.01, abs=1e-9)


# --- foam ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "preset", ["default", pytest.param("mpm", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("law", ["foam-tension", "foam-poisson"])
def test_a_bar_has_its_modulus_and_poisson_ratio(law, preset):
    ratio = ratio_at_rest("genesis", law, {"preset": preset})
    assert ratio == pytest.approx(1.0, rel=0.01)


def row_of_foam():
    (row,) = soft_rows(FOAM)
    return row


def test_grid_planes_lie_at_the_faces_of_both_grips():
    row = row_of_foam()
    voxel_m = fitted_voxel_m([row], 0.0125)
    assert 0.85 * 0.0125 <= voxel_m <= 1.15 * 0.0125
    for face_m in (row.low_m[2], row.high_m[2]):
        apart_m = abs(round(face_m / voxel_m) * voxel_m - face_m)
        assert apart_m < 0.15 * voxel_m


def test_the_step_of_material_points_is_a_share_of_the_time_of_sound():
    (body,) = FOAM.deformables
    density = body.mass_kg / (0.05 * 0.05 * 0.2)
    modulus_pa = body.young_modulus_pa * 0.77 / (1.23 * 0.54)
    longest_s = longest_mpm_timestep_s(body, 0.0125)
    sound_s = 0.0125 / np.sqrt(modulus_pa / density)
    assert longest_s == pytest.approx(0.4 * sound_s, rel=1e-9)
    assert soft_presets(FOAM)["mpm"].timestep_s <= longest_s


def test_foam_out_of_the_box_has_genesis_defaults():
    options, presets = engine().options, soft_presets(FOAM)
    preset = presets["out_of_box"]
    points_m = preset.cell_m / preset.points_per_voxel_edge
    assert 1 / preset.cell_m == pytest.approx(options.MPMOptions().grid_density)
    assert points_m == pytest.approx(options.MPMOptions().particle_size)
    assert preset.model == engine().materials.MPM.Elastic().model
    assert preset.contact_softness_m == engine().materials.Rigid().coup_softness
    # Genesis's default step is longer than the interval, and a step must divide the interval.
    assert preset.timestep_s == preset.drive_interval_s < options.SimOptions().dt
    paper = preset.model_copy(update={"preset": "paper", "timestep_s": 1 / 900})
    assert paper == presets["paper"]


def test_foam_that_bursts_is_an_error_that_names_the_longest_step():
    simulation = GENESIS.build(FOAM, {"preset": "out_of_box"})
    burst = r"'foam' left its grid: explicit MPM is unstable.* set timestep_s to 1/"
    with pytest.raises(DivergedError, match=burst):
        record(simulation, FOAM, 0.1)
    simulation.close()


@pytest.mark.slow
def test_the_longest_step_that_the_error_names_holds():
    (body,) = FOAM.deformables
    voxel_m = fitted_voxel_m([row_of_foam()], 1 / 64)
    steps = int(np.ceil(1 / 180 / (0.4 * sound_time_s(body, voxel_m))))
    settings = {"preset": "paper", "timestep_s": 1 / 180 / steps}
    simulation = GENESIS.build(FOAM, settings)
    record(simulation, FOAM, 0.1)
    simulation.close()


# --- support ---------------------------------------------------------------------------------------------------------


def test_deformable_bodies_that_genesis_cannot_simulate_are_unsupported():
    rod, *rest = SATIN.bodies
    dynamic = (replace(rod, motion=Motion.DYNAMIC), *rest)
    both = (*FOAM.deformables, *SATIN.deformables)
    beam = load_experiment("CantileverBeam-soft").scene
    touch = contact("cube-1", "cube-3", friction=0.1)
    for scene, reason in (
        (load_experiment("TableclothPulling-wood").scene, "'cube' is dynamic and"),
        (load_experiment("RopeWinding-rubber").scene, "is a line"),
        (replace(SATIN, bodies=dynamic, drivers=()), "moves under forces"),
        (replace(beam, contacts=(touch,)), "'cube-1' may touch 'cube-3'"),
        (replace(FOAM, deformables=both), "shares a scene with cloth"),
    ):
        assert reason in "; ".join(unsupported_deformables(scene))
