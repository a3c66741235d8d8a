"""Cloth, lines and foam in Newton's vertex block descent and material points: constants, iterations, contact, rows.

Expected values are closed forms, an independent assembly of linear elasticity, and the trajectories of MuJoCo.
"""

from dataclasses import replace

import numpy as np
import pytest
from cloths import CELL_M, fabric
from foam import (
    AREA_M2,
    DENSITY_KG_PER_M3,
    EDGE_M,
    YOUNG_PA,
    attachment_of,
    block,
    gripped,
)
from rigid import scene_of, target
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.shared.soft_rows import soft_rows
from gauge_envs.errors import ParameterError
from gauge_envs.fixtures.parts import ball, contact, fixed_box
from gauge_envs.scene import GRAVITY_M_PER_S2, Attachment, Motion, Pose, Region, Rod

newton = pytest.importorskip("newton")

from gauge_envs.backends.newton.contacts import surface_contacts  # noqa: E402
from gauge_envs.backends.newton.line import add_line  # noqa: E402
from gauge_envs.backends.newton.mpm import fitted_voxel_m  # noqa: E402
from gauge_envs.backends.newton.settings import (  # noqa: E402
    SettingsImplicitMPM,
    SettingsLines,
    longest_timestep_s,
    settings_for,
)

NEWTON = backend("newton")
INTERVAL_S = 1 / 180
FRAME = fixed_box("frame", (0.0, 0.0, 1.0), (0.01,) * 3)


def on_frame(name, *regions):
    """Attachments of regions of a body to the fixed frame."""
    return tuple(
        Attachment(deformable=name, region=region, to="frame") for region in regions
    )


def edge(axis, side="low", depth_m=0.0):
    return Region(axis=axis, side=side, depth_m=depth_m)


def weight_n_per_m2(cloth):
    return cloth.areal_density_kg_per_m2 * GRAVITY_M_PER_S2


def fallen(scene, seconds, name="textile", **settings):
    """Rest and later positions of the nodes of a body [m]."""
    settings = {"timestep_s": 1 / 1440, "cell_m": CELL_M} | settings
    simulation = NEWTON.build(scene, settings)
    rest_m = simulation.nodes(name)[0]
    simulation.advance(seconds)
    return rest_m, simulation.nodes(name)[0]


# --- cloth -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "rate_hz"),
    [("satin", 1440), pytest.param("nylon", 2880, marks=pytest.mark.slow)],
)
def test_a_hanging_strip_stretches_under_its_weight(name, rate_hz):
    """Its end sinks by w L^2 / 2 K, with the iterations that a run has: too few make it too soft."""
    length_m = 0.4
    pose = Pose.from_euler_deg((0.0, 0.0, 0.0), (0.0, 90.0, 0.0))
    cloth = fabric(name, (length_m, 0.05), pose)
    scene = scene_of(
        FRAME, deformables=(cloth,), attachments=on_frame("textile", edge("x"))
    )
    rest_m, nodes_m = fallen(scene, 1.0, timestep_s=1 / rate_hz)
    low = rest_m[:, 2] < rest_m[:, 2].min() + 1e-6
    sunk_m = (rest_m - nodes_m)[low, 2].mean()
    stiffness_n_per_m = cloth.stretch_stiffness_n_per_m
    expected_m = weight_n_per_m2(cloth) * length_m**2 / (2.0 * stiffness_n_per_m)
    assert sunk_m == pytest.approx(expected_m, rel=0.02)
    # Nothing breaks the symmetry of a flat sheet, so what leaves its plane would be a mistake.
    assert np.ptp(nodes_m[:, 0]) < 1e-6


def test_a_sheet_between_two_walls_shears_under_its_weight():
    """Gravity in its plane: a parabola of height w L^2 / 8 K_sh.

    Newton's isotropic membrane can have the measured shear stiffness of uniform. Bending in the plane adds a quarter of
    K_sh / K_s times (span / height) squared, 0.6 %.
    """
    span_m, height_m = 0.1, 0.4
    upright = Pose.from_euler_deg((0.0, 0.0, 0.0), (90.0, 0.0, 0.0))
    cloth = fabric("uniform", (span_m, height_m), upright)
    walls = on_frame("textile", edge("x"), edge("x", "high"))
    scene = scene_of(FRAME, deformables=(cloth,), attachments=walls)
    rest_m, nodes_m = fallen(scene, 0.5)
    middle = np.isclose(rest_m[:, 0], 0.0, atol=1e-6) & (np.abs(rest_m[:, 2]) < 0.06)
    sunk_m = (rest_m - nodes_m)[middle, 2].mean()
    stiffness_n_per_m = cloth.shear_stiffness_n_per_m
    expected_m = weight_n_per_m2(cloth) * span_m**2 / (8.0 * stiffness_n_per_m)
    assert sunk_m == pytest.approx(expected_m, rel=0.01)


def test_hinges_have_the_energy_of_the_bending_stiffness():
    """A cylinder along warp."""
    cloth = fabric("satin", (0.5, 0.5))
    simulation = NEWTON.build(scene_of(deformables=(cloth,)), {"cell_m": CELL_M})
    model, curvature_per_m = simulation._stepper.model, 1e-2
    places_m = model.particle_q.numpy().astype(float)
    places_m[:, 2] = 0.5 * curvature_per_m * places_m[:, 0] ** 2
    edges = model.edge_indices.numpy()
    inner = (edges[:, :2] >= 0).all(axis=1)
    a, b, c, d = places_m[edges[inner]].transpose(1, 0, 2)
    first, second = np.cross(c - a, d - a), np.cross(d - b, c - b)
    sines = np.linalg.norm(np.cross(first, second), axis=1)
    angles_rad = np.arctan2(sines, (first * second).sum(axis=1))
    hinges_n_m = model.edge_bending_properties.numpy()[inner, 0]
    hinges_n_m = hinges_n_m * model.edge_rest_length.numpy()[inner]
    plate_n_m = cloth.bend_stiffness_n_m_per_rad
    expected_j = 0.5 * plate_n_m * curvature_per_m**2 * np.prod(cloth.size_m)
    energy_j = 0.5 * hinges_n_m @ angles_rad**2
    # A strip of half a cell at each side has no hinges.
    assert energy_j == pytest.approx(expected_j, rel=1.2 * CELL_M / 0.5)


@pytest.mark.slow
def test_a_falling_sheet_gains_no_energy():
    """Held at one edge it drops, swings through and snaps; nylon is stiff for its mass.

    The elastic energy is zero at the start and positive later, so kinetic and potential energy stay below the first.
    """
    cloth = fabric("nylon", (0.4, 0.2))
    scene = scene_of(
        FRAME, deformables=(cloth,), attachments=on_frame("textile", edge("x"))
    )
    simulation = NEWTON.build(scene, {"timestep_s": 1 / 2880, "cell_m": CELL_M})
    masses_kg = simulation._stepper.model.particle_mass.numpy().astype(float)
    scale_j = 0.1 * GRAVITY_M_PER_S2 * masses_kg.sum()
    fallen_j = []
    for _ in range(90):
        simulation.advance(1 / 90)
        state = simulation._stepper.current_state
        places_m, speeds = state.particle_q.numpy(), state.particle_qd.numpy()
        height_m = places_m[:, 2] + simulation._origin_m[2]
        kinetic_j = 0.5 * masses_kg @ np.square(speeds).sum(axis=1)
        fallen_j.append(GRAVITY_M_PER_S2 * masses_kg @ height_m + kinetic_j)
    assert max(fallen_j) < 0.002 * scale_j
    assert min(fallen_j) < -0.1 * scale_j


def test_too_few_iterations_for_the_stiffness_are_an_error():
    """Four vertices' worth of legs and diagonals, with the P wave modulus of a ratio K / K_sh of 2.7."""
    cloth = fabric("nylon", (0.2, 0.2))
    scene = scene_of(deformables=(cloth,))
    few = {"cell_m": CELL_M, "iterations": 3}
    with pytest.raises(ParameterError, match="take 11, or a timestep_s of 1/2"):
        settings_for(scene, few | {"timestep_s": 1 / 1440})
    assert settings_for(scene, few).timestep_s == 1 / 2880
    shear_n_per_m = cloth.stretch_stiffness_n_per_m / 2.7
    modulus_n_per_m = shear_n_per_m * (2.0 + 2.0 * 0.7 / 1.3)
    vertex_kg = cloth.areal_density_kg_per_m2 * CELL_M**2
    square_rate = 4.0 * modulus_n_per_m / vertex_kg
    longest_s = longest_timestep_s(cloth, cell_m=CELL_M, iterations=3)
    assert longest_s**2 * square_rate == pytest.approx(3 / 0.33, rel=0.04)


def test_each_pair_gets_its_own_friction():
    """Newton takes the geometric mean of the coefficients of two bodies."""
    scene = load_experiment("TableclothPulling-metal").scene
    contacts = surface_contacts(scene)
    sides = contacts.shape_friction | {"textile": contacts.friction}
    for touch in scene.contacts:
        (first,), (second,) = touch.first, touch.second
        mean = np.sqrt(sides[first] * sides[second])
        assert mean == pytest.approx(touch.friction, rel=1e-6)
    assert contacts.touched == {"cube", "table"}


def around(name):
    """Attachments of all four edges of a sheet."""
    sides = ("low", "high")
    return on_frame(name, *(edge(axis, side) for axis in "xy" for side in sides))


@pytest.mark.slow
def test_a_narrow_body_meets_cloth_between_its_vertices():
    marble = ball("ball", (0.0125, 0.006, -0.0085), radius_m=0.008)
    touching = scene_of(
        replace(marble, motion=Motion.FIXED),
        FRAME,
        deformables=(fabric("satin", (0.2, 0.2)),),
        attachments=around("textile"),
        contacts=(contact("textile", "ball", friction=0.0),),
    )

    def sag_m(scene, **settings):
        return -fallen(scene, 0.3, **settings)[1][:, 2].min()

    free_m = sag_m(replace(touching, contacts=()))
    assert free_m > 0.004
    assert sag_m(touching, full_surface=True) < 0.8 * free_m
    # With vertices alone the ball pokes through.
    assert sag_m(touching) == pytest.approx(free_m, rel=1e-6)


# --- lines -----------------------------------------------------------------------------------------------------------


def test_segments_of_a_rod_have_the_mass_and_inertia_of_their_pieces():
    free_m, depth_m, radius_m, mass_kg = 0.15, 0.03, 0.005, 0.0149
    rod = Rod(
        name="rod",
        pose=Pose(position_m=(0.0, 0.0, 0.5 * (depth_m - free_m))),
        length_m=free_m + depth_m,
        radius_m=radius_m,
        mass_kg=mass_kg,
        young_modulus_pa=9285115.0,
        poisson_ratio=0.49,
    )
    builder = newton.ModelBuilder()
    part = add_line(
        builder,
        rod,
        attachments=[attachment_of("high", Motion.FIXED, depth_m, body="top")],
        bodies={"top": -1},
        settings=SettingsLines(preset="own", timestep_s=1 / 3600),
    )
    masses_kg = np.array(builder.body_mass)
    assert masses_kg == pytest.approx(mass_kg * free_m / (free_m + depth_m) / 8)
    inertia = np.array(builder.body_inertia[0]).reshape(3, 3)
    across_m2 = (3 * radius_m**2 + (free_m / 8) ** 2) / 12
    radii_m2 = np.array([across_m2, across_m2, 0.5 * radius_m**2])
    assert np.diag(inertia) == pytest.approx(masses_kg[0] * radii_m2)
    # The tip in the grip is a node, too.
    nodes_m = [*np.linspace(-free_m, 0.0, 9), depth_m]
    assert part.rest_m[:, 2] == pytest.approx(nodes_m)


# --- foam ------------------------------------------------------------------------------------------------------------


def clamped(foam, gravity_m_per_s2=0.0, **settings):
    """A simulation of a bar whose low end is fixed to a frame, its rest points, and its particles at the start."""
    scene = scene_of(
        FRAME,
        deformables=(foam,),
        attachments=on_frame("foam", edge("z")),
        gravity_m_per_s2=gravity_m_per_s2,
    )
    settings = {"cell_m": EDGE_M / 2, "timestep_s": 1 / 900} | settings
    simulation = NEWTON.build(scene, settings)
    return simulation, simulation._stepper.current_state.particle_q.numpy().astype(
        float
    )


def linear_stiffness(model, young_pa, poisson):
    """Stiffness matrix of linear elasticity on the tetrahedra of a model, from scratch."""
    points = model.particle_q.numpy().astype(float)
    corners = model.tet_indices.numpy()
    edges = points[corners[:, 1:]] - points[corners[:, :1]]
    inner = np.linalg.inv(edges).transpose(0, 2, 1)
    slopes = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
    shear = young_pa / (2 * (1 + poisson))
    lame = 2 * shear * poisson / (1 - 2 * poisson)
    blocks = lame * np.einsum("tai,tbj->taibj", slopes, slopes)
    blocks += shear * np.einsum("taj,tbi->taibj", slopes, slopes)
    blocks += shear * np.einsum("tac,tbc,ij->taibj", slopes, slopes, np.eye(3))
    blocks *= (np.abs(np.linalg.det(edges)) / 6)[:, None, None, None, None]
    freedoms = (3 * corners[:, :, None] + np.arange(3)).reshape(len(corners), 12)
    rows = np.repeat(freedoms, 12, axis=1).ravel()
    columns = np.tile(freedoms, (1, 12)).ravel()
    return csr_matrix((blocks.ravel(), (rows, columns)))


@pytest.mark.parametrize(
    ("euler_deg", "gravity"),
    [((-90.0, 0.0, 0.0), 0.3), ((180.0, 0.0, 0.0), 3.0)],
    ids=["bending", "tension"],
)
def test_linear_elasticity_on_the_same_mesh_is_in_balance(euler_deg, gravity):
    """Foam that starts at the solution stays there, so Newton's constants are E and nu of the scene."""
    foam = block(poisson=0.34, density=1000.0, euler_deg=euler_deg)
    simulation, start_m = clamped(foam, gravity, iterations=40)
    model = simulation._stepper.model
    stiffness = linear_stiffness(model, YOUNG_PA, 0.34)
    masses_kg = model.particle_mass.numpy().astype(float)
    loads_n = np.outer(masses_kg, [0.0, 0.0, -gravity]).ravel()
    free = np.flatnonzero(np.repeat(masses_kg > 0.0, 3))
    expected_m = np.zeros(len(loads_n))
    expected_m[free] = spsolve(stiffness[free][:, free].tocsc(), loads_n[free])
    expected_m = expected_m.reshape(-1, 3)
    simulation._stepper.current_state.particle_q.assign(start_m + expected_m)
    # Half a swing, to the other side of where the balance is.
    simulation.advance(0.26)
    moved_m = simulation._stepper.current_state.particle_q.numpy() - start_m
    assert np.abs(moved_m - expected_m).max() < 0.02 * np.abs(expected_m).max()


def test_mass_follows_the_material_and_points_follow_the_elements():
    stiff = block("stiff", length_m=0.1, centre_m=(0, 0, -0.05), density=1000.0)
    foam = block("soft", length_m=0.05, centre_m=(0, 0, 0.025))
    bond = Attachment(deformable="soft", region=edge("z"), to="stiff")
    scene = scene_of(
        deformables=(stiff, foam), attachments=(bond,), gravity_m_per_s2=0.0
    )
    simulation = NEWTON.build(scene, {"soft_rigid_ratio": np.inf})
    state = simulation._stepper.current_state
    masses_kg = simulation._stepper.model.particle_mass.numpy().astype(float)
    places_m = state.particle_q.numpy() + simulation._origin_m
    total_kg = stiff.mass_kg + foam.mass_kg
    assert masses_kg.sum() == pytest.approx(total_kg, rel=1e-5)
    centre_m = (-0.05 * stiff.mass_kg + 0.025 * foam.mass_kg) / total_kg
    mean_m = masses_kg @ places_m / total_kg
    assert mean_m == pytest.approx([0.0, 0.0, centre_m], abs=1e-6)
    rng = np.random.default_rng(0)
    slope, shift_m = rng.normal(size=(3, 3)), rng.normal(size=3)
    points_m = rng.uniform([-0.025, -0.025, -0.1], [0.025, 0.025, 0.05], (50, 3))
    read = simulation.track("soft", points_m)
    state.particle_q.assign(places_m @ slope.T + shift_m - simulation._origin_m)
    assert read()[0] == pytest.approx(points_m @ slope.T + shift_m, abs=1e-5)


def test_an_axial_swing_has_the_damping_of_kelvin_and_voigt():
    """Half the frequency times the relaxation time, to which the implicit step adds itself."""
    relaxation_s = 0.002
    simulation, start_m = clamped(
        block(density=1000.0), iterations=40, soft_damping_s=relaxation_s
    )
    place = (start_m[:, 2] - start_m[:, 2].min()) / 0.2
    stretched_m = start_m.copy()
    stretched_m[:, 2] += 1e-3 * np.sin(0.5 * np.pi * place)
    simulation._stepper.current_state.particle_q.assign(stretched_m)
    end_m = simulation.nodes("foam")[0, :, 2]
    top = end_m > end_m.max() - 1e-4
    tips_m = [1e-3]
    for _ in range(20):
        simulation.advance(INTERVAL_S)
        tips_m.append(simulation.nodes("foam")[0, top, 2].mean() - 0.1)
    back = 8 + int(np.argmax(tips_m[8:]))
    rate_per_s = 0.5 * np.pi / 0.2 * np.sqrt(YOUNG_PA / 1000.0)
    assert back * INTERVAL_S == pytest.approx(2 * np.pi / rate_per_s, abs=INTERVAL_S)
    decay = -np.log(tips_m[back] / tips_m[0]) / (2 * np.pi)
    expected = 0.5 * rate_per_s * (relaxation_s + 1 / 900)
    assert decay == pytest.approx(expected, rel=0.05)


def falling(name, x_m, young_pa=1e5, mass_kg=0.01):
    """A block of foam 5 mm above a slab."""
    foam = block(name, length_m=EDGE_M, centre_m=(x_m, 0.0, 0.03), young_pa=young_pa)
    return replace(foam, mass_kg=mass_kg, poisson_ratio=0.3)


def lowest_m(*bodies, touching, bonds=(), seconds):
    """Height of the lowest node of each body after a fall, in each of two worlds, shape [2, body_count]."""
    scene = scene_of(
        fixed_box("slab", (0.0, 0.0, -0.05), (1.0, 1.0, 0.1)),
        deformables=bodies,
        attachments=bonds,
        contacts=(contact(touching, "slab", friction=0.3),),
    )
    simulation = NEWTON.build_worlds(scene, 2, {"preset": "soft_row", "cell_m": 0.025})
    simulation.advance(seconds)
    heights = [simulation.nodes(body.name)[:, :, 2].min(axis=1) for body in bodies]
    return np.transpose(heights)


def test_each_body_collides_only_in_its_contacts():
    """An implicit Euler step falls half a step further each time."""
    bodies = falling("held", 0.0), falling("passing", 0.2)
    rest_m, passed_m = lowest_m(*bodies, touching="held", seconds=0.2).T
    assert rest_m == pytest.approx(0.0, abs=2e-3)
    fall_m = 0.5 * GRAVITY_M_PER_S2 * 0.2 * (0.2 + 1 / 3600)
    assert 0.005 - passed_m == pytest.approx(fall_m, rel=1e-4)


def ends_m(touching):
    """Heights of the foam and the rigid blocks of two rows, shape [2, 2], and of a single foam block, shape [2].

    Of the blocks, those whose names begin with `touching` may touch the slab.
    """
    bodies = []
    bonds = []
    for row, x_m in enumerate((0.0, 0.3)):
        foam = falling(f"foam {row}", x_m, mass_kg=0.002)
        rubber = falling(f"rubber {row}", x_m + 0.05, 1e7, mass_kg=0.02)
        bodies += [foam, rubber]
        bonds.append(Attachment(deformable=rubber.name, region=edge("x"), to=foam.name))
    names = (f"{touching} 0", f"{touching} 1")
    bodies.append(falling("single", -0.3))
    heights = lowest_m(*bodies, touching=names, bonds=tuple(bonds), seconds=0.1)
    return heights[:, 0:4:2], heights[:, 1:4:2], heights[:, 4]


def test_rigid_blocks_of_rows_hold_the_bonded_foam():
    """Both rest on the contact layer of the nodes; the single block falls freely, by 49 mm."""
    foam_m, rubber_m, single_m = ends_m("rubber")
    assert foam_m == pytest.approx(1e-4, abs=2e-5)
    assert rubber_m == pytest.approx(1e-4, abs=2e-5)
    assert single_m == pytest.approx(0.005 - 0.049, abs=1e-3)


def test_foam_blocks_of_rows_collide_on_their_own():
    """The heavy rigid end tips over the edge of the light foam, through the slab."""
    foam_m, rubber_m, _ = ends_m("foam")
    assert foam_m == pytest.approx(1e-4, abs=2e-4)
    assert (rubber_m < -0.02).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "frames", "moved_mm", "apart_mm"),
    [
        # Both solve the same elasticity, on cells of their own.
        ("FoamStretching-soft", 8, 1.0, 0.05),
        # The meshes are alike and the membranes' small-strain limits too; the rest is a step that is 3 times as short.
        ("TextileFlinging-satin", 15, 100.0, 0.5),
        # Rubber, a hundred times as stiff as the foam, is rigid here and elastic there.
        ("CantileverBeam-soft", 4, 30.0, 0.5),
    ],
)
def test_bodies_move_as_in_mujoco(rollout, name, frames, moved_mm, apart_mm):
    def distance_mm(first, second):
        return 1e3 * np.sqrt(np.square(first - second).sum(axis=-1).mean(axis=-1))

    options = {"frames": frames, "marker_proxy": "material"}
    _, ours, _ = rollout(name, backend="newton", **options)
    _, theirs, _ = rollout(name, **options)
    assert distance_mm(ours.markers_m, ours.markers_m[:1])[-1] > moved_mm
    assert distance_mm(ours.markers_m, theirs.markers_m).max() < apart_mm


# --- material points -------------------------------------------------------------------------------------------------


def material_points(voxel_m, step_s):
    """A simulation of a gripped bar off the planes of the grid, and the middle of the bar."""
    centre_m = np.array([0.41, 0.39, 0.13])
    scene = gripped(block(poisson=0.23, centre_m=tuple(centre_m.tolist())))
    settings = {"preset": "mpm", "cell_m": voxel_m, "timestep_s": step_s}
    return NEWTON.build(scene, settings), centre_m


def test_voxels_end_at_the_grips():
    """Planes of the grid lie half a voxel off its multiples, within a share of a voxel of both faces."""
    foam, depth_m = block(centre_m=(0.41, 0.39, 0.13)), 0.01285
    (row,) = soft_rows(gripped(foam, depth_m=depth_m))
    settings = SettingsImplicitMPM(preset="test", timestep_s=1 / 180, cell_m=0.018)
    voxel_m = fitted_voxel_m(row, settings)
    faces_m = 0.13 + np.array([-1.0, 1.0]) * (0.1 - depth_m)
    planes = faces_m / voxel_m - 0.5
    assert np.abs(planes - planes.round()).max() < 0.15
    assert voxel_m == pytest.approx(0.018, rel=0.2)


def test_points_have_the_mass_of_the_free_material_and_follow_linear_motion():
    simulation, centre_m = material_points(0.018, 1 / 180)
    masses_kg = simulation._stepper.model.particle_mass.numpy()
    expected_kg = DENSITY_KG_PER_M3 * AREA_M2 * 0.1743
    assert masses_kg.sum() == pytest.approx(expected_kg, rel=1e-5)
    assert np.count_nonzero(masses_kg) == len(simulation.nodes("foam")[0])
    rng = np.random.default_rng(0)
    slope, shift_m = rng.normal(size=(3, 3)), rng.normal(size=3)
    points_m = centre_m + rng.uniform(-1, 1, (50, 3)) * [0.025, 0.025, 0.087]
    read = simulation.track("foam", points_m)
    state, origin_m = simulation._stepper.current_state, simulation._origin_m
    places_m = state.particle_q.numpy() + origin_m
    state.particle_q.assign(places_m @ slope.T + shift_m - origin_m)
    assert read()[0] == pytest.approx(points_m @ slope.T + shift_m, abs=5e-6)


@pytest.mark.slow
def test_material_points_in_tension_have_strain_and_stress_of_the_constants():
    """In the middle of the bar; Newton counts stress positive in compression. Rigid voxels end at the grips."""
    simulation, centre_m = material_points(0.018, 1 / 900)
    rest_m = simulation.nodes("foam")[0]
    for index in range(18):
        rates = np.zeros(6)
        rates[2] = 0.02 * (index < 9)
        pose = Pose(position_m=(0.0, 0.0, 0.02 * min(index, 9) * INTERVAL_S))
        simulation.drive("high", target(pose, rates))
        simulation.advance(INTERVAL_S)
    moved_m = simulation.nodes("foam")[0] - rest_m
    middle = np.abs(rest_m[:, 2] - centre_m[2]) < 0.04
    columns = np.column_stack([rest_m - rest_m.mean(axis=0), np.ones(len(rest_m))])
    slopes = np.linalg.lstsq(columns[middle], moved_m[middle])[0]
    strain = 1e-3 / 0.1743
    assert slopes[2, 2] == pytest.approx(strain, rel=0.05)
    assert -slopes[0, 0] / slopes[2, 2] == pytest.approx(0.23, rel=0.1)
    stresses_pa = simulation._stepper.current_state.mpm.particle_stress.numpy()
    stress_pa = -stresses_pa[: len(rest_m)][middle, 2, 2].mean()
    assert stress_pa == pytest.approx(YOUNG_PA * strain, rel=0.05)
