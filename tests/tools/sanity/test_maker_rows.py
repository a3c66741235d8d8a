"""Robots beside published models: facts, planted mistakes, choices, and the published numbers as a cure."""

import csv
import re

import mujoco
import pytest
from robot_faults import good_xml

from gauge_envs.tools.sanity import mended
from gauge_envs.tools.sanity.model import Verdict
from gauge_envs.tools.sanity.robot import maker_rows
from gauge_envs.tools.sanity.robot.maker_rows import (
    differing,
    families,
    published_models,
    same_robots,
)
from gauge_envs.tools.sanity.robot.quantities import QUANTITIES
from gauge_envs.tools.sanity.stacks import configuration
from gauge_envs.tools.sanity.target_checks import robot_row
from studies.robots import tables

DATA_SHEETS_KG = {
    "anybotics_anymal_c": 50.0,
    "unitree_go1": 12.0,
    "unitree_go2": 15.0,
    "unitree_h1": 47.0,
}
"""Masses of robots by their makers' data sheets [kg]. Menagerie's Spot has 50.3 kg, and its data sheet 32.7."""


@pytest.mark.parametrize("name", DATA_SHEETS_KG)
def test_published_masses_are_those_of_data_sheets(name):
    (model,) = (one for one in published_models() if one.name == name)
    mass_kg = sum(model.numbers["mass"].values())
    assert mass_kg == pytest.approx(DATA_SHEETS_KG[name], rel=0.15)


def test_each_published_model_has_a_source_and_known_quantities():
    models = published_models()
    files = {file.stem for file in maker_rows.FOLDER.glob("*.csv")}
    assert {one.name for one in models} == files - {"index"}
    assert len(models) > 70
    for one in models:
        assert re.search(r"[0-9a-f]{7}", one.source)
        assert one.numbers.keys() <= QUANTITIES.keys()
        assert one.numbers["mass"].keys()


def test_each_published_model_is_nearest_to_itself():
    """Also where another version has all its numbers and more, as the iiwa of 2025 beside that of 2022."""
    unknown = set()
    for model in published_models():
        known = {name: model.numbers.get(name, {}) for name in QUANTITIES}
        robots = same_robots(known)
        if not robots:
            unknown.add(model.name)
            continue
        nearest = robots[0][0]
        off = [one for name in QUANTITIES for one in differing(name, known, nearest)]
        assert off == [], model.name
    # Drones and two models of few joints cannot be told from others.
    drones = {"bitcraze_crazyflie_2", "skydio_x2"}
    assert unknown == drones | {"stanford_tidybot_base", "umi_gripper"}


@pytest.fixture
def published(request, tmp_path, monkeypatch):
    """The tests' own quadruped, or a changed one, as the only published model."""
    path = tmp_path / "quadruped.xml"
    path.write_text(getattr(request, "param", good_xml()))
    for module in (maker_rows, tables):
        monkeypatch.setattr(module, "FOLDER", tmp_path)
    model = {"name": "dog", "robot": "Dog", "source": "1234567", "licence": "MIT"}
    listing = tmp_path / "list.csv"
    with listing.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, [*model, "path"])
        writer.writeheader()
        writer.writerow({**model, "path": str(path)})
    published_models.cache_clear()
    tables.main(listing)
    yield
    published_models.cache_clear()


def row(xml):
    return robot_row(
        "robot-maker", configuration(mujoco.MjModel.from_xml_string(xml)).robot
    )


def scaled(xml, attribute, factor):
    """Return a model with all values of an attribute times a factor."""
    return re.sub(
        rf'(\s{attribute}=")([\d.]+)', lambda m: f"{m[1]}{factor * float(m[2])}", xml
    )


@pytest.mark.usefixtures("published")
def test_the_published_robot_itself_has_no_difference():
    found = row(good_xml())
    assert found.applies
    assert found.configured == 0.0


MISTAKES = {
    "one heavy calf": ('name="FL_calf" type', 'mass="2" \\g<0>', "mass of FL_calf"),
    "one knee of another gain": (
        'joint="RR_knee" kp="80"',
        'joint="RR_knee" kp="60"',
        "kp of RR_knee",
    ),
    "one range": (
        'name="RL_hip" axis="0 1 0" range="-60 240"',
        'name="RL_hip" axis="0 1 0" range="-60 200"',
        "joint-range of RL_hip",
    ),
    "a foot that touches nothing": (
        'name="FR_foot"',
        'name="FR_foot" contype="0" conaffinity="0"',
        "geoms of FR_calf",
    ),
    "all gains per degree": ('kp="80"', 'kp="4583.66"', "kp of FL_hip"),
    "densities in pounds": (
        'density="1200"',
        'density="2645.55"',
        "mass of FL_thigh",
    ),
    "damping alone": ('damping="0.5"', 'damping="1"', "damping of FL_hip"),
    "joints without their class": (
        '<joint armature="0.005" damping="0.5" frictionloss="0.2"/>',
        "",
        "damping of FL_hip",
    ),
    "feet and calves that touch nothing": (
        'geom name=".._(calf|foot)"',
        r'\g<0> contype="0" conaffinity="0"',
        "geoms of FL_calf",
    ),
    "a motor without its limit": (
        '(joint="FL_hip" kp="80" kv="2") forcerange="-40 40"',
        r"\1",
        "motor-limit of FL_hip",
    ),
}
"""Patterns, what they become, and what the row names."""


@pytest.mark.usefixtures("published")
@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_in_a_published_robot_is_named(name):
    old, new, words = MISTAKES[name]
    xml, count = re.subn(old, new, good_xml())
    assert count
    found = row(xml)
    assert found.verdict is Verdict.VISIBLE
    assert found.is_flag
    assert words in found.remark
    assert "Dog" in found.remark


RICH = re.sub(
    '(joint=".._)(hip|knee)"',
    lambda found: f'{found[0]} ctrlrange="{"-2 2" if found[2] == "hip" else "-1 1"}"',
    good_xml(),
).replace(
    "</mujoco>",
    """<contact><exclude body1="FL_thigh" body2="FR_thigh"/><exclude body1="RL_thigh" body2="RR_thigh"/></contact>
    </mujoco>""",
)
"""The quadruped with commands and excludes."""


@pytest.mark.usefixtures("published")
@pytest.mark.parametrize("published", [RICH], indirect=True)
@pytest.mark.parametrize(
    ("old", "new", "is_flag"),
    [
        ('ctrlrange="-1 1"', 'ctrlrange="-2 2"', True),
        ("<contact>.*</contact>", "", True),
        (' joint="', ' gear="6.33" joint="', True),
        ('(_knee" ctrlrange="-1 1" kp=)"80"', r'\1"40"', False),
    ],
    ids=["commands of all knees", "all excludes", "all gears", "gains of all knees"],
)
def test_what_all_parts_of_a_kind_share_is_a_choice_or_not(old, new, is_flag):
    assert row(RICH).configured == 0.0
    changed, count = re.subn(old, new, RICH)
    assert count
    assert row(changed).is_flag == is_flag


CHOICES = {
    "all gains": ('kp="80"', 'kp="40"'),
    "gains of all knees": ('(_knee" kp=)"80"', r'\1"40"'),
    "friction": ('friction="0.8', 'friction="1'),
    "damping and dry friction": ('damping="0.5" frictionloss="0.2"', 'damping="1"'),
    "another pose": ('qpos="0 0 .322 1 0 0 0 0 0', 'qpos="0 0 .322 1 0 0 0 .1 -.1'),
}


@pytest.mark.usefixtures("published")
@pytest.mark.parametrize("name", CHOICES)
def test_a_choice_is_advice(name):
    xml, count = re.subn(*CHOICES[name], good_xml())
    assert count
    found = row(xml)
    assert found.verdict is Verdict.VISIBLE
    assert found.advisory
    assert not found.is_flag


@pytest.mark.usefixtures("published")
def test_another_robot_with_the_same_names_is_not_judged():
    lengths = scaled(good_xml().replace(".15 0 -.15", ".21 0 -.19"), "density", 1.3)
    other = lengths.replace('range="-60 240"', 'range="-90 200"').replace(".12", ".17")
    assert not row(other).applies


@pytest.mark.usefixtures("published")
def test_the_published_numbers_are_the_cure(tmp_path, gauge):
    xml = good_xml().replace('joint="RR_knee" kp="80"', 'joint="RR_knee" kp="20"')
    xml = xml.replace('name="FL_knee" axis', 'name="FL_knee" damping="9" axis')
    (tmp_path / "dog.xml").write_text(xml)
    outcome = gauge(
        "sanity", "dog.xml", "--only", "robot-maker,robot-sides", "--fix", "mended.xml"
    )
    assert outcome.exit_code == 1
    assert 'damping="0.5" for FL_knee' in outcome.stdout
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "mended.xml"))
    assert model.actuator("RR_knee").gainprm[0] == pytest.approx(80.0)
    assert model.joint("FL_knee").damping[0] == pytest.approx(0.5)
    assert row((tmp_path / "mended.xml").read_text()).configured == 0.0


RUSTY = good_xml().replace('frictionloss="0.2"', 'frictionloss="20"')


@pytest.mark.parametrize("published", [RUSTY], indirect=True)
def test_a_published_mistake_is_cured_too(published, tmp_path, gauge, monkeypatch):
    # The cure leaves the published numbers.
    monkeypatch.setattr(mended, "_flags", lambda *_: {"robot-maker"})
    (tmp_path / "dog.xml").write_text(RUSTY)
    only = ("--only", "robot-maker,robot-frictionloss")
    outcome = gauge("sanity", "dog.xml", *only, "--fix", "mended.xml")
    assert outcome.stdout.startswith("Mends most")
    assert "frictionloss was 20" in (tmp_path / "mended.xml").read_text()


def test_what_is_left_out_with_its_joint_is_no_mistake():
    known = {
        "motor": {"grip moves finger": 1.0, "lift moves arm": 1.0},
        "joint-zero": {"arm": 0.0},
        "tendon-length": {},
        "site-place": {},
        "mass": {"hand": 1.0},
    }

    def is_left_out(part):
        one = maker_rows.Difference(
            quantity="motor", part=part, value=float("nan"), published=1.0
        )
        return maker_rows.is_left_out(one, known)

    assert not is_left_out("grip moves arm")
    assert is_left_out("grip moves thumb")
    assert is_left_out("turn moves arm")


def test_families_are_parts_that_differ_in_one_word():
    found = families(["FL_calf", "FR_calf", "RL_calf", "RR_calf", "trunk"])
    assert frozenset({"FL_calf", "FR_calf"}) in found["FL_calf"]
    assert frozenset({"FL_calf", "RL_calf"}) in found["FL_calf"]
    assert "trunk" not in found
