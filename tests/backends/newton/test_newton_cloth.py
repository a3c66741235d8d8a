"""Cloth in Newton's vertex block descent against closed forms: stretch, shear, bending, friction, energy, edges."""

from dataclasses import replace

import numpy as np
import pytest
from cloths import CELL_M, FABRICS, fabric, heavy_elastica_sag_m, pinned
from foam import ORIGIN
from rigid import scene_of
from scipy.interpolate import griddata

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.errors import ParameterError
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Attachment,
    Motion,
    Pose,
    Region,
    Scene,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.states import nominal_states
from gauge_envs.tools.bench.parts import ball, contact, fixed_box

newton = pytest.importorskip("newton")

from gauge_envs.backends.newton.contacts import surface_contacts  # noqa: E402
from gauge_envs.backends.newton.parts import add_cloth  # noqa: E402
from gauge_envs.backends.newton.settings import (  # noqa: E402
    SettingsVBD,
    longest_timestep_s,
    settings_for,
)
from gauge_envs.backends.newton.vbd import StepperVBD  # noqa: E402

HANGING = Pose.from_euler_deg((0.0, 0.0, 0.0), (0.0, 90.0, 0.0))
"""Warp downward."""

RATES = dict.fromkeys(FABRICS, 1440) | {"nylon": 2880}
"""Steps per second that three iterations are enough for."""


def weight_n_per_m2(cloth):
    return cloth.areal_density_kg_per_m2 * GRAVITY_M_PER_S2


class Rig:
    """A cloth alone in a model."""

    def __init__(
        self,
        cloth,
        attachments=(),
        *,
        gravity_m_per_s2=(0.0, 0.0, -GRAVITY_M_PER_S2),
        rate_hz=1440,
        iterations=3,
        cell_m=CELL_M,
    ):
        builder = newton.ModelBuilder(gravity=gravity_m_per_s2)
        settings = SettingsVBD(
            preset="rig", timestep_s=1 / rate_hz, iterations=iterations, cell_m=cell_m
        )
        self.part = add_cloth(
            builder, cloth, attachments=attachments, bodies={}, settings=settings
        )
        builder.color(include_bending=True)
        self.model = builder.finalize(device="cpu")
        self.stepper = StepperVBD(self.model, driven=[], settings=settings)
        self.stepper.record()

    @property
    def moved_m(self):
        return self.part.nodes(self.stepper)[0] - self.part.rest_m

    def settle(self, seconds):
        """Come to rest: velocities are taken away again and again."""
        for _ in range(round(10 * seconds)):
            self.stepper.advance(0.1)
            for state in self.stepper.states:
                state.particle_qd.zero_()
            self.stepper.solver._last_qd.zero_()
        self.stepper.advance(0.1)
        return self


def played(scene, seconds, *names, full_surface=False):
    """Nodes of bodies of a scene after some time [m]."""
    settings = {
        "timestep_s": 1 / 1440,
        "iterations": 3,
        "cell_m": CELL_M,
        "full_surface": full_surface,
    }
    simulation = backend("newton").build(scene, settings)
    simulation.advance(seconds)
    return [simulation.nodes(name)[0] for name in names or ("textile",)]


def strains(part, nodes_m):
    """Strain of each edge of the mesh along warp and weft."""
    edges = np.unique(
        np.sort(part.grid.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1),
        axis=0,
    )
    rest = np.linalg.norm(part.rest_m[edges[:, 1]] - part.rest_m[edges[:, 0]], axis=1)
    edges, rest = edges[rest < 1.2 * rest.min()], rest[rest < 1.2 * rest.min()]
    return (
        np.linalg.norm(nodes_m[edges[:, 1]] - nodes_m[edges[:, 0]], axis=1) / rest - 1.0
    )


# --- elasticity ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [*FABRICS[:2], *(pytest.param(one, marks=pytest.mark.slow) for one in FABRICS[2:])],
)
def test_a_hanging_strip_stretches_under_its_weight(name):
    """Its end sinks by weight times length squared over twice the stiffness, with the iterations that a run has."""
    length_m = 0.4
    cloth = fabric(name, (length_m, 0.05), HANGING)
    rig = Rig(cloth, [pinned("x")], rate_hz=RATES[name])
    rig.stepper.advance(1.0)
    low = np.isclose(rig.part.rest_m[:, 2], -0.5 * length_m)
    expected = (
        weight_n_per_m2(cloth) * length_m**2 / (2.0 * cloth.stretch_stiffness_n_per_m)
    )
    assert -rig.moved_m[low, 2].mean() == pytest.approx(expected, rel=0.02)
    # Nothing breaks the symmetry of a flat sheet, so what leaves its plane would be a mistake.
    assert np.abs(rig.moved_m[:, 0]).max() < 1e-6


@pytest.mark.parametrize("softness", [1.0, 0.1])
def test_a_sheet_between_two_walls_shears_under_its_weight(softness):
    """Gravity in its plane: a parabola with weight times span squared over 8 K_sh in the middle.

    Uniform is the fabric whose measured shear stiffness Newton's isotropic membrane can have. Bending in the plane adds
    a quarter of K_sh / K_s times (span / height) squared, 0.6 %.
    """
    span_m, height_m = 0.1, 0.4
    cloth = fabric("uniform", (span_m, height_m))
    assert 2.0 < cloth.stretch_stiffness_n_per_m / cloth.shear_stiffness_n_per_m < 4.0
    cloth = replace(
        cloth,
        stretch_stiffness_n_per_m=softness * cloth.stretch_stiffness_n_per_m,
        shear_stiffness_n_per_m=softness * cloth.shear_stiffness_n_per_m,
    )
    walls = [pinned("x"), pinned("x", "high")]
    rig = Rig(cloth, walls, gravity_m_per_s2=(0.0, -GRAVITY_M_PER_S2, 0.0))
    rig.stepper.advance(0.5)
    middle = np.isclose(rig.part.rest_m[:, 0], 0.0) & (
        np.abs(rig.part.rest_m[:, 1]) < 0.06
    )
    expected = (
        weight_n_per_m2(cloth) * span_m**2 / (8.0 * cloth.shear_stiffness_n_per_m)
    )
    assert -rig.moved_m[middle, 1].mean() == pytest.approx(expected, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "tolerance"), [("x", 0.01), ("y", 0.035)])
def test_a_cantilever_sags_like_an_elastica(axis, tolerance):
    """A strip clamped at one end, by more than half its length.

    Newton's hinges are as stiff as they are long, so a square grid with diagonals bends along its lines with the cell
    over the mean edge length, 0.88, of what its constant says. Along the weft, folds lack every other hinge at the rim.
    """
    free_m = 0.3
    size = (free_m + CELL_M, 0.2)
    cloth = fabric("satin", size if axis == "x" else size[::-1])
    intended = weight_n_per_m2(cloth) * free_m**3 / 5.0
    cloth = replace(cloth, bend_stiffness_n_m_per_rad=intended)
    rig = Rig(cloth, [pinned(axis, depth_m=CELL_M)], rate_hz=360, iterations=40).settle(
        1.5
    )
    tip = np.isclose(rig.part.rest_m[:, "xy".index(axis)], 0.5 * size[0])
    # Interior edges: two legs and a diagonal a cell. The rim's legs bring the mean of this mesh from 0.879 to 0.885.
    bending = 0.885 * intended
    expected = heavy_elastica_sag_m(
        weight_n_per_m2(cloth) / bending, free_m + 0.5 * CELL_M, 0.5 * CELL_M
    )
    assert expected > 0.5 * free_m
    assert -rig.moved_m[tip, 2].mean() == pytest.approx(expected, rel=tolerance)


def energy_j(rig):
    """Kinetic, potential and elastic energy, from the laws that Newton's documentation states."""
    model, state = rig.model, rig.stepper.now
    x, v = (
        array.numpy().astype(float) for array in (state.particle_q, state.particle_qd)
    )
    masses = model.particle_mass.numpy().astype(float)
    corners = x[model.tri_indices.numpy()]
    sides = np.stack(
        [corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=-1
    )
    gradient = sides @ model.tri_poses.numpy().astype(float)
    mu, lame = model.tri_materials.numpy()[:, :2].astype(float).T
    lame = lame + mu
    area_ratio = np.linalg.norm(np.cross(gradient[..., 0], gradient[..., 1]), axis=1)
    stretch = 0.5 * mu * (np.square(gradient).sum(axis=(1, 2)) - 2.0)
    spread = 0.5 * lame * ((area_ratio - 1.0 - mu / lame) ** 2 - (mu / lame) ** 2)
    edges = model.edge_indices.numpy()
    inner = (edges[:, :2] >= 0).all(axis=1)
    a, b, c, d = x[edges[inner]].transpose(1, 0, 2)
    first, second = np.cross(c - a, d - a), np.cross(d - b, c - b)
    along = (d - c) / np.linalg.norm(d - c, axis=1, keepdims=True)
    angle = np.arctan2(
        (np.cross(first, second) * along).sum(axis=1), (first * second).sum(axis=1)
    )
    hinges = (
        model.edge_bending_properties.numpy()[inner, 0]
        * model.edge_rest_length.numpy()[inner]
    )
    return float(
        (
            0.5 * masses * np.square(v).sum(axis=1)
            + GRAVITY_M_PER_S2 * masses * x[:, 2]
        ).sum()
        + (model.tri_areas.numpy() * (stretch + spread)).sum()
        + (0.5 * hinges * angle**2).sum()
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rayon", "nylon"])
def test_a_falling_sheet_gains_no_energy(name):
    """Held at one edge it drops, swings through and snaps; the stiffest fabrics for their mass are the ones at risk."""
    cloth = fabric(name, (0.4, 0.2))
    rig = Rig(cloth, [pinned("x")], rate_hz=RATES[name])
    energies = [energy_j(rig)]
    for _ in range(90):
        rig.stepper.advance(1 / 90)
        energies.append(energy_j(rig))
    scale = cloth.mass_kg * 0.5 * GRAVITY_M_PER_S2 * 0.2
    rises = np.array(energies) - np.minimum.accumulate(energies)
    assert rises.max() < 0.002 * scale
    assert np.abs(strains(rig.part, rig.part.nodes(rig.stepper)[0])).max() < 0.05


def test_too_few_iterations_for_the_stiffness_are_an_error():
    cloth = fabric("nylon", (0.2, 0.2))
    scene = scene_of(deformables=(cloth,))
    few = {"cell_m": CELL_M, "iterations": 3}
    with pytest.raises(ParameterError, match="take 11, or a timestep_s of 1/2"):
        settings_for(scene, few | {"timestep_s": 1 / 1440})
    assert settings_for(scene, few).timestep_s == 1 / 2880
    assert 1 / 2880 < longest_timestep_s(cloth, cell_m=CELL_M, iterations=3) < 1 / 2700
    # Four vertices' worth of legs and diagonals, with the P wave modulus 1.14 K that a ratio K / K_sh of 2.7 gives.
    shear = cloth.stretch_stiffness_n_per_m / 2.7
    modulus = shear * (2.0 + 2.0 * 0.7 / 1.3)
    expected = 4.0 * modulus / (cloth.areal_density_kg_per_m2 * CELL_M**2 * 2880**2)
    found = longest_timestep_s(cloth, cell_m=CELL_M, iterations=3)
    assert found * 2880 == pytest.approx(np.sqrt(3 / (0.33 * expected)), rel=0.02)


# --- contact ---------------------------------------------------------------------------------------------------------


def sheet(name, size_m, pose, as_name="textile"):
    return replace(fabric(name, size_m, pose), name=as_name)


FRAME = fixed_box("frame", (0.0, 0.0, 1.0), (0.01, 0.01, 0.01))


def held_around(name):
    """Attachments of all four edges of a sheet."""
    return tuple(
        Attachment(deformable=name, region=Region(axis=axis, side=side), to="frame")
        for axis in "xy"
        for side in ("low", "high")
    )


def test_cloth_passes_through_what_it_has_no_contact_with():
    scene = Scene(
        bodies=(
            fixed_box("board", (0.0, 0.0, -0.02), (2.0, 0.5, 0.02)),
            fixed_box("other", (0.3, 0.0, 0.06), (0.1, 0.1, 0.1)),
        ),
        deformables=(sheet("oxford", (0.2, 0.2), Pose(position_m=(-0.2, 0.0, 0.0))),),
        contacts=(contact("textile", "other", friction=0.3),),
        duration_s=1.0,
    )
    (nodes,) = played(scene, 0.2)
    assert nodes[:, 2].max() < -0.15


@pytest.mark.slow
def test_a_narrow_body_meets_cloth_between_its_vertices():
    marble = replace(
        ball("ball", (0.0125, 0.006, -0.0085), radius_m=0.008), motion=Motion.FIXED
    )
    scene = Scene(
        bodies=(marble, FRAME),
        deformables=(sheet("satin", (0.2, 0.2), ORIGIN),),
        attachments=held_around("textile"),
        contacts=(contact("textile", "ball", friction=0.0),),
        duration_s=1.0,
    )

    def sag_m(one, full_surface):
        (nodes,) = played(one, 0.3, full_surface=full_surface)
        return float(-nodes[:, 2].min())

    free = sag_m(replace(scene, contacts=()), full_surface=False)
    assert free > 0.004
    assert sag_m(scene, full_surface=True) < 0.8 * free
    # With vertices alone the ball pokes through.
    assert sag_m(scene, full_surface=False) == pytest.approx(free, rel=1e-6)


@pytest.mark.slow
def test_cloth_rests_on_cloth():
    """A sheet falls on a taut one; both are of particles, which meet where the scene lists them with each other."""
    above = Pose(position_m=(0.004, 0.003, 0.02))
    pairs = (("taut", "loose"), ("taut", "taut"), ("loose", "loose"))
    scene = Scene(
        bodies=(FRAME,),
        deformables=(
            sheet("uniform", (0.3, 0.3), ORIGIN, "taut"),
            sheet("uniform", (0.15, 0.15), above, "loose"),
        ),
        attachments=held_around("taut"),
        contacts=tuple(contact(*pair, friction=0.3) for pair in pairs),
        duration_s=1.0,
    )
    taut, loose = played(scene, 0.3, "taut", "loose")
    gaps = loose[:, 2] - griddata(taut[:, :2], taut[:, 2], loose[:, :2])
    assert gaps.min() > 0.0005
    assert gaps.max() < 0.003
    (fallen,) = played(replace(scene, contacts=()), 0.2, "loose")
    assert fallen[:, 2].max() < -0.1


def test_every_pair_gets_its_own_friction():
    scene = load_experiment("TableclothPulling-metal").scene
    contacts = surface_contacts(scene)
    sides = contacts.shape_friction | {"textile": contacts.friction}
    for touch in scene.contacts:
        for first in touch.first:
            for second in touch.second:
                assert np.sqrt(sides[first] * sides[second]) == pytest.approx(
                    touch.friction, rel=1e-6
                )
    assert contacts.touched == {"cube", "table"}
    assert not contacts.itself


def test_free_cloth_starts_where_the_array_says():
    """Its rest shape stays that of the nominal start, and another reset forgets the start."""
    scene = scene_of(deformables=(sheet("oxford", (0.2, 0.2), ORIGIN),))
    lifted = replace(scene, deformables=(replace(scene.deformables[0], pose=HANGING),))
    simulation = backend("newton").build_worlds(scene, 2, {"cell_m": CELL_M})
    simulation.reset(np.stack([nominal_states(scene), nominal_states(lifted)]))
    expected = backend("newton").build(lifted, {"cell_m": CELL_M}).nodes("textile")
    assert simulation.nodes("textile")[1:] == pytest.approx(expected, abs=1e-7)
    simulation.advance(0.1)
    falls_m = np.ptp(simulation.nodes("textile")[:, :, 2], axis=1)
    assert falls_m == pytest.approx([0.0, 0.2], abs=1e-4)
    simulation.reset()
    assert np.ptp(simulation.nodes("textile"), axis=0).max() == 0.0


@pytest.mark.slow
def test_cloth_stays_on_a_slope_that_holds_it():
    lean = (0.0, 30.0, 0.0)
    slope = Pose.from_euler_deg((0.0, 0.0, 0.0), lean)
    above_m = 0.01 + 0.5 * fabric("oxford", (0.1, 0.1)).thickness_m
    place = vector(slope.to_world(np.array([-0.2, 0.0, above_m])))
    scene = Scene(
        bodies=(fixed_box("board", (0.0, 0.0, 0.0), (2.0, 0.5, 0.02), euler_deg=lean),),
        deformables=(sheet("oxford", (0.2, 0.2), replace(slope, position_m=place)),),
        contacts=(contact("textile", "board", friction=0.8),),
        duration_s=1.0,
    )
    (start,), (end,) = played(scene, 0.1), played(scene, 0.4)
    assert np.abs(end - start).max() < 1e-4
