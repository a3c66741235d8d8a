"""Reader of hinges and tethers from the joints of a USD stage."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pxr import Sdf, Usd, UsdPhysics

from gauge_envs.scene.bodies import BodyHinge, Hinge, Motion, RigidBody, Tether
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scene.usd.layer import WRITTEN, hinge_axis, hinge_frame, wxyz
from gauge_envs.scene.usd.source import Source, StoredValue

GAP_M = 1e-4
"""Largest distance between the two ends of a joint at the start [m], and largest angle between its axes [rad]."""

UNIT = 1e-6
"""Largest deviation of an axis from unit length."""


class _End:
    """One end of a joint.

    Args:
        source: The stage.
        joint: The joint.
        side: Index of the end, 0 or 1.

    Attributes:
        body: Prim of the moving body; None for an end in the world.
        space: Prim in whose space the frame is; None for that of the world.
        position: Attribute of the origin of the frame.
        rotation: Attribute of its orientation.
    """

    def __init__(self, source: Source, joint: Usd.Prim, side: int) -> None:
        api = UsdPhysics.Joint(joint)
        targets = (api.GetBody0Rel(), api.GetBody1Rel())[side].GetTargets()
        target = source.stage.GetPrimAtPath(targets[0]) if targets else None
        if targets and not target:
            raise source.fault(joint, f"joins {targets[0]}, which does not exist")
        owner = source.body_of(target) if target else None
        self._source = source
        self.body = owner if owner and source.is_rigid(owner) else None
        self.space = self.body or target
        self.position = (api.GetLocalPos0Attr(), api.GetLocalPos1Attr())[side]
        self.rotation = (api.GetLocalRot0Attr(), api.GetLocalRot1Attr())[side]

    def reading(self) -> StoredValue | None:
        """Return the authored origin of the frame in world coordinates [m]."""
        source, space = self._source, self.space
        convert = source.world_m if space is None else lambda points: source.to_world(space, points)
        return source.reading(self.position, (3,), convert)

    def place(self) -> FloatArray:
        """Return the origin of the frame in world coordinates [m]; that of its space if none is authored."""
        stated = self.reading()
        if stated is not None:
            return stated.value
        return np.zeros(3) if self.space is None else self._source.to_world(self.space, np.zeros(3))

    def axis(self, letter: str) -> FloatArray:
        """Return the direction of an axis of the frame in the world."""
        source, quaternion = self._source, self._source.numbers(self.rotation, (4,))
        if quaternion is not None and not quaternion.any():
            raise source.fault(self.rotation, "is a zero quaternion: a rotation is expected")
        axis = hinge_axis(np.array([1.0, 0.0, 0.0, 0.0]) if quaternion is None else quaternion, letter)
        if self.space is None:
            return source.up @ axis
        return source.frame(self.space, Usd.TimeCode(source.start)).pose.rotation.apply(axis)


def _ends(source: Source, joint: Usd.Prim) -> list[_End]:
    return [_End(source, joint, side) for side in (0, 1)]


def joint_prims(source: Source) -> list[Usd.Prim]:
    """Return the enabled joints in the stage's order."""
    return [
        prim
        for prim in source.prims()
        if prim.IsA(UsdPhysics.Joint) and source.flag(UsdPhysics.Joint(prim).GetJointEnabledAttr(), default=True)
    ]


def is_welded(source: Source, joint: Usd.Prim, body: Usd.Prim) -> bool:
    """Return whether a joint fixes a body to the world."""
    return joint.IsA(UsdPhysics.FixedJoint) and _world_joint(source, joint)[1].body == body


def joins_bodies(source: Source, joint: Usd.Prim) -> bool:
    """Return whether a joint connects two moving bodies."""
    return all(end.body for end in _ends(source, joint))


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
    ends, letter = _ends(source, prim), _letter(source, prim)
    places, axes = [end.place() for end in ends], [end.axis(letter) for end in ends]
    edited = any(_is_edited(one) for end in ends for one in (end.position, end.rotation))
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
    first, second = (bodies[end.body.GetPath()].name for end in ends if end.body)
    return BodyHinge(first=first, second=second, anchor_m=vector(anchor), axis=vector(_normalized(axis)))


def read_joint(source: Source, prim: Usd.Prim, bodies: Mapping[Sdf.Path, RigidBody]) -> Hinge | Tether | None:
    """Return a hinge for a revolute joint, a tether for a distance joint, and None for a fixed joint.

    The joint's end in the world is the anchor. Its end in the body must coincide with the anchor. An exception is an
    unedited joint of a layer of this package, because the body may have been moved.

    Args:
        source: The stage.
        prim: The joint.
        bodies: Rigid bodies, by path of the prim.
    """
    world, held = _world_joint(source, prim)
    kind = str(prim.GetTypeName())
    if kind == "PhysicsFixedJoint":
        return None
    if kind not in ("PhysicsRevoluteJoint", "PhysicsDistanceJoint"):
        raise source.fault(
            prim, f"unsupported joint: {kind}; revolute, distance and fixed joints to the world are read"
        )
    assert held.body is not None
    body = bodies[held.body.GetPath()]
    if body.motion is not Motion.DYNAMIC:
        raise source.fault(prim, f"unsupported joint: a {kind} of a {body.motion} body")
    _check_plain(source, prim)
    own = prim.GetAttribute("gauge:anchor_m")
    anchor = source.counted(own, [world.reading()], (3,))
    if anchor is None:
        anchor = world.place()
    if kind == "PhysicsDistanceJoint":
        return _tether(source, prim, body, anchor, held.place())
    # If only the body was moved, the anchor stays.
    is_free = bool(own and own.HasAuthoredValue()) and not _is_edited(held.position)
    return _hinge(source, prim, body, anchor, world, held, is_free=is_free)


def _world_joint(source: Source, prim: Usd.Prim) -> tuple[_End, _End]:
    """Return the ends of a joint in the world and in its moving body."""
    ends = sorted(_ends(source, prim), key=lambda end: end.body is not None)
    moving = [end.body for end in ends if end.body]
    if len(moving) != 1:
        joined = ", ".join(str(body.GetPath()) for body in moving) or "no moving body"
        raise source.fault(
            prim,
            f"unsupported joint: a {prim.GetTypeName()} of {joined}; this joint must be of one body and the world",
        )
    return ends[0], ends[1]


def _letter(source: Source, prim: Usd.Prim) -> str:
    return source.text(UsdPhysics.RevoluteJoint(prim).GetAxisAttr(), ("X", "Y", "Z")) or "X"


def _normalized(axis: FloatArray) -> FloatArray:
    """Return a unit vector; an axis that was edited has single precision, and an exact one stays."""
    length = float(np.linalg.norm(axis))
    return axis if abs(length - 1.0) < 1e-12 else axis / length


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
    source: Source, prim: Usd.Prim, body: RigidBody, anchor: FloatArray, world: _End, held: _End, *, is_free: bool
) -> Hinge:
    """Return the hinge; the place of a free one in its body does not count."""
    letter = _letter(source, prim)
    stated = world.axis(letter)
    standard = StoredValue(place=str(world.rotation.GetPath()), raw=stated, value=stated)
    own = prim.GetAttribute("gauge:axis")
    axis = source.counted(own, [standard], (3,), rounded=lambda a: hinge_axis(wxyz(hinge_frame(vector(a)))))
    assert axis is not None
    if abs(float(np.linalg.norm(axis)) - 1.0) > UNIT:
        raise source.fault(prim, f"its axis {axis.tolist()} is not a unit vector: normalize it")
    axis = _normalized(axis)
    if not is_free or _is_edited(held.rotation):
        gap = 0.0 if is_free else float(np.linalg.norm(held.place() - anchor))
        askew = float(np.linalg.norm(held.axis(letter) - axis))
        if max(gap, askew) > GAP_M:
            raise source.fault(
                prim,
                f"its two frames lie {1e3 * gap:.3g} mm apart and {askew:.3g} rad askew at the start: they must meet",
            )
    return Hinge(body=body.name, anchor_m=vector(anchor), axis=vector(axis))
