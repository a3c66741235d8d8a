"""Servo logs in MJCF models: logs from plain MuJoCo at a quarter of the step, and from closed forms."""

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from servo_laws import JOINT

from gauge_envs.backends import backend
from gauge_envs.errors import ParameterError
from gauge_envs.runs.rollout import DivergedError
from gauge_envs.tools.identify import (
    Log,
    Setting,
    identify,
    one_joint,
    read_log,
    read_mjcf,
)
from gauge_envs.tools.identify.baselines import baselines, lagged
from gauge_envs.tools.identify.fit import AS_WELL, _to_leave_out, machine_of
from gauge_envs.tools.identify.intervals import SCALE, settings_of
from gauge_envs.tools.identify.model_files import joints_of_model
from gauge_envs.tools.identify.mujoco_joints import ModelJoints, start_at
from gauge_envs.tools.identify.rig import SceneJoints
from gauge_envs.tools.identify.stages import Fitter
from gauge_envs.tools.identify.words import identified_document

ARM = """<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody><body>
  <SHOULDER/><inertial pos="0 0 -.1" mass=".2" diaginertia="1e-3 1e-3 1e-3"/>
  <body pos="0 0 -.2"><JOINT/><inertial pos="0 0 -.1" mass=".3" diaginertia="2e-3 2e-3 2e-3"/></body>
</body></worldbody>{rest}</mujoco>"""
TRUTH = (
    '<joint name="elbow" axis="0 1 0" frictionloss="0.05" '
    'solimpfriction="0.9999 0.9999 0.001" solreffriction="0.001 1"/>'
)
SHOULDER = '<joint name="shoulder" axis="0 1 0"/>'
KP, KV, DELAY_S, NOISE_RAD = 6.0, 0.25, 0.03, 5e-4
STEP_S = 0.002
NAMES = ("dry_friction_n_m", "armature_kg_m2", "kp_n_m_per_rad", "kv_n_m_s_per_rad", "delay_s")  # fmt: skip


def arm(elbow="", *, step=STEP_S, rest="", shoulder=SHOULDER):
    """The model; without a shoulder, its link is fixed."""
    joint = elbow or '<joint name="elbow" axis="0 1 0"/>'
    xml = ARM.format(step=step, rest=rest).replace("<SHOULDER/>", shoulder)
    return xml.replace("<JOINT/>", joint)


def played(xml, command, times_s):
    """Angles of the elbow while the shoulder stays, in plain MuJoCo; `command` is a function of time."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    place = model.joint("elbow").qposadr
    angles = []
    done = 0
    for until_s in times_s:
        while done < round(until_s / model.opt.timestep):
            data.ctrl[0] = command(done * model.opt.timestep)
            mujoco.mj_step(model, data)
            done += 1
        angles.append(float(data.qpos[place][0]))
    return np.array(angles)


def servo_log(name, seed, armature=0.0, noise_rad=NOISE_RAD):
    """A log of random steps of the elbow, which starts at rest and hangs."""
    random = np.random.default_rng(seed)
    times_s = np.arange(400) * 0.02
    steps = np.repeat(random.uniform(-0.6, 0.6, 20), 20)
    steps[:20] = 0.0

    def held(time_s):
        row = np.searchsorted(times_s, time_s - DELAY_S + 1e-9, side="right") - 1
        return steps[max(row, 0)]

    servo = f'<position joint="elbow" kp="{KP}" kv="{KV}"/>'
    rest = f"<actuator>{servo}</actuator>"
    joint = TRUTH.replace("<joint", f'<joint armature="{armature}"')
    xml = arm(joint, step=0.0005, rest=rest, shoulder="")
    angles = played(xml, held, times_s) + noise_rad * random.standard_normal(400)
    return Log(name, times_s, angles[:, None], steps[:, None], joints=("elbow",))


@pytest.fixture(scope="module")
def found():
    model = mujoco.MjSpec.from_string(arm())
    held_out = servo_log("other", 2)
    logs = [servo_log("one", 1)]
    return identify(backend("mujoco"), model, logs, NAMES, held_out=[held_out])


def test_the_numbers_of_one_joint_of_an_arm_are_found(found):
    values = {one.name: one for one in found.settings}
    truth = dict(zip(NAMES, (0.05, 0.0, KP, KV, DELAY_S), strict=True))
    for name in ("dry_friction_n_m", "kp_n_m_per_rad", "kv_n_m_s_per_rad", "delay_s"):
        assert values[name].pasted == pytest.approx(truth[name], rel=0.06), name
    assert values["kp_n_m_per_rad"].unknown == ""
    assert found.held_out_rad["other"][0] < 2.0 * NOISE_RAD


def test_what_is_not_determined_is_marked_and_left_out(found):
    armature = next(one for one in found.settings if one.name == "armature_kg_m2")
    assert armature.unknown and armature.pasted is None
    assert 'joint name="elbow"' in found.lines
    assert 'armature="' not in found.lines
    assert re.search("<!-- elbow: armature_kg_m2 is not determined .*, left out", found.lines)  # fmt: skip


def test_the_printed_error_is_that_of_the_pasted_lines(found):
    """The lines go into the file as a user pastes them, and the shoulder is held."""
    joint, servo = [one for one in found.lines.splitlines() if "<!--" not in one]
    log = servo_log("other", 2)
    rest = f"<actuator>{servo}</actuator>"
    xml = arm(joint.replace("<joint", '<joint axis="0 1 0"'), rest=rest, shoulder="")
    assert log.command_rad is not None
    commands = log.command_rad[:, 0]

    def held(time_s):
        return commands[int(np.searchsorted(log.times_s, time_s + 1e-9, "right")) - 1]

    measured = log.position_rad[:, 0]
    error = np.sqrt(((played(xml, held, log.times_s) - measured) ** 2).mean())
    # The replay starts at the measured angle and rate, this one at rest at 0.
    assert found.held_out_rad["other"][0] == pytest.approx(error, rel=0.02)


def test_a_servo_stands_at_its_command_plus_the_offset():
    """Without gravity, in plain MuJoCo and on an engine of this package."""
    times_s = 0.02 * np.arange(100)
    command = np.full((100, 1), 0.2)
    log = Log("", times_s, command, command)
    numbers = {"kp_n_m_per_rad": 4.0, "kv_n_m_s_per_rad": 0.4, "offset_rad": -0.05}
    scene = one_joint(1.0, 0.0, 0.01)
    start = np.zeros(1), np.zeros(1)
    plain = machine_of(backend("mujoco"), scene, log, list(numbers), {})
    assert plain.angles(log, [numbers], start)[-1, 0] == pytest.approx(0.15, abs=1e-3)
    engine = SceneJoints(backend("rapier"), scene, {})
    assert engine.angles(log, [numbers], start)[-1, 0] == pytest.approx(0.15, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("offset_rad", [0.04, -0.06])
def test_the_standing_offset_of_a_servo_is_found(offset_rad):
    """Commands that are less by an angle move the same arm if the servo adds it."""
    log = servo_log("one", 1)
    assert log.command_rad is not None
    moved = replace(log, command_rad=log.command_rad - offset_rad)
    spec = mujoco.MjSpec.from_string(arm())
    names = ["dry_friction_n_m", "kp_n_m_per_rad", "kv_n_m_s_per_rad", "delay_s", "offset_rad"]  # fmt: skip
    found = identify(backend("mujoco"), spec, [moved], names)
    one = next(one for one in found.settings if one.name == "offset_rad")
    assert one.low < offset_rad < one.high
    assert one.value == pytest.approx(offset_rad, abs=0.003)
    assert f"elbow: offset_rad = {one.value:.5g}, which no line above sets" in found.lines  # fmt: skip
    assert found.error_rad["one"][0] < 2.0 * NOISE_RAD


def test_a_bench_value_is_kept_and_pasted():
    """The rest is fitted with it: with an armature that the log has not, the error is larger."""
    model = mujoco.MjSpec.from_string(arm())
    fitted = ("dry_friction_n_m", "kp_n_m_per_rad", "kv_n_m_s_per_rad", "delay_s")
    bench = identify(
        backend("mujoco"), model, [servo_log("one", 1)], fitted, known={"armature_kg_m2": 0.03}
    )  # fmt: skip
    known = bench.settings[-1]
    assert known.is_known and known.low == known.high == known.pasted == 0.03
    assert known.unknown == "" and 'armature="0.03"' in bench.lines
    assert bench.error_rad["one"][0] > 3.0 * NOISE_RAD


def test_a_bench_value_of_one_joint_stays_beside_fitted_ones():
    log = servo_log("one", 1)
    angles = np.hstack([log.position_rad, log.position_rad])
    both = Log("both", log.times_s, angles, angles, joints=("shoulder", "elbow"))
    machine = joints_of_model(mujoco.MjSpec.from_string(arm()), both, {})
    fitter = Fitter(machine=machine, known={"elbow.kp_n_m_per_rad": 7.0})
    problem = fitter._stages([both], NAMES)[1]
    of_shoulder, of_elbow = problem.unknowns(np.ones(2 * len(NAMES)))[0]
    assert of_elbow["kp_n_m_per_rad"] == 7.0 != of_shoulder["kp_n_m_per_rad"]


@pytest.mark.parametrize(
    ("known", "words"),
    [
        ({"wrist.kp_n_m_per_rad": 7.0}, "no joint wrist; it has elbow"),
        ({"elbow.offset_rad": 0.1}, "name it in --fit"),
    ],
)
def test_a_bench_value_of_no_fitted_joint_is_refused(known, words):
    spec = mujoco.MjSpec.from_string(arm())
    with pytest.raises(ParameterError, match=words):
        identify(backend("mujoco"), spec, [servo_log("one", 1)], NAMES, known=known)


@pytest.mark.slow
def test_a_lag_with_play_tells_ratios_of_torques_alone():
    """Nothing of it is an inertia or a weight: kp, kv and friction go together, also beside a known armature."""
    times_s = 0.02 * np.arange(200)
    command = np.repeat([0.0, 0.4, -0.3, 0.2], 50)
    angles = lagged(times_s, command, 0.0, (1.0, 0.0, 0.02, 0.08, 0.01))
    angles += NOISE_RAD * np.random.default_rng(4).standard_normal(200)
    log = Log("lag", times_s, angles[:, None], command[:, None], joints=("elbow",))
    spec = mujoco.MjSpec.from_string(arm(rest='<option gravity="0 0 0"/>', shoulder=""))
    found = identify(backend("mujoco"), spec, [log], NAMES, known={"armature_kg_m2": 0.001})  # fmt: skip
    unknown = {one.name: one.unknown for one in found.settings}
    assert unknown["kp_n_m_per_rad"] == unknown["kv_n_m_s_per_rad"] == SCALE
    found = identify(
        backend("mujoco"), spec, [log], NAMES, known={"armature_kg_m2": 0.001, "elbow.kp_n_m_per_rad": 6.0}
    )  # fmt: skip
    assert not any(one.unknown for one in found.settings)


def test_an_armature_that_is_not_determined_is_not_pasted_though_it_follows_the_log_better():
    """Of 40 noisy samples 0 is in its interval; only a bench value may stand in the lines."""
    log = servo_log("one", 2, armature=5e-4, noise_rad=0.012)
    assert log.command_rad is not None
    few = Log(
        "few", log.times_s[::10], log.position_rad[::10], log.command_rad[::10], joints=log.joints
    )  # fmt: skip
    rest = dict(zip(NAMES, (0.05, 0.0, KP, KV, DELAY_S), strict=True))
    del rest["armature_kg_m2"]
    model = mujoco.MjSpec.from_string(arm())
    found = identify(backend("mujoco"), model, [few], ["armature_kg_m2"], known=rest)
    armature = found.settings[0]
    assert armature.unknown and armature.value > 2e-4
    assert armature.pasted is None and 'armature="' not in found.lines
    with_it = rest | {"armature_kg_m2": armature.value}
    bench = identify(backend("mujoco"), model, [few], ["armature_kg_m2"], known=with_it)
    assert bench.error_rad["few"][0] < found.error_rad["few"][0] / AS_WELL
    assert 'armature="' in bench.lines


@pytest.mark.slow
def test_the_torque_limit_of_a_servo_is_found():
    """A servo that its limit holds back: twice the limit would move the elbow faster."""
    limit = 0.5
    servo = (
        f'<position joint="elbow" kp="{KP}" kv="0.5" forcerange="-{limit} {limit}"/>'
    )
    rest = f'<option gravity="0 0 0"/><actuator>{servo}</actuator>'
    times_s = np.arange(200) * 0.02
    steps = np.repeat([0.0, 1.0, -0.5, 0.8], 50)
    xml = arm(step=0.0005, rest=rest, shoulder="")
    angles = played(xml, lambda time_s: steps[int(time_s / 0.02 + 1e-9)], times_s)
    log = Log("one", times_s, angles[:, None], steps[:, None], joints=("elbow",))
    found = {}
    for step_s in (0.0005, STEP_S):
        free = '<option gravity="0 0 0"/>'
        model = mujoco.MjSpec.from_string(arm(step=step_s, rest=free))
        names = ("kp_n_m_per_rad", "kv_n_m_s_per_rad", "torque_limit_n_m")
        found[step_s] = identify(backend("mujoco"), model, [log], names)
    values = [one.value for one in found[0.0005].settings]
    assert values == pytest.approx([KP, 0.5, limit], rel=0.01)
    # With four times the step the engine needs another kp, and the output says so.
    coarse = found[STEP_S]
    assert coarse.settings[2].value == pytest.approx(limit, rel=0.02)
    assert coarse.settings[0].value == pytest.approx(1.17 * KP, rel=0.02)
    notes = identified_document(coarse).parts[0].notes
    assert any("the numbers hold at this step alone" in line for line in notes)


@pytest.mark.parametrize("stiffness", [0.0, 20_000.0], ids=["follows", "diverges"])
def test_the_first_stage_takes_longer_steps_unless_these_diverge(
    monkeypatch, stiffness
):
    """A step h of a spring k of inertia I diverges where k h^2 > 4 I: with 2 ms, and not with 0.5 ms."""
    log = servo_log("one", 1)
    assert log.command_rad is not None
    rows = {name: values[:40] for name, values in log.columns.items()}
    short = replace(log, times_s=log.times_s[:40], **rows)
    spec = mujoco.MjSpec.from_string(arm(step=0.0005))
    spec.joint("elbow").stiffness[0] = stiffness
    steps = []
    inner = ModelJoints.angles

    def seen(self, *given):
        steps.append(self.timestep_s)
        return inner(self, *given)

    monkeypatch.setattr(ModelJoints, "angles", seen)
    fitter = Fitter(machine=joints_of_model(spec, short, {}), known={})
    fitter.fit([short], ["kp_n_m_per_rad"], most_steps=1)
    assert steps.count(0.002) > 10
    assert (steps.count(0.0005) > 10) == bool(stiffness)


def test_plain_laws_are_beside_the_errors(found):
    command, lag = (
        float(found.plain_rad["other"][name][0]) for name in ("command", "lag")
    )
    assert found.held_out_rad["other"][0] < 0.2 * lag < 0.2 * command


def test_a_lag_is_found_by_its_five_numbers():
    """Of a log that this law made, a lag leaves the noise, which is none."""
    times_s = np.arange(600) * 0.02
    command = np.repeat(np.random.default_rng(3).uniform(-1.0, 1.0, 20), 30)
    # First order: after a step the rest is exp(-t / constant), less the play on the side it came from.
    angle = lagged(times_s, command, 0.0, (0.9, 0.1, 0.04, 0.1, 0.02))
    after = times_s[89] - times_s[60] - 0.04
    target = 0.9 * command[60] + 0.1
    side = np.sign(target - angle[61])
    rest = (target - side * 0.02 - angle[62]) * np.exp(-after / 0.1)
    assert angle[89] == pytest.approx(target - side * 0.02 - rest, abs=1e-9)
    log = Log("lag", times_s, angle[:, None], command[:, None])
    errors = baselines([log], [])["lag"]
    assert errors["command"][0] > 0.1
    assert errors["lag"][0] < 0.02


def test_joints_without_a_log_keep_the_angles_of_the_keyframe(tmp_path):
    key = '<keyframe><key qpos="0.4 0"/></keyframe>'
    (tmp_path / "arm.xml").write_text(arm(rest=key))
    log = servo_log("one", 1)
    machine = joints_of_model(read_mjcf(tmp_path / "arm.xml"), log, {})
    model = machine.spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert model.njnt == 1
    turned = [-0.2 * np.sin(0.4), 0.0, -0.2 * np.cos(0.4)]
    assert data.joint("elbow").xanchor == pytest.approx(turned)


def test_a_log_of_another_robot_is_refused():
    log = servo_log("one", 1)
    strange = Log("one", log.times_s, log.position_rad, log.command_rad, joints=("wrist",))  # fmt: skip
    model = mujoco.MjSpec.from_string(arm())
    with pytest.raises(ParameterError, match="wrist, and the model has the joints shoulder, elbow"):  # fmt: skip
        identify(backend("mujoco"), model, [strange], NAMES)
    nameless = Log("one", log.times_s, log.position_rad, log.command_rad)
    with pytest.raises(ParameterError, match="1 joints without names, and the model 2"):
        identify(backend("mujoco"), model, [nameless], NAMES)
    with pytest.raises(ParameterError, match="a step above 0"):
        identify(backend("mujoco"), model, [log], NAMES, settings={"timestep_s": 0.5})
    for joint in model.joints:
        joint.range = [-0.5, 0.5]
    degrees = np.degrees(log.position_rad)
    turned = Log("one", log.times_s, degrees, log.command_rad, joints=log.joints)
    with pytest.raises(ParameterError, match="are the angles in degrees"):
        identify(backend("mujoco"), model, [turned], NAMES)


def test_an_npz_log_names_its_joints(tmp_path):
    times_s = np.arange(30) / 50
    angles = np.zeros((30, 2))
    file = tmp_path / "log.npz"
    np.savez(file, time_s=times_s, position_rad=angles, joints=["a", "b"])
    assert read_log(file).joints == ("a", "b")


LOOP = """<mujoco><option timestep="0.001"/><worldbody>
<body><joint name="crank" axis="0 1 0"/><inertial pos="0 0 -.03" mass=".05" diaginertia="2e-5 2e-5 2e-6"/>
  <body name="coupler" pos="0 0 -.06"><joint name="knee" axis="0 1 0"/>
    <inertial pos=".05 0 0" mass=".05" diaginertia="2e-6 4e-5 4e-5"/></body></body>
<body name="rocker" pos=".1 0 0"><joint name="rocker" axis="0 1 0"/>
  <inertial pos="0 0 -.05" mass=".2" diaginertia="3e-4 3e-4 1e-4"/></body>
</worldbody><equality><connect body1="coupler" body2="rocker" anchor=".1 0 0"/></equality></mujoco>"""
"""A parallelogram: the coupler translates, and the rocker turns with the crank."""


def loop_of(log):
    return joints_of_model(mujoco.MjSpec.from_string(LOOP), log, {})


def test_a_loop_starts_closed():
    """Where the crank has turned by a, the knee has turned by -a and the rocker by a; so for rates."""
    times_s = np.arange(20) * 0.02
    log = Log("log", times_s, np.zeros((20, 1)), joints=("crank",))
    machine = loop_of(log)
    model, data = machine._motored
    for angle, rate in ((0.4, 2.0), (-0.7, -1.0)):
        start_at(model, data, machine, np.array([angle]), np.array([rate]))
        signs = np.array([1.0, -1.0, 1.0])
        assert data.qpos == pytest.approx(angle * signs, abs=1e-4)
        assert data.qvel == pytest.approx(rate * signs, abs=1e-3)


def test_a_loop_swings_with_the_period_of_its_closed_form():
    """Small swings: omega^2 = g (m r of crank and rocker + coupler at the crank's tip) / (their inertias)."""
    times_s = np.arange(0.0, 2.0, 0.005)
    log = Log("log", times_s, np.zeros((times_s.size, 1)), joints=("crank",))
    angles = loop_of(log).angles(log, [{}], (np.array([0.02]), np.zeros(1)))[:, 0]
    weight = 9.81 * (0.05 * 0.03 + 0.05 * 0.06 + 0.2 * 0.05)
    inertia = 2e-5 + 0.05 * 0.03**2 + 0.05 * 0.06**2 + 3e-4 + 0.2 * 0.05**2
    crossings = times_s[1:][(angles[:-1] > 0.0) & (angles[1:] <= 0.0)]
    period_s = float(np.diff(crossings).mean())
    assert period_s == pytest.approx(2.0 * np.pi * np.sqrt(inertia / weight), rel=0.01)


def test_angles_that_no_loop_has_are_an_error():
    """A rocker of 20 mm and a coupler of 100 mm do not reach from 162 mm."""
    times_s = np.arange(20) * 0.02
    log = Log("log", times_s, np.zeros((20, 1)), joints=("crank",))
    short = LOOP.replace('name="rocker" pos=".1 0 0"', 'name="rocker" pos=".1 0 -.04"')
    machine = joints_of_model(mujoco.MjSpec.from_string(short), log, {})
    with pytest.raises(DivergedError, match="close the loops"):
        start_at(*machine._motored, machine, np.array([2.5]))


TILT = {"axis": "0 1 0", "pos": ".02 0 .03", "mass": 0.25, "inertia": "2e-4 2e-4 2e-4", "armature": 6.4e-4}  # fmt: skip
FINGER = {"axis": "1 0 0", "pos": "0 0 -.03", "mass": 0.04, "inertia": "2e-5 2e-5 5e-6", "armature": 2e-4}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kp", "kv", "dry", "delay_s", "reach_rad", "seed", "place"),
    [
        (1.59, 0.0612, 0.0142, 0.04, 0.6, 10, TILT),
        (1.2, 0.016, 0.0139, 0.015, 0.5, 40, FINGER),
    ],
    ids=["stiffness", "dry friction"],
)
def test_a_fit_leaves_the_minima_beside_the_best(
    kp, kv, dry, delay_s, reach_rad, seed, place
):
    """From one first guess, the first fit ends with a stiffness 80 times too large, the second without dry friction."""
    random = np.random.default_rng(seed)
    times_s = 0.02 * np.arange(300)
    command = np.repeat(random.uniform(-reach_rad, reach_rad, 15), 20)
    command[:20] = 0.0
    servo = f'<actuator><position joint="elbow" kp="{kp}" kv="{kv}"/></actuator>'
    xml = JOINT.format(step=0.0005, dry=dry, rest=servo, **place)

    def held(time_s):
        # A second at the first command, in which the joint comes to rest.
        row = int(np.floor((time_s - 1.0 - delay_s) / 0.02 + 1e-9))
        return command[min(max(row, 0), 299)]

    angles = played(xml, held, 1.0 + times_s)
    angles += NOISE_RAD * random.standard_normal(300)
    log = Log("log", times_s, angles[:, None], command[:, None], joints=("elbow",))
    spec = mujoco.MjSpec.from_string(JOINT.format(step=0.002, dry=0.0, rest="", **place))  # fmt: skip
    names = [one for one in NAMES if one != "armature_kg_m2"]
    values = {
        one.name: one.value
        for one in identify(backend("mujoco"), spec, [log], names).settings
    }
    # A servo that is solved implicitly with four times the step has slightly larger numbers.
    assert values["kp_n_m_per_rad"] == pytest.approx(kp, rel=0.1)
    assert values["dry_friction_n_m"] == pytest.approx(dry, rel=0.15)


def test_a_number_without_effect_is_not_determined_however_large():
    """A servo never reaches 50 times the torque limit that its weight suggests, nor 5,000 times it."""
    log = servo_log("one", 1)
    machine = joints_of_model(mujoco.MjSpec.from_string(arm()), log, {})
    names = ("kp_n_m_per_rad", "torque_limit_n_m")
    problem = Fitter(machine=machine, known={})._stages([log], names)[1]
    for limit in (50.0, 5000.0):
        unknowns = np.array([1.0, limit])
        found = settings_of(problem, unknowns, problem.covariance(unknowns))
        assert [bool(one.unknown) for one in found] == [False, True]
        assert found[1].low == 0.0


def test_a_limit_without_effect_is_not_told_by_that_of_another_joint():
    """The shoulder reaches its limit, and moves the elbow, which never reaches its own."""
    both = np.repeat(servo_log("one", 1).position_rad, 2, axis=1)
    log = Log("", np.arange(400) * 0.02, both, both, joints=("shoulder", "elbow"))
    machine = joints_of_model(mujoco.MjSpec.from_string(arm()), log, {})
    names = ("kp_n_m_per_rad", "torque_limit_n_m")
    problem = Fitter(machine=machine, known={})._stages([log], names)[1]
    unknowns = np.array([1.0, 1.0, 0.3, 1000.0])
    found = settings_of(problem, unknowns, problem.covariance(unknowns))
    assert [bool(one.unknown) for one in found] == [False, False, False, True]


def test_an_armature_that_is_not_determined_is_left_out_however_far_it_is_from_the_model():
    """The rest may be needed together; an armature is not, which contact would meet."""
    spread = Setting(
        joint=0, joint_name="elbow", name="armature_kg_m2", value=5.0, low=4.0, high=6.0, unknown="goes with delay_s"
    )  # fmt: skip
    machine = SimpleNamespace(stated=[dict.fromkeys(NAMES, 0.0)])
    problem: Any = SimpleNamespace(machine=machine, names=NAMES)
    assert _to_leave_out(problem, [spread], set()) == [spread]
    assert _to_leave_out(problem, [replace(spread, name="delay_s")], set()) == []


@pytest.mark.slow
def test_both_servos_of_an_arm_are_found_from_one_log():
    """Their numbers differ by a factor of 5, and all start from one guess."""
    truth = {"shoulder": (30.0, 1.5, 0.2), "elbow": (6.0, 0.25, 0.05)}
    stiff = 'solimpfriction="0.9999 0.9999 0.001" solreffriction="0.001 1"'
    joints = {
        name: f'<joint name="{name}" axis="0 1 0" frictionloss="{dry}" {stiff}/>'
        for name, (_, _, dry) in truth.items()
    }
    motors = "".join(
        f'<position name="{name}" joint="{name}" kp="{kp}" kv="{kv}"/>'
        for name, (kp, kv, _) in truth.items()
    )
    xml = arm(
        joints["elbow"], step=STEP_S / 4, rest=f"<actuator>{motors}</actuator>", shoulder=joints["shoulder"]
    )  # fmt: skip
    random = np.random.default_rng(2)
    times_s = np.arange(400) * 0.02
    commands = np.repeat(random.uniform(-0.6, 0.6, (20, 2)), 20, axis=0)
    commands[:20] = 0.0
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    angles = np.zeros((400, 2))
    for row in range(400):
        angles[row] = data.qpos
        data.ctrl[:] = commands[row]
        mujoco.mj_step(model, data, nstep=40)
    angles += NOISE_RAD * random.standard_normal(angles.shape)
    log = Log("log", times_s, angles, commands, joints=tuple(truth))
    spec = mujoco.MjSpec.from_string(arm())
    names = ("dry_friction_n_m", "kp_n_m_per_rad", "kv_n_m_s_per_rad")
    found = identify(backend("mujoco"), spec, [log], names)
    for numbers, (kp, kv, dry) in zip(found.joints, truth.values(), strict=True):
        assert numbers["kp_n_m_per_rad"] == pytest.approx(kp, rel=0.05)
        assert numbers["kv_n_m_s_per_rad"] == pytest.approx(kv, rel=0.1)
        assert numbers["dry_friction_n_m"] == pytest.approx(dry, rel=0.1)
