"""Reader of hinges with their motors, and of tethers of a USD stage."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any

import numpy as np
from pxr import Sdf, Usd, UsdPhysics
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.errors import first_fault
from gauge_envs.scene.bodies import (
    BodyHinge,
    Hinge,
    JointDynamics,
    Motion,
    RigidBody,
    Tether,
)
from gauge_envs.scene.geometry import FloatArray, length_of, vector
from gauge_envs.scene.motors import Motor
from gauge_envs.tools.usd.layer import (
    DRIVE,
    DYNAMICS,
    PHYSX_ARMATURE,
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


UNREAD = (
    "physxJoint:jointFriction",
    "mjc:stiffness",
)
"""Attributes with physics that joints of a scene do not have, unless they are 0."""


class _Terms(BaseModel):
    """Terms of a hinge."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    dynamics: JointDynamics
    motor: Annotated[Motor, Field(discriminator="kind")] | None


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


def joins_bodies(
    source: Source, joint: Usd.Prim, bodies: Mapping[Sdf.Path, RigidBody]
) -> bool:
    """Return whether a joint connects two bodies, none of which is fixed."""
    return all(_is_loose(end, bodies) for end in _ends(source, joint))


def _is_loose(end: _End, bodies: Mapping[Sdf.Path, RigidBody]) -> bool:
    """Return whether an end of a joint is in a body that is not fixed; bodies that are not given are not."""
    if end.body is None:
        return False
    body = bodies.get(end.body.GetPath())
    return body is None or body.motion is not Motion.FIXED


def read_body_hinge(
    source: Source,
    prim: Usd.Prim,
    bodies: Mapping[Sdf.Path, RigidBody],
    *,
    has_limits: bool = False,
) -> BodyHinge:
    """Return the hinge of a revolute joint between two bodies.

    Its frames in both bodies must coincide at the start. They count if one of them was edited; otherwise the exact
    anchor and axis of a layer of this package count, which must agree with them.

    Args:
        source: The stage.
        prim: The joint.
        bodies: Rigid bodies, by path of the prim.
        has_limits: Whether it may have limits, which do not count.
    """
    kind = str(prim.GetTypeName())
    if kind != "PhysicsRevoluteJoint" and not (has_limits and _slides(prim)):
        raise source.fault(
            prim,
            f"unsupported joint: a {kind} of two bodies; revolute joints of two bodies are read",
        )
    _check_plain(source, prim, has_limits=has_limits)
    ends, letter = _ends(source, prim), _letter(source, prim)
    places, axes = [end.place() for end in ends], [end.axis(letter) for end in ends]
    edited = any(
        _is_edited(one) for end in ends for one in (end.position, end.rotation)
    )
    exact = [
        source.numbers(prim.GetAttribute(f"gauge:{name}"), (3,))
        for name in ("anchor_m", "axis")
    ]
    anchor = places[0] if edited or exact[0] is None else exact[0]
    axis = axes[0] if edited or exact[1] is None else exact[1]
    gap = max(length_of(place - anchor) for place in places)
    askew = max(length_of(one - axis) for one in axes)
    if not max(gap, askew) <= GAP_M:
        raise source.fault(
            prim,
            f"its frames in the two bodies lie up to {1e3 * gap:.3g} mm and {askew:.3g} rad off its anchor and axis at "
            "the start: they must meet",
        )
    first, second = (bodies[end.body.GetPath()].name for end in ends if end.body)
    place, terms = vector(anchor), _terms(source, prim)
    return BodyHinge(
        first=first,
        second=second,
        anchor_m=place,
        axis=vector(_normalized(axis)),
        **terms,
    )


def read_joint(
    source: Source,
    prim: Usd.Prim,
    bodies: Mapping[Sdf.Path, RigidBody],
    *,
    has_limits: bool = False,
) -> Hinge | Tether | None:
    """Return a hinge for a revolute joint, a tether for a distance joint, and None for a fixed joint.

    The joint's end in the world is the anchor. Its end in the body must coincide with the anchor. An exception is an
    unedited joint of a layer of this package, because the body may have been moved.

    Args:
        source: The stage.
        prim: The joint.
        bodies: Rigid bodies, by path of the prim.
        has_limits: Whether it may have limits, which do not count.
    """
    kind = str(prim.GetTypeName())
    if kind == "PhysicsFixedJoint":
        _world_joint(source, prim, {})
        return None
    world, moving = _world_joint(source, prim, bodies)
    is_read = kind in ("PhysicsRevoluteJoint", "PhysicsDistanceJoint")
    if not is_read and not (has_limits and _slides(prim)):
        raise source.fault(
            prim,
            f"unsupported joint: {kind}; revolute, distance and fixed joints to the world are read",
        )
    assert moving.body is not None
    body = bodies[moving.body.GetPath()]
    if body.motion is not Motion.DYNAMIC:
        raise source.fault(prim, f"unsupported joint: a {kind} of a {body.motion} body")
    _check_plain(source, prim, has_limits=has_limits)
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


def _slides(prim: Usd.Prim) -> bool:
    return bool(prim.IsA(UsdPhysics.PrismaticJoint))


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


def _check_plain(source: Source, prim: Usd.Prim, *, has_limits: bool) -> None:
    """Check that a joint has no limit, no drive but that of a revolute joint, and no breaking strength."""
    applied = [
        name
        for name in prim.GetAppliedSchemas()
        if name.startswith(("PhysicsDriveAPI", "PhysicsLimitAPI"))
    ]
    if prim.IsA(UsdPhysics.RevoluteJoint) or _slides(prim):
        applied = [one for one in applied if one != f"PhysicsDriveAPI:{_drive(prim)}"]
    if applied:
        raise source.fault(
            prim,
            f"unsupported joint: it has {applied[0]}, and joints of a scene move freely",
        )
    limits = ("physics:lowerLimit", "physics:upperLimit")
    strengths = ("physics:breakForce", "physics:breakTorque")
    for name in strengths if has_limits else (*limits, *strengths):
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
    second = _ends(source, prim)[1].body
    terms = _terms(source, prim, 1.0 if second == moving.body else -1.0)
    return Hinge(body=body.name, anchor_m=vector(anchor), axis=vector(axis), **terms)


def _drive(prim: Usd.Prim) -> str:
    """Return the kind of the drive that moves a joint."""
    return "linear" if _slides(prim) else "angular"


def _terms(source: Source, prim: Usd.Prim, sign: float = 1.0) -> dict[str, Any]:
    """Return the fields `dynamics` and `motor` of the hinge of a joint, which turns as the joint times a sign.

    Those of a slider have m for rad and N for N m.
    """
    velocity = f"drive:{_drive(prim)}:physics:targetVelocity"
    for attribute in map(prim.GetAttribute, (*UNREAD, velocity)):
        if attribute and source.number(attribute):
            raise source.fault(
                attribute,
                f"unsupported joint: it is {attribute.Get()}, and a scene has no such term",
            )
    unit = source.kilograms * (1.0 if _slides(prim) else source.metres**2)
    dynamics = {}
    for field, name in DYNAMICS.items():
        other = (
            [source.reading(prim.GetAttribute(PHYSX_ARMATURE))]
            if name == "mjc:armature"
            else []
        )
        if (value := source.counted(prim.GetAttribute(name), other)) is not None:
            dynamics[field] = float(value) * (1.0 if field == "backlash_rad" else unit)
    drive = UsdPhysics.DriveAPI(prim, _drive(prim))
    kind = source.text(prim.GetAttribute("gauge:motor")) or ("servo" if drive else None)
    motor = (
        None
        if kind is None
        else {"kind": kind} | _motor(source, prim, drive, unit, sign)
    )
    try:
        return dict(_Terms.model_validate({"dynamics": dynamics, "motor": motor}))
    except ValidationError as error:
        raise source.fault(prim, ": ".join(first_fault(error))) from None


def _motor(
    source: Source, prim: Usd.Prim, drive: UsdPhysics.DriveAPI, unit: float, sign: float
) -> dict[str, Any]:
    """Return the fields of a motor; a drive of another tool holds its target."""
    source.text(drive.GetTypeAttr(), ("force",))
    motor: dict[str, Any] = {
        "delay_s": source.number(prim.GetAttribute("gauge:delay_s")) or 0.0
    }
    for field, (name, factor) in DRIVE.items():
        standard = prim.GetAttribute(name.replace("angular", _drive(prim)))
        if _slides(prim):
            factor = source.metres if field == "torque_limit_n_m" else 1.0
        is_given = standard and standard.Get() != math.inf
        reading = (
            source.reading(standard, (), partial(np.multiply, factor * unit))
            if is_given
            else None
        )
        if (
            value := source.counted(prim.GetAttribute(f"gauge:{field}"), [reading])
        ) is not None:
            motor[field] = float(value)
    command = prim.GetAttribute("gauge:command")
    stated_target = source.number(drive.GetTargetPositionAttr()) or 0.0
    target = sign * (
        source.metres * stated_target if _slides(prim) else math.radians(stated_target)
    )
    try:
        stated = json.loads(source.text(command) or "null")
    except ValueError as error:
        raise source.fault(command, f"is not JSON: {error}") from None
    return motor | {
        "command": stated
        or {"kind": "sampled", "times_s": (0.0, 1.0), "values": (target, target)}
    }
