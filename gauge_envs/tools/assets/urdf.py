"""Write rigid bodies of a scene as URDF files, one for each body, which simulators load and place one by one.

URDF has no free bodies beside each other, no planes, no friction and no restitution. So a scene is a set of files, a
plane is a large box below it, and contact constants are in the manifest beside the files.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from xml.etree import ElementTree

import numpy as np

from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Box, ConvexUnion, Cylinder, Hinge, Motion, Plane, RigidBody, Scene, Shape, Sphere, Vector
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.meshes import body_mass_properties
from gauge_envs.tools.assets.build import shape_to_obj

ROOT_LINK = "anchor"
"""Root link of a hinged body, which is fixed in the world."""

GROUND_BOX = Box(size_m=(10.0, 10.0, 1.0))
"""Box that stands for a plane; its upper face is the plane."""


NOWHERE = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class BodyFile:
    """URDF file of a body and where its root link starts.

    Attributes:
        file: Name of the file; bodies of equal shape, mass and motion share one.
        texts: Texts of the URDF file and of its meshes by path.
        root_position_m: Position of the root link at the start [m].
        root_quaternion: Orientation of the root link at the start (w, x, y, z).
        link: Name of the link of the body.
        origin_in_link_m: Origin of the body in the frame of this link [m].
        is_root_fixed: Whether the root link never moves.
    """

    file: str
    texts: Mapping[str, str]
    root_position_m: Vector = NOWHERE
    root_quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    link: str
    origin_in_link_m: Vector = NOWHERE
    is_root_fixed: bool


def body_files(scene: Scene) -> dict[str, BodyFile]:
    """Return the URDF file of each rigid body of a scene, by its name."""
    if scene.deformables:
        raise UnsupportedSceneError("URDF has no deformable bodies: export the scene as MJCF or USD")
    if scene.body_hinges:
        raise UnsupportedSceneError(
            "this writer makes one URDF file for each body, and hinges join two: export the scene as MJCF or USD"
        )
    hinges: dict[str, Hinge] = {}
    for joint in scene.joints:
        if not isinstance(joint, Hinge):
            raise UnsupportedSceneError("URDF has no tethers: export the scene as MJCF or USD")
        hinges[joint.body] = joint
    shared: dict[tuple[Shape, float, float | None, Motion], BodyFile] = {}
    files = {}
    for body in scene.bodies:
        if body.name in hinges:
            files[body.name] = _hinged(body, hinges[body.name])
            continue
        key = (body.shape, body.mass_kg, body.inertia_kg_m2, body.motion)
        if key not in shared:
            robot = ElementTree.Element("robot", name=body.name)
            meshes = _add_link(robot, body, NOWHERE)
            shared[key] = _file(body, robot, meshes, is_root_fixed=body.motion is Motion.FIXED)
        pose = body.pose
        files[body.name] = replace(shared[key], root_position_m=pose.position_m, root_quaternion=pose.quaternion)
    return files


def _hinged(body: RigidBody, hinge: Hinge) -> BodyFile:
    """Return a body on a hinge of the world, whose link has its frame at the anchor, with the body's axes."""
    turn = body.pose.rotation
    offset = vector(turn.apply(np.subtract(body.pose.position_m, hinge.anchor_m), inverse=True))
    robot = ElementTree.Element("robot", name=body.name)
    ElementTree.SubElement(robot, "link", name=ROOT_LINK)
    joint = ElementTree.SubElement(robot, "joint", name="hinge", type="continuous")
    with warnings.catch_warnings():
        # Of several angles for a pitch of 90 degrees, any will do.
        warnings.simplefilter("ignore", UserWarning)
        roll_pitch_yaw = vector(turn.as_euler("xyz"))
    ElementTree.SubElement(joint, "origin", xyz=_text(hinge.anchor_m), rpy=_text(roll_pitch_yaw))
    ElementTree.SubElement(joint, "parent", link=ROOT_LINK)
    ElementTree.SubElement(joint, "child", link=body.name)
    ElementTree.SubElement(joint, "axis", xyz=_text(vector(turn.apply(hinge.axis, inverse=True))))
    terms = hinge.dynamics
    if terms.armature_kg_m2 or hinge.motor:
        raise UnsupportedSceneError("URDF has no armature, backlash or motors: export the scene as MJCF or USD")
    damping, friction = (
        repr(one).removesuffix(".0") for one in (terms.viscous_friction_n_m_s_per_rad, terms.dry_friction_n_m)
    )
    ElementTree.SubElement(joint, "dynamics", damping=damping, friction=friction)
    meshes = _add_link(robot, body, offset)
    return replace(_file(body, robot, meshes, is_root_fixed=True), origin_in_link_m=offset)


def _file(body: RigidBody, robot: ElementTree.Element, meshes: Mapping[str, str], *, is_root_fixed: bool) -> BodyFile:
    ElementTree.indent(robot)
    name = f"{body.name}.urdf"
    texts = {name: ElementTree.tostring(robot, encoding="unicode") + "\n", **meshes}
    return BodyFile(file=name, texts=texts, link=body.name, is_root_fixed=is_root_fixed)


def _add_link(robot: ElementTree.Element, body: RigidBody, offset_m: Vector) -> dict[str, str]:
    """Add the link of a body whose origin is at an offset in the link's frame; return its meshes by path."""
    link = ElementTree.SubElement(robot, "link", name=body.name)
    if body.mass_kg > 0.0:
        centre, inertia = body_mass_properties(body)
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "origin", xyz=_text(vector(centre + offset_m)), rpy="0 0 0")
        ElementTree.SubElement(inertial, "mass", value=_text((body.mass_kg,)))
        names = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
        entries = {name: _text((float(inertia[place]),)) for name, place in names.items()}
        ElementTree.SubElement(inertial, "inertia", entries)
    meshes = {}
    shape = body.shape
    pieces = shape.pieces_m if isinstance(shape, ConvexUnion) else ()
    for index, part in enumerate([ConvexUnion(pieces_m=(piece,)) for piece in pieces] or [shape]):
        place, tag, attributes = _geometry(part, f"meshes/{body.name}-{index}.obj")
        if tag == "mesh":
            meshes[attributes["filename"]] = shape_to_obj(part, f"{body.name}-{index}")
        for purpose in ("visual", "collision"):
            element = ElementTree.SubElement(link, purpose)
            ElementTree.SubElement(element, "origin", xyz=_text(vector(np.add(place, offset_m))), rpy="0 0 0")
            ElementTree.SubElement(ElementTree.SubElement(element, "geometry"), tag, attributes)
    return meshes


def _geometry(shape: Shape, mesh: str) -> tuple[Vector, str, dict[str, str]]:
    """Return the place [m], tag and attributes of the geometry of a convex shape."""
    centre = (0.0, 0.0, 0.0)
    if isinstance(shape, Plane):
        return (0.0, 0.0, -0.5 * GROUND_BOX.size_m[2]), "box", {"size": _text(GROUND_BOX.size_m)}
    if isinstance(shape, Box):
        return centre, "box", {"size": _text(shape.size_m)}
    if isinstance(shape, Sphere):
        return centre, "sphere", {"radius": _text((shape.radius_m,))}
    if isinstance(shape, Cylinder):
        return centre, "cylinder", {"radius": _text((shape.radius_m,)), "length": _text((shape.length_m,))}
    if isinstance(shape, ConvexUnion):
        return centre, "mesh", {"filename": mesh}
    raise UnsupportedSceneError(f"the writer of URDF has no {type(shape).__name__}: export the scene as MJCF")


def _text(numbers: tuple[float, ...]) -> str:
    return " ".join(repr(number + 0.0) for number in numbers)
