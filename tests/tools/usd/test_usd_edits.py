"""What is edited in a USD file counts, wherever it stands; and what is not edited stays as it is, to the bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.errors import AssetError
from gauge_envs.scene import (
    Box,
    ConvexUnion,
    Cylinder,
    Motion,
    Pose,
    RigidBody,
    Scene,
    Sphere,
    Tether,
)
from gauge_envs.scene.geometry import pose_distance
from gauge_envs.scene.profiles import SampledProfile
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.usd.reader import from_usd, read_usd
from gauge_envs.tools.usd.writer import to_usd

Edit = Callable[[Usd.Stage], None]


def edited(name: str, tmp_path: Path, edit: Edit) -> Scene:
    """The scene of a variant's layer after an edit, as a USD tool would save it."""
    stage = Usd.Stage.Open(str(assets_folder() / "usd" / f"{name}.usda"))
    copy = Usd.Stage.CreateInMemory()
    copy.GetRootLayer().TransferContent(stage.GetRootLayer())
    edit(copy)
    file = tmp_path / "edited.usda"
    copy.GetRootLayer().Export(str(file))
    return from_usd(file)


def original(name: str) -> Scene:
    return load_experiment(name).scene


def setting(path: str, attribute: str, value: Any) -> Edit:
    def edit(stage: Usd.Stage) -> None:
        found = stage.GetPrimAtPath(path).GetAttribute(attribute)
        assert found.HasAuthoredValue(), f"{path}.{attribute}"
        found.Set(value)

    return edit


def both(*edits: Edit) -> Edit:
    def edit(stage: Usd.Stage) -> None:
        for one in edits:
            one(stage)

    return edit


def with_body(scene: Scene, name: str, **changes: Any) -> Scene:
    return replace(
        scene,
        bodies=tuple(
            replace(body, **changes) if body.name == name else body
            for body in scene.bodies
        ),
    )


def with_contact(scene: Scene, index: int, **changes: Any) -> Scene:
    contacts = list(scene.contacts)
    contacts[index] = replace(contacts[index], **changes)
    return replace(scene, contacts=tuple(contacts))


def with_deformable(scene: Scene, index: int, **changes: Any) -> Scene:
    deformables = list(scene.deformables)
    deformables[index] = replace(deformables[index], **changes)
    return replace(scene, deformables=tuple(deformables))


SLIDER, TABLE, BALL, PENDULUM = (
    "SlopeSlider-2-wood",
    "Turntable-1-wood",
    "BouncingBall-rubber",
    "Pendulum-metal",
)
CLOTH, FOAM, CRADLE, TWIST = (
    "TextileBending-rayon",
    "FoamTwisting-soft",
    "NewtonsCradle-metal",
    "FoamTwisting-soft",
)
MATERIAL = "/World/Materials/contact_0"

# name, edit, what the scene is then; single precision counts as the decimal that was typed.
COUNTED = {
    "mass, standard": (
        SLIDER,
        setting("/World/cube", "physics:mass", 0.25),
        lambda s: with_body(s, "cube", mass_kg=0.25),
    ),
    "mass, double": (
        SLIDER,
        setting("/World/cube", "gauge:mass_kg", 0.123456789012),
        lambda s: with_body(s, "cube", mass_kg=0.123456789012),
    ),
    "mass, both": (
        SLIDER,
        both(
            setting("/World/cube", "gauge:mass_kg", 0.123456789012),
            setting("/World/cube", "physics:mass", 0.123456789012),
        ),
        lambda s: with_body(s, "cube", mass_kg=0.123456789012),
    ),
    "friction, double": (
        SLIDER,
        setting("/World/Contacts/contact_0", "gauge:friction", 0.1),
        lambda s: with_contact(s, 0, friction=0.1),
    ),
    "friction, dynamic": (
        SLIDER,
        setting(MATERIAL, "physics:dynamicFriction", 0.1),
        lambda s: with_contact(s, 0, friction=0.1),
    ),
    "friction, static": (
        SLIDER,
        setting(MATERIAL, "physics:staticFriction", 0.1),
        lambda s: with_contact(s, 0, friction=0.1),
    ),
    "restitution": (
        BALL,
        setting(MATERIAL, "physics:restitution", 0.75),
        lambda s: with_contact(s, 0, restitution=0.75),
    ),
    "gravity, standard": (
        SLIDER,
        setting("/World/PhysicsScene", "physics:gravityMagnitude", 1.62),
        lambda s: replace(s, gravity_m_per_s2=1.62),
    ),
    "gravity, double": (
        SLIDER,
        setting("/World/PhysicsScene", "gauge:gravity_m_per_s2", 1.62),
        lambda s: replace(s, gravity_m_per_s2=1.62),
    ),
    "duration": (
        SLIDER,
        lambda stage: stage.SetEndTimeCode(30),
        lambda s: replace(s, duration_s=1.0),
    ),
    "pose": (
        BALL,
        setting("/World/ball", "xformOp:translate", Gf.Vec3d(0.1, 0.2, 0.9)),
        lambda s: with_body(
            s, "ball", pose=replace(s.body("ball").pose, position_m=(0.1, 0.2, 0.9))
        ),
    ),
    "radius": (
        BALL,
        setting("/World/ball/collision", "radius", 0.04),
        lambda s: with_body(s, "ball", shape=Sphere(radius_m=0.04)),
    ),
    "box": (
        SLIDER,
        setting("/World/cube/collision", "xformOp:scale", Gf.Vec3d(0.05, 0.06, 0.07)),
        lambda s: with_body(s, "cube", shape=Box(size_m=(0.05, 0.06, 0.07))),
    ),
    "cylinder": (
        TABLE,
        setting("/World/plate/collision", "height", 0.03),
        lambda s: with_body(s, "plate", shape=Cylinder(radius_m=0.15, length_m=0.03)),
    ),
    "anchor": (
        CRADLE,
        setting(
            "/World/Joints/joint_1", "physics:localPos0", Gf.Vec3f(0.5, 0.25, 0.75)
        ),
        lambda s: replace(
            s,
            joints=(
                s.joints[0],
                replace(s.joints[1], anchor_m=(0.5, 0.25, 0.75)),
                *s.joints[2:],
            ),
        ),
    ),
    "motion": (
        TABLE,
        setting("/World/cube", "physics:kinematicEnabled", True),
        lambda s: with_body(s, "cube", motion=Motion.KINEMATIC),
    ),
    "stiffness of a cloth": (
        CLOTH,
        setting("/World/textile", "gauge:bend_stiffness_n_m_per_rad", 1e-4),
        lambda s: with_deformable(s, 0, bend_stiffness_n_m_per_rad=1e-4),
    ),
    "mass of a cloth": (
        CLOTH,
        setting("/World/textile", "omniphysics:mass", 0.5),
        lambda s: with_deformable(s, 0, mass_kg=0.5),
    ),
    "thickness of a cloth": (
        CLOTH,
        setting("/World/Materials/body_textile", "omniphysics:surfaceThickness", 0.002),
        lambda s: with_deformable(s, 0, thickness_m=0.002),
    ),
    "modulus of a foam": (
        FOAM,
        setting("/World/Materials/body_foam", "omniphysics:youngsModulus", 12345.0),
        lambda s: with_deformable(s, 0, young_modulus_pa=12345.0),
    ),
    "Poisson ratio of a foam": (
        FOAM,
        setting("/World/Materials/body_foam", "omniphysics:poissonsRatio", 0.25),
        lambda s: with_deformable(s, 0, poisson_ratio=0.25),
    ),
    "radius of a rod": (
        "StickStack-soft",
        setting("/World/rod", "widths", Vt.FloatArray([0.25])),
        lambda s: with_deformable(s, 0, radius_m=0.125),
    ),
    "a marker": (
        CLOTH,
        lambda stage: shift_point(stage, "/World/Markers", 3, (0.5, 0.25, 0.125)),
        lambda s: replace(s, markers=with_marker(s.markers, 3, (0.5, 0.25, 0.125))),
    ),
}


def shift_point(
    stage: Usd.Stage, path: str, index: int, position: tuple[float, float, float]
) -> None:
    attribute = UsdGeom.PointBased(stage.GetPrimAtPath(path)).GetPointsAttr()
    points = list(attribute.Get())
    points[index] = Gf.Vec3f(*position)
    attribute.Set(points)


def with_marker(markers: Any, index: int, position: tuple[float, float, float]) -> Any:
    positions = list(markers.positions_m)
    positions[index] = position
    return replace(markers, positions_m=tuple(positions))


@pytest.mark.parametrize("case", COUNTED)
def test_the_edited_value_counts_and_no_other_changes(
    case: str, tmp_path: Path
) -> None:
    name, edit, change = COUNTED[case]
    expected = change(original(name))
    assert expected != original(name)
    assert edited(name, tmp_path, edit) == expected


@pytest.mark.parametrize(
    ("path", "attribute"),
    [
        ("/World/cube", "gauge:mass_kg"),
        ("/World/Contacts/contact_0", "gauge:friction"),
        ("/World/PhysicsScene", "gauge:duration_s"),
        ("/World/PhysicsScene", "gauge:gravity_m_per_s2"),
    ],
)
def test_without_the_double_the_standard_value_counts(
    path: str, attribute: str, tmp_path: Path
) -> None:
    # All of these have so few digits that single precision, read as a decimal, has them too.
    scene = edited(
        SLIDER,
        tmp_path,
        lambda stage: stage.GetPrimAtPath(path).RemoveProperty(attribute),
    )
    assert scene == original(SLIDER)


def test_a_string_has_the_length_that_was_edited(tmp_path: Path) -> None:
    ball = RigidBody(
        name="ball",
        shape=Sphere(radius_m=0.1),
        motion=Motion.DYNAMIC,
        pose=Pose(position_m=(0.0, 0.0, 1.0)),
        mass_kg=1.0,
    )
    tether = Tether(body="ball", anchor_m=(0.0, 0.1, 1.7), length_m=1 / 3)
    scene = Scene(bodies=(ball,), joints=(tether,), duration_s=1.0)
    to_usd(scene, tmp_path / "a.usda")
    for attribute in ("physics:maxDistance", "gauge:length_m"):
        stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
        setting("/World/Joints/joint_0", attribute, 0.75)(stage)
        stage.Export(str(tmp_path / "b.usda"))
        del stage
        expected = replace(scene, joints=(replace(tether, length_m=0.75),))
        assert from_usd(tmp_path / "b.usda") == expected


def test_a_vertex_of_a_mesh_moves_and_the_others_keep_every_digit(
    tmp_path: Path,
) -> None:
    name = "Funnel-rayon"
    before = original(name)
    body = next(body for body in before.bodies if isinstance(body.shape, ConvexUnion))
    moved = tuple(
        float(x) for x in np.float32(1.01) * np.float32(body.shape.pieces_m[2][1])
    )
    after = edited(
        name,
        tmp_path,
        lambda stage: shift_point(stage, f"/World/{body.name}/collision_2", 1, moved),
    )
    found = after.body(body.name).shape
    for index, (piece, was) in enumerate(
        zip(found.pieces_m, body.shape.pieces_m, strict=True)
    ):
        for vertex, (point, old) in enumerate(zip(piece, was, strict=True)):
            if (index, vertex) == (2, 1):
                np.testing.assert_allclose(point, moved, rtol=1e-6)
                assert point != old
            else:
                assert point == old


def test_a_hinge_turned_in_the_joint_frame_turns(tmp_path: Path) -> None:
    turn = Rotation.from_euler("xyz", [10.0, 20.0, 80.0], degrees=True)
    w, x, y, z = turn.as_quat(scalar_first=True)
    (hinge,) = edited(
        PENDULUM,
        tmp_path,
        both(
            setting("/World/Joints/joint_0", "physics:localRot0", Gf.Quatf(w, x, y, z)),
            setting("/World/Joints/joint_0", "gauge:axis", Gf.Vec3d(0.0, 1.0, 0.0)),
        ),
    ).joints
    np.testing.assert_allclose(hinge.axis, turn.apply([1.0, 0.0, 0.0]), atol=1e-6)
    assert np.linalg.norm(hinge.axis) == pytest.approx(1.0, abs=1e-15)
    edit = setting("/World/Joints/joint_0", "gauge:axis", Gf.Vec3d(1.0, 0.0, 0.0))
    (double,) = edited(PENDULUM, tmp_path, edit).joints
    assert double == replace(original(PENDULUM).joints[0], axis=(1.0, 0.0, 0.0))


def test_a_pendulum_that_is_moved_keeps_its_anchor(tmp_path: Path) -> None:
    scene = edited(
        PENDULUM,
        tmp_path,
        setting("/World/ball", "xformOp:translate", Gf.Vec3d(0.2, 0.49, 0.3)),
    )
    assert scene.body("ball").pose.position_m == (0.2, 0.49, 0.3)
    assert scene.joints == original(PENDULUM).joints


def test_a_world_that_is_moved_moves_its_bodies(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        UsdGeom.Xformable(stage.GetPrimAtPath("/World")).AddTranslateOp().Set(
            Gf.Vec3d(1.0, 0.0, 0.0)
        )

    scene, before = edited(SLIDER, tmp_path, edit), original(SLIDER)
    for body in before.bodies:
        shifted = np.add(body.pose.position_m, [1.0, 0.0, 0.0])
        np.testing.assert_allclose(
            scene.body(body.name).pose.position_m, shifted, atol=1e-15
        )
    assert scene.contacts == before.contacts


# --- drivers ---------------------------------------------------------------------------------------------------------


def orient(
    stage: Usd.Stage, path: str, turn: Callable[[float], Rotation], frames: range
) -> None:
    attribute = stage.GetPrimAtPath(path).GetAttribute("xformOp:orient")
    for frame in frames:
        w, x, y, z = turn(frame / FRAME_RATE_HZ).as_quat(scalar_first=True)
        attribute.Set(Gf.Quatd(w, x, y, z), frame)


def turning(turn: Callable[[float], Rotation]) -> Edit:
    """Sets every sample of the turntable's orientation."""
    return lambda stage: orient(stage, "/World/plate", turn, range(95))


def test_samples_that_stay_on_the_axis_keep_it_and_its_action(tmp_path: Path) -> None:
    before = original(TABLE)
    scene = edited(
        TABLE, tmp_path, turning(lambda t: Rotation.from_rotvec([0, 0, 2.0 * t * t]))
    )
    (driver,), (was,) = scene.drivers, before.drivers
    (motion,), (old,) = driver.motions, was.motions
    assert replace(motion, profiles=old.profiles) == old
    assert isinstance(motion.profiles[0], SampledProfile)
    for frame in range(95):
        assert motion.value(frame / FRAME_RATE_HZ) == pytest.approx(
            2.0 * (frame / FRAME_RATE_HZ) ** 2, abs=1e-9
        )
    assert scene.bodies == before.bodies
    assert driver.provenance.startswith("nominal: edited in edited.usda")


def test_one_sample_that_is_edited_leaves_the_others(tmp_path: Path) -> None:
    name, index = "TextileFlinging-rayon", 20
    before = original(name)
    (was,) = before.drivers
    start = before.body(was.body).pose
    high = np.add(was.pose(start, index / FRAME_RATE_HZ).position_m, [0.0, 0.01, 0.02])

    def edit(stage: Usd.Stage) -> None:
        stage.GetPrimAtPath(f"/World/{was.body}").GetAttribute("xformOp:translate").Set(
            Gf.Vec3d(*high.tolist()), index
        )

    (driver,) = edited(name, tmp_path, edit).drivers
    for frame in range(round(before.duration_s * FRAME_RATE_HZ) + 1):
        expected = was.pose(start, frame / FRAME_RATE_HZ)
        if frame == index:
            expected = replace(expected, position_m=tuple(high.tolist()))
        assert pose_distance(driver.pose(start, frame / FRAME_RATE_HZ), expected) < 1e-9
    kept = [motion for motion in driver.motions if motion.axis == was.motions[0].axis]
    assert [motion.residual_rate for motion in kept] == [was.motions[0].residual_rate]
    assert "video" in driver.provenance
    assert driver.provenance.startswith("nominal")


def test_general_samples_are_reproduced(tmp_path: Path) -> None:
    def tumble(time_s: float) -> Rotation:
        return Rotation.from_euler("xyz", [time_s, 0.3 * time_s, np.sin(time_s)])

    scene = edited(TABLE, tmp_path, turning(tumble))
    (driver,) = scene.drivers
    start = scene.body("plate").pose
    for frame in range(95):
        w, x, y, z = (tumble(frame / FRAME_RATE_HZ)).as_quat(scalar_first=True).tolist()
        expected = Pose(position_m=start.position_m, quaternion=(w, x, y, z))
        assert pose_distance(driver.pose(start, frame / FRAME_RATE_HZ), expected) < 1e-9
    assert [
        m.residual_rate
        for m in driver.motions
        if m.axis == (0.0, 0.0, 1.0) and m.kind == "rotate"
    ] == [original(TABLE).drivers[0].motions[0].residual_rate]


def test_a_quarter_turn_about_each_axis_in_turn_is_an_error(tmp_path: Path) -> None:
    def tumble(time_s: float) -> Rotation:
        third, phase = divmod(round(time_s * FRAME_RATE_HZ), 32)
        return Rotation.from_rotvec(
            0.5 * np.pi * np.sin(np.pi * phase / 32) ** 2 * np.eye(3)[third]
        )

    with pytest.raises(
        AssetError,
        match=r"/World/plate: the time samples of its transform: no three successive rotations",
    ):
        edited(TABLE, tmp_path, turning(tumble))


def test_the_exact_motion_can_be_edited_in_its_json(tmp_path: Path) -> None:
    before = original(TABLE)
    attribute = "gauge:driver"

    def edit(stage: Usd.Stage) -> None:
        found = stage.GetPrimAtPath("/World/plate").GetAttribute(attribute)
        found.Set(
            found.Get().replace(
                repr(before.drivers[0].motions[0].profiles[0].amount), "1.5"
            )
        )

    (driver,) = edited(TABLE, tmp_path, edit).drivers
    assert driver.motions[0].profiles[0].amount == 1.5
    assert driver.provenance == "nominal: edited in edited.usda, was nominal"


def test_a_driven_body_that_moves_with_its_samples_turns_about_its_new_place(
    tmp_path: Path,
) -> None:
    moved = Gf.Vec3d(0.5, 0.5, 0.178902)
    turn = turning(lambda t: Rotation.from_rotvec([0, 0, t]))
    scene = edited(
        TABLE, tmp_path, both(setting("/World/plate", "xformOp:translate", moved), turn)
    )
    (driver,) = scene.drivers
    (motion,) = driver.motions
    np.testing.assert_allclose(motion.point_m[:2], (0.5, 0.5), atol=1e-9)
    assert motion.residual_rate == original(TABLE).drivers[0].motions[0].residual_rate
    assert scene.body("plate").pose.position_m == tuple(moved)


def test_without_samples_the_exact_motion_counts(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        attribute = stage.GetPrimAtPath("/World/plate").GetAttribute("xformOp:orient")
        for time in attribute.GetTimeSamples():
            attribute.ClearAtTime(time)

    assert edited(TABLE, tmp_path, edit) == original(TABLE)


# --- contacts --------------------------------------------------------------------------------------------------------


def pairs(scene: Scene) -> set[frozenset[str]]:
    return {
        frozenset(pair)
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    }


def test_a_collider_that_is_disabled_collides_no_more(tmp_path: Path) -> None:
    scene = edited(
        TABLE,
        tmp_path,
        setting("/World/ground/collision", "physics:collisionEnabled", False),
    )
    assert scene.contacts == original(TABLE).contacts[:1]
    assert scene.bodies == original(TABLE).bodies


def test_a_pair_that_is_filtered_is_taken_out_of_its_group(tmp_path: Path) -> None:
    name = "NonsmoothContact-1-wood"
    before = original(name)
    contact = before.contacts[0]
    one, other = next(iter(before.colliding_pairs(contact)))

    def edit(stage: Usd.Stage) -> None:
        pairs = UsdPhysics.FilteredPairsAPI.Apply(stage.GetPrimAtPath(f"/World/{one}"))
        pairs.CreateFilteredPairsRel().AddTarget(f"/World/{other}")

    scene = edited(name, tmp_path, edit)
    assert pairs(scene) == pairs(before) - {frozenset((one, other))}


def test_balls_of_a_cradle_that_pass_each_other_leave_one_chain(tmp_path: Path) -> None:
    before = original(CRADLE)
    balls = [body.name for body in before.dynamic_bodies]
    one, other = balls[0], balls[-1]
    paths = read_usd(assets_folder() / "usd" / f"{CRADLE}.usda").paths
    assert before.has_impact_chain

    def edit(stage: Usd.Stage) -> None:
        filtered = UsdPhysics.FilteredPairsAPI.Apply(stage.GetPrimAtPath(paths[one]))
        filtered.CreateFilteredPairsRel().AddTarget(paths[other])

    scene = edited(CRADLE, tmp_path, edit)
    listed = [
        frozenset(pair)
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    ]
    assert sorted(map(sorted, listed)) == sorted(
        map(sorted, pairs(before) - {frozenset((one, other))})
    )
    assert scene.has_impact_chain


def test_a_pair_that_is_added_to_a_contact_counts_though_it_is_filtered(
    tmp_path: Path,
) -> None:
    name = "StickStack-soft"

    def edit(stage: Usd.Stage) -> None:
        stage.GetPrimAtPath("/World/Contacts/contact_0").GetRelationship(
            "gauge:second"
        ).AddTarget("/World/ground")

    before = original(name)
    assert edited(name, tmp_path, edit) == with_contact(
        before, 0, second=(*before.contacts[0].second, "ground")
    )


def test_a_body_that_is_added_collides_by_its_material(tmp_path: Path) -> None:
    before = original(SLIDER)

    def edit(stage: Usd.Stage) -> None:
        crate = UsdGeom.Cube.Define(stage, "/World/crate")
        crate.CreateSizeAttr(0.1)
        crate.AddTranslateOp().Set(Gf.Vec3d(1.0, 0.0, 0.5))
        for api in (UsdPhysics.RigidBodyAPI, UsdPhysics.CollisionAPI):
            api.Apply(crate.GetPrim())
        UsdPhysics.MassAPI.Apply(crate.GetPrim()).CreateMassAttr(2.0)
        material = UsdShade.Material(stage.GetPrimAtPath(MATERIAL))
        binding = UsdShade.MaterialBindingAPI.Apply(crate.GetPrim())
        binding.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")

    scene = edited(SLIDER, tmp_path, edit)
    assert scene.body("crate").shape == Box(size_m=(0.1, 0.1, 0.1))
    assert scene.body("crate").mass_kg == 2.0
    assert scene.contacts[: len(before.contacts)] == before.contacts
    added = pairs(replace(scene, contacts=scene.contacts[len(before.contacts) :]))
    assert added == {frozenset(("crate", name)) for name in ("cube", "board", "ground")}


# --- edits that cannot count -----------------------------------------------------------------------------------------

DECLINED = {
    "both edited": (
        SLIDER,
        both(
            setting("/World/cube", "gauge:mass_kg", 0.3),
            setting("/World/cube", "physics:mass", 0.2),
        ),
        r"/World/cube.gauge:mass_kg: is 0.3 but /World/cube.physics:mass is 0.2",
    ),
    "static and dynamic": (
        SLIDER,
        both(
            setting(MATERIAL, "physics:staticFriction", 0.3),
            setting(MATERIAL, "physics:dynamicFriction", 0.2),
        ),
        r"staticFriction: is 0.3 but .*dynamicFriction is 0.2: make them agree",
    ),
    "pose of a driven body alone": (
        "TextileFlinging-rayon",
        setting("/World/rod", "xformOp:translate", Gf.Vec3d(0.0, 0.0, 0.5)),
        r"/World/rod: its pose was edited, but not the time samples of its transform",
    ),
    "points of a cloth": (
        CLOTH,
        lambda stage: shift_point(stage, "/World/textile", 0, (9.0, 9.0, 9.0)),
        r"/World/textile.points: was edited, but it follows from gauge:size_m",
    ),
    "density of a cloth": (
        CLOTH,
        setting("/World/Materials/body_textile", "omniphysics:density", 1.0),
        r"omniphysics:density: was edited, but it follows from gauge:areal_density",
    ),
    "constants for Isaac": (
        CLOTH,
        setting("/World/Materials/body_textile", "omniphysics:youngsModulus", 1.0),
        r"youngsModulus: was edited, but it follows from gauge:stretch_",
    ),
    "attached vertices": (
        CLOTH,
        setting(
            "/World/Attachments/attachment_0",
            "omniphysics:vtxIndicesSrc0",
            Vt.IntArray([0]),
        ),
        r"vtxIndicesSrc0: was edited, but it follows from gauge:region_axis",
    ),
    "half of a hinge": (
        PENDULUM,
        setting("/World/Joints/joint_0", "physics:localPos1", Gf.Vec3f(0.0, 0.0, 0.5)),
        r"/World/Joints/joint_0: its two frames lie",
    ),
    "another material": (
        SLIDER,
        lambda stage: UsdShade.MaterialBindingAPI(
            stage.GetPrimAtPath("/World/cube")
        ).Bind(ice(stage), UsdShade.Tokens.weakerThanDescendants, "physics"),
        r"/World/cube: is bound to /World/ice",
    ),
    "motion, both": (
        TABLE,
        both(
            setting("/World/cube", "physics:kinematicEnabled", True),
            setting("/World/cube", "gauge:motion", "fixed"),
        ),
        r"gauge:motion: is fixed, but UsdPhysics makes the body kinematic",
    ),
    "driver, both": (
        TABLE,
        both(
            turning(lambda t: Rotation.from_rotvec([0, 0, 2.0 * t])),
            lambda stage: accelerate(stage),
        ),
        r"gauge:driver: puts the body up to .* away from the time samples",
    ),
    "a driver that is no JSON": (
        TABLE,
        setting("/World/plate", "gauge:driver", "{"),
        r"/World/plate.gauge:driver: is not as the writer writes it",
    ),
}


def accelerate(stage: Usd.Stage) -> None:
    attribute = stage.GetPrimAtPath("/World/plate").GetAttribute("gauge:driver")
    text = attribute.Get()
    assert '"accelerate_s": 0.5' in text
    attribute.Set(text.replace('"accelerate_s": 0.5', '"accelerate_s": 0.4'))


def ice(stage: Usd.Stage) -> UsdShade.Material:
    material = UsdShade.Material.Define(stage, "/World/ice")
    UsdPhysics.MaterialAPI.Apply(material.GetPrim()).CreateDynamicFrictionAttr(0.01)
    return material


@pytest.mark.parametrize("case", DECLINED)
def test_edits_that_contradict_each_other_are_errors_that_name_the_place(
    case: str, tmp_path: Path
) -> None:
    name, edit, message = DECLINED[case]
    with pytest.raises(AssetError, match=message) as caught:
        edited(name, tmp_path, edit)
    assert caught.value.file == tmp_path / "edited.usda"
