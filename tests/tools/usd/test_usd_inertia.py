"""A stated moment of inertia in a USD layer."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Gf, Usd, UsdPhysics

from gauge_envs import load_experiment
from gauge_envs.errors import AssetError
from gauge_envs.tools.usd.reader import read_usd
from gauge_envs.tools.usd.writer import to_usd


def test_a_stated_moment_of_inertia_survives_a_layer(tmp_path: Path) -> None:
    scene = load_experiment("CubeToss-acrylic").scene
    file = tmp_path / "cube.usda"
    to_usd(scene, file)
    assert read_usd(file).scene.body("cube").inertia_kg_m2 == pytest.approx(
        8.1e-4, rel=1e-12
    )
    stage = Usd.Stage.Open(str(file))
    cube = next(prim for prim in stage.Traverse() if prim.GetName() == "cube")
    UsdPhysics.MassAPI(cube).GetDiagonalInertiaAttr().Set(Gf.Vec3f(6.8e-4))
    stage.Save()
    with pytest.raises(AssetError, match="contradicts gauge:inertia_kg_m2"):
        read_usd(file)
