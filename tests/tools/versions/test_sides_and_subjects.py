"""What is compared, and on what: versions, environments of releases, models, saved states."""

import subprocess
import sys

import mujoco
import numpy as np
import pytest
from planted_models import SCENE, Planted, side

from gauge_envs.errors import ParameterError
from gauge_envs.tools.versions import environments, worker
from gauge_envs.tools.versions.environments import Bench, VersionsError
from gauge_envs.tools.versions.sides import (
    compares_motions,
    read_sides,
    releases_between,
)
from gauge_envs.tools.versions.subject import check_states, read_subject

# --- sides -----------------------------------------------------------------------------------------------------------


def test_versions_are_read():
    (release,) = read_sides("mujoco==3.3.0:iterations=4,gravity=[0,0,-1]")
    assert release.settings == {"iterations": 4, "gravity": [0, 0, -1]}
    assert release.requirement == "mujoco==3.3.0"
    ends = read_sides("mujoco==3.1.0..4.0.0")
    assert [end.requirement for end in ends] == ["mujoco==3.1.0", "mujoco==4.0.0"]
    (rapier,) = read_sides("rapier==0.36.0")
    assert (rapier.engine, rapier.requirement) == ("rapier", "rapier3d==0.36.0")
    assert read_sides("mujoco")[0].python == sys.executable
    (alone,) = read_sides("iterations=4")
    assert (alone.engine, alone.settings) == ("mujoco", {"iterations": 4})


@pytest.mark.parametrize(
    "text", ["mujco==3.3.0", "mujoco==new", "mujoco=3.3.0", "mujoco>=3"]
)
def test_what_names_no_version_is_an_error_with_the_forms(text):
    with pytest.raises(ParameterError, match="expected mujoco=="):
        read_sides(text)


@pytest.mark.parametrize(
    ("subject", "texts", "message"),
    [
        ("SlopeSlider-2-wood", ("mujoco==3.3.0", "newton"), "releases of MuJoCo are"),
        ("scene.xml", ("mujoco", "newton"), "on an id of this suite"),
        ("scene.xml", ("mujoco", "mujoco:preset=training"), "on an id of this suite"),
    ],
)
def test_versions_that_cannot_be_compared(subject, texts, message):
    sides = []
    for text in texts:
        sides += read_sides(text)
    with pytest.raises(ParameterError, match=message):
        compares_motions(subject, sides)


# --- environments ----------------------------------------------------------------------------------------------------


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """Return a folder of environments, into which `pip` of a test installs."""
    monkeypatch.setenv("GAUGE_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(environments.shutil, "which", lambda name: None)

    def create(folder, with_pip):
        (folder / "bin").mkdir(parents=True)
        (folder / "bin" / "python").touch()

    monkeypatch.setattr(environments.venv, "create", create)
    return tmp_path / "versions"


def pip(monkeypatch, output, returncode=1):
    done = subprocess.CompletedProcess([], returncode, "", output)
    monkeypatch.setattr(environments.subprocess, "run", lambda *words, **more: done)


LACKS = "ERROR: Could not find a version that satisfies the requirement mujoco==9.9.0"


@pytest.mark.parametrize(
    ("output", "message"),
    [
        (f"{LACKS} (from versions: 3.3.0, 3.9.0)\nERROR: No match", "No match.*3.9.0"),
        ("WARNING: after connection broken by 'E'\nERROR: No", "does not answer"),
        ("error: Failed to fetch: `i/`", "does not answer"),
    ],
)
def test_why_an_installation_failed(cache, monkeypatch, output, message):
    pip(monkeypatch, output)
    with pytest.raises(VersionsError, match=message):
        environments.make_environment(
            "mujoco==9.9.0",
        )
    assert [folder.name for folder in cache.iterdir()] == [".locks"]


def test_an_environment_is_made_once_and_leftovers_go(cache, monkeypatch, capsys):
    pip(monkeypatch, "", 0)
    folder = environments.environment_folder("mujoco==3.1.0")
    folder.with_name(f".{folder.name}").mkdir(parents=True)
    python = environments.make_environment("mujoco==3.1.0")
    # Wheels of this release need an older NumPy.
    assert "mujoco==3.1.0 and numpy<2: installed" in capsys.readouterr().err
    assert {each.name for each in cache.iterdir()} == {".locks", folder.name}
    environments.make_environment("mujoco==3.1.0")
    assert not capsys.readouterr().err
    # The Python of an environment may have been removed.
    python.unlink()
    assert environments.make_environment("mujoco==3.1.0").exists()
    environments.remove_environment("mujoco==3.1.0")
    assert not folder.exists()


def test_a_range_has_the_releases_of_the_index_between_its_ends(cache, monkeypatch):
    pip(monkeypatch, "mujoco (4.0.0)\nAvailable versions: 3.10.0, 3.9.0, 3.3.0\n", 0)
    releases = releases_between(read_sides("mujoco==3.9..3.10.0"))
    assert [each.title for each in releases] == ["mujoco==3.9.0", "mujoco==3.10.0"]
    with pytest.raises(ParameterError, match=r"newest are 3\.3\.0, 3\.9\.0, 3\.10\.0"):
        releases_between(read_sides("mujoco==3.3.1..3.8"))


# --- models ----------------------------------------------------------------------------------------------------------


def made_model():
    return mujoco.MjSpec.from_string(SCENE)


def leaves():
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
    file = read_subject(f"{__name__}:{name}", tmp_path)
    model = mujoco.MjModel.from_xml_path(str(file))
    assert (model.body_mass[1], model.nv) == (pytest.approx(mass_kg), 7)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{__name__}:Other", "cannot save the model"),
        (f"{__name__}:nothing", "nothing"),
        (f"{__name__}:leaves", "SystemExit: 3"),
        ("absent.xml", "no such file"),
        ("Absent-v0", "no environment of Gymnasium"),
        ("FoamShearing-soft", "are not compared"),
        ("Turntable-1-wood", "are not compared"),
    ],
)
def test_what_is_no_subject(tmp_path, text, message):
    with pytest.raises(ParameterError, match=message):
        read_subject(text, tmp_path)


LAYER = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Z"
)
def PhysicsScene "scene" {}
def Cube "block" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI"])
{
    float physics:mass = 3
    rel material:binding:physics = </wood>
}
def Material "wood" (prepend apiSchemas = ["PhysicsMaterialAPI"])
{
    float physics:dynamicFriction = 0.5
    float physics:staticFriction = 0.5
    float physics:restitution = 0
}
"""


def test_a_usd_layer_is_a_subject(tmp_path):
    layer = tmp_path / "block.usda"
    layer.write_text(LAYER)
    file = read_subject(str(layer), tmp_path)
    assert mujoco.MjModel.from_xml_path(str(file)).body_mass[-1] == 3.0


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"qvel": np.zeros((2, 6))}, "expected qpos"),
        ({"qpos": np.zeros((2, 7)), "qvel": np.zeros((3, 6))}, "as many rows"),
        ({"qpos": np.full((2, 7), np.nan)}, "finite"),
    ],
)
def test_an_npz_without_states_is_refused(tmp_path, arrays, message):
    np.savez(tmp_path / "states.npz", **arrays)
    with pytest.raises(ParameterError, match=message):
        check_states(tmp_path / "states.npz")


def test_states_of_another_model_are_refused(tmp_path):
    saved = tmp_path / "states.npz"
    np.savez(saved, qpos=np.zeros((1, 9)))
    with pytest.raises(SystemExit, match=r"9 numbers of qpos; the model has 8"):
        Planted(tmp_path, saved=saved).work("run", [side("old")])


# --- processes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"jacobian": "densest"}, "jacobian=densest: expected dense or sparse"),
        ({"iterations": "many"}, "iterations=many: expected a value as 100"),
        ({"iteration": 3}, "iteration=3: expected .* an option of this release"),
        ({"timestep": 0.0}, "positive"),
    ],
)
def test_a_wrong_setting_says_what_is_expected(settings, message):
    with pytest.raises(SystemExit, match=message):
        worker.set_options(mujoco.MjModel.from_xml_string("<mujoco/>"), settings)


def test_a_worker_that_fails_says_why(tmp_path):
    model = tmp_path / "newer.xml"
    model.write_text(SCENE.replace("<body", "<newer/><body"))
    bench = Bench(title="newer.xml", job={"model": str(model)})
    with pytest.raises(VersionsError, match=r"old cannot run newer.xml: .*newer"):
        bench.work("run", [side("old")])


def test_an_attribute_that_a_release_lacks_is_left_out_and_listed(tmp_path):
    text = SCENE.replace("<option", '<option newer="1"')
    model = tmp_path / "scene.xml"
    model.write_text(text.replace("timestep", 'cone="round" timestep'))
    compiled, dropped = worker.load_model({"model": str(model), "settings": {}})
    assert set(dropped) == {'option newer="1"', 'option cone="round"'}
    assert compiled.opt.timestep == 0.004


def test_an_attribute_that_a_release_has_for_other_actuators_is_left_out():
    """MuJoCo 4 writes `input` for all actuators; MuJoCo 3.12 knows it for some."""
    text = '<mujoco><general name="a" input="pos"/><general name="b" input="pos"/></mujoco>'
    root = worker.ElementTree.fromstring(text)
    message = (
        "Error: input is only available for so3, pid and dcmotor actuators, actuator 'a' (id = 0)\n"
        "Element name 'a', id 0, line 2"
    )
    assert worker.remove_unknown(root, message) == ['general input="pos"']
    assert [element.get("input") for element in root] == [None, "pos"]
