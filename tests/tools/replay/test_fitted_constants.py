"""Constants of servos are fitted to logs, and models are judged by logs that no fit has seen."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from planted_arm import ARM, SERVO, record
from test_causes import set_servo

from gauge_envs.errors import FileError, ParameterError
from gauge_envs.tools.replay.constants import fit_logs, parameter_dict
from gauge_envs.tools.replay.judge import judge_models
from gauge_envs.tools.replay.log import LogMap
from gauge_envs.tools.replay.schema import Value


@pytest.fixture(scope="module")
def servo(tmp_path_factory):
    """Two logs of a servo with other constants than its model."""
    files = []
    for duration_s in (6.0, 4.0):
        folder = tmp_path_factory.mktemp("servo")
        planted = {"change": set_servo, "delay_s": 0.01, "duration_s": duration_s}
        files.append(record(folder, robot=SERVO, **planted))
    return files


def test_fitted_constants_predict_another_log(gauge, servo, tmp_path):
    (log, model), (other, _) = servo
    fitted = tmp_path / "fitted.xml"
    names = "delay,kp,armature,damping"
    options = ("--model", model, "--fit", names, "--test", other, "--write", fitted)
    shown = gauge("replay", log, *options, "--json")
    assert shown.exit_code == 0
    line = json.loads(shown.stdout)
    values = {each["parameter"]: each["fitted"] for each in line["values"]}
    assert values["delay of delay"] == pytest.approx(0.01, abs=0.001)
    armature = values["armature of joint"]
    assert values["kp of joint"] / armature == pytest.approx(500.0, rel=0.05)
    assert values["damping of joint"] / armature == pytest.approx(25.0, rel=0.05)
    assert [each["better"] for each in line["predictions"]] == ["nominal", "yes"] * 2
    # The file has all but the delay, which stands in the map.
    delayed = tmp_path / "map.toml"
    delayed.write_text(line["paste"]["map"])
    files = ("--model", model, "--model", fitted, "--map", delayed)
    text = gauge("replay", other, *files).stdout
    assert "fitted.xml predicts best over" in text


def set_friction(model):
    model.dof_frictionloss[0] = 1.0


@pytest.mark.parametrize("push", [0.0, 0.5])
def test_an_interval_has_the_planted_value(tmp_path, push):
    """The value is far from that of the model, and a push is what no constant explains."""
    log, model = record(
        tmp_path,
        robot=SERVO,
        change=set_friction,
        push=lambda now_s: push * np.sin(11.0 * now_s),
    )
    (value,) = fit_logs([log], model, (), ["frictionloss"], (), LogMap()).values
    assert value.low < 1.0 < value.high
    # The velocities of the log alone leave some thousandths.
    assert value.high - value.low < 0.04


def test_constants_are_a_parameter_dict_of_mujoco(tmp_path):
    values = [
        Value("armature of knee", 0.0, 2e-5, 1e-5, 3e-5, changes=True),
        Value("effort limit of knee", None, 4.0, 3.0, 5.0, changes=True),
    ]
    file = tmp_path / "constants.yaml"
    file.write_bytes(parameter_dict(values))
    states = yaml.safe_load(file.read_text())
    assert states["armature of knee"] == {
        "name": "armature of knee",
        "nominal": [0.0],
        "min_value": [0.0],
        "max_value": [3e-5],
        "value": [2e-5],
        "frozen": False,
    }
    assert states["effort limit of knee"]["nominal"] == [4.0]
    pytest.importorskip("colorama")
    sysid = pytest.importorskip("mujoco.sysid._src.parameter")
    read = sysid.ParameterDict.load_from_disk(file)
    assert read.as_vector() == pytest.approx([2e-5, 4.0])


def test_a_parameter_dict_is_read_as_a_model(servo, tmp_path):
    """The constants that were planted, but the delay, in a file of `mujoco.sysid`."""
    (log, model), _ = servo
    planted = {"kp": 12.0, "armature": 0.024, "damping": 0.6}
    values = [
        Value(f"{name} of joint", None, value, None, None, changes=True)
        for name, value in planted.items()
    ]
    file, other = tmp_path / "constants.yaml", tmp_path / "other.yaml"
    file.write_bytes(parameter_dict(values))
    lines = judge_models([log], [model, file], LogMap())
    assert [line.better for line in lines] == ["nominal", "yes"] * 2
    other.write_bytes(parameter_dict([replace(values[0], parameter="kp of hip")]))
    with pytest.raises(FileError, match="kp of hip: no constant of the model"):
        judge_models([log], [model, other], LogMap())


def test_a_model_is_not_better_than_itself(servo):
    (log, model), _ = servo
    lines = judge_models([log], [model, model], LogMap())
    assert {line.over_nominal for line in lines} == {1.0}


def test_noise_makes_no_model_better(tmp_path):
    """A damping that is off by 0.1 % changes less than the noise."""
    log, model = record(tmp_path, robot=SERVO)
    near = tmp_path / "near.xml"
    near.write_text(SERVO.replace('damping="0.3"', 'damping="0.3003"'))
    far = tmp_path / "far.xml"
    far.write_text(SERVO.replace('damping="0.3"', 'damping="0.6"'))
    lines = judge_models([log], [model, near, far], LogMap())
    found = {(line.model, line.horizon_s): line for line in lines}
    assert found["near.xml", 0.1].over_nominal == pytest.approx(1.0, abs=0.02)
    assert found["far.xml", 0.1].better == "no"


def test_a_constant_that_a_log_does_not_show_is_said(tmp_path):
    """A joint that rests shows no friction of its drive, armature or damping."""
    log, model = record(tmp_path, robot=ARM)
    columns = dict(np.load(log))
    for name in ("q", "dq", "target"):
        columns[name] = 0.0 * columns[name] + 1e-5 * np.sin(columns["t"])[:, None]
    np.savez(log, **columns)
    line = fit_logs([log], model, (), ["armature"], ["elbow"], LogMap())
    assert line.unknown == ("armature of elbow",)
    assert line.paste == {}


@pytest.mark.parametrize(
    ("names", "joints", "words"),
    [
        (["inertia"], [], "--fit inertia: expected some of"),
        (["armature"], ["wrist"], "--joint wrist: the log has"),
    ],
)
def test_unknown_names_are_named(servo, names, joints, words):
    (log, model), _ = servo
    with pytest.raises(ParameterError, match=words):
        fit_logs([log], model, (), names, joints, LogMap())
