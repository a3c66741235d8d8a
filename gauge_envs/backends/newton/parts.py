"""Deformable bodies of a Newton model, and the massless particles that kinematic bodies hold."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import newton
import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from gauge_envs.backends.newton.kernels import carry, hold
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.backends.shared.soft_rows import SoftRow
from gauge_envs.scene import Motion

Reader = Callable[[newton.State], NDArray[np.float64]]
"""Function of a state that returns the positions of material points [m], shape [point_count, 3]."""


@dataclass(frozen=True, kw_only=True)
class Pin:
    """A massless particle that a kinematic body holds.

    Attributes:
        particle: Index of the particle in the model.
        body: Index of the kinematic body in the model.
        place_m: Position of the particle in the body's frame [m].
    """

    particle: int
    body: int
    place_m: tuple[float, float, float]


def pins_of(
    attachment: RigidAttachment, bodies: Mapping[str, int], particles: Iterable[int], points_m: NDArray[np.float64]
) -> Iterator[Pin]:
    """Yield the pins of attached particles, if the body that holds them is kinematic.

    Args:
        attachment: The attachment.
        bodies: Model index of each kinematic body, by name.
        particles: Indices of the particles in the model.
        points_m: Their positions at the start [m], shape [particle_count, 3].
    """
    if attachment.motion is Motion.KINEMATIC:
        for particle, (x, y, z) in zip(particles, attachment.pose.to_body(points_m).tolist(), strict=True):
            yield Pin(particle=int(particle), body=bodies[attachment.body], place_m=(x, y, z))


class PinnedParticles:
    """Pins of a model on its device.

    Args:
        pins: The pins.
        device: Device of the model.
    """

    def __init__(self, pins: Sequence[Pin], device: wp.Device) -> None:
        self._device = device
        self._count = len(pins)
        with wp.ScopedDevice(device):
            self._inputs = [
                wp.array([pin.particle for pin in pins], dtype=wp.int32),
                wp.array([pin.body for pin in pins], dtype=wp.int32),
                wp.array([pin.place_m for pin in pins], dtype=wp.vec3),
            ]

    def hold(self, body_q: wp.array, particle_q: wp.array) -> None:
        """Move the particles to their positions on bodies."""
        self._launch(hold, [body_q], [particle_q])

    def carry(self, state: newton.State, after: newton.State, timestep_s: float) -> None:
        """Move the particles to their positions before a step, with the velocities that lead to those after it."""
        outputs = [state.particle_q, state.particle_qd, state.mpm.particle_qd_grad]
        self._launch(carry, [state.body_q, after.body_q, after.body_qd, timestep_s], outputs)

    def _launch(self, kernel: wp.Kernel, inputs: list[Any], outputs: list[wp.array]) -> None:
        if self._count:
            wp.launch(kernel, dim=self._count, inputs=[*self._inputs, *inputs], outputs=outputs, device=self._device)


class Part(ABC):
    """A deformable body or a soft row in a model.

    Attributes:
        rest_m: World positions of the nodes at the start [m], shape [node_count, 3].
        pins: Particles that kinematic bodies hold.
        node_indices: Indices of each body's nodes among those of a soft row, by name; empty for a single body.
    """

    rest_m: NDArray[np.float64]
    pins: tuple[Pin, ...] = ()
    node_indices: Mapping[str, NDArray[np.intp]] = MappingProxyType({})

    @abstractmethod
    def nodes(self, state: newton.State) -> NDArray[np.float64]:
        """Return the world positions of the nodes in a state [m], shape [node_count, 3], in single precision."""

    def track(self, points_m: ArrayLike) -> Reader | None:
        """Return a reader of material points, given by their start positions [m], or None to interpolate the nodes."""
        return None


class ParticlePart(Part):
    """A deformable body or a soft row that consists of particles.

    Attributes:
        particles: Its particles in the model.
    """

    particles: slice

    def positions(self, state: newton.State) -> NDArray[np.float64]:
        """Return the positions of its particles in a state [m], shape [particle_count, 3], in single precision."""
        positions: NDArray[np.float64] = state.particle_q.numpy()[self.particles].astype(np.float64)
        return positions

    def nodes(self, state: newton.State) -> NDArray[np.float64]:
        """Return the positions of the particles, which are the nodes; see `Part.nodes`."""
        return self.positions(state)


class SoftRowPart(ParticlePart):
    """A soft body or a soft row as particles. Material in a grip moves rigidly.

    Args:
        soft_row: The soft row.
        rest_m: World positions of the nodes at the start [m], shape [node_count, 3].
        particles: Its particles in the model.
        pins: Particles that kinematic bodies hold.

    Attributes:
        names: Names of the bodies, in their order along the row.
    """

    names: tuple[str, ...]

    def __init__(self, soft_row: SoftRow, rest_m: NDArray[np.float64], particles: slice, pins: Sequence[Pin]) -> None:
        self._soft_row = soft_row
        self.names = soft_row.names
        self.rest_m = rest_m
        self.particles = particles
        self.pins = tuple(pins)
        self.node_indices = soft_row.nodes_of(rest_m)
