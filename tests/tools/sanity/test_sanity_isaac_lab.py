"""Isaac Lab's `env.yaml`, which the stack wrote itself."""

import copy
import json
from pathlib import Path

import numpy as np
import pytest

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.readers import dialect
from gauge_envs.tools.sanity.readers.documents import yaml_document
from gauge_envs.tools.sanity.readers.isaac_lab import isaac_lab_configuration
from gauge_envs.tools.sanity.training import Need

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


def test_the_default_locomotion_task_is_read():
    g1 = configuration(G1)
    settings = {
        "timestep_s": 0.005,
        "solver": "TGS",
        "bounce_threshold_m_per_s": 0.5,
        "position_iterations": 8,
        "velocity_iterations": 4,
        "max_linear_velocity_m_per_s": 1000.0,
        "preset": "isaac",
    }
    assert settings.items() <= g1.settings.items()
    # Isaac Lab has 1000 degrees per second.
    speed = g1.settings["max_angular_velocity_rad_per_s"]
    assert speed == pytest.approx(np.radians(1000.0))
    assert (g1.frame_skip, g1.gravity_m_per_s2) == (4, (0.0, 0.0, -9.81))
    assert set(g1.origins) == set(g1.settings)


@pytest.mark.parametrize(
    ("values", "bounces"),
    [
        ({}, False),
        ({"scene__terrain__physics_material__restitution": 0.3}, True),
        ({"events__physics_material__params__restitution_range": [0.0, 0.5]}, True),
    ],
)
def test_impacts_are_advice_where_no_material_has_a_restitution(values, bounces):
    task = read(**values)
    assert task.settings["sustained_restitution"] == bounces
    assert (Need.REBOUND in task.inapplicable) != bounces


@pytest.mark.parametrize(
    ("low", "high", "count", "used"),
    [(10, 255, 8, 10), (1, 4, 8, 4)],
)
def test_iterations_of_the_robot_are_clamped(low, high, count, used):
    values = {
        "sim__physx__min_position_iteration_count": low,
        "sim__physx__max_position_iteration_count": high,
        ITERATIONS: count,
    }
    assert read(**values).settings["position_iterations"] == used


def test_what_the_engine_cannot_represent_is_noted():
    assert not any("not carried over" in note for note in read().notes)
    task = read(
        sim__physx__friction_correlation_distance=0.00625,
        sim__physx__enable_stabilization=True,
    )
    for key in ("friction_correlation_distance", "enable_stabilization"):
        assert f"sim.physx.{key} is not carried over" in task.notes
    springs = read(scene__terrain__physics_material__compliant_contact_stiffness=1e4)
    assert "makes contacts springs" in springs.inapplicable[Need.CONTACT]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"sim__dt": None}, "there is no sim.dt"),
        (
            {"sim__newton_cfg": {"njmax": 65}, "sim__physx": None},
            r"there is no sim\.physx, and there is sim\.newton_cfg instead",
        ),
        ({"sim__physx__solver_type": 2}, "sim.physx.solver_type is 2: give 0"),
        (
            {"sim__gravity": [0.0, -9.81]},
            r"sim.gravity is \[0.0, -9.81\], and 3 numbers are expected",
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
    task = configuration(file.parents[1])
    assert task.name == "2026-01-01_g1"
    assert task.settings == configuration(G1).settings
    assert task.origins["timestep_s"] == "env.sim.dt"


def test_isaac_lab_3_has_its_solver_at_another_place():
    physics = DUMPED["sim"]["physx"] | {"bounce_threshold_velocity": 0.2}
    task = read(sim__physics=physics, sim__physx=None)
    settings = configuration(G1).settings
    assert task.settings == settings | {"bounce_threshold_m_per_s": 0.2}
    changes = {"bounce_threshold_m_per_s": 0.1, "solver": "TGS"}
    key, text = "self.sim.physics", dialect(task.language).paste_text(changes)
    assert text == f"{key}.bounce_threshold_velocity = 0.1; {key}.solver_type = 1"
