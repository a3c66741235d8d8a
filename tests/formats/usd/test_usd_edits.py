"""An edited value of a USD file applies, in either place; all other values stay the same, to the bit."""

import math
from ast import literal_eval
from dataclasses import replace

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade
from scipy.spatial.transform import Rotation
from usd_scenes import pairs

from gauge_envs import load_experiment
from gauge_envs.errors import AssetError
from gauge_envs.formats.usd.reader import from_usd
from gauge_envs.formats.usd.writer import scene_stage
from gauge_envs.scene import (
    Box,
    ConvexUnion,
    Motion,
    Pose,
    RigidBody,
    Scene,
)
from gauge_envs.scene.profiles import SampledProfile
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.assets.build import assets_folder

SLIDER, TABLE, BALL, PENDULUM = (
    "SlopeSlider-2-wood",
    "Turntable-1-wood",
    "BouncingBall-rubber",
    "Pendulum-metal",
)
CLOTH, FOAM, CRADLE, ROD = (
    "TextileBending-rayon",
    "FoamTwisting-soft",
    "NewtonsCradle-metal",
    "StickStack-soft",
)


def original(name):
    return load_experiment(name).scene


# A body whose centre of mass is not its origin, and a string of a length without few digits.
CORNERS = np.add(Box(size_m=(0.1, 0.06, 0.03)).corners_m, (0.05, 0.03, 0.015)).tolist()
THROWN = RigidBody(
    name="thrown",
    shape=ConvexUnion(pieces_m=(tuple(map(tuple, CORNERS)),)),
    motion=Motion.DYNAMIC,
    pose=Pose.from_euler_deg((0.2, 0.1, 1.0), (50.0, -20.0, 70.0)),
    mass_kg=0.4,
    linear_velocity_m_per_s=(1.2, -0.8, 1 / 3),
    angular_velocity_rad_per_s=(2.0, math.pi, -3.0),
)
THROW = Scene(bodies=(THROWN,), duration_s=0.5)
# --- edits of a layer ---


def edited(source, folder, edit):
    """Return the scene of a layer after an edit, as a USD tool would save it.

    Args:
        source: A variant, whose layer is read, or a scene.
        folder: Where the layer is written.
        edit: New values of attributes by path, or a function of the stage.
    """
    if isinstance(source, str):
        file = assets_folder() / "usd" / f"{source}.usda"
        stage = Usd.Stage.CreateInMemory()
        stage.GetRootLayer().TransferContent(Sdf.Layer.FindOrOpen(str(file)))
    else:
        stage = scene_stage(source)
    if callable(edit):
        edit(stage)
    else:
        for path, value in edit.items():
            attribute = stage.GetAttributeAtPath(path)
            assert attribute.HasAuthoredValue(), path
            attribute.Set(value)
    stage.GetRootLayer().Export(str(folder / "edited.usda"))
    return from_usd(folder / "edited.usda")


def changed(value, place, to):
    """Return a scene, or a part of one, with another value at a place such as `bodies.cube.mass_kg`."""
    if not place:
        return to
    name, _, rest = place.partition(".")
    if not isinstance(value, tuple):
        return replace(value, **{name: changed(getattr(value, name), rest, to)})
    names = [getattr(part, "name", "") for part in value]
    index = int(name) if name.isdecimal() else names.index(name)
    return (*value[:index], changed(value[index], rest, to), *value[index + 1 :])


# --- one value -------------------------------------------------------------------------------------------------------

CUBE, CONTACT = "/World/cube", "/World/Contacts/contact_0"
MATERIAL, SHEET, JOINT = (
    "/World/Materials/contact_0",
    "/World/textile",
    "/World/Joints/joint_0",
)
PLATE = "/World/plate"

# Edits of a layer: attribute, new value, place in the scene, and what stands there if it is another value. Numbers in
# single precision count as the decimal that was typed.
COUNTED = {
    SLIDER: """
        /World/cube.physics:mass                          0.25              bodies.cube.mass_kg
        /World/cube.gauge:mass_kg                         0.123456789012    bodies.cube.mass_kg
        /World/Contacts/contact_0.gauge:friction          0.1               contacts.0.friction
        /World/Materials/contact_0.physics:dynamicFriction 0.1              contacts.0.friction
        /World/Materials/contact_0.physics:staticFriction 0.1               contacts.0.friction
        /World/PhysicsScene.physics:gravityMagnitude      1.62              gravity_m_per_s2
        /World/PhysicsScene.gauge:gravity_m_per_s2        1.62              gravity_m_per_s2
        /World/cube/collision.xformOp:scale               (0.05,0.06,0.07)  bodies.cube.shape.size_m
    """,
    BALL: """
        /World/Materials/contact_0.physics:restitution    0.75              contacts.0.restitution
        /World/ball.xformOp:translate                     (0.1,0.2,0.9)     bodies.ball.pose.position_m
        /World/ball/collision.radius                      0.04              bodies.ball.shape.radius_m
    """,
    TABLE: """
        /World/plate/collision.height                     0.03              bodies.plate.shape.length_m
        /World/cube.physics:kinematicEnabled              True              bodies.cube.motion  "kinematic"
    """,
    CRADLE: """
        /World/Joints/joint_1.physics:localPos0           (0.5,0.25,0.75)   joints.1.anchor_m
    """,
    PENDULUM: """
        /World/Joints/joint_0.gauge:axis                  (1.0,0.0,0.0)     joints.0.axis
        /World/ball.xformOp:translate                     (0.2,0.49,0.3)    bodies.ball.pose.position_m
    """,
    CLOTH: """
        /World/textile.gauge:bend_stiffness_n_m_per_rad   1e-4  deformables.0.bend_stiffness_n_m_per_rad
        /World/textile.omniphysics:mass                   0.5   deformables.0.mass_kg
        /World/Materials/body_textile.omniphysics:surfaceThickness  0.002  deformables.0.thickness_m
    """,
    FOAM: """
        /World/Materials/body_foam.omniphysics:youngsModulus  12345.0  deformables.0.young_modulus_pa
        /World/Materials/body_foam.omniphysics:poissonsRatio  0.25     deformables.0.poisson_ratio
    """,
    ROD: """
        /World/rod.widths                                 [0.25]            deformables.0.radius_m  0.125
    """,
    "throw": """
        /World/thrown.gauge:linear_velocity_m_per_s       (3.0,0.0,0.1)     bodies.thrown.linear_velocity_m_per_s
    """,
}


@pytest.mark.parametrize(
    ("source", "row"),
    [
        (name, row)
        for name, rows in COUNTED.items()
        for row in rows.strip().splitlines()
    ],
)
def test_the_edited_value_applies_and_no_other_changes(source, row, tmp_path):
    path, value, place, *to = row.split()
    source = THROW if source == "throw" else source
    before = original(source) if isinstance(source, str) else source
    expected = changed(before, place, literal_eval((to or [value])[0]))
    assert expected != before
    assert edited(source, tmp_path, {path: literal_eval(value)}) == expected


def shifted(path, index, to):
    """Moves a point of a mesh, cloth or set of markers."""

    def edit(stage):
        attribute = stage.GetAttributeAtPath(f"{path}.points")
        points = list(attribute.Get())
        points[index] = Gf.Vec3f(*to)
        attribute.Set(points)

    return edit


def test_a_duration_and_a_marker_count(tmp_path):
    half = edited(SLIDER, tmp_path, lambda stage: stage.SetEndTimeCode(30))
    assert half == replace(original(SLIDER), duration_s=1.0)
    moved = edited(CLOTH, tmp_path, shifted("/World/Markers", 3, (0.5, 0.25, 0.125)))
    assert moved == changed(
        original(CLOTH), "markers.positions_m.3", (0.5, 0.25, 0.125)
    )


def test_a_hinge_turned_in_the_joint_frame_turns(tmp_path):
    rotation = Rotation.from_euler("xyz", [10.0, 20.0, 80.0], degrees=True)
    quaternion = Gf.Quatf(*rotation.as_quat(scalar_first=True))
    edit = {f"{JOINT}.physics:localRot0": quaternion, f"{JOINT}.gauge:axis": (0.0, 1.0, 0.0)}  # fmt: skip
    (hinge,) = edited(PENDULUM, tmp_path, edit).joints
    np.testing.assert_allclose(hinge.axis, rotation.apply([1.0, 0.0, 0.0]), atol=1e-6)
    assert np.linalg.norm(hinge.axis) == pytest.approx(1.0, abs=1e-15)


# --- velocities ------------------------------------------------------------------------------------------------------


def test_an_edited_standard_velocity_counts(tmp_path):
    velocity, spin_deg_per_s = (0.0, 0.0, 2.0), (0.0, 90.0, 0.0)
    edit = {
        "/World/thrown.physics:velocity": velocity,
        "/World/thrown.physics:angularVelocity": spin_deg_per_s,
    }
    body = edited(THROW, tmp_path, edit).body("thrown")
    # The centre of mass is at (0.05, 0.03, 0.015) in the body's axes, along which UsdPhysics gives its velocity.
    linear = (-0.015 * np.pi / 2, 0.0, 2.0 + 0.05 * np.pi / 2)
    rotation = THROWN.pose.rotation
    assert body.linear_velocity_m_per_s == pytest.approx(rotation.apply(linear))
    spin = rotation.apply((0.0, np.pi / 2, 0.0))
    assert body.angular_velocity_rad_per_s == pytest.approx(spin)


# --- drivers ---------------------------------------------------------------------------------------------------------

TABLE_FRAMES = range(95)


def turning(rotation_at):
    """Sets every sample of the turntable's orientation."""

    def edit(stage):
        attribute = stage.GetAttributeAtPath(f"{PLATE}.xformOp:orient")
        for frame in TABLE_FRAMES:
            quaternion = rotation_at(frame / FRAME_RATE_HZ).as_quat(scalar_first=True)
            attribute.Set(Gf.Quatd(*quaternion), frame)

    return edit


def faster(stage):
    attribute = stage.GetAttributeAtPath(f"{PLATE}.gauge:driver")
    amount = original(TABLE).drivers[0].motions[0].profiles[0].amount
    assert repr(amount) in attribute.Get()
    attribute.Set(attribute.Get().replace(repr(amount), "1.5"))


def spun(time_s):
    return Rotation.from_rotvec([0, 0, 2.0 * time_s**2])


def test_samples_that_stay_on_the_axis_keep_it_and_its_action(tmp_path):
    before = original(TABLE)
    scene = edited(TABLE, tmp_path, turning(spun))
    (driver,), (was,) = scene.drivers, before.drivers
    (motion,), (old,) = driver.motions, was.motions
    assert replace(motion, profiles=old.profiles) == old
    assert isinstance(motion.profiles[0], SampledProfile)
    times = np.array(TABLE_FRAMES) / FRAME_RATE_HZ
    values = [motion.value(time_s) for time_s in times]
    assert values == pytest.approx(2.0 * times**2, abs=1e-9)
    assert scene.bodies == before.bodies
    assert driver.provenance.startswith("nominal: edited in edited.usda")


def test_the_exact_motion_counts_with_its_edits_and_without_samples(tmp_path):
    def no_samples(stage):
        stage.GetAttributeAtPath(f"{PLATE}.xformOp:orient").Clear()

    assert edited(TABLE, tmp_path, no_samples) == original(TABLE)
    (driver,) = edited(TABLE, tmp_path, faster).drivers
    assert driver.motions[0].profiles[0].amount == 1.5
    assert driver.provenance == "nominal: edited in edited.usda, was nominal"


# --- contacts --------------------------------------------------------------------------------------------------------


def filtered(stage):
    api = UsdPhysics.FilteredPairsAPI.Apply(stage.GetPrimAtPath(CUBE))
    api.CreateFilteredPairsRel().AddTarget("/World/board")


def test_a_body_that_is_added_collides_by_its_material(tmp_path):
    before = original(SLIDER)

    def edit(stage):
        crate = UsdGeom.Cube.Define(stage, "/World/crate")
        crate.CreateSizeAttr(0.1)
        crate.AddTranslateOp().Set((1.0, 0.0, 0.5))
        for api in (UsdPhysics.RigidBodyAPI, UsdPhysics.CollisionAPI):
            api.Apply(crate.GetPrim())
        UsdPhysics.MassAPI.Apply(crate.GetPrim()).CreateMassAttr(2.0)
        bind(stage, "/World/crate", MATERIAL)

    scene = edited(SLIDER, tmp_path, edit)
    crate = scene.body("crate")
    assert (crate.shape, crate.mass_kg) == (Box(size_m=(0.1, 0.1, 0.1)), 2.0)
    known = set(before.contacts)
    added = replace(scene, contacts=[c for c in scene.contacts if c not in known])
    assert len(scene.contacts) - len(added.contacts) == len(known)
    assert pairs(added) == {
        frozenset(("crate", name)) for name in ("cube", "board", "ground")
    }


def bind(stage, path, material):
    binding = UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath(path))
    shade = UsdShade.Material(stage.GetPrimAtPath(material))
    binding.Bind(shade, UsdShade.Tokens.weakerThanDescendants, "physics")


# --- edits that cannot count -----------------------------------------------------------------------------------------


def on_ice(stage):
    material = UsdShade.Material.Define(stage, "/World/ice")
    UsdPhysics.MaterialAPI.Apply(material.GetPrim()).CreateDynamicFrictionAttr(0.01)
    bind(stage, CUBE, "/World/ice")


# The layer, its edits, and the place and the fault in the words of the error.
UNSUPPORTED = [
    (
        SLIDER,
        {f"{CUBE}.gauge:mass_kg": 0.3, f"{CUBE}.physics:mass": 0.2},
        r"/cube.gauge:mass_kg: was edited to 0.3, and to 0.2",
    ),
    (SLIDER, on_ice, r"/cube: is bound to /World/ice"),
    (SLIDER, filtered, r"/contact_0: board and cube have a contact, but"),
    (
        CLOTH,
        shifted(SHEET, 0, (9.0, 9.0, 9.0)),
        r"textile.points: was edited, but it follows from gauge:size_m",
    ),
    (
        PENDULUM,
        {f"{JOINT}.physics:localPos1": (0.0, 0.0, 0.5)},
        r"/joint_0: its two frames lie",
    ),
    (
        TABLE,
        {f"{CUBE}.physics:kinematicEnabled": True, f"{CUBE}.gauge:motion": "fixed"},
        r"gauge:motion: is fixed, but UsdPhysics",
    ),
    (
        TABLE,
        {f"{PLATE}.gauge:driver": "{"},
        r"/plate.gauge:driver: Expecting property name",
    ),
    (
        load_experiment("CubeToss-acrylic").scene,
        {f"{CUBE}.physics:diagonalInertia": (6.8e-4,) * 3},
        "contradict those of its shape and mass",
    ),
]


@pytest.mark.parametrize(("source", "edit", "words"), UNSUPPORTED)
def test_edits_that_cannot_count_are_errors_that_name_the_place(
    source, edit, words, tmp_path
):
    with pytest.raises(AssetError, match=words) as caught:
        edited(source, tmp_path, edit)
    assert caught.value.file == tmp_path / "edited.usda"
