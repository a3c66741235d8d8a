"""Faults of one side, place in a list, mass or length, planted in MuJoCo: which checks see them.

    python -m studies.planted_faults.sides      two minutes of processor time

Each holds in a part of space, for one sign or from some number on. None was listed or drawn before; some of them
helped to choose the scene of `copies-alike`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import backend
from gauge_envs.scene import Box, Hinge, Motion, Pose, RigidBody, Scene, Tether
from gauge_envs.scene.bodies import Contact
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.motors import Servo
from gauge_envs.tools.conformance import checks, run_checks

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from mutations import FAILS_ITSELF, Mutant
from mutations.mutant import Fault, Passed

CHECK = "copies-alike"
SOFT = re.compile(r"^(cloth|air|foam|rope|rod|soft)-")
Joint = Hinge | Tether


def _joints(change: Callable[[Joint], Joint]) -> Callable[[Scene], Scene]:
    return lambda scene: replace(scene, joints=tuple(map(change, scene.joints)))


def _weak_servo(one: Joint) -> Joint:
    if not isinstance(one, Hinge) or not isinstance(one.motor, Servo):
        return one
    limit = one.motor.torque_limit_n_m
    if limit is None or one.axis[2] >= 0.0:
        return one
    return replace(one, motor=replace(one.motor, torque_limit_n_m=0.7 * limit))


def _viscous(one: Joint) -> Joint:
    if not isinstance(one, Hinge) or max(one.axis, key=abs) >= 0.0:
        return one
    viscous = 1.5 * one.dynamics.viscous_friction_n_m_s_per_rad
    return replace(
        one, dynamics=replace(one.dynamics, viscous_friction_n_m_s_per_rad=viscous)
    )


def _moved_anchor(one: Joint) -> Joint:
    x, y, z = one.anchor_m
    if not isinstance(one, Hinge) or x <= 0.0 or y >= 0.0:
        return one
    return replace(one, anchor_m=(x + 0.002, y, z))


def _long_string(one: Joint) -> Joint:
    if not isinstance(one, Tether) or one.anchor_m[0] >= 0.0:
        return one
    return replace(one, length_m=one.length_m + 0.003)


def _tired_servo(one: Joint) -> Joint:
    if not isinstance(one, Hinge) or not isinstance(one.motor, Servo):
        return one
    limit = one.motor.torque_limit_n_m
    return replace(
        one, motor=replace(one.motor, torque_limit_n_m=min(limit or 1.0, 1.0))
    )


def _short_string(one: Joint) -> Joint:
    if not isinstance(one, Tether) or one.length_m < 0.4:
        return one
    return replace(one, length_m=0.98 * one.length_m)


def _bodies(
    change: Callable[[int, RigidBody], RigidBody],
) -> Callable[[Scene], Scene]:
    return lambda scene: replace(
        scene, bodies=tuple(change(*pair) for pair in enumerate(scene.bodies))
    )


def _light(_: int, one: RigidBody) -> RigidBody:
    is_heavy = one.motion is Motion.DYNAMIC and one.mass_kg > 0.6
    return replace(one, mass_kg=0.9 * one.mass_kg) if is_heavy else one


def _slow_spin(number: int, one: RigidBody) -> RigidBody:
    if number < 12:
        return one
    spin = 0.97 * np.array(one.angular_velocity_rad_per_s)
    return replace(one, angular_velocity_rad_per_s=vector(spin))


def _positive_scalar(_: int, one: RigidBody) -> RigidBody:
    w, x, y, z = one.pose.quaternion
    return replace(
        one, pose=Pose(position_m=one.pose.position_m, quaternion=(abs(w), x, y, z))
    )


def _contacts(
    change: Callable[[int, Contact, Scene], Contact],
) -> Callable[[Scene], Scene]:
    return lambda scene: replace(
        scene,
        contacts=tuple(
            change(number, one, scene) for number, one in enumerate(scene.contacts)
        ),
    )


def _slippery_below(_: int, one: Contact, scene: Scene) -> Contact:
    known = {body.name: body for body in scene.bodies}
    bodies = [known[name] for name in (*one.first, *one.second) if name in known]
    looks_down = any(
        body.motion is not Motion.DYNAMIC and body.pose.rotation.as_matrix()[2, 2] < 0.0
        for body in bodies
    )
    return replace(one, friction=0.9 * one.friction) if looks_down else one


def _late_pair(number: int, one: Contact, _: Scene) -> Contact:
    if number < 5:
        return one
    return replace(one, restitution=max(0.0, one.restitution - 0.05))


def _slippery_large(_: int, one: Contact, scene: Scene) -> Contact:
    known = {body.name: body for body in scene.bodies}
    bodies = [known[name] for name in (*one.first, *one.second) if name in known]
    is_large = any(
        body.motion is Motion.DYNAMIC
        and isinstance(body.shape, Box)
        and np.prod(body.shape.size_m) > 0.002
        for body in bodies
    )
    return replace(one, friction=0.8 * one.friction) if is_large else one


class _FastDriver(Passed):
    def drive(self, body: str, pose: Pose, velocity: Any, acceleration: Any) -> None:
        velocity = np.array(velocity)
        velocity[:3] *= 0.95 if np.linalg.norm(velocity[:3]) > 2.0 else 1.0
        self.inner.drive(body, pose, velocity, acceleration)


class _LateDriver(Passed):
    def drive(self, body: str, pose: Pose, velocity: Any, acceleration: Any) -> None:
        driven = [
            one.name for one in self.scene.bodies if one.motion is Motion.KINEMATIC
        ]
        factor = 0.95 if driven.index(body) >= 3 else 1.0
        self.inner.drive(body, pose, factor * np.array(velocity), acceleration)


class _SideOfDriver(Passed):
    def drive(self, body: str, pose: Pose, velocity: Any, acceleration: Any) -> None:
        velocity = np.array(velocity)
        velocity[3] *= 0.9 if velocity[3] < 0.0 else 1.0
        self.inner.drive(body, pose, velocity, acceleration)


class _ServoRate(Passed):
    def advance(self, seconds: float) -> None:
        model, data = self.inner.model, self.inner.data
        gains = model.actuator_biasprm.copy()
        model.actuator_biasprm[data.actuator_velocity < 0.0, 2] *= 0.5
        super().advance(seconds)
        model.actuator_biasprm[:] = gains


def _of_free_bodies(
    change: Callable[[NDArray[np.float64], NDArray[np.float64]], None],
) -> type[Passed]:
    """Return a simulation that changes velocity and spin (world frame) of free bodies, which also get their places."""

    class Changed(Passed):
        def advance(self, seconds: float) -> None:
            super().advance(seconds)
            model, data = self.inner.model, self.inner.data
            for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
                rates = slice(model.jnt_dofadr[joint], model.jnt_dofadr[joint] + 6)
                place = slice(model.jnt_qposadr[joint], model.jnt_qposadr[joint] + 3)
                axes = data.xmat[model.jnt_bodyid[joint]].reshape(3, 3)
                state = data.qvel[rates].copy()
                state[3:] = axes @ state[3:]
                change(state, data.qpos[place])
                state[3:] = axes.T @ state[3:]
                data.qvel[rates] = state

    return Changed


def _damped_side(state: NDArray[np.float64], _: NDArray[np.float64]) -> None:
    state[4] *= 0.995 if state[4] < -0.5 else 1.0


def _pulled_side(state: NDArray[np.float64], place_m: NDArray[np.float64]) -> None:
    state[2] += 0.05 / 180.0 if place_m[1] < -0.6 else 0.0


FAULTS: Mapping[str, Mapping[str, Any]] = {
    "servo limit 30 % low, axis downward": {"scene": _joints(_weak_servo)},
    "viscous friction 1.5 times, axis negative": {"scene": _joints(_viscous)},
    "anchors of hinges 2 mm off in a quadrant": {"scene": _joints(_moved_anchor)},
    "strings 3 mm long at negative x": {"scene": _joints(_long_string)},
    "bodies above 0.6 kg 10 % light": {"scene": _bodies(_light)},
    "spin 3 % low from the 13th body on": {"scene": _bodies(_slow_spin)},
    "quaternions' negative scalar made positive": {"scene": _bodies(_positive_scalar)},
    "friction 10 % low under what looks down": {"scene": _contacts(_slippery_below)},
    "restitution 0.05 low from the 6th pair on": {"scene": _contacts(_late_pair)},
    "velocity 5 % low from the 4th driver on": {"simulation": _LateDriver},
    "spin of drivers about -x 10 % low": {"simulation": _SideOfDriver},
    "servo gain halved at negative rates": {"simulation": _ServoRate},
    "spin about -y damped": {"simulation": _of_free_bodies(_damped_side)},
    "pull upward at y < -0.6 m": {"simulation": _of_free_bodies(_pulled_side)},
    "servo torque of at most 1 N m": {"scene": _joints(_tired_servo)},
    "strings above 0.4 m 2 % short": {"scene": _joints(_short_string)},
    "friction 20 % low on boxes above 2 litres": {"scene": _contacts(_slippery_large)},
    "velocity 5 % low of drivers above 2 m/s": {"simulation": _FastDriver},
}


def first_failure(fault: Fault, names: list[str]) -> str:
    """Return the first check that fails on a fault in MuJoCo, and not on the healthy engine; `-` without one."""
    mutant = Mutant(backend("mujoco"), fault)
    known = FAILS_ITSELF["mujoco"]
    results = run_checks(mutant, only=names, eliminates=False)
    return next(
        (one.check for one in results if one.is_bad and one.check not in known), "-"
    )


def main() -> None:
    """Print for each fault whether the copies see it, and which other check does first."""
    others = [one.id for one in checks() if one.id != CHECK and not SOFT.match(one.id)]
    for what, how in FAULTS.items():
        fault = Fault(what=what, caught_by="", says="", engine="mujoco", **how)
        print(
            f"{what} | {first_failure(fault, [CHECK])} | {first_failure(fault, others)}",
            flush=True,
        )


if __name__ == "__main__":
    main()
