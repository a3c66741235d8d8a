"""Planted causes are named with their value; what is not in the list is not."""

from dataclasses import replace

import numpy as np
import pytest
from planted_arm import ARM, CART_POLE, SERVO, paste, record

from gauge_envs.tools.replay import ReplayVerdict, read_log, replay
from gauge_envs.tools.replay.fit import Problem
from gauge_envs.tools.replay.log import ControlMap, LogMap
from gauge_envs.tools.replay.model import Replayer, build_setup, load_model
from gauge_envs.tools.replay.report import replay_document


def set_stiffness(model):
    model.actuator_gainprm[:, 0] *= 0.7
    model.actuator_biasprm[:, 1] *= 0.7


def set_friction(model):
    model.dof_frictionloss[1] = 0.3


def set_armature(model):
    model.dof_armature[1] = 0.03


def set_gravity(model):
    model.opt.gravity[2] = -7.0


def set_effort(model):
    model.actuator_forcelimited[0] = 1
    model.actuator_forcerange[0] = -3.0, 3.0


def set_stop(model):
    model.jnt_limited[1] = 1
    model.jnt_range[1] = -3.0, 0.3


def set_pole(model):
    model.dof_frictionloss[0] = 2.0


def set_servo(model):
    model.actuator_gainprm[0, 0] = 12.0
    model.actuator_biasprm[0, 1] = -12.0
    model.dof_armature[0] = 0.024
    model.dof_damping[:] *= 2.0


def set_servo_friction(model):
    model.dof_frictionloss[0] = 0.05


slow = pytest.mark.slow
PLANTED = [
    ("delay", {"robot": SERVO, "delay_s": 0.03}, 0.03),
    pytest.param("joint order", {"columns": (1, 0)}, None, marks=slow),
    pytest.param(
        "dry friction", {"robot": CART_POLE, "change": set_pole}, 2.0, marks=slow
    ),
    pytest.param("kp", {"change": set_stiffness}, 28.0, marks=slow),
    pytest.param("dry friction", {"change": set_friction}, 0.3, marks=slow),
    pytest.param("armature", {"change": set_armature}, 0.03, marks=slow),
    pytest.param("gravity or tilt", {"change": set_gravity}, -7.0, marks=slow),
    pytest.param("effort limit", {"change": set_effort}, 3.0, marks=slow),
    pytest.param("joint limit", {"change": set_stop}, 0.3, marks=slow),
]
"""What is planted, and the value of the first number of the answer."""


@pytest.mark.parametrize(("cause", "planted", "value"), PLANTED)
def test_a_planted_cause_is_named_with_its_value(tmp_path, cause, planted, value):
    log, model = record(tmp_path, **planted)
    line = replay(log, model).line
    best = line.candidates[0]
    assert line.verdict is ReplayVerdict.CAUSE
    assert best.cause == cause
    assert best.share > 0.97
    if value is not None:
        assert best.values[0].fitted == pytest.approx(value, rel=0.05)
    if cause in ("armature", "gravity or tilt", "joint limit"):
        paste(model, line.paste["MJCF"])
        assert replay(log, model).verdict is ReplayVerdict.NOISE


FLOOR = '<worldbody><geom type="plane" size="1 1 1" pos="0 0 -0.53"/>'


@pytest.mark.parametrize("robot", [ARM, ARM.replace("<worldbody>", FLOOR)])
def test_the_error_of_the_right_model_is_that_of_the_noise(tmp_path, robot):
    """A hand that strikes the floor amplifies the noise of the state before."""
    log, model = record(tmp_path, robot=robot)
    result = replay(log, model)
    problem = result.problem
    assert result.verdict is ReplayVerdict.NOISE
    assert problem.before.error == pytest.approx(1.0, abs=0.25)
    assert np.mean(problem.before.training**2) == pytest.approx(1.0, abs=0.25)
    # The pieces that a fit sees have no part in its error.
    seen = replace(problem.before, training=0.0 * problem.before.training)
    assert seen.error == problem.before.error


def test_two_causes_are_named_together(tmp_path):
    planted = {"robot": SERVO, "change": set_stiffness, "delay_s": 0.03}
    line = replay(*record(tmp_path, **planted)).line
    assert line.verdict is ReplayVerdict.SEVERAL
    assert {each.cause for each in line.several} == {"kp", "delay"}
    # A cause with a value for each of many joints lists none.
    several = tuple(replace(each, values=()) for each in line.several)
    document = replay_document(replace(line, several=several))
    assert document.parts[0].text == line.sentence


def test_a_force_that_is_not_in_the_list_is_not_explained(tmp_path):
    line = replay(
        *record(
            tmp_path,
            robot=SERVO,
            push=lambda now_s: 2.0 * np.sign(np.sin(7.0 * now_s)),
        )
    ).line
    assert line.verdict is ReplayVerdict.NOTHING
    assert line.sentence.startswith("Nothing in the list explains it (best: ")
    assert line.paste == {}


@slow
def test_backlash_is_no_dry_friction(tmp_path):
    """A dead zone of the servo looks like losses, which take most of the error and are not said to explain it."""
    line = replay(*record(tmp_path, dead_zone=0.03)).line
    assert line.verdict in (ReplayVerdict.PART, ReplayVerdict.NOTHING)
    assert " explain" not in line.sentence.replace("list explains", "")


@slow
def test_a_push_in_one_piece_hides_no_cause(tmp_path):
    line = replay(
        *record(
            tmp_path,
            robot=SERVO,
            change=set_servo_friction,
            push=lambda now_s: 10.0 * (3.0 < now_s < 3.1),
        )
    ).line
    assert [each.cause for each in line.named] == ["dry friction"]
    assert line.named[0].values[0].fitted == pytest.approx(0.05, rel=0.05)
    assert any("unlike the rest" in text for text in line.findings)


@slow
def test_laws_that_are_one_are_both_named(tmp_path):
    def change(model):
        model.actuator_biasprm[0, 2] -= 2.0

    line = replay(*record(tmp_path, change=change)).line
    assert {line.candidates[0].cause, *line.indistinguishable} >= {"kd", "damping"}


def test_two_logs_compare_with_the_first(tmp_path):
    first, model = record(tmp_path, robot=SERVO, change=set_servo)
    first = first.rename(tmp_path / "first.npz")
    second, _ = record(tmp_path, robot=SERVO, change=set_servo)
    line = replay(first, model, second).line
    assert line.verdict is ReplayVerdict.NOISE
    assert line.baseline_over_noise > 2.0
    assert line.sentence.startswith("The model predicts log.npz as badly as first.npz")
    assert all(row.repeat_rms < 1e-6 for row in line.joints)


def test_a_motor_with_targets_takes_its_law_from_the_map(tmp_path):
    log, file = record(tmp_path)
    servo = load_model(file)
    motors = (
        file.read_text()
        .replace("<position", "<motor")
        .replace('kp="40" kv="1.5"', "")
        .replace('kp="20" kv="0.8"', "")
    )
    file.write_text(motors)
    model = load_model(file)
    control = ControlMap(
        kp={"shoulder": 40.0, "elbow": 20.0}, kd={"shoulder": 1.5, "elbow": 0.8}
    )
    errors = []
    for each, law in ((servo, ControlMap()), (model, control)):
        read = read_log(log, mapped=LogMap(control=law))
        setup = build_setup(each, read)
        errors.append(Problem(Replayer(read, setup.model), setup).before.training)
    assert np.allclose(*errors, atol=1e-6)
