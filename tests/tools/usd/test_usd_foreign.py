"""Plain UsdPhysics that somebody else wrote becomes a scene, or an error that names the prim."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics
from scipy.spatial.transform import Rotation

from gauge_envs.errors import AssetError
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Box,
    Contact,
    ContactMode,
    ConvexUnion,
    Cylinder,
    Hinge,
    Motion,
    Plane,
    Pose,
    Scene,
    Sphere,
    Tether,
)
from gauge_envs.scene.geometry import pose_distance
from gauge_envs.tools.usd.reader import from_usd

HEAD = '#usda 1.0\n(\n metersPerUnit = 1\n upAxis = "Z"\n)\n'
PHYSICS = 'def PhysicsScene "Physics" {}\n'
RUBBER = """
def Material "Rubber" (prepend apiSchemas = ["PhysicsMaterialAPI"])
{
    float physics:dynamicFriction = 0.5
    float physics:staticFriction = 0.5
    float physics:restitution = 0.1
}
"""
RIGID = '"PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI", "MaterialBindingAPI"'
BOUND = "rel material:binding = </Rubber>\n"


def body(
    name: str = "box",
    kind: str = "Cube",
    text: str = "",
    apis: str = RIGID,
    mass: str = "float physics:mass = 2\n",
) -> str:
    return f'def {kind} "{name}" (prepend apiSchemas = [{apis}])\n{{\n{BOUND}{mass}{text}\n}}\n'


def read(tmp_path: Path, text: str, *, head: str = HEAD, **options: Any) -> Scene:
    file = tmp_path / "foreign.usda"
    file.write_text(head + text)
    return from_usd(file, **({"duration_s": 2.0} | options))


def simple(tmp_path: Path, text: str, **options: Any) -> Scene:
    return read(tmp_path, PHYSICS + RUBBER + text, **options)


def corners(piece: Any) -> set[tuple[float, ...]]:
    return {tuple(np.round(point, 6)) for point in piece}


# --- a stage in the style of other tools -----------------------------------------------------------------------------

RAMP = """#usda 1.0
(
    defaultPrim = "Lab"
    endTimeCode = 48
    kilogramsPerUnit = 0.001
    metersPerUnit = 0.01
    startTimeCode = 0
    timeCodesPerSecond = 24
    upAxis = "Y"
)

def Xform "Lab"
{
    def PhysicsScene "Scene"
    {
        vector3f physics:gravityDirection = (0, -1, 0)
        float physics:gravityMagnitude = 981
    }

    def Scope "Looks"
    {
        def Material "Ice" (prepend apiSchemas = ["PhysicsMaterialAPI"])
        {
            float physics:density = 0.5
            float physics:dynamicFriction = 0.1
            float physics:staticFriction = 0.1
        }
        def Material "Wood" (prepend apiSchemas = ["PhysicsMaterialAPI"])
        {
            float physics:dynamicFriction = 0.3
            float physics:restitution = 0.5
            float physics:staticFriction = 0.3
        }
    }

    def Xform "Slope"
    {
        float xformOp:rotateZ = 30
        double3 xformOp:translate = (0, 100, 0)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]

        def Cube "Board" (prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"])
        {
            rel material:binding:physics = </Lab/Looks/Wood>
            double size = 1
            float3 xformOp:scale = (200, 4, 50)
            uniform token[] xformOpOrder = ["xformOp:scale"]
        }

        def Xform "Crate" (prepend apiSchemas = ["PhysicsRigidBodyAPI"])
        {
            double3 xformOp:translate = (20, 12, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]

            def Cube "Geometry" (prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"])
            {
                rel material:binding:physics = </Lab/Looks/Ice>
                double size = 20
            }
        }
    }
}
"""


def test_y_up_centimetres_and_grams_become_z_up_metres_and_kilograms(
    tmp_path: Path,
) -> None:
    file = tmp_path / "ramp.usda"
    file.write_text(RAMP)
    scene = from_usd(file)
    assert scene.duration_s == 2.0
    assert scene.gravity_m_per_s2 == pytest.approx(9.81, rel=1e-15)
    crate, board = scene.body("Crate"), scene.body("Board")
    np.testing.assert_allclose(crate.shape.size_m, (0.2, 0.2, 0.2), rtol=1e-12)
    np.testing.assert_allclose(board.shape.size_m, (2.0, 0.04, 0.5), rtol=1e-12)
    # 0.5 g/cm^3 are 500 kg/m^3, in 8 litres.
    assert crate.mass_kg == pytest.approx(4.0, rel=1e-12)
    assert (crate.motion, board.motion) == (Motion.DYNAMIC, Motion.FIXED)
    # x stays, y becomes z, z becomes -y.
    slope = Rotation.from_euler("z", 30.0, degrees=True)
    up = Rotation.from_euler("x", 90.0, degrees=True)
    expected = up.apply(np.add(slope.apply([0.2, 0.12, 0.0]), [0.0, 1.0, 0.0]))
    np.testing.assert_allclose(crate.pose.position_m, expected, atol=1e-15)
    assert (crate.pose.rotation * (up * slope).inv()).magnitude() < 1e-7
    # The board's upper side lies 30 degrees from level.
    np.testing.assert_allclose(
        board.pose.rotation.apply([0.0, 1.0, 0.0])[2],
        np.cos(np.radians(30.0)),
        atol=1e-7,
    )
    (contact,) = scene.contacts
    assert set(contact.first) == {"Crate", "Board"}
    assert contact.friction == pytest.approx(0.2)
    assert contact.restitution == 0.25
    assert contact.mode is ContactMode.SUSTAINED


def test_it_slides_down_the_ramp_as_newton_says(tmp_path: Path) -> None:
    """From the file to MuJoCo: a = g (sin - mu cos) along a slope of 30 degrees."""
    from gauge_envs.backends.mujoco import BackendMuJoCo

    file = tmp_path / "ramp.usda"
    file.write_text(RAMP)
    scene = from_usd(file)
    simulation = BackendMuJoCo().build(scene)
    simulation.reset(0)
    start = simulation.body_states(("Crate",))[0].copy()
    for _ in range(90):
        simulation.advance(1 / 180)
    end = simulation.body_states(("Crate",))[0]
    way = float(np.linalg.norm(end[:3] - start[:3]))
    slope = np.radians(30.0)
    expected = 0.5 * 9.81 * (np.sin(slope) - 0.2 * np.cos(slope)) * 0.5**2
    assert way == pytest.approx(expected, rel=0.01)


def test_references_and_instances_are_followed(tmp_path: Path) -> None:
    (tmp_path / "part.usda").write_text(
        HEAD
        + 'def Xform "Part"\n{\n'
        + body("hull", text="double size = 0.5\n", apis=RIGID).replace(BOUND, "")
        + "}\n"
    )
    text = "".join(
        f'def Xform "P{k}" (\ninstanceable = true\nreferences = @./part.usda@</Part>\n)\n'
        f'{{\ndouble3 xformOp:translate = ({k}, 0, 1)\nuniform token[] xformOpOrder = ["xformOp:translate"]\n}}\n'
        for k in range(2)
    )
    everything = (
        Contact(first=("P0/hull",), second=("P1/hull",), friction=0.5, restitution=0.0),
    )
    scene = read(tmp_path, PHYSICS + text, contacts=everything)
    assert [body.name for body in scene.bodies] == ["P0/hull", "P1/hull"]
    assert [body.pose.position_m for body in scene.bodies] == [
        (0.0, 0.0, 1.0),
        (1.0, 0.0, 1.0),
    ]
    assert scene.contacts == everything


# --- shapes ----------------------------------------------------------------------------------------------------------

MESH = """
point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0.2, 0.2, 0.2)]
int[] faceVertexCounts = [3, 3, 3, 3]
int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]
"""
LSHAPE = """
point3f[] points = [(0,0,0),(2,0,0),(2,1,0),(1,1,0),(1,2,0),(0,2,0),(0,0,1),(2,0,1),(2,1,1),(1,1,1),(1,2,1),(0,2,1)]
int[] faceVertexCounts = [6, 6, 4, 4, 4, 4, 4, 4]
int[] faceVertexIndices = [5,4,3,2,1,0, 6,7,8,9,10,11, 0,1,7,6, 1,2,8,7, 2,3,9,8, 3,4,10,9, 4,5,11,10, 5,0,6,11]
"""
HULL = '"PhysicsMeshCollisionAPI"'


def moved(x: float, y: float, z: float) -> str:
    return f'double3 xformOp:translate = ({x}, {y}, {z})\nuniform token[] xformOpOrder = ["xformOp:translate"]\n'


def collider(
    name: str, kind: str, text: str, apis: str = '"PhysicsCollisionAPI"'
) -> str:
    return f'def {kind} "{name}" (prepend apiSchemas = [{apis}])\n{{\n{text}\n}}\n'


XFORM_APIS = '"PhysicsRigidBodyAPI", "PhysicsMassAPI", "MaterialBindingAPI"'


def parent(*children: str, text: str = "") -> str:
    return body("thing", "Xform", text + "".join(children), apis=XFORM_APIS)


def test_primitives_on_their_own_prims(tmp_path: Path) -> None:
    scene = simple(
        tmp_path,
        body("box", "Cube", "double size = 0.5\n")
        + body("ball", "Sphere", "double radius = 0.25\n" + moved(2, 0, 0))
        + body(
            "drum",
            "Cylinder",
            "double radius = 0.25\ndouble height = 0.75\n" + moved(4, 0, 0),
        )
        + body(
            "floor",
            "Plane",
            "",
            apis='"PhysicsCollisionAPI", "MaterialBindingAPI"',
            mass="",
        ),
    )
    assert [body.shape for body in scene.bodies] == [
        Box(size_m=(0.5, 0.5, 0.5)),
        Sphere(radius_m=0.25),
        Cylinder(radius_m=0.25, length_m=0.75),
        Plane(),
    ]
    assert [body.mass_kg for body in scene.bodies] == [2.0, 2.0, 2.0, 0.0]
    assert scene.gravity_m_per_s2 == GRAVITY_M_PER_S2
    # One contact for all, so that an engine sees chains of impacts.
    assert scene.contacts == (
        Contact(
            first=("box", "ball", "drum", "floor"),
            second=("box", "ball", "drum", "floor"),
            friction=0.5,
            restitution=0.1,
        ),
    )


@pytest.mark.parametrize("axis", "XYZ")
def test_a_cylinder_along_another_axis_turns_its_body(
    axis: str, tmp_path: Path
) -> None:
    text = f'uniform token axis = "{axis}"\ndouble radius = 0.2\ndouble height = 1\n'
    (drum,) = simple(tmp_path, body("drum", "Cylinder", text)).bodies
    assert drum.shape == Cylinder(radius_m=0.2, length_m=1.0)
    np.testing.assert_allclose(
        np.abs(drum.pose.rotation.apply([0.0, 0.0, 1.0])),
        np.eye(3)["XYZ".index(axis)],
        atol=1e-12,
    )


def test_a_sphere_beside_its_body_takes_the_body_along(tmp_path: Path) -> None:
    turn = "double3 xformOp:rotateXYZ = (0, 0, 90)\ndouble3 xformOp:translate = (1, 0, 0)\n"
    order = (
        'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]\n'
    )
    (ball,) = simple(
        tmp_path,
        parent(
            collider("c", "Sphere", "double radius = 0.1\n" + moved(0.5, 0, 0)),
            text=turn + order,
        ),
    ).bodies
    assert ball.shape == Sphere(radius_m=0.1)
    np.testing.assert_allclose(ball.pose.position_m, (1.0, 0.5, 0.0), atol=1e-12)


def test_a_box_beside_its_body_is_a_polyhedron_in_place(tmp_path: Path) -> None:
    (box,) = simple(
        tmp_path,
        parent(
            collider("c", "Cube", "double size = 1\n" + moved(0.5, 0, 0)),
            text=moved(0, 0, 3),
        ),
    ).bodies
    assert box.pose.position_m == (0.0, 0.0, 3.0)
    assert isinstance(box.shape, ConvexUnion)
    assert corners(box.shape.pieces_m[0]) == {
        (x, y, z) for x in (0.0, 1.0) for y in (-0.5, 0.5) for z in (-0.5, 0.5)
    }


def test_boxes_and_meshes_of_one_body_are_its_pieces(tmp_path: Path) -> None:
    hull = collider(
        "m",
        "Mesh",
        MESH + 'uniform token physics:approximation = "convexHull"\n',
        f'"PhysicsCollisionAPI", {HULL}',
    )
    below = collider("c", "Cube", "double size = 1\n" + moved(0.5, 0.5, -0.5))
    (thing,) = simple(tmp_path, parent(hull, below)).bodies
    assert thing.shape.volume_m3 == pytest.approx(1.0 + 1.0 / 6.0)
    # The vertex inside the tetrahedron is none of its hull.
    assert len(thing.shape.pieces_m[0]) == 4


def test_a_convex_mesh_needs_no_hull(tmp_path: Path) -> None:
    (thing,) = simple(
        tmp_path, body("m", "Mesh", MESH.replace(", (0.2, 0.2, 0.2)", ""))
    ).bodies
    assert thing.shape.volume_m3 == pytest.approx(1.0 / 6.0)


def test_density_of_the_body_counts_before_that_of_the_material(tmp_path: Path) -> None:
    rubber = RUBBER.replace("{", "{ float physics:density = 100\n", 1)
    by_material = read(
        tmp_path, PHYSICS + rubber + body(text="double size = 2\n", mass="")
    ).bodies[0]
    assert by_material.mass_kg == pytest.approx(800.0)
    by_body = read(
        tmp_path,
        PHYSICS
        + rubber
        + body(text="double size = 2\n", mass="float physics:density = 10\n"),
    ).bodies[0]
    assert by_body.mass_kg == pytest.approx(80.0)


def test_an_inertia_of_uniform_density_is_accepted(tmp_path: Path) -> None:
    # m (b^2 + c^2) / 12 of a box of 2 kg and edges 1, 2, 3.
    text = 'double size = 1\ndouble3 xformOp:scale = (1, 2, 3)\nuniform token[] xformOpOrder = ["xformOp:scale"]\n'
    inertia = "float3 physics:diagonalInertia = ({}, {}, {})\npoint3f physics:centerOfMass = (0, 0, 0)\n"
    (box,) = simple(
        tmp_path, body(text=text + inertia.format(13 / 6, 10 / 6, 5 / 6))
    ).bodies
    assert box.shape == Box(size_m=(1.0, 2.0, 3.0))
    with pytest.raises(
        AssetError,
        match=r"diagonalInertia: contradicts uniform density, whose moments are \(0.833333, 1.66667, 2.16667\)",
    ):
        simple(tmp_path, body(text=text + inertia.format(2.0, 2.0, 2.0)))
    (drum,) = simple(
        tmp_path,
        body(
            "d",
            "Cylinder",
            "double radius = 1\ndouble height = 2\n"
            + inertia.format(2 * 7 / 12, 2 * 7 / 12, 1.0),
        ),
    ).bodies
    assert drum.mass_kg == 2.0


# --- joints, drivers, contacts ---------------------------------------------------------------------------------------


def joint(kind: str, text: str) -> str:
    return f'def Physics{kind} "joint"\n{{\n{text}\n}}\n'


BALL = body("ball", "Sphere", "double radius = 0.1\n" + moved(0, 0, 1))


def test_joints_to_the_world(tmp_path: Path) -> None:
    hinge = "rel physics:body0 = </ball>\npoint3f physics:localPos0 = (0.5, 0, 0)\n"
    hinge += "point3f physics:localPos1 = (0.5, 0, 1)\n"
    scene = simple(
        tmp_path,
        BALL + joint("RevoluteJoint", hinge + 'uniform token physics:axis = "Y"\n'),
    )
    assert scene.joints == (
        Hinge(body="ball", anchor_m=(0.5, 0.0, 1.0), axis=(0.0, 1.0, 0.0)),
    )
    string = "rel physics:body1 = </ball>\npoint3f physics:localPos0 = (0, 0, 2)\nfloat physics:maxDistance = 1.1\n"
    scene = simple(tmp_path, BALL + joint("DistanceJoint", string))
    assert scene.joints == (
        Tether(body="ball", anchor_m=(0.0, 0.0, 2.0), length_m=1.1),
    )
    scene = simple(
        tmp_path, BALL + joint("FixedJoint", "rel physics:body0 = </ball>\n")
    )
    assert scene.joints == ()
    assert scene.body("ball").motion is Motion.FIXED
    scene = simple(
        tmp_path,
        BALL
        + joint(
            "SphericalJoint",
            "rel physics:body0 = </ball>\nbool physics:jointEnabled = 0\n",
        ),
    )
    assert scene.joints == ()


def test_a_joint_to_a_fixed_prim_is_one_to_the_world(tmp_path: Path) -> None:
    frame = f'def Xform "frame"\n{{\n{moved(0, 0, 3)}}}\n'
    text = "rel physics:body0 = </frame>\nrel physics:body1 = </ball>\nfloat physics:maxDistance = 3\n"
    (tether,) = simple(tmp_path, frame + BALL + joint("DistanceJoint", text)).joints
    assert tether.anchor_m == (0.0, 0.0, 3.0)


def test_a_kinematic_body_follows_its_samples(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "door.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, "Y")
    stage.SetTimeCodesPerSecond(24)
    stage.SetStartTimeCode(10)
    stage.SetEndTimeCode(58)
    UsdPhysics.Scene.Define(stage, "/physics")
    door = UsdGeom.Cube.Define(stage, "/door")
    door.CreateSizeAttr(20)
    angle = door.AddRotateYOp(UsdGeom.XformOp.PrecisionDouble)
    door.AddTranslateOp().Set(Gf.Vec3d(50, 0, 0))
    for code in range(10, 59, 4):
        angle.Set(0.1 * (code - 10) ** 2, code)
    UsdPhysics.CollisionAPI.Apply(door.GetPrim())
    UsdPhysics.RigidBodyAPI.Apply(door.GetPrim()).CreateKinematicEnabledAttr(True)
    stage.Save()
    scene = from_usd(tmp_path / "door.usda")
    assert scene.duration_s == 2.0
    (driver,), start = scene.drivers, scene.body("door").pose
    (motion,) = driver.motions
    assert motion.kind == "rotate"
    np.testing.assert_allclose(motion.axis, (0.0, 0.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(motion.point_m, (0.0, 0.0, 0.0), atol=1e-9)
    assert driver.provenance == "nominal: time samples of door.usda"
    for code in range(10, 59, 4):
        turn = Rotation.from_euler("z", 0.1 * (code - 10) ** 2, degrees=True)
        w, x, y, z = (turn * start.rotation).as_quat(scalar_first=True).tolist()
        expected = Pose(
            position_m=tuple(turn.apply([0.5, 0.0, 0.0]).tolist()),
            quaternion=(w, x, y, z),
        )
        assert pose_distance(driver.pose(start, (code - 10) / 24), expected) < 1e-9


SPINNER = body(
    text="bool physics:kinematicEnabled = 1\nfloat xformOp:rotateZ.timeSamples = {0: 0, 48: 720}\n"
    'uniform token[] xformOpOrder = ["xformOp:rotateZ"]\n'
)


def test_whole_turns_between_two_keys_are_not_lost(tmp_path: Path) -> None:
    (driver,) = simple(tmp_path, SPINNER).drivers
    (motion,) = driver.motions
    for time_s in np.linspace(0.0, 2.0, 13).tolist():
        assert motion.value(time_s) == pytest.approx(2.0 * np.pi * time_s, abs=1e-7)


def test_a_kinematic_body_that_stands_still_has_no_driver(tmp_path: Path) -> None:
    scene = simple(tmp_path, SPINNER.replace("48: 720", "48: 0"))
    assert scene.drivers == ()
    assert scene.bodies[0].motion is Motion.KINEMATIC


def test_pairs_that_are_filtered_or_disabled_do_not_collide(tmp_path: Path) -> None:
    def named(name: str, place: float, text: str = "", apis: str = RIGID) -> str:
        return body(name, "Sphere", text + moved(place, 0, 0), apis=apis)

    a = named(
        "a",
        0,
        "rel physics:filteredPairs = </b>\n",
        RIGID + ', "PhysicsFilteredPairsAPI"',
    )
    scene = simple(
        tmp_path,
        a
        + named("b", 3)
        + named("c", 6)
        + named("d", 9, "bool physics:collisionEnabled = 0\n"),
    )
    pairs = {
        frozenset(pair)
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    }
    assert pairs == {frozenset("ac"), frozenset("bc")}
    group = (
        'def PhysicsCollisionGroup "{0}"\n{{\nprepend rel collection:colliders:includes = [{1}]\n'
        "rel physics:filteredGroups = {2}\n}}\n"
    )
    groups = group.format("g", "</a>, </b>", "</h>") + group.format("h", "</c>", "</g>")
    scene = simple(tmp_path, named("a", 0) + named("b", 3) + named("c", 6) + groups)
    pairs = {
        frozenset(pair)
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    }
    assert pairs == {frozenset("ab")}


def test_coefficients_combine_as_the_materials_say(tmp_path: Path) -> None:
    def two(first: str, second: str) -> Contact:
        other = (
            RUBBER.replace("Rubber", "Ice")
            .replace("0.5", "0.25")
            .replace("{", "{ token " + second + "\n" if second else "{", 1)
        )
        rubber = RUBBER.replace("{", "{ token " + first + "\n" if first else "{", 1)
        text = body("a", "Sphere") + body("b", "Sphere", moved(3, 0, 0)).replace(
            "</Rubber>", "</Ice>"
        )
        (contact,) = read(tmp_path, PHYSICS + rubber + other + text).contacts
        return contact

    mode = 'physxMaterial:frictionCombineMode = "{}"'
    assert two("", "").friction == 0.375
    assert two(mode.format("min"), "").friction == 0.25
    assert two(mode.format("min"), mode.format("multiply")).friction == 0.125
    assert two(mode.format("max"), mode.format("multiply")).friction == 0.5


def test_what_usd_cannot_say_comes_from_keywords(tmp_path: Path) -> None:
    text = (
        RUBBER.replace("staticFriction = 0.5", "staticFriction = 0.7")
        + PHYSICS
        + BALL
        + body("box")
    )
    assert read(tmp_path, text, friction="static").contacts[0].friction == 0.7
    (contact,) = read(
        tmp_path, text, friction="dynamic", mode={("box", "ball"): ContactMode.IMPACT}
    ).contacts
    assert (contact.friction, contact.mode) == (0.5, ContactMode.IMPACT)
    own = Contact(first=("ball",), second=("box",), friction=0.9, restitution=0.3)
    assert read(tmp_path, text, friction="static", contacts=[own]).contacts == (own,)


# --- what a scene does not have --------------------------------------------------------------------------------------

NO_MASS = body(mass="")
BOX = body()
SHEAR = (
    "double3 xformOp:scale = (1, 2, 1)\ndouble xformOp:rotateZ = 30\n"
    'uniform token[] xformOpOrder = ["xformOp:scale", "xformOp:rotateZ"]\n'
)
REFUSED = {
    "no metersPerUnit": (
        '#usda 1.0\n(\nupAxis = "Z"\n)\n',
        BOX,
        r"foreign.usda: metersPerUnit is not given",
    ),
    "no upAxis": (
        "#usda 1.0\n(\nmetersPerUnit = 1\n)\n",
        BOX,
        r"foreign.usda: upAxis is not given",
    ),
    "no units of length": (HEAD.replace("= 1\n", "= 0\n"), BOX, "metersPerUnit is 0"),
    "no mass": (HEAD, NO_MASS, r"/box: a dynamic body needs a mass"),
    "negative mass": (
        HEAD,
        body(mass="float physics:mass = -1\n"),
        r"/box: its mass is -1.0 kg",
    ),
    "capsule": (HEAD, body(kind="Capsule"), r"/box: is a collider of type Capsule"),
    "no shape": (
        HEAD,
        body(kind="Xform", apis=XFORM_APIS),
        r"/box: is a rigid body without a collider",
    ),
    "zero scale": (
        HEAD,
        body(
            text='float3 xformOp:scale = (1, 0, 1)\nuniform token[] xformOpOrder = ["xformOp:scale"]\n'
        ),
        r"/box: its transform scales by",
    ),
    "uneven sphere": (
        HEAD,
        body(
            kind="Sphere",
            text='float3 xformOp:scale = (1, 1, 2)\nuniform token[] xformOpOrder = ["xformOp:scale"]\n',
        ),
        r"/box: is a Sphere with an uneven scale",
    ),
    "sheared": (HEAD, body(text=SHEAR), r"/box: its transform is sheared"),
    "no unit quaternion": (
        HEAD,
        body(
            text='quatf xformOp:orient = (2, 0, 0, 0)\nuniform token[] xformOpOrder = ["xformOp:orient"]\n'
        ),
        r"/box.xformOp:orient: holds .*: a unit quaternion is expected",
    ),
    "concave": (
        HEAD,
        body("m", "Mesh", LSHAPE),
        r"/m: is not convex \(it fills 0.857 of its hull\)",
    ),
    "concave, decomposed": (
        HEAD,
        body(
            "m",
            "Mesh",
            LSHAPE + 'uniform token physics:approximation = "convexDecomposition"\n',
            f"{RIGID}, {HULL}",
        ),
        r"/m: is not convex .*'convexDecomposition'",
    ),
    "flat": (
        HEAD,
        body("m", "Mesh", MESH.replace("(0, 0, 1), (0.2, 0.2, 0.2)", "(1, 1, 0)")),
        r"/m: is flat",
    ),
    "sphere in a compound": (
        HEAD,
        parent(collider("a", "Sphere", ""), collider("b", "Cube", moved(3, 0, 0))),
        r"/thing/a: is a Sphere among other colliders",
    ),
    "overlap": (
        HEAD,
        parent(collider("a", "Cube", ""), collider("b", "Cube", moved(1.9, 0, 0))),
        r"/thing/a: overlaps /thing/b by 100 mm",
    ),
    "driven plane": (HEAD, body(kind="Plane"), r"/box: is a plane of a dynamic body"),
    "velocity off the hinge": (
        HEAD,
        body(text="vector3f physics:velocity = (1, 0, 0)\n")
        + joint("RevoluteJoint", "rel physics:body0 = </box>\n"),
        r"'box' does not rotate the body about its hinge",
    ),
    "no material": (
        HEAD,
        BOX.replace(BOUND, "") + BALL,
        r"/box: has no physics material",
    ),
    "no friction": (
        HEAD,
        BOX
        + BALL.replace("</Rubber>", "</Bare>")
        + 'def Material "Bare" (prepend apiSchemas = ["PhysicsMaterialAPI"]) {}\n',
        r"/Bare: has neither physics:dynamicFriction nor",
    ),
    "two frictions": (
        HEAD,
        BOX
        + BALL.replace("</Rubber>", "</Two>")
        + RUBBER.replace("Rubber", "Two").replace(
            "staticFriction = 0.5", "staticFriction = 0.7"
        ),
        r"/Two: static friction is 0.7 and dynamic 0.5",
    ),
    "restitution": (
        HEAD,
        BOX
        + BALL.replace("</Rubber>", "</R>")
        + RUBBER.replace("Rubber", "R").replace("0.1", "1.5"),
        r"/R: restitution is 1.5",
    ),
    "two bodies": (
        HEAD,
        BOX
        + BALL
        + joint(
            "RevoluteJoint", "rel physics:body0 = </box>\nrel physics:body1 = </ball>\n"
        ),
        r"/joint: its frames in the two bodies lie up to .* they must meet",
    ),
    "no body": (
        HEAD,
        BOX + joint("RevoluteJoint", ""),
        r"/joint: unsupported joint: .* of no moving body",
    ),
    "missing body": (
        HEAD,
        BOX + joint("RevoluteJoint", "rel physics:body0 = </gone>\n"),
        r"/joint: joins /gone, which does not exist",
    ),
    **{
        kind: (
            HEAD,
            BALL + joint(kind, "rel physics:body0 = </ball>\n"),
            rf"/joint: unsupported joint: Physics{kind}",
        )
        for kind in ("PrismaticJoint", "SphericalJoint", "Joint")
    },
    "limit": (
        HEAD,
        BALL
        + joint(
            "RevoluteJoint",
            "rel physics:body0 = </ball>\npoint3f physics:localPos1 = (0, 0, 1)\nfloat physics:lowerLimit = -10\n",
        ),
        r"/joint.physics:lowerLimit: unsupported joint",
    ),
    "drive": (
        HEAD,
        BALL
        + joint("RevoluteJoint", "rel physics:body0 = </ball>\n").replace(
            '"joint"', '"joint" (prepend apiSchemas = ["PhysicsDriveAPI:linear"])'
        ),
        r"/joint: unsupported joint: it has PhysicsDriveAPI:linear",
    ),
    "open hinge": (
        HEAD,
        BALL + joint("RevoluteJoint", "rel physics:body0 = </ball>\n"),
        r"/joint: its two frames lie 1e\+03 mm apart",
    ),
    "string without length": (
        HEAD,
        BALL + joint("DistanceJoint", "rel physics:body0 = </ball>\n"),
        r"/joint: physics:maxDistance",
    ),
    "rod": (
        HEAD,
        BALL
        + joint(
            "DistanceJoint",
            "rel physics:body0 = </ball>\nfloat physics:minDistance = 1\nfloat physics:maxDistance = 1\n",
        ),
        r"minDistance: unsupported joint",
    ),
    "string off centre": (
        HEAD,
        BALL
        + joint(
            "DistanceJoint",
            "rel physics:body0 = </ball>\npoint3f physics:localPos0 = (0.1, 0, 0)\nfloat physics:maxDistance = 1\n",
        ),
        r"/joint: ends at .* not at the origin of 'ball'",
    ),
    "moving ground": (
        HEAD,
        body(
            text="double3 xformOp:translate.timeSamples = {0: (0, 0, 0), 1: (1, 0, 0)}\n"
            'uniform token[] xformOpOrder = ["xformOp:translate"]\n',
            apis='"PhysicsCollisionAPI", "MaterialBindingAPI"',
        ),
        r"/box: is a collider that moves without a rigid body",
    ),
    "deformable of others": (
        HEAD,
        'def Mesh "sheet" (prepend apiSchemas = ["OmniPhysicsDeformableBodyAPI"]) {}\n',
        r"/sheet: is a deformable body without gauge:kind",
    ),
    "missing reference": (
        HEAD,
        'def Xform "x" (references = @./gone.usda@) {}\n',
        r"gone.usda",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_a_scene_does_not_have_is_an_error_that_names_the_prim(
    case: str, tmp_path: Path
) -> None:
    head, text, message = REFUSED[case]
    with pytest.raises(AssetError, match=message):
        simple(tmp_path, text, head=head)


GRAVITY = 'def PhysicsScene "Physics"\n{{\n{}\n}}\n'


@pytest.mark.parametrize(
    ("physics", "message"),
    [
        ("", "0 PhysicsScene prims"),
        (PHYSICS + PHYSICS.replace('"Physics"', '"Other"'), "2 PhysicsScene prims"),
        (
            GRAVITY.format("vector3f physics:gravityDirection = (0, -1, 0)"),
            "gravity must point down",
        ),
        (GRAVITY.format("float physics:gravityMagnitude = -3"), "is -3.0 m/s"),
    ],
)
def test_gravity_points_down_in_one_scene(
    physics: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(AssetError, match=message):
        read(tmp_path, physics + RUBBER + BOX)


def test_the_duration_must_be_known(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="its duration is not known"):
        simple(tmp_path, BOX, duration_s=None)
    head = HEAD.replace(
        "(\n",
        "(\n startTimeCode = 10\n endTimeCode = 70\n timeCodesPerSecond = 24\n",
        1,
    )
    assert simple(tmp_path, BOX, head=head, duration_s=None).duration_s == 2.5
    assert simple(tmp_path, BOX, head=head, duration_s=1.0).duration_s == 1.0
    with pytest.raises(AssetError, match="its duration is -1"):
        simple(tmp_path, BOX, duration_s=-1.0)
