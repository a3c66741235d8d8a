"""Cures of an arm, judged by plain MuJoCo: it holds its pose, steps no slower, and resists a push.

Cures of other robots are written, and read again.
"""

import re
import xml.etree.ElementTree as ET

import more_faults
import mujoco
import numpy as np
import pytest
import robot_faults
from arm_faults import LATER, MISTAKES, good_xml, read, replaced
from more_faults import GOOD, LATER as MORE_LATER, MISTAKES as MORE_MISTAKES

from gauge_envs.tools.sanity import check, configuration
from gauge_envs.tools.sanity.cure import _ranked
from gauge_envs.tools.sanity.mended import write_mended
from gauge_envs.tools.sanity.model import Verdict
from gauge_envs.tools.sanity.phenomena import ROBOT_IDS
from gauge_envs.tools.sanity.robot import behaviour
from gauge_envs.tools.sanity.robot.behaviour import Behaviour, after_changes, harm
from gauge_envs.tools.sanity.robot.mended_model import mended_xml
from gauge_envs.tools.sanity.robot.remedies import ORDER, find_remedies
from gauge_envs.tools.sanity.robot.remedy import Remedy
from gauge_envs.tools.sanity.robot.rows import ROWS
from gauge_envs.tools.sanity.stacks import dialect
from gauge_envs.tools.sanity.target_checks import target_rows

NO_REMEDY = {"limits of the wrist alone"}
"""Mistakes that took away what no check can know."""


def flags_of(configuration):
    rows = target_rows(configuration, dialect("mjcf"), ROBOT_IDS)
    return {row.phenomenon for row in rows if row.is_flag}


def shown(model):
    """Return the error of the held pose, its change by a push [rad], and the slowest half of a step [s]."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    start = data.qpos.copy()
    mujoco.mj_step(model, data, round(2.0 / model.opt.timestep))
    held = data.qpos.copy()
    data.qfrc_applied[:] = 2.0
    mujoco.mj_step(model, data, round(1.0 / model.opt.timestep))
    pushed = np.abs(data.qpos - held).max()
    halves_s = []
    for servo in range(model.nu):
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.ctrl[servo] += 0.3
        while data.qpos[servo] - start[servo] < 0.15 and data.time < 1.0:
            mujoco.mj_step(model, data)
        halves_s.append(data.time)
    return np.abs(held - start).max(), pushed, max(halves_s)


OF_ARMS = MISTAKES | LATER
FIRST_OF_ARMS = {row: name for name, (_, row) in reversed(OF_ARMS.items())}.values()


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in FIRST_OF_ARMS else pytest.mark.slow)
        for name in sorted(OF_ARMS.keys() - NO_REMEDY)
    ],
)
def test_an_arm_is_the_better_for_its_cure(name, tmp_path):
    change, _ = OF_ARMS[name]
    before = read(change(good_xml()))
    found = find_remedies(before.robot, flags_of(before))
    assert found.texts
    text = mended_xml(before.robot, found.changes, found.texts, tmp_path)
    after = read(text)
    assert flags_of(after) == set()
    assert sum(one.tag is ET.Comment for one in _with_comments(text)) > 1
    pose_rad, push_rad, half_s = shown(after.robot.model)
    assert pose_rad < 0.1 and push_rad < 0.1 and half_s < 0.2


def _with_comments(text):
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
    return ET.fromstring(text, parser=parser).iter()


BY_HAND = {
    *(
        "robot-size",
        "robot-balance",
        "robot-mirror",
        "robot-command",
        "robot-unlimited",
    ),
    *("robot-torque", "robot-stands"),
}
"""Rows that a change mends for certain only where no other one does as well, or where the model states a range."""
TRUNK = "quadruped, a trunk whose centre is far ahead"
"""A mistake that no change mends for certain, though its row has some for others: none says where the mass is."""

ALL = MORE_MISTAKES | MORE_LATER
FIRST = {row: name for name, (_, row) in reversed(ALL.items())}.values()
LAG_IS_LEFT = {"hand, armature in g cm^2"}
"""Mistakes after whose cure another row is still flagged."""


def test_every_row_on_a_model_has_its_place_in_the_order():
    assert set(ROWS) - set(ORDER) == {"robot-action", "robot-delay", "robot-solver"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in FIRST else [pytest.mark.slow])
        for name in ALL
    ],
)
def test_the_written_robot_has_the_flags_that_are_left(name, tmp_path):
    change, row = ALL[name]
    before = read(change(GOOD[name.partition(",")[0]]()))
    found = find_remedies(before.robot, flags_of(before))
    if not found.texts:
        assert row in BY_HAND or name == TRUNK
        assert all(found.unmended.values()) and found.unmended
        return
    after = read(mended_xml(before.robot, found.changes, found.texts, tmp_path))
    assert row not in flags_of(after)
    assert flags_of(after) == set() or name in LAG_IS_LEFT | {
        other for other in ALL if ALL[other][1] in BY_HAND
    }


def remedies(xml):
    before = read(xml)
    return find_remedies(before.robot, flags_of(before))


@pytest.mark.parametrize(
    ("robot", "old", "new", "cure"),
    [
        (
            *("arm", '(name="joint3".*?)damping="1"', r'\1damping="400"'),
            'damping="1" for joint3',
        ),
        (
            *("arm", '(name="joint6")', r'\1 stiffness="400" springref="90"'),
            'stiffness="0" for joint6',
        ),
        (
            *("hand", 'condim="4"(\\s+priority="1" friction=)"1', r'condim="3"\1"0'),
            'condim="3" friction="1 0.005 0.0001" priority="1" for index_pad and pads like it',
        ),
    ],
)
def test_what_is_wrong_in_one_place_is_mended_there(robot, old, new, cure):
    assert remedies(replaced(old, new)(GOOD[robot]())).texts == (cure,)


def test_a_remedy_that_compiles_the_model_again_keeps_the_earlier_ones():
    """Masses are rows of an array; limits are read by the compiler."""
    text = good_xml()
    for name in ("links in grams", "limits off"):
        text = (MISTAKES | LATER)[name][0](text)
    before = read(text)
    found = find_remedies(before.robot, flags_of(before))
    assert {"body_mass", "jnt_limited"} <= {
        key.partition("[")[0] for key in found.changes
    }
    model = found.robot.model
    assert model.jnt_limited.all()
    assert model.body_mass[1:] == pytest.approx(before.robot.model.body_mass[1:] / 1e3)


def keyframe_in_millimetres(text):
    begin, end = 'qpos="', text[text.index('qpos="') + 6 :]
    place, rest = end.split()[:3], end.split()[3:]
    place = [str(1000.0 * float(one)) for one in place]
    return text[: text.index(begin)] + begin + " ".join(place + rest)


@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("arm", str),
        ("quadruped", keyframe_in_millimetres),
        pytest.param("quadruped", str, marks=pytest.mark.slow),
        pytest.param("hand", str, marks=pytest.mark.slow),
    ],
)
def test_lengths_in_millimetres_become_metres(name, more, tmp_path):
    """The mended robot has the places and the masses of the right one, also where its keyframe is in metres."""
    good = GOOD[name]()
    file, mended = tmp_path / "robot.xml", tmp_path / "mended.xml"
    file.write_text(more(more_faults.millimetres(good)))
    report = check(str(file), only=["robot-*"])
    assert report.cure is not None
    assert report.cure.line.startswith("lengths times 0.001")
    assert report.cure.mended_count == report.cure.flag_count > 1
    write_mended(report, mended)
    found, right = (
        mujoco.MjModel.from_xml_path(str(mended)),
        mujoco.MjModel.from_xml_string(good),
    )
    for array in ("body_pos", "geom_pos", "geom_size", "body_mass", "key_qpos"):
        np.testing.assert_allclose(
            getattr(found, array), getattr(right, array), rtol=1e-5, atol=1e-6
        )


def test_a_unit_with_which_the_model_does_not_compile_is_left_out():
    """In metres the speck would weigh less than MuJoCo takes."""
    speck = '<body name="speck"><freejoint/><geom size="0.001"/></body></worldbody>'
    text = more_faults.millimetres(good_xml()).replace("</worldbody>", speck)
    text = re.sub("<keyframe>.*</keyframe>", "", text)
    found = find_remedies(read(text).robot, ["robot-size"])
    assert "lengths times 0.001" not in "".join(found.texts)


TEXTS = {
    # Masses follow from densities; a thousandth of these lengths has motors that are far too strong.
    "arm, centimetres": "lengths times 0.01",
    # With other hips the robot would be over its feet too, and stand on their edges.
    "biped, both knees reversed": 'axis="0 1 0" for left_knee and right_knee',
    "biped, a reversed knee": 'axis="0 1 0" for left_knee',
}


@pytest.mark.parametrize("name", TEXTS)
def test_the_one_change_that_mends_a_robot_is_said(name):
    change, _ = ALL[name]
    found = remedies(change(GOOD[name.partition(",")[0]]()))
    assert [text.partition(": ")[0] for text in found.texts] == [TEXTS[name]]
    assert not found.unmended


@pytest.mark.parametrize(
    ("height", "texts"),
    [(".7287", ('pos="0 0 -0.35" for right_shin',)), (".8", ())],
    ids=["one leg reaches the ground", "none does"],
)
def test_the_leg_that_misses_the_ground_gets_the_length_of_the_other_one(height, texts):
    change, row = ALL["biped, a longer thigh"]
    found = remedies(change(GOOD["biped"]()).replace(".7287", height))
    assert found.texts == texts
    assert set(found.unmended) == (set() if texts else {row, "robot-sides"})


def test_no_side_is_turned_where_either_can_be_the_wrong_one():
    change, row = ALL["biped, an ankle whose range was not turned"]
    found = remedies(change(GOOD["biped"]()))
    assert found.texts == () and set(found.unmended) == {row}
    assert sum("and so does" in one.line for one in found.attempts) == 2


@pytest.mark.parametrize("zero", ["0.6 1", "0 -1"])
def test_a_coupling_gets_back_its_zero_and_its_direction(zero):
    good = GOOD["hand"]()
    found = remedies(good.replace('polycoef="0 1', f'polycoef="{zero}'))
    assert found.texts == ('polycoef="0 1 0 0 0" for index, ring and thumb',)


PAIR = "".join(
    f'<pair geom1="floor" geom2="{leg}_foot" {{}}/>' for leg in robot_faults.FEET
)
SOFT_PAIR = 'solref="0.2 1" solimp="0.95 0.95 0.001"'


@pytest.mark.parametrize(
    "is_default", [False, pytest.param(True, marks=pytest.mark.slow)]
)
def test_soft_explicit_pairs_are_mended_where_they_state_it(is_default, tmp_path):
    """The contacts of pairs do not see their geoms; a class of pairs is changed as a class."""
    text = robot_faults.good_xml()
    own, default = ("", f"<pair {SOFT_PAIR}/>") if is_default else (SOFT_PAIR, "")
    text = text.replace(
        "<keyframe>", f"<contact>{PAIR.replace('{}', own)}</contact><keyframe>"
    )
    text = text.replace("<joint armature", f"{default}<joint armature")
    file, mended = tmp_path / "soft.xml", tmp_path / "mended.xml"
    file.write_text(text)
    report = check(str(file), only=["rest-height", "robot-stands"])
    assert [*report.flags] == ["rest-height"]
    assert "1 of 1 flags are gone" in write_mended(report, mended)
    model = mujoco.MjModel.from_xml_path(str(mended))
    assert model.npair == len(robot_faults.FEET)
    assert (model.pair_solref[:, 0] < 0.01).all()
    stating = [
        line
        for line in mended.read_text().splitlines()
        if line.strip().startswith("<pair") and "solref" in line
    ]
    assert len(stating) == (1 if is_default else len(robot_faults.FEET))


def test_a_wall_is_built_only_with_changes_that_could_be_the_best():
    mended = {"a": ["creep-wood", "wall-sag"], "b": ["creep-wood"], "c": []}
    mended["d"] = mended["a"]
    walls = []

    def outcome_of(name, row):
        if row == "wall-sag":
            walls.append(name)
        return (Verdict.INSIDE if row in mended[name] else Verdict.WRONG), 1.0

    ranked = _ranked(
        [{"d": 1}, {"c": 1}, {"b": 1}, {"a": 1}],
        ["creep-wood", "wall-sag"],
        lambda changes: (next(iter(changes)), {}),
        outcome_of,
        lambda changes, error: pytest.fail(str(error)),
        lambda name, changes: "it falls" if name == "d" else "",
    )
    # For a change that harms the robot no wall is built.
    assert next(ranked)[0] == {"d": 1} and walls == []
    assert next(ranked)[0] == {"a": 1}
    assert walls == ["b", "a"]
    # Of a change that harms, the next best one follows.
    assert [one[0] for one in ranked] == [{"b": 1}, {"c": 1}]


def test_a_change_of_contacts_with_which_a_pushed_robot_slips_is_refused(monkeypatch):
    robot = read(robot_faults.good_xml()).robot
    changes = {"impratio": 50.0}
    before, after = Behaviour(robot), after_changes(robot, changes)
    remedy = Remedy(text="", changes=changes)
    assert harm(before, after, remedy) == ""
    slips_m = {id(robot): [0.01, 0.02], id(after.robot): [0.009, 0.1]}
    monkeypatch.setattr(behaviour, "pushed_m", lambda one: slips_m[id(one)])
    assert harm(before, after, remedy).startswith("a push of 0.1 of its weight")


def test_a_class_of_one_joint_is_changed_with_it(tmp_path):
    classes = '<default><default class="one"><joint armature="0.123"/></default>'
    text = good_xml().replace("<default>", classes, 1)
    text = re.sub(r'(name="joint1".*) armature="0.1"', r'class="one" \1', text)
    # A picture that nobody sees is no reason to refuse a model, and stays in its file.
    picture = '<texture name="one" type="2d" file="absent.png"/>'
    text = text.replace("<worldbody>", f"<asset>{picture}</asset><worldbody>")
    file = tmp_path / "robot.xml"
    file.write_text(text)
    robot = configuration(str(file)).robot
    assert robot.model.dof_armature[0] == pytest.approx(0.123)
    written = mended_xml(robot, {"dof_armature[0]": 0.5}, [], tmp_path)
    tree = ET.fromstring(written)
    assert [one.get("file") for one in tree.iter("texture")] == ["absent.png"]
    stated = [one.get("armature") for one in tree.iter("joint") if one.get("armature")]
    assert "0.5" in stated and "0.123" not in stated


def test_a_change_that_is_said_in_words_is_pasted_once():
    change, row = ALL["arm, under water"]
    cure = check(read(change(GOOD["arm"]())), only=[row]).cure
    medium = '<option density="0" viscosity="0" wind="0 0 0"/>'
    assert cure.line.startswith(medium) and cure.line.count("density") == 1
