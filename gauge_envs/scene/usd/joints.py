"""Reader of hinges and tethers from the joints of a USD stage."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pxr import Sdf, Usd, UsdPhysics

from gauge_envs.scene.bodies import BodyHinge, Hinge, Motion, RigidBody, Tether
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.usd.layer import WRITTEN, FloatArray, hinge_axis, hinge_frame, wxyz
from gauge_envs.scene.usd.source import Source, StoredValue

GAP_M = 1e-4
"""Largest distance between the two ends of a joint at the start [m], and largest angle between its axes [rad]."""

UNIT = 1e-6
"""Largest deviation of an axis from unit length."""


def joint_prims(source: Source) -> list[Usd.Prim]:
    """Return the enabled joints in the stage's order."""
    return [
        prim
        for prim in source.prims()
        if prim.IsA(UsdPhysics.Joint) and source.flag(UsdPhysics.Joint(prim).GetJointEnabledAttr(), default=True)
    ]


def is_welded(source: Source, joint: Usd.Prim, body: Usd.Prim) -> bool:
    """Return whether a joint fixes a body to the world."""
    return joint.IsA(UsdPhysics.FixedJoint) and _moving_end(source, joint)[0] == body


def joins_bodies(source: Source, joint: Usd.Prim) -> bool:
    """Return whether a joint connects two moving bodies."""
    return len(_moving_ends(source, joint)) == 2


def read_body_hinge(source: Source, prim: Usd.Prim, bodies: Mapping[Sdf.Path, RigidBody]) -> BodyHinge:
    """Return the hinge of a revolute joint between two bodies.

    Its frames in both bodies must coincide at the start. They count if one of them was edited; otherwise the exact
    anchor and axis of a layer of this package count, which must agree with them.

    Args:
        source: The stage.
        prim: The joint.
        bodies: Rigid bodies, by path of the prim.
    """
    kind = str(prim.GetTypeName())
    if kind != "PhysicsRevoluteJoint":
        raise source.fault(prim, f"unsupported joint: a {kind} of two bodies; revolute joints of two bodies are read")
    _check_plain(source, prim)
    prims = [owner for owner, _ in _moving_ends(source, prim)]
    letter = source.text(UsdPhysics.RevoluteJoint(prim).GetAxisAttr(), ("X", "Y", "Z")) or "X"
    stated = [_in_world(source, body, place) for body, place in zip(prims, _positions(prim), strict=True)]
    places = [_origin(source, body) if one is None else one.value for body, one in zip(prims, stated, strict=True)]
    axes = [_axis(source, body, turn, letter) for body, turn in zip(prims, _rotations(prim), strict=True)]
    edited = any(_is_edited(one) for one in (*_positions(prim), *_rotations(prim)))
    exact = [source.numbers(prim.GetAttribute(f"gauge:{name}"), (3,)) for name in ("anchor_m", "axis")]
    anchor = places[0] if edited or exact[0] is None else exact[0]
    axis = axes[0] if edited or exact[1] is None else exact[1]
    gap = max(float(np.linalg.norm(place - anchor)) for place in places)
    askew = max(float(np.linalg.norm(one - axis)) for one in axes)
    if not max(gap, askew) <= GAP_M:
        raise source.fault(
            prim,
            f"its frames in the two bodies lie up to {1e3 * gap:.3g} mm and {askew:.3g} rad off its anchor and axis at "
            "the start: they must meet",
        )
    length = float(np.linalg.norm(axis))
    axis = axis if abs(length - 1.0) < 1e-12 else axis / length
    names = [bodies[body.GetPath()].name for body in prims]
    return BodyHinge(first=names[0], second=names[1], anchor_m=vector(anchor), axis=vector(axis))


def read_joint(source: Source, prim: Usd.Prim, bodies: Mapping[Sdf.Path, RigidBody]) -> Hinge | Tether | None:
    """Return a hinge for a revolute joint, a tether for a distance joint, and None for a fixed joint.

    The joint's end in the world is the anchor. Its end in the body must coincide with the anchor. An exception is an
    unedited joint of a layer of this package, because the body may have been moved.

    Args:
        source: The stage.
        prim: The joint.
        bodies: Rigid bodies, by path of the prim.
    """
    body_prim, side = _moving_end(source, prim)
    kind = str(prim.GetTypeName())
    if kind == "PhysicsFixedJoint":
        return None
    if kind not in ("PhysicsRevoluteJoint", "PhysicsDistanceJoint"):
        raise source.fault(
            prim, f"unsupported joint: {kind}; revolute, distance and fixed joints to the world are read"
        )
    body = bodies[body_prim.GetPath()]
    if body.motion is not Motion.DYNAMIC:
        raise source.fault(prim, f"unsupported joint: a {kind} of a {body.motion} body")
    _check_plain(source, prim)
    ends = _positions(prim)
    world_prim = _target(source, prim, 1 - side)
    own = prim.GetAttribute("gauge:anchor_m")
    anchor = source.counted(own, [_in_world(source, world_prim, ends[1 - side])], (3,))
    if anchor is None:
        anchor = _origin(source, world_prim)
    stated = _in_world(source, body_prim, ends[side])
    held = _origin(source, body_prim) if stated is None else stated.value
    if kind == "PhysicsDistanceJoint":
        return _tether(source, prim, body, anchor, held)
    # If only the body was moved, the anchor stays.
    is_free = bool(own and own.HasAuthoredValue()) and not _is_edited(ends[side])
    return _hinge(source, prim, body_prim, body, anchor, None if is_free else held)


def _moving_end(source: Source, prim: Usd.Prim) -> tuple[Usd.Prim, int]:
    """Return the moving body of a joint to the world, and the index of its end, 0 or 1."""
    ends = _moving_ends(source, prim)
    if len(ends) != 1:
        joined = ", ".join(str(owner.GetPath()) for owner, _ in ends) or "no moving body"
        raise source.fault(
            prim,
            f"unsupported joint: a {prim.GetTypeName()} of {joined}; this joint must be of one body and the world",
        )
    return ends[0]


def _moving_ends(source: Source, prim: Usd.Prim) -> list[tuple[Usd.Prim, int]]:
    """Return the moving bodies of a joint with the index of their end, 0 or 1."""
    ends = []
    for side in (0, 1):
        target = _target(source, prim, side)
        owner = source.body_of(target) if target else None
        if owner and source.is_rigid(owner):
            ends.append((owner, side))
    return ends


def _target(source: Source, prim: Usd.Prim, side: int) -> Usd.Prim | None:
    joint = UsdPhysics.Joint(prim)
    targets = (joint.GetBody0Rel(), joint.GetBody1Rel())[side].GetTargets()
    if not targets:
        return None
    target = source.stage.GetPrimAtPath(targets[0])
    if not target:
        raise source.fault(prim, f"joins {targets[0]}, which does not exist")
    return target


def _positions(prim: Usd.Prim) -> tuple[Usd.Attribute, Usd.Attribute]:
    joint = UsdPhysics.Joint(prim)
    return joint.GetLocalPos0Attr(), joint.GetLocalPos1Attr()


def _rotations(prim: Usd.Prim) -> tuple[Usd.Attribute, Usd.Attribute]:
    joint = UsdPhysics.Joint(prim)
    return joint.GetLocalRot0Attr(), joint.GetLocalRot1Attr()


def _in_world(source: Source, prim: Usd.Prim | None, attribute: Usd.Attribute) -> StoredValue | None:
    """Read a point in a prim's space, or in the stage's world without a prim, in world coordinates [m]."""
    return source.reading(attribute, (3,), source.world_m if prim is None else lambda p: source.to_world(prim, p))


def _origin(source: Source, prim: Usd.Prim | None) -> FloatArray:
    return np.zeros(3) if prim is None else source.to_world(prim, np.zeros(3))


def _is_edited(attribute: Usd.Attribute) -> bool:
    """Return whether an attribute at the body's end of a joint differs from its written value."""
    return bool(attribute) and attribute.Get() != attribute.GetCustomDataByKey(WRITTEN)


def _check_plain(source: Source, prim: Usd.Prim) -> None:
    """Check that a joint has no limit, drive or breaking strength."""
    applied = [name for name in prim.GetAppliedSchemas() if name.startswith(("PhysicsDriveAPI", "PhysicsLimitAPI"))]
    if applied:
        raise source.fault(prim, f"unsupported joint: it has {applied[0]}, and joints of a scene move freely")
    for name in ("physics:lowerLimit", "physics:upperLimit", "physics:breakForce", "physics:breakTorque"):
        attribute = prim.GetAttribute(name)
        value = attribute.Get() if attribute else None
        if value is not None and np.isfinite(value):
            raise source.fault(attribute, f"unsupported joint: it is {value}, but joints of a scene have no limits")


def _tether(source: Source, prim: Usd.Prim, body: RigidBody, anchor: FloatArray, held: FloatArray) -> Tether:
    joint = UsdPhysics.DistanceJoint(prim)
    if np.linalg.norm(held - body.pose.position_m) > GAP_M:
        raise source.fault(prim, f"ends at {held.tolist()} m, not at the origin of {body.name!r}, where strings end")
    shortest = source.number(joint.GetMinDistanceAttr())
    if shortest is not None and shortest > 0.0:
        raise source.fault(joint.GetMinDistanceAttr(), f"unsupported joint: it is {shortest}, and a string only pulls")
    longest = source.reading(joint.GetMaxDistanceAttr(), (), lambda length: length * source.metres)
    length = source.counted(prim.GetAttribute("gauge:length_m"), [longest])
    if length is None or length <= 0.0:
        raise source.fault(prim, "physics:maxDistance, the length of the string, is missing or not positive")
    return Tether(body=body.name, anchor_m=vector(anchor), length_m=float(length))


def _hinge(
    source: Source, prim: Usd.Prim, body_prim: Usd.Prim, body: RigidBody, anchor: FloatArray, held: FloatArray | None
) -> Hinge:
    """Return the hinge; `held` is the joint's end in the body [m], or None if it does not count."""
    side = _moving_end(source, prim)[1]
    frames = _rotations(prim)
    letter = source.text(UsdPhysics.RevoluteJoint(prim).GetAxisAttr(), ("X", "Y", "Z")) or "X"
    stated = _axis(source, _target(source, prim, 1 - side), frames[1 - side], letter)
    standard = StoredValue(place=str(frames[1 - side].GetPath()), raw=stated, value=stated)
    own = prim.GetAttribute("gauge:axis")
    axis = source.counted(own, [standard], (3,), rounded=lambda a: hinge_axis(wxyz(hinge_frame(vector(a)))))
    assert axis is not None
    length = float(np.linalg.norm(axis))
    if abs(length - 1.0) > UNIT:
        raise source.fault(prim, f"its axis {axis.tolist()} is not a unit vector: normalize it")
    # An edited axis has single precision.
    axis = axis if abs(length - 1.0) < 1e-12 else axis / length
    if held is not None or _is_edited(frames[side]):
        gap = 0.0 if held is None else float(np.linalg.norm(held - anchor))
        askew = float(np.linalg.norm(_axis(source, body_prim, frames[side], letter) - axis))
        if max(gap, askew) > GAP_M:
            raise source.fault(
                prim,
                f"its two frames lie {1e3 * gap:.3g} mm apart and {askew:.3g} rad askew at the start: they must meet",
            )
    return Hinge(body=body.name, anchor_m=vector(anchor), axis=vector(axis))


def _axis(source: Source, prim: Usd.Prim | None, attribute: Usd.Attribute, letter: str) -> FloatArray:
    """Return the direction of a joint's axis in the world, from its frame in a body or in the world."""
    quaternion = source.numbers(attribute, (4,))
    if quaternion is not None and not quaternion.any():
        raise source.fault(attribute, "is a zero quaternion: a rotation is expected")
    axis = hinge_axis(np.array([1.0, 0.0, 0.0, 0.0]) if quaternion is None else quaternion, letter)
    if prim is None:
        return source.up @ axis
    return source.frame(prim, Usd.TimeCode(source.start)).pose.rotation.apply(axis)
