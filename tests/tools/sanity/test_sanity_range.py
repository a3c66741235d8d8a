"""The range from which training draws friction, against the pairs of materials and the slides that were measured."""

import copy
import csv
import tomllib

import numpy as np
import pytest
import yaml
from places import ROOT

from gauge_envs.tools.sanity import check
from gauge_envs.tools.sanity.model import FootContact, TrainingConfiguration, Verdict
from gauge_envs.tools.sanity.target_checks import friction_range_row

FACTS = ROOT / "scoring" / "facts"


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


def test_random_ranges_are_judged_as_by_a_plain_reading_of_the_data():
    with (FACTS / "friction_tables.csv").open(encoding="utf-8") as file:
        texts = [one[key] for one in csv.DictReader(file) for key in ("static", "dynamic")]  # fmt: skip
    values = [float(end) for text in texts if text for end in text.split(" to ")]
    # Published friction of the rubber ball.
    least, most = min(values), 0.808698
    slides = tomllib.loads((FACTS / "slope_slider_30deg_summary.toml").read_text(encoding="utf-8"))  # fmt: skip
    wood = slides["wood"]["friction"]
    # Student's t of 19 degrees of freedom.
    share = 2.0930 * wood["std"] * np.sqrt(1 + 1 / 20) / wood["mean"]
    random = np.random.default_rng(0)
    for _ in range(300):
        center = random.uniform(0.02, 1.2)
        half = center * random.choice([random.uniform(0.0, 0.1), random.uniform(0, 1)])
        low, high = center - half, center + half
        if not low < high:
            continue
        words = "inside"
        if not least <= center <= most:
            words = "off centre"
        elif low < least or high > most:
            words = "too wide"
        elif half < share * center:
            words = "too narrow"
        found = row(low, high)
        assert words in found.remark
        assert (found.verdict is Verdict.INSIDE) is (words == "inside")


def test_a_range_in_a_file_is_flagged_and_one_value_is_none():
    cfg = yaml.load(
        (ROOT / "tests/tools/sanity/data/isaac_lab_g1_flat.yaml").read_text(encoding="utf-8"),
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
