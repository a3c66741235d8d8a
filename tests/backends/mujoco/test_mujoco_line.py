"""Ropes and rods in MuJoCo against closed forms: stretch, swing, bending, friction."""

from __future__ import annotations

from math import cos, pi, sin

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_bvp, solve_ivp
from scipy.spatial.transform import Rotation

from gauge_envs.backends.mujoco.line import LinePartMuJoCo, add_rod, add_rope
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.errors import ShapeError, UnsupportedSceneError
from gauge_envs.scene import GRAVITY_M_PER_S2, Motion, Pose, Region, Rod, Rope

ROPE_M = 0.34
BALL_KG = 0.3122
BALL_M = 0.03
ROD_M = 0.15
ROD_RADIUS_M = 0.005
SOFT_PA, HARD_PA = 9285115.0, 1e9
DISCRETE, FAST = (
    mujoco.mjtIntegrator.mjINT_DISCRETE,
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
)
TOP = Pose(position_m=(0.0, 0.0, 0.0))


class Bench:
    """A line with a body at its start, in a model of its own."""

    def __init__(
        self, *, step_s: float, integrator: int, gravity: float = GRAVITY_M_PER_S2
    ) -> None:
        self.spec = mujoco.MjSpec()
        self.spec.option.timestep = step_s
        self.spec.option.integrator = integrator
        self.spec.option.gravity = [0.0, 0.0, -gravity]
        self.spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        self.spec.option.impratio = 10.0

    def add_body(
        self, name: str, pose: Pose, motion: Motion, mass_kg: float = 1e3
    ) -> mujoco.MjsBody:
        body = self.spec.worldbody.add_body(
            name=name, pos=pose.position_m, quat=pose.quaternion
        )
        if motion is not Motion.FIXED:
            body.add_freejoint(name=name)
            body.explicitinertial, body.mass = True, mass_kg
            body.inertia = [
                mass_kg if motion is Motion.KINEMATIC else 0.4 * mass_kg * BALL_M**2
            ] * 3
            body.gravcomp = float(motion is Motion.KINEMATIC)
            body.ipos = [0.0, 0.0, 0.0]
        return body

    def finish(self, part: LinePartMuJoCo) -> None:
        self.part = part
        self.model = self.spec.compile()
        part.complete(self.model)
        self.data = mujoco.MjData(self.model)
        part.bind(self.model, self.data)

    def place(self, name: str, pose: Pose) -> None:
        joint = self.model.joint(name)
        position, speed = int(joint.qposadr[0]), int(joint.dofadr[0])
        self.data.qpos[position : position + 7] = [*pose.position_m, *pose.quaternion]
        self.data.qvel[speed : speed + 6] = 0.0

    def steps(self, seconds: float) -> int:
        return round(seconds / self.model.opt.timestep)

    def lengths(self) -> NDArray[np.float64]:
        """Distances of neighbouring nodes as parts of those at rest, less one."""
        rest, now = (
            np.linalg.norm(np.diff(x, axis=0), axis=1)
            for x in (self.part.rest_m, self.part.nodes())
        )
        return now / rest - 1.0


def ball_on_rope(
    direction: tuple[float, float, float], motion: Motion = Motion.FIXED
) -> Bench:
    """A ball on a rope that starts straight in a direction, both above the origin's height; its top end at TOP."""
    bench = Bench(step_s=1 / 9000, integrator=FAST)
    turn = Rotation.align_vectors([direction], [[1.0, 0.0, 0.0]])[0]
    x, y, z, w = turn.as_quat()
    end = np.array(direction)
    rope = Rope(
        name="rope",
        pose=Pose(position_m=tuple(0.5 * ROPE_M * end), quaternion=(w, x, y, z)),
        length_m=ROPE_M,
        radius_m=0.002,
        mass_kg=0.005,
        young_modulus_pa=795.0,
    )
    pose = Pose(position_m=tuple((ROPE_M + BALL_M) * end))
    bench.add_body("top", TOP, motion)
    bench.add_body("ball", pose, Motion.DYNAMIC, BALL_KG)
    attachments = [
        RigidAttachment(
            region=Region(axis="x", side="low"), body="top", motion=motion, pose=TOP
        ),
        RigidAttachment(
            region=Region(axis="x", side="high"),
            body="ball",
            motion=Motion.DYNAMIC,
            pose=pose,
        ),
    ]
    bench.finish(add_rope(bench.spec, rope, attachments=attachments))
    return bench


def test_rope_carries_a_ball_without_stretching() -> None:
    bench = ball_on_rope((0.0, 0.0, -1.0))
    assert np.allclose(bench.part.nodes(), bench.part.rest_m, atol=1e-12)
    mujoco.mj_step(bench.model, bench.data, nstep=bench.steps(0.5))
    assert 0.0 < bench.lengths().mean() < 5e-4
    bodies = [
        i
        for i in range(bench.model.nbody)
        if bench.model.body(i).name.startswith("rope")
    ]
    assert bench.model.body_mass[bodies].sum() == pytest.approx(0.005 * 33 / 34)


def test_ball_swings_from_level_like_a_pendulum() -> None:
    bench = ball_on_rope((1.0, 0.0, 0.0))
    joint = bench.model.joint("ball")
    position, speed = int(joint.qposadr[0]), int(joint.dofadr[0])
    worst = 0.0
    for _ in range(30):
        mujoco.mj_step(bench.model, bench.data, nstep=bench.steps(0.01))
        worst = max(worst, float(np.abs(bench.lengths()).max()))
    assert worst < 2e-3
    # A point mass on a massless string; the rope's weight is 1.6 % of the ball's.
    fall = solve_ivp(
        lambda _, s: [s[1], GRAVITY_M_PER_S2 / (ROPE_M + BALL_M) * cos(s[0])],
        (0.0, 0.3),
        [0.0, 0.0],
        rtol=1e-9,
    )
    angle = fall.y[0, -1]
    expected = (ROPE_M + BALL_M) * np.array([cos(angle), 0.0, -sin(angle)])
    assert bench.data.qpos[position : position + 3] == pytest.approx(expected, abs=4e-3)
    assert np.linalg.norm(bench.data.qvel[speed : speed + 3]) == pytest.approx(
        (ROPE_M + BALL_M) * fall.y[1, -1], rel=0.02
    )


def test_rope_follows_a_driven_body() -> None:
    bench = ball_on_rope((0.0, 0.0, -1.0), Motion.KINEMATIC)
    for index in range(36):
        bench.place("top", Pose(position_m=(0.0, 0.0, 1e-3 * index)))
        mujoco.mj_step(bench.model, bench.data, nstep=50)
    bench.place("top", Pose(position_m=(0.0, 0.0, 0.035)))
    assert bench.part.nodes()[0] == pytest.approx([0.0, 0.0, 0.035])


def test_two_balls_hang_over_a_beam() -> None:
    """The rope stays on the beam although it weighs a hundredth of what pulls on it."""
    bench = Bench(step_s=1 / 9000, integrator=FAST)
    beam = bench.spec.worldbody.add_body(
        name="beam", pos=[0.0, 0.0, -0.007], quat=[0.5**0.5, 0.5**0.5, 0.0, 0.0]
    )
    beam.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[0.005, 0.1, 0.0],
        contype=0,
        conaffinity=1,
    )
    rope = Rope(
        name="rope",
        pose=TOP,
        length_m=ROPE_M,
        radius_m=0.002,
        mass_kg=0.005,
        young_modulus_pa=795.0,
    )
    attachments = []
    for name, side, sign in (("a", "low", -1.0), ("b", "high", 1.0)):
        pose = Pose(position_m=(sign * (0.5 * ROPE_M + BALL_M), 0.0, 0.0))
        bench.add_body(name, pose, Motion.DYNAMIC, BALL_KG)
        attachments.append(
            RigidAttachment(
                region=Region(axis="x", side=side),
                body=name,
                motion=Motion.DYNAMIC,
                pose=pose,
            )
        )
    part = add_rope(bench.spec, rope, attachments=attachments)
    part.flex.contype, part.flex.condim, part.flex.friction = 1, 3, [0.467, 0.0, 0.0]
    bench.finish(part)
    lowest = 0.0
    for _ in range(40):
        mujoco.mj_step(bench.model, bench.data, nstep=bench.steps(0.01))
        assert np.abs(bench.lengths()).max() < 0.02
        lowest = min(lowest, float(part.nodes()[[0, -1], 2].max()))
    assert lowest < -0.13
    # The segments touch the beam, so that the node between them stands off by up to 2.5 mm.
    assert part.nodes()[17] == pytest.approx([0.0, 0.0, 1.25e-3], abs=1.25e-3)


def rod(
    young_pa: float, motion: Motion, *, step_s: float = 1 / 900, damping_s: float = 0.01
) -> Bench:
    """A rod that hangs from the origin without weight, by its high end."""
    bench = Bench(step_s=step_s, integrator=DISCRETE, gravity=0.0)
    bench.add_body("base", TOP, motion)
    body = Rod(
        name="rod",
        pose=Pose(position_m=(0.0, 0.0, -0.5 * ROD_M)),
        length_m=ROD_M,
        radius_m=ROD_RADIUS_M,
        mass_kg=0.0149,
        young_modulus_pa=young_pa,
        poisson_ratio=0.49,
    )
    attachments = [
        RigidAttachment(
            region=Region(axis="z", side="high"), body="base", motion=motion, pose=TOP
        )
    ]
    bench.finish(
        add_rod(bench.spec, body, attachments=attachments, damping_s=damping_s)
    )
    return bench


def load(bench: Bench, force_n: float, seconds: float = 1.5) -> NDArray[np.float64]:
    """Nodes after a force has pulled the free end along x for a while."""
    tip = bench.model.flex_vertbodyid[0]
    bench.data.xfrc_applied[tip, 0] = force_n
    for _ in range(round(180 * seconds)):
        if bench.model.joint(0).type[0] == mujoco.mjtJoint.mjJNT_FREE:
            bench.place("base", TOP)
        mujoco.mj_step(bench.model, bench.data, nstep=bench.steps(1 / 180))
    return bench.part.nodes()


@pytest.mark.parametrize("motion", [Motion.FIXED, Motion.KINEMATIC])
@pytest.mark.parametrize("young_pa", [SOFT_PA, HARD_PA])
def test_clamped_rod_bends_as_theory_says(young_pa: float, motion: Motion) -> None:
    rigidity = young_pa * pi / 4 * ROD_RADIUS_M**4
    bench = rod(young_pa, motion)
    nodes = load(bench, 3e-3 * rigidity / ROD_M**3)
    assert nodes[0, 2] == pytest.approx(-ROD_M, abs=2e-5)
    assert nodes[0, 0] == pytest.approx(1e-3, rel=0.005)
    places = -bench.part.rest_m[:-2, 2]
    line = 0.5e-3 * (3 * (places / ROD_M) ** 2 - (places / ROD_M) ** 3)
    assert nodes[:-2, 0] == pytest.approx(line, abs=5e-6)


def test_large_deflection_is_the_elastica() -> None:
    rigidity = SOFT_PA * pi / 4 * ROD_RADIUS_M**4
    force = 2.5 * rigidity / ROD_M**2
    solution = solve_bvp(
        lambda s, y: np.array([y[1], -2.5 * np.cos(y[0])]),
        lambda a, b: np.array([a[0], b[1]]),
        np.linspace(0, 1, 50),
        np.zeros((2, 50)),
        tol=1e-8,
    )
    s = np.linspace(0, 1, 1001)
    across = np.trapezoid(np.sin(solution.sol(s)[0]), s) * ROD_M
    nodes = load(rod(SOFT_PA, Motion.FIXED), force, 2.5)
    assert nodes[0, 0] == pytest.approx(across, rel=0.005)


def test_points_on_the_surface_turn_with_the_rod() -> None:
    bench = rod(SOFT_PA, Motion.FIXED)
    rest = np.array([[0.005, 0.0, -0.14], [0.0, 0.0, -0.14], [0.0, -0.005, -0.05]])
    read = bench.part.track(rest)
    assert np.allclose(read(), rest, atol=1e-12)
    rigidity = SOFT_PA * pi / 4 * ROD_RADIUS_M**4
    nodes = load(bench, 1.0 * rigidity / ROD_M**2)
    surface, centre, other = read()
    tangent = nodes[0] - nodes[2]
    assert np.linalg.norm(surface - centre) == pytest.approx(0.005)
    assert (surface - centre) @ tangent == pytest.approx(0.0, abs=5e-6)
    assert other[1] == pytest.approx(-0.005)
    with pytest.raises(ShapeError, match="beyond an end"):
        bench.part.track([[0.0, 0.0, -0.2]])


@pytest.mark.parametrize(
    ("young_pa", "friction"), [(SOFT_PA, 0.8087), (HARD_PA, 0.5801)]
)
def test_foot_that_slides_feels_the_friction(young_pa: float, friction: float) -> None:
    """The base moves sideways a tenth of a millimetre too low. The stiff rod sticks and slides, the other slides."""
    bench = rod(young_pa, Motion.KINEMATIC)
    spec = bench.spec
    board = spec.worldbody.add_body(name="board", pos=[0.0, 0.0, -ROD_M - 0.005])
    board.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.5, 0.1, 0.005], contype=0, conaffinity=1
    )
    for geom in bench.part.geoms:
        geom.contype, geom.friction, geom.priority = 1, [friction, 0.0, 0.0], 1
    spec.option.timestep = 1 / 1800
    spec.option.gravity = [0.0, 0.0, -GRAVITY_M_PER_S2]
    bench.finish(bench.part)
    ratios = []
    foot = bench.model.flex_vertbodyid[0]
    bench.data.xfrc_applied[foot, 2] = -0.3
    force = np.empty(6)
    for index in range(180):
        time = index / 180
        bench.place(
            "base", Pose(position_m=(0.017 * time, 0.0, -1e-4 * min(4 * time, 1.0)))
        )
        bench.data.qvel[bench.model.joint("base").dofadr[0]] = 0.017
        mujoco.mj_step(bench.model, bench.data, nstep=10)
        if index > 120:
            for contact in range(bench.data.ncon):
                mujoco.mj_contactForce(bench.model, bench.data, contact, force)
                ratios.append(np.hypot(force[1], force[2]) / force[0])
    assert len(ratios) > 20
    assert np.median(ratios) == pytest.approx(friction, rel=1e-3)
    assert max(ratios) < 1.001 * friction
    assert bench.part.nodes()[0, 2] == pytest.approx(-ROD_M, abs=5e-5)


def test_what_cannot_be_built_is_named() -> None:
    bench = Bench(step_s=1 / 900, integrator=DISCRETE)
    rope = Rope(
        name="rope",
        pose=TOP,
        length_m=1.0,
        radius_m=0.002,
        mass_kg=0.01,
        young_modulus_pa=1.0,
    )
    wrong = {"x": (0.1, "over a length"), "y": (0.0, "elsewhere")}
    for axis, (depth, message) in wrong.items():
        attachment = RigidAttachment(
            region=Region(axis=axis, side="low", depth_m=depth),
            body="top",
            motion=Motion.FIXED,
            pose=TOP,
        )
        with pytest.raises(UnsupportedSceneError, match=message):
            add_rope(bench.spec, rope, attachments=[attachment])
