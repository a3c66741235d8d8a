"""What versions are compared on: models, functions, environments, saved states."""

import sys

import mujoco
import numpy as np
import pytest
from planted_models import SCENE, side

from gauge_envs.errors import ParameterError
from gauge_envs.tools.versions import worker
from gauge_envs.tools.versions.processes import Bench
from gauge_envs.tools.versions.subject import check_states, read_subject


def made_model():
    return mujoco.MjSpec.from_string(SCENE)


def leaves():
    print("not for the output")
    sys.exit(3)


class Made:
    """An environment that holds a compiled model."""

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(SCENE)


class Changed(Made):
    def __init__(self):
        super().__init__()
        self.model.body_mass[1] *= 2.0


class Other(Made):
    """MuJoCo writes the model that it compiled last."""

    def __init__(self):
        super().__init__()
        mujoco.MjModel.from_xml_string("<mujoco/>")


@pytest.mark.parametrize(
    ("name", "mass_kg"), [("made_model", 8.0), ("Made", 8.0), ("Changed", 16.0)]
)
def test_a_function_that_makes_a_model_is_a_subject(tmp_path, name, mass_kg):
    read = read_subject(f"{__name__}:{name}", tmp_path)
    again = mujoco.MjModel.from_xml_path(str(read.file))
    assert again.body_mass[1] == pytest.approx(mass_kg)
    assert again.nv == 7


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (f"{__name__}:Other", "incompatible models"),
        (f"{__name__}:Bench", "argument"),
        (f"{__name__}:nothing", "nothing"),
        (f"{__name__}:leaves", "SystemExit: 3"),
        ("absent.xml", "no such file"),
        ("Absent-v0", "no environment of Gymnasium"),
        ("FoamShearing-soft", "are not compared"),
    ],
)
def test_what_is_no_subject(tmp_path, text, told):
    with pytest.raises(ParameterError, match=told):
        read_subject(text, tmp_path)


LAYER = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Z"
)
def PhysicsScene "scene" {}
def Material "wood" (prepend apiSchemas = ["PhysicsMaterialAPI"])
{
    float physics:dynamicFriction = 0.5
    float physics:staticFriction = 0.5
    float physics:restitution = 0
}
def Cube "block" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI"])
{
    float physics:mass = 3
    rel material:binding:physics = </wood>
}
"""


def test_a_usd_layer_without_a_duration_is_a_subject(tmp_path):
    layer = tmp_path / "block.usda"
    layer.write_text(LAYER)
    found = read_subject(str(layer), tmp_path)
    assert mujoco.MjModel.from_xml_path(str(found.file)).body_mass[-1] == 3.0


def test_a_driven_body_of_an_id_moves_as_its_driver(tmp_path):
    """The plate of a turntable is at the poses of its motion, one every 1/180 s; the XML has none of them."""
    read = read_subject("Turntable-1-wood", tmp_path)
    assert "numeric" not in read.file.read_text()
    bench = Bench(read.file, tmp_path, steps=300, seed=0, motion=read.motion)
    _, file = bench.run(side("here"))
    with np.load(file) as states, np.load(read.motion) as motions:
        moving = states["segment"] == 0
        angle = 2.0 * np.arctan2(states["qpos"][moving, 13], states["qpos"][moving, 10])
        assert states["qvel"][moving][250, 6:] == pytest.approx(
            motions["plate"][5, 7:13]
        )
        driven = 2.0 * np.arctan2(motions["plate"][:, 6], motions["plate"][:, 3])
    assert driven[5] > 1e-6
    assert angle[250] == pytest.approx(driven[5], rel=1e-3)


@pytest.mark.parametrize(
    ("arrays", "told"),
    [
        ({"qvel": np.zeros((2, 6))}, "no qpos.*it has qvel"),
        ({"qpos": np.zeros(7)}, r"shape \(7,\)"),
        ({"qpos": np.zeros((0, 7))}, r"shape \(0, 7\)"),
        ({"qpos": np.zeros((2, 7)), "qvel": np.zeros((3, 6))}, "expected 2 rows"),
        ({"qpos": np.full((2, 7), np.nan)}, "not finite"),
    ],
)
def test_an_npz_that_holds_no_states_is_refused(tmp_path, arrays, told):
    np.savez(tmp_path / "states.npz", **arrays)
    with pytest.raises(ParameterError, match=told):
        check_states(tmp_path / "states.npz")


def test_states_of_another_model_are_refused(tmp_path):
    model = mujoco.MjModel.from_xml_string(SCENE)
    file = tmp_path / "states.npz"
    np.savez(file, qpos=np.zeros((1, 9)))
    with pytest.raises(SystemExit, match="qpos"):
        worker.saved(model, str(file))
