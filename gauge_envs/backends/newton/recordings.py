"""Recorded worlds, scored and judged by Warp on the device that holds them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gauge_envs.backends.base import Recording, RecordingKernels, RigidLimits
from gauge_envs.backends.newton.recording_kernels import (
    align,
    compare,
    find_suspects,
    project,
)
from gauge_envs.errors import ShapeError
from gauge_envs.scene.timing import SAMPLES_PER_FRAME

FloatArray = NDArray[np.float64]


def device_array(array: Any) -> wp.array:
    """Return an array of another library as a Warp array on the same device, without a copy.

    Args:
        array: An array of 64-bit floats that follows the DLPack protocol.

    Raises:
        ShapeError: It holds other numbers.
    """
    if not isinstance(array, wp.array):
        # Warp logs every kernel that it loads, unless it is told before its start. A second start does nothing.
        wp.config.log_level = wp.LOG_WARNING
        wp.init()
        array = wp.from_dlpack(array)
    # A kernel would read halves of numbers.
    if array.dtype is not wp.float64:
        raise ShapeError(
            f"positions are of type {array.dtype.__name__}, expected 64-bit floats"
        )
    return array


class WarpKernels(RecordingKernels):
    """Kernels of Warp, for arrays of any library that follows the DLPack protocol."""

    def copied(self, array: Any) -> FloatArray:
        """Return an array on the host."""
        return device_array(array).numpy()

    def squares(
        self,
        positions_m: Any,
        *,
        rows: Sequence[int],
        sample_counts: NDArray[np.intp],
        projection: FloatArray,
        mean: FloatArray,
        shift_limit: int,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return squared distances from a band as they are, the best time shifts, and the squares with them."""
        positions = device_array(positions_m)
        sample_count, world_count = positions.shape[:2]
        known = np.isfinite(mean)
        last_known = SAMPLES_PER_FRAME * int(np.flatnonzero(known.any(axis=1))[-1])
        with wp.ScopedDevice(positions.device):
            counts = wp.array(
                np.minimum(sample_counts, sample_count).astype(np.int32), dtype=wp.int32
            )
            target = wp.array(np.where(known, mean, 0.0), dtype=wp.float64)
            weight = wp.array(known.astype(np.float64), dtype=wp.float64)
            row = wp.array(np.asarray(rows, dtype=np.int32), dtype=wp.int32)
            coordinates = wp.array(projection, dtype=wp.float64)
            last = wp.full(world_count, sample_count - 1, dtype=wp.int32)
            projected = wp.empty(
                (sample_count, world_count, len(projection)), dtype=wp.float64
            )
            wp.launch(
                project,
                dim=projected.shape[:2],
                inputs=[positions, row, coordinates, counts],
                outputs=[last, projected],
            )
            squares = wp.empty(world_count, dtype=wp.float64)
            wp.launch(
                compare,
                dim=world_count,
                inputs=[projected, target, weight, SAMPLES_PER_FRAME, counts],
                outputs=[squares],
            )
            shifts = wp.empty(world_count, dtype=wp.float64)
            shifted = wp.empty(world_count, dtype=wp.float64)
            wp.launch(
                align,
                dim=world_count,
                inputs=[
                    projected,
                    target,
                    weight,
                    SAMPLES_PER_FRAME,
                    last_known,
                    shift_limit,
                    last,
                ],
                outputs=[shifts, shifted],
            )
            return squares.numpy(), shifts.numpy(), shifted.numpy()

    def suspects(
        self, recording: Recording, limits: RigidLimits, *, later: int
    ) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
        """Find worlds that may be out of bounds, and copy them alone."""
        states = device_array(recording.states)
        positions = device_array(recording.positions_m)
        frame_count, world_count = states.shape[:2]
        values = (
            limits.masses_kg,
            limits.distances_m,
            limits.speeds_m_per_s,
            limits.energies_j,
        )
        with wp.ScopedDevice(states.device):
            first = wp.full(world_count, frame_count, dtype=wp.int32)
            limit_arrays = [wp.array(value, dtype=wp.float64) for value in values]
            wp.launch(
                find_suspects,
                dim=(frame_count - 1, world_count),
                inputs=[states, positions, *limit_arrays, SAMPLES_PER_FRAME, later],
                outputs=[first],
            )
            firsts: NDArray[np.intp] = first.numpy().astype(np.intp)
            suspects = np.flatnonzero(firsts < frame_count)
            if not len(suspects):
                return firsts, np.zeros((0, 0)), np.zeros((0, 0))
            chosen = wp.array(suspects.astype(np.int32), dtype=wp.int32)
            copied_states = wp.indexedarray(states, [None, chosen]).numpy()
            copied_positions = wp.indexedarray(positions, [None, chosen]).numpy()
            return firsts, copied_states, copied_positions
