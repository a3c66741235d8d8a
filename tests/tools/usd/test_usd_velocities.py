"""Start velocities in USD layers: exact in gauge: doubles, and as other tools read and write them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from gauge_envs.errors import AssetError
from gauge_envs.scene import (
    Box,
    ConvexUnion,
    Hinge,
    Motion,
    Pose,
    RigidBody,
    Scene,
    Sphere,
)
from gauge_envs.scene.meshes import mass_properties
from gauge_envs.tools.usd.reader import from_usd
from gauge_envs.tools.usd.writer import to_usd

POSE = Pose.from_euler_deg((0.2, 0.1, 1.0), (50.0, -20.0, 70.0))
CORNERS = np.add(Box(size_m=(0.1, 0.06, 0.03)).corners_m, (0.05, 0.03, 0.015)).tolist()
SOLID = ConvexUnion(pieces_m=(tuple((x, y, z) for x, y, z in CORNERS),))
LINEAR, ANGULAR = (1.2, -0.8, 1 / 3), (2.0, math.pi, -3.0)
THROWN = RigidBody(
    name="thrown",
    shape=SOLID,
    motion=Motion.DYNAMIC,
    pose=POSE,
    mass_kg=0.4,
    linear_velocity_m_per_s=LINEAR,
    angular_velocity_rad_per_s=ANGULAR,
)
SCENE = Scene(bodies=(THROWN,), duration_s=0.5)


def written(
    tmp_path: Path, edit: Callable[[UsdPhysics.RigidBodyAPI], None] = lambda _: None
) -> Path:
    """A layer of the scene after an edit of the body."""
    to_usd(SCENE, tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    edit(UsdPhysics.RigidBodyAPI(stage.GetPrimAtPath("/World/thrown")))
    stage.Export(str(tmp_path / "b.usda"))
    return tmp_path / "b.usda"


def test_a_layer_keeps_every_digit(tmp_path: Path) -> None:
    assert from_usd(written(tmp_path)) == SCENE


def test_a_scene_at_rest_writes_no_velocity(tmp_path: Path) -> None:
    rest = replace(
        THROWN,
        linear_velocity_m_per_s=(0.0, 0.0, 0.0),
        angular_velocity_rad_per_s=(0.0, 0.0, 0.0),
    )
    to_usd(replace(SCENE, bodies=(rest,)), tmp_path / "a.usda")
    assert "elocity" not in (tmp_path / "a.usda").read_text()


def test_newton_reads_the_same_velocities(tmp_path: Path) -> None:
    newton = pytest.importorskip("newton")
    builder = newton.ModelBuilder()
    index = builder.add_usd(str(written(tmp_path)))["path_body_map"]["/World/thrown"]
    centre = POSE.rotation.apply(mass_properties(SOLID, 1.0)[0])
    # Newton's linear velocity is that of the centre of mass.
    expected = [*np.add(LINEAR, np.cross(ANGULAR, centre)), *ANGULAR]
    assert list(builder.body_qd[index]) == pytest.approx(expected, abs=1e-5)


def test_an_edited_standard_velocity_counts(tmp_path: Path) -> None:
    def edit(rigid: UsdPhysics.RigidBodyAPI) -> None:
        assert rigid.GetAngularVelocityAttr().HasAuthoredValue()
        rigid.GetVelocityAttr().Set(Gf.Vec3f(0.0, 0.0, 2.0))
        rigid.GetAngularVelocityAttr().Set(Gf.Vec3f(0.0, 0.0, 0.0))

    body = from_usd(written(tmp_path, edit)).body("thrown")
    assert body.linear_velocity_m_per_s == pytest.approx(
        POSE.rotation.apply([0.0, 0.0, 2.0]), abs=1e-12
    )
    assert body.angular_velocity_rad_per_s == (0.0, 0.0, 0.0)


def test_an_edited_double_counts(tmp_path: Path) -> None:
    edited = (3.0, 0.0, 0.1)
    file = written(
        tmp_path,
        lambda rigid: (
            rigid.GetPrim().GetAttribute("gauge:linear_velocity_m_per_s").Set(edited)
        ),
    )
    assert from_usd(file) == replace(
        SCENE, bodies=(replace(THROWN, linear_velocity_m_per_s=edited),)
    )


def test_two_edits_that_disagree_are_an_error(tmp_path: Path) -> None:
    def edit(rigid: UsdPhysics.RigidBodyAPI) -> None:
        rigid.GetPrim().GetAttribute("gauge:linear_velocity_m_per_s").Set(
            (3.0, 0.0, 0.1)
        )
        rigid.GetVelocityAttr().Set(Gf.Vec3f(0.0, 0.0, 2.0))

    with pytest.raises(
        AssetError,
        match=r"/World/thrown: its gauge: velocities give physics:velocity .* make them agree",
    ):
        from_usd(written(tmp_path, edit))


def foreign(
    tmp_path: Path, *, up: str, metres: float, edit: Callable[[UsdGeom.Xform], None]
) -> RigidBody:
    """The ball of a layer of plain UsdPhysics, with a velocity of (100, 0, 0) units/s and (0, 0, 180) degrees/s."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(24)
    UsdPhysics.Scene.Define(stage, "/Physics")
    xform = UsdGeom.Xform.Define(stage, "/ball")
    edit(xform)
    rigid = UsdPhysics.RigidBodyAPI.Apply(xform.GetPrim())
    rigid.CreateVelocityAttr(Gf.Vec3f(100.0, 0.0, 0.0))
    rigid.CreateAngularVelocityAttr(Gf.Vec3f(0.0, 0.0, 180.0))
    UsdPhysics.MassAPI.Apply(xform.GetPrim()).CreateMassAttr(0.2)
    sphere = UsdGeom.Sphere.Define(stage, "/ball/shape")
    sphere.CreateRadiusAttr(3.0)
    UsdPhysics.CollisionAPI.Apply(sphere.GetPrim()).CreateCollisionEnabledAttr(False)
    stage.Export(str(tmp_path / "foreign.usda"))
    return from_usd(tmp_path / "foreign.usda").body("ball")


def test_a_velocity_of_another_tool_is_in_its_units_and_axes(tmp_path: Path) -> None:
    body = foreign(tmp_path, up="Y", metres=0.01, edit=lambda _: None)
    # Centimetres, degrees, and y up: z of the stage is -y of the world.
    assert body.linear_velocity_m_per_s == pytest.approx((1.0, 0.0, 0.0))
    assert body.angular_velocity_rad_per_s == pytest.approx((0.0, -math.pi, 0.0))


def test_a_velocity_turns_with_the_body(tmp_path: Path) -> None:
    body = foreign(
        tmp_path, up="Z", metres=1.0, edit=lambda xform: xform.AddRotateZOp().Set(90.0)
    )
    assert body.linear_velocity_m_per_s == pytest.approx((0.0, 100.0, 0.0))
    assert body.angular_velocity_rad_per_s == pytest.approx((0.0, 0.0, math.pi))


def test_a_collider_off_the_origin_moves_with_the_body(tmp_path: Path) -> None:
    """The body frame moves to the centre of a single sphere, which is its centre of mass."""

    def edit(xform: UsdGeom.Xform) -> None:
        xform.GetPrim().GetStage().DefinePrim("/ball/shape", "Sphere")
        UsdGeom.Xformable(
            xform.GetPrim().GetStage().GetPrimAtPath("/ball/shape")
        ).AddTranslateOp().Set((0.0, 1.0, 0.0))

    body = foreign(tmp_path, up="Z", metres=1.0, edit=edit)
    assert body.pose.position_m == pytest.approx((0.0, 1.0, 0.0))
    assert body.linear_velocity_m_per_s == pytest.approx((100.0, 0.0, 0.0))


def test_a_hinged_body_keeps_its_velocity(tmp_path: Path) -> None:
    hinge = Hinge(body="bob", anchor_m=(0.2, 0.1, 1.3), axis=(0.0, 1.0, 0.0))
    bob = replace(
        THROWN,
        name="bob",
        shape=Sphere(radius_m=0.03),
        linear_velocity_m_per_s=(-0.6, 0.0, 0.0),
        angular_velocity_rad_per_s=(0.0, 2.0, 0.0),
    )
    scene = Scene(bodies=(bob,), joints=(hinge,), duration_s=0.5)
    to_usd(scene, tmp_path / "a.usda")
    found = from_usd(tmp_path / "a.usda")
    assert found.bodies[0].linear_velocity_m_per_s == bob.linear_velocity_m_per_s
    assert found.bodies[0].angular_velocity_rad_per_s == bob.angular_velocity_rad_per_s
