"""Static rules: each names a mistake, and says nothing of its right twin."""

from itertools import product

import pytest
from quadruped import good_xml

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity import check, configuration
from gauge_envs.tools.sanity.static_rules import STATIC_RULES
from gauge_envs.tools.sanity.static_rules.consistent import side_of

ARM = """<mujoco><compiler {angle}/><option timestep=".002" {option}/><worldbody>
  <geom name="floor" type="plane" size="1 1 .1" {floor}/>
  <body name="link" pos="0 0 .5"><inertial pos=".15 0 0" mass="{mass}" diaginertia="{inertia}"/>
   <joint name="elbow" axis="0 1 0" range="{range}" damping=".5"/>
   <geom name="link" type="capsule" fromto="0 0 0 .3 0 0" size=".03"/><site name="left_tip" pos=".3 0 0"/></body>
  <body name="box" pos="1 0 {height}"><freejoint/>
   <geom name="box" type="box" size=".05 .05 .05" mass="1" {box}/></body>
  </worldbody><tendon><fixed name="cord" range="{cord}"><joint joint="elbow" coef="1"/></fixed></tendon>
  <actuator><position name="{actuator}" joint="elbow" kp="{kp}" kv="2" gear="{gear}" ctrlrange="{commands}"
   forcerange="-20 20"/></actuator>
  <sensor><touch name="{sensor}" site="left_tip"/></sensor>
  <keyframe><key name="home" qpos="{start} 1 0 {height} 1 0 0 0" ctrl="{command}"/></keyframe></mujoco>"""

RIGHT = {
    "angle": 'angle="radian"',
    "option": "",
    "floor": "",
    "mass": "1",
    "inertia": ".001 .009 .009",
    "range": "-1 1.5",
    "height": ".05",
    "box": "",
    "cord": "-1 1",
    "actuator": "elbow",
    "kp": "50",
    "gear": "1",
    "commands": "-1 1.5",
    "sensor": "left_touch",
    "start": "0",
    "command": "0",
}

MISTAKES = [
    ("range-unit", "22.8 times round", {"range": "-57 86"}, {"range": "-6 6"}),
    (
        "range-unit",
        "radians in a file of degrees",
        {"angle": ""},
        {"angle": "", "range": "-57 86"},
    ),
    ("density", "densest metal", {"mass": "50", "inertia": ".05 .45 .45"}, {}),
    ("inertia", "8.4 times", {"inertia": ".01 .08 .08"}, {"inertia": ".002 .01 .01"}),
    (
        "inertia",
        "0.084 times",
        {"inertia": "1e-4 8e-4 8e-4"},
        {"inertia": "5e-4 .006 .006"},
    ),
    ("command-range", "degrees", {"commands": "-57 86"}, {"commands": "-1.2 1.7"}),
    ("command-range", "-20 to 20", {"commands": "-20 20"}, {"commands": "-.5 .5"}),
    ("servo-gain", "kp 0.87", {"kp": ".87"}, {"kp": "20"}),
    (
        "stated-gear",
        "makes no force",
        {"gear": "0"},
        {"gear": "-1", "commands": "-1.5 1"},
    ),
    (
        "start-range",
        "outside of its range",
        {"start": "1.7"},
        {"start": "1.5", "cord": "-2 2"},
    ),
    ("start-command", "commands elbow to 2", {"command": "2"}, {"command": "1.5"}),
    ("start-overlap", "20 mm", {"height": ".03"}, {"height": ".048"}),
    ("start-tendon", "0, outside", {"cord": ".4 .6"}, {"cord": "-.1 .1"}),
    (
        "names",
        "left_tip, on the other side",
        {"sensor": "right_touch"},
        {"sensor": "touch"},
    ),
    (
        "touch",
        "falls through",
        {"box": 'contype="2" conaffinity="2"'},
        {"box": 'contype="0"'},
    ),
    ("medium", "a liquid", {"option": 'density="1000"'}, {"option": 'density="1.2"'}),
    (
        "stated-solimp",
        "exchange",
        {"box": 'solimp=".9 .1 .001"'},
        {"box": 'solimp=".1 .9 .001"'},
    ),
    (
        "stated-solref",
        "a step of 2 ms raises solref of box",
        {"box": 'solref=".001 1"'},
        {"box": 'solref=".004 1"'},
    ),
    (
        "stated-margin",
        "10 mm ahead",
        {"box": 'margin=".01"'},
        {"box": 'gap=".01"'},
    ),
    (
        "stated-friction",
        "friction 0.3",
        {"box": 'friction=".3"'},
        {"box": 'friction=".3" priority="1"'},
    ),
    (
        "stated-rolling",
        "torsional",
        {"box": 'friction="1 .1 .0001"'},
        {"box": 'friction="1 .1 .0001" condim="4"'},
    ),
]
"""Rule, a part of its text, and what a mistake and its right twin change in the right arm."""


def flags_of(xml, tmp_path):
    file = tmp_path / "robot.xml"
    file.write_text(xml)
    target = configuration(str(file))
    results = [rule.result(target) for rule in STATIC_RULES]
    return {result.id: result.remark for result in results if result.verdict.is_off}


@pytest.mark.parametrize(("rule", "words", "wrong", "right"), MISTAKES)
def test_a_mistake_is_named_and_its_right_twin_is_not(
    rule, words, wrong, right, tmp_path
):
    flags = flags_of(ARM.format(**{**RIGHT, **wrong}), tmp_path)
    assert words in flags.get(rule, ""), flags
    assert flags_of(ARM.format(**{**RIGHT, **right}), tmp_path) == {}


@pytest.mark.parametrize(
    ("rule", "old", "wrong", "right"),
    [
        (
            "mirror",
            'joint="FL_knee" kp="80"',
            'joint="FL_knee" kp="20"',
            'joint="FL_knee" kp="85"',
        ),
        (
            "mirror",
            '"FL_foot"',
            '"FL_foot" contype="0" conaffinity="0"',
            '"FL_foot" condim="3"',
        ),
        (
            "stated-gravcomp",
            '<body name="trunk"',
            '<body name="trunk" gravcomp="1"',
            '<body name="trunk" gravcomp="0"',
        ),
    ],
)
def test_legs_are_compared_with_each_other(rule, old, wrong, right, tmp_path):
    text = good_xml().replace("<position joint", "<position name={0} joint")
    for leg, part in product(("FL", "FR", "RL", "RR"), ("hip", "knee")):
        joint = f"{leg}_{part}"
        text = text.replace(
            f'name={{0}} joint="{joint}"', f'name="{joint}" joint="{joint}"'
        )
    assert old in text
    assert rule in flags_of(text.replace(old, wrong), tmp_path)
    assert flags_of(text.replace(old, right), tmp_path) == {}


@pytest.mark.parametrize(
    ("name", "side", "stem"),
    [
        ("left_hip_pitch", "l", "* hip pitch"),
        ("RightKnee", "r", "* knee"),
        ("FL_calf", "l", "front calf"),
        ("RF_calf", "r", "front calf"),
        ("hip_rl", "l", "hip rear"),
        ("left_right_foot", "", "* * foot"),
        ("flange", "", "flange"),
        ("link_3", "", "link 3"),
    ],
)
def test_a_name_says_a_side(name, side, stem):
    assert side_of(name) == (side, stem)


HEAVY = ARM.format(**{**RIGHT, "mass": "50", "inertia": ".05 .45 .45"})


def density_of(folder, xml):
    (folder / "robot.xml").write_text(xml)
    (result,) = check(str(folder / "robot.xml"), only=["density"]).checks
    return result


def test_a_finding_is_accepted_with_a_reason(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert density_of(tmp_path, HEAVY).is_flag
    accepted = density_of(
        tmp_path, f"<!-- gauge: accept density:link: a weight -->{HEAVY}"
    )
    assert (accepted.accepted, accepted.is_flag, accepted.severity) == (
        "a weight",
        False,
        "",
    )
    assert density_of(
        tmp_path, f"<!-- gauge: accept density:arm: a weight -->{HEAVY}"
    ).is_flag
    (tmp_path / "gauge.toml").write_text('[sanity.accept]\ndensity = "a weight"')
    assert density_of(tmp_path, HEAVY).accepted == "a weight"
    (tmp_path / "gauge.toml").write_text('[sanity.accept]\ndensity = ""')
    with pytest.raises(TargetError, match="toml: density is accepted without"):
        density_of(tmp_path, HEAVY)


@pytest.mark.parametrize(
    ("entry", "note"),
    [
        ("density:link", None),
        ("density", None),
        (
            "density:links",
            "density:links accepts no finding; findings: density:link",
        ),
        ("density:arm", "density:arm accepts no finding; findings: density:link"),
    ],
)
def test_an_entry_that_accepts_nothing_is_said_with_its_file(
    tmp_path, monkeypatch, entry, note
):
    monkeypatch.chdir(tmp_path)
    report = check_of(tmp_path, HEAVY, "density")
    (tmp_path / "gauge.toml").write_text(f'[sanity.accept]\n"{entry}" = "a weight"')
    from_toml = check_of(tmp_path, HEAVY, "density")
    (tmp_path / "gauge.toml").unlink()
    comment = f"<!-- gauge: accept {entry}: a weight: of lead -->"
    in_file = check_of(tmp_path, comment + HEAVY, "density")
    assert report.notes == ()
    for found, file in ((from_toml, "gauge.toml"), (in_file, "robot.xml")):
        assert [text.startswith(f"{file}: {note}") for text in found.notes] == (
            [True] if note else []
        )
        assert bool(note) == ("note:" in found.screen)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[sanity.accept]\ndensty = "x"', "unknown check 'densty'; did you mean den"),
        ('[sanity.accpet]\ndensity = "x"', "sanity.accpet: unknown key; write"),
        ('density = "x"', "density: unknown key; write"),
        ("sanity = 3", "sanity: .* valid dictionary"),
        ("[sanity.accept]\ndensity = 3", "sanity.accept.density: .* valid string"),
        ('[sanity.accept]\ndensity = " "', "density is accepted without a reason"),
        ("[sanity.accept\n", "not a TOML file"),
        ("<!-- gauge: acept density: x -->", '"gauge: acept density: x" is not read'),
        ("<!-- gauge: accept densty: x -->", "unknown check 'densty'"),
        ("<!-- gauge: accept density -->", "density is accepted without a reason"),
    ],
)
def test_an_entry_that_cannot_be_read_is_an_error(tmp_path, monkeypatch, text, message):
    monkeypatch.chdir(tmp_path)
    is_comment = text.startswith("<")
    if not is_comment:
        (tmp_path / "gauge.toml").write_text(text)
    with pytest.raises(TargetError, match=message):
        density_of(tmp_path, text * is_comment + HEAVY)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[sanity.accept]",
        '[sanity.accept]\n"density:link" = "a weight"\nmirror = "one arm"',
        "<!--gauge:accept density:link: a weight-->",
        "<!-- Gauge: accept density: a weight\n of lead -->",
        "<!-- a gauge: of steel -->",
    ],
)
def test_an_entry_in_any_form_of_its_file_is_read(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    is_comment = text.startswith("<")
    if not is_comment:
        (tmp_path / "gauge.toml").write_text(text)
    found = density_of(tmp_path, text * is_comment + HEAVY)
    assert bool(found.accepted) == ("density" in text)


def test_a_finding_with_one_element_accepted_says_which_are_left(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    link = """<body name="{0}" pos="{1} 0 1"><joint name="{0}" axis="0 1 0"/>
      <geom name="{0}" size=".05" mass="50"/></body>"""
    bodies = link.format("link", 0) + link.format("other", 2)
    motors = '<motor joint="link"/><motor joint="other"/>'
    xml = (
        f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>"
    )
    (tmp_path / "gauge.toml").write_text('[sanity.accept]\n"density:link" = "lead"')
    assert check_of(tmp_path, HEAVY, "density").notes == ()
    report = check_of(tmp_path, xml, "density")
    assert report.notes == ("density stays: no reason accepts density:other",)
    assert [*report.flags] == ["density"]


def test_a_cause_has_its_effects_and_a_failed_assertion_shows_the_screen(tmp_path):
    (tmp_path / "robot.xml").write_text(
        good_xml().replace('range="-60 240"', 'range="-1 4"')
    )
    report = check(
        str(tmp_path / "robot.xml"), only=["range-unit", "robot-stands", "model-*"]
    )
    assert [*report.warnings] == ["range-unit"]
    assert "looks like radians in a file of degrees" in repr(report.warnings)
    assert report.warnings["range-unit"].line == 5


def test_what_is_unusual_is_advice_beside_what_the_run_shows(tmp_path):
    """A trunk whose mass is no metal's is advice; that its motors do not hold it is measured."""
    heavy = good_xml().replace('mass="7.84"', 'density="150000"')
    report = check_of(tmp_path, heavy, "density", "robot-torque")
    assert [*report.flags] == ["density", "robot-torque"]
    assert [*report.warnings] == ["robot-torque"] and not report.errors
    lines = report.screen.strip().splitlines()
    assert lines[1].startswith("Advice:") and "kg/m^3" in lines[2]
    assert lines[3].startswith("Run:") and "takes" in lines[4]


def test_advice_whose_correction_cures_a_fall_is_its_cause(tmp_path):
    text, off = good_xml(), ' contype="0" conaffinity="0"'
    for geom in ('geom name="FL_foot"', 'geom name="FL_calf"'):
        assert geom in text
        text = text.replace(geom, geom + off)
    (tmp_path / "robot.xml").write_text(text)
    report = check(str(tmp_path / "robot.xml"), only=["mirror", "robot-*"])
    assert [*report.flags] == [*report.warnings] == ["mirror"]
    assert report.warnings["mirror"].fix == 'geom "FL_calf": contype="1"; 1 more'
    assert "also: it falls or jumps" in report.screen
    causes = {result.id: result.cause for result in report.checks}
    assert causes["robot-stands"] == causes["robot-feet"] == "mirror"


def check_of(folder, xml, *only):
    (folder / "robot.xml").write_text(xml)
    return check(str(folder / "robot.xml"), only=only, explain=False)


@pytest.mark.parametrize(("condim", "is_lost"), [(1, False), (3, True), (6, True)])
def test_a_contact_without_friction_loses_none(condim, is_lost, tmp_path):
    constants = {"box": f'friction=".3" condim="{condim}"', "floor": 'condim="1"'}
    flags = flags_of(ARM.format(**{**RIGHT, **constants}), tmp_path)
    assert ("stated-friction" in flags) is is_lost


FIXES = {
    "range-unit": ({"range": "-57.3 86"}, 'joint "elbow": range="-1.00007 1.50098"'),
    "command-range": ({"commands": "-57 86"}, 'actuator "elbow": ctrlrange="-1 1.5"'),
    "stated-solimp": (
        {"box": 'solimp=".9 .1 .001"'},
        'geom "box": solimp="0.1 0.9 0.001 0.5 2"',
    ),
    "stated-margin": ({"box": 'margin=".01" gap=".01"'}, 'geom "box": margin="0"'),
    "stated-friction": ({"box": 'friction=".3"'}, 'geom "box": priority="1"'),
    "density": ({"mass": "50", "inertia": ".05 .45 .45"}, ""),
}


@pytest.mark.parametrize("rule", FIXES)
def test_the_attribute_that_is_named_is_corrected_and_tried(rule, tmp_path):
    wrong, fix = FIXES[rule]
    file = tmp_path / "robot.xml"
    file.write_text(ARM.format(**{**RIGHT, **wrong}))
    (result,) = check(str(file), only=[rule]).checks
    assert result.is_flag and result.fix == fix


ODD = {
    "condim": ('"FR_foot"', '"FR_foot" condim="6"', 'geom "FR_foot": condim="3"'),
    "damping": ('"RL_knee" axis', '"RL_knee" damping="5" axis', 'damping="0.5"'),
    "range": (
        'name="RR_knee" axis="0 1 0" range="-170 170"',
        'name="RR_knee" axis="0 1 0" range="-60 60"',
        'joint "RR_knee": range="-170 170"',
    ),
    "keyframe": ('qpos="0 0 .322', 'qpos="0 0 .3', 'key "home": qpos="0 0 0.322 '),
    "armature": ('armature="0.005"', "", "armature="),
    "exclude": (
        '<geom name="FL_calf"',
        '<geom name="FL_ball" size=".17" mass="0" pos=".15 0 .15"/><geom name="FL_calf"',
        '<exclude body1="',
    ),
}
"""Attribute of a quadruped, a wrong one, and the fix: the value of the other legs, a start above the floor, ..."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name in ("condim", "damping")))
        for name in ODD
    ],
)
def test_a_leg_gets_the_value_of_the_others(name, tmp_path, gauge):
    old, wrong, fix = ODD[name]
    text = good_xml().replace('forcerange="-40 40"', 'forcerange="-400 400"')
    (tmp_path / "robot.xml").write_text(text.replace(old, wrong))
    only = "start-overlap,mirror,armature"
    report = check(str(tmp_path / "robot.xml"), only=[only])
    assert [fix for result in report.flags.values() if fix in result.fix], report.flags
    gauge("sanity", "robot.xml", "--only", only, "--fix", "fixed.xml")
    assert not check(str(tmp_path / "fixed.xml"), only=[only]).flags


ROLL = """<mujoco><worldbody><body name="{side}_ankle"><joint name="{name}_{last}" axis="1 0 0"/>
  <joint name="{name}_{other}" axis="0 1 0"/><geom size=".1"/></body>
  <body name="right_ankle"><joint name="{name}_{mate}"/><geom size=".1"/></body></worldbody></mujoco>"""
"""Two joints of an ankle, and one of the right ankle: a roll, or a part of the other side."""

LIMBS = ("LEG_ANKLE", "arm_wrist", "J4", "hip_flex")


@pytest.mark.parametrize(("last", "other"), [("R", "P"), ("R", "Y"), ("r", "p")])
def test_a_roll_beside_a_pitch_is_no_right_side(last, other, tmp_path):
    for name in LIMBS:
        words = {"name": name, "side": "left", "last": last}
        right = ROLL.format(**words, other=other, mate="2")
        assert "names" not in flags_of(right, tmp_path)
        mate = "L" if last == "R" else "l"
        wrong = flags_of(ROLL.format(**words, other="2", mate=mate), tmp_path)
        assert "on the other side" in wrong["names"]


@pytest.mark.parametrize(
    ("span", "is_wrong"),
    [(6, False), (180, True), (720, True), (7200, True), (1e5, False), (2e16, False)],
)
def test_a_range_without_an_end_is_no_range_in_degrees(span, is_wrong, tmp_path):
    for low in (0, -0.5 * span, -span):
        text = ARM.format(**{**RIGHT, "range": f"{low} {low + span}"})
        assert ("range-unit" in flags_of(text, tmp_path)) is is_wrong


SMALL = "<mujoco><worldbody>{}</worldbody>{}</mujoco>"


@pytest.mark.parametrize("gas_kg_per_m3", [0.08, 0.12, 0.167, 0.21, 0.25])
@pytest.mark.parametrize("lift", [1.5, 7.2])
def test_a_body_lighter_than_air_floats_by_its_gravcomp(gas_kg_per_m3, lift, tmp_path):
    body = '<body gravcomp="{}"><freejoint/><geom type="ellipsoid" size=".11 .1 .15" density="{}"/></body>'
    for gravcomp in (0.0, 0.5, 1.0, lift):
        xml = SMALL.format(body.format(gravcomp, gas_kg_per_m3), "")
        assert density_of(tmp_path, xml).is_flag is (gravcomp < lift)


@pytest.mark.parametrize("span", [0.3, 0.5, 1, 1.6, 2, 3, 4, 4.5, 5, 6])
def test_a_small_range_looks_like_radians_in_a_file_of_degrees_alone(span, tmp_path):
    for unit, per_degree in {"radian": 0.0174533, "degree": 1.0}.items():
        arm = {**RIGHT, "angle": f'angle="{unit}"'}
        high = span * per_degree
        text = ARM.format(**{**arm, "range": f"{-0.2 * high} {high}"})
        is_flag = "range-unit" in flags_of(text, tmp_path)
        assert is_flag is (unit == "degree" and span < 5.0)


@pytest.mark.parametrize("length_m", [0.02, 0.04, 0.07, 0.1, 0.15])
@pytest.mark.parametrize("ratio", [-0.5, 1.0])
def test_a_coupling_brakes_a_motion_without_damping(length_m, ratio, tmp_path):
    link = f'<geom type="capsule" fromto="0 0 0 {length_m} 0 0" size=".008"/>'
    bodies = f"""<body><joint name="near" axis="0 1 0"/>{link}
      <body pos="{length_m} 0 0"><joint name="far" axis="0 1 0"/>{link}</body></body>"""
    mimic = f'<equality><joint joint1="far" joint2="near" polycoef="0 {ratio} 0 0 0"/></equality>'
    file = tmp_path / "robot.xml"
    for coupling in ("", mimic):
        file.write_text(SMALL.format(bodies, coupling))
        report = check(str(file), only=["robot-energy"], explain=False)
        assert ("robot-energy" in report.flags) is not bool(coupling)


FREE = """<body pos="0 0 1"><freejoint name="root"/><geom {} size=".05" density="{}"/><site name="hook"/>
  <body pos=".1 0 0"><joint name="part" axis="0 1 0"/><geom size=".02" {}/></body></body>"""
GHOST = 'contype="0" conaffinity="0"'


@pytest.mark.parametrize(
    ("held", "falls"),
    [
        ("", False),
        ('<actuator><motor joint="part"/></actuator>', True),
        ('<actuator><motor joint="root" gear="0 0 1 0 0 0"/></actuator>', False),
        ('<actuator><motor site="hook" gear="0 0 1 0 0 0"/></actuator>', False),
        (
            '<tendon><spatial><site site="beam"/><site site="hook"/></spatial></tendon>',
            False,
        ),
    ],
)
@pytest.mark.parametrize("density", [300, 1000, 3000, 8000])
def test_what_a_rope_or_a_thruster_holds_does_not_fall(held, falls, density, tmp_path):
    floor = '<geom type="plane" size="1 1 1"/><site name="beam" pos="0 0 2"/>'
    body = FREE.format(GHOST, density, GHOST)
    flags = flags_of(SMALL.format(floor + body, held), tmp_path)
    solid = flags_of(SMALL.format(floor + FREE.format("", density, ""), held), tmp_path)
    assert ("touch" in flags) is falls and "touch" not in solid


@pytest.mark.parametrize("radius_m", [0.1, 0.2, 0.3, 0.4, 0.5])
def test_a_rod_without_mass_carries_the_weight_that_is_welded_to_it(radius_m, tmp_path):
    rod = '<body><joint/><geom type="capsule" size=".05 {0}" mass="1e-6"/>{1}</body>'
    tip = f'<body pos="0 0 {radius_m}"><geom size=".05" mass="1"/></body>'
    for weight, is_light in (("", True), (tip, False)):
        assert (
            density_of(tmp_path, SMALL.format(rod.format(radius_m, weight), "")).is_flag
            is is_light
        )


CAR = """<geom type="plane" size="9 9 1"/><body pos="0 0 .05"><freejoint/>
  <geom type="box" size=".2 .1 .02" mass="2" contype="0" conaffinity="0"/>
  <geom size=".05" pos=".15 0 0" {}/><body pos="-.1 .1 0"><joint name="l" axis="0 1 0"/>
  <geom type="cylinder" size=".05 .01" quat="1 1 0 0" {}/></body>
  <body pos="-.1 -.1 0"><joint name="r" axis="0 1 0"/>
  <geom type="cylinder" size=".05 .01" quat="1 1 0 0"/></body></body>"""
WHEELS = '<actuator><motor joint="l"/><motor joint="r"/></actuator>'


@pytest.mark.parametrize("friction", [0, 0.001, 0.01, 0.04])
def test_a_caster_may_slip_and_a_wheel_not(friction, tmp_path):
    slips = f'friction="{friction}" priority="1" condim="3"'
    assert "robot-friction" not in flags_of(
        SMALL.format(CAR.format(slips, ""), WHEELS), tmp_path
    )
    assert "robot-friction" in flags_of(
        SMALL.format(CAR.format("", slips), WHEELS), tmp_path
    )


@pytest.mark.parametrize("angle", [90, -90, 180, 30])
@pytest.mark.parametrize("axis", ["1 0 0", "0 1 0"])
def test_a_plane_on_a_turned_body_is_the_ground(angle, axis, tmp_path):
    """A body that stands for the ground turns by an angle, and its plane back by it."""
    plane = '<body axisangle="{0} {1}"><geom type="plane" size="1 1 1" axisangle="{0} {2}"/></body>'
    ball = '<body pos="0 0 1"><freejoint/><geom size=".1"/></body>'
    file = tmp_path / "robot.xml"
    file.write_text(SMALL.format(plane.format(axis, angle, -angle) + ball, ""))
    assert not check(str(file), only=["gravity"], explain=False).flags


@pytest.mark.parametrize("mass_kg", [0.001, 0.01, 0.03, 0.1])
def test_a_motor_without_a_range_has_no_usual_command(mass_kg, tmp_path):
    drone = f"""<body><freejoint name="root"/><geom size=".02" mass="{mass_kg}"/><site name="hub"/></body>"""
    motor = '<actuator><motor site="hub" gear="0 0 0 0 0 1"/></actuator>'
    file = tmp_path / "robot.xml"
    file.write_text(SMALL.format(drone, motor))
    assert not check(str(file), only=["robot-holds"], explain=False).flags
