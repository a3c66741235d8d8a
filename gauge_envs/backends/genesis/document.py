"""The rigid bodies of a scene as an MJCF document, the only input that gives a geom of Genesis all its constants.

Free bodies stand far from each other in it, since geoms that touch in the document never collide in Genesis. Genesis
takes the larger friction of two geoms, and the mean of their constraint constants. A body has one geom for each set of
constants in its contacts. Both geoms of a pair have the same constants, so both rules give these constants. Collision
bits let each geom collide only with geoms of its contacts.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from math import pi
from typing import Any
from xml.etree import ElementTree

import numpy as np

from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.shared.spring_damper import SLOWEST_IMPACT_M_PER_S
from gauge_envs.scene import (
    Box,
    Capsule,
    Compound,
    Contact,
    ContactMode,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    Hinge,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Vector,
)
from gauge_envs.scene.bodies import friction_dimension
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.meshes import body_mass_properties

CONTACT_LIMIT = 30
"""Largest number of contacts of a scene: each needs a bit of Genesis's collision masks."""

MIN_FRICTION = 0.01
"""Genesis raises the friction of each contact to this value."""

MAX_FRICTION = 5.0
"""Largest friction that Genesis's materials take."""

PHASES = 16
"""Number of moments within a step at which an impact may start, over which its restitution is averaged."""

LONGEST = 10
"""Half periods after which a body that is still in contact rests."""

MAX_STEP_DAMPING = 0.9
"""Largest share of its speed that an impact loses in a step. Genesis raises time constants that imply more than 1."""

COUPLED_BIT = 1 << 30
"""Collision bit that a geom accepts and no geom offers."""

ORIGIN = Pose(position_m=(0.0, 0.0, 0.0))

APART_M, HEIGHT_M = 10.0, 1000.0
"""Distance between free bodies in the document, and their height, where they touch nothing [m]."""


# --- contacts ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Constants:
    """Constants of a contact, as geoms hold them.

    Attributes:
        friction: Coulomb's coefficient.
        solref: Time constant [s] and damping ratio.
        solimp: Impedance: smallest, largest, width [m].
        turning: Torsional and rolling friction [m].
    """

    friction: float
    solref: tuple[float, float]
    solimp: tuple[float, float, float]
    turning: tuple[float, float] = (0.0, 0.0)


@dataclass
class Layer:
    """Collision bits of a geom: two geoms collide if one offers a bit that the other accepts."""

    offers: int = 0
    accepts: int = 0


def layers_of_bodies(
    scene: Scene, settings: SettingsGenesis
) -> dict[str, dict[Constants, Layer]]:
    """Return the geoms that each body needs, by name, as its constants of contacts and their collision bits."""
    bodies = {body.name for body in scene.bodies}
    layers: dict[str, dict[Constants, Layer]] = {}
    for number, contact in enumerate(_rigid_contacts(scene)):
        constants, bit = _constants(scene, contact, settings), 1 << number
        for name in bodies & set(contact.first):
            layers.setdefault(name, {}).setdefault(constants, Layer()).offers |= bit
        for name in bodies & set(contact.second):
            layers.setdefault(name, {}).setdefault(constants, Layer()).accepts |= bit
    return layers


def _rigid_contacts(scene: Scene) -> Iterator[Contact]:
    """Yield the contacts in which two rigid bodies may collide."""
    bodies = {body.name for body in scene.bodies}
    for contact in scene.contacts:
        if any(bodies.issuperset(pair) for pair in scene.colliding_pairs(contact)):
            yield contact


def _constants(scene: Scene, contact: Contact, settings: SettingsGenesis) -> Constants:
    solref = (settings.sustained_timeconst_s, settings.sustained_dampratio)
    impedance = settings.sustained_impedance
    if contact.mode is ContactMode.IMPACT and settings.impact_steps is not None:
        speed = settings.impact_speed_m_per_s or SLOWEST_IMPACT_M_PER_S
        weight = scene.gravity_m_per_s2 * settings.timestep_s / speed
        damping = damping_ratio(contact.restitution, settings.impact_steps, weight)
        frequency = pi / (settings.impact_steps * settings.timestep_s)
        solref = (1.0 / (damping * frequency), damping)
        impedance = (settings.impact_impedance, settings.impact_impedance, 0.001)
    turning = (contact.torsion_m, contact.rolling_m)
    return Constants(contact.friction, solref, impedance, turning)


@cache
def damping_ratio(restitution: float, steps: int, weight: float = 0.0) -> float:
    """Return the damping ratio with which a damped spring that only pushes has a restitution.

    A body in contact has the acceleration -2 z w v - w^2 x at the depth x and the speed v, gravity included. The spring
    never pulls. With the angular frequency w = pi / (steps h), half a period without damping lasts `steps`
    steps.

    Args:
        restitution: Ratio of outgoing to incoming speed, at least 0.
        steps: Steps of half a period.
        weight: Speed that gravity adds in a step, over the speed of the impact.
    """
    lowest, highest = 1e-6, MAX_STEP_DAMPING * steps / (2.0 * pi)
    if _mean_rebound(lowest, steps, weight) <= restitution:
        return lowest
    if _mean_rebound(highest, steps, weight) >= restitution:
        return highest
    # `gauge list` asks also where Genesis is absent, and the import takes a tenth of a second.
    from scipy.optimize import brentq

    return float(
        brentq(
            lambda ratio: _mean_rebound(ratio, steps, weight) - restitution,
            lowest,
            highest,
            xtol=1e-10,
        )
    )


def _mean_rebound(damping: float, steps: int, weight: float) -> float:
    phases = [
        rebound(damping, steps, (index + 0.5) / PHASES, weight)
        for index in range(PHASES)
    ]
    return sum(phases) / PHASES


def rebound(damping: float, steps: int, phase: float, weight: float) -> float:
    """Return the restitution of the spring in steps.

    Args:
        damping: Damping ratio.
        steps: Steps of half a period without damping.
        phase: Depth at the first step in contact, over the displacement of the body in a step.
        weight: Speed that gravity adds in a step, over the speed of the impact.
    """
    frequency, speed, depth = pi / steps, 1.0, phase
    for _ in range(LONGEST * steps):
        # Without a pull, the body falls freely.
        speed -= max(2.0 * damping * frequency * speed + frequency**2 * depth, -weight)
        depth += speed
        if depth <= 0.0:
            return max(-speed, 0.0)
    return 0.0


def is_frictionless(scene: Scene) -> bool:
    """Return whether rigid bodies touch, and no contact between them has friction."""
    frictions = [contact.friction for contact in _rigid_contacts(scene)]
    return bool(frictions) and not any(frictions)


def unsupported_contacts(scene: Scene, settings: SettingsGenesis) -> Iterator[str]:
    """Yield one sentence for each kind of contact between rigid bodies that Genesis cannot take."""
    contacts = list(_rigid_contacts(scene))
    is_smooth = is_frictionless(scene) and settings.friction_cone == "elliptic"
    for contact in contacts:
        first, second = contact.first[0], contact.second[0]
        if not (is_smooth or MIN_FRICTION <= contact.friction <= MAX_FRICTION):
            yield (
                f"{first!r} and {second!r} touch with a friction of {contact.friction:.6g}: Genesis raises the "
                f"friction of each contact to {MIN_FRICTION}, and takes at most {MAX_FRICTION:g}. This backend builds "
                "scenes in which no contact has friction, with the elliptic cone"
            )
            break
    for contact in contacts:
        if contact.mode is ContactMode.IMPACT and contact.restitution > 1.0:
            yield (
                f"{contact.first[0]!r} and {contact.second[0]!r} rebound with a restitution of "
                f"{contact.restitution:.6g}: the damped spring that stands for it reaches 1"
            )
            break
    if len(contacts) > CONTACT_LIMIT:
        yield f"the scene has {len(contacts)} contacts: Genesis's collision masks hold {CONTACT_LIMIT}; join groups"


# --- bodies -----------------------------------------------------------------------------------------------------------


def body_label(index: int) -> str:
    """Return the name of a scene's body in the document, by its place among the scene's bodies."""
    return f"body{index}"


def document(
    scene: Scene,
    settings: SettingsGenesis,
    coupled: Mapping[str, float],
    margin_m: float,
) -> str:
    """Return the document.

    Args:
        scene: The scene.
        settings: Effective settings.
        coupled: Friction of the bodies that collide with deformable bodies, by name.
        margin_m: Thickness by which the geoms of these bodies exceed them [m].
    """
    root = ElementTree.Element("mujoco")
    _add(root, "compiler", angle="radian", autolimits="false")
    asset, world = _add(root, "asset"), _add(root, "worldbody")
    layers = layers_of_bodies(scene, settings)
    for index, body in enumerate(scene.bodies):
        parent, pose = world, body.pose
        if body.motion is not Motion.FIXED:
            hinge = scene.hinges.get(body.name)
            parent, pose = _add_body(world, index, body, hinge, settings), ORIGIN
        copies = [
            (body.shape, constants, layer)
            for constants, layer in layers.get(body.name, {}).items()
        ]
        friction = coupled.get(body.name)
        if friction is not None:
            inert = Constants(
                max(friction, MIN_FRICTION),
                (settings.sustained_timeconst_s, 1.0),
                (0.9, 0.95, 0.001),
            )
            shape = _enlarged(body.shape, margin_m)
            copies.insert(0, (shape, inert, Layer(accepts=COUPLED_BIT)))
        label = body_label(index)
        for number, (piece, _) in enumerate(_solids(body.shape, ORIGIN)):
            if isinstance(piece, tuple):
                _add(asset, "mesh", name=f"{label}/{number}", vertex=piece)
        for number, (shape, constants, layer) in enumerate(copies):
            _add_geoms(parent, f"{label}/{number}", shape, pose, constants, layer)
    return ElementTree.tostring(root, encoding="unicode")


def _enlarged(shape: Shape, margin_m: float) -> Shape:
    """Return a box, sphere or cylinder enlarged by a margin [m], and other shapes unchanged."""
    if isinstance(shape, Box):
        x, y, z = (edge + 2.0 * margin_m for edge in shape.size_m)
        return Box(size_m=(x, y, z))
    if isinstance(shape, Sphere):
        return Sphere(radius_m=shape.radius_m + margin_m)
    if isinstance(shape, Cylinder):
        length_m = shape.length_m + 2.0 * margin_m
        return Cylinder(radius_m=shape.radius_m + margin_m, length_m=length_m)
    return shape


def _add(
    parent: ElementTree.Element, tag: str, **attributes: Any
) -> ElementTree.Element:
    """Add an element, whose numbers have all their digits, and return it."""

    def text(value: Any) -> str:
        if isinstance(value, str | int):
            return str(value)
        return " ".join(repr(number) for number in np.ravel(value).tolist())

    return ElementTree.SubElement(
        parent, tag, {name: text(value) for name, value in attributes.items()}
    )


def _add_body(
    world: ElementTree.Element,
    index: int,
    body: RigidBody,
    hinge: Hinge | None,
    settings: SettingsGenesis,
) -> ElementTree.Element:
    """Add a body to the world."""
    pose, label = body.pose, body_label(index)
    if hinge is None:
        pose = Pose(position_m=(APART_M * index, 0.0, HEIGHT_M))
    element = _add(world, "body", name=label, pos=pose.position_m, quat=pose.quaternion)
    if hinge is None:
        _add(element, "freejoint", name=label)
    else:
        _add(
            element,
            "joint",
            name=label,
            type="hinge",
            pos=pose.to_body(hinge.anchor_m),
            axis=pose.rotation.inv().apply(hinge.axis),
            armature=settings.hinge_armature_kg_m2,
        )
    if body.motion is Motion.KINEMATIC:
        mass_kg, centre_m = settings.kinematic_mass_kg, np.zeros(3)
        # A sphere's inertia is the same in every frame, so a torque needs no rotation.
        inertia = mass_kg * outer_radius_m(body) ** 2 * np.eye(3)
    else:
        mass_kg = body.mass_kg
        centre_m, inertia = body_mass_properties(body)
    order = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    _add(
        element,
        "inertial",
        pos=centre_m,
        mass=mass_kg,
        fullinertia=[inertia[place] for place in order],
    )
    return element


def outer_radius_m(body: RigidBody) -> float:
    """Return the largest distance of a corner of a body from its origin [m]."""
    return float(np.linalg.norm(body.shape.corners_m, axis=1).max())


def _add_geoms(
    parent: ElementTree.Element,
    name: str,
    shape: Shape,
    pose: Pose,
    constants: Constants,
    layer: Layer,
) -> None:
    """Add a geom for each solid of a shape; its name begins with the label of the body."""
    label = name.partition("/")[0]
    for number, (solid, place) in enumerate(_solids(shape, pose)):
        _add(
            parent,
            "geom",
            name=f"{name}/{number}",
            **_geometry(f"{label}/{number}", solid),
            pos=place.position_m,
            quat=place.quaternion,
            contype=layer.offers,
            conaffinity=layer.accepts,
            friction=(constants.friction, *constants.turning),
            condim=friction_dimension(*constants.turning),
            solref=constants.solref,
            solimp=constants.solimp,
            # Geoms of this group are not rendered.
            group="3",
        )


Solid = Shape | Capsule | Ellipsoid
Piece = tuple[Vector, ...]
"""Vertices of a convex solid in the body frame [m]."""


def _solids(shape: Solid, pose: Pose) -> Iterator[tuple[Solid | Piece, Pose]]:
    """Yield the solids of a shape: primitives, and the vertices of convex pieces, each with its pose."""
    if isinstance(shape, ConvexUnion):
        yield from ((piece, pose) for piece in shape.pieces_m)
    elif isinstance(shape, Compound):
        for part in shape.parts:
            place = Pose.from_rotation(
                vector(pose.to_world(part.pose.position_m)),
                pose.rotation * part.pose.rotation,
            )
            yield from _solids(part.shape, place)
    else:
        yield shape, pose


def _geometry(mesh: str, solid: Solid | Piece) -> dict[str, Any]:
    """Return the attributes of the geom of a solid."""
    match solid:
        case Box():
            return {"type": "box", "size": [0.5 * edge for edge in solid.size_m]}
        case Sphere():
            return {"type": "sphere", "size": solid.radius_m}
        case Ellipsoid():
            return {"type": "ellipsoid", "size": solid.radii_m}
        case Cylinder() | Capsule():
            size_m = [solid.radius_m, 0.5 * solid.length_m]
            return {"type": type(solid).__name__.lower(), "size": size_m}
        case Plane():
            return {"type": "plane", "size": "0 0 1"}
    return {"type": "mesh", "mesh": mesh}
