"""A PyBullet simulation: driving, stepping and reading of its state."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from gauge_envs.backends.pybullet.model import WorldPyBullet
from gauge_envs.backends.pybullet.settings import SettingsPyBullet
from gauge_envs.backends.pybullet.world import PLANE_REACH_M, Handle, pybullet
from gauge_envs.backends.shared.rigid import (
    CONJUGATE,
    DrivenMotion,
    MeanForces,
    PlacedWorld,
    body_state,
    placed_states,
)
from gauge_envs.backends.world import Simulation
from gauge_envs.scene import Motion, Plane, Pose, Scene
from gauge_envs.scene.geometry import (
    FloatArray,
    quaternion_products,
    rotation_matrices,
    unit_quaternions,
)

Rows = list[list[float]]
Path = tuple[int, Rows, Rows, Rows, Rows]
"""What Bullet gets of a driven body before each of some steps; see `SimulationPyBullet._path`."""


class SimulationPyBullet(PlacedWorld, Simulation):
    """A scene in PyBullet.

    Attributes:
        settings: Numerical settings in force.
        world: The world in PyBullet.
    """

    def __init__(self, scene: Scene, settings: SettingsPyBullet) -> None:
        self.settings = settings.model_dump(mode="json")
        self.world = WorldPyBullet(scene, settings)
        self._scene = scene
        self._scale = settings.units_per_m
        self._timestep_s = settings.timestep_s
        boxes = settings.planes == "box"
        self._planes = [
            body.pose
            for body in scene.bodies
            if boxes and isinstance(body.shape, Plane)
        ]
        self._kinematic = [
            body.name for body in scene.bodies if body.motion is Motion.KINEMATIC
        ]
        self._force_readers: list[MeanForces] = []
        self._start()

    def _start(self) -> None:
        self._driven: dict[str, DrivenMotion] = {}
        self._wrenches: dict[str, FloatArray] = {}
        self._has_moved = False
        self.placed = placed_states(self._scene)

    def reset(self, seed: int) -> None:
        """Return to the scene's start in a new world. Bullet draws no random numbers, so the seed has no effect."""
        if self._has_moved:
            self.world.rebuild()
        self._start()

    def drive(
        self,
        body: str,
        pose: Pose,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> None:
        """Prescribe a kinematic body; each step moves it to where the motion is at the end of the step."""
        self._driven[body] = DrivenMotion.copied(pose, velocity, acceleration)
        # Until the next step, which takes the body along: then Bullet is asked.
        self.placed[body] = body_state(pose, velocity)

    def apply_wrench(self, body: str, wrench: FloatArray) -> None:
        """Apply a force and a torque to a dynamic body; see `World.apply_wrench`."""
        self._wrenches.pop(body, None)
        if np.any(wrench):
            self._wrenches[body] = np.array(wrench)

    def advance(self, seconds: float) -> None:
        """Step the world. A driven body that was not driven since the last call stays where it is."""
        count = round(seconds / self._timestep_s)
        self._has_moved = True
        motions = {name: self._motion(name) for name in self._kinematic}
        paths = [
            self._path(handle, motion, count)
            for name, motion in motions.items()
            for handle in (self.world.handles[name], *self.world.copies.get(name, []))
        ]
        client = self.world.client
        for reader in self._force_readers:
            reader.clear()
        acts = bool(paths or self._wrenches)
        for step in range(count):
            if acts:
                self._act(paths, step)
            pybullet.stepSimulation(client)
            for reader in self._force_readers:
                reader.add()
        for name in self._driven:
            self.placed.pop(name, None)
        self._driven.clear()

    def _act(self, paths: Sequence[Path], step: int) -> None:
        """Move driven bodies to the end of a step, and apply wrenches for it."""
        client = self.world.client
        for body, positions, quaternions, speeds, spins in paths:
            pybullet.resetBasePositionAndOrientation(
                body, positions[step], quaternions[step], physicsClientId=client
            )
            pybullet.resetBaseVelocity(
                body, speeds[step], spins[step], physicsClientId=client
            )
        for name, wrench in self._wrenches.items():
            self._push(name, wrench)

    def fault(self) -> str | None:
        """Return which body is beyond the box of a plane, where nothing would carry it."""
        names = [body.name for body in self._scene.dynamic_bodies]
        if not names or not self._planes:
            return None
        handles = [self.world.handles[name] for name in names]
        places = [self._read(handle.body, handle.link)[0] for handle in handles]
        positions = np.array(places) / self._scale
        for plane in self._planes:
            across = np.abs((positions - plane.position_m) @ plane.matrix[:, :2]).max(
                axis=1
            )
            if across.max() > PLANE_REACH_M:
                name = names[int(across.argmax())]
                return f"{name} is beyond the {PLANE_REACH_M:g} m that this backend's planes reach"
        return None

    def _motion(self, name: str) -> DrivenMotion:
        """Return the motion of a driven body; without a call of `drive`, it stays where it is."""
        if name in self._driven:
            return self._driven[name]
        x, y, z, *turn = self.body_states([name])[0, :7].tolist()
        return DrivenMotion(Pose(position_m=(x, y, z), quaternion=tuple(turn)))

    def _path(self, handle: Handle, motion: DrivenMotion, count: int) -> Path:
        """Return what Bullet gets of a driven body before each of the next steps.

        Returns:
            Number of the body, its positions [units], quaternions x y z w, and the mean velocities [units/s] and
            angular velocities [rad/s] of the steps, one row for each step.
        """
        step_s = self._timestep_s
        poses, velocities = motion.steps(step_s, count)
        quaternions = poses[:, 3:]
        arms = rotation_matrices(quaternions) @ handle.offset_m
        speeds, spins = velocities[:, :3], velocities[:, 3:]
        if arms.any():
            speeds = speeds + np.cross(spins, arms)
        # Bullet adds gravity to the velocity of every body that can move.
        speeds[:, 2] += self._scene.gravity_m_per_s2 * step_s
        frames = quaternion_products(quaternions, CONJUGATE * handle.quaternion)
        return (
            handle.body,
            (self._scale * (poses[:, :3] + arms)).tolist(),
            frames[:, [1, 2, 3, 0]].tolist(),
            (self._scale * speeds).tolist(),
            spins.tolist(),
        )

    def _push(self, name: str, wrench: FloatArray) -> None:
        """Apply a wrench for one step, after which Bullet forgets it."""
        handle = self.world.handles[name]
        place = self._read(handle.body, handle.link)[0]
        frame = pybullet.WORLD_FRAME
        force, torque = self._scale * wrench[:3], self._scale**2 * wrench[3:]
        self.world.call(
            "applyExternalForce", handle.body, handle.link, force.tolist(), place, frame
        )
        self.world.call(
            "applyExternalTorque", handle.body, handle.link, torque.tolist(), frame
        )

    def _read(self, body: int, link: int) -> tuple[Any, ...]:
        """Return position, quaternion x y z w, velocity and angular velocity of a centre of mass, in units."""
        client = self.world.client
        if link < 0:
            place = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
            return (*place, *pybullet.getBaseVelocity(body, physicsClientId=client))
        state = pybullet.getLinkState(
            body,
            link,
            computeLinkVelocity=1,
            computeForwardKinematics=1,
            physicsClientId=client,
        )
        return (state[0], state[1], state[6], state[7])

    def nodes(self, name: str) -> FloatArray:
        """Return the nodes of a rope or soft body [m], shape [node_count, 3]."""
        if name in self.world.soft:
            flags = pybullet.MESH_DATA_SIMULATION_MESH
            return (
                np.array(
                    self.world.call(
                        "getMeshData", self.world.soft[name], -1, flags=flags
                    )[1]
                )
                / self._scale
            )
        return self.world.ropes[name].nodes_m(self._read, self._scale)

    def track(self, name: str, points_m: FloatArray) -> Callable[[], FloatArray] | None:
        """Return a reader of material points of a rope, or None for a soft body; see `World.track`."""
        if name in self.world.soft:
            return None
        # A reset builds the rope anew, with the same numbers.
        return self.world.ropes[name].track(points_m, self._read, self._scale)

    def moving_states(self, names: Sequence[str]) -> FloatArray:
        """Return poses and velocities of dynamic and driven bodies in Bullet, shape [len(names), 13]."""
        handles = [self.world.handles[name] for name in names]
        read = (self._read(handle.body, handle.link) for handle in handles)
        places, frames, speeds, spins = map(np.array, zip(*read, strict=True))
        turns = np.array([handle.quaternion for handle in handles])
        offsets_m = np.array([handle.offset_m for handle in handles])
        quaternions = quaternion_products(
            unit_quaternions(frames[:, [3, 0, 1, 2]]), turns
        )
        positions_m, speeds = places / self._scale, speeds / self._scale
        if offsets_m.any():
            # Bullet's frame is at the centre of mass.
            arms_m = np.einsum("nij,nj->ni", rotation_matrices(quaternions), offsets_m)
            positions_m, speeds = positions_m - arms_m, speeds - np.cross(spins, arms_m)
        return np.hstack([positions_m, quaternions, speeds, spins])

    def contact_forces(
        self, pairs: Sequence[tuple[str, str]]
    ) -> Callable[[], FloatArray]:
        """Return a reader of contact forces; see `World.contact_forces`."""
        reader = MeanForces(pairs, self._touches)
        self._force_readers.append(reader)
        return reader.mean

    def _touches(self) -> Iterator[tuple[str, str, FloatArray]]:
        """Yield the contacts of the last step: two bodies, and the force on the first [N]."""
        world, names = self.world, {}
        for name, handle in world.handles.items():
            for copy in (handle, *world.copies.get(name, [])):
                names[copy.body, copy.link] = name
        for touch in world.call("getContactPoints"):
            first = names.get((touch[1], touch[3]), "")
            second = names.get((touch[2], touch[4]), "")
            force = touch[9] * np.array(touch[7])
            force += touch[10] * np.array(touch[11]) + touch[12] * np.array(touch[13])
            yield first, second, force / self._scale

    def close(self) -> None:
        """Free the world. A second call does nothing."""
        self.world.close()
