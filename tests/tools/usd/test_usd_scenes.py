"""Scene -> USD -> Scene is exact, and a damaged layer gives a scene or an error of this package."""

import random
import re
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from places import one_of_a_kind
from pxr import Sdf, Usd
from usd_scenes import scenes

from gauge_envs import load_experiment
from gauge_envs.errors import AssetError, GaugeError, ParameterError, ResultFileError
from gauge_envs.experiments.variants import variants
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.usd.reader import from_usd, read_usd
from gauge_envs.tools.usd.writer import to_usd

ANY_SCENE = settings(deadline=None, suppress_health_check=list(HealthCheck))

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


def returns_exactly(scene, *suffixes):
    with tempfile.TemporaryDirectory() as folder:
        for suffix in suffixes:
            to_usd(scene, Path(folder) / f"scene{suffix}")
            assert from_usd(Path(folder) / f"scene{suffix}") == scene


@pytest.mark.slow
@settings(ANY_SCENE, max_examples=2000)
@given(scene=scenes())
def test_very_many_scenes_come_back_to_the_bit(scene):
    returns_exactly(scene, ".usdc")


# --- damage ----------------------------------------------------------------------------------------------------------

WRONG = (
    "nan",
    "inf",
    "-1",
    "0",
    "1e300",
    "-0.5",
    "()",
    "[]",
    "None",
    '"text"',
    "(1, 2)",
    "(nan, 0, 0)",
)
KINDS = (
    (Sdf.ValueTypeNames.String, "text"),
    (Sdf.ValueTypeNames.DoubleArray, [1.0]),
    (Sdf.ValueTypeNames.Bool, True),
)


def survives(content, suffix=".usda"):
    """The file gives a scene that ends, or an error that names it."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"damaged{suffix}"
        file.write_bytes(content)
        try:
            scene = from_usd(file)
        except GaugeError as error:
            assert str(file) in str(error)
            return
        assert 0.0 < scene.duration_s < float("inf")


def other_bytes(content, chance):
    at = chance.randrange(len(content))
    new = chance.randbytes(chance.randrange(20))
    return content[:at] + new + content[at + chance.randrange(200) :]


def other_value(content, chance):
    lines = content.decode().splitlines()
    given_ = [i for i, line in enumerate(lines) if re.search(r" = \S.*[^(]$", line)]
    i = chance.choice(given_)
    lines[i] = f"{lines[i].partition(' = ')[0]} = {chance.choice(WRONG)}"
    return "\n".join([*lines, ""]).encode()


def other_property(content, chance):
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString(content.decode())
    found = []
    layer.Traverse("/", lambda path: path.IsPropertyPath() and found.append(path))
    path = chance.choice(found)
    prim, spec = layer.GetPrimAtPath(path.GetPrimPath()), layer.GetPropertyAtPath(path)
    how = chance.choice(["remove", "retype", "block", "empty"])
    if how == "remove" or not isinstance(spec, Sdf.AttributeSpec):
        prim.RemoveProperty(spec)
    elif how == "retype":
        kind, value = chance.choice(KINDS)
        prim.RemoveProperty(spec)
        Sdf.AttributeSpec(prim, path.name, kind).default = value
    elif how == "block":
        spec.default = Sdf.ValueBlock()
    else:
        spec.ClearDefaultValue()
    return layer.ExportToString().encode()


def no_prim(content, chance):
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(content.decode())
    stage.RemovePrim(chance.choice([prim.GetPath() for prim in stage.Traverse()]))
    return stage.GetRootLayer().ExportToString().encode()


DAMAGES = {other_bytes: 3, other_value: 10, other_property: 5, no_prim: 5}


@settings(ANY_SCENE, max_examples=4)
@given(scene=scenes(), seed=st.integers(0, 2**32))
def test_any_scene_comes_back_to_the_bit_and_damage_is_survived(scene, seed):
    returns_exactly(scene, ".usda", ".usdc")
    chance = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        text, binary = Path(folder) / "a.usda", Path(folder) / "a.usdc"
        to_usd(scene, text)
        to_usd(scene, binary)
        for damage, count in DAMAGES.items():
            for _ in range(count):
                survives(damage(text.read_bytes(), chance))
        survives(other_bytes(binary.read_bytes(), chance), ".usdc")


@pytest.mark.parametrize("key", ["startTimeCode", "endTimeCode", "timeCodesPerSecond"])
@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e300", "-1e20", "1e-20"])
def test_times_that_make_no_sense(key, value):
    """Without the double beside them, so that they count."""
    text = (assets_folder() / "usd" / "Turntable-1-wood.usda").read_text()
    text, count = re.subn(rf"(\n    {key} = )\S+", rf"\g<1>{value}", text)
    double = r"\n        custom double gauge:duration_s = \S+ \([^)]*\)"
    text, doubles = re.subn(double, "", text)
    assert (count, doubles) == (1, 1)
    survives(text.encode())


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.usda", b""),
        ("a.usda", b"#usda 1.0\n"),
        ("a.usda", b"\x00" * 100),
        ("a.usda", b"#usda 1.0\ndef Xform"),
        ("a.usdc", b"PXR-USDC" + b"\xff" * 200),
        ("a.usd", b"neither text nor crate"),
        ("a.usdz", b"PK\x03\x04 no archive"),
        ("a.txt", b"#usda 1.0\n"),
        ("gone.usda", None),
        (".", None),
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
        (twice, "a.usda", "'cube' has more than one name"),
        (driven, "a.usda", "'plate' has more than one driver"),
        (scene, "a.obj", r"ends in \.usda"),
        (scene, "file/a.usda", "cannot be written"),
    ):
        with pytest.raises((ParameterError, ResultFileError), match=words):
            to_usd(wrong, tmp_path / name)
