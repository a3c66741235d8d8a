"""A PyBullet simulation: driving, stepping and reading of its state."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from gauge_envs.backends.pybullet.model import ModelPyBullet
from gauge_envs.backends.pybullet.settings import SettingsPyBullet
from gauge_envs.backends.pybullet.world import BASE, PLANE_HALF_EDGE_M, pybullet
from gauge_envs.backends.shared.rigid import (
    CONJUGATE,
    MeanForces,
    SingleWorldSimulation,
    motion_steps,
)
from gauge_envs.backends.simulation import ContactForces, MaterialPoints
from gauge_envs.scene import Motion, Plane, Scene
from gauge_envs.scene.geometry import (
    FloatArray,
    quaternion_products,
    rotation_matrices,
    unit_quaternions,
)
from gauge_envs.scene.states import bodies_at

Target = tuple[list[float], list[float], list[float], list[float]]
"""State of a driven body that Bullet gets before a step; see `SimulationPyBullet._targets`."""


class SimulationPyBullet(SingleWorldSimulation):
    """A scene in PyBullet. A reset rebuilds it, since Bullet cannot forget its contacts."""

    def __init__(self, scene: Scene, settings: SettingsPyBullet) -> None:
        super().__init__(scene, settings)
        self._scale = settings.units_per_m
        self._planes = []
        if settings.planes == "box":
            planes = [body for body in scene.bodies if isinstance(body.shape, Plane)]
            self._planes = [body.pose for body in planes]
        self._kinematic = [
            body.name for body in scene.bodies if body.motion is Motion.KINEMATIC
        ]
        self._force_readers: list[MeanForces] = []
        self._model = ModelPyBullet(scene, settings)
        self.reset()

    def start(self, states: FloatArray | None) -> None:
        """Build the scene at its start."""
        bodies = self.scene.bodies
        if states is not None:
            bodies = bodies_at(self.scene, states)
        self._model.build(bodies)
        self._client = self._model.client
        # The client looks functions up by name, which costs as much as they do.
        self._pose_of = self._client.getBasePositionAndOrientation
        self._velocity_of = self._client.getBaseVelocity

    def drive(self, body: str, targets: FloatArray) -> None:
        """Prescribe a kinematic body; each step moves it to its pose at the end of the step."""
        super().drive(body, targets)
        # Valid until the next step, which moves the body; after it, the state comes from Bullet.
        self.placed[body] = targets[0, :13].copy()

    def advance(self, seconds: float) -> None:
        """Step the world. A driven body that was not driven since the last call stays where it is."""
        count = round(seconds / self.step_s)
        targets = [
            (body, self._targets(name, count))
            for name in self._kinematic
            for body, _ in self._model.handles[name]
        ]
        for reader in self._force_readers:
            reader.clear()
        pushes = [self._push(name, wrench) for name, wrench in self.wrenches.items()]
        take_step = self._client.stepSimulation
        place = self._client.resetBasePositionAndOrientation
        move = self._client.resetBaseVelocity
        for step in range(count):
            for body, rows in targets:
                position, quaternion, speed, spin = rows[step]
                place(body, position, quaternion)
                move(body, speed, spin)
            for push in pushes:
                push()
            take_step()
            for reader in self._force_readers:
                reader.add()
        for name in self.motions:
            self.placed.pop(name, None)
        self.motions.clear()

    def _targets(self, name: str, count: int) -> list[Target]:
        """Return the states of a driven body that Bullet gets before each of the next steps.

        Without a call of `drive`, the body stays where it is.

        Returns:
            Position [units], quaternion x y z w, and the mean velocity [units/s] and angular velocity [rad/s] of each
            step.
        """
        frame = self._model.frames[name]
        motion = self.motions.get(name)
        if motion is None:
            pose = self.body_states([name])[0, 0, :7]
            motion = np.concatenate([pose, np.zeros(12)])
        poses, velocities = motion_steps(motion, self.step_s, count)
        quaternions = poses[:, 3:]
        arms_m = rotation_matrices(quaternions) @ frame.centre_m
        spins = velocities[:, 3:]
        speeds = velocities[:, :3] + np.cross(spins, arms_m)
        # Bullet adds gravity to the velocity of every body that can move.
        speeds[:, 2] += self.scene.gravity_m_per_s2 * self.step_s
        frames = quaternion_products(quaternions, CONJUGATE * frame.quaternion)
        columns = (
            self._scale * (poses[:, :3] + arms_m),
            frames[:, [1, 2, 3, 0]],
            self._scale * speeds,
            spins,
        )
        return list(zip(*(column.tolist() for column in columns), strict=True))

    def _push(self, name: str, wrench: FloatArray) -> Callable[[], None]:
        """Return a function that applies a wrench for one step, after which Bullet forgets it."""
        body, link = self._model.handles[name][0]
        force = (self._scale * wrench[:3]).tolist()
        torque = (self._scale**2 * wrench[3:]).tolist()
        push, turn = self._client.applyExternalForce, self._client.applyExternalTorque

        def apply() -> None:
            if any(force):
                centre = self._read(body, link)[0]
                push(body, link, force, centre, pybullet.WORLD_FRAME)
            if any(torque):
                turn(body, link, torque, pybullet.WORLD_FRAME)

        return apply

    def _read(self, body: int, link: int) -> tuple[Any, ...]:
        """Return position, quaternion x y z w, velocity and angular velocity of a centre of mass, in units."""
        if link == BASE:
            return (*self._pose_of(body), *self._velocity_of(body))
        state = self._client.getLinkState(
            body, link, computeLinkVelocity=1, computeForwardKinematics=1
        )
        return (state[0], state[1], state[6], state[7])

    def moving_states(self, names: Sequence[str]) -> FloatArray:
        """Return poses and velocities of dynamic and driven bodies in Bullet, shape [1, len(names), 13]."""
        read = (self._read(*self._model.handles[name][0]) for name in names)
        places, turns, speeds, spins = map(np.array, zip(*read, strict=True))
        frames = [self._model.frames[name] for name in names]
        axes = np.array([frame.quaternion for frame in frames])
        offsets_m = np.array([frame.centre_m for frame in frames])
        quaternions = unit_quaternions(turns[:, [3, 0, 1, 2]])
        quaternions = quaternion_products(quaternions, axes)
        positions_m, velocities = places / self._scale, speeds / self._scale
        if offsets_m.any():
            # Bullet's frame is at the centre of mass.
            arms_m = np.einsum("nij,nj->ni", rotation_matrices(quaternions), offsets_m)
            positions_m -= arms_m
            velocities -= np.cross(spins, arms_m)
        return np.hstack([positions_m, quaternions, velocities, spins])[None]

    def nodes(self, name: str) -> FloatArray:
        """Return the nodes of a rope or soft body [m], shape [1, node_count, 3]."""
        if name in self._model.ropes:
            nodes_m = self._model.ropes[name].nodes_m(self._read, self._scale)
        else:
            flags = pybullet.MESH_DATA_SIMULATION_MESH
            number = self._model.soft[name]
            places = self._client.getMeshData(number, -1, flags=flags)[1]
            nodes_m = np.array(places) / self._scale
        return nodes_m[None]

    def track(self, name: str, points_m: FloatArray) -> MaterialPoints | None:
        """Return a reader of material points of a rope, or None for a soft body; see `Simulation.track`."""
        if name in self._model.soft:
            return None
        # A reset rebuilds the rope with the same numbers.
        return self._model.ropes[name].track(points_m, self._read, self._scale)

    def contact_forces(self, pairs: Sequence[tuple[str, str]]) -> ContactForces:
        """Return a reader of contact forces; see `Simulation.contact_forces`."""
        reader = MeanForces(pairs, self._touches)
        self._force_readers.append(reader)
        return reader.mean

    def _touches(self) -> Iterator[tuple[str, str, FloatArray]]:
        """Yield the contacts of the last step: two bodies, and the force on the first [N]."""
        names = self._model.names
        for point in self._client.getContactPoints():
            first = names.get((point[1], point[3]), "")
            second = names.get((point[2], point[4]), "")
            force = point[9] * np.array(point[7])
            force += point[10] * np.array(point[11]) + point[12] * np.array(point[13])
            yield first, second, force / self._scale

    def diverged(self) -> Mapping[int, str]:
        """Return the body that is beyond the box of a plane, where nothing supports it."""
        names = [body.name for body in self.scene.dynamic_bodies]
        if names and self._planes:
            positions_m = self.body_states(names)[0, :, :3]
            for plane in self._planes:
                across_m = np.abs(plane.to_body(positions_m)[:, :2]).max(axis=1)
                if across_m.max() > PLANE_HALF_EDGE_M:
                    name = names[int(across_m.argmax())]
                    return {
                        0: f"{name} left its plane, which ends at {PLANE_HALF_EDGE_M:g} m in this backend"
                    }
        return {}

    def close(self) -> None:
        """Free the world. A second call does nothing."""
        self._model.close()
