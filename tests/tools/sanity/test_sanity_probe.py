"""The program that writes a training environment's model to a file, and the reader of these files."""

from __future__ import annotations

import ast
import copy
import dataclasses
import enum
import json
import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity import check, configuration, gauge_probe as program
from gauge_envs.tools.sanity.gauge_probe import ARRAYS, ProbeError, plain

SUFFIX = ".gaugeprobe.json"
PROGRAM = Path(program.__file__).read_text()

# Every kind of geom and joint, objects without names, hulls, height fields, a mocap body, pairs, excludes, a keyframe.
HARD = """
<mujoco model="hard">
  <option timestep="0.004" cone="elliptic" impratio="7.3" iterations="5" ls_iterations="9" gravity="0.1 0 -9.7">
    <flag multiccd="disable" island="disable"/>
  </option>
  <asset>
    <mesh name="m" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1  .02 .02 .02"/>
    <mesh name="n" vertex="0 0 0  .2 0 0  0 .1 0  0 0 .3"/>
    <hfield name="h" nrow="2" ncol="2" size="1 2 .3 .1" elevation="0 1 2 3"/>
  </asset>
  <worldbody>
    <geom type="hfield" hfield="h" solimp=".5 .9 .02 .5 2"/>
    <geom name="floor" type="plane" size="0 0 .1" pos="0 0 -1" euler="10 0 0" friction=".7 .01 .001" condim="4"/>
    <body name="hand" mocap="true" pos="1 1 1"><geom type="box" size=".1 .2 .3"/></body>
    <body name="base" pos="0 0 1" euler="10 20 30"><freejoint/>
      <geom type="mesh" mesh="m" pos=".1 .2 .3" euler="20 30 40" priority="2" solref="-500 -20"/>
      <geom type="mesh" mesh="n" contype="0" conaffinity="0" mass="0"/>
      <body pos=".2 0 0">
        <joint name="knee" axis="0 1 0" range="-30 60" limited="true" ref="10" armature=".01" damping=".2"/>
        <site name="eye" pos=".1 0 0"/>
        <geom type="capsule" size=".05 .2" margin=".003" gap=".001"/>
        <body name="tip" pos="0 0 -.3"><joint type="ball"/>
          <geom type="ellipsoid" size=".02 .03 .04" condim="6" friction=".4 .02 .003"/>
          <body pos="0 0 -.1"><joint type="slide" axis="0 0 1"/><geom name="pin" type="cylinder" size=".02 .03"/></body>
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
  <equality><connect body1="tip" body2="other" anchor="0 0 0"/></equality>
  <tendon><spatial name="string"><site site="eye"/><site site="ring"/></spatial></tendon>
  <actuator><motor joint="knee"/><motor tendon="string"/></actuator>
  <keyframe><key name="home" qpos="0 0 2 1 0 0 0 .1 1 0 0 0 0 2 0 2 1 0 0 0"/></keyframe>
</mujoco>
"""

POSED = ("xpos", "xquat", "xipos", "ximat")


@pytest.fixture
def file(tmp_path):
    """File of the hard model."""
    path = tmp_path / f"hard{SUFFIX}"
    program.save(mujoco.MjModel.from_xml_string(HARD), str(path), "hard")
    return path


def facts(target):
    """Everything that is read of a target, but how it is called, and the model, which a file does not hold."""
    read = configuration(target)
    return {
        field.name: getattr(read, field.name)
        for field in dataclasses.fields(read)
        if field.name not in ("name", "source", "robot")
    }


# --- program ---------------------------------------------------------------------------------------------------------


def test_the_program_is_python_3_8_and_imports_only_the_standard_library():
    tree = ast.parse(PROGRAM, feature_version=(3, 8))
    tops = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    names = {
        alias.name if isinstance(node, ast.Import) else node.module
        for node in tops
        for alias in node.names
    }
    assert {str(name).partition(".")[0] for name in names} <= sys.stdlib_module_names
    assert "gauge_envs" not in PROGRAM
    # Annotations are not evaluated; these forms would be.
    assert not any(isinstance(node, ast.Match) for node in ast.walk(tree))
    assert (
        ".removeprefix(" not in PROGRAM
        and ".removesuffix(" not in PROGRAM
        and "strict=" not in PROGRAM
    )


def run_program(folder, *arguments):
    """Run the program in a folder, without the sources of this package on the path."""
    (folder / "gauge_probe.py").write_text(PROGRAM)
    environment = {
        name: value for name, value in os.environ.items() if name != "PYTHONPATH"
    }
    command = [sys.executable, "gauge_probe.py", *arguments]
    return subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_file_gives_the_same_table_as_the_target(tmp_path):
    done = run_program(tmp_path, "HalfCheetah-v5")
    assert done.stdout.split() == [f"HalfCheetah-v5{SUFFIX}"], done.stderr
    saved = tmp_path / done.stdout.strip()
    assert saved.stat().st_size < 10_000
    assert facts(saved) == facts("HalfCheetah-v5")
    patterns = ["gravity", "rest-height", "slide-wood"]
    direct, by_file = (
        check(target, only=patterns) for target in ("HalfCheetah-v5", saved)
    )
    assert [row.to_dict() for row in by_file.rows] == [
        row.to_dict() for row in direct.rows
    ]
    assert by_file.cure == direct.cure
    assert by_file.configuration.source.endswith(
        f"model 'cheetah', MuJoCo {mujoco.__version__}"
    )


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (("model.xml",), "model.xml"),
        (("robots:make",), "robots:make"),
        (("robots:SPEC",), "robots:SPEC"),
        (("robots:Env(3)", "--out", "own.json"), "robots:Env(3)"),
    ],
)
def test_forms_of_targets(tmp_path, arguments, name):
    (tmp_path / "model.xml").write_text(HARD)
    (tmp_path / "robots.py").write_text(
        "import mujoco\nSPEC = mujoco.MjSpec.from_file('model.xml')\n\ndef make():\n    return SPEC.compile()\n\n"
        "class Env:\n    def __init__(self, skip):\n        self.frame_skip, self.mj_model = skip, make()\n",
    )
    done = run_program(tmp_path, *arguments)
    assert done.returncode == 0, done.stderr
    read = configuration(tmp_path / done.stdout.strip())
    assert read.name == name
    assert read.frame_skip == (3 if "Env" in name else None)
    assert read.settings == configuration(tmp_path / "model.xml").settings


def test_a_target_without_a_model_is_an_error_in_one_line(tmp_path):
    done = run_program(tmp_path, "CartPole-v1")
    assert done.returncode == 1
    assert done.stderr.startswith("error: CartPole-v1: gymnasium.")
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.glob("*.json"))


def test_values_of_configurations_become_plain():
    class Mode(enum.Enum):
        TGS = 1

    @dataclasses.dataclass
    class Part:
        limits: tuple[float, float] = (-float("inf"), 1.5)
        mode: Mode = Mode.TGS

    values = {
        "part": Part(),
        "rows": np.array([[1, 2]]),
        "ids": slice(None),
        "kind": ast.parse,
        3: np.float32(0.004),
    }
    assert plain(values) == {
        "part": {"limits": ["-inf", 1.5], "mode": "TGS"},
        "rows": [[1, 2]],
        "ids": None,
        "kind": "ast:parse",
        "3": 0.004,
    }
    nested = []
    nested.append(nested)
    with pytest.raises(ProbeError, match="nested"):
        plain(nested)


# --- MuJoCo ----------------------------------------------------------------------------------------------------------


def test_the_model_of_a_file_is_the_original(file):
    original = mujoco.MjModel.from_xml_string(HARD)
    assert facts(file) == facts(original)
    assert facts(file)["gravity_m_per_s2"] == (0.1, 0.0, -9.7)


def test_the_robot_of_a_file_stands_as_the_original(file):
    from gauge_envs.tools.sanity.robot.saved_model import ModelData, build_saved_model

    original = mujoco.MjModel.from_xml_string(HARD)
    built, notes = build_saved_model(
        ModelData.model_validate(json.loads(file.read_text())["data"]), "file"
    )
    assert notes == []
    states = []
    for model in (original, built):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        states.append(data)
    for name in POSED:
        np.testing.assert_allclose(
            getattr(states[1], name), getattr(states[0], name), atol=1e-12
        )
    for name in (
        "body_mass",
        "body_inertia",
        "body_subtreemass",
        "body_weldid",
        "jnt_range",
        "qpos0",
        "dof_armature",
        "dof_damping",
    ):
        np.testing.assert_allclose(
            getattr(built, name), getattr(original, name), atol=1e-12
        )
    # Hulls lie where those of the original lie, whatever frame the compiler gives a mesh.
    hulls = []
    for model, data in zip((original, built), states, strict=True):
        geom = next(
            index
            for index in range(model.ngeom)
            if model.geom_type[index] == mujoco.mjtGeom.mjGEOM_MESH
        )
        first, count = (
            getattr(model, f"mesh_{key}")[model.geom_dataid[geom]]
            for key in ("vertadr", "vertnum")
        )
        turned = (
            model.mesh_vert[first : first + count]
            @ data.geom_xmat[geom].reshape(3, 3).T
        )
        hulls.append((turned + data.geom_xpos[geom]).max(axis=0))
    np.testing.assert_allclose(hulls[1], hulls[0], atol=1e-6)


def test_a_file_of_another_version_says_so(file):
    document = json.loads(file.read_text())
    document["versions"]["mujoco"] = "3.2.0"
    document["data"]["known_flags"]["disableflags"].remove("mjDSBL_MULTICCD")
    document["data"]["options"]["disableflags"] = ["mjDSBL_LATER"]
    document["data"]["options"]["later"] = 1.0
    document["data"]["implementation"] = "mujoco_warp"
    document["data"]["counts"]["nflex"] = 1
    file.write_text(json.dumps(document))
    notes = "; ".join(configuration(file).notes)
    for note in (
        f"training runs with MuJoCo 3.2.0; the rows are measured with MuJoCo {mujoco.__version__}",
        "the target's MuJoCo has no flag multiccd; here",
        "margins and gaps of two geoms are combined as since MuJoCo 3.9, not as in training",
        "the flag mjDSBL_LATER is unknown",
        "the option later is unknown",
        "training runs on MuJoCo Warp",
        "deformable bodies of the model are not read",
    ):
        assert note in notes


def test_a_pair_of_geoms_is_chosen_by_name(file):
    chosen = configuration(file, pair=("pin", "floor"))
    assert chosen.settings["contact_solref"] == [0.003, 0.8]
    assert chosen.settings["contact_solreffriction"] == [0.01, 1.0]


# --- files of strangers ----------------------------------------------------------------------------------------------


def changed(document, place, value):
    """A copy with another value at a place such as `data.arrays.geom_margin`."""
    document = copy.deepcopy(document)
    *path, last = place.split(".")
    inner = document
    for name in path:
        inner = inner[name]
    inner[last] = value
    return document


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("version", 4, "version 4 of the format.*run `gauge sanity probe` again"),
        ("version", 0, "version 0 of the format"),
        ("kind", "pickle", "kind 'pickle' is not known; known are mujoco-model"),
        ("more", 1, "more"),
        ("name", 7, "name"),
        ("versions", {"mujoco": ["4"]}, "versions.mujoco"),
        ("data.implementation", "cuda", "data: implementation"),
        ("data.arrays.geom_margin", [0.0], "geom_margin|order|index"),
        ("data.arrays.geom_margin", [float("nan")] * 9, "data: arrays.geom_margin"),
        ("data.arrays.body_mass", [-1.0] * 7, "mass"),
        ("data.arrays.pair_geom1", [99], "data: "),
        ("data.geom_types", ["mjGEOM_TORUS"] * 9, "has no 'mjGEOM_TORUS'"),
        ("data.body_names", [], "data:"),
        (
            "data.keyframes",
            {"home": [1.0]},
            "keyframes.home has 1 numbers, expected 20",
        ),
        ("data.options.integrator", "mjINT_MAGIC", "has no 'mjINT_MAGIC'"),
        ("data.options.iterations", 1.5, "options.iterations: expected a whole number"),
        ("data.options.timestep", "0.002", "options.timestep: expected a number"),
    ],
)
def test_a_wrong_file_is_refused_with_the_place(file, place, value, message):
    document = changed(json.loads(file.read_text()), place, value)
    file.write_text(json.dumps(document))
    with pytest.raises(TargetError, match=message) as caught:
        configuration(file)
    assert str(file) in str(caught.value)


def test_an_array_that_is_missing_is_named(file):
    document = json.loads(file.read_text())
    for name in ARRAYS:
        rest = {
            key: value
            for key, value in document["data"]["arrays"].items()
            if key != name
        }
        file.write_text(json.dumps(changed(document, "data.arrays", rest)))
        with pytest.raises(TargetError, match=f"arrays.{name} is missing"):
            configuration(file)


def test_a_json_file_is_recognized_by_its_start(file, tmp_path):
    renamed = tmp_path / "robot.json"
    renamed.write_bytes(file.read_bytes())
    assert configuration(renamed).contact_groups == configuration(file).contact_groups
