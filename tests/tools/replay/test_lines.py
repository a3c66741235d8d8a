"""Lines to paste make the change when they are executed, and a verdict does not hang on how a log is written."""

from functools import cache
from itertools import product

import numpy as np
import pytest
from planted_arm import ARM, SERVO, paste, record, swing, written_otherwise
from scipy.spatial.transform import Rotation
from test_causes import (
    set_effort,
    set_friction,
    set_servo_friction,
    set_stiffness,
    set_stop,
)

from gauge_envs.tools.replay import ReplayVerdict, read_map, replay
from gauge_envs.tools.replay.model import Replayer


def set_mass(model):
    model.body_mass[2] *= 1.8
    model.body_inertia[2] *= 1.8


def set_damping(model):
    model.dof_damping[1] += 1.5


GEARED = ARM.replace('kp="40" kv="1.5"', 'gear="2" kp="10" kv="0.375"')
DEGREES = ARM.replace('angle="radian"', 'angle="degree"')
GENERAL = ARM.replace(
    '<position joint="shoulder" kp="40" kv="1.5"/>',
    '<general joint="shoulder" gainprm="40" biastype="affine" biasprm="0 -40 -1.5"/>',
)


@pytest.mark.parametrize(
    ("change", "robot"),
    [
        (set_stiffness, GEARED),
        pytest.param(set_effort, GENERAL, marks=pytest.mark.slow),
        pytest.param(set_stop, DEGREES, marks=pytest.mark.slow),
        pytest.param(set_effort, GEARED, marks=pytest.mark.slow),
    ],
)
def test_lines_of_mjcf_make_the_change(tmp_path, change, robot):
    log, model = record(tmp_path, change=change)
    model.write_text(robot)
    line = replay(log, model).line
    if change is set_stiffness:
        # With a gear of 2, a quarter of the gains gives the same torque.
        (value, *_) = line.candidates[0].values
        assert value.present == pytest.approx(40.0)
        assert value.fitted == pytest.approx(28.0, rel=0.05)
    paste(model, line.paste["MJCF"])
    assert replay(log, model).verdict is ReplayVerdict.NOISE


@pytest.mark.slow
@pytest.mark.parametrize("change", [set_mass, set_friction, set_damping])
def test_lines_of_mjcf_of_links_and_losses_make_the_change(tmp_path, change):
    log, model = record(tmp_path, change=change)
    line = replay(log, model).line
    paste(model, line.paste["MJCF"])
    after = replay(log, model).line
    assert after.error_over_noise < 0.1 * line.error_over_noise
    assert "shoulder" not in line.paste["MJCF"]


WRITTEN = {
    "order": lambda values: values[:, ::-1],
    "degrees": np.rad2deg,
    "sign": lambda values: values * [1.0, -1.0],
    "zero": lambda values: values + np.array([0.6, 0.0]),
    "scale": lambda values: values * [0.5, 1.0],
    "offset": lambda values: values + np.array([0.0, 0.3]),
}
ALL = ("q", "dq", "target")


@pytest.mark.parametrize(
    ("writing", "names"),
    [
        ("order", ALL),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("degrees", ALL),
                ("sign", ALL),
                ("zero", ("q", "target")),
                *product(("order", "sign", "scale", "offset"), [("target",)]),
            )
        ),
    ],
)
def test_lines_of_the_map_correct_the_log(gauge, tmp_path, writing, names):
    log, model = record(tmp_path)
    columns = dict(np.load(log))
    changed = {name: WRITTEN[writing](columns[name]) for name in names}
    np.savez(log, **columns | changed)
    line = replay(log, model).line
    file = tmp_path / "map.toml"
    file.write_text(line.paste["map"])
    assert line.paste.keys() == {"map"}
    assert line.verdict is not ReplayVerdict.NOISE
    assert names == ALL or writing == "zero" or "command" in line.paste["map"]
    shown = [
        gauge("replay", log, "--model", model, *options)
        for options in ([], ["--map", file])
    ]
    assert [each.exit_code for each in shown] == [1, 0]
    assert "physics agrees" in " ".join(shown[1].stdout.split())


SATELLITE = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body>
      <freejoint/>
      <inertial pos="0.02 0.01 0" mass="6" diaginertia="0.09 0.13 0.2"/>
      <body pos="0.2 0 0.1">
        <joint name="arm" axis="0 1 0" armature="0.01" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0.1" size="0.03" mass="2"/>
      </body>
      <body pos="-0.2 0 0">
        <joint name="boom" axis="1 0 0" armature="0.01" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 -0.1 0.2 0.2" size="0.03" mass="2"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="arm" kp="20" kv="1"/>
    <position joint="boom" kp="20" kv="1"/>
  </actuator>
</mujoco>
"""


def in_other_axes(columns, turn, part):
    """The base in other axes, of the world and of its own."""
    changes = {key: columns[key] @ turn.T for key in ("base_pos", "base_linvel")}
    if part == "axes":
        rotation = Rotation.from_matrix(turn)
        pose = Rotation.from_quat(columns["base_quat"], scalar_first=True)
        pose = rotation * pose * rotation.inv()
        changes["base_quat"] = pose.as_quat(scalar_first=True)
        changes["base_angvel"] = columns["base_angvel"] @ turn.T
    return changes


Y_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
PERMUTED = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
HALF_TURN = np.diag([-1, -1, 1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turn", "part", "axes"),
    [
        (Y_UP, "axes", "x -z y"),
        (PERMUTED, "axes", "z x y"),
        (HALF_TURN, "axes", "-x -y z"),
        (Y_UP, "position_axes", "x -z y"),
    ],
)
def test_the_line_of_axes_repairs_the_base(tmp_path, turn, part, axes):
    robot, duration_s = SATELLITE, 8.0
    if part == "position_axes":
        # Gravity shows which axis of the position is up.
        robot, duration_s = robot.replace('gravity="0 0 0"', ""), 1.0
    log, model = record(tmp_path, robot=robot, duration_s=duration_s)
    columns = dict(np.load(log))
    assert not replay(log, model).line.mistakes
    np.savez(log, **columns | in_other_axes(columns, turn, part))
    line = replay(log, model).line
    assert line.paste == {"map": f'{part} = "{axes}"'}
    file = tmp_path / "map.toml"
    file.write_text(line.paste["map"])
    after = replay(log, model, mapped=read_map(file)).line
    assert (after.mistakes, after.verdict) == ((), ReplayVerdict.NOISE)


@pytest.fixture(scope="module")
def frictions(tmp_path_factory):
    """A function: the log of a robot with more friction than its model, and what is named."""

    @cache
    def explained(robot):
        folder = tmp_path_factory.mktemp(robot)
        if robot == "swing":
            files = swing(folder, 0.004, 0.0004)
        elif robot == "servo":
            files = record(folder, robot=SERVO, change=set_servo_friction)
        else:
            files = record(folder, change=set_friction)
        return files, replay(*files).line

    return explained


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "writing"),
    [
        ("servo", "clock"),
        ("swing", "clock"),
        *product(["arm"], ["clock", "order", "unit", "sparse"]),
    ],
)
def test_a_verdict_does_not_hang_on_how_a_log_is_written(
    tmp_path, frictions, robot, writing
):
    (log, model), before = frictions(robot)
    columns = dict(np.load(log))
    changes, mapped = written_otherwise(columns, writing)
    written = tmp_path / "log.npz"
    np.savez(written, **columns | changes)
    after = replay(written, model, mapped=mapped).line
    check_equal(before, after)


@pytest.mark.slow
def test_losses_of_a_swing_are_named_together(frictions):
    """Pieces of 0.25 s show dry friction alone; a long rollout needs damping too."""
    _, line = frictions("swing")
    values = {each.cause: each.values[0].fitted for each in line.named}
    assert values.keys() == {"dry friction", "damping"}
    # MuJoCo's dry friction is soft at low speed.
    assert values["dry friction"] == pytest.approx(0.004, rel=0.1)
    assert values["damping"] == pytest.approx(0.0004, rel=0.1)


def check_equal(before, after):
    """Two verdicts name the same causes with the same values."""
    assert after.verdict is before.verdict
    for one, other in zip(before.named, after.named, strict=True):
        assert one.cause == other.cause
        numbers = {value.parameter: value.fitted for value in one.values}
        for value in other.values:
            fitted = pytest.approx(value.fitted, rel=0.05, abs=0.01)
            assert numbers[value.parameter] == fitted


@pytest.mark.slow
def test_a_verdict_does_not_hang_on_which_half_is_fitted(frictions, monkeypatch):
    files, before = frictions("arm")
    pieces = Replayer.pieces
    monkeypatch.setattr(
        Replayer, "pieces", lambda *args, **options: pieces(*args, **options)[::-1]
    )
    check_equal(before, replay(*files).line)
