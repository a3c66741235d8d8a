"""Cloth in MuJoCo against closed forms: stretch, shear, bending, mass, and the rod that drives an edge."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from cloths import CELL_M, FABRICS, fabric

from gauge_envs import load_experiment
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.cloth import FoldWatch, add_cloth
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.scene import (
    Attachment,
    Pose,
    Region,
    Scene,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.bench.parts import box, contact, fixed_box
from gauge_envs.tools.bench.recording import record


def sheet_of(cloth, bending_n_m=1e-6):
    """Return a cloth alone in a model, the model, and its data."""
    spec = mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    part = add_cloth(
        spec, cloth, attachments=(), cell_m=CELL_M, bending_stiffness_n_m=bending_n_m
    )
    model = spec.compile()
    part.complete(model)
    data = mujoco.MjData(model)
    part.bind(model, data)
    return part, model, data


def energy_j(cloth, displace, **bending):
    """Return the elastic energy [J] of a displacement, a function of the rest points, shape [vertex_count, 3]."""
    part, model, data = sheet_of(cloth, **bending)
    displaced_m = displace(*part.rest_m.T)
    data.qpos[:] = displaced_m.ravel()
    mujoco.mj_forward(model, data)
    forces_n = data.qfrc_spring.reshape(-1, 3)
    inside = np.all(
        np.abs(part.rest_m[:, :2]) < 0.5 * np.array(cloth.size_m) - 2.5 * CELL_M, axis=1
    )
    along_n = forces_n[:, np.abs(displaced_m).max(axis=0) > 0.0]
    assert np.abs(along_n[inside]).max() < 1e-5 * np.abs(along_n).max()
    return -0.5 * float((forces_n * displaced_m).sum())


@pytest.mark.parametrize("name", FABRICS)
def test_a_strained_sheet_has_the_energy_of_its_stiffnesses(name):
    """Per area K e^2 / 2 of a strain along warp or weft, with no Poisson effect, and K_sh g^2 / 2 of a shear."""
    cloth, strain = fabric(name, (0.2, 0.15)), 1e-4
    stretch, shear = cloth.stretch_stiffness_n_per_m, cloth.shear_stiffness_n_per_m
    cases = (
        (lambda x, y, z: strain * np.stack([x, z, z], axis=1), stretch),
        (lambda x, y, z: strain * np.stack([z, y, z], axis=1), stretch),
        (lambda x, y, z: strain * np.stack([x, y, z], axis=1), 2.0 * stretch),
        (lambda x, y, z: strain * np.stack([y, z, z], axis=1), shear),
        (lambda x, y, z: strain * np.stack([z, x, z], axis=1), shear),
    )
    for displace, stiffness in cases:
        expected = 0.5 * stiffness * strain**2 * 0.2 * 0.15
        assert energy_j(cloth, displace) == pytest.approx(expected, rel=2e-3, abs=0.0)


@pytest.mark.parametrize("angle_deg", [0, 20, 45, 70, 90, 135])
def test_bending_energy_is_that_of_an_isotropic_plate(angle_deg):
    """Cylinders in all directions: within the hinges that a mesh lacks along its rim, half a cell on each side."""
    bending, curvature, size = 1e-2, 1e-4, 0.5
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))

    def bent(x, y, z):
        return np.stack([z, z, 0.5 * curvature * (cosine * x + sine * y) ** 2], axis=1)

    energy = energy_j(fabric("rayon", (size, size)), bent, bending_n_m=bending)
    expected = 0.5 * bending * curvature**2 * size**2
    assert energy == pytest.approx(expected, rel=1.1 * CELL_M / size, abs=0.0)


@pytest.mark.parametrize("name", FABRICS)
def test_cloth_has_its_mass_and_vertices_at_the_markers(name):
    scene = load_experiment(f"TextileFlinging-{name}").scene
    part, model, _ = sheet_of(scene.deformables[0])
    assert model.body_mass.sum() == pytest.approx(
        scene.deformables[0].mass_kg, rel=1e-3
    )
    markers_m = np.array(scene.markers.positions_m)
    distances = np.linalg.norm(markers_m[:, None] - part.nodes(), axis=-1)
    assert distances.min(axis=1).max() < 1e-9


@pytest.mark.slow
def test_a_swing_hardly_depends_on_the_step():
    """The integrator is first order: after 0.6 m, a quarter of the step moves the cloth by 1 mm."""
    scene, ends = load_experiment("TextileFlinging-satin").scene, []
    for rate in (900, 3600):
        simulation = BackendMuJoCo().build(scene, {"timestep_s": 1 / rate})
        ends.append(record(simulation, scene, 2.0).nodes_m["textile"][-1])
    assert np.sqrt(np.square(ends[0] - ends[1]).sum(axis=1).mean()) < 0.002


# --- bodies on cloth -------------------------------------------------------------------------------------------------


def test_every_pair_gets_its_own_friction():
    """A flex has one friction only; a cube on the cloth has another than the cloth on the table."""
    scene = load_experiment("TableclothPulling-metal").scene
    simulation = BackendMuJoCo().build(scene)
    simulation.reset()
    simulation.advance(SAMPLE_INTERVAL_S)
    model, data = simulation.model, simulation.data
    wanted = {c.first + c.second: c.friction for c in scene.contacts}
    assert wanted[("cube", "textile")] != wanted[("textile", "table")]
    seen = {"cube": set(), "table": set()}
    for touch in data.contact:
        if touch.flex.max() >= 0:
            geom = int(touch.geom.max())
            seen[model.body(model.geom_bodyid[geom]).name].add(float(touch.friction[0]))
    assert seen == {
        "cube": {wanted[("cube", "textile")]},
        "table": {wanted[("textile", "table")]},
    }


def on_a_slope(cloth, *, friction=0.3, below=0.1, degrees=10.0):
    """A metal cube of 0.34 kg on a cloth of 0.3 m that hangs from its upper edge and lies on a slab."""
    lean = (0.0, degrees, 0.0)
    slope = Pose.from_euler_deg((0.0, 0.0, 1.0), lean)
    cloth = replace(cloth, size_m=(0.3, 0.15), pose=slope)
    half = 0.5 * cloth.thickness_m

    def lying(part, name, size_m, height_m):
        place = vector(slope.to_world(np.array([0.0, 0.0, height_m])))
        return part(name, place, size_m, euler_deg=lean)

    cube = lying(box, "cube", (0.05, 0.05, 0.05), 0.025 + half)
    edge = Region(axis="x", side="low")
    return Scene(
        bodies=(
            lying(fixed_box, "slab", (0.6, 0.4, 0.02), -0.01 - half),
            replace(cube, mass_kg=0.34),
            lying(fixed_box, "bar", (0.01, 0.01, 0.01), 1.0),
        ),
        deformables=(cloth,),
        attachments=(Attachment(deformable="textile", region=edge, to="bar"),),
        contacts=(
            contact("cube", "textile", friction=friction),
            contact("textile", "slab", friction=below),
        ),
        duration_s=1.0,
    )


NYLON = load_experiment("TableclothPulling-metal").scene.deformables[0]


STRIPS = [
    pytest.param(fabric(name, (0.3, 0.15)), marks=pytest.mark.slow, id=name)
    for name in ("satin", "oxford", "leather")
]


@pytest.mark.parametrize("cloth", [NYLON, *STRIPS])
def test_a_cube_on_cloth_holds_while_the_slope_is_less_than_friction(cloth):
    scene = on_a_slope(cloth)
    simulation = BackendMuJoCo().build(scene)
    simulation.reset()
    ways_m, start = [], np.asarray(scene.body("cube").pose.position_m)
    for _ in range(6):
        simulation.advance(0.1)
        way = simulation.body_states(["cube"])[0, 0, :3] - start
        ways_m.append(scene.body("slab").pose.rotation.apply(way, inverse=True))
    downhill, _, off = np.transpose(ways_m)
    # On a rigid slope the best known real cubes leave room for 1.4 to 2.5 mm/s.
    assert abs(downhill[-1] - downhill[2]) / 0.3 < 0.002
    assert off.min() > -cloth.thickness_m


@pytest.mark.parametrize("cell_m", [0.05, 0.025])
@pytest.mark.parametrize("name", ["satin", "leather"])
def test_a_patch_of_any_cloth_is_as_soft(name, cell_m):
    """MuJoCo's regularization of a vertex' contact, over the number of vertices on an area."""
    scene = on_a_slope(fabric(name, (0.3, 0.15)))
    model = BackendMuJoCo().build(scene, {"cell_m": cell_m}).model
    # At the rim vertices weigh half or a quarter.
    mass = model.body_mass[
        [
            one
            for one in range(model.nbody)
            if model.body(one).name.startswith("textile/")
        ]
    ].max()
    impedance = float(model.flex_solimp[0, 0])
    softness = (1.0 - impedance) / (impedance * mass) * cell_m**2
    assert softness == pytest.approx(0.0375)
    assert model.flex_solimp[0, 1] == impedance


def test_impedance_of_cloth_may_be_given_itself():
    both = {"cloth_solimp": (0.9, 0.95, 0.001), "cloth_softness_m2_per_kg": None}
    model = BackendMuJoCo().build(on_a_slope(NYLON), both).model
    assert model.flex_solimp[0].tolist() == [0.9, 0.95, 0.001, 0.5, 2.0]


def test_frictions_that_neither_flex_nor_geoms_can_carry_are_declined():
    scene = on_a_slope(NYLON)
    other = replace(scene.deformables[0], name="other")
    scene = replace(scene, deformables=(*scene.deformables, other))
    both = contact("other", "textile", friction=0.5)
    support = BackendMuJoCo().supports(replace(scene, contacts=(*scene.contacts, both)))
    assert (
        "['other', 'textile'] touch each other and other bodies with different friction"
        in support.missing[0]
    )
    assert BackendMuJoCo().supports(scene)


# --- solver -----------------------------------------------------------------------------------------------------------


def swung(settings, duration_s=0.3):
    """Nodes of a satin that a rod swings [m]."""
    experiment = load_experiment("TextileFlinging-satin")
    scene = replace(
        experiment.scene,
        deformables=(replace(experiment.scene.deformables[0], size_m=(0.5, 0.1)),),
        markers=None,
    )
    simulation = BackendMuJoCo().build(scene, settings)
    return record(simulation, scene, duration_s).nodes_m["textile"][-1]


def test_conjugate_gradients_move_cloth_like_newtons_method():
    tight = swung({"solver": "Newton", "tolerance": 1e-12})
    assert np.abs(tight - swung({}, 0.0)).max() > 0.01, "the cloth swings"
    # A tenth of what half the step moves a flung cloth in 2 s, 0.5 mm.
    assert np.abs(swung({}) - tight).max() < 5e-5
    assert np.abs(swung({"tolerance": 1e-8}) - tight).max() < 5e-6
    assert np.abs(swung({"iterations": 1}) - tight).max() > 5e-5, (
        "one iteration does not solve a step"
    )


# --- search for contacts with itself ----------------------------------------------------------------------------------


def folded(monkeypatch, watch, answer):
    """Nodes of a cloth whose lower half flies against the upper one; and of each interval, whether it was searched."""
    with monkeypatch.context() as patch:
        if answer is not None:
            patch.setattr(FoldWatch, watch, lambda *_: answer)
        scene = load_experiment("TextileFlinging-satin").scene
        cloth = replace(scene.deformables[0], size_m=(0.3, 0.1))
        scene = replace(scene, deformables=(cloth,), gravity_m_per_s2=0.0)
        simulation = BackendMuJoCo().build(scene, {})
        simulation.reset()
        nodes = simulation.nodes("textile")[0]
        part = simulation._parts["textile"]
        low = (nodes[:, 2].max() - nodes[:, 2])[part.points.free]
        simulation.data.qvel[part.points.dofs[:, 2]] = 7.0 * low
        simulation.data.qvel[part.points.dofs[:, 0]] = np.sin(np.pi * low / 0.3)
        frames, searched = [], []
        original = SimulationMuJoCo._step

        def steps(self, world, count):
            original(self, world, count)
            has_search = (
                not self.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
            )
            searched.append((has_search, int(self.data.ncon)))

        patch.setattr(SimulationMuJoCo, "_step", steps)
        for _ in range(90):
            simulation.advance(SAMPLE_INTERVAL_S)
            frames.append(simulation.nodes("textile")[0])
        assert (
            not simulation.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
        )
    return np.array(frames), searched


def test_a_cloth_that_cannot_touch_itself_is_not_searched_and_moves_to_the_same_bits(
    monkeypatch,
):
    always, _ = folded(monkeypatch, "stays_apart", False)
    ours, searched = folded(monkeypatch, "stays_apart", None)
    assert np.array_equal(ours, always)
    assert max(contacts for _, contacts in searched) > 0, "the cloth touches itself"
    assert not all(has_search for has_search, _ in searched)
    never, _ = folded(monkeypatch, "_is_apart", True)
    assert not np.array_equal(never, always), (
        "layers that are taken to be apart pass through each other"
    )
