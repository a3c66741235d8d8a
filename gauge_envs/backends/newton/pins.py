"""Massless particles of a Newton model that kinematic bodies hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import newton
import warp as wp

from gauge_envs.backends.newton.kernels import carry, hold


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
