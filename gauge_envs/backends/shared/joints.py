"""Joints of a scene, for every engine: start rates, motors, rotors, and which terms one drive of an engine can be."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from gauge_envs.backends.shared.rigid import hinges_by_body, world_hinges
from gauge_envs.scene import BodyHinge, Hinge, JointDynamics, Pose, Scene, Sphere
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.hinged import (
    hinge_trees,
    joint_sign,
    other_end,
    parent_hinges,
    start_rate_rad_per_s,
)
from gauge_envs.scene.motors import Motor, Servo

BRAKE_RATE_RAD_PER_S = 1e-5
"""Rate up to which a brake that is a joint's dry friction is viscous [rad/s]."""

ROTOR_SHARE = 1e-3
"""Mass of a rotor over that of its body, and inertia of this mass over the armature, which has the rest."""


@dataclass(frozen=True, kw_only=True)
class PlayHinge(BodyHinge):
    """Hinge of a rotor and the body that it turns, free up to a stop at an angle to either side [rad]."""

    stop_rad: float


def with_rotors(scene: Scene) -> Scene:
    """Return a scene in which each rotor with play is a body, for engines with one joint for each body."""
    for number, hinge in enumerate(scene.hinges):
        if not hinge.dynamics.backlash_rad:
            continue
        body = scene.body(hinge.body if isinstance(hinge, Hinge) else hinge.second)
        mass_kg, armature = ROTOR_SHARE * body.mass_kg, hinge.dynamics.armature_kg_m2
        arm_m, spin = (
            np.subtract(hinge.anchor_m, body.pose.position_m),
            body.angular_velocity_rad_per_s,
        )
        rotor = replace(
            body,
            name=f"{body.name}/rotor{number}",
            shape=Sphere(
                radius_m=float(np.sqrt(2.5 * ROTOR_SHARE * armature / mass_kg))
            ),
            pose=Pose(position_m=hinge.anchor_m),
            mass_kg=mass_kg,
            inertia_kg_m2=None,
            linear_velocity_m_per_s=vector(
                body.linear_velocity_m_per_s + np.cross(spin, arm_m)
            ),
        )
        place: dict[str, Any] = {"anchor_m": hinge.anchor_m, "axis": hinge.axis}
        play = PlayHinge(
            first=rotor.name,
            second=body.name,
            stop_rad=0.5 * hinge.dynamics.backlash_rad,
            **place,
        )
        terms = replace(
            hinge.dynamics,
            armature_kg_m2=(1.0 - ROTOR_SHARE) * armature,
            backlash_rad=0.0,
        )
        end: dict[str, Any] = {
            "body" if isinstance(hinge, Hinge) else "second": rotor.name
        }
        turned: Any = replace(hinge, dynamics=terms, **end)
        joints = tuple(turned if one is hinge else one for one in scene.joints)
        inner = (*(turned if one is hinge else one for one in scene.body_hinges), play)
        scene = replace(
            scene, bodies=(*scene.bodies, rotor), joints=joints, body_hinges=inner
        )
    return scene


class JointMotor(NamedTuple):
    """A motor of a scene.

    Attributes:
        body: Name of the body that its hinge turns, relative to what the body hangs on.
        hinge: The hinge.
        motor: The motor.
        sign: -1 where the hinge's angle counts the other way, otherwise 1.
    """

    body: str
    hinge: Hinge | BodyHinge
    motor: Motor
    sign: float

    @property
    def is_drive(self) -> bool:
        """Whether the motor is what `drive_of` returns."""
        return (
            isinstance(self.motor, Servo) and not self.hinge.dynamics.dry_friction_n_m
        )

    def torque_n_m(
        self, command: float, angle_rad: float, rate_rad_per_s: float
    ) -> float:
        """Return the torque on the body for a command, and an angle and a rate of the body about the axis [N m]."""
        if isinstance(self.motor, Servo):
            return self.motor.torque_n_m(self.sign * command, angle_rad, rate_rad_per_s)
        return self.sign * command


def joint_motors(scene: Scene) -> list[JointMotor]:
    """Return the motors of a scene, in the order of commands."""
    names = {id(hinge): name for name, hinge in hinges_by_body(scene).items()}
    bodies = ((names[id(hinge)], hinge, motor) for hinge, motor in scene.motors)
    return [
        JointMotor(name, hinge, motor, joint_sign(hinge, name))
        for name, hinge, motor in bodies
    ]


def drive_of(hinge: Hinge | BodyHinge) -> tuple[float, float, float]:
    """Return what the one drive of a joint is: its dry friction, as a brake, or else its servo.

    Returns:
        Torque per angle [N m/rad], torque per rate [N m s/rad], and the largest torque [N m]; zeros without both.
    """
    dry, motor = hinge.dynamics.dry_friction_n_m, hinge.motor
    if dry:
        return 0.0, dry / BRAKE_RATE_RAD_PER_S, dry
    if isinstance(motor, Servo):
        return (
            motor.kp_n_m_per_rad,
            motor.kv_n_m_s_per_rad,
            motor.torque_limit_n_m or np.inf,
        )
    return 0.0, 0.0, np.inf


def stops_rad(hinge: Hinge | BodyHinge) -> tuple[float, float]:
    """Return the smallest and the largest angle of a hinge [rad]; infinite without limits."""
    if isinstance(hinge, PlayHinge):
        return -hinge.stop_rad, hinge.stop_rad
    limits = hinge.limits_rad if isinstance(hinge, Hinge) else None
    return limits or (-np.inf, np.inf)


def joint_rate_rad_per_s(scene: Scene, body: str, hinge: Hinge | BodyHinge) -> float:
    """Return the rate of a body about its hinge at the start, relative to what it hangs on."""
    turned = scene.body(body)
    if isinstance(hinge, BodyHinge):
        return start_rate_rad_per_s(hinge, turned, scene.body(other_end(hinge, body)))
    return float(np.dot(turned.angular_velocity_rad_per_s, hinge.axis))


def has_terms(hinge: Hinge | BodyHinge) -> bool:
    """Return whether a joint has friction, armature or a motor."""
    return hinge.motor is not None or hinge.dynamics != JointDynamics()


def linked_hinges(scene: Scene, single: bool) -> dict[str, Hinge | BodyHinge | None]:
    """Return the hinges of the bodies that an engine builds in reduced coordinates; None for the free root of a tree.

    Two free bodies whose hinge turns freely are joined by a constraint.

    Args:
        scene: The scene.
        single: Whether a body on a hinge to the world alone is one of them, although it turns freely.

    Returns:
        By name of the body, parents first.
    """
    hung = world_hinges(scene)
    linked: dict[str, Hinge | BodyHinge | None] = {}
    for tree in hinge_trees(scene.body_hinges):
        below = parent_hinges(tree, scene.hung)
        name, hinge = next(iter(below.items()))
        root = other_end(hinge, name)
        if root in hung or any(map(has_terms, tree)):
            linked[root] = hung.get(root)
            linked.update(below)
    for name, hanging in hung.items():
        if single or has_terms(hanging) or hanging.limits_rad is not None:
            linked.setdefault(name, hanging)
    return linked
