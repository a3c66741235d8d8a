"""A damaged USD file gives a scene or an error of this package, never one of USD, Python or NumPy."""

from __future__ import annotations

import re
import tempfile
from functools import cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from pxr import Sdf, Usd

from gauge_envs.errors import AssetError, GaugeError
from gauge_envs.scene import Scene
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.usd.reader import from_usd

NAMES = (
    "Turntable-1-wood",
    "Pendulum-metal",
    "StickStack-soft",
    "SlopeContact-wood",
    "FoamTwisting-soft",
    "Funnel-rayon",
)
FUZZ = settings(deadline=None, suppress_health_check=list(HealthCheck))


@cache
def layer_text(name: str) -> str:
    return (assets_folder() / "usd" / f"{name}.usda").read_text(encoding="utf-8")


def survives(content: str | bytes, suffix: str = ".usda") -> None:
    """The file gives a scene that ends, or an error that names it."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"damaged{suffix}"
        file.write_bytes(
            content.encode("utf-8", "surrogateescape")
            if isinstance(content, str)
            else content
        )
        try:
            scene = from_usd(file)
        except GaugeError as error:
            assert str(file) in str(error)
            return
        assert isinstance(scene, Scene)
        assert 0.0 < scene.duration_s < float("inf")


@settings(FUZZ, max_examples=30)
@given(
    name=st.sampled_from(NAMES),
    where=st.floats(0.0, 1.0),
    length=st.integers(0, 200),
    data=st.binary(max_size=20),
)
def test_bytes_that_are_lost_or_changed(
    name: str, where: float, length: int, data: bytes
) -> None:
    content = layer_text(name).encode()
    at = int(where * len(content))
    survives(content[:at] + data + content[at + length :])


@settings(FUZZ, max_examples=120)
@given(
    name=st.sampled_from(NAMES),
    pick=st.integers(0, 10**6),
    value=st.sampled_from(
        [
            "nan",
            "inf",
            "-1",
            "0",
            "1e300",
            "()",
            "[]",
            "None",
            '"text"',
            "(1, 2)",
            "(nan, 0, 0)",
            "-0.5",
        ]
    ),
)
def test_values_that_make_no_sense(name: str, pick: int, value: str) -> None:
    lines = layer_text(name).splitlines()
    given_ = [
        i
        for i, line in enumerate(lines)
        if re.search(r" = \S", line) and line.rstrip()[-1] != "("
    ]
    i = given_[pick % len(given_)]
    lines[i] = lines[i].partition(" = ")[0] + f" = {value}"
    survives("\n".join(lines) + "\n")


@pytest.mark.parametrize("key", ["startTimeCode", "endTimeCode", "timeCodesPerSecond"])
@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e300", "-1e20", "1e-20"])
def test_times_that_make_no_sense(key: str, value: str) -> None:
    """Without the double beside them, so that they count."""
    text, count = re.subn(
        rf"(\n    {key} = )\S+", rf"\g<1>{value}", layer_text("Turntable-1-wood")
    )
    assert count == 1
    text, count = re.subn(
        r"\n        custom double gauge:duration_s = \S+ \([^)]*\)", "", text
    )
    assert count == 1
    survives(text)


@settings(FUZZ, max_examples=60)
@given(
    name=st.sampled_from(NAMES),
    pick=st.integers(0, 10**6),
    how=st.sampled_from(["remove", "retype", "block", "empty"]),
)
def test_properties_that_are_missing_or_of_another_type(
    name: str, pick: int, how: str
) -> None:
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString(layer_text(name))
    found: list[Sdf.Path] = []
    layer.Traverse(
        "/", lambda path: found.append(path) if path.IsPropertyPath() else None
    )
    path = found[pick % len(found)]
    prim, spec = layer.GetPrimAtPath(path.GetPrimPath()), layer.GetPropertyAtPath(path)
    if how == "remove" or not isinstance(spec, Sdf.AttributeSpec):
        prim.RemoveProperty(spec)
    elif how == "retype":
        prim.RemoveProperty(spec)
        kinds = (
            (Sdf.ValueTypeNames.String, "text"),
            (Sdf.ValueTypeNames.DoubleArray, [1.0]),
            (Sdf.ValueTypeNames.Bool, True),
        )
        kind, value = kinds[pick % 3]
        Sdf.AttributeSpec(prim, path.name, kind).default = value
    elif how == "block":
        spec.default = Sdf.ValueBlock()
    else:
        spec.ClearDefaultValue()
    survives(layer.ExportToString())


@settings(FUZZ, max_examples=60)
@given(name=st.sampled_from(NAMES), pick=st.integers(0, 10**6))
def test_prims_that_are_missing(name: str, pick: int) -> None:
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(layer_text(name))
    prims = [prim.GetPath() for prim in stage.Traverse()]
    stage.RemovePrim(prims[pick % len(prims)])
    survives(stage.GetRootLayer().ExportToString())


@pytest.mark.parametrize(
    ("suffix", "content"),
    [
        (".usda", b""),
        (".usda", b"#usda 1.0\n"),
        (".usda", b"\x00" * 100),
        (".usda", b"#usda 1.0\ndef Xform"),
        (".usdc", b"PXR-USDC" + b"\xff" * 200),
        (".usd", b"neither text nor crate"),
        (".usdz", b"PK\x03\x04 no archive"),
        (".txt", b"#usda 1.0\n"),
    ],
)
def test_files_that_are_no_layers(suffix: str, content: bytes, tmp_path: Path) -> None:
    file = tmp_path / f"a{suffix}"
    file.write_bytes(content)
    with pytest.raises(AssetError, match=re.escape(str(file))):
        from_usd(file)


def test_files_that_do_not_exist(tmp_path: Path) -> None:
    for path, reason in (
        (tmp_path / "gone.usda", "there is no such file"),
        (tmp_path, "it is not a regular file"),
    ):
        with pytest.raises(AssetError, match=reason):
            from_usd(path)


@settings(FUZZ, max_examples=15)
@given(where=st.floats(0.0, 1.0), data=st.binary(min_size=1, max_size=8))
def test_binary_layers_that_are_damaged(where: float, data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "a.usdc"
        layer = Sdf.Layer.CreateAnonymous(".usda")
        layer.ImportFromString(layer_text("Pendulum-metal"))
        layer.Export(str(file))
        content = file.read_bytes()
    at = int(where * len(content))
    survives(content[:at] + data + content[at + len(data) :], ".usdc")
