"""Reader of hinges and tethers to the world of a USD stage."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from pxr import Sdf, Usd, UsdPhysics

from gauge_envs.scene import Hinge, Motion, RigidBody, Tether
from gauge_envs.scene.geometry import FloatArray, length_of, vector
from gauge_envs.tools.usd.layer import WRITTEN, as_array, hinge_axis, hinge_frame
from gauge_envs.tools.usd.source import Source, StoredValue

MAX_GAP = 1e-4
"""Largest distance between the two ends of a joint at the start [m], and largest angle between its axes [rad]."""

UNIT = 1e-6
"""Largest deviation of an axis from unit length."""

LIMITS = (
    "physics:lowerLimit",
    "physics:upperLimit",
    "physics:breakForce",
    "physics:breakTorque",
)
"""Attributes that limit a joint where they are finite."""

RESISTANCES = (
    "mjc:armature",
    "mjc:damping",
    "mjc:frictionloss",
    "mjc:stiffness",
    "physics:minDistance",
    "physxJoint:armature",
    "physxJoint:jointFriction",
)
"""Attributes that resist the motion of a joint where they are above 0."""


@dataclass(frozen=True)
class _End:
    """One end of a joint: its frame in the space of a prim or of the stage, and the path of its moving body."""

    source: Source
    space: Usd.Prim | None
    body: Sdf.Path | None
    position: Usd.Attribute
    rotation: Usd.Attribute

    def stored_anchor(self) -> StoredValue | None:
        """Return the authored origin of the frame in world coordinates [m]."""
        to_world = partial(self.source.to_world, self.space)
        return self.source.stored(self.position, (3,), to_world)

    def anchor_m(self) -> FloatArray:
        """Return the origin of the frame in world coordinates [m]; that of its space if none is authored."""
        stored = self.stored_anchor()
        origin = np.zeros(3)
        return stored.value if stored else self.source.to_world(self.space, origin)

    def axis(self, letter: str) -> FloatArray:
        """Return the direction of an axis of the frame in the world."""
        quaternion = self.source.numbers(self.rotation, (4,))
        if quaternion is None or not quaternion.any():
            quaternion = np.array([1.0, 0.0, 0.0, 0.0])
        ends = np.array([np.zeros(3), hinge_axis(quaternion, letter)])
        start, end = self.source.to_world(self.space, ends)
        return _unit(end - start)


def joint_prims(source: Source) -> list[Usd.Prim]:
    """Return the enabled joints in the stage's order."""
    joints = [UsdPhysics.Joint(prim) for prim in source.prims()]
    return [
        joint.GetPrim()
        for joint in joints
        if joint and joint.GetJointEnabledAttr().Get() is not False
    ]


def welded_body(source: Source, joint: Usd.Prim) -> Sdf.Path | None:
    """Return the path of the body that a fixed joint fixes to the world; None for other joints."""
    if not joint.IsA(UsdPhysics.FixedJoint):
        return None
    return _ends(source, joint, fixed=())[1].body


def _ends(
    source: Source, prim: Usd.Prim, fixed: Collection[Sdf.Path]
) -> tuple[_End, _End]:
    """Return the ends of a joint in the world, or in one of the fixed bodies, and in its moving body."""
    joint = UsdPhysics.Joint(prim)
    ends = []
    for body, position, rotation in (
        (joint.GetBody0Rel(), joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()),
        (joint.GetBody1Rel(), joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr()),
    ):
        paths = body.GetTargets()
        space = source.stage.GetPrimAtPath(paths[0]) if paths else None
        if paths and not space:
            raise source.fault(prim, f"joins {paths[0]}, which does not exist")
        owner, path = source.body_of(space), None
        if owner and source.is_rigid(owner) and owner.GetPath() not in fixed:
            space, path = owner, owner.GetPath()
        ends.append(_End(source, space, path, position, rotation))
    ends.sort(key=lambda end: end.body is not None)
    moving = [str(end.body) for end in ends if end.body is not None]
    if len(moving) != 1:
        raise source.fault(
            prim,
            f"unsupported joint: a {prim.GetTypeName()} of {', '.join(moving) or 'no moving body'}; this joint must be "
            "of one body and the world",
        )
    return ends[0], ends[1]


def read_joint(
    source: Source, prim: Usd.Prim, bodies: Mapping[Sdf.Path, RigidBody]
) -> Hinge | Tether | None:
    """Return a hinge for a revolute joint, a tether for a distance joint, and None for a fixed joint.

    The joint's end in the world is the anchor. Its end in the body must coincide with the anchor. An exception is an
    unedited joint of a layer of this package, because the body may have been moved.

    Args:
        source: The stage.
        prim: The joint.
        bodies: Rigid bodies, by path of the prim.

    Raises:
        AssetError: The joint is of another kind, joins two moving bodies, or has friction, limits or a motor.
    """
    if prim.IsA(UsdPhysics.FixedJoint):
        return None
    fixed = [path for path, body in bodies.items() if body.motion is Motion.FIXED]
    world, moving = _ends(source, prim, fixed)
    hinge, tether = UsdPhysics.RevoluteJoint(prim), UsdPhysics.DistanceJoint(prim)
    if not hinge and not tether:
        raise source.fault(
            prim,
            f"unsupported joint: {prim.GetTypeName()}; revolute, distance and fixed joints to the world are read",
        )
    assert moving.body is not None
    body = bodies[moving.body]
    if body.motion is not Motion.DYNAMIC:
        raise source.fault(
            prim, f"unsupported joint: a {prim.GetTypeName()} of a {body.motion} body"
        )
    _check_free(source, prim)
    exact = prim.GetAttribute("gauge:anchor_m")
    anchor_m = source.edited(exact, [world.stored_anchor()], (3,))
    if anchor_m is None:
        anchor_m = world.anchor_m()
    if tether:
        return _read_tether(source, tether, body, anchor_m, moving)
    axis = _read_axis(source, hinge, world)
    # If only the body of a layer of this package was moved, the anchor stays.
    ends = (moving.position, moving.rotation)
    if not exact or any(end.Get() != end.GetCustomDataByKey(WRITTEN) for end in ends):
        gap = length_of(moving.anchor_m() - anchor_m)
        angle = length_of(moving.axis(_letter(source, hinge)) - axis)
        if max(gap, angle) > MAX_GAP:
            raise source.fault(
                prim,
                f"its two frames lie {1e3 * gap:.3g} mm apart and {angle:.3g} rad askew at the start: they must meet",
            )
    return Hinge(body=body.name, anchor_m=vector(anchor_m), axis=vector(axis))


def _check_free(source: Source, prim: Usd.Prim) -> None:
    """Check that a joint has no drive, friction, armature, limit and breaking strength."""
    for name in prim.GetAppliedSchemas():
        if name.startswith(("PhysicsDriveAPI", "PhysicsLimitAPI")):
            raise source.fault(
                prim,
                f"unsupported joint: it has {name}, and joints of a scene move freely",
            )
    for attribute in prim.GetAuthoredAttributes():
        name, value = attribute.GetName(), attribute.Get()
        if (name in LIMITS and np.isfinite(value)) or (
            name in RESISTANCES and value > 0.0
        ):
            raise source.fault(
                attribute,
                f"unsupported joint: it is {value}, and joints of a scene move freely",
            )


def _read_tether(
    source: Source,
    joint: UsdPhysics.DistanceJoint,
    body: RigidBody,
    anchor_m: FloatArray,
    moving: _End,
) -> Tether:
    end_m = moving.anchor_m()
    if length_of(end_m - body.pose.position_m) > MAX_GAP:
        raise source.fault(
            joint.GetPrim(),
            f"ends at {end_m.tolist()} m, not at the origin of {body.name!r}, where strings end",
        )
    longest = source.stored(
        joint.GetMaxDistanceAttr(), (), lambda length: length * source.metres
    )
    length_m = source.edited(joint.GetPrim().GetAttribute("gauge:length_m"), [longest])
    if length_m is None or length_m <= 0.0:
        raise source.fault(
            joint.GetPrim(),
            "physics:maxDistance, the length of the string, is missing or not positive",
        )
    return Tether(body=body.name, anchor_m=vector(anchor_m), length_m=float(length_m))


def _read_axis(
    source: Source, joint: UsdPhysics.RevoluteJoint, world: _End
) -> FloatArray:
    """Return the axis of a hinge in the world, a unit vector, shape [3]."""
    standard = world.axis(_letter(source, joint))
    stored = StoredValue(world.rotation.GetPath(), standard, standard)
    axis = source.edited(
        joint.GetPrim().GetAttribute("gauge:axis"),
        [stored],
        (3,),
        rounded=lambda axis: hinge_axis(as_array(hinge_frame(vector(axis)))),
    )
    assert axis is not None
    if abs(length_of(axis) - 1.0) > UNIT:
        raise source.fault(
            joint.GetPrim(),
            f"its axis {axis.tolist()} is not a unit vector: normalize it",
        )
    return _unit(axis)


def _letter(source: Source, joint: UsdPhysics.RevoluteJoint) -> str:
    return source.text(joint.GetAxisAttr(), ("X", "Y", "Z")) or "X"


def _unit(axis: FloatArray) -> FloatArray:
    """Return a unit vector; one that is exact within the tolerance of `DriverMotion` keeps its digits."""
    length = length_of(axis)
    return axis if abs(length - 1.0) <= 1e-9 else axis / length
