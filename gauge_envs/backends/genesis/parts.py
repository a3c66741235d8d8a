"""Common code of Genesis's deformable solvers: nodes, pinned nodes, and the rigid bodies that touch them."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.genesis.document import COUPLED_BIT, body_label
from gauge_envs.backends.genesis.engine import engine
from gauge_envs.backends.genesis.settings import touching_bodies
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.backends.shared.rigid import body_state, later_targets
from gauge_envs.backends.simulation import MaterialPoints
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray, IntArray, rotation_matrices


@dataclass(frozen=True, eq=False)
class PinGenesis:
    """Nodes that move with a rigid body.

    Attributes:
        entity: Genesis's entity of the nodes.
        nodes: Indices of the nodes in the entity.
        attachment: Attachment to the body.
        places_m: Positions of the nodes in the frame of the body [m], shape [count, 3].
    """

    entity: Any
    nodes: IntArray
    attachment: RigidAttachment
    places_m: FloatArray


class DeformablePart(ABC):
    """Deformable bodies of one solver of a Genesis scene with one world, their nodes and how they are driven.

    The calls come in this order: `scene_options` and `touches` before the Genesis scene exists, `add` before it is
    built, `finish` after it, then `reset`; `plan` before each interval, and `hold` before each step of it.

    Attributes:
        names: Names of the bodies.
    """

    def __init__(self, scene: Scene, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._scene = scene
        self._pins: list[PinGenesis] = []
        self._planned: list[tuple[NDArray[Any], ...]] = []

    @abstractmethod
    def scene_options(self) -> dict[str, Any]:
        """Return keyword arguments of `gs.Scene`, such as `pbd_options` and `coupler_options`."""

    def touches(self) -> Mapping[str, float]:
        """Return the friction of the rigid bodies that collide with the part, by their names.

        Each of these bodies gets an additional first geom, which collides with no rigid body. Only this geom takes part
        in the coupling.
        """
        return {
            name: contact.friction
            for name, partner, contact in touching_bodies(self._scene)
            if partner in self.names and name not in self.names
        }

    def touch_margin_m(self) -> float:
        """Return the distance [m] by which the geoms of `touches` exceed their bodies, except planes and unions."""
        return 0.0

    def add(self, model: Any) -> None:
        """Add the bodies to a `gs.Scene` before it is built, and couple them to their geoms only."""
        for geom in model.sim.rigid_solver.geoms:
            geom._needs_coup = geom.conaffinity == COUPLED_BIT

    def coupled_geoms(self, model: Any) -> Iterator[tuple[Any, float]]:
        """Yield the geoms of a `gs.Scene` that collide with the part, with their friction."""
        touches = self.touches()
        labels = {
            body_label(index): body.name
            for index, body in enumerate(self._scene.bodies)
        }
        for geom in model.sim.rigid_solver.geoms:
            if geom.conaffinity == COUPLED_BIT:
                label, _, _ = geom.metadata["name"].partition("/")
                yield geom, touches[labels[label]]

    @abstractmethod
    def finish(self, model: Any) -> None:
        """Complete the bodies after the scene was built: set constants, fix nodes, find the pins."""

    def reset(self, initial_states: FloatArray) -> None:  # noqa: B027
        """Move cloth to its initial states after a reset of the Genesis scene; soft bodies start as in the scene.

        Args:
            initial_states: Initial states of the scene's deformable bodies, shape [count, 13].
        """

    def pin(
        self,
        entity: Any,
        nodes: IntArray,
        attachment: RigidAttachment,
        points_m: FloatArray,
    ) -> None:
        """Let nodes of an entity, given by their start positions [m], move with a rigid body."""
        places_m = attachment.pose.to_body(points_m)
        self._pins.append(PinGenesis(entity, nodes, attachment, places_m))

    def plan(self, targets: Mapping[str, FloatArray], times_s: FloatArray) -> None:
        """Compute how pinned nodes move in an interval.

        Args:
            targets: Motion of each kinematic body from the start of the interval on, by name: a row of
                `Simulation.drive`, shape [19].
            times_s: Times of the ends of the steps since the start of the interval [s], shape [step_count + 1].
        """
        self._planned = []
        for pin in self._pins:
            at_rest = np.append(body_state(pin.attachment.pose), np.zeros(6))
            target = targets.get(pin.attachment.body, at_rest)
            motion = later_targets(np.tile(target, (len(times_s), 1)), times_s[:, None])
            turned = rotation_matrices(motion[:, 3:7])
            path_m = (
                np.einsum("tij,pj->tpi", turned, pin.places_m) + motion[:, None, :3]
            )
            arrays = self.pin_motion(pin, path_m, motion[:, 10:13])
            self._planned.append(
                tuple(
                    np.ascontiguousarray(array, dtype=engine().np_float)
                    for array in arrays
                )
            )

    def hold(self, step: int) -> None:
        """Move the pinned nodes before a step of the interval."""
        for pin, arrays in zip(self._pins, self._planned, strict=True):
            self.hold_pin(pin, *(array[step] for array in arrays))

    @abstractmethod
    def pin_motion(
        self, pin: PinGenesis, path_m: FloatArray, spin: FloatArray
    ) -> tuple[FloatArray, ...]:
        """Return the arguments of `hold_pin` in each step of an interval, arrays whose first axis is the step.

        Args:
            pin: The nodes.
            path_m: Positions of the nodes at the ends of the steps [m], shape [step_count + 1, node_count, 3].
            spin: Angular velocity of their body at these times [rad/s], shape [step_count + 1, 3].
        """

    @abstractmethod
    def hold_pin(self, pin: PinGenesis, *arrays: NDArray[Any]) -> None:
        """Prescribe nodes in the next step."""

    @abstractmethod
    def nodes(self, name: str) -> FloatArray:
        """Return the positions of a body's nodes [m], shape [node_count, 3]."""

    def track(self, name: str, points_m: FloatArray) -> MaterialPoints | None:
        """Return a reader of material points; see `Simulation.track`."""
        return None

    def diverged(self) -> str | None:
        """Return why the solver discarded the state; see `Simulation.diverged`."""
        return None


def particle_positions_m(entity: Any) -> FloatArray:
    """Return the positions of the particles of an entity [m], shape [particle_count, 3]."""
    return entity.get_particles_pos()[0].numpy().astype(np.float64)
