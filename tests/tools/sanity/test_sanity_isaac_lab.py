"""Stacks on PhysX: what is read of Isaac Lab's `env.yaml` and ManiSkill's SimConfig. Both files are theirs."""

import copy
import json
from pathlib import Path

import pytest
from sanity_cases import read_text

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.model import Need
from gauge_envs.tools.sanity.stacks import dialect
from gauge_envs.tools.sanity.stacks.documents import yaml_document
from gauge_envs.tools.sanity.stacks.isaac_lab import isaac_lab_configuration
from gauge_envs.tools.sanity.stacks.maniskill import maniskill_configuration

pytest.importorskip("sapien")

G1 = Path(__file__).parent / "data" / "isaac_lab_g1_flat.yaml"
DUMPED = yaml_document(G1.read_text())
ITERATIONS = "scene__robot__spawn__articulation_props__solver_position_iteration_count"


def changed(**values):
    """The dumped configuration with other values; two underscores stand for a dot."""
    cfg = copy.deepcopy(DUMPED)
    for key, value in values.items():
        *folders, last = key.split("__")
        table = cfg
        for folder in folders:
            table = table.setdefault(folder, {})
        table[last] = value
    return cfg


def read(**values):
    return isaac_lab_configuration(changed(**values), name="env.yaml", source="test")


def material(friction, mode, restitution=0.0):
    return {
        "static_friction": friction,
        "dynamic_friction": friction,
        "restitution": restitution,
        "friction_combine_mode": mode,
        "restitution_combine_mode": mode,
    }


def test_the_default_locomotion_task_is_read(approved):
    found = configuration(G1)
    approved("sanity/read_isaac_lab", read_text(found))
    assert set(found.origins) == set(found.settings)


@pytest.mark.parametrize(
    ("ground", "robot", "friction"),
    [
        (("average", 1.0), ("multiply", 0.5), 0.5),
        (("average", 1.0), ("average", 0.5), 0.75),
        (("min", 0.4), ("max", 1.2), 1.2),
        (("multiply", 0.5), ("max", 0.4), 0.5),
    ],
)
def test_of_two_rules_the_one_of_higher_priority_combines(ground, robot, friction):
    found = read(
        events=None,
        scene__terrain__physics_material=material(ground[1], ground[0]),
        scene__robot__spawn__physics_material=material(robot[1], robot[0]),
    ).foot_contact
    assert found.friction == pytest.approx((friction, friction))


@pytest.mark.parametrize(
    ("kind", "friction", "restitution"), [("plane", 0.5, 0.4), ("generator", 1.0, 0.0)]
)
def test_a_floor_without_a_material_is_that_of_the_engine(kind, friction, restitution):
    # A generated terrain is a mesh, which gets the default material of the simulation.
    terrain = {"terrain_type": kind}
    simulation = {} if kind == "plane" else material(1.0, "average")
    found = read(
        events=None, scene__terrain=terrain, sim__physics_material=simulation
    ).foot_contact
    assert (*found.friction, *found.restitution) == pytest.approx(
        (friction, friction, restitution, restitution)
    )


def test_a_ground_plane_of_a_manipulation_task_is_found():
    plane = {"func": "isaaclab.sim.spawners.from_files.from_files:spawn_ground_plane"}
    plane["physics_material"] = material(0.7, "average")
    found = read(
        events=None,
        scene__terrain=None,
        scene__plane={"spawn": plane},
        sim__physics_material=material(0.3, "average"),
    )
    assert found.foot_contact.friction == pytest.approx((0.5, 0.5))
    nothing = read(events=None, scene__terrain=None)
    assert any("no ground is found" in note for note in nothing.notes)


@pytest.mark.parametrize(
    ("low", "high", "own", "used"),
    [(1, 255, 8, 8), (10, 255, 8, 10), (1, 4, 8, 4), (1, 255, None, 16)],
)
def test_iterations_of_the_robot_are_clamped(low, high, own, used):
    values = {
        "sim__physx__min_position_iteration_count": low,
        "sim__physx__max_position_iteration_count": high,
        ITERATIONS: own,
    }
    assert read(**values).settings["position_iterations"] == used


def test_what_the_engine_cannot_represent_is_noted_or_declined():
    length = {"sim__physx__friction_correlation_distance": 0.00625}
    found = read(**length, sim__physx__enable_stabilization=True)
    notes = "\n".join(found.notes)
    assert "friction_correlation_distance 0.00625 m are not carried over" in notes
    assert "sim.physx.enable_stabilization is not carried over" in notes
    scaled = read(**length, sim__physx__friction_offset_threshold=0.01)
    assert scaled.settings["tolerance_length_m"] == pytest.approx(0.25)
    springs = read(scene__terrain__physics_material__compliant_contact_stiffness=1e4)
    assert "makes contacts springs" in springs.inapplicable[Need.CONTACT]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"sim__dt": "fast"}, "sim.dt is 'fast', and a number is expected"),
        ({"sim__dt": None}, "there is no sim.dt"),
        (
            {"sim__newton_cfg": {"njmax": 65}, "sim__physx": None},
            r"there is no sim\.physx, and there is sim\.newton_cfg instead",
        ),
        ({"sim__dt": -0.005}, "timestep_s"),
        ({"sim__physx": [1]}, r"sim.physx is \[1\], and a table is expected"),
        ({"sim__physx__solver_type": 2}, "sim.physx.solver_type is 2: give 0"),
        ({"sim__physx__enable_ccd": "maybe"}, "sim.physx.enable_ccd: .*boolean"),
        (
            {"sim__physx__bounce_threshold_velocity": float("nan")},
            "bounce_threshold_velocity is nan",
        ),
        (
            {"sim__gravity": [0.0, -9.81]},
            r"sim.gravity is \[0.0, -9.81\], and 3 numbers are expected",
        ),
        (
            {"scene__terrain__physics_material__friction_combine_mode": "sum"},
            "combines by 'sum': choose one of average, min, multiply, max",
        ),
        (
            {"scene__terrain__physics_material__dynamic_friction": -1.0},
            "dynamic_friction is -1: give 0 or more",
        ),
    ],
)
def test_a_wrong_value_is_named_with_its_key(values, message):
    with pytest.raises(TargetError, match=message):
        read(**values)


def test_a_hydra_file_has_the_same_below_env(tmp_path):
    file = tmp_path / "2026-01-01_g1" / ".hydra" / "config.yaml"
    file.parent.mkdir(parents=True)
    file.write_text(json.dumps({"env": DUMPED, "seed": 1}))
    found = configuration(file.parents[1])
    assert found.name == "2026-01-01_g1"
    assert found.settings == configuration(G1).settings
    assert found.origins["timestep_s"] == "env.sim.dt"


def test_isaac_lab_3_has_its_solver_at_another_place():
    physics = DUMPED["sim"]["physx"] | {"bounce_threshold_velocity": 0.2}
    found = read(sim__physics=physics, sim__physx=None)
    settings = configuration(G1).settings
    assert found.settings == settings | {"bounce_threshold_m_per_s": 0.2}
    changes = {"bounce_threshold_m_per_s": 0.1, "solver": "TGS"}
    key, text = "self.sim.physics", dialect(found.language).paste_text(changes)
    assert text == f"{key}.bounce_threshold_velocity = 0.1; {key}.solver_type = 1"


# --- ManiSkill -------------------------------------------------------------------------------------------------------

CONFIGS = json.loads((G1.parent / "maniskill_sim_configs.json").read_text())
"""What ManiSkill 3.0.1 returns."""


def read_task(**values):
    cfg = CONFIGS["tasks"]["PickCube-v1"] | values
    return maniskill_configuration(cfg, name="PickCube-v1", source="test")


def test_a_sim_config_is_read(approved):
    approved("sanity/read_maniskill", read_text(read_task()))


def test_a_wrong_value_of_a_sim_config_is_named():
    with pytest.raises(TargetError, match=r"no positive sim_config\.sim_freq"):
        read_task(sim_freq=None)


def test_damping_of_links_is_what_sapien_starts_with():
    import sapien
    from sapien import physx

    builder = sapien.Scene([physx.PhysxCpuSystem()]).create_articulation_builder()
    builder.create_link_builder()
    (link,) = builder.build().links
    assert (link.linear_damping, link.angular_damping) == pytest.approx((0.05, 0.05))


# --- YAML ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("!!python/object/apply:os.system ['touch RAN']", "line 2: .*is not run"),
        ("!!python/name:os.system ''", "line 2: .*is not run"),
        ("*x", "line 2: it is no YAML: "),
        ("2020-99-99", "it is no YAML: "),
        ("\x00", "it is no YAML: "),
    ],
)
def test_nothing_of_a_file_is_run(value, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "env.yaml").write_text(f"sim:\n  dt: {value}\n")
    with pytest.raises(TargetError, match=rf"env\.yaml: .*{message}"):
        configuration(tmp_path / "env.yaml")
    assert not (tmp_path / "RAN").exists()
