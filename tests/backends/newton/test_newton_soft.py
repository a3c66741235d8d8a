"""Soft bodies in Newton against closed forms and independent finite elements: tetrahedra by VBD, material points."""

import numpy as np
import pytest
from foam import AREA_M2, DENSITY_KG_PER_M3, EDGE_M, YOUNG_PA, block, held
from hexahedra import extrapolated_end_force
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

newton = pytest.importorskip("newton")
wp = pytest.importorskip("warp")


from gauge_envs.backends.newton.mpm import StepperMPM, add_soft_mpm, fitted_voxel_m  # noqa: E402
from gauge_envs.backends.newton.parts import add_soft  # noqa: E402
from gauge_envs.backends.newton.settings import SettingsMPM, SettingsVBD  # noqa: E402
from gauge_envs.backends.newton.vbd import StepperVBD  # noqa: E402
from gauge_envs.backends.shared.soft_rows import SoftRow  # noqa: E402
from gauge_envs.scene import Motion  # noqa: E402


def vbd(**changes):
    return SettingsVBD(
        preset="bench",
        starts_from_acceleration=False,
        **{"timestep_s": 1 / 3600} | changes,
    )


class Bench:
    """A row that a fixed plate holds at its low end."""

    def __init__(
        self,
        *bodies,
        gravity=(0.0, 0.0, 0.0),
        **changes,
    ):
        wp.config.log_level = wp.LOG_WARNING
        self.builder = newton.ModelBuilder(gravity=gravity)
        row = SoftRow.of(bodies, {bodies[0].name: [held("low", Motion.FIXED)]})
        settings = vbd(**changes)
        self.part = add_soft(self.builder, row, indices={}, settings=settings)
        self.builder.color()
        self.model = self.builder.finalize(device="cpu")
        self.stepper = StepperVBD(self.model, driven=[], settings=settings)
        self.stepper.record()

    def run(self, seconds, path=None):
        """Simulate while the driven plate follows a path, given at 180 Hz."""
        for index in range(round(180 * seconds)):
            if path is not None:
                (place, turn), (there, turned) = (
                    path(index / 180),
                    path((index + 1) / 180),
                )
                rate = 180 * np.concatenate(
                    [np.subtract(there, place), (turned * turn.inv()).as_rotvec()]
                )
                motion = [*place, *turn.as_quat(scalar_first=True), *rate, *np.zeros(6)]
                self.stepper.drive(self.driven[0], np.array([motion]))
            self.stepper.advance(1 / 180)

    def nodes(self):
        return self.part.nodes(self.stepper)[0]

    def moved(self, *points_m):
        """Displacements of material points [m]."""
        points_m = np.array(points_m)
        return self.part.track(points_m)(self.stepper)[0] - points_m


STILL = Rotation.identity()


def ramp(time, seconds):
    return min(time / seconds, 1.0)


# --- the elements ----------------------------------------------------------------------------------------------------


def linear_stiffness(builder, young_pa, poisson):
    """Stiffness matrix of linear elasticity on the tetrahedra of a model in the making, from scratch."""
    points, corners = (
        np.array(builder.particle_q, dtype=float),
        np.array(builder.tet_indices),
    )
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
    rows, columns = (
        np.repeat(freedoms, 12, axis=1).ravel(),
        np.tile(freedoms, (1, 12)).ravel(),
    )
    return csr_matrix((blocks.ravel(), (rows, columns)))


def mesh(*bodies, high=Motion.FIXED, **options):
    builder = newton.ModelBuilder()
    attachments = {bodies[0].name: [held("low", Motion.FIXED)]}
    if high:
        attachments.setdefault(bodies[-1].name, []).append(held("high", high))
    return builder, add_soft(
        builder, SoftRow.of(bodies, attachments), indices={}, settings=vbd(**options)
    )


@pytest.mark.parametrize(
    ("axis", "cells", "least", "most"),
    [(2, 4, 1.0, 1.02), (0, 4, 1.05, 1.17), (0, 6, 1.03, 1.08)],
    ids=["tension", "shear", "shear of finer cells"],
)
@pytest.mark.parametrize("poisson", [0.23, 0.34])
def test_clamped_bar_is_too_stiff_by_what_is_stated(poisson, axis, cells, least, most):
    builder, part = mesh(block(length_m=0.1743, poisson=poisson), cell_m=EDGE_M / cells)
    stiffness = linear_stiffness(builder, YOUNG_PA, poisson)
    high = np.flatnonzero(part.rest_m[:, 2] > 0.0871)
    moved = np.zeros(stiffness.shape[0])
    moved[3 * high + axis] = 1.0
    free = np.flatnonzero(np.repeat(np.array(builder.particle_mass) > 0.0, 3))
    moved[free] = spsolve(stiffness[free][:, free].tocsc(), -(stiffness[free] @ moved))
    force = (stiffness @ moved)[3 * high + axis].sum()
    fine = extrapolated_end_force(
        edge_m=EDGE_M, length_m=0.1743, young_pa=YOUNG_PA, poisson=poisson, axis=axis
    )
    assert least < force / fine < most


def test_mass_is_that_of_the_material():
    stiff = block("stiff", length_m=0.1, centre_m=(0, 0, -0.05), density=1000.0)
    soft = block("soft", length_m=0.05, centre_m=(0, 0, 0.025))
    builder = newton.ModelBuilder()
    part = add_soft(builder, SoftRow.of([stiff, soft], {}), indices={}, settings=vbd())
    masses = np.array(builder.particle_mass)
    assert masses.sum() == pytest.approx(stiff.mass_kg + soft.mass_kg)
    centre = (stiff.mass_kg * -0.05 + soft.mass_kg * 0.025) / (
        stiff.mass_kg + soft.mass_kg
    )
    assert masses @ part.rest_m / masses.sum() == pytest.approx([0.0, 0.0, centre])
    assert part.names == ("stiff", "soft")
    assert part.rest_m[part.node_indices["soft"], 2].min() == pytest.approx(0.0)


def test_points_are_those_of_the_elements():
    bench = Bench(block(poisson=0.3))
    rng = np.random.default_rng(0)
    slope, shift = rng.normal(size=(3, 3)), rng.normal(size=3)
    bench.stepper.now.particle_q.assign(bench.part.rest_m @ slope.T + shift)
    points = rng.uniform([-0.025, -0.025, -0.1], [0.025, 0.025, 0.1], (50, 3))
    assert np.allclose(
        bench.part.track(points)(bench.stepper)[0], points @ slope.T + shift, atol=1e-6
    )


# --- vertex block descent --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "gravity", [(0.0, 0.3, 0.0), (0.0, 0.0, 3.0)], ids=["bending", "tension"]
)
def test_linear_elasticity_on_the_same_mesh_is_in_balance(gravity):
    """Started at the solution it stays there, so Newton's own constants are E and nu; what is left is the mesh."""
    bench = Bench(
        block(poisson=0.34, density=1000.0),
        gravity=gravity,
        cell_m=EDGE_M / 2,
        timestep_s=1 / 900,
        iterations=40,
    )
    stiffness = linear_stiffness(bench.builder, YOUNG_PA, 0.34)
    masses = np.array(bench.builder.particle_mass)
    free = np.flatnonzero(np.repeat(masses > 0.0, 3))
    expected = np.zeros(3 * len(masses))
    expected[free] = spsolve(
        stiffness[free][:, free].tocsc(), np.outer(masses, gravity).ravel()[free]
    )
    expected = expected.reshape(-1, 3)
    bench.stepper.now.particle_q.assign(bench.part.rest_m + expected)
    # Half a swing, to the other side of where the balance is.
    bench.run(0.26)
    moved = bench.nodes() - bench.part.rest_m
    assert np.abs(moved - expected).max() < 0.02 * np.abs(expected).max()


def test_damping_of_an_axial_swing():
    """Kelvin and Voigt's: half the frequency times the relaxation time, to which the implicit step adds itself."""
    bench = Bench(
        block(density=1000.0),
        cell_m=EDGE_M / 2,
        timestep_s=1 / 900,
        iterations=40,
        soft_damping_s=0.002,
    )
    stretched = bench.part.rest_m.copy()
    stretched[:, 2] += 1e-3 * np.sin(0.5 * np.pi * (stretched[:, 2] + 0.1) / 0.2)
    bench.stepper.now.particle_q.assign(stretched)
    tips = [1e-3]
    for _ in range(20):
        bench.run(1 / 180)
        tips.append(bench.moved([0.0, 0.0, 0.1])[0, 2])
    back = 8 + int(np.argmax(tips[8:]))
    rate = 0.5 * np.pi / 0.2 * np.sqrt(YOUNG_PA / 1000.0)
    assert back / 180 == pytest.approx(2 * np.pi / rate, abs=1 / 180)
    assert -np.log(tips[back] / tips[0]) / (2 * np.pi) == pytest.approx(
        0.5 * rate * (0.002 + 1 / 900), rel=0.05
    )


def cantilever(**options):
    foam = {"young_pa": 86410.0, "poisson": 0.23, "density": 12.8}
    rubber = {"young_pa": 9285115.0, "poisson": 0.49, "density": 1072.8}
    cubes = [
        block(
            f"cube-{index + 1}",
            length_m=0.05,
            centre_m=(0.0, 0.0, 0.05 * index),
            **kind,
        )
        for index, kind in enumerate([foam, rubber, foam, rubber])
    ]
    return Bench(*cubes, **options)


@pytest.mark.slow
def test_rigid_blocks_and_soft_ones_stay_together():
    bench = cantilever(gravity=(0.0, 9.81, 0.0))
    bench.run(0.15)
    rest, nodes = bench.part.rest_m, bench.nodes()
    for name, face_m in (("cube-2", 0.025), ("cube-2", 0.075), ("cube-4", 0.125)):
        rigid = bench.part.node_indices[name]
        face = rigid[np.abs(rest[rigid, 2] - face_m) < 1e-6]
        _, where = np.unique(rest[face].round(6), axis=0, return_inverse=True)
        spread = max(
            np.ptp(nodes[face][where == index], axis=0).max()
            for index in range(where.max() + 1)
        )
        assert len(face) == 2 * (where.max() + 1)
        assert spread < 2e-6
    # A rigid block keeps its shape.
    own = bench.part.node_indices["cube-4"]
    assert np.linalg.norm(np.ptp(nodes[own], axis=0)) > 0.05
    assert np.linalg.norm(nodes[own[-1]] - nodes[own[-2]]) == pytest.approx(
        np.linalg.norm(rest[own[-1]] - rest[own[-2]]), rel=1e-4
    )


@pytest.mark.slow
def test_rigid_rubber_swings_as_stiff_rubber_does():
    """Rubber that is 20 times as stiff as the foam instead of 107 times, compressible, by short steps."""
    tips = []
    for options in (
        {},
        {"soft_rigid_ratio": np.inf, "timestep_s": 1 / 7200, "iterations": 20},
    ):
        foam, soft_rubber = (
            {"density": 12.8, "poisson": 0.23},
            {"density": 1072.8, "young_pa": 20 * YOUNG_PA},
        )
        kinds = [foam, soft_rubber, foam, soft_rubber]
        cubes = [
            block(f"cube-{k + 1}", length_m=0.05, centre_m=(0.0, 0.0, 0.05 * k), **kind)
            for k, kind in enumerate(kinds)
        ]
        bench = Bench(
            *cubes, gravity=(0.0, 9.81, 0.0), **({"soft_rigid_ratio": 10.0} | options)
        )
        bench.run(0.2)
        tips.append(bench.moved([0.0, 0.0, 0.15])[0, 1])
    assert tips[0] == pytest.approx(tips[1], rel=0.08)


# --- material points -------------------------------------------------------------------------------------------------


class BenchMPM(Bench):
    """The same with material points."""

    def __init__(self, body, *, voxel_m, step_s):
        wp.config.log_level = wp.LOG_WARNING
        attachments = {
            body.name: [
                held("low", Motion.FIXED, 0.01285),
                held("high", Motion.KINEMATIC, 0.01285),
            ]
        }
        settings = SettingsMPM(preset="bench", timestep_s=step_s, cell_m=voxel_m)
        soft_row = SoftRow.of([body], attachments)
        self.voxel_m = fitted_voxel_m(soft_row, settings)
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        newton.solvers.SolverImplicitMPM.register_custom_attributes(builder)
        self.driven = [
            builder.add_body(is_kinematic=True, mass=1.0, inertia=wp.mat33(np.eye(3)))
        ]
        self.part = add_soft_mpm(
            builder,
            soft_row,
            indices={"high": self.driven[0]},
            spacing_m=0.5 * self.voxel_m,
        )
        self.model = builder.finalize(device="cpu")
        self.stepper = StepperMPM(
            self.model,
            driven=self.driven,
            pins=self.part.pins,
            voxel_m=self.voxel_m,
            settings=settings,
        )
        self.stepper.record()


def test_points_have_the_mass_of_the_free_material_and_voxels_end_at_the_grips():
    bench = BenchMPM(block(centre_m=(0.41, 0.39, 0.13)), voxel_m=0.018, step_s=1 / 180)
    masses = bench.model.particle_mass.numpy()
    assert masses.sum() == pytest.approx(DENSITY_KG_PER_M3 * AREA_M2 * 0.1743, rel=1e-5)
    assert np.count_nonzero(masses) == len(bench.part.rest_m)
    planes = np.array([0.13 - 0.08715, 0.13 + 0.08715]) / bench.voxel_m - 0.5
    assert np.abs(planes - planes.round()).max() < 0.15


def test_points_between_material_points_follow_linear_motion():
    bench = BenchMPM(block(centre_m=(0.41, 0.39, 0.13)), voxel_m=0.025, step_s=1 / 180)
    rng = np.random.default_rng(0)
    slope, shift = rng.normal(size=(3, 3)), rng.normal(size=3)
    bench.stepper.now.particle_q.assign(
        bench.stepper.now.particle_q.numpy() @ slope.T + shift
    )
    points = np.array([0.41, 0.39, 0.13]) + rng.uniform(-1, 1, (50, 3)) * [
        0.025,
        0.025,
        0.087,
    ]
    assert np.allclose(
        bench.part.track(points)(bench.stepper)[0], points @ slope.T + shift, atol=2e-6
    )


@pytest.mark.slow
def test_material_points_in_tension():
    """Strain and stress (which Newton counts positive in compression) of E and nu in the middle of the bar."""
    bench = BenchMPM(
        block(centre_m=(0.41, 0.39, 0.13), poisson=0.23), voxel_m=0.018, step_s=1 / 900
    )
    bench.run(0.1, lambda time: ((0.0, 0.0, 1e-3 * ramp(time, 0.05)), STILL))
    rest, moved = bench.part.rest_m, bench.nodes() - bench.part.rest_m
    middle = np.abs(rest[:, 2] - 0.13) < 0.04
    slopes = np.linalg.lstsq(
        np.column_stack([rest - rest.mean(axis=0), np.ones(len(rest))])[middle],
        moved[middle],
    )[0]
    assert slopes[2, 2] == pytest.approx(1e-3 / 0.1743, rel=0.05)
    assert -slopes[0, 0] / slopes[2, 2] == pytest.approx(0.23, rel=0.1)
    stress = -bench.stepper.now.mpm.particle_stress.numpy()[: len(rest)][
        middle, 2, 2
    ].mean()
    assert stress == pytest.approx(YOUNG_PA * 1e-3 / 0.1743, rel=0.05)
