"""MJCF files of scenes whose hinges have friction, armature and motors: exact return, edits, and what is refused."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.envs.driver_paths import DriverPaths
from gauge_envs.errors import AssetError
from gauge_envs.scene import Hinge, JointDynamics
from gauge_envs.scene.diff import scene_changes
from gauge_envs.scene.motors import Servo, TorqueMotor
from gauge_envs.scene.profiles import CosineProfile
from gauge_envs.tools.mjcf.writer import exact_xml, start_notes

COMMAND = CosineProfile(start_s=0.1, duration_s=0.3, amount=0.7)
SERVO = Servo(
    command=COMMAND,
    kp_n_m_per_rad=0.8123456789,
    kv_n_m_s_per_rad=0.013,
    torque_limit_n_m=1.7,
    delay_s=0.02,
)
DYNAMICS = JointDynamics(
    dry_friction_n_m=0.0103456789,
    viscous_friction_n_m_s_per_rad=0.0212345678,
    armature_kg_m2=0.00171234567,
    backlash_rad=0.0234567891,
)


def chain():
    """Return two blocks on a hinge to the world with friction, and a servo between them."""
    scene = load_experiment(
        "ElbowToss-blocks", {"first.position_m": (0.0, 0.0, 0.15)}
    ).scene
    (elbow,) = scene.body_hinges
    shoulder = Hinge(
        body="first", anchor_m=(0.0, 0.0, 0.2), axis=(0.0, 1.0, 0.0), dynamics=DYNAMICS
    )
    return replace(
        scene,
        joints=(shoulder,),
        body_hinges=(replace(elbow, motor=SERVO),),
        contacts=(),
    )


def read(scene, folder, *replacements):
    """Return the file of a scene after edits of its text, and what is read from it."""
    text = ElementTree.tostring(
        exact_xml(BackendMuJoCo().build(scene)), encoding="unicode"
    )
    for old, new in replacements:
        assert old in text, text
        text = text.replace(old, new)
    path = folder / "chain.xml"
    path.write_text(text)
    return path, BackendMuJoCo().read_file(path, scene)


def test_the_file_is_the_scenes(tmp_path):
    scene = chain()
    path, found = read(scene, tmp_path)
    assert found.scene == scene
    assert found.changes == ()
    # Commands stay the scene's, so the file moves as the scene bit for bit.
    paths = DriverPaths(scene, 0.5)
    worlds = [BackendMuJoCo().build(scene), BackendMuJoCo().build_file(path, scene)]
    for index in range(90):
        for world in worlds:
            paths.advance(world, index)
    np.testing.assert_array_equal(worlds[0].data.qpos, worlds[1].data.qpos)
    assert abs(worlds[0].data.qpos[2]) > 0.1


def test_a_torque_motor_stays(tmp_path):
    scene = chain()
    torque = replace(scene.body_hinges[0], motor=TorqueMotor(command=COMMAND))
    scene = replace(scene, body_hinges=(torque,))
    assert read(scene, tmp_path)[1].scene == scene
    assert (
        "Motors 'second': this file holds no commands"
        in start_notes(BackendMuJoCo().build(scene))[0]
    )


@pytest.mark.parametrize(
    ("old", "new", "part", "field", "value", "change"),
    [
        (
            'frictionloss="0.0103456789"',
            'frictionloss="0.5"',
            "dynamics",
            "dry_friction_n_m",
            0.5,
            "dof_frictionloss",
        ),
        (
            'damping="0.0212345678"',
            'damping="0"',
            "dynamics",
            "viscous_friction_n_m_s_per_rad",
            0.0,
            "dof_damping",
        ),
        (
            'armature="0.00171234567"',
            'armature="0.25"',
            "dynamics",
            "armature_kg_m2",
            0.25,
            "dof_armature",
        ),
        (
            "-0.01172839455 0.01172839455",
            "-0.25 0.25",
            "dynamics",
            "backlash_rad",
            0.5,
            "first/play",
        ),
        (
            'gainprm="0.8123456789"',
            'gainprm="2"',
            "motor",
            "kp_n_m_per_rad",
            2.0,
            "second: actuator_gainprm",
        ),
        (
            "-0.8123456789 -0.013",
            "-0.8123456789 -0.5",
            "motor",
            "kv_n_m_s_per_rad",
            0.5,
            "second: actuator_biasprm",
        ),
        (
            "-1.7 1.7",
            "-2 2",
            "motor",
            "torque_limit_n_m",
            2.0,
            "second: actuator_forcerange",
        ),
    ],
)
def test_an_edit_counts_and_is_listed(old, new, part, field, value, change, tmp_path):
    _, found = read(chain(), tmp_path, (old, new))
    hinge = chain().hinges[0 if part == "dynamics" else 1]
    expected = replace(hinge, **{part: replace(getattr(hinge, part), **{field: value})})
    assert found.scene.hinges[0 if part == "dynamics" else 1] == expected
    assert [line for line in found.changes if change in line]
    (line,) = scene_changes(chain(), found.scene)
    assert f"{part}.{field} " in line


def test_a_file_without_the_motor_is_refused(tmp_path):
    with pytest.raises(
        AssetError, match="its joint has a motor and needs an actuator with its name"
    ):
        read(
            chain(),
            tmp_path,
            ('name="second" joint="second"', 'name="other" joint="second"'),
        )


def test_a_file_without_the_play_is_refused(tmp_path):
    with pytest.raises(
        AssetError, match="its joint has backlash and needs a second hinge 'first/play'"
    ):
        read(chain(), tmp_path, ('name="first/play"', 'name="other"'))
