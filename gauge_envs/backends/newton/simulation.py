"""Simulations and batched worlds on top of a Newton model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import cast

import newton
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.device import DeviceWorlds
from gauge_envs.backends.newton.model import WorldLayout, build_model
from gauge_envs.backends.newton.mujoco_stepper import StepperMuJoCo, installed
from gauge_envs.backends.newton.settings import SettingsNewton
from gauge_envs.backends.newton.stepper import HostState, Stepper
from gauge_envs.backends.shared.rigid import MeanForces, PlacedWorld, placed_states
from gauge_envs.backends.shared.states import Snapshot, StateOrigin
from gauge_envs.backends.world import Simulation
from gauge_envs.backends.worlds import Worlds
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Motion, Pose, Scene


class _WorldNewton(PlacedWorld):
    """One world of a Newton model."""

    def __init__(
        self,
        scene: Scene,
        layout: WorldLayout,
        stepper: Stepper,
        settings: SettingsNewton,
    ) -> None:
        self.settings = settings.model_dump(mode="json")
        self._layout = layout
        self._stepper = stepper
        self.placed = placed_states(scene)

    def drive(
        self,
        body: str,
        pose: Pose,
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
    ) -> None:
        """Prescribe a kinematic body; see `World.drive`."""
        near_m = np.subtract(pose.position_m, self._layout.origin_m)
        motion = np.concatenate([near_m, pose.quaternion, velocity, acceleration])
        self._stepper.drive(np.array([self._layout.rigid.bodies[body]]), motion[None])

    def apply_wrench(self, body: str, wrench: NDArray[np.float64]) -> None:
        """Apply a force and a torque to a dynamic body if the solver supports it; see `World.apply_wrench`."""
        self._stepper.apply_wrench(self._layout.rigid.bodies[body], wrench)

    def moving_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return poses and velocities in single precision, shape [len(names), 13]."""
        states = self._stepper.body_states(
            [self._layout.rigid.bodies[name] for name in names]
        )
        states[:, :3] += self._layout.origin_m
        return states

    def nodes(self, name: str) -> NDArray[np.float64]:
        """Return the current nodes of a deformable body [m], shape [node_count, 3]."""
        return self._layout.nodes(name, self._stepper.now)

    def track(
        self, name: str, points_m: NDArray[np.float64]
    ) -> Callable[[], NDArray[np.float64]] | None:
        """Return a reader of material points, or None for cloth; see `World.track`."""
        origin_m = self._layout.origin_m
        read = self._layout.parts[name].track(points_m - np.asarray(origin_m))
        return None if read is None else lambda: read(self._stepper.now) + origin_m


class SimulationNewton(_WorldNewton, Simulation):
    """A scene in Newton."""

    def __init__(self, scene: Scene, settings: SettingsNewton) -> None:
        stepper, layouts = build_model([scene], settings)
        super().__init__(scene, layouts[0], stepper, settings)
        self._origin = StateOrigin(
            f"newton {installed('newton')}", self.settings, scene
        )

    def reset(self, seed: int) -> None:
        """Return to the scene's start. Newton draws no random numbers here, so the seed has no effect."""
        self._stepper.reset()

    def contact_forces(
        self, pairs: Sequence[tuple[str, str]]
    ) -> Callable[[], NDArray[np.float64]] | None:
        """Return a reader of contact forces, or None where the solver is not MuJoCo's; see `World.contact_forces`."""
        stepper = self._stepper
        if not isinstance(stepper, StepperMuJoCo):
            return None
        names = {
            shape: name
            for name, shapes in self._layout.rigid.shapes.items()
            for shape in shapes
        }

        def touches() -> Iterator[tuple[str, str, NDArray[np.float64]]]:
            for first, second, force_n in stepper.touches():
                yield names[first], names[second], force_n

        reader = MeanForces(pairs, touches)
        stepper.force_readers.append(reader)
        return reader.mean

    def advance(self, seconds: float) -> None:
        """Step the model."""
        self._stepper.advance(seconds)

    def state(self) -> Snapshot:
        """Return every array that a step may change, with its origin."""
        return self._origin.state(self._stepper.state())

    def restore(self, state: Snapshot) -> None:
        """Restore a state."""
        self._stepper.restore(self._origin.values(state))

    def close(self) -> None:
        """Do nothing, since the simulation only holds memory."""


class WorldsNewton(Worlds):
    """Instances of a scene as worlds of one Newton model."""

    def __init__(self, scenes: Sequence[Scene], settings: SettingsNewton) -> None:
        self._stepper, layouts = build_model(scenes, settings)
        self.worlds = [
            _WorldNewton(scene, layout, self._stepper, settings)
            for scene, layout in zip(scenes, layouts, strict=True)
        ]
        moving = [
            body.name for body in scenes[0].bodies if body.motion is not Motion.FIXED
        ]
        self._bodies = {
            name: np.array(
                [layout.rigid.bodies[name] for layout in layouts], dtype=np.intp
            )
            for name in moving
        }
        self._origins_m = np.array([layout.origin_m for layout in layouts])[:, None]
        self._scene, self._layouts = scenes[0], layouts

    def reset(self, seed: int) -> None:
        """Return all worlds to their starts. Newton draws no random numbers here, so the seed has no effect."""
        self._stepper.reset()

    def restart(self, number: int) -> None:
        """Return one world to its start; see `Worlds.restart`."""
        self._stepper.restart(number, len(self.worlds))

    def advance(self, seconds: float) -> None:
        """Step the model, which contains all worlds."""
        self._stepper.advance(seconds)

    def drive(
        self, body: str, motions: NDArray[np.float64], numbers: NDArray[np.intp]
    ) -> None:
        """Prescribe a kinematic body in some worlds; see `Worlds.drive`."""
        near = motions.copy()
        near[:, :3] -= self._origins_m[numbers, 0]
        self._stepper.drive(self._bodies[body][numbers], near)

    def nodes(self, name: str) -> NDArray[np.float64]:
        """Return the nodes of a deformable body in all worlds, with one copy from the device."""
        state = cast("newton.State", HostState(self._stepper.now))
        return np.stack([layout.nodes(name, state) for layout in self._layouts])

    def faults(self) -> dict[int, str]:
        """Return no world: Newton does not report that it gave up a state."""
        return {}

    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return poses and velocities of bodies in all worlds, with one copy from the device."""
        if not self._all_move(names):
            return super().body_states(names)
        states = self._stepper.body_states(self._indices(names)).reshape(
            len(self.worlds), len(names), 13
        )
        states[:, :, :3] += self._origins_m
        return states

    def body_positions(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return positions of bodies in all worlds, with one copy from the device."""
        if not self._all_move(names):
            return super().body_positions(names)
        positions = self._stepper.body_positions(self._indices(names)).reshape(
            len(self.worlds), len(names), 3
        )
        return positions + self._origins_m

    def on_device(self) -> DeviceWorlds:
        """Return the worlds as tensors of PyTorch; see `Worlds.on_device`."""
        from gauge_envs.backends.newton.device import NewtonOnDevice

        if not isinstance(self._stepper, StepperMuJoCo):
            raise UnsupportedSceneError(
                "Newton's worlds on a device are of rigid bodies alone: leave out mode='device'"
            )
        return NewtonOnDevice(self._scene, self._stepper, self._layouts, self._bodies)

    def _all_move(self, names: Sequence[str]) -> bool:
        return bool(names) and self._bodies.keys() >= set(names)

    def _indices(self, names: Sequence[str]) -> NDArray[np.intp]:
        """Return the indices of bodies in the model, all of the first world first."""
        return np.column_stack([self._bodies[name] for name in names]).ravel()

    def close(self) -> None:
        """Do nothing, since the simulation only holds memory."""
