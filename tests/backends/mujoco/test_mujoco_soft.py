"""Soft bodies in MuJoCo against closed forms: stretching, twisting, shearing, bonded rows, contact."""

import mujoco
import numpy as np
import pytest
from foam import AREA_M2, DENSITY_KG_PER_M3, EDGE_M, YOUNG_PA, block, held
from hexahedra import extrapolated_end_force
from scipy.spatial.transform import Rotation

from gauge_envs.backends.mujoco import soft
from gauge_envs.backends.mujoco.soft import add_soft
from gauge_envs.backends.shared.soft_rows import SoftRow
from gauge_envs.errors import ShapeError
from gauge_envs.scene import Motion


def part_of(spec, row, *, cells=None, damping_s=1e-4):
    """The part of a row, with other numbers of cells along and across each body where they are given."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("LONE_CELLS", "BONDED_CELLS"):
            patch.setattr(soft, name, cells or getattr(soft, name))
        return add_soft(
            spec,
            row,
            grip_mass_kg=1e3,
            timestep_s=spec.option.timestep,
            damping_s=damping_s,
        )


class Bench:
    """A row held by a fixed plate at its low end and a driven one at its high end."""

    def __init__(
        self,
        *bodies,
        depth_m=0.0,
        step_s=1 / 900,
        damping_s=1e-4,
        gravity=0.0,
        high=Motion.KINEMATIC,
        more=lambda spec: None,
        conaffinity=0,
        cells=None,
        axis="z",
    ):
        spec = mujoco.MjSpec()
        spec.option.timestep = step_s
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        spec.option.gravity = [0.0, 0.0, -gravity]
        spec.option.iterations = 2000
        for name, motion in (("low", Motion.FIXED), ("high", high)):
            frame = spec.worldbody.add_body(name=name)
            if motion is Motion.KINEMATIC:
                frame.add_freejoint(name=name)
                frame.explicitinertial, frame.mass, frame.inertia, frame.gravcomp = (
                    True,
                    1e3,
                    [1e3] * 3,
                    1.0,
                )
        more(spec)
        attachments = {bodies[0].name: [held("low", Motion.FIXED, depth_m, axis)]}
        attachments.setdefault(bodies[-1].name, []).append(
            held("high", high, depth_m, axis)
        )
        self.part = part_of(
            spec, SoftRow.of(bodies, attachments), damping_s=damping_s, cells=cells
        )
        self.part.flex.conaffinity, self.part.flex.condim = conaffinity, 1
        self.model = spec.compile()
        self.part.complete(self.model)
        self.data = mujoco.MjData(self.model)
        self.part.bind(self.model, self.data)
        self.driven = high is Motion.KINEMATIC

    def place(self, move_m, turn=None):
        """Put the driven plate, at rest."""
        joint = self.model.joint("high")
        position, speed = int(joint.qposadr[0]), int(joint.dofadr[0])
        self.data.qpos[position : position + 3] = move_m
        self.data.qpos[position + 3 : position + 7] = (
            turn or Rotation.identity()
        ).as_quat(scalar_first=True)
        self.data.qvel[speed : speed + 6] = 0.0
        for grip in self.part.grips:
            grip.follow()

    def run(
        self,
        seconds,
        path=lambda time: ([0, 0, 0], None),
    ):
        """Simulate while the driven plate follows a path, placed at 180 Hz."""
        steps = round(1 / 180 / self.model.opt.timestep)
        for index in range(round(180 * seconds)):
            if self.driven:
                self.place(*path(index / 180))
            mujoco.mj_step(self.model, self.data, nstep=steps)

    def reaction(self, move_m, turn=None):
        """Force [N] and torque [N m] that hold the plate there at rest, shape [6]."""
        self.run(0.5, lambda time: (move_m, turn))
        self.place(move_m, turn)
        mujoco.mj_forward(self.model, self.data)
        ids = [
            self.model.body(name).id for grip in self.part.grips for name in grip.names
        ]
        dofs = self.model.body_dofadr[ids][:, None] + np.arange(3)
        # `qfrc_spring` and `qfrc_damper` without the compensation of the nodes' weight.
        forces = -(self.data.qfrc_spring + self.data.qfrc_damper)[dofs]
        torques = np.cross(self.data.xpos[ids] - np.asarray(move_m), forces)
        return np.concatenate([forces.sum(axis=0), torques.sum(axis=0)])


def static(*bodies, **options):
    """A bench that comes to rest fast."""
    return Bench(*bodies, step_s=1 / 180, damping_s=0.01, **options)


def test_tension_is_exact_without_lateral_contraction():
    bench = static(block(), depth_m=0.01285)
    assert bench.reaction([0.0, 0.0, 1e-3])[2] == pytest.approx(
        YOUNG_PA * AREA_M2 / 0.1743 * 1e-3, rel=1e-3
    )


@pytest.mark.slow
def test_torsion_of_a_square_bar():
    """Saint-Venant's 0.1406 G a^4, as the difference of two lengths: clamps keep the ends from warping."""
    poisson, angle = 0.23, 0.02
    compliance = []
    for cells, length in ((4, 0.1743), (8, 0.3486)):
        bench = static(block(length_m=length, poisson=poisson), cells=(cells, 2))
        compliance.append(
            angle / bench.reaction([0, 0, 0], Rotation.from_rotvec([0, 0, angle]))[5]
        )
    shear_pa = YOUNG_PA / (2 * (1 + poisson))
    assert 1 / np.diff(compliance)[0] == pytest.approx(
        0.1406 * shear_pa * EDGE_M**4 / 0.1743, rel=0.03
    )


@pytest.mark.parametrize("poisson", [0.0, pytest.param(0.23, marks=pytest.mark.slow)])
def test_shear_of_a_clamped_and_guided_bar(poisson):
    """Timoshenko; clamps that keep the ends from contracting add up to 4 %."""
    force = static(block(poisson=poisson), depth_m=0.01285).reaction([1e-3, 0.0, 0.0])[
        0
    ]
    inertia, shear_pa = EDGE_M**4 / 12, YOUNG_PA / (2 * (1 + poisson))
    compliance = 0.1743**3 / (12 * YOUNG_PA * inertia) + 0.1743 / (
        5 / 6 * shear_pa * AREA_M2
    )
    assert force == pytest.approx(1e-3 / compliance, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axis", "limit"), [(0, 0.05), (2, 0.02)], ids=["shear", "tension"]
)
@pytest.mark.parametrize("poisson", [0.23, 0.34])
def test_clamped_bar_agrees_with_fine_finite_elements(poisson, axis, limit):
    """The clamps' share, which beam theory leaves out, is the same in an independent solution."""
    force = static(block(poisson=poisson), depth_m=0.01285).reaction(
        list(1e-3 * np.eye(3)[axis])
    )[axis]
    fine = extrapolated_end_force(
        edge_m=EDGE_M, length_m=0.1743, young_pa=YOUNG_PA, poisson=poisson, axis=axis
    )
    assert force / 1e-3 == pytest.approx(fine, rel=limit)
    assert force / 1e-3 > fine


def test_mass_is_that_of_the_free_material():
    bench = Bench(block(), depth_m=0.01285, high=Motion.FIXED)
    held = (
        DENSITY_KG_PER_M3 * AREA_M2 * 0.1743 / 4 / 6 * 2
    )  # Simpson's share of the two pinned layers.
    expected = DENSITY_KG_PER_M3 * AREA_M2 * 0.1743 - held
    bodies = [
        index
        for index in range(bench.model.nbody)
        if bench.model.body(index).name.startswith("foam")
    ]
    assert bench.model.body_mass[bodies].sum() == pytest.approx(expected)


def test_points_are_those_of_the_elements():
    bench = Bench(block(poisson=0.3), high=Motion.FIXED)
    bench.data.qpos += np.random.default_rng(0).normal(0.0, 2e-3, bench.model.nq)
    mujoco.mj_forward(bench.model, bench.data)
    assert np.allclose(bench.part.nodes(), bench.data.flexvert_xpos, atol=1e-12)
    assert np.allclose(
        bench.part.track(bench.part.rest_m[::7])(),
        bench.data.flexvert_xpos[::7],
        atol=1e-12,
    )
    assert np.abs(
        np.diff(np.unique(bench.part.rest_m[:, 2].round(9)))
    ).max() == pytest.approx(0.0125)
    with pytest.raises(ShapeError, match="outside the free soft material"):
        bench.part.track([[0.0, 0.0, 0.2]])


def test_nodes_in_a_grip_have_its_velocity_and_acceleration():
    bench = Bench(block(), depth_m=0.01285)
    # At a steady rate the nodes have the velocity of the plate, and its acceleration towards the axis.
    joint = bench.model.joint("high")
    bench.place([0.0, 0.0, 0.0])
    bench.data.qvel[joint.dofadr[0] : joint.dofadr[0] + 6] = [
        0.0,
        0.0,
        0.1,
        0.0,
        0.0,
        2.0,
    ]
    (grip,) = bench.part.grips
    grip.follow()
    ids = [bench.model.body(name).id for name in grip.names]
    arms = bench.model.body_pos[ids]
    dofs = bench.model.body_dofadr[ids][:, None] + np.arange(3)
    assert bench.data.qvel[dofs] == pytest.approx(
        np.cross([0.0, 0.0, 2.0], arms) + np.array([0.0, 0.0, 0.1])
    )
    inward = -4.0 * arms * [1.0, 1.0, 0.0]
    assert bench.data.xfrc_applied[ids, :3] == pytest.approx(1e3 * inward)


def hanging(cubes, **options):
    """A row without its high plate, held at the low end of its first body."""
    spec = mujoco.MjSpec()
    spec.option.timestep = 1 / 900
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.iterations = 2000
    spec.worldbody.add_body(name="low")
    bench = Bench.__new__(Bench)
    grip = {cubes[0].name: [held("low", Motion.FIXED)]}
    bench.part = part_of(spec, SoftRow.of(cubes[::-1], grip), **options)
    bench.model = spec.compile()
    bench.part.complete(bench.model)
    bench.data = mujoco.MjData(bench.model)
    bench.part.bind(bench.model, bench.data)
    bench.driven = False
    return bench


def test_blocks_of_unequal_length_move_like_the_same_row_in_equal_pieces():
    soft, heavy = (
        {"young_pa": 2e5, "density": 1000.0},
        {"young_pa": 4e5, "density": 5000.0},
    )
    turned = {"euler_deg": (-90.0, 0.0, 0.0)}

    def piece(name, low_m, length_m, kind):
        return block(
            name,
            centre_m=(0.0, low_m + 0.5 * length_m, 0.0),
            length_m=length_m,
            **turned,
            **kind,
        )

    unequal = [piece("arm", 0.0, 0.15, soft), piece("end", 0.15, 0.05, heavy)]
    equal = [piece(f"part-{index}", 0.05 * index, 0.05, soft) for index in range(3)] + [
        piece("tip", 0.15, 0.05, heavy)
    ]
    paths = []
    for bodies, cells in ((unequal, (3, 1)), (equal, (1, 1))):
        bench = hanging(bodies, cells=cells)
        end = bench.part.track([[0.0, 0.2, 0.0], [0.0, 0.1, 0.0]])
        bench.run(0.05)
        paths.append(end())
    np.testing.assert_allclose(paths[0], paths[1], atol=1e-12)
    assert paths[0][0, 2] < -1e-3


def test_a_row_that_touches_an_edge_stays_on_it(rollout):
    """The second cube of the beam touches the base that holds the first: a layer of 0.01 mm threw it 0.17 m aside."""
    env = rollout("CantileverBeam-soft", frames=8, marker_proxy="material")[0]
    moved_m = env.trajectory().markers_m - env.trajectory().markers_m[0]
    assert np.abs(moved_m[..., 0]).max() < 1e-3
