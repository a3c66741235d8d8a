"""Hinges between two bodies in USD layers: exact return, edits, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdPhysics

from gauge_envs import load_experiment
from gauge_envs.errors import AssetError
from gauge_envs.scene.scene import Scene
from gauge_envs.tools.usd.reader import read_usd
from gauge_envs.tools.usd.writer import to_usd


@pytest.fixture
def scene() -> Scene:
    return load_experiment("ElbowToss-blocks").scene


@pytest.fixture
def stage(scene: Scene, tmp_path: Path) -> Usd.Stage:
    to_usd(scene, tmp_path / "elbow.usda")
    return Usd.Stage.Open(str(tmp_path / "elbow.usda"))


def joint(stage: Usd.Stage) -> UsdPhysics.RevoluteJoint:
    return UsdPhysics.RevoluteJoint(
        next(prim for prim in stage.Traverse() if prim.IsA(UsdPhysics.RevoluteJoint))
    )


def saved(stage: Usd.Stage) -> Path:
    stage.Save()
    return Path(stage.GetRootLayer().realPath)


def test_a_layer_returns_the_scene_exactly(scene: Scene, stage: Usd.Stage) -> None:
    assert read_usd(saved(stage)).scene == scene
    assert [
        str(rel.GetTargets()[0])
        for rel in (joint(stage).GetBody0Rel(), joint(stage).GetBody1Rel())
    ] == [
        "/World/first",
        "/World/second",
    ]


def test_a_joint_without_exact_numbers_is_read_from_its_frames(
    scene: Scene, stage: Usd.Stage
) -> None:
    for name in ("gauge:anchor_m", "gauge:axis"):
        joint(stage).GetPrim().RemoveProperty(name)
    (found,) = read_usd(saved(stage)).scene.body_hinges
    np.testing.assert_allclose(found.anchor_m, scene.body_hinges[0].anchor_m, atol=1e-7)
    np.testing.assert_allclose(found.axis, scene.body_hinges[0].axis, atol=1e-6)


def test_edited_frames_move_the_hinge(scene: Scene, stage: Usd.Stage) -> None:
    for place in (joint(stage).GetLocalPos0Attr(), joint(stage).GetLocalPos1Attr()):
        # Along the axis, which is the same in both blocks.
        place.Set(place.Get() + Gf.Vec3f(0.0, 0.01, 0.0))
    (found,) = read_usd(saved(stage)).scene.body_hinges
    along = (
        np.subtract(found.anchor_m, scene.body_hinges[0].anchor_m)
        @ scene.body_hinges[0].axis
    )
    assert along == pytest.approx(0.01, abs=1e-6)


def test_frames_that_do_not_meet_are_refused(stage: Usd.Stage) -> None:
    place = joint(stage).GetLocalPos1Attr()
    place.Set(place.Get() + Gf.Vec3f(0.0, 0.0, 0.002))
    with pytest.raises(AssetError, match="up to 2 mm"):
        read_usd(saved(stage))


def test_other_joints_of_two_bodies_are_refused(stage: Usd.Stage) -> None:
    path = joint(stage).GetPath()
    targets = [
        rel.GetTargets()
        for rel in (joint(stage).GetBody0Rel(), joint(stage).GetBody1Rel())
    ]
    stage.RemovePrim(path)
    ball = UsdPhysics.SphericalJoint.Define(stage, path)
    ball.CreateBody0Rel().SetTargets(targets[0])
    ball.CreateBody1Rel().SetTargets(targets[1])
    with pytest.raises(AssetError, match="revolute joints of two bodies are read"):
        read_usd(saved(stage))


def test_limits_are_refused(stage: Usd.Stage) -> None:
    joint(stage).CreateLowerLimitAttr(-30.0)
    with pytest.raises(AssetError, match="have no limits"):
        read_usd(saved(stage))
