"""The rigid bodies of a scene as an MJCF document, the only input that gives a geom of Genesis all its constants.

Free bodies stand far from each other in it, so that scenes that differ in start poses have the same document.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from gauge_envs.backends.genesis.contacts import MIN_FRICTION, Constants, Layer, layers_of_bodies
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.shared.rigid import world_hinges
from gauge_envs.scene import Box, ConvexUnion, Cylinder, Hinge, Motion, Plane, Pose, RigidBody, Scene, Sphere
from gauge_envs.scene.meshes import body_mass_properties

COUPLED_BIT = 1 << 30
"""Collision bit that a geom accepts and none offers."""

ORIGIN = Pose(position_m=(0.0, 0.0, 0.0))

APART_M, HEIGHT_M = 10.0, 1000.0
"""Distance between free bodies in the document, and their height, where they touch nothing [m]."""


def body_label(index: int) -> str:
    """Return the name of a scene's body in the document, by its place among the scene's bodies."""
    return f"body{index}"


def document(
    scene: Scene, settings: SettingsGenesis, coupled: Mapping[str, float] | None = None, margin_m: float = 0.0
) -> str:
    """Return the document.

    Args:
        scene: The scene.
        settings: Settings in force.
        coupled: Friction of the bodies that collide with deformable bodies, by name.
        margin_m: Thickness by which the geoms of these bodies exceed them [m].
    """
    root = ElementTree.Element("mujoco")
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="false")
    asset = ElementTree.SubElement(root, "asset")
    world = ElementTree.SubElement(root, "worldbody")
    layers = layers_of_bodies(scene, settings)
    hinges = world_hinges(scene)
    for index, body in enumerate(scene.bodies):
        parent, pose = world, body.pose
        if body.motion is not Motion.FIXED:
            parent, pose = _add_body(world, index, body, hinges.get(body.name), settings), ORIGIN
        copies = list(layers.get(body.name, {}).items())
        friction = (coupled or {}).get(body.name)
        if friction is not None:
            inert = Constants(max(friction, MIN_FRICTION), (settings.sustained_timeconst_s, 1.0), (0.9, 0.95, 0.001))
            coupling = (inert, Layer(accepts=COUPLED_BIT))
            if margin_m > 0.0 and isinstance(body.shape, Box | Sphere | Cylinder):
                _add_geoms(parent, asset, index, replace(body, shape=_enlarged(body.shape, margin_m)), pose, [coupling])
            else:
                copies.insert(0, coupling)
        _add_geoms(parent, asset, index, body, pose, copies)
    return ElementTree.tostring(root, encoding="unicode")


def _enlarged(shape: Box | Sphere | Cylinder, margin_m: float) -> Box | Sphere | Cylinder:
    """Return a shape whose surface is farther outside [m]."""
    if isinstance(shape, Box):
        x, y, z = (edge + 2.0 * margin_m for edge in shape.size_m)
        return Box(size_m=(x, y, z))
    if isinstance(shape, Sphere):
        return Sphere(radius_m=shape.radius_m + margin_m)
    return Cylinder(radius_m=shape.radius_m + margin_m, length_m=shape.length_m + 2.0 * margin_m)


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _add_body(
    world: ElementTree.Element, index: int, body: RigidBody, hinge: Hinge | None, settings: SettingsGenesis
) -> ElementTree.Element:
    pose = Pose(position_m=(APART_M * index, 0.0, HEIGHT_M)) if hinge is None else body.pose
    element = ElementTree.SubElement(
        world, "body", name=body_label(index), pos=_text(pose.position_m), quat=_text(pose.quaternion)
    )
    if hinge is None:
        ElementTree.SubElement(element, "freejoint", name=body_label(index))
    else:
        ElementTree.SubElement(
            element,
            "joint",
            name=body_label(index),
            type="hinge",
            pos=_text(pose.to_body(np.asarray(hinge.anchor_m))),
            axis=_text(pose.rotation.inv().apply(hinge.axis)),
            armature=repr(settings.hinge_armature_kg_m2),
        )
    if body.motion is Motion.KINEMATIC:
        mass_kg, centre_m = settings.kinematic_mass_kg, np.zeros(3)
        # A sphere's inertia is the same in every frame, so a torque needs no rotation.
        inertia = mass_kg * reach_m(body) ** 2 * np.eye(3)
    else:
        mass_kg = body.mass_kg
        centre_m, inertia = body_mass_properties(body)
    order = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    ElementTree.SubElement(
        element,
        "inertial",
        pos=_text(centre_m),
        mass=repr(float(mass_kg)),
        fullinertia=_text(inertia[place] for place in order),
    )
    return element


def reach_m(body: RigidBody) -> float:
    """Return the largest distance of a corner of a body from its origin [m]."""
    return float(np.linalg.norm(body.shape.corners_m, axis=1).max())


def _add_geoms(
    parent: ElementTree.Element,
    asset: ElementTree.Element,
    index: int,
    body: RigidBody,
    pose: Pose,
    copies: Iterable[tuple[Constants, Layer]],
) -> None:
    shapes = _shapes(body)
    for number, attributes in enumerate(shapes):
        if attributes["type"] == "mesh":
            label = f"{body_label(index)}/{number}"
            ElementTree.SubElement(asset, "mesh", name=label, vertex=attributes.pop("vertex"))
            attributes["mesh"] = label
    for constants, layer in copies:
        for attributes in shapes:
            ElementTree.SubElement(
                parent,
                "geom",
                attributes,
                pos=_text(pose.position_m),
                quat=_text(pose.quaternion),
                contype=str(layer.offers),
                conaffinity=str(layer.accepts),
                friction=_text((constants.friction, 0.0, 0.0)),
                solref=_text(constants.solref),
                solimp=_text(constants.solimp),
                # Geoms of this group are not rendered.
                group="3",
            )


def _shapes(body: RigidBody) -> list[dict[str, str]]:
    shape = body.shape
    if isinstance(shape, Box):
        return [{"type": "box", "size": _text(0.5 * edge for edge in shape.size_m)}]
    if isinstance(shape, Sphere):
        return [{"type": "sphere", "size": _text([shape.radius_m])}]
    if isinstance(shape, Cylinder):
        return [{"type": "cylinder", "size": _text([shape.radius_m, 0.5 * shape.length_m])}]
    if isinstance(shape, Plane):
        return [{"type": "plane", "size": "0 0 1"}]
    assert isinstance(shape, ConvexUnion)
    return [{"type": "mesh", "vertex": _text(np.asarray(piece).ravel())} for piece in shape.pieces_m]
