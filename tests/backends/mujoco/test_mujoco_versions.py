"""Versions of MuJoCo: settings and bodies that some of them lack."""

from dataclasses import replace

import mujoco
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.mujoco import versions
from gauge_envs.backends.mujoco.versions import FEATURES, constants_of
from gauge_envs.errors import ParameterError, UnsupportedSceneError

MAJOR = int(mujoco.__version__.split(".")[0])
RIGID = load_experiment("SlopeSlider-2-wood").scene
CLOTH = load_experiment("TextileFlinging-satin").scene


@pytest.fixture
def older(monkeypatch):
    """MuJoCo 3.11, as far as this package asks for it."""
    monkeypatch.setattr(mujoco, "__version__", "3.11.0")
    absent = tuple(replace(feature, constant="mjABSENT") for feature in FEATURES)
    monkeypatch.setattr(versions, "FEATURES", absent)


@pytest.mark.usefixtures("older")
def test_deformable_bodies_are_declined_below_4():
    (reason,) = backend("mujoco").supports(CLOTH).missing
    assert "need MuJoCo 4" in reason
    assert "MuJoCo 3.11.0" in reason
    with pytest.raises(UnsupportedSceneError, match="install mujoco>=4"):
        backend("mujoco").build(CLOTH)


def test_support_follows_the_installed_version():
    assert backend("mujoco").supports(RIGID)
    assert bool(backend("mujoco").supports(CLOTH)) is (MAJOR >= 4)


@pytest.mark.usefixtures("older")
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"speculative": True},
            r"'speculative': the installed MuJoCo 3\.11\.0 does not have it, .* MuJoCo 4\.0",
        ),
        ({"speculative": False}, "'speculative'.*leave it out"),
        (
            {"integrator": "discrete"},
            r"'integrator': the installed MuJoCo 3\.11\.0 has no value 'discrete'.*3\.13",
        ),
        ({"preset": "rod"}, "'integrator'.*'discrete'"),
    ],
)
def test_a_setting_that_the_installed_version_lacks_is_an_error(settings, message):
    with pytest.raises(ParameterError, match=message):
        backend("mujoco").build(RIGID, settings)


@pytest.mark.usefixtures("older")
def test_a_setting_that_the_installed_version_lacks_is_not_in_force():
    in_force = backend("mujoco").build(RIGID).settings
    assert "speculative" not in in_force
    assert in_force["integrator"] == "Euler"


@pytest.mark.parametrize("feature", FEATURES, ids=lambda feature: feature.since)
def test_a_feature_is_installed_from_the_version_on_that_is_stated(feature):
    installed = tuple(int(part) for part in mujoco.__version__.split(".")[:2])
    assert feature.is_installed is (
        installed >= tuple(int(part) for part in feature.since.split("."))
    )


def test_constants_that_the_installed_version_lacks_are_left_out():
    names = {"Euler": "mjINT_EULER", "later": "mjINT_LATER"}
    assert constants_of("mjtIntegrator", names) == {
        "Euler": mujoco.mjtIntegrator.mjINT_EULER
    }
