"""A rod in MuJoCo against closed forms: small deflections of all stiffnesses, and friction of its foot."""

from math import pi

import mujoco
import numpy as np
import pytest
from foam import held

from gauge_envs.backends.mujoco.line import add_rod
from gauge_envs.scene import GRAVITY_M_PER_S2, Motion, Pose, Rod

ROD_M, ROD_RADIUS_M = 0.15, 0.005
SOFT_PA, HARD_PA = 9285115.0, 1e9


class Bench:
    """A rod that hangs from the origin by its high end, without weight."""

    def __init__(self, young_pa, motion, steps_per_s=900):
        self.spec = mujoco.MjSpec()
        option = self.spec.option
        option.timestep, option.gravity, option.impratio = (
            1 / steps_per_s,
            [0.0] * 3,
            10.0,
        )
        option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        base = self.spec.worldbody.add_body(name="base")
        if motion is Motion.KINEMATIC:
            base.add_freejoint(name="base")
            base.explicitinertial, base.mass, base.gravcomp = True, 1e3, 1.0
            base.inertia, base.ipos = [1e3] * 3, [0.0] * 3
        self.is_driven = motion is Motion.KINEMATIC
        rod = Rod(
            name="rod",
            pose=Pose(position_m=(0.0, 0.0, -0.5 * ROD_M)),
            length_m=ROD_M,
            radius_m=ROD_RADIUS_M,
            mass_kg=0.0149,
            young_modulus_pa=young_pa,
            poisson_ratio=0.49,
        )
        grip = held("high", motion, body="base")
        self.part = add_rod(self.spec, rod, attachments=[grip], damping_s=0.01)
        self.finish()

    def finish(self):
        self.model = self.spec.compile()
        self.part.complete(self.model)
        self.data = mujoco.MjData(self.model)
        self.part.bind(self.model, self.data)

    def place(self, x=0.0, z=0.0, speed=0.0):
        """Put the driven base."""
        self.data.qpos[:7] = [x, 0.0, z, 1.0, 0.0, 0.0, 0.0]
        self.data.qvel[:6] = [speed, 0.0, 0.0, 0.0, 0.0, 0.0]

    def load(self, force_n, seconds=1.5, axis=0):
        """Nodes after a force has pulled the free end along an axis for a while."""
        self.data.xfrc_applied[self.model.flex_vertbodyid[0], axis] = force_n
        steps = round(1.0 / (180 * self.model.opt.timestep))
        for _ in range(round(180 * seconds)):
            if self.is_driven:
                self.place()
            mujoco.mj_step(self.model, self.data, nstep=steps)
        return self.part.nodes()


@pytest.mark.parametrize("motion", [Motion.FIXED, Motion.KINEMATIC])
@pytest.mark.parametrize("young_pa", [SOFT_PA, HARD_PA])
def test_clamped_rod_bends_as_theory_says(young_pa, motion):
    rigidity = young_pa * pi / 4 * ROD_RADIUS_M**4
    bench = Bench(young_pa, motion)
    nodes = bench.load(3e-3 * rigidity / ROD_M**3)
    assert nodes[0, 2] == pytest.approx(-ROD_M, abs=2e-5)
    assert nodes[0, 0] == pytest.approx(1e-3, rel=0.005)
    places = -bench.part.rest_m[:-2, 2]
    line = 0.5e-3 * (3 * (places / ROD_M) ** 2 - (places / ROD_M) ** 3)
    assert nodes[:-2, 0] == pytest.approx(line, abs=5e-6)


@pytest.mark.parametrize(
    ("young_pa", "steps_per_s", "motion"),
    [
        (SOFT_PA, 900, Motion.FIXED),
        (SOFT_PA, 3600, Motion.KINEMATIC),
        (HARD_PA, 3600, Motion.FIXED),
    ],
)
def test_pulled_rod_stretches_as_theory_says(young_pa, steps_per_s, motion):
    """A force along the rod moves its end by F L / (E A), at every step that lets the rod be as stiff."""
    bench = Bench(young_pa, motion, steps_per_s)
    stretch_m = 1e-4 * ROD_M
    force_n = stretch_m / ROD_M * young_pa * pi * ROD_RADIUS_M**2
    nodes = bench.load(-force_n, axis=2)
    assert -ROD_M - nodes[0, 2] == pytest.approx(stretch_m, rel=2e-3)


@pytest.mark.parametrize(
    ("young_pa", "friction"), [(SOFT_PA, 0.8087), (HARD_PA, 0.5801)]
)
def test_foot_that_slides_feels_the_friction(young_pa, friction):
    """The base moves sideways a tenth of a millimetre too low. The stiff rod sticks and slides, the other slides."""
    bench = Bench(young_pa, Motion.KINEMATIC)
    spec = bench.spec
    board = spec.worldbody.add_body(name="board", pos=[0.0, 0.0, -ROD_M - 0.005])
    board.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.5, 0.1, 0.005], contype=0, conaffinity=1
    )
    for geom in bench.part.geoms:
        geom.contype, geom.friction, geom.priority = 1, [friction, 0.0, 0.0], 1
    spec.option.timestep = 1 / 1800
    spec.option.gravity = [0.0, 0.0, -GRAVITY_M_PER_S2]
    bench.finish()
    ratios = []
    foot = bench.model.flex_vertbodyid[0]
    bench.data.xfrc_applied[foot, 2] = -0.3
    force = np.empty(6)
    for index in range(180):
        time = index / 180
        bench.place(0.017 * time, -1e-4 * min(4 * time, 1.0), 0.017)
        mujoco.mj_step(bench.model, bench.data, nstep=10)
        if index > 120:
            for contact in range(bench.data.ncon):
                mujoco.mj_contactForce(bench.model, bench.data, contact, force)
                ratios.append(np.hypot(force[1], force[2]) / force[0])
    assert len(ratios) > 20
    assert np.median(ratios) == pytest.approx(friction, rel=1e-3)
    assert max(ratios) < 1.001 * friction
    assert bench.part.nodes()[0, 2] == pytest.approx(-ROD_M, abs=5e-5)
