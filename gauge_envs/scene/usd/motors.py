"""Friction, armature and motors of hinges in USD layers.

Friction and armature have the names of MuJoCo's schema, which are doubles per radian; armature has that of PhysX too. A
servo is an angular drive of UsdPhysics, per degree and in single precision, beside exact `gauge:` doubles.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from functools import partial
from typing import Annotated, Any

import numpy as np
from pxr import Sdf, Usd, UsdPhysics
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.errors import first_fault
from gauge_envs.scene.bodies import BodyHinge, Hinge, JointDynamics
from gauge_envs.scene.motors import Motor, Servo
from gauge_envs.scene.usd.layer import record_follower, record_written
from gauge_envs.scene.usd.source import Source

PHYSX_ARMATURE = "physxJoint:armature"

DYNAMICS = {
    "dry_friction_n_m": "mjc:frictionloss",
    "viscous_friction_n_m_s_per_rad": "mjc:damping",
    "armature_kg_m2": "mjc:armature",
}
"""Attributes of friction and armature, by field of `JointDynamics`."""

DRIVE = {
    "kp_n_m_per_rad": ("drive:angular:physics:stiffness", math.degrees(1.0)),
    "kv_n_m_s_per_rad": ("drive:angular:physics:damping", math.degrees(1.0)),
    "torque_limit_n_m": ("drive:angular:physics:maxForce", 1.0),
}
"""Attribute of a drive, and factor from its unit to SI, by field of `Servo`."""

UNREAD = ("physxJoint:jointFriction", "mjc:stiffness", "drive:angular:physics:targetVelocity")
"""Attributes with physics that joints of a scene do not have, unless they are 0."""


class _Terms(BaseModel):
    """Fields of `Hinge` and `BodyHinge`."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    dynamics: JointDynamics
    motor: Annotated[Motor, Field(discriminator="kind")] | None


def _set(prim: Usd.Prim, name: str, value: Any, kind: str = "double") -> Usd.Attribute:
    attribute = prim.CreateAttribute(name, Sdf.ValueTypeNames.Find(kind), custom=name.startswith("gauge:"))
    attribute.Set(value)
    return attribute


def write_terms(prim: Usd.Prim, hinge: Hinge | BodyHinge) -> None:
    """Write friction, armature and motor of a hinge."""
    for field, name in DYNAMICS.items():
        if value := getattr(hinge.dynamics, field):
            prim.AddAppliedSchema("MjcJointAPI")
            double = _set(prim, name, value)
            if field == "armature_kg_m2":
                prim.AddAppliedSchema("PhysxJointAPI")
                record_written(double, _set(prim, PHYSX_ARMATURE, value, "float").Get())
    if (motor := hinge.motor) is None:
        return
    _set(prim, "gauge:motor", motor.kind, "token")
    _set(prim, "gauge:command", json.dumps(asdict(motor.command), allow_nan=False), "string")
    if isinstance(motor, Servo):
        drive = UsdPhysics.DriveAPI.Apply(prim, "angular")
        record_follower(drive.CreateTargetPositionAttr(math.degrees(motor.command.value(0.0))), "gauge:command")
    for field, value in asdict(motor).items():
        if isinstance(value, float):
            double = _set(prim, f"gauge:{field}", value)
            if field in DRIVE:
                name, factor = DRIVE[field]
                record_written(double, _set(prim, name, value / factor, "float").Get() * factor)


def read_terms(source: Source, prim: Usd.Prim, sign: float = 1.0) -> dict[str, Any]:
    """Return the fields `dynamics` and `motor` of the hinge of a revolute joint.

    Args:
        source: The stage.
        prim: The joint. A drive of another tool holds its target.
        sign: 1 where the hinge turns as the joint, -1 where the other way.
    """
    for attribute in map(prim.GetAttribute, UNREAD):
        if attribute and source.number(attribute):
            raise source.fault(attribute, f"unsupported joint: it is {attribute.Get()}, and a scene has no such term")
    unit, dynamics = source.kilograms * source.metres**2, {}
    for field, name in DYNAMICS.items():
        other = [source.reading(prim.GetAttribute(PHYSX_ARMATURE))] if field == "armature_kg_m2" else []
        if (value := source.counted(prim.GetAttribute(name), other)) is not None:
            dynamics[field] = unit * float(value)
    drive = UsdPhysics.DriveAPI(prim, "angular")
    kind = source.text(prim.GetAttribute("gauge:motor")) or ("servo" if drive else None)
    motor = None if kind is None else {"kind": kind} | _motor(source, prim, drive, unit, sign)
    try:
        terms = _Terms.model_validate({"dynamics": dynamics, "motor": motor})
    except ValidationError as error:
        raise source.fault(prim, ": ".join(first_fault(error))) from None
    return {"dynamics": terms.dynamics, "motor": terms.motor}


def _motor(source: Source, prim: Usd.Prim, drive: UsdPhysics.DriveAPI, unit: float, sign: float) -> dict[str, Any]:
    """Return the fields of a motor."""
    source.text(drive.GetTypeAttr(), ("force",))
    motor: dict[str, Any] = {"delay_s": source.number(prim.GetAttribute("gauge:delay_s")) or 0.0}
    for field, (name, factor) in DRIVE.items():
        standard = prim.GetAttribute(name)
        is_given = standard and standard.Get() != math.inf
        reading = source.reading(standard, (), partial(np.multiply, factor * unit)) if is_given else None
        if (value := source.counted(prim.GetAttribute(f"gauge:{field}"), [reading])) is not None:
            motor[field] = float(value)
    command = prim.GetAttribute("gauge:command")
    target = sign * math.radians(source.number(drive.GetTargetPositionAttr()) or 0.0)
    try:
        stated = json.loads(source.text(command) or "null")
    except ValueError as error:
        raise source.fault(command, f"is not JSON: {error}") from None
    return motor | {"command": stated or {"kind": "sampled", "times_s": (0.0, 1.0), "values": (target, target)}}
