"""Ranges for domain randomization: against the values they come from, and as files that their stacks could load."""

import ast
import csv
import json
import math
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import mujoco
import numpy as np
import pytest
from json_lines import check_lines
from places import ROOT

from gauge_envs import variants
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.variants import beyond_variants
from gauge_envs.tools.transfer.ranges import (
    FEWEST,
    Scatter,
    covering,
    friction_of_materials,
    justified_ranges,
    measured_constants,
    slides_of_one_pair,
)
from gauge_envs.tools.transfer.stack_files import STACKS, stack_file, subject_ranges

DRAWS = 1000

IDS = [one.name for one in (*variants(), *beyond_variants())]

ARM = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/>
<body name="upper"><joint name="shoulder" axis="0 1 0" frictionloss="0.3" damping="1"/>
<geom name="rod" type="capsule" size="0.02" fromto="0 0 1 0 0 0.7"/>
<body name="fore" pos="0 0 0.7"><joint name="elbow" axis="0 1 0" frictionloss="0.2"/>
<geom name="tip" size="0.03"/></body></body></worldbody>
<actuator><position name="a" joint="shoulder" kp="50"/><position name="b" joint="elbow" kp="50"/></actuator></mujoco>"""

SERVO = {
    "joints.dry_friction_n_m",
    "joints.viscous_friction_n_m_s_per_rad",
    "joints.armature_kg_m2",
    "joints.kp_n_m_per_rad",
    "joints.delay_s",
}


@pytest.fixture(name="arm")
def arm_file(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(ARM)
    return file


LIKE = ["ServoArm-so101", "SlopeSlider-2-wood"]


@pytest.fixture(name="arm_ranges", scope="module")
def arm_ranges_fixture(tmp_path_factory):
    file = tmp_path_factory.mktemp("arm") / "arm.xml"
    file.write_text(ARM)
    return subject_ranges(str(file), like=LIKE, payload_kg=(0.0, 0.3), body="fore")


def rows(name):
    with (ROOT / "studies" / name).open() as file:
        return list(csv.DictReader(file))


# --- values ---


def test_values_are_those_of_the_studies():
    known = measured_constants()
    servo = rows("joints/so101_constants.csv")
    for constant, name in (
        ("viscous_friction_n_m_s_per_rad", "damping"),
        ("delay_s", "delay"),
    ):
        fitted = [float(one["value"]) for one in servo if one["constant"] == name]
        assert known["so101"][constant].values[:6] == pytest.approx(fitted, rel=1e-3)
    carried = ("Pitch", "Elbow", "Wrist_Pitch")
    gains = [
        float(one["value"])
        for one in servo
        if one["constant"] == "kp" and one["joint"] in carried
    ]
    assert known["so101"]["kp_n_m_per_rad"].values == pytest.approx(gains, rel=1e-3)
    held = {one["joint"]: one for one in rows("joints/so101_held.csv")}
    assert known["so101"]["dry_friction_n_m"].factor == pytest.approx(
        float(held["Pitch"]["largest"]), rel=1e-3
    )
    slides = [float(one["friction"]) for one in rows("pushes/slides.csv")]
    assert known["light"]["friction"].values == pytest.approx(slides)


def test_pieces_of_a_pendulum_are_those_of_their_fits():
    single = [
        float(one["dry_rad_per_s2"])
        for one in rows("joints/swings.csv")
        if one["trial"].startswith("dry-") and one["law"] == "dry"
    ]
    # The task file has the torque of the even piece, by which fits become torques.
    ratios = np.array(measured_constants()["dry"]["dry_friction_n_m"].values) / single
    assert ratios == pytest.approx(ratios.mean(), rel=2e-3)
    for one in rows("joints/law_values.csv"):
        if one["name"] != "armature_kg_m2":
            pieces = [float(one[f"single_{k}"]) for k in range(4)]
            values = measured_constants()["viscous"][one["name"]].values
            assert values == pytest.approx(pieces, rel=1e-3)


def test_a_range_of_trials_covers_95_percent_of_further_ones():
    random = np.random.default_rng(0)
    inside = []
    for _ in range(1000):
        *first, further = random.normal(0.26, 0.005, 21)
        low, high = covering(np.mean(first), np.std(first, ddof=1), len(first))
        inside.append(low <= further <= high)
    # Three standard errors of a share of 1,000 draws.
    assert np.mean(inside) == pytest.approx(0.95, abs=3 * math.sqrt(0.95 * 0.05 / 1000))


def test_the_smallest_and_largest_hold_the_stated_share_with_any_distribution():
    random = np.random.default_rng(1)
    for one in justified_ranges("ServoArm-so101").ranges:
        # Laws of one joint promise nothing for another one.
        assert (one.inside is None) is (one.scatter is Scatter.LAWS)
        if one.inside is None:
            continue
        drawn = random.lognormal(0.0, 2.0, (3000, one.count + 1))
        values, further = drawn[:, :-1], drawn[:, -1]
        share = np.mean((values.min(1) <= further) & (further <= values.max(1)))
        assert one.inside == pytest.approx(share, abs=0.03)


# --- which range ---


def test_single_slides_give_the_friction_of_their_pair_alone():
    friction, _ = justified_ranges("SlopeSlider-2-wood").ranges
    assert (friction.scatter, friction.count) == (Scatter.TRIALS, 20)
    # Student's t of 19 degrees of freedom, 2.093; mean and standard deviation of the 20 slides.
    half = 2.0930 * 0.004503 * math.sqrt(1.05)
    assert friction.low == pytest.approx(0.257145 - half, abs=1e-5)
    assert friction.high == pytest.approx(0.257145 + half, abs=1e-5)


@pytest.mark.parametrize("name", IDS)
def test_nothing_is_left_without_a_word(name):
    found = justified_ranges(name)
    assert found.ranges or found.left_out
    assert all(one.reason for one in found.left_out)
    for one in found.ranges:
        assert one.source
        assert one.count >= FEWEST
        assert one.low < one.high
        # Rounding of digits is no scatter, and a ball's rebound says nothing about another pair.
        assert one.constant != "mass_kg"
        assert one.constant != "restitution" or name.startswith("BouncingBall")


def test_a_servo_arm_has_its_gains_and_friction():
    found = justified_ranges("ServoArm-so101")
    assert {one.name for one in found.ranges} == SERVO
    dry = next(one for one in found.ranges if one.constant == "dry_friction_n_m")
    assert (dry.operation, dry.high) == ("scale", 1.75)


def test_a_joint_with_two_pieces_has_no_range():
    dry = justified_ranges("JointPendulum-dry").left_out[0]
    assert "2 values, 0.000553 and 0.000531 N m" in dry.reason
    assert "needs 3" in dry.reason


def test_a_robot_on_an_unknown_floor_may_meet_any_measured_pair(arm):
    found = subject_ranges(str(arm))
    assert [one.name for one in found.ranges] == ["contact.friction"]
    materials = friction_of_materials()
    # PTFE on steel, and a rubber ball on wood.
    assert materials.low <= 0.10 < 0.80 < materials.high < 0.82
    assert all(materials.low < one.low < one.high < materials.high for one in slides_of_one_pair())  # fmt: skip
    assert {one.name for one in found.left_out} == {
        "contact.restitution", "joints: friction, damping, armature, gain, delay", "start", "mass",
    }  # fmt: skip


def test_a_factor_needs_a_friction_in_the_file(arm):
    arm.write_text(ARM.replace('frictionloss="0.2"', ""))
    found = subject_ranges(str(arm), like=LIKE)
    (dry,) = (one for one in found.left_out if one.name == "joints.dry_friction_n_m")
    assert "no frictionloss for elbow" in dry.reason


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"payload_kg": (0.0, 1.0)}, "--body, one of fore, upper; none is given"),
        ({"payload_kg": (1.0, 0.0), "body": "fore"}, "smallest and the largest"),
        ({"like": ["SlopeSlider-2-wood", "SlopeSlider-2-metal"]}, "two of them state contact.friction"),
    ],
)  # fmt: skip
def test_a_request_that_cannot_be_met_says_what_would_be_right(arm, options, words):
    with pytest.raises(ParameterError, match=words):
        subject_ranges(str(arm), **options)


# --- files ---


def table(text):
    """The ranges of a file, as its code has them."""
    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign) and node.targets[0].id == "RANGES":
            return ast.literal_eval(node.value)
    raise AssertionError("no RANGES")


def load(text, **modules):
    """Run the code of a file with stand-ins for the modules of its stack."""
    names = {}
    sys.modules.update(modules)
    try:
        exec(compile(text, "randomized", "exec"), names)
    finally:
        for one in modules:
            del sys.modules[one]
    return SimpleNamespace(**names)


@pytest.mark.parametrize("stack", STACKS)
@pytest.mark.parametrize("name", ["arm", "SlopeSlider-2-wood", "ServoArm-so101", "BouncingBall-rubber"])  # fmt: skip
def test_a_file_holds_what_was_justified_and_no_more(stack, name, arm_ranges):
    found = arm_ranges if name == "arm" else justified_ranges(name)
    text = stack_file(found, stack)
    stated = table(text)
    justified = {one.name: one for one in found.ranges}
    assert stated
    assert stated.keys() <= justified.keys()
    random = np.random.default_rng(2)
    for key, one in stated.items():
        drawn = random.uniform(one["low"], one["high"], DRAWS)
        low, high = justified[key].low, justified[key].high
        width = 1e-5 * (high - low) + 1e-6 * abs(high)
        assert drawn.min() >= low - width
        assert drawn.max() <= high + width
        # A uniform draw uses the whole range.
        assert np.ptp(drawn) > 0.98 * (high - low)
        comment = text[: text.index(f'"{key}"')].rsplit("},", 1)[-1]
        assert "n = " in comment or "stated" in comment
    for key in justified.keys() - stated.keys():
        assert f"- {key}: " in text
    for one in found.left_out:
        assert f"- {one.name}: " in text


def test_mujoco_sets_what_it_draws(arm_ranges):
    model = mujoco.MjModel.from_xml_string(ARM)
    randomizer = load(stack_file(arm_ranges, "mujoco")).Randomizer(model)
    random = np.random.default_rng(3)
    masses, kept = [], []
    for _ in range(DRAWS):
        drawn = randomizer(random)
        assert model.dof_damping[1] == drawn["elbow.viscous_friction_n_m_s_per_rad"]
        assert -model.actuator_biasprm[0, 1] == drawn["shoulder.kp_n_m_per_rad"]
        assert set(model.geom_friction[:, 0]) == {drawn["contact.friction"]}
        masses.append(model.body("fore").mass[0])
        kept.append([drawn["shoulder.dry_friction_n_m"], drawn["elbow.dry_friction_n_m"]])  # fmt: skip
    stated = mujoco.MjModel.from_xml_string(ARM).body("fore").mass[0]
    # Draws do not add up, and joints are drawn apart.
    assert stated < min(masses) < max(masses) < stated + 0.3
    dry = np.array(kept) / [0.3, 0.2]
    assert dry.min() == pytest.approx(1 / 1.75, rel=0.01)
    assert dry.max() == pytest.approx(1.75, rel=0.01)
    assert abs(np.corrcoef(dry.T)[0, 1]) < 0.1


def test_gymnasium_draws_constants_that_the_id_takes():
    found = load(stack_file(justified_ranges("BouncingBall-rubber"), "gymnasium"))
    random = np.random.default_rng(4)
    heights = [found.drawn_parameters(random)["ball.position_m"][2] for _ in range(DRAWS)]  # fmt: skip
    # The scatter of the real drops' start height.
    assert np.ptp(heights) == pytest.approx(2 * 2.0796 * 0.000955 * math.sqrt(23 / 22), rel=0.01)  # fmt: skip
    env = found.RandomizedConstants()
    _, info = env.reset(seed=5)
    assert 0.732 < info["constants"]["ball.restitution"] < 0.742
    assert env.unwrapped.experiment.overrides["ball.restitution"] == info["constants"]["ball.restitution"]  # fmt: skip
    env.close()


class Fake(SimpleNamespace):
    """A joint or link of SAPIEN, of which a test needs what it keeps."""

    def set_friction(self, value):
        self.friction = value

    def set_armature(self, values):
        (self.armature,) = values

    def set_drive_properties(self, stiffness, damping, force_limit, mode):
        assert (force_limit, mode) == (10.0, "force")
        self.stiffness, self.damping = stiffness, damping

    def set_mass(self, value):
        self.mass = value

    def get_collision_shapes(self):
        return [self]

    def set_physical_material(self, material):
        self.material = material


def test_maniskill_draws_from_what_the_robot_states_at_each_call(arm_ranges):
    joints = {
        name: SimpleNamespace(
            _objs=[Fake(friction=0.3, stiffness=50, damping=1, force_limit=10, drive_mode="force") for _ in "ab"]
        )
        for name in ("shoulder", "elbow")
    }  # fmt: skip
    links = [
        SimpleNamespace(name=name, _objs=[Fake(mass=1.0), Fake(mass=1.0)])
        for name in ("upper", "fore")
    ]
    physx = module("sapien.physx", PhysxMaterial=lambda *values: values)
    sapien = module("sapien", physx=physx)
    text = stack_file(arm_ranges, "maniskill")
    found = load(text, **{"sapien": sapien, "sapien.physx": physx})
    randomizer = found.Randomizer(SimpleNamespace(links=links, joints_map=joints))
    random = np.random.default_rng(6)
    masses, frictions = [], []
    for _ in range(DRAWS):
        first, second = randomizer(random)
        elbow = joints["elbow"]._objs
        assert elbow[0].friction == first["elbow.dry_friction_n_m"]
        assert elbow[1].stiffness == second["elbow.kp_n_m_per_rad"]
        assert elbow[1].damping == second["elbow.viscous_friction_n_m_s_per_rad"]
        assert links[0]._objs[1].material == (*[second["contact.friction"]] * 2, 0.0)
        masses.append(links[1]._objs[0].mass)
        frictions.append(elbow[0].friction)
    assert 1.0 <= min(masses) < 1.01 < 1.29 < max(masses) <= 1.3
    assert 0.3 / 1.75 <= min(frictions) < max(frictions) <= 0.3 * 1.75


# isaaclab.envs.mdp of isaac-sim/IsaacLab, wheel 2.3.2 and 3308ee75 of November 2026: parameters after env and env_ids,
# optional ones in brackets. The terms read `operation` before they are called, so that it is required.
SIGNATURES = {
    "randomize_actuator_gains": "asset_cfg operation [stiffness_distribution_params] [damping_distribution_params] "
    "[distribution]",
    "randomize_joint_parameters": "asset_cfg operation [friction_distribution_params] [armature_distribution_params] "
    "[lower_limit_distribution_params] [upper_limit_distribution_params] [distribution]",
    "randomize_rigid_body_material": "static_friction_range dynamic_friction_range restitution_range num_buckets "
    "asset_cfg [make_consistent]",
    "randomize_rigid_body_mass": "asset_cfg mass_distribution_params operation [distribution] [recompute_inertia]",
}
POSITIVE = {"stiffness_distribution_params", "mass_distribution_params"}
"""Ranges of factors whose lower end must be above 0; that of others is at least 0."""


def module(name, **values):
    made = ModuleType(name)
    vars(made).update(values)
    return made


def isaac_file(text):
    mdp = module("isaaclab.envs.mdp", **{name: name for name in SIGNATURES})
    envs = module("isaaclab.envs", mdp=mdp)
    managers = module(
        "isaaclab.managers",
        EventTermCfg=SimpleNamespace,
        SceneEntityCfg=lambda name, **names: (name, names),
    )
    return load(
        text,
        **{
            "isaaclab": module("isaaclab", envs=envs),
            "isaaclab.envs": envs,
            "isaaclab.envs.mdp": mdp,
            "isaaclab.managers": managers,
        },
    )


def test_isaac_lab_gets_terms_that_its_functions_take(arm_ranges):
    found = isaac_file(stack_file(arm_ranges, "isaaclab"))
    terms = found.event_terms()
    for term in terms.values():
        words = SIGNATURES[term.func].split()
        required = {word for word in words if not word.startswith("[")}
        assert required <= set(term.params) <= {word.strip("[]") for word in words}
        assert term.mode == "startup"
        operation = term.params.get("operation", "abs")
        assert operation in ("add", "scale", "abs")
        assert term.params.get("distribution", "uniform") == "uniform"
        for name, ends in term.params.items():
            if name.endswith(("_params", "_range")):
                low, high = ends
                assert low <= high
                is_positive = name in POSITIVE and operation == "scale"
                assert low > 0.0 if is_positive else low >= 0.0
    assert len(terms) == 6
    assert terms["contact_friction"].params["static_friction_range"][0] == pytest.approx(0.2475, abs=1e-4)  # fmt: skip
    # 1 to 26 ms, in steps of 5 ms.
    assert found.delay_steps(0.005) == {"min_delay": 0, "max_delay": 5}


def test_isaac_lab_draws_no_viscous_friction_from_a_range_in_n_m(arm_ranges):
    """Its function draws both from one range, where a factor leaves a viscous friction of 0."""
    terms = isaac_file(stack_file(arm_ranges, "isaaclab")).event_terms()
    assert terms["joints_dry_friction_n_m"].params["operation"] == "scale"
    with pytest.raises(ParameterError, match="viscous friction from the same range"):
        stack_file(justified_ranges("JointPendulum-viscous"), "isaaclab")


# --- command ---


def test_the_command_writes_a_file_and_says_what_is_left_out(gauge, arm):
    done = gauge("transfer", "randomize", arm, "--for", "mujoco", "--json")
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert [line["kind"] for line in lines] == ["range", *["left_out"] * 4]
    check_lines("transfer randomize", done.stdout)
    compile(Path("randomized_mujoco.py").read_text(), "file", "exec")
    bare = gauge("transfer", "randomize", "FoamBending-soft", "--for", "gymnasium")
    assert bare.exit_code == 2
    assert "no range is justified" in bare.output
    assert "stiffness, damping and density" in gauge("transfer", "randomize", "FoamBending-soft").stdout  # fmt: skip
