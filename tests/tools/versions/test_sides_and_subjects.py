"""Sides and subjects of a comparison: versions, environments of releases, models, saved states."""

import subprocess
import sys

import mujoco
import numpy as np
import pytest
from places import ROOT
from planted_models import SCENE, plant_workers, side

from gauge_envs.errors import ParameterError
from gauge_envs.tools.versions import environments, worker
from gauge_envs.tools.versions.environments import VersionsError, work
from gauge_envs.tools.versions.subject import (
    compares_motions,
    read_sides,
    read_subject,
    releases_between,
)

TASK_FILE = ROOT / "examples/own_experiment/crate.toml"

# --- sides -----------------------------------------------------------------------------------------------------------


def test_versions_are_read():
    (release,) = read_sides("mujoco==3.3.0:iterations=4,gravity=[0,0,-1]")
    assert release.settings == {"iterations": 4, "gravity": [0, 0, -1]}
    assert release.requirement == "mujoco==3.3.0"
    ends = read_sides("mujoco==3.1.0..4.0.0")
    assert [end.requirement for end in ends] == ["mujoco==3.1.0", "mujoco==4.0.0"]
    (rapier,) = read_sides("rapier==0.36.0")
    assert (rapier.engine, rapier.requirement) == ("rapier", "rapier3d==0.36.0")
    (alone,) = read_sides("iterations=4")
    assert (alone.engine, alone.settings) == ("mujoco", {"iterations": 4})


@pytest.mark.parametrize("text", ["mujco==3.3.0", "mujoco=3.3.0", "mujoco>=3"])
def test_an_unknown_version_is_an_error_with_the_forms(text):
    with pytest.raises(ParameterError, match="expected mujoco=="):
        read_sides(text)


@pytest.mark.parametrize(
    ("subject", "texts"),
    [
        ("SlopeSlider-2-wood", ("mujoco==3.3.0", "newton")),
        ("scene.xml", ("mujoco", "mujoco:preset=training")),
    ],
)
def test_engines_are_compared_with_each_other_on_ids(subject, texts):
    sides = [side for text in texts for side in read_sides(text)]
    with pytest.raises(ParameterError, match="on an experiment, as SlopeSlider"):
        compares_motions(subject, sides)


@pytest.mark.parametrize("subject", ["GAUGE/CubePush-light", TASK_FILE])
def test_releases_of_an_engine_are_compared_on_every_experiment(subject, monkeypatch):
    monkeypatch.setenv("GAUGE_TASKS", "")
    sides = [*read_sides("rapier==0.36.0"), *read_sides("rapier==0.36.1")]
    assert compares_motions(str(subject), sides)


# --- environments ----------------------------------------------------------------------------------------------------


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """Return the folder of environments; installations use `pip` of the test."""
    monkeypatch.setenv("GAUGE_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(environments.shutil, "which", lambda name: None)

    def create(folder, with_pip):
        (folder / "bin").mkdir(parents=True)
        (folder / "bin" / "python").touch()

    monkeypatch.setattr(environments.venv, "create", create)
    return tmp_path / "versions"


def pip(monkeypatch, output, error=""):
    done = subprocess.CompletedProcess([], int(bool(error)), output, error)
    monkeypatch.setattr(environments.subprocess, "run", lambda *words, **more: done)


def test_a_failed_installation_gives_the_reason_and_leaves_no_folder(
    cache, monkeypatch
):
    pip(monkeypatch, "", "WARNING: retry\nERROR: No matching distribution found")
    with pytest.raises(VersionsError, match=r"mujoco==9.9.0 .*--python.*No matching"):
        environments.make_environment("mujoco==9.9.0")
    assert [path.name for path in cache.iterdir()] == [".lock"]


def test_an_environment_is_installed_once(cache, monkeypatch, capsys):
    pip(monkeypatch, "")
    folder = environments.make_environment("mujoco==3.1.0")
    # Wheels of this release need an older NumPy.
    assert "mujoco==3.1.0 and numpy<2: installing" in capsys.readouterr().err
    assert {path.name for path in cache.iterdir()} == {".lock", folder.name}
    environments.make_environment("mujoco==3.1.0")
    assert not capsys.readouterr().err
    # Without its Python, the environment is installed again.
    (folder / "bin" / "python").unlink()
    environments.make_environment("mujoco==3.1.0")
    assert (folder / "bin" / "python").exists()
    environments.remove_environment("mujoco==3.1.0")
    assert not folder.exists()


def test_a_range_has_the_releases_of_the_index_between_its_ends(cache, monkeypatch):
    pip(monkeypatch, "mujoco (4.0.0)\nAvailable versions: 3.10.0, 3.9.0, 3.3.0\n")
    releases = releases_between(read_sides("mujoco==3.9.0..3.10.0"))
    assert [release.title for release in releases] == [
        "mujoco==3.9.0",
        "mujoco==3.10.0",
    ]
    with pytest.raises(ParameterError, match=r"newest are 3\.3\.0, 3\.9\.0, 3\.10\.0"):
        releases_between(read_sides("mujoco==3.3.1..3.8"))


# --- models ----------------------------------------------------------------------------------------------------------


def made_model():
    return mujoco.MjSpec.from_string(SCENE)


def leaves():
    sys.exit(3)


def test_a_function_that_returns_a_model_is_a_subject(tmp_path):
    file = read_subject(f"{__name__}:made_model", tmp_path)
    model = mujoco.MjModel.from_xml_path(str(file))
    assert (model.body_mass[1], model.nv) == (pytest.approx(8.0), 7)


def test_an_environment_of_gymnasium_is_its_model_file(tmp_path):
    file = read_subject("Hopper-v5", tmp_path)
    assert mujoco.MjModel.from_xml_path(str(file)).nu == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("CartPole-v1", "without a model file"),
        (f"{__name__}:nothing", "nothing"),
        (f"{__name__}:leaves", "SystemExit: 3"),
        ("absent.xml", "no such file"),
        ("Turntable-1-wood", "are not compared"),
    ],
)
def test_an_invalid_subject_is_an_error(tmp_path, text, message):
    with pytest.raises(ParameterError, match=message):
        read_subject(text, tmp_path)


@pytest.mark.parametrize(
    "arrays", [{"qpos": np.zeros((1, 9))}, {"qvel": np.zeros((2, 7))}]
)
def test_states_that_do_not_fit_the_model_are_rejected(tmp_path, monkeypatch, arrays):
    saved = tmp_path / "states.npz"
    np.savez(saved, **arrays)
    job = plant_workers(monkeypatch, tmp_path)
    with pytest.raises(SystemExit, match="expected 8 columns"):
        work("run", {**job, "saved": str(saved)}, [side("old")])


# --- processes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"jacobian": "densest"}, "jacobian=densest: expected dense or sparse"),
        ({"iterations": "many"}, "iterations=many: expected 100"),
    ],
)
def test_a_wrong_setting_is_an_error_with_the_expected_value(settings, message):
    with pytest.raises(SystemExit, match=message):
        worker.set_options(mujoco.MjModel.from_xml_string("<mujoco/>"), settings)


def test_a_failed_worker_gives_the_reason(tmp_path):
    model = tmp_path / "newer.xml"
    model.write_text("<mujoco><newer/></mujoco>")
    job = {"title": "newer.xml", "model": str(model)}
    with pytest.raises(VersionsError, match=r"old cannot run newer.xml: .*newer"):
        work("run", job, [side("old")])


def test_packages_of_a_release_precede_packages_of_the_user(tmp_path, monkeypatch):
    monkeypatch.setattr(environments, "make_environment", lambda requirement: tmp_path)
    package = tmp_path / "lib" / "site-packages" / "mujoco"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("raise ImportError('this is mujoco 3.3.0')")
    with pytest.raises(VersionsError, match=r"this is mujoco 3\.3\.0"):
        work("run", {"title": "it"}, read_sides("mujoco==3.3.0"))
