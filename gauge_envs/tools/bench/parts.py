"""Bodies, contacts and motions for the scenes of the bench and of the checks."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.scene import (
    Box,
    Contact,
    ContactMode,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Shape,
    Sphere,
    Vector,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scene.profiles import TrapezoidProfile


def corners(low_m: Vector, high_m: Vector) -> tuple[Vector, ...]:
    """Return the corners of a block between two opposite corners [m]."""
    return tuple(map(vector, product(*zip(low_m, high_m, strict=True))))


def body(
    name: str,
    shape: Shape,
    pose: Pose,
    *,
    mass_kg: float = 0.1,
    motion: Motion = Motion.DYNAMIC,
) -> RigidBody:
    """Return a rigid body, dynamic by default."""
    return RigidBody(name=name, shape=shape, motion=motion, pose=pose, mass_kg=mass_kg)


def ball(
    name: str, position_m: Vector, *, radius_m: float = 0.03, mass_kg: float = 0.1
) -> RigidBody:
    """Return a dynamic sphere."""
    return body(
        name, Sphere(radius_m=radius_m), Pose(position_m=position_m), mass_kg=mass_kg
    )


def box(
    name: str,
    position_m: Vector,
    size_m: Vector,
    *,
    euler_deg: Vector = (0.0, 0.0, 0.0),
    mass_kg: float = 0.2,
) -> RigidBody:
    """Return a dynamic box."""
    return body(
        name,
        Box(size_m=size_m),
        Pose.from_euler_deg(position_m, euler_deg),
        mass_kg=mass_kg,
    )


def fixed_box(
    name: str,
    position_m: Vector,
    size_m: Vector,
    *,
    euler_deg: Vector = (0.0, 0.0, 0.0),
) -> RigidBody:
    """Return a fixed box."""
    dynamic = box(name, position_m, size_m, euler_deg=euler_deg, mass_kg=1.0)
    return replace(dynamic, motion=Motion.FIXED)


def driven_box(
    name: str,
    position_m: Vector,
    size_m: Vector,
    *,
    euler_deg: Vector = (0.0, 0.0, 0.0),
) -> RigidBody:
    """Return a box with prescribed motion."""
    return replace(
        fixed_box(name, position_m, size_m, euler_deg=euler_deg),
        motion=Motion.KINEMATIC,
    )


def thrown(
    body: RigidBody, velocity: ArrayLike, spin: ArrayLike = (0.0, 0.0, 0.0)
) -> RigidBody:
    """Return a body that starts with a velocity [m/s] and an angular velocity [rad/s]."""
    return replace(
        body,
        linear_velocity_m_per_s=vector(velocity),
        angular_velocity_rad_per_s=vector(spin),
    )


def ground() -> RigidBody:
    """Return a horizontal plane at height 0."""
    return body(
        "ground",
        Plane(),
        Pose(position_m=(0.0, 0.0, 0.0)),
        mass_kg=0.0,
        motion=Motion.FIXED,
    )


def contact(
    first: str | tuple[str, ...],
    second: str | tuple[str, ...],
    *,
    friction: float,
    restitution: float | None = None,
) -> Contact:
    """Return a contact between bodies: an impact with a restitution, or a sustained contact without."""
    first, second = (
        (names,) if isinstance(names, str) else names for names in (first, second)
    )
    if restitution is None:
        return Contact(first=first, second=second, friction=friction, restitution=0.0)
    return Contact(
        first=first,
        second=second,
        friction=friction,
        restitution=restitution,
        mode=ContactMode.IMPACT,
    )


def ramp(
    amount: float, *, start_s: float, duration_s: float, ramp_s: float
) -> TrapezoidProfile:
    """Return a motion by an amount [m or rad], with equal times of acceleration and braking."""
    return TrapezoidProfile(
        start_s=start_s,
        duration_s=duration_s,
        accelerate_s=ramp_s,
        brake_s=ramp_s,
        amount=amount,
    )


def driver(
    name: str,
    kind: Literal["translate", "rotate"],
    axis: Vector,
    *profiles: TrapezoidProfile,
    point_m: Vector = (0.0, 0.0, 0.0),
) -> Driver:
    """Return a prescribed motion of one body along or about one axis."""
    motion = DriverMotion(kind=kind, axis=axis, profiles=profiles, point_m=point_m)
    return Driver(body=name, motions=(motion,), provenance="nominal")


def box_inertia_kg_m2(body: RigidBody) -> FloatArray:
    """Return the moments of inertia of a solid box about its own axes [kg m^2], shape [3]."""
    assert isinstance(body.shape, Box), "the body is a box"
    x, y, z = np.square(body.shape.size_m)
    return body.mass_kg / 12.0 * np.array([y + z, x + z, x + y])
