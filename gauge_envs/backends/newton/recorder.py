"""Recording of all worlds of a Newton model in arrays of its device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gauge_envs.backends.newton.kernels import record_positions, record_states
from gauge_envs.backends.newton.stepper import Stepper
from gauge_envs.backends.recording import Recording


@dataclass(frozen=True, kw_only=True)
class RecordShape:
    """Length of a record.

    Attributes:
        frame_count: Number of frames, with the first one.
        samples: Number of samples from one frame to the next.
    """

    frame_count: int
    samples: int


class Recorder:
    """Record of the bodies of all worlds.

    The host starts the recorded steps and two kernels, and waits for none of them.

    Args:
        stepper: Stepper of the model.
        bodies: Indices of the bodies in the model, shape [world_count, body_count].
        origins_m: World positions of the origin of each world's bodies [m], shape [world_count, 3].
        shape: Length of the record.
    """

    def __init__(
        self, stepper: Stepper, bodies: NDArray[np.intp], origins_m: NDArray[np.float64], shape: RecordShape
    ) -> None:
        self._stepper, self._bodies, self._shape = stepper, bodies, shape
        self._device = stepper.model.device
        with wp.ScopedDevice(self._device):
            self._index = wp.array(bodies.astype(np.int32), dtype=wp.int32)
            self._origins = wp.array(origins_m, dtype=wp.vec3d)
            self._centres = wp.array(stepper.model.body_com.numpy().astype(np.float64), dtype=wp.vec3d)
            sample_count = (shape.frame_count - 1) * shape.samples + 1
            self._positions = wp.zeros((sample_count, *bodies.shape, 3), dtype=wp.float64)
            self._states = wp.zeros((shape.frame_count, *bodies.shape, 13), dtype=wp.float64)

    def fits(self, bodies: NDArray[np.intp], shape: RecordShape) -> bool:
        """Return whether the arrays suit these bodies and this length."""
        return shape == self._shape and np.array_equal(bodies, self._bodies)

    def run(self, interval_s: float) -> Recording:
        """Advance the model and record it from its current state on.

        Args:
            interval_s: Time between samples [s].
        """
        self._record(0)
        for sample in range(1, len(self._positions)):
            self._stepper.advance(interval_s)
            self._record(sample)
        return Recording(device=str(self._device), positions_m=self._positions, states=self._states)

    def _record(self, sample: int) -> None:
        state = self._stepper.now
        wp.launch(
            record_positions,
            dim=self._bodies.shape,
            inputs=[sample, self._index, self._origins, state.body_q],
            outputs=[self._positions],
            device=self._device,
        )
        if sample % self._shape.samples == 0:
            wp.launch(
                record_states,
                dim=self._bodies.shape,
                inputs=[
                    sample // self._shape.samples,
                    self._index,
                    self._origins,
                    self._centres,
                    state.body_q,
                    state.body_qd,
                ],
                outputs=[self._states],
                device=self._device,
            )
