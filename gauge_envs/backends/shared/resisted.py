"""Friction of joints for which an engine has no term: drag, and what dry friction gains with load and loses with rate.

Before each step the state is read, and the torques of friction act on both bodies of a joint through it. Drag is that
of the rate before the step, an error of the order of a step. Dry friction is the torque that stops the joint at the end
of the step, and at most what the law holds, with the mass matrix M and the torques c of gravity and rotation:

    M rate' = motor + friction - viscous rate - c

Bodies in contact are not part of the load, and a servo's torque is that of the state before the step.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.shared.joints import joint_motors, linked_hinges
from gauge_envs.backends.shared.rigid import DrivenMotion
from gauge_envs.backends.shared.wrapped import WrappedSimulation
from gauge_envs.backends.world import Simulation
from gauge_envs.errors import BackendError
from gauge_envs.scene import BodyHinge, Hinge, Pose, Scene, body_mass_properties
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.hinged import hinge_angle_rad, hinge_frames, other_end
from gauge_envs.scene.motors import Servo

SWEEPS = 20
"""Rounds over the joints of a scene in which each is stopped with the friction of the others."""


class _Joint(NamedTuple):
    """A joint of a scene.

    Attributes:
        hinge: The hinge.
        row: Row of the body that it turns.
        parent: Row of what this body hangs on; -1 for the world.
        anchor_m: Point of the axis in the frame of the body [m], shape [3].
        axis: Direction of the axis in the frame of the body, shape [3].
    """

    hinge: Hinge | BodyHinge
    row: int
    parent: int
    anchor_m: FloatArray
    axis: FloatArray


class ResistedSimulation(WrappedSimulation):
    """A simulation whose joints have friction that the engine has not.

    Attributes:
        inner: The simulation without it.

    Args:
        scene: The scene with this friction.
        inner: A simulation of the scene without it.
        drags: Whether quadratic friction is part of it.
    """

    def __init__(self, scene: Scene, inner: Simulation, *, drags: bool) -> None:
        super().__init__(inner)
        self._scene, self._step_s = scene, float(inner.settings["timestep_s"])
        linked = linked_hinges(scene, single=True)
        self._names = list(linked)
        self._joints: list[_Joint] = []
        for row, (name, hinge) in enumerate(linked.items()):
            if hinge is None:
                continue
            pose, parent = scene.body(name).pose, -1
            if isinstance(hinge, BodyHinge):
                parent = self._names.index(other_end(hinge, name))
            axis = pose.rotation.apply(hinge.axis, inverse=True)
            anchor_m = pose.to_body(np.asarray(hinge.anchor_m))
            self._joints.append(_Joint(hinge, row, parent, anchor_m, axis))
        bodies = [scene.body(name) for name in self._names]
        self._masses = np.array([body.mass_kg for body in bodies])
        properties = [body_mass_properties(body) for body in bodies]
        self._centres = np.array([centre for centre, _ in properties])
        self._inertias = np.array([inertia for _, inertia in properties])
        terms = [one.hinge.dynamics for one in self._joints]
        self._drags = np.array(
            [one.quadratic_friction_n_m_s2_per_rad2 * drags for one in terms]
        )
        self._viscous = np.array([one.viscous_friction_n_m_s_per_rad for one in terms])
        self._armatures = np.array([one.armature_kg_m2 for one in terms])
        self._laws = {
            place: one.servo.holding(one.dry_friction_n_m)
            for place, one in enumerate(terms)
            if one.servo
        }
        self._motors = joint_motors(scene)
        self._start()

    def _start(self) -> None:
        self._commands = np.zeros(len(self._motors))
        self._wrenches: dict[str, FloatArray] = {}
        self._motions: dict[str, DrivenMotion] = {}

    def reset(self, seed: int) -> None:
        """Return to the scene's start."""
        self.inner.reset(seed)
        self._start()

    def drive(
        self, body: str, pose: Pose, velocity: FloatArray, acceleration: FloatArray
    ) -> None:
        """Prescribe the motion of a kinematic body; see `World.drive`."""
        self._motions[body] = DrivenMotion.copied(pose, velocity, acceleration)
        self.inner.drive(body, pose, velocity, acceleration)

    def command(self, values: FloatArray) -> None:
        """Set what the motors follow; see `World.command`."""
        self._commands = np.array(values, dtype=float)
        self.inner.command(values)

    def apply_wrench(self, body: str, wrench: FloatArray) -> None:
        """Apply a force and a torque; see `World.apply_wrench`."""
        self._wrenches[body] = np.array(wrench, dtype=float)
        self.inner.apply_wrench(body, wrench)

    def advance(self, seconds: float) -> None:
        """Simulate an interval [s], step by step."""
        for step in range(round(seconds / self._step_s)):
            time_s = step * self._step_s
            for body, motion in self._motions.items() if step else ():
                velocity = motion.velocity_at(time_s)
                self.inner.drive(
                    body, motion.pose(time_s), velocity, motion.acceleration
                )
            for name, torque in self._torques().items():
                wrench = self._wrenches.get(name, np.zeros(6)).copy()
                wrench[3:] += torque
                self.inner.apply_wrench(name, wrench)
            self.inner.advance(self._step_s)
        self._motions = {}

    def state(self) -> Any:
        """Return a snapshot of the engine, the commands and the wrenches."""
        terms = [one.hinge.dynamics for one in self._joints]
        laws = [(*vars(one).items(),) for one in terms]
        wrenches = {name: one.copy() for name, one in self._wrenches.items()}
        return laws, self.inner.state(), self._commands.copy(), wrenches

    def restore(self, state: Any) -> None:
        """Restore a snapshot of a simulation whose joints have the same friction."""
        laws, inner, commands, wrenches = state
        if laws != [(*vars(one.hinge.dynamics).items(),) for one in self._joints]:
            raise BackendError(
                "the state is from a simulation whose joints have other friction: build that simulation"
            )
        self.inner.restore(inner)
        self._start()
        self._commands = commands.copy()
        self._wrenches = {name: one.copy() for name, one in wrenches.items()}

    def accelerations(self) -> FloatArray:
        """Return the accelerations of the joints without friction and motors [rad/s^2], shape [joint_count]."""
        mass, loads, _ = self._dynamics(*self._motion())
        return np.asarray(np.linalg.solve(mass, loads)[: len(self._joints)])

    def _motion(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return states and rotations of the bodies, and axes and rates of the joints [rad/s]."""
        states = self.inner.body_states(self._names)
        turns = Rotation.from_quat(states[:, 3:7], scalar_first=True).as_matrix()
        axes = np.array([turns[one.row] @ one.axis for one in self._joints])
        spins = np.vstack([states[:, 10:], np.zeros(3)])
        rows, parents = (
            [getattr(one, name) for one in self._joints] for name in ("row", "parent")
        )
        rates = np.einsum("ji,ji->j", axes, spins[rows] - spins[parents])
        return states, turns, axes, rates

    def _torques(self) -> dict[str, FloatArray]:
        """Return the torque of friction on each body in the next step [N m], in the world frame, shape [3]."""
        states, turns, axes, rates = self._motion()
        torques = -self._drags * np.abs(rates) * rates
        if self._laws:
            torques += self._dry_n_m(states, turns, axes, rates, torques)
        found = {name: np.zeros(3) for name in self._names}
        for one, axis, torque in zip(self._joints, axes, torques, strict=True):
            found[self._names[one.row]] += torque * axis
            if one.parent >= 0:
                found[self._names[one.parent]] -= torque * axis
        return found

    def _dry_n_m(
        self,
        states: FloatArray,
        turns: FloatArray,
        axes: FloatArray,
        rates: FloatArray,
        drags: FloatArray,
    ) -> FloatArray:
        """Return the torque of dry friction with a law at each joint [N m], shape [joint_count]."""
        count, step_s = len(self._joints), self._step_s
        mass, loads, root_rates = self._dynamics(states, turns, axes, rates)
        motors = self._motor_n_m(states, rates)
        rest = np.zeros(len(mass))
        rest[:count] = motors + drags - self._viscous * rates
        inverse = np.linalg.inv(mass)
        free = np.concatenate([rates, root_rates]) + step_s * inverse @ (rest + loads)
        torques = np.zeros(len(mass))
        holding_n_m = {
            place: law(float(rates[place]), float(motors[place]), float(loads[place]))
            for place, law in self._laws.items()
        }
        for _ in range(SWEEPS if len(holding_n_m) > 1 else 1):
            for place, limit_n_m in holding_n_m.items():
                rate = free[place] + step_s * inverse[place] @ torques
                stops = torques[place] - rate / (step_s * inverse[place, place])
                torques[place] = min(max(stops, -limit_n_m), limit_n_m)
        return torques[:count]

    def _motor_n_m(self, states: FloatArray, rates: FloatArray) -> FloatArray:
        """Return the torque of the motor of each joint for the state before a step [N m], shape [joint_count]."""
        torques = np.zeros(len(self._joints))
        places = {id(one.hinge): place for place, one in enumerate(self._joints)}
        for motor, value in zip(self._motors, self._commands.tolist(), strict=True):
            place = places[id(motor.hinge)]
            angle = 0.0
            if isinstance(motor.motor, Servo):
                angle = self._angle_rad(self._joints[place], states)
            torques[place] = motor.torque_n_m(value, angle, float(rates[place]))
        return torques

    def _angle_rad(self, joint: _Joint, states: FloatArray) -> float:
        """Return the angle from the start by which a joint turned its body [rad], from -pi to pi."""
        hinge, scene = joint.hinge, self._scene
        carrier, turn = Pose(position_m=(0.0, 0.0, 0.0)), Rotation.identity()
        if joint.parent >= 0:
            carrier = scene.body(self._names[joint.parent]).pose
            turn = Rotation.from_quat(states[joint.parent, 3:7], scalar_first=True)
        place: dict[str, Any] = {"anchor_m": hinge.anchor_m, "axis": hinge.axis}
        joined = BodyHinge(first="", second=self._names[joint.row], **place)
        frames = hinge_frames(joined, carrier, scene.body(self._names[joint.row]).pose)
        turned = Rotation.from_quat(states[joint.row, 3:7], scalar_first=True)
        return float(hinge_angle_rad(frames, turn, turned))

    def _dynamics(
        self, states: FloatArray, turns: FloatArray, axes: FloatArray, rates: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return mass matrix [kg m^2], torques of weights, rotation and wrenches [N m], and velocities of free roots.

        The unknowns are the rates of the joints and, behind them, velocity and angular velocity of each free root.
        """
        bodies, count = len(self._names), len(self._joints)
        hung = {one.row for one in self._joints}
        roots = [row for row in range(bodies) if row not in hung]
        size = count + 6 * len(roots)
        centres = states[:, :3] + np.einsum("bij,bj->bi", turns, self._centres)
        turning, moving = np.zeros((2, bodies, 3, size))
        # Accelerations of the bodies at constant rates of all joints.
        spun, sped = np.zeros((2, bodies, 3))
        velocities = []
        for number, row in enumerate(roots):
            first = count + 6 * number
            moving[row, :, first : first + 3] = np.eye(3)
            turning[row, :, first + 3 : first + 6] = np.eye(3)
            arm_m = centres[row] - states[row, :3]
            speed = states[row, 7:10] + np.cross(states[row, 10:], arm_m)
            velocities += [*speed, *states[row, 10:]]
        # Parents come first.
        for place, (one, axis) in enumerate(zip(self._joints, axes, strict=True)):
            row, parent = one.row, one.parent
            anchor_m = states[row, :3] + turns[row] @ one.anchor_m
            arm_m, spin = centres[row] - anchor_m, states[row, 10:]
            if parent >= 0:
                reach_m, old_spin = anchor_m - centres[parent], states[parent, 10:]
                turning[row] = turning[parent]
                moving[row] = moving[parent] + np.cross(
                    turning[parent], (centres[row] - centres[parent])[:, None], axis=0
                )
                spun[row] = spun[parent] + rates[place] * np.cross(old_spin, axis)
                sped[row] = sped[parent] + np.cross(spun[parent], reach_m)
                sped[row] += np.cross(old_spin, np.cross(old_spin, reach_m))
            turning[row, :, place] += axis
            moving[row, :, place] += np.cross(axis, arm_m)
            sped[row] += np.cross(spun[row], arm_m)
            sped[row] += np.cross(spin, np.cross(spin, arm_m))
        mass = np.zeros((size, size))
        mass[np.arange(count), np.arange(count)] = self._armatures
        loads = np.zeros(size)
        fall = np.array([0.0, 0.0, self._scene.gravity_m_per_s2])
        for row, name in enumerate(self._names):
            spin = states[row, 10:]
            inertia = turns[row] @ self._inertias[row] @ turns[row].T
            wrench = self._wrenches.get(name, np.zeros(6))
            force = wrench[:3] - self._masses[row] * (sped[row] + fall)
            torque = wrench[3:] - inertia @ spun[row]
            torque -= np.cross(spin, inertia @ spin)
            mass += self._masses[row] * moving[row].T @ moving[row]
            mass += turning[row].T @ inertia @ turning[row]
            loads += moving[row].T @ force + turning[row].T @ torque
        return mass, loads, np.array(velocities)
