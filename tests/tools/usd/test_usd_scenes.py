"""Scene -> USD -> Scene is exact; a file that is no layer gives an error that names it."""

import re
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from places import one_of_a_kind
from usd_scenes import scenes

from gauge_envs import load_experiment
from gauge_envs.errors import AssetError, ParameterError, ResultFileError
from gauge_envs.experiments.variants import variants
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.usd.reader import from_usd, read_usd
from gauge_envs.tools.usd.writer import to_usd

# --- exact return ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", one_of_a_kind(one.name for one in variants()))
def test_checked_in_layers_are_the_scenes_to_the_bit(name):
    read = read_usd(assets_folder() / "usd" / f"{name}.usda")
    assert read.scene == load_experiment(name).scene
    assert read.metadata["variant"] == name
    assert set(read.paths) >= {body.name for body in read.scene.bodies}


def test_a_layer_keeps_an_inertia(tmp_path):
    scene = load_experiment("CubeToss-acrylic").scene
    to_usd(scene, tmp_path / "a.usda")
    assert from_usd(tmp_path / "a.usda") == scene


@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
@given(scene=scenes())
def test_any_scene_comes_back_to_the_bit(scene, tmp_path):
    for name in ("scene.usda", "scene.usdc"):
        to_usd(scene, tmp_path / name)
        assert from_usd(tmp_path / name) == scene


# --- files that are no layers ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.usda", b""),
        ("a.usda", b"#usda 1.0\ndef Xform"),
        ("a.usdc", b"PXR-USDC" + b"\xff" * 200),
        ("a.usdz", b"PK\x03\x04 no archive"),
        ("a.txt", b"#usda 1.0\n"),
        ("gone.usda", None),
    ],
)
def test_files_that_are_no_layers(name, content, tmp_path):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(AssetError, match=re.escape(str(tmp_path / name))):
        from_usd(tmp_path / name)


def test_what_is_named_or_driven_twice_is_not_written(tmp_path):
    scene = load_experiment("Turntable-1-wood").scene
    twice = replace(scene, bodies=(*scene.bodies, scene.body("cube")))
    driven = replace(scene, drivers=scene.drivers * 2)
    (tmp_path / "file").touch()
    for wrong, name, words in (
        (twice, "a.usda", "'cube' has more than one name or driver"),
        (driven, "a.usda", "'plate' has more than one name or driver"),
        (scene, "a.obj", r"ends in \.usda"),
        (scene, "file/a.usda", "cannot be written"),
    ):
        with pytest.raises((ParameterError, ResultFileError), match=words):
            to_usd(wrong, tmp_path / name)
