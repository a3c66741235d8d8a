"""Reader of hinges and tethers to the world of a USD stage."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pxr import Sdf, Usd, UsdPhysics

from gauge_envs.scene.bodies import Hinge, Motion, RigidBody, Tether
from gauge_envs.scene.geometry import FloatArray, length_of, vector
from gauge_envs.tools.usd.layer import (
    WRITTEN,
    hinge_axis,
    hinge_frame,
    wxyz,
)
from gauge_envs.tools.usd.source import Source, StoredValue

GAP_M = 1e-4
"""Largest distance between the two ends of a joint at the start [m], and largest angle between its axes [rad]."""

UNIT = 1e-6
"""Largest deviation of an axis from unit length."""


UNSUPPORTED = (
    "gauge:backlash_rad",
    "gauge:motor",
    "gauge:quadratic_friction",
    "mjc:armature",
    "mjc:damping",
    "mjc:frictionloss",
    "mjc:stiffness",
    "physxJoint:armature",
    "physxJoint:jointFriction",
)
"""Attributes with physics that joints of a scene do not have, unless they are 0."""


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
        convert = (
            source.world_m
            if space is None
            else lambda points: source.to_world(space, points)
        )
        return source.reading(self.position, (3,), convert)

    def place(self) -> FloatArray:
        """Return the origin of the frame in world coordinates [m]; that of its space if none is authored."""
        stated = self.reading()
        if stated is not None:
            return stated.value
        return (
            np.zeros(3)
            if self.space is None
            else self._source.to_world(self.space, np.zeros(3))
        )

    def axis(self, letter: str) -> FloatArray:
        """Return the direction of an axis of the frame in the world."""
        source, quaternion = self._source, self._source.numbers(self.rotation, (4,))
        if quaternion is not None and not quaternion.any():
            raise source.fault(
                self.rotation, "is a zero quaternion: a rotation is expected"
            )
        axis = hinge_axis(
            np.array([1.0, 0.0, 0.0, 0.0]) if quaternion is None else quaternion, letter
        )
        if self.space is None:
            return source.up @ axis
        return source.frame(self.space, Usd.TimeCode(source.start)).pose.rotation.apply(
            axis
        )


def _ends(source: Source, joint: Usd.Prim) -> list[_End]:
    return [_End(source, joint, side) for side in (0, 1)]


def joint_prims(source: Source) -> list[Usd.Prim]:
    """Return the enabled joints in the stage's order."""
    return [
        prim
        for prim in source.prims()
        if prim.IsA(UsdPhysics.Joint)
        and source.flag(UsdPhysics.Joint(prim).GetJointEnabledAttr(), default=True)
    ]


def is_welded(source: Source, joint: Usd.Prim, body: Usd.Prim) -> bool:
    """Return whether a joint fixes a body to the world."""
    return (
        joint.IsA(UsdPhysics.FixedJoint)
        and _world_joint(source, joint, {})[1].body == body
    )


def _is_loose(end: _End, bodies: Mapping[Sdf.Path, RigidBody]) -> bool:
    """Return whether an end of a joint is in a body that is not fixed; bodies that are not given are not."""
    if end.body is None:
        return False
    body = bodies.get(end.body.GetPath())
    return body is None or body.motion is not Motion.FIXED


def read_joint(
    source: Source,
    prim: Usd.Prim,
    bodies: Mapping[Sdf.Path, RigidBody],
) -> Hinge | Tether | None:
    """Return a hinge for a revolute joint, a tether for a distance joint, and None for a fixed joint.

    The joint's end in the world is the anchor. Its end in the body must coincide with the anchor. An exception is an
    unedited joint of a layer of this package, because the body may have been moved.

    Args:
        source: The stage.
        prim: The joint.
        bodies: Rigid bodies, by path of the prim.
    """
    kind = str(prim.GetTypeName())
    if kind == "PhysicsFixedJoint":
        _world_joint(source, prim, {})
        return None
    world, moving = _world_joint(source, prim, bodies)
    if kind not in ("PhysicsRevoluteJoint", "PhysicsDistanceJoint"):
        raise source.fault(
            prim,
            f"unsupported joint: {kind}; revolute, distance and fixed joints to the world are read",
        )
    assert moving.body is not None
    body = bodies[moving.body.GetPath()]
    if body.motion is not Motion.DYNAMIC:
        raise source.fault(prim, f"unsupported joint: a {kind} of a {body.motion} body")
    _check_plain(source, prim)
    double = prim.GetAttribute("gauge:anchor_m")
    anchor = source.counted(double, [world.reading()], (3,))
    if anchor is None:
        anchor = world.place()
    if kind == "PhysicsDistanceJoint":
        return _tether(source, prim, body, anchor, moving.place())
    # If only the body was moved, the anchor stays.
    is_free = bool(double and double.HasAuthoredValue()) and not _is_edited(
        moving.position
    )
    return _hinge(source, prim, body, anchor, world, moving, is_free=is_free)


def _world_joint(
    source: Source, prim: Usd.Prim, bodies: Mapping[Sdf.Path, RigidBody]
) -> tuple[_End, _End]:
    """Return the ends of a joint in the world, or a fixed body, and in its moving body."""
    ends = sorted(_ends(source, prim), key=lambda end: _is_loose(end, bodies))
    moving = [end.body for end in ends if end.body and _is_loose(end, bodies)]
    if len(moving) != 1:
        joined = ", ".join(str(body.GetPath()) for body in moving) or "no moving body"
        raise source.fault(
            prim,
            f"unsupported joint: a {prim.GetTypeName()} of {joined}; this joint must be of one body and the world",
        )
    return ends[0], ends[1]


def _letter(source: Source, prim: Usd.Prim) -> str:
    return (
        source.text(UsdPhysics.RevoluteJoint(prim).GetAxisAttr(), ("X", "Y", "Z"))
        or "X"
    )


def _normalized(axis: FloatArray) -> FloatArray:
    """Return a unit vector; an axis that was edited has single precision, and one that a task file may state stays."""
    length = length_of(axis)
    return axis if abs(length - 1.0) <= 1e-9 else axis / length


def _is_edited(attribute: Usd.Attribute) -> bool:
    """Return whether an attribute at the body's end of a joint differs from its written value."""
    return bool(attribute) and attribute.Get() != attribute.GetCustomDataByKey(WRITTEN)


def _check_plain(source: Source, prim: Usd.Prim) -> None:
    """Check that a joint has no drive, friction, armature, limit and breaking strength."""
    applied = [
        name
        for name in prim.GetAppliedSchemas()
        if name.startswith(("PhysicsDriveAPI", "PhysicsLimitAPI"))
    ]
    if applied:
        raise source.fault(
            prim,
            f"unsupported joint: it has {applied[0]}, and joints of a scene move freely",
        )
    for attribute in map(prim.GetAttribute, UNSUPPORTED):
        if attribute and attribute.Get():
            raise source.fault(
                attribute,
                f"unsupported joint: it is {attribute.Get()}, and joints of a scene move freely",
            )
    limits = ("physics:lowerLimit", "physics:upperLimit")
    for name in (*limits, "physics:breakForce", "physics:breakTorque"):
        attribute = prim.GetAttribute(name)
        value = attribute.Get() if attribute else None
        if value is not None and np.isfinite(value):
            raise source.fault(
                attribute,
                f"unsupported joint: it is {value}, but joints of a scene have no limits",
            )


def _tether(
    source: Source,
    prim: Usd.Prim,
    body: RigidBody,
    anchor: FloatArray,
    end_m: FloatArray,
) -> Tether:
    joint = UsdPhysics.DistanceJoint(prim)
    if np.linalg.norm(end_m - body.pose.position_m) > GAP_M:
        raise source.fault(
            prim,
            f"ends at {end_m.tolist()} m, not at the origin of {body.name!r}, where strings end",
        )
    shortest = source.number(joint.GetMinDistanceAttr())
    if shortest is not None and shortest > 0.0:
        raise source.fault(
            joint.GetMinDistanceAttr(),
            f"unsupported joint: it is {shortest}, and a string only pulls",
        )
    longest = source.reading(
        joint.GetMaxDistanceAttr(), (), lambda length: length * source.metres
    )
    length = source.counted(prim.GetAttribute("gauge:length_m"), [longest])
    if length is None or length <= 0.0:
        raise source.fault(
            prim,
            "physics:maxDistance, the length of the string, is missing or not positive",
        )
    return Tether(body=body.name, anchor_m=vector(anchor), length_m=float(length))


def _hinge(
    source: Source,
    prim: Usd.Prim,
    body: RigidBody,
    anchor: FloatArray,
    world: _End,
    moving: _End,
    *,
    is_free: bool,
) -> Hinge:
    """Return the hinge; the place of a free one in its body does not count."""
    letter = _letter(source, prim)
    stated = world.axis(letter)
    standard = StoredValue(
        place=str(world.rotation.GetPath()), raw=stated, value=stated
    )
    double = prim.GetAttribute("gauge:axis")
    axis = source.counted(
        double,
        [standard],
        (3,),
        rounded=lambda a: hinge_axis(wxyz(hinge_frame(vector(a)))),
    )
    assert axis is not None
    if abs(length_of(axis) - 1.0) > UNIT:
        raise source.fault(
            prim, f"its axis {axis.tolist()} is not a unit vector: normalize it"
        )
    axis = _normalized(axis)
    if not is_free or _is_edited(moving.rotation):
        gap = 0.0 if is_free else length_of(moving.place() - anchor)
        askew = length_of(moving.axis(letter) - axis)
        if max(gap, askew) > GAP_M:
            raise source.fault(
                prim,
                f"its two frames lie {1e3 * gap:.3g} mm apart and {askew:.3g} rad askew at the start: they must meet",
            )
    return Hinge(body=body.name, anchor_m=vector(anchor), axis=vector(axis))
