"""ManiSkill: settings of tasks as a SimConfig. The stored ones are returned by ManiSkill 3.0.1 itself."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from sanity_cases import read_text

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.stacks.maniskill import maniskill_configuration

pytest.importorskip("sapien")

STORED = json.loads(
    (Path(__file__).parent / "data" / "maniskill_sim_configs.json").read_text()
)["tasks"]
PICK_CUBE = STORED["PickCube-v1"]


def test_a_sim_config_is_read(approved):
    found = maniskill_configuration(PICK_CUBE, name="PickCube-v1", source="test")
    approved("sanity/read_maniskill", read_text(found))


def test_damping_of_links_is_what_sapien_starts_with():
    import sapien
    from sapien import physx

    builder = sapien.Scene([physx.PhysxCpuSystem()]).create_articulation_builder()
    builder.create_link_builder()
    (link,) = builder.build().links
    assert (link.linear_damping, link.angular_damping) == (
        pytest.approx(0.05),
        pytest.approx(0.05),
    )
    assert physx.PhysxRigidDynamicComponent().linear_damping == 0.0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"sim_freq": None}, "no positive sim_config.sim_freq"),
        ({"sim_freq": "fast"}, "sim_config.sim_freq is 'fast'"),
        ({"scene_config": [1]}, "sim_config.scene_config is a list"),
        (
            {"scene_config": {"solver_position_iterations": 1.5}},
            "solver_position_iterations: .*integer",
        ),
        (
            {"scene_config": {"enable_tgs": "yes"}},
            "enable_tgs is 'yes': give 0 .PGS. or 1",
        ),
        ({"scene_config": {"contact_offset": -1.0}}, "contact_offset_m"),
        (
            {"default_materials_config": {"restitution": "inf"}},
            "restitution is inf: give 0 or more",
        ),
    ],
)
def test_a_wrong_value_is_named(values, message):
    with pytest.raises(TargetError, match=message):
        maniskill_configuration(
            {**PICK_CUBE, **values}, name="PickCube-v1", source="test"
        )
