"""Friction, armature and motors of hinges in USD layers: exact return, edits, foreign stages, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from pxr import Sdf, Usd, UsdGeom, UsdPhysics

from gauge_envs import load_experiment
from gauge_envs.errors import AssetError
from gauge_envs.scene import BodyHinge, Hinge, JointDynamics
from gauge_envs.scene.motors import Motor, Servo, TorqueMotor
from gauge_envs.scene.profiles import CosineProfile, SampledProfile
from gauge_envs.scene.scene import Scene
from gauge_envs.tools.usd.reader import read_usd
from gauge_envs.tools.usd.writer import scene_stage, to_usd

COMMAND = CosineProfile(start_s=0.1, duration_s=0.3, amount=0.7)
SAMPLED = SampledProfile(times_s=(0.0, 0.1, 0.3), values=(0.1, 0.2, -0.3))
SERVO = Servo(
    command=COMMAND,
    kp_n_m_per_rad=8.1,
    kv_n_m_s_per_rad=0.13,
    torque_limit_n_m=1.7,
    delay_s=0.02,
)
DYNAMICS = JointDynamics(
    dry_friction_n_m=0.0103,
    viscous_friction_n_m_s_per_rad=0.021,
    armature_kg_m2=0.0017,
    backlash_rad=0.01,
)


def chain(dynamics: JointDynamics = DYNAMICS, motor: Motor | None = SERVO) -> Scene:
    """Return two blocks on a hinge to the world, whose two joints have terms."""
    scene = load_experiment(
        "ElbowToss-blocks", {"first.position_m": (0.0, 0.0, 0.15)}
    ).scene
    (elbow,) = scene.body_hinges
    shoulder = Hinge(
        body="first", anchor_m=(0.0, 0.0, 0.2), axis=(0.0, 1.0, 0.0), dynamics=dynamics
    )
    return replace(
        scene, joints=(shoulder,), body_hinges=(replace(elbow, motor=motor),)
    )


def edited(
    scene: Scene, folder: Path, edit: Callable[[Usd.Prim, Usd.Prim], object]
) -> list[Hinge | BodyHinge]:
    """Return the hinges of the scene's layer after an edit of its shoulder and elbow joints."""
    path = folder / "chain.usda"
    to_usd(scene, path)
    stage = Usd.Stage.Open(str(path))
    edit(
        *(
            stage.GetPrimAtPath(f"/World/Joints/{name}_0")
            for name in ("joint", "body_hinge")
        )
    )
    stage.Save()
    return read_usd(path).scene.hinges


NUMBER = st.one_of(st.just(0.0), st.floats(1e-9, 1e6))
GAIN = st.floats(1e-9, 1e6)
PROFILES = st.sampled_from([COMMAND, SAMPLED])
SERVOS = st.builds(
    Servo,
    command=PROFILES,
    kp_n_m_per_rad=GAIN,
    kv_n_m_s_per_rad=NUMBER,
    torque_limit_n_m=st.none() | GAIN,
    delay_s=NUMBER,
)
MOTORS = st.none() | SERVOS | st.builds(TorqueMotor, command=PROFILES, delay_s=NUMBER)
FRICTION = {"dry_friction_n_m": NUMBER, "viscous_friction_n_m_s_per_rad": NUMBER}
TERMS = st.builds(JointDynamics, **FRICTION, armature_kg_m2=NUMBER) | st.builds(
    JointDynamics, **FRICTION, armature_kg_m2=GAIN, backlash_rad=NUMBER
)


@settings(
    max_examples=15,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(dynamics=TERMS, motor=MOTORS)
def test_a_layer_returns_the_terms_exactly(
    dynamics: JointDynamics, motor: Motor | None, tmp_path: Path
) -> None:
    scene = chain(dynamics, motor)
    to_usd(scene, tmp_path / "chain.usdc")
    assert read_usd(tmp_path / "chain.usdc").scene == scene


def test_an_axis_of_as_many_digits_as_files_state_returns_exactly(
    tmp_path: Path,
) -> None:
    scene = chain()
    axis = (0.0, 1.0 - 5e-10, 0.0)
    joints, hinges = (
        [replace(one, axis=axis) for one in group]
        for group in (scene.joints, scene.body_hinges)
    )
    scene = replace(scene, joints=tuple(joints), body_hinges=tuple(hinges))
    to_usd(scene, tmp_path / "chain.usda")
    assert read_usd(tmp_path / "chain.usda").scene == scene


def test_standard_attributes_are_in_their_units() -> None:
    stage = scene_stage(chain())
    shoulder, elbow = (
        stage.GetPrimAtPath(f"/World/Joints/{name}_0")
        for name in ("joint", "body_hinge")
    )
    assert shoulder.GetAttribute("mjc:frictionloss").Get() == 0.0103
    assert shoulder.GetAttribute("mjc:damping").Get() == 0.021
    assert shoulder.GetAttribute("physxJoint:armature").Get() == pytest.approx(0.0017)
    drive = UsdPhysics.DriveAPI(elbow, "angular")
    assert drive.GetStiffnessAttr().Get() == pytest.approx(8.1 * math.pi / 180.0)
    assert drive.GetDampingAttr().Get() == pytest.approx(0.13 * math.pi / 180.0)
    assert drive.GetMaxForceAttr().Get() == pytest.approx(1.7)
    assert shoulder.GetMetadata("apiSchemas").GetAppliedItems() == [
        "MjcJointAPI",
        "PhysxJointAPI",
    ]


def author(
    side: int, name: str, value: float
) -> Callable[[Usd.Prim, Usd.Prim], object]:
    return lambda *joints: joints[side].GetAttribute(name).Set(value)


@pytest.mark.parametrize(
    ("side", "name", "value", "field", "expected"),
    [
        (0, "mjc:frictionloss", 0.5, "dry_friction_n_m", 0.5),
        (0, "mjc:damping", 0.25, "viscous_friction_n_m_s_per_rad", 0.25),
        (0, "mjc:armature", 0.75, "armature_kg_m2", 0.75),
        (0, "physxJoint:armature", 0.75, "armature_kg_m2", 0.75),
        (1, "gauge:kp_n_m_per_rad", 9.0, "kp_n_m_per_rad", 9.0),
        (1, "drive:angular:physics:stiffness", 0.5, "kp_n_m_per_rad", 90.0 / math.pi),
        (1, "drive:angular:physics:damping", 0.5, "kv_n_m_s_per_rad", 90.0 / math.pi),
        (1, "drive:angular:physics:maxForce", 2.5, "torque_limit_n_m", 2.5),
        (1, "gauge:delay_s", 0.5, "delay_s", 0.5),
    ],
)
def test_the_edited_value_counts(
    side: int, name: str, value: float, field: str, expected: float, tmp_path: Path
) -> None:
    before = chain().hinges[side]
    after = edited(chain(), tmp_path, author(side, name, value))[side]
    whole = (
        replace(before, dynamics=replace(DYNAMICS, **{field: expected}))
        if side == 0
        else None
    )
    assert after == (
        whole
        or replace(
            before, motor=replace(SERVO, **{field: pytest.approx(expected, rel=1e-15)})
        )
    )


@pytest.mark.parametrize(
    ("side", "name", "value", "reason"),
    [
        (0, "mjc:frictionloss", -0.5, "dynamics.dry_friction_n_m: "),
        (1, "gauge:kp_n_m_per_rad", -1.0, "motor.servo.kp_n_m_per_rad: "),
        (1, "gauge:motor", "stepper", "motor: "),
        (1, "gauge:motor", "torque", "kp_n_m_per_rad"),
        (1, "gauge:command", "{", "gauge:command: is not JSON"),
        (
            1,
            "gauge:command",
            '{"kind": "sampled", "times_s": [0, 1], "values": [0, NaN]}',
            "values.1: .*given: nan",
        ),
        (
            1,
            "drive:angular:physics:targetPosition",
            20.0,
            "it follows from gauge:command",
        ),
        (1, "drive:angular:physics:type", "acceleration", "force is expected"),
    ],
)
def test_a_wrong_edit_is_refused(
    side: int, name: str, value: float | str, reason: str, tmp_path: Path
) -> None:
    def edit(*joints: Usd.Prim) -> None:
        kind = Sdf.ValueTypeNames.Token
        (
            joints[side].GetAttribute(name) or joints[side].CreateAttribute(name, kind)
        ).Set(value)

    with pytest.raises(AssetError, match=reason):
        edited(chain(), tmp_path, edit)


def foreign(
    folder: Path,
    build: Callable[[UsdPhysics.RevoluteJoint], object],
    *,
    flipped: bool = False,
) -> Hinge:
    """Return the hinge of a stage of another tool, in centimetres, with a bar on a revolute joint about y."""
    path = folder / "bar.usda"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdPhysics.Scene.Define(stage, "/physics")
    bar = UsdGeom.Cube.Define(stage, "/bar")
    for api in (UsdPhysics.RigidBodyAPI, UsdPhysics.CollisionAPI):
        api.Apply(bar.GetPrim())
    UsdPhysics.MassAPI.Apply(bar.GetPrim()).CreateMassAttr(1.0)
    joint = UsdPhysics.RevoluteJoint.Define(stage, "/joint")
    joint.CreateAxisAttr("Y")
    (joint.CreateBody0Rel() if flipped else joint.CreateBody1Rel()).SetTargets(["/bar"])
    build(joint)
    stage.Save()
    (hinge,) = read_usd(path, duration_s=1.0).scene.hinges
    assert isinstance(hinge, Hinge)
    return hinge


@pytest.mark.parametrize("flipped", [False, True])
def test_a_drive_of_another_tool_is_a_servo_that_holds_its_target(
    flipped: bool, tmp_path: Path
) -> None:
    def build(joint: UsdPhysics.RevoluteJoint) -> None:
        drive = UsdPhysics.DriveAPI.Apply(joint.GetPrim(), "angular")
        drive.CreateStiffnessAttr(1000.0)
        drive.CreateDampingAttr(10.0)
        drive.CreateTargetPositionAttr(30.0)
        joint.GetPrim().CreateAttribute(
            "mjc:frictionloss", Sdf.ValueTypeNames.Double
        ).Set(100.0)
        joint.GetPrim().CreateAttribute(
            "physxJoint:armature", Sdf.ValueTypeNames.Float
        ).Set(20.0)

    hinge = foreign(tmp_path, build, flipped=flipped)
    # A torque of kg cm^2/s^2 is 1e-4 N m, and gains are per degree.
    assert hinge.dynamics == JointDynamics(
        dry_friction_n_m=pytest.approx(0.01), armature_kg_m2=pytest.approx(0.002)
    )
    assert isinstance(hinge.motor, Servo)
    assert hinge.motor.kp_n_m_per_rad == pytest.approx(0.1 * 180.0 / math.pi)
    assert hinge.motor.kv_n_m_s_per_rad == pytest.approx(1e-3 * 180.0 / math.pi)
    assert hinge.motor.torque_limit_n_m is None
    assert hinge.motor.command.value(0.5) == pytest.approx(
        (-1.0 if flipped else 1.0) * math.pi / 6.0
    )


@pytest.mark.parametrize(
    "name",
    [
        "physxJoint:jointFriction",
        "mjc:stiffness",
        "drive:angular:physics:targetVelocity",
    ],
)
def test_terms_with_another_meaning_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(AssetError, match=f"{name}: unsupported joint: it is 0.5"):
        foreign(
            tmp_path,
            lambda joint: (
                joint.GetPrim()
                .CreateAttribute(name, Sdf.ValueTypeNames.Double)
                .Set(0.5)
            ),
        )


def test_a_drive_without_stiffness_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="kp_n_m_per_rad: missing key"):
        foreign(
            tmp_path,
            lambda joint: UsdPhysics.DriveAPI.Apply(joint.GetPrim(), "angular"),
        )
