"""Plain UsdPhysics that somebody else wrote becomes a scene, or an error that names the prim."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from usd_scenes import pairs

from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.errors import AssetError
from gauge_envs.formats.usd.reader import from_usd
from gauge_envs.scene import (
    Box,
    Cylinder,
    Hinge,
    Motion,
    Tether,
)

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
XFORM = '"PhysicsRigidBodyAPI", "PhysicsMassAPI", "MaterialBindingAPI"'
BOUND = "rel material:binding = </Rubber>\n"


def prim(kind, name, text="", apis=""):
    applied = f"(prepend apiSchemas = [{apis}])" if apis else ""
    return f'def {kind} "{name}" {applied}\n{{\n{text}\n}}\n'


def body(name="box", kind="Cube", text="", apis=RIGID, mass="2"):
    mass_text = f"float physics:mass = {mass}\n" if mass else ""
    return prim(kind, name, BOUND + mass_text + text, apis)


def collider(name, kind, text="", apis='"PhysicsCollisionAPI"'):
    return prim(kind, name, text, apis)


def op(kind, values):
    """A transform of one operation."""
    name = kind.split()[-1]
    return f'{kind} = {values}\nuniform token[] xformOpOrder = ["{name}"]\n'


def moved(*place):
    return op("double3 xformOp:translate", place)


def scaled(*scale):
    return op("double3 xformOp:scale", scale)


def joint(kind, text="", apis=""):
    return prim(f"Physics{kind}", "joint", text, apis)


def read(tmp_path, *prims, head=HEAD, physics=PHYSICS + RUBBER, **options):
    file = tmp_path / "foreign.usda"
    file.write_text(head + physics + "".join(prims))
    return from_usd(file, **({"duration_s": 2.0} | options))


BOX = body()
BALL = body("ball", "Sphere", "double radius = 0.1\n" + moved(0, 0, 1))
TO_BALL = "rel physics:body0 = </ball>\n"


def parent(*children, text=""):
    return body("thing", "Xform", text + "".join(children), apis=XFORM)


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


def test_a_slope_of_another_tool_becomes_a_scene_and_slides_as_newton_says(tmp_path):
    """Y up, centimetres and grams; in MuJoCo, a = g (sin - mu cos) along a slope of 30 degrees."""
    (tmp_path / "ramp.usda").write_text(RAMP)
    scene = from_usd(tmp_path / "ramp.usda")
    assert scene.duration_s == 2.0
    assert scene.gravity_m_per_s2 == pytest.approx(9.81, rel=1e-15)
    crate, board = scene.body("Crate"), scene.body("Board")
    assert crate.shape.size_m == pytest.approx((0.2, 0.2, 0.2), rel=1e-12)
    # 0.5 g/cm^3 are 500 kg/m^3, in 8 litres.
    assert crate.mass_kg == pytest.approx(4.0, rel=1e-12)
    assert (crate.motion, board.motion) == (Motion.DYNAMIC, Motion.FIXED)
    # x stays, y becomes z, z becomes -y.
    slope = Rotation.from_euler("y", -30.0, degrees=True)
    place = np.add(slope.apply([0.2, 0.0, 0.12]), [0.0, 0.0, 1.0])
    np.testing.assert_allclose(crate.pose.position_m, place, atol=1e-15)
    (contact,) = scene.contacts
    assert {*contact.first, *contact.second} == {"Crate", "Board"}
    assert (contact.friction, contact.restitution) == (pytest.approx(0.2), 0.25)
    simulation = BackendMuJoCo().build(scene)
    start = simulation.body_states(("Crate",))[0, 0].copy()
    simulation.advance(0.5)
    displacement_m = np.linalg.norm(
        simulation.body_states(("Crate",))[0, 0, :3] - start[:3]
    )
    angle = np.radians(30.0)
    a = 9.81 * (np.sin(angle) - 0.2 * np.cos(angle))
    assert displacement_m == pytest.approx(0.5 * a * 0.5**2, rel=0.01)


def test_references_and_instances_are_followed(tmp_path):
    hull = body("hull", text="bool physics:collisionEnabled = 0\n")
    (tmp_path / "part.usda").write_text(HEAD + prim("Xform", "Part", hull))
    parts = [
        f'def Xform "P{k}" (\ninstanceable = true\nreferences = @./part.usda@</Part>\n)\n{{\n{moved(k, 0, 1)}}}\n'
        for k in range(2)
    ]
    bodies = read(tmp_path, *parts).bodies
    places = {body.name: body.pose.position_m for body in bodies}
    assert places == {"P0/hull": (0.0, 0.0, 1.0), "P1/hull": (1.0, 0.0, 1.0)}


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
HULL = '"PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"'


@pytest.mark.parametrize("axis", "XYZ")
def test_a_cylinder_along_another_axis_turns_its_body(axis, tmp_path):
    text = f'uniform token axis = "{axis}"\ndouble radius = 0.2\ndouble height = 1\n'
    (drum,) = read(tmp_path, body("drum", "Cylinder", text)).bodies
    assert drum.shape == Cylinder(radius_m=0.2, length_m=1.0)
    along = np.abs(drum.pose.rotation.apply([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(along, np.eye(3)["XYZ".index(axis)], atol=1e-12)


def test_a_velocity_of_another_tool_is_in_its_units_and_axes(tmp_path):
    head = '#usda 1.0\n(\n metersPerUnit = 0.01\n upAxis = "Y"\n)\n'
    turned = "double xformOp:rotateZ"
    text = (
        "vector3f physics:velocity = (100, 0, 0)\n"
        "vector3f physics:angularVelocity = (180, 0, 90)\n" + op(turned, 90)
    )
    (box,) = read(tmp_path, body(text=text), head=head).bodies
    # The body's x axis is y of the stage, which is z of the world; z of the stage is -y of the world.
    assert box.linear_velocity_m_per_s == pytest.approx((0.0, 0.0, 1.0))
    spin_rad_per_s = (0.0, -np.pi / 2, np.pi)
    assert box.angular_velocity_rad_per_s == pytest.approx(spin_rad_per_s)


def test_boxes_and_meshes_of_one_body_are_its_pieces(tmp_path):
    approximation = 'uniform token physics:approximation = "convexHull"\n'
    hull = collider("m", "Mesh", MESH + approximation, HULL)
    below = collider("c", "Cube", "double size = 1\n" + moved(0.5, 0.5, -0.5))
    (thing,) = read(tmp_path, parent(hull, below)).bodies
    assert thing.shape.volume_m3 == pytest.approx(1.0 + 1.0 / 6.0)
    # The vertex inside the tetrahedron is none of its hull.
    assert len(thing.shape.pieces_m[0]) == 4
    convex = body("m", "Mesh", MESH.replace(", (0.2, 0.2, 0.2)", ""))
    (thing,) = read(tmp_path, convex).bodies
    assert thing.shape.volume_m3 == pytest.approx(1.0 / 6.0)


def test_density_of_the_body_counts_before_that_of_the_material(tmp_path):
    rubber = RUBBER.replace("{", "{ float physics:density = 100\n", 1)
    text = "double size = 2\nfloat physics:density = 10\n"
    (box,) = read(tmp_path, body(text=text, mass=""), physics=PHYSICS + rubber).bodies
    assert box.mass_kg == pytest.approx(80.0)


@pytest.mark.parametrize(("metres", "kilograms"), [(1, 1), (0.01, 0.001)])
def test_a_box_without_mass_has_the_density_of_water(tmp_path, metres, kilograms):
    """The default of UsdPhysics is 1000 kg/m^3, in any units."""
    text = f"double size = {0.1 / metres}\n"
    head = HEAD.replace("= 1\n", f"= {metres}\n kilogramsPerUnit = {kilograms}\n", 1)
    (box,) = read(tmp_path, body(text=text, mass=""), head=head).bodies
    assert box.mass_kg == pytest.approx(1.0)


def inertia(*moments):
    return f"float3 physics:diagonalInertia = {moments}\npoint3f physics:centerOfMass = (0, 0, 0)\n"


# m (b^2 + c^2) / 12 of a box of 2 kg and edges 1, 2, 3.
BRICK = "double size = 1\n" + scaled(1, 2, 3)


def test_the_angular_damping_that_physx_has_by_default_is_accepted(tmp_path):
    scene = read(tmp_path, body(text="float physxRigidBody:angularDamping = 0.05\n"))
    assert scene.body("box").mass_kg == 2.0


def test_an_inertia_of_uniform_density_is_accepted(tmp_path):
    (box,) = read(tmp_path, body(text=BRICK + inertia(13 / 6, 10 / 6, 5 / 6))).bodies
    assert box.shape == Box(size_m=(1.0, 2.0, 3.0))


# --- joints, drivers, contacts ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("joint_text", "expected"),
    [
        (
            joint(
                "RevoluteJoint",
                TO_BALL
                + "point3f physics:localPos0 = (0.5, 0, 0)\npoint3f physics:localPos1 = (0.5, 0, 1)\n"
                'uniform token physics:axis = "Y"\n',
            ),
            Hinge(body="ball", anchor_m=(0.5, 0.0, 1.0), axis=(0.0, 1.0, 0.0)),
        ),
        (
            joint(
                "DistanceJoint",
                "rel physics:body1 = </ball>\npoint3f physics:localPos0 = (0, 0, 2)\nfloat physics:maxDistance = 1.1\n",
            ),
            Tether(body="ball", anchor_m=(0.0, 0.0, 2.0), length_m=1.1),
        ),
    ],
)
def test_joints_to_the_world(joint_text, expected, tmp_path):
    assert read(tmp_path, BALL, joint_text).joints == (expected,)


def spinner(end_deg):
    rotation = op("float xformOp:rotateZ.timeSamples", f"{{0: 0, 48: {end_deg}}}")
    rotation = rotation.replace(
        '["xformOp:rotateZ.timeSamples"]', '["xformOp:rotateZ"]'
    )
    return body(text="bool physics:kinematicEnabled = 1\n" + rotation)


def test_whole_turns_between_two_keys_are_not_lost(tmp_path):
    (driver,) = read(tmp_path, spinner(720)).drivers
    (motion,) = driver.motions
    assert driver.provenance == "nominal: time samples of foreign.usda"
    for time_s in np.linspace(0.0, 2.0, 13).tolist():
        assert motion.value(time_s) == pytest.approx(2.0 * np.pi * time_s, abs=1e-7)


def test_pairs_that_are_filtered_or_disabled_do_not_collide(tmp_path):
    def named(name, place, text="", apis=RIGID):
        return body(name, "Sphere", text + moved(place, 0, 0), apis=apis)

    def group(name, members, filtered):
        includes = f"prepend rel collection:colliders:includes = [{members}]"
        return f'def PhysicsCollisionGroup "{name}"\n{{\n{includes}\nrel physics:filteredGroups = {filtered}\n}}\n'

    filters = RIGID + ', "PhysicsFilteredPairsAPI"'
    a = named("a", 0, "rel physics:filteredPairs = </b>\n", filters)
    disabled = named("d", 9, "bool physics:collisionEnabled = 0\n")
    scene = read(tmp_path, a, named("b", 3), named("c", 6), disabled)
    assert pairs(scene) == {frozenset("ac"), frozenset("bc")}
    groups = group("g", "</a>, </b>", "</h>") + group("h", "</c>", "</g>")
    scene = read(tmp_path, named("a", 0), named("b", 3), named("c", 6), groups)
    assert pairs(scene) == {frozenset("ab")}


@pytest.mark.parametrize(
    ("first", "second", "friction"),
    [
        ("average", "min", 0.25),
        ("multiply", "min", 0.125),
        ("multiply", "max", 0.5),
        ("", "average", 0.375),
    ],
)
def test_friction_combines_as_the_materials_say(first, second, friction, tmp_path):
    def material(text, mode):
        line = f'{{ token physxMaterial:frictionCombineMode = "{mode}"\n'
        return text.replace("{", line, 1) if mode else text

    ice = RUBBER.replace("Rubber", "Ice").replace("0.5", "0.25")
    on_ice = BALL.replace("</Rubber>", "</Ice>")
    physics = PHYSICS + material(RUBBER, first) + material(ice, second)
    (contact,) = read(tmp_path, BOX, on_ice, physics=physics).contacts
    assert (contact.friction, contact.restitution) == (friction, 0.1)


# --- parts that scenes lack ------------------------------------------------------------------------------------------


SLIPPERY = RUBBER.replace("Rubber", "Two").replace(
    "staticFriction = 0.5", "staticFriction = 0.7"
)
SHEAR = (
    "double3 xformOp:scale = (1, 2, 1)\ndouble xformOp:rotateZ = 30\n"
    'uniform token[] xformOpOrder = ["xformOp:scale", "xformOp:rotateZ"]\n'
)
MOVING = op(
    "double3 xformOp:translate.timeSamples", "{0: (0, 0, 0), 1: (1, 0, 0)}"
).replace('.timeSamples"]', '"]')
LIMIT = "point3f physics:localPos1 = (0, 0, 1)\nfloat physics:lowerLimit = -10\n"
TWO = "rel physics:body0 = </box>\nrel physics:body1 = </ball>\n"
HINGED = TO_BALL + "point3f physics:localPos1 = (0, 0, 1)\ndouble "

# Prims, and the place and the fault in the words of the error.
REFUSED = [
    (
        body(text="bool physics:startsAsleep = 1\n"),
        r"/box.physics:startsAsleep: is 1, which scenes lack",
    ),
    (
        body(text="float physxRigidBody:angularDamping = 0.5\n"),
        r"/box.physxRigidBody:angularDamping: is 0.5, which scenes lack",
    ),
    (
        BOX.replace("</Rubber>", "</Clay>")
        + SLIPPERY.replace("Two", "Clay").replace(
            "{", "{\nfloat newton:rollingFriction = 0.01\n", 1
        ),
        r"/Clay.newton:rollingFriction: is 0.01",
    ),
    (body("m", "Mesh"), r"/m: is flat or has fewer than four vertices"),
    (
        body(text="double size = 0\n", mass=""),
        r"/box: has a mass, or encloses no volume",
    ),
    (
        parent(
            collider(
                "c",
                "Cube",
                "float physics:mass = 1\n",
                '"PhysicsCollisionAPI", "PhysicsMassAPI"',
            )
        ).replace("float physics:mass = 2\n", ""),
        r"/thing/c: has a mass",
    ),
    (
        body(
            "thing",
            "Xform",
            collider(
                "a", "Cube", "float physics:density = 5\n", HULL + ', "PhysicsMassAPI"'
            )
            + collider("b", "Cube", moved(3, 0, 0)),
            apis=XFORM,
            mass="",
        ),
        r"/thing: has colliders of densities .5.0, 1000.0.",
    ),
    (body(text="float physics:density = -5\n", mass=""), r"/box: its mass is -"),
    (body(mass="-1"), r"/box: its mass is -1.0 kg"),
    (
        body(text=BRICK + inertia(2.0, 2.0, 2.0)),
        r"/box: its centre of mass .* contradict those of its shape and mass, .* .0.833333 1.666667 2.166667.",
    ),
    (body(kind="Capsule"), r"/box: is a collider of type Capsule"),
    (body(text=scaled(1, 0, 1)), r"/box: its transform scales by"),
    (
        body(kind="Sphere", text=scaled(1, 1, 2)),
        r"/box: is a Sphere with an uneven scale",
    ),
    (body(text=SHEAR), r"/box: its transform is sheared"),
    (body("m", "Mesh", LSHAPE), r"/m: is not convex \(it fills 0.857 of its hull\)"),
    (
        parent(collider("a", "Sphere"), collider("b", "Cube", moved(3, 0, 0))),
        r"/thing/a: is a Sphere among other",
    ),
    (BOX.replace(BOUND, "") + BALL, r"/box: has no physics material, so its friction"),
    (
        BOX + BALL.replace("</Rubber>", "</Two>") + SLIPPERY,
        r"/Two: has different frictions",
    ),
    (
        BOX + BALL + joint("RevoluteJoint", TWO),
        r"/joint: unsupported joint: a PhysicsRevoluteJoint of /box and /ball",
    ),
    (
        BALL + joint("FixedJoint", TO_BALL),
        r"/joint: unsupported joint: PhysicsFixedJoint.*rigidBodyEnabled",
    ),
    (
        BALL + joint("RevoluteJoint", TO_BALL + LIMIT),
        r"/joint: unsupported joint: it has physics:lowerLimit",
    ),
    (
        BALL + joint("RevoluteJoint", HINGED + "mjc:frictionloss = 0.5"),
        r"/joint: unsupported joint: it has mjc:frictionloss = 0.5",
    ),
    (
        BALL + joint("RevoluteJoint", TO_BALL),
        r"/joint: its two frames lie 1e\+03 mm apart",
    ),
    (parent(collider("c", "Cube", MOVING)), r"/thing/c: does not move with its body"),
    (
        prim("Mesh", "sheet", "", '"OmniPhysicsDeformableBodyAPI"'),
        r"/sheet: is a deformable body without gauge:kind",
    ),
]


@pytest.mark.parametrize(("prims", "words"), REFUSED)
def test_what_a_scene_does_not_have_is_an_error_that_names_the_prim(
    prims, words, tmp_path
):
    with pytest.raises(AssetError, match=words):
        read(tmp_path, prims)


HEAVY = PHYSICS.replace("{", "{\nfloat physics:gravityMagnitude = 981\n")
CENTIMETRES = {
    "head": HEAD.replace("= 1", "= 0.01", 1),
    "physics": RUBBER + HEAVY.replace("981", "9.81"),
}
DOWN = PHYSICS.replace("{", "{\nvector3f physics:gravityDirection = (0, -1, 0)\n")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"head": HEAD.replace("metersPerUnit = 1", "")}, r"foreign.usda: metersPerUnit is not given"),
        ({"duration_s": None}, "its duration is None s"),
        ({"physics": RUBBER}, "0 PhysicsScene prims"),
        ({"physics": RUBBER + DOWN}, "gravity must point down"),
        (CENTIMETRES, r"0.0981 m/s\^2, 0.01 times the earth's: .* = 0.01, the earth's is 980.665"),
        ({"physics": RUBBER + HEAVY}, r"981 m/s\^2, 100 times the earth's"),
    ],
)  # fmt: skip
def test_units_duration_and_gravity_must_be_known(options, words, tmp_path):
    with pytest.raises(AssetError, match=words):
        read(tmp_path, BOX, **options)
