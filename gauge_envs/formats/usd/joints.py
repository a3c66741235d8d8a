"""Reader of hinges and tethers to the world of a USD stage."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
from pxr import Sdf, Usd, UsdPhysics

from gauge_envs.formats.usd.layer import WRITTEN, as_array, hinge_axis
from gauge_envs.formats.usd.source import Source, is_written
from gauge_envs.scene import Hinge, Motion, RigidBody, Tether
from gauge_envs.scene.geometry import FloatArray, length_of, vector

MAX_GAP = 1e-4
"""Largest distance between the two ends of a joint at the start [m], and largest angle between its axes [rad]."""

LIMITS = (
    "physics:lowerLimit",
    "physics:upperLimit",
    "physics:breakForce",
    "physics:breakTorque",
)
"""Attributes that limit a joint if they are finite."""

RESISTANCES = (
    "mjc:armature",
    "mjc:damping",
    "mjc:frictionloss",
    "mjc:stiffness",
    "physics:minDistance",
    "physxJoint:armature",
    "physxJoint:jointFriction",
)
"""Attributes that resist the motion of a joint if they are above 0."""


class _End(NamedTuple):
    """One end of a joint: its frame in the space of a prim or of the stage, and the path of its moving body."""

    space: Usd.Prim | None
    body: Sdf.Path | None
    position: Usd.Attribute
    rotation: Usd.Attribute


def joint_prims(source: Source) -> list[Usd.Prim]:
    """Return the enabled joints in the stage's order."""
    return [
        prim
        for prim in source.prims()
        if prim.IsA(UsdPhysics.Joint)
        and UsdPhysics.Joint(prim).GetJointEnabledAttr().Get()
    ]


def _ends(source: Source, prim: Usd.Prim) -> tuple[_End, _End]:
    """Return the ends of a joint in the world, or in a fixed body, and in its moving body."""
    ends = []
    for side in (0, 1):
        paths = prim.GetRelationship(f"physics:body{side}").GetTargets()
        space = source.stage.GetPrimAtPath(paths[0]) if paths else None
        if paths and not space:
            raise source.fault(prim, f"joins {paths[0]}, which does not exist")
        owner, path = source.body_of(space), None
        if owner and source.is_rigid(owner):
            space, path = owner, owner.GetPath()
        position = prim.GetAttribute(f"physics:localPos{side}")
        rotation = prim.GetAttribute(f"physics:localRot{side}")
        ends.append(_End(space, path, position, rotation))
    world, moving = sorted(ends, key=lambda end: end.body is not None)
    if world.body is not None or moving.body is None:
        raise source.fault(
            prim,
            f"unsupported joint: a {prim.GetTypeName()} of {world.body} and {moving.body}; this joint must be of one "
            "moving body and the world",
        )
    return world, moving


def read_joint(
    source: Source, prim: Usd.Prim, bodies: Mapping[Sdf.Path, RigidBody]
) -> Hinge | Tether:
    """Return a hinge for a revolute joint, and a tether for a distance joint.

    The joint's end in the world is the anchor. Its end in the body must coincide with the anchor. An exception is an
    unedited joint of a layer of this package, because the body may have been moved.

    Args:
        source: The stage.
        prim: The joint.
        bodies: Rigid bodies, by path of the prim.

    Raises:
        AssetError: The joint is of another kind, joins two moving bodies, or has friction, limits or a motor.
    """
    world, moving = _ends(source, prim)
    assert moving.body is not None
    body = bodies[moving.body]
    hinge, tether = UsdPhysics.RevoluteJoint(prim), UsdPhysics.DistanceJoint(prim)
    if not (hinge or tether) or body.motion is not Motion.DYNAMIC:
        raise source.fault(
            prim,
            f"unsupported joint: {prim.GetTypeName()} of a {body.motion} body; revolute and distance joints of dynamic "
            "bodies are read. To fix a body, set physics:rigidBodyEnabled to 0",
        )
    _check_free(source, prim)
    exact = prim.GetAttribute("gauge:anchor_m")
    to_world = partial(source.to_world, world.space)
    stored = source.stored(world.position, (3,), to_world)
    anchor_m = source.edited(exact, [stored], (3,))
    if anchor_m is None:
        anchor_m = to_world(np.zeros(3))
    end_m = source.to_world(moving.space, np.array(moving.position.Get()))
    if tether:
        return _read_tether(source, tether, body, anchor_m, end_m)
    letter = hinge.GetAxisAttr().Get()
    axis = _axis(source, world, letter)
    double = prim.GetAttribute("gauge:axis")
    exact_axis = source.numbers(double, (3,))
    if exact_axis is not None and is_written(axis, double.GetCustomDataByKey(WRITTEN)):
        length = length_of(exact_axis)
        # An axis that is exact within the tolerance of `DriverMotion` keeps its digits.
        axis = exact_axis if abs(length - 1.0) <= 1e-9 else exact_axis / length
    # If only the body of a layer of this package was moved, the anchor stays.
    ends = (moving.position, moving.rotation)
    if not exact or any(end.Get() != end.GetCustomDataByKey(WRITTEN) for end in ends):
        gap = length_of(end_m - anchor_m)
        angle = length_of(_axis(source, moving, letter) - axis)
        if max(gap, angle) > MAX_GAP:
            raise source.fault(
                prim,
                f"its two frames lie {1e3 * gap:.3g} mm apart and {angle:.3g} rad askew at the start: they must meet",
            )
    return Hinge(body=body.name, anchor_m=vector(anchor_m), axis=vector(axis))


def _check_free(source: Source, prim: Usd.Prim) -> None:
    """Check that a joint has no drive, friction, armature, limit and breaking strength."""
    obstacles = [
        name
        for name in prim.GetAppliedSchemas()
        if name.startswith(("PhysicsDriveAPI", "PhysicsLimitAPI"))
    ]
    for attribute in prim.GetAuthoredAttributes():
        name, value = attribute.GetName(), attribute.Get()
        if (name in LIMITS and np.isfinite(value)) or (
            name in RESISTANCES and value > 0.0
        ):
            obstacles.append(f"{name} = {value}")
    if obstacles:
        raise source.fault(
            prim,
            f"unsupported joint: it has {obstacles[0]}, and joints of a scene move freely",
        )


def _read_tether(
    source: Source,
    joint: UsdPhysics.DistanceJoint,
    body: RigidBody,
    anchor_m: FloatArray,
    end_m: FloatArray,
) -> Tether:
    prim = joint.GetPrim()
    if length_of(end_m - body.pose.position_m) > MAX_GAP:
        raise source.fault(
            prim,
            f"ends at {end_m.tolist()} m, not at the origin of {body.name!r}, where strings end",
        )
    longest = source.stored(
        joint.GetMaxDistanceAttr(), (), lambda length: length * source.metres
    )
    length_m = source.edited(prim.GetAttribute("gauge:length_m"), [longest])
    if length_m is None or length_m <= 0.0:
        raise source.fault(
            prim,
            "physics:maxDistance, the length of the string, is missing or not positive",
        )
    return Tether(body=body.name, anchor_m=vector(anchor_m), length_m=float(length_m))


def _axis(source: Source, end: _End, letter: str) -> FloatArray:
    """Return the direction of an axis of a frame in the world, a unit vector, shape [3]."""
    direction = hinge_axis(as_array(end.rotation.Get()), letter)
    tail, tip = source.to_world(end.space, np.array([np.zeros(3), direction]))
    return (tip - tail) / length_of(tip - tail)
