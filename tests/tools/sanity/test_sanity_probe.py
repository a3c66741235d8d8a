"""The program that writes a training environment's model or settings to a file, and the reader of these files."""

from __future__ import annotations

import ast
import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity import check, configuration
from gauge_envs.tools.sanity.readers import gauge_probe as program

PROGRAM = Path(program.__file__).read_text()

# Every kind of element: geoms, joints, names that are not stated, hulls, height fields, tendons, equalities, actuators.
HARD = """
<mujoco model="hard">
  <option timestep="0.004" cone="elliptic" impratio="7.3" iterations="5" ls_iterations="9" gravity="0.1 0 -9.7">
    <flag multiccd="disable" island="disable"/>
  </option>
  <asset>
    <mesh name="m" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1  .02 .02 .02"/>
    <mesh name="n" vertex="0 0 0  .2 0 0  0 .1 0  0 0 .3"/>
    <hfield name="h" nrow="2" ncol="3" size="1 2 .3 .1" elevation="0 1 2 3 4 5"/>
  </asset>
  <worldbody>
    <geom type="hfield" hfield="h" solimp=".5 .9 .02 .5 2"/>
    <geom name="floor" type="plane" size="0 0 .1" pos="0 0 -1" euler="10 0 0" friction=".7 .01 .001" condim="4"/>
    <body name="hand" mocap="true" pos="1 1 1"><geom type="box" size=".1 .2 .3"/></body>
    <body name="base" pos="0 0 1" euler="10 20 30"><freejoint/>
      <geom type="mesh" mesh="m" pos=".1 .2 .3" euler="20 30 40" priority="2" solref="-500 -20"/>
      <geom type="mesh" mesh="n" contype="0" conaffinity="0" mass="0"/>
      <body pos=".2 0 0" gravcomp=".5">
        <joint name="knee" axis="0 1 0" range="-30 60" limited="true" ref="10" armature=".01" damping=".2"
          stiffness="3" springref="20" frictionloss=".1"/>
        <site name="eye" pos=".1 0 0"/>
        <geom type="capsule" size=".05 .2" margin=".003" gap=".001"/>
        <body name="tip" pos="0 0 -.3"><joint type="ball"/>
          <geom type="ellipsoid" size=".02 .03 .04" condim="6" friction=".4 .02 .003"/>
          <body pos="0 0 -.1"><joint name="lift" type="slide" axis="0 0 1"/>
            <geom name="pin" type="cylinder" size=".02 .03"/></body>
        </body>
      </body>
    </body>
    <body name="other" pos="2 0 1"><freejoint/><geom size=".1"/><site name="ring"/></body>
  </worldbody>
  <contact>
    <pair geom1="pin" geom2="floor" condim="3" friction="1.2 1.1 .01 .001 .002" solref=".003 .8"
      solreffriction=".01 1"/>
    <exclude body1="base" body2="other"/>
  </contact>
  <equality>
    <connect body1="tip" body2="other" anchor="0 0 0"/>
    <weld body1="hand" body2="other" solref=".05 1" torquescale=".2" active="false"/>
    <weld body1="base" body2="other" relpose=".1 .2 .3 .8 .6 0 0" anchor=".01 .02 .03"/>
    <joint joint1="lift" joint2="knee" polycoef="0 .01 0 0 0"/>
  </equality>
  <tendon>
    <spatial name="string" range="0 3" limited="true"><site site="eye"/><geom geom="pin"/><site site="ring"/></spatial>
    <fixed name="sum"><joint joint="knee" coef="2"/><joint joint="lift" coef=".5"/></fixed>
  </tendon>
  <actuator>
    <position joint="knee" kp="20" kv=".3" forcerange="-2 2"/><motor tendon="string" gear="3"/>
    <general site="eye" refsite="ring" gear="1 0 0 0 0 0" dyntype="filter" dynprm=".03"/>
  </actuator>
  <keyframe><key name="home" qpos="0 0 2 1 0 0 0 .1 1 0 0 0 0 2 0 2 1 0 0 0" ctrl=".1 .2 .3"/></keyframe>
</mujoco>
"""


@pytest.fixture
def original():
    """The hard model, changed after loading."""
    model = mujoco.MjModel.from_xml_string(HARD)
    model.opt.timestep, model.geom_solref[1] = 0.001, (0.006, 1.0)
    return model


@pytest.fixture
def file(tmp_path, original):
    """File of an environment with the hard model."""
    path = tmp_path / "hard.gaugeprobe.json"
    program.save(SimpleNamespace(mj_model=original), str(path))
    return path


def facts(target):
    """Everything that is read of a target except its name and the model."""
    read = dataclasses.asdict(dataclasses.replace(configuration(target), robot=None))
    return {key: read[key] for key in read if key not in ("name", "source")}


def results(target, *only):
    return check(target, only=only, explain=False).checks


def run_program(folder, *arguments):
    """Run the program in a folder, without the sources of this package on the path."""
    (folder / "gauge_probe.py").write_text(PROGRAM)
    return subprocess.run(
        [sys.executable, "gauge_probe.py", *arguments],
        cwd=folder,
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_program_is_python_3_8_and_imports_only_the_standard_library():
    tree = ast.parse(PROGRAM, feature_version=(3, 8))
    imports = [node for node in tree.body if isinstance(node, ast.Import)]
    names = {alias.name for node in imports for alias in node.names}
    names |= {node.module for node in tree.body if isinstance(node, ast.ImportFrom)}
    assert {name.partition(".")[0] for name in names} <= sys.stdlib_module_names
    later = ("gauge_envs", ".removeprefix(", ".removesuffix(", "strict=")
    assert not any(words in PROGRAM for words in later)


def test_a_file_gives_the_results_of_the_target_digit_by_digit(tmp_path):
    done = run_program(tmp_path, "HalfCheetah-v5")
    assert done.stdout.split() == ["HalfCheetah-v5.gaugeprobe.json"], done.stderr
    saved = tmp_path / done.stdout.strip()
    assert facts(saved) == facts("HalfCheetah-v5")
    only = ("gravity", "rest-height", "slide-wood")
    assert results(saved, *only) == results("HalfCheetah-v5", *only)


def test_python_of_a_module_is_a_target(tmp_path):
    (tmp_path / "model.xml").write_text(HARD)
    (tmp_path / "robots.py").write_text(
        "import mujoco\n\nclass Env:\n    def __init__(self, skip):\n        self.frame_skip = skip\n"
        "        self.mj_model = mujoco.MjModel.from_xml_path('model.xml')\n",
    )
    done = run_program(tmp_path, "robots:Env(3)", "--out", "env.json")
    assert done.returncode == 0, done.stderr
    read = configuration(tmp_path / done.stdout.strip())
    assert read.name == "env"
    assert read.settings == configuration(tmp_path / "model.xml").settings


def test_a_target_without_a_model_is_an_error_in_one_line(tmp_path):
    done = run_program(tmp_path, "CartPole-v1")
    assert done.returncode == 1
    assert done.stderr.startswith("error: CartPole-v1: gymnasium.")
    assert done.stderr.count("\n") == 1


def test_the_model_of_a_file_is_the_original_and_moves_alike(file, original):
    built = configuration(file).robot.model
    assert facts(file) == facts(original)
    exact = "body_mass body_inertia jnt_range qpos0 qpos_spring dof_armature dof_damping dof_frictionloss jnt_stiffness"
    exact += " actuator_gainprm actuator_biasprm actuator_forcerange actuator_trnid tendon_range hfield_data"
    for name in f"{exact} tendon_lengthspring body_gravcomp key_qpos key_ctrl geom_friction".split():
        values = getattr(built, name), getattr(original, name)
        np.testing.assert_allclose(*values, atol=1e-12, err_msg=name)
    # A weld has its anchor, the pose of its second body and the scale of its torque in eleven numbers.
    welds = built.eq_data[:, :11], original.eq_data[:, :11]
    np.testing.assert_allclose(*welds, atol=1e-12)
    ends = []
    for model in (original, built):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_step(model, data, 100)
        ends.append(data.qpos)
    np.testing.assert_allclose(*ends, atol=1e-6)


def test_a_file_of_another_version_says_so(file):
    text = file.read_text().replace("<option ", "<option later='1' ")
    document = json.loads(text) | {"engine": "MJX", "notes": ["from the probe"]}
    document["mujoco"] = "3.2.0"
    file.write_text(json.dumps(document))
    notes = "; ".join(configuration(file).notes)
    for note in (
        f"training runs with MuJoCo 3.2.0; the checks run with MuJoCo {mujoco.__version__}",
        "has no later of <option>, which is 1 in training",
        "training runs on MJX",
        "from the probe",
    ):
        assert note in notes
    file.write_text(json.dumps(document | {"version": 3}))
    with pytest.raises(TargetError, match=r"version 3 of the probe.*again"):
        configuration(file)
