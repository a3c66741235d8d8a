"""Scores of many worlds of one experiment on the device that holds their positions, by Warp kernels.

The numbers are those of `worlds.score_worlds`, within 1e-9; NumPy stays the reference. A kernel reads the positions
where the engine recorded them, and only the scores are copied to the host.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import MissingExtraError, ShapeError
from gauge_envs.evaluation.worlds import MOST_STEPS, is_aligned, normalized
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME

if TYPE_CHECKING:
    import warp as wp


def device_array(array: Any) -> wp.array:
    """Return an array of another library as a Warp array on the same device, without a copy.

    Args:
        array: An array that follows the DLPack protocol.
    """
    try:
        import warp as wp
    except ImportError as error:
        raise MissingExtraError("scoring on a device", "newton", error) from error
    if isinstance(array, wp.array):
        return array
    # Warp logs every kernel that it loads, unless it is told before its start. A second start does nothing.
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    return wp.from_dlpack(array)


def score_recording(
    experiment: Experiment,
    band: Band,
    *,
    positions_m: Any,
    rows: Sequence[int],
    sample_counts: NDArray[np.intp],
) -> dict[str, NDArray[np.float64]]:
    """Return the distances of recorded worlds from a band; for experiments that observe positions.

    Args:
        experiment: Experiment that was simulated.
        band: Its reference.
        positions_m: Positions of the bodies [m], 180 samples a second from 0, a contiguous array of 64-bit floats of
            any library that follows DLPack, shape [sample_count, world_count, body_count, 3].
        rows: Numbers of the observed bodies, in the order of the experiment.
        sample_counts: Number of samples of each world that count, shape [world_count]. A world that lacks a frame has
            no score; fewer samples after the last frame shorten the range of time shifts.

    Returns:
        As `score_worlds` returns them.
    """
    positions = device_array(positions_m)
    import warp as wp

    from gauge_envs.evaluation.score_kernels import align, compare, project

    needed = (experiment.frame_count - 1) * SAMPLES_PER_FRAME + 1
    world_count = len(sample_counts)
    width = 3 * len(rows)
    is_right = len(positions.shape) == 4 and positions.shape[1] == world_count and positions.shape[3] == 3
    if not is_right or positions.shape[0] < needed or width != band.projection.shape[1]:
        raise ShapeError(
            f"positions have shape {tuple(positions.shape)} with {len(rows)} observed bodies; [{needed} or more, "
            f"{world_count}, body_count, 3] and {band.projection.shape[1] // 3} observed bodies are needed"
        )
    # A kernel reads what is there: outside of the array, or halves of numbers.
    if positions.dtype is not wp.float64:
        raise ShapeError(f"positions are of type {positions.dtype.__name__}, expected 64-bit floats")
    if not all(0 <= row < positions.shape[2] for row in rows):
        raise ShapeError(f"rows are {list(rows)}, expected numbers of the {positions.shape[2]} bodies, from 0")
    known = np.isfinite(band.mean)
    frames = np.flatnonzero(known.any(axis=1))
    with wp.ScopedDevice(positions.device):
        counts = wp.array(np.minimum(sample_counts, positions.shape[0]).astype(np.int32), dtype=wp.int32)
        mean = wp.array(np.where(known, band.mean, 0.0), dtype=wp.float64)
        weight = wp.array(known.astype(np.float64), dtype=wp.float64)
        last = wp.full(world_count, positions.shape[0] - 1, dtype=wp.int32)
        projected = wp.empty((positions.shape[0], world_count, len(band.projection)), dtype=wp.float64)
        squares, shifts, least = (wp.empty(world_count, dtype=wp.float64) for _ in range(3))
        wp.launch(
            project,
            dim=projected.shape[:2],
            inputs=[
                positions,
                wp.array(np.asarray(rows, dtype=np.int32), dtype=wp.int32),
                wp.array(band.projection, dtype=wp.float64),
                counts,
            ],
            outputs=[last, projected],
        )
        wp.launch(
            compare,
            dim=world_count,
            inputs=[projected, mean, weight, SAMPLES_PER_FRAME, counts],
            outputs=[squares],
        )
        scores = {"rmse": np.sqrt(squares.numpy() / len(frames))}
        if is_aligned(experiment, band):
            wp.launch(
                align,
                dim=world_count,
                inputs=[
                    projected,
                    mean,
                    weight,
                    SAMPLES_PER_FRAME,
                    int(SAMPLES_PER_FRAME * frames[-1]),
                    MOST_STEPS,
                    last,
                ],
                outputs=[shifts, least],
            )
            missing = ~np.isfinite(scores["rmse"])
            scores["release_offset_s"] = np.where(missing, np.nan, SAMPLE_INTERVAL_S * shifts.numpy())
            scores["rmse_aligned"] = np.where(missing, np.nan, np.sqrt(least.numpy() / len(frames)))
    return normalized(experiment, band, scores)
