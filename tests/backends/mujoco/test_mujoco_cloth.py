"""Cloth in MuJoCo against closed forms: stretch, shear, bending, mass, and the rod that drives an edge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from cloths import CELL_M, FABRICS, fabric, heavy_elastica_sag_m, pinned

from gauge_envs import load_experiment
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.cloth import ClothPartMuJoCo, FoldWatch, add_cloth
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.runs.rollout import record
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Attachment,
    Box,
    Cloth,
    Contact,
    Motion,
    Pose,
    Region,
    RigidBody,
    Scene,
)
from gauge_envs.scene.driver_path import DriverPath
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S


class Rig:
    """A cloth alone in a model."""

    def __init__(
        self,
        cloth: Cloth,
        attachments: Sequence[RigidAttachment] = (),
        *,
        bending_n_m: float = 1e-6,
        gravity: float = 0.0,
        timestep_s: float = 0.05,
        cell_m: float = CELL_M,
        radius_m: float | None = None,
    ) -> None:
        self.spec = mujoco.MjSpec()
        self.spec.option.timestep = timestep_s
        self.spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        self.spec.option.gravity = [0.0, 0.0, -gravity]
        for name in {attachment.body for attachment in attachments}:
            self.spec.worldbody.add_body(name=name)
        self.part: ClothPartMuJoCo = add_cloth(
            self.spec,
            cloth,
            attachments=attachments,
            cell_m=cell_m,
            bending_stiffness_n_m=bending_n_m,
            contact_radius_m=radius_m,
        )

    def compile(self) -> Rig:
        self.model = self.spec.compile()
        self.part.complete(self.model)
        self.data = mujoco.MjData(self.model)
        self.part.bind(self.model, self.data)
        return self

    def pull(self, forces_n: np.ndarray) -> None:
        """Forces on all vertices, shape [vertex_count, 3]; pinned ones do not feel them."""
        for index, force in enumerate(forces_n):
            vertex = f"{self.part.name}/{index}"
            if mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, vertex) >= 0:
                first = self.model.body(vertex).dofadr[0]
                self.data.qfrc_applied[first : first + 3] = force

    def settle(self, steps: int = 1500) -> np.ndarray:
        """Vertices at rest: implicit steps far longer than any vibration damp it within a few of them."""
        for _ in range(steps // 10):
            mujoco.mj_step(self.model, self.data, nstep=10)
            if np.abs(self.data.qvel).max() < 1e-7:
                break
        assert np.abs(self.data.qvel).max() < 1e-5
        return self.part.nodes()


def line_shares(part: ClothPartMuJoCo, axis: int, at_m: float) -> np.ndarray:
    """Length of cloth that each vertex of a line across an axis stands for [m]; zero elsewhere."""
    rest, other = part.rest_m, 1 - axis
    ends = np.isclose(np.abs(rest[:, other]), np.abs(rest[:, other]).max())
    return np.where(
        np.isclose(rest[:, axis], at_m), np.where(ends, 0.5, 1.0) * CELL_M, 0.0
    )


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("name", FABRICS)
def test_a_pulled_strip_stretches_by_its_stiffness(name: str, axis: str) -> None:
    along = "xy".index(axis)
    rig = Rig(
        fabric(name, (0.2, 0.1) if axis == "x" else (0.1, 0.2)), [pinned(axis)]
    ).compile()
    strain, stiffness = 1e-3, fabric(name, (0.2, 0.1)).stretch_stiffness_n_per_m
    forces = np.zeros((len(rig.part.rest_m), 3))
    # Along a fibre of stretch 1 + e, St. Venant-Kirchhoff gives the force K (e + e^2/2) (1 + e) per width.
    forces[:, along] = (
        stiffness
        * (strain + 0.5 * strain**2)
        * (1.0 + strain)
        * line_shares(rig.part, along, 0.1)
    )
    rig.pull(forces)
    moved = rig.settle() - rig.part.rest_m
    assert moved[
        np.isclose(rig.part.rest_m[:, along], 0.1), along
    ] / 0.2 == pytest.approx(strain, rel=1e-4)
    assert np.abs(moved[:, 1 - along]).max() < 1e-7  # no Poisson effect


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("name", FABRICS)
def test_shear_force_is_the_shear_stiffness(name: str, axis: str) -> None:
    along = "xy".index(axis)
    cloth = fabric(name, (0.2, 0.1) if axis == "x" else (0.1, 0.2))
    rig = Rig(cloth).compile()
    angle = 1e-3
    displaced = np.zeros((len(rig.part.rest_m), 3))
    displaced[:, 1 - along] = angle * rig.part.rest_m[:, along]
    rig.data.qpos[:] = displaced.ravel()
    mujoco.mj_forward(rig.model, rig.data)
    forces = -rig.data.qfrc_spring.reshape(-1, 3)
    assert forces[
        np.isclose(rig.part.rest_m[:, along], 0.1), 1 - along
    ].sum() == pytest.approx(cloth.shear_stiffness_n_per_m * angle * 0.1, rel=0.002)
    inside = np.all(
        np.abs(rig.part.rest_m[:, :2]) < np.array(cloth.size_m) / 2 - 1e-6, axis=1
    )
    assert np.abs(forces[inside, :2]).max() < 1e-5 * np.abs(forces).max()


@pytest.mark.parametrize("angle_deg", [0, 20, 45, 70, 90, 135])
def test_bending_energy_is_that_of_an_isotropic_plate(angle_deg: float) -> None:
    """Cylinders in all directions: within the hinges that a mesh lacks along its rim, half a cell on each side."""
    bending, curvature, size = 1e-2, 1e-4, 0.5
    rig = Rig(fabric("rayon", (size, size)), bending_n_m=bending).compile()
    x, y = rig.part.rest_m[:, 0], rig.part.rest_m[:, 1]
    distance = np.cos(np.radians(angle_deg)) * x + np.sin(np.radians(angle_deg)) * y
    displaced = np.zeros((len(x), 3))
    displaced[:, 2] = 0.5 * curvature * distance**2
    rig.data.qpos[:] = displaced.ravel()
    mujoco.mj_forward(rig.model, rig.data)
    forces = rig.data.qfrc_spring.reshape(-1, 3)[:, 2]
    energy = -0.5 * forces @ displaced[:, 2]
    assert energy == pytest.approx(
        0.5 * bending * curvature**2 * size**2, rel=1.1 * CELL_M / size
    )
    inside = np.all(np.abs(rig.part.rest_m[:, :2]) < size / 2 - 2.5 * CELL_M, axis=1)
    assert np.abs(forces[inside]).max() < 1e-6 * np.abs(forces).max()


@pytest.mark.parametrize(
    ("name", "axis"), [("satin", "x"), ("oxford", "x"), ("oxford", "y")]
)
@pytest.mark.parametrize("slackness", [0.2, 5.0])
def test_cantilever_sags_like_an_elastica(
    name: str, axis: str, slackness: float
) -> None:
    """A strip clamped at one end sags under its weight: a little, and by more than half its length.

    A hinge spreads its fold over half a cell on either side, so a clamp of two lines of vertices acts halfway between
    them: the closed form's strip is half a cell longer than the free one. That is the mesh error; what is left is the
    rim, where folds along the weft lack one hinge in two.
    """
    along = "xy".index(axis)
    free_m = 0.3
    length_m = free_m + CELL_M
    cloth = fabric(name, (length_m, 0.4) if axis == "x" else (0.4, length_m))
    weight = cloth.areal_density_kg_per_m2 * GRAVITY_M_PER_S2
    bending = weight * free_m**3 / slackness
    rig = Rig(
        cloth,
        [pinned(axis, depth_m=CELL_M)],
        bending_n_m=bending,
        gravity=GRAVITY_M_PER_S2,
    ).compile()
    moved = rig.settle() - rig.part.rest_m
    tip = moved[np.isclose(rig.part.rest_m[:, along], 0.5 * length_m)].mean(axis=0)
    expected = heavy_elastica_sag_m(
        weight / bending, free_m + 0.5 * CELL_M, 0.5 * CELL_M
    )
    assert -tip[2] == pytest.approx(expected, rel=0.05)
    if slackness > 1.0:
        assert abs(tip[2]) > 0.5 * free_m


@pytest.mark.parametrize("name", FABRICS)
def test_cloth_has_its_mass_and_vertices_at_the_markers(name: str) -> None:
    scene = load_experiment(f"TextileFlinging-{name}").scene
    cloth = scene.deformables[0]
    assert isinstance(cloth, Cloth)
    rig = Rig(cloth).compile()
    assert rig.model.body_mass.sum() == pytest.approx(cloth.mass_kg, rel=1e-3)
    assert scene.markers is not None
    distances = np.linalg.norm(
        np.array(scene.markers.positions_m)[:, None] - rig.part.nodes(), axis=-1
    )
    assert distances.min(axis=1).max() < 1e-9


def test_the_compiled_table_of_an_isotropic_fabric_is_mujocos_own() -> None:
    """Stretch K and shear K/2 are a plate without Poisson effect, which MuJoCo derives itself."""
    cloth = fabric("rayon", (0.1, 0.1))
    rig = Rig(
        replace(cloth, shear_stiffness_n_per_m=0.5 * cloth.stretch_stiffness_n_per_m)
    )
    model = rig.spec.compile()
    theirs = model.flex_stiffness.copy()
    rig.part.complete(model)
    np.testing.assert_allclose(
        model.flex_stiffness, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max()
    )


@pytest.mark.slow
def test_a_swing_hardly_depends_on_the_step() -> None:
    """The integrator is first order: after 0.6 m, a quarter of the step moves the cloth by 1 mm."""
    scene, ends = load_experiment("TextileFlinging-satin").scene, []
    for rate in (900, 3600):
        simulation = BackendMuJoCo().build(scene, {"timestep_s": 1 / rate})
        ends.append(record(simulation, scene, 2.0).nodes_m["textile"][-1])
    assert np.sqrt(np.square(ends[0] - ends[1]).sum(axis=1).mean()) < 0.002


CONTACT = {
    "solref": [0.005, 1.0],
    "solimp": [0.9, 0.95, 0.001, 0.5, 2.0],
    "friction": [0.4, 0.0, 0.0],
}


def with_sphere(
    rig: Rig,
    *,
    at_m: tuple[float, float, float],
    radius_m: float,
    mass_kg: float | None,
) -> Rig:
    """A sphere that collides with the cloth; fixed without a mass."""
    body = rig.spec.worldbody.add_body(name="ball", pos=at_m)
    geom = body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[radius_m, 0.0, 0.0],
        contype=0,
        conaffinity=1,
    )
    if mass_kg is not None:
        body.add_freejoint(name="ball")
        geom.mass = mass_kg
    rig.part.flex.contype = 1
    for one in (geom, rig.part.flex):
        for key, value in CONTACT.items():
            setattr(one, key, value)
    return rig.compile()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["satin", "oxford"])
def test_a_cloth_drapes_over_a_sphere(name: str) -> None:
    center = np.array([0.004, 0.003, 0.057])
    above = Pose(position_m=(0.0, 0.0, 0.13))
    rig = Rig(
        fabric(name, (0.4, 0.4), above),
        gravity=GRAVITY_M_PER_S2,
        timestep_s=1 / 900,
        radius_m=0.002,
    )
    with_sphere(rig, at_m=tuple(center), radius_m=0.07, mass_kg=None)
    mujoco.mj_step(rig.model, rig.data, nstep=900)
    distances = np.linalg.norm(rig.part.nodes() - center, axis=1)
    assert distances.min() > 0.0715
    assert rig.part.nodes()[:, 2].max() > 0.12
    assert rig.part.nodes()[:, 2].min() < 0.05


@pytest.mark.slow
def test_a_ball_rests_on_a_taut_cloth() -> None:
    """It neither sinks through nor is thrown off, although it is heavier than the cloth below it."""
    frame = [pinned(axis, side) for axis in "xy" for side in ("low", "high")]
    cloth = fabric("oxford", (0.4, 0.4))
    rig = Rig(
        cloth, frame, gravity=GRAVITY_M_PER_S2, timestep_s=1 / 900, radius_m=0.002
    )
    with_sphere(rig, at_m=(0.004, 0.003, 0.035), radius_m=0.03, mass_kg=0.2)
    heights = []
    for _ in range(6 * 60):
        mujoco.mj_step(rig.model, rig.data, nstep=15)
        heights.append(rig.data.joint("ball").qpos[2])
    gap = (
        np.linalg.norm(rig.part.nodes() - rig.data.joint("ball").qpos[:3], axis=1).min()
        - 0.032
    )
    assert gap > -0.001
    assert np.ptp(heights[-60:]) < 0.005
    assert -0.02 < np.mean(heights[-60:]) < 0.02


@pytest.mark.slow
def test_a_dropped_cloth_does_not_pass_through_itself() -> None:
    upright = Pose.from_euler_deg((0.0, 0.0, 0.21), (0.0, -90.0, 0.0))
    rig = Rig(
        fabric("satin", (0.4, 0.2), upright),
        gravity=GRAVITY_M_PER_S2,
        timestep_s=1 / 900,
        radius_m=0.002,
    )
    plane = rig.spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05], contype=0, conaffinity=2
    )
    flex = rig.part.flex
    flex.contype, flex.conaffinity = 3, 1
    flex.selfcollide = mujoco.mjtFlexSelf.mjFLEXSELF_AUTO
    for one in (plane, flex):
        for key, value in CONTACT.items():
            setattr(one, key, value)
    rig.compile()
    # It buckles to both sides.
    rig.data.qvel.reshape(-1, 3)[:, 0] = 0.2 * np.sin(20.0 * rig.part.rest_m[:, 2])
    for _ in range(12):
        mujoco.mj_step(rig.model, rig.data, nstep=90)
        assert (
            crossings(
                rig.part.nodes(),
                rig.model.flex_edge,
                rig.model.flex_elem.reshape(-1, 3),
            )
            == 0
        )
    assert rig.part.nodes()[:, 2].min() > 0.0015
    assert rig.part.nodes()[:, 2].max() > 0.01


def crossings(nodes: np.ndarray, edges: np.ndarray, triangles: np.ndarray) -> int:
    """How many edges pierce a triangle that they share no vertex with (Moeller and Trumbore)."""
    start, along = (
        nodes[edges[:, 0], None],
        (nodes[edges[:, 1]] - nodes[edges[:, 0]])[:, None],
    )
    a, b, c = (nodes[triangles[:, k]] for k in range(3))
    side = np.cross(along, c - a)
    determinant = np.sum(side * (b - a), axis=-1)
    scale = 1.0 / np.where(np.abs(determinant) > 1e-14, determinant, np.inf)
    other = np.cross(start - a, b - a)
    u = np.sum((start - a) * side, axis=-1) * scale
    v = np.sum(along * other, axis=-1) * scale
    t = np.sum((c - a) * other, axis=-1) * scale
    shared = (edges[:, None, :, None] == triangles[None, :, None, :]).any(axis=(2, 3))
    inside = (u > 0) & (v > 0) & (u + v < 1) & (t > 0) & (t < 1) & (scale != 0)
    return int((inside & ~shared).sum())


# --- bodies on cloth -------------------------------------------------------------------------------------------------


def test_every_pair_gets_its_own_friction() -> None:
    """A flex has one friction only; a cube on the cloth has another than the cloth on the table."""
    scene = load_experiment("TableclothPulling-metal").scene
    simulation = BackendMuJoCo().build(scene)
    simulation.reset(0)
    simulation.advance(SAMPLE_INTERVAL_S)
    model, data = simulation.model, simulation.data
    wanted = {c.first + c.second: c.friction for c in scene.contacts}
    assert wanted[("cube", "textile")] != wanted[("textile", "table")]
    seen = {"cube": set(), "table": set()}
    for contact in data.contact:
        if contact.flex.max() >= 0:
            geom = int(contact.geom.max())
            seen[model.body(model.geom_bodyid[geom]).name].add(
                float(contact.friction[0])
            )
    assert seen == {
        "cube": {wanted[("cube", "textile")]},
        "table": {wanted[("textile", "table")]},
    }


def on_a_slope(
    cloth: Cloth, *, friction: float = 0.3, below: float = 0.1, degrees: float = 10.0
) -> Scene:
    """A metal cube of 0.34 kg on a cloth of 0.3 m that hangs from its upper edge and lies on a slab."""
    slope = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, degrees, 0.0))

    def lying(
        name: str, size_m: tuple[float, float, float], height_m: float, motion: Motion
    ) -> RigidBody:
        place = tuple(float(x) for x in slope.to_world(np.array([0.0, 0.0, height_m])))
        pose = Pose(position_m=place, quaternion=slope.quaternion)
        return RigidBody(
            name=name, shape=Box(size_m=size_m), motion=motion, pose=pose, mass_kg=0.34
        )

    cloth = replace(cloth, size_m=(0.3, 0.15), pose=slope)
    half = 0.5 * cloth.thickness_m
    return Scene(
        bodies=(
            lying("slab", (0.6, 0.4, 0.02), -0.01 - half, Motion.FIXED),
            lying("cube", (0.05, 0.05, 0.05), 0.025 + half, Motion.DYNAMIC),
            lying("bar", (0.01, 0.01, 0.01), 1.0, Motion.FIXED),
        ),
        deformables=(cloth,),
        attachments=(
            Attachment(
                deformable="textile", region=Region(axis="x", side="low"), to="bar"
            ),
        ),
        contacts=(
            Contact(
                first=("cube",), second=("textile",), friction=friction, restitution=0.0
            ),
            Contact(
                first=("textile",), second=("slab",), friction=below, restitution=0.0
            ),
        ),
        duration_s=1.0,
    )


NYLON = load_experiment("TableclothPulling-metal").scene.deformables[0]
assert isinstance(NYLON, Cloth)


STRIPS = [
    pytest.param(fabric(name, (0.3, 0.15)), marks=pytest.mark.slow, id=name)
    for name in ("satin", "oxford", "leather")
]


@pytest.mark.parametrize("cloth", [NYLON, *STRIPS])
def test_a_cube_on_cloth_holds_while_the_slope_is_less_than_friction(
    cloth: Cloth,
) -> None:
    scene = on_a_slope(cloth)
    simulation = BackendMuJoCo().build(scene)
    simulation.reset(0)
    ways_m, start = [], np.asarray(scene.body("cube").pose.position_m)
    for _ in range(6):
        simulation.advance(0.1)
        way = simulation.body_states(["cube"])[0, :3] - start
        ways_m.append(scene.body("slab").pose.rotation.apply(way, inverse=True))
    downhill, _, off = np.transpose(ways_m)
    # On a rigid slope the best known real cubes leave room for 1.4 to 2.5 mm/s.
    assert abs(downhill[-1] - downhill[2]) / 0.3 < 0.002
    assert off.min() > -cloth.thickness_m


@pytest.mark.parametrize("cell_m", [0.05, 0.025])
def test_a_patch_of_any_cloth_is_as_soft(cell_m: float) -> None:
    """MuJoCo's regularization of a vertex' contact, over the number of vertices on an area."""
    for name in ("satin", "leather"):
        simulation = BackendMuJoCo().build(
            on_a_slope(fabric(name, (0.3, 0.15))), {"cell_m": cell_m}
        )
        bodies = [
            simulation.model.body(index) for index in range(simulation.model.nbody)
        ]
        # At the rim they weigh half or a quarter.
        mass = max(
            float(body.mass[0]) for body in bodies if body.name.startswith("textile/")
        )
        impedance = float(simulation.model.flex_solimp[0, 0])
        assert (1.0 - impedance) / (impedance * mass) * cell_m**2 == pytest.approx(
            0.0375
        )
        assert simulation.model.flex_solimp[0, 1] == impedance


def test_impedance_of_cloth_may_be_given_itself() -> None:
    both = {"cloth_solimp": (0.9, 0.95, 0.001), "cloth_softness_m2_per_kg": None}
    model = BackendMuJoCo().build(on_a_slope(NYLON), both).model
    assert model.flex_solimp[0].tolist() == [0.9, 0.95, 0.001, 0.5, 2.0]


def test_frictions_that_neither_flex_nor_geoms_can_carry_are_declined() -> None:
    scene = on_a_slope(NYLON)
    other = replace(scene.deformables[0], name="other")
    scene = replace(scene, deformables=(*scene.deformables, other))
    alone = Contact(first=("other",), second=("slab",), friction=0.5, restitution=0.0)
    both = replace(alone, second=("textile",))
    support = BackendMuJoCo().supports(replace(scene, contacts=(*scene.contacts, both)))
    assert (
        "['other', 'textile'] touch each other and other bodies with different friction"
        in support.missing[0]
    )
    assert BackendMuJoCo().supports(scene)


# --- solver -----------------------------------------------------------------------------------------------------------


def swung(settings: dict[str, object], duration_s: float = 0.3) -> np.ndarray:
    """Nodes of a satin that a rod swings [m]."""
    experiment = load_experiment("TextileFlinging-satin")
    scene = replace(
        experiment.scene,
        deformables=(replace(experiment.scene.deformables[0], size_m=(0.5, 0.1)),),
    )
    simulation = BackendMuJoCo().build(scene, settings)
    simulation.reset(0)
    path = DriverPath(scene.drivers[0], scene, experiment.frame_count)
    for sample in range(round(duration_s / SAMPLE_INTERVAL_S)):
        simulation.drive("rod", *path.interval(sample, np.zeros(path.motion_count)))
        simulation.advance(SAMPLE_INTERVAL_S)
    return simulation.nodes("textile")


def test_conjugate_gradients_move_cloth_like_newtons_method() -> None:
    tight = swung({"solver": "Newton", "tolerance": 1e-12})
    assert np.abs(tight - swung({}, 0.0)).max() > 0.01, "the cloth swings"
    # A tenth of what half the step moves a flung cloth in 2 s, 0.5 mm.
    assert np.abs(swung({}) - tight).max() < 5e-5
    assert np.abs(swung({"tolerance": 1e-8}) - tight).max() < 5e-6
    assert np.abs(swung({"iterations": 1}) - tight).max() > 5e-5, (
        "one iteration does not solve a step"
    )


# --- search for contacts with itself ----------------------------------------------------------------------------------


def folded(
    monkeypatch: pytest.MonkeyPatch, watch: str, answer: bool | None
) -> tuple[np.ndarray, list[tuple[bool, int]]]:
    """Nodes of a cloth whose lower half flies against the upper one; and of each interval, whether it was searched."""
    with monkeypatch.context() as patch:
        if answer is not None:
            patch.setattr(FoldWatch, watch, lambda *_: answer)
        scene = load_experiment("TextileFlinging-satin").scene
        cloth = replace(scene.deformables[0], size_m=(0.3, 0.1))
        scene = replace(scene, deformables=(cloth,), gravity_m_per_s2=0.0)
        simulation = BackendMuJoCo().build(scene, {})
        simulation.reset(0)
        nodes = simulation.nodes("textile")
        part = simulation._parts["textile"]
        low = (nodes[:, 2].max() - nodes[:, 2])[part.points.free]
        simulation.data.qvel[part.points.dofs[:, 2]] = 7.0 * low
        simulation.data.qvel[part.points.dofs[:, 0]] = np.sin(np.pi * low / 0.3)
        frames, searched = [], []
        original = SimulationMuJoCo._steps

        def steps(self: SimulationMuJoCo, count: int) -> None:
            original(self, count)
            has_search = (
                not self.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
            )
            searched.append((has_search, int(self.data.ncon)))

        patch.setattr(SimulationMuJoCo, "_steps", steps)
        for _ in range(90):
            simulation.advance(SAMPLE_INTERVAL_S)
            frames.append(simulation.nodes("textile"))
        assert (
            not simulation.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
        )
    return np.array(frames), searched


def test_a_cloth_that_cannot_touch_itself_is_not_searched_and_moves_to_the_same_bits(
    monkeypatch,
) -> None:
    always, _ = folded(monkeypatch, "stays_apart", False)
    ours, searched = folded(monkeypatch, "stays_apart", None)
    assert np.array_equal(ours, always)
    assert max(contacts for _, contacts in searched) > 0, "the cloth touches itself"
    assert not all(has_search for has_search, _ in searched)
    never, _ = folded(monkeypatch, "_is_apart", True)
    assert not np.array_equal(never, always), (
        "layers that are taken to be apart pass through each other"
    )
