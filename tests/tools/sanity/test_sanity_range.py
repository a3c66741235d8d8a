"""The range from which training draws friction, against the pairs of materials and the slides that were measured."""

import copy

import pytest
import yaml
from places import ROOT

from gauge_envs.tools.sanity import check
from gauge_envs.tools.sanity.model import FootContact, TrainingConfiguration, Verdict
from gauge_envs.tools.sanity.target_checks import friction_range_row


def row(low, high):
    foot = FootContact(
        friction=(low, high), static_friction=(low, high), restitution=(0.0, 0.0), source="a test"
    )  # fmt: skip
    return friction_range_row(
        TrainingConfiguration(name="n", source="s", backend="physx", settings={}, foot_contact=foot)
    )  # fmt: skip


@pytest.mark.parametrize(
    ("ends", "words"),
    [
        ((0.39, 0.41), "too narrow: single slides of one pair scatter by 3.8 %"),
        ((0.0, 0.8), "too wide: it leaves 0.08 to 0.81 of 37 measured pairs"),
        ((0.7, 1.3), "off centre: 1 is outside 0.08 to 0.81"),
        ((0.3, 0.6), "inside 0.08 to 0.81"),
    ],
)
def test_a_range_is_judged_as_a_whole(ends, words):
    found = row(*ends)
    assert words in found.remark
    assert found.is_flag is ("inside" not in words)
    assert "n = 37" in found.reality.source
    assert "friction_tables.csv" in found.reality.source


def test_a_range_in_a_file_is_flagged_and_one_value_is_none():
    cfg = yaml.load(
        (ROOT / "tests/tools/sanity/data/isaac_lab_g1_flat.yaml").read_text(),
        Loader=Plain,
    )  # fmt: skip
    found = check(cfg, only=["friction-range"])
    assert (found.rows[0].verdict, found.rows[0].applies) == (Verdict.DECLINED, False)
    narrow = copy.deepcopy(cfg)
    narrow["events"]["physics_material"]["params"]["static_friction_range"] = [0.39, 0.41]  # fmt: skip
    (flag,) = check(narrow, only=["friction-range"]).rows
    assert flag.is_flag
    assert "0.39 to 0.41 is too narrow" in flag.remark


class Plain(yaml.SafeLoader):
    """YAML whose tags of Python are lists, or nothing."""


def plain(loader, _, node):
    return loader.construct_sequence(node) if isinstance(node, yaml.SequenceNode) else None  # fmt: skip


Plain.add_multi_constructor("tag:yaml.org,2002:python/", plain)
