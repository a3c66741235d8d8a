"""Joint terms in TOML: constants of the body, a motor in the joint, overrides, and errors for people."""

import gymnasium
import numpy as np
import pytest

from gauge_envs import load_experiment_file
from gauge_envs.errors import AssetError, ParameterError, TaskFileError
from gauge_envs.experiments.scene_builder import SceneBuilder
from gauge_envs.experiments.task_files import load_task
from gauge_envs.experiments.variants import Variant
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result, recorded_experiment, write_result
from gauge_envs.scene import JointDynamics
from gauge_envs.scene.motors import Servo, TorqueMotor
from gauge_envs.scene.profiles import CosineProfile, SampledProfile
from gauge_envs.scene.servo_friction import ServoFriction
from gauge_envs.tools.catalog.description import description
from gauge_envs.tools.usd.writer import to_usd

ARM = """
family = "Arm"
title = "Arm"
group = "rigid"
summary = "A pendulum with a servo at its elbow."
evaluates = ["articulation"]
materials = ["brass", "steel"]

[source]
metadata = "none: an example"
paper = "none: an example"

[bodies.upper]
shape = { kind = "box", size_m = [0.04, 0.04, 0.3] }
motion = "dynamic"
recorded = true

[bodies.lower]
shape = { kind = "box", size_m = [0.03, 0.03, 0.2] }
motion = "dynamic"
recorded = true

[constants.upper]
brass = { mass_kg = 0.5, dry_friction_n_m = 0.01, armature_kg_m2 = 0.002, backlash_rad = 0.02 }
steel = { mass_kg = 0.6, viscous_friction_n_m_s_per_rad = 0.03, load_friction = 0.1 }

[constants.lower]
brass = { mass_kg = 0.2, kp_n_m_per_rad = 8.0, kv_n_m_s_per_rad = 0.1, torque_limit_n_m = 1.5, delay_s = 0.02 }
steel = { mass_kg = 0.3, kp_n_m_per_rad = 9.0 }

[initial.all]
upper = { position_m = [0.0, 0.0, 0.85] }
lower = { position_m = [0.0, 0.0, 0.6] }

[[joints]]
kind = "hinge"
body = "upper"
axis = [0.0, 1.0, 0.0]
anchor_m = [0.0, 0.0, 1.0]

[[body_hinges]]
bodies = ["upper", "lower"]
anchor_m = [0.0, 0.0, 0.7]
axis = [0.0, 1.0, 0.0]
motor = { kind = "servo", command = { kind = "cosine", start_s = 0.1, duration_s = 0.3, amount = 0.7 } }

[score]
observable = "position"
metrics = ["rmse", "dtw"]

[frames]
all = 16

[provenance]
bodies = "nominal: a test"
constants = "nominal: a test"
initial = "nominal: a test"
joints = "nominal: a test"
body_hinges = "nominal: a test"
frames = "nominal: a test"
"""

SERVO_COMMAND = CosineProfile(start_s=0.1, duration_s=0.3, amount=0.7)


def built(folder, old="", new="", material="brass", **overrides):
    """Return the scene of the arm's task file with one passage changed; `upper__mass_kg` overrides a constant."""
    assert old in ARM
    path = folder / "arm.toml"
    path.write_text(ARM.replace(old, new, 1) if old else ARM)
    stated = {key.replace("__", "."): value for key, value in overrides.items()}
    return SceneBuilder(
        path, load_task(path), Variant("Arm", None, material), stated
    ).build()


def test_joint_terms_of_a_task_file_depend_on_the_material(tmp_path):
    brass, steel = (
        built(tmp_path, material=material).hinges for material in ("brass", "steel")
    )
    assert brass[0].anchor_m == (0.0, 0.0, 1.0)
    assert brass[0].dynamics == JointDynamics(
        dry_friction_n_m=0.01, armature_kg_m2=0.002, backlash_rad=0.02
    )
    assert steel[0].dynamics == JointDynamics(
        viscous_friction_n_m_s_per_rad=0.03, servo=ServoFriction(load_friction=0.1)
    )
    assert brass[0].motor is None
    assert brass[1].motor == Servo(
        command=SERVO_COMMAND,
        kp_n_m_per_rad=8.0,
        kv_n_m_s_per_rad=0.1,
        torque_limit_n_m=1.5,
        delay_s=0.02,
    )
    assert steel[1].motor == Servo(command=SERVO_COMMAND, kp_n_m_per_rad=9.0)


COMMAND = (
    ', command = { kind = "cosine", start_s = 0.1, duration_s = 0.3, amount = 0.7 }'
)
GAINS = "kp_n_m_per_rad = 8.0, kv_n_m_s_per_rad = 0.1, torque_limit_n_m = 1.5, "


def test_a_motor_without_a_command_rests(tmp_path):
    servo = built(tmp_path, COMMAND).hinges[1].motor
    assert [servo.command.value(time) for time in (-1.0, 0.0, 0.5, 9.0)] == [0.0] * 4


def test_a_torque_motor_has_a_sampled_command(tmp_path):
    command = (
        ', command = { kind = "sampled", times_s = [0.0, 0.1], values = [0.0, 0.3] }'
    )
    text = (
        ARM.replace(GAINS, "")
        .replace(", kp_n_m_per_rad = 9.0", "")
        .replace(COMMAND, command)
    )
    path = tmp_path / "arm.toml"
    path.write_text(text.replace('"servo"', '"torque"'))
    scene = SceneBuilder(
        path, load_task(path), Variant("Arm", None, "brass"), {}
    ).build()
    expected = TorqueMotor(
        command=SampledProfile(times_s=(0.0, 0.1), values=(0.0, 0.3)), delay_s=0.02
    )
    assert scene.hinges[1].motor == expected


def test_overrides_state_terms(tmp_path):
    upper, lower = built(
        tmp_path, upper__dry_friction_n_m=0.5, lower__delay_s=0.0
    ).hinges
    assert upper.dynamics == JointDynamics(
        dry_friction_n_m=0.5, armature_kg_m2=0.002, backlash_rad=0.02
    )
    assert lower.motor.delay_s == 0.0
    with pytest.raises(ParameterError, match=r"dry_friction_n_m'.*given: -1\.0"):
        built(tmp_path, upper__dry_friction_n_m=-1.0)
    with pytest.raises(
        ParameterError, match="'upper' has no constant 'kp_n_m_per_rad'"
    ):
        built(tmp_path, upper__kp_n_m_per_rad=1.0)


@pytest.mark.parametrize(
    ("old", "new", "key", "reason"),
    [
        (
            "dry_friction_n_m = 0.01",
            "dry_friction_n_m = -0.01",
            "constants.upper.brass.dry_friction_n_m",
            "-0.01",
        ),
        (
            "armature_kg_m2 = 0.002, ",
            "",
            "constants.upper",
            "a joint with backlash_rad needs armature_kg_m2",
        ),
        (
            "kp_n_m_per_rad = 8.0, ",
            "",
            "constants.lower",
            "a servo needs the constant kp_n_m_per_rad",
        ),
        ('"servo"', '"torque"', "constants.lower", "no motor with that constant"),
        (
            "dry_friction_n_m = 0.01",
            "delay_s = 0.01",
            "constants.upper",
            "state its motor",
        ),
        ('"servo"', '"stepper"', "body_hinges.0.motor.kind", "'stepper'"),
        ('body = "upper"', 'body = "uper"', "joints.0.body", "uper"),
        (
            '["upper", "lower"]',
            '["lower", "upper"]',
            "constants.upper",
            "'upper' has 2",
        ),
        (
            "anchor_m = [0.0, 0.0, 1.0]\n",
            "",
            "joints",
            "hangs_from_m, or its hinge an anchor_m",
        ),
        (
            'constants = "nominal: a test"',
            '"constants.*.*.mass_kg" = "nominal: a test"',
            "dry_friction_n_m",
            "provenance",
        ),
        (
            'body_hinges = "nominal: a test"',
            '"body_hinges.*.axis" = "nominal: a test"',
            "body_hinges.0",
            "provenance",
        ),
    ],
)
def test_a_wrong_joint_names_key_and_reason(old, new, key, reason, tmp_path):
    with pytest.raises(TaskFileError) as caught:
        built(tmp_path, old, new)
    assert key in caught.value.place
    assert reason in caught.value.reason


def test_a_body_with_an_anchor_of_its_hinge_starts_with_an_angular_velocity(tmp_path):
    spin = "upper = { position_m = [0.0, 0.0, 0.85], angular_velocity_deg_per_s = [0.0, 90.0, 0.0] }"
    alone = ARM[: ARM.index("[[body_hinges]]")] + ARM[ARM.index("[score]") :]
    path = tmp_path / "arm.toml"
    text = alone.replace("upper = { position_m = [0.0, 0.0, 0.85] }", spin)
    path.write_text(
        text.replace(GAINS + "delay_s = 0.02", "")
        .replace(", kp_n_m_per_rad = 9.0", "")
        .replace("0.2,  }", "0.2 }")
    )
    upper = (
        SceneBuilder(path, load_task(path), Variant("Arm", None, "steel"), {})
        .build()
        .body("upper")
    )
    assert upper.linear_velocity_m_per_s == pytest.approx(
        (-0.15 * 1.5707963267948966, 0.0, 0.0)
    )


# --- experiment files ------------------------------------------------------------------------------------------------

SWING = """
name = "swing"
title = "Swing"
usd = "arm.usda"
frames = 10
recorded = ["upper", "lower"]

[score]
observable = "position"

[[joints]]
body = "upper"
dry_friction_n_m = 0.02

[[joints]]
body = "/World/lower"
kp_n_m_per_rad = 5.0
motor = { kind = "servo", command = { kind = "sampled", times_s = [0.0, 0.2], values = [0.0, 0.5] } }

[provenance]
joints = "nominal: a test"
"""


@pytest.fixture
def swing(tmp_path):
    """Experiment file whose layer has the arm of the task file."""
    to_usd(built(tmp_path), tmp_path / "arm.usda")
    (tmp_path / "swing.toml").write_text(SWING)
    return tmp_path / "swing.toml"


def test_an_experiment_file_replaces_the_terms_of_its_layer(swing):
    upper, lower = load_experiment_file(swing).scene.hinges
    assert upper.dynamics == JointDynamics(dry_friction_n_m=0.02)
    assert lower.dynamics == JointDynamics()
    assert lower.motor == Servo(
        command=SampledProfile(times_s=(0.0, 0.2), values=(0.0, 0.5)),
        kp_n_m_per_rad=5.0,
    )


def test_an_experiment_file_with_motors_runs_and_its_result_reads_back(swing, tmp_path):
    result = run_episode(RunRequest(str(swing), backend="mujoco"))
    moved = np.ptp(np.array(result.trajectory.samples), axis=0)
    assert moved.max() > 10.0
    write_result(result, tmp_path / "swing.json")
    experiment = recorded_experiment(load_result(tmp_path / "swing.json"))
    assert experiment.scene == load_experiment_file(swing).scene


@pytest.mark.parametrize(
    ("old", "new", "error", "reason"),
    [
        (
            "dry_friction_n_m = 0.02",
            "dry_friction_n_m = -0.02",
            TaskFileError,
            r"joints.0.dry_friction_n_m: .*-0.02",
        ),
        (
            'body = "upper"',
            'body = "uper"',
            AssetError,
            r"joints.0.body: 'uper' is no body of arm.usda",
        ),
        (
            "kp_n_m_per_rad = 5.0\n",
            "",
            TaskFileError,
            "joints.1: a servo needs the constant kp_n_m_per_rad",
        ),
        (
            "dry_friction_n_m = 0.02",
            "delay_s = 0.02",
            TaskFileError,
            "joints.0: delay_s: the hinge has no motor",
        ),
        ("[0.0, 0.2]", "[0.2, 0.2]", TaskFileError, "joints.1.motor.command.*times_s"),
    ],
)
def test_wrong_terms_in_an_experiment_file(old, new, error, reason, swing):
    assert old in SWING
    swing.write_text(SWING.replace(old, new, 1))
    with pytest.raises(error, match=reason):
        load_experiment_file(swing)


def test_a_chain_is_shown(swing):
    values = description(load_experiment_file(swing))
    world, between = values["joints"]
    assert (world["kind"], between["kind"]) == ("hinge", "hinge of two bodies")
    assert world["dynamics"]["dry_friction_n_m"] == 0.02
    assert "motor" not in world
    assert between["motor"]["kp_n_m_per_rad"] == 5.0
    env = gymnasium.make("GAUGE/Asset", asset=swing, render_mode="rgb_array")
    env.reset(seed=0)
    for _ in range(3):
        env.step(0)
    assert np.ptp(np.asarray(env.render())) > 0
    env.close()
