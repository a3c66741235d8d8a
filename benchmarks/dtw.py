"""Dynamic time warping of dtaidistance, on two trajectories of the longest textile task, 562 x 63.

All calls run on one thread and are timed by its CPU clock, so the load of the machine does not matter.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
from dtaidistance import dtw_ndim

FRAME_COUNT, MARKER_COUNT = 562, 63


def competitors(
    first: np.ndarray, second: np.ndarray
) -> dict[str, Callable[[], object]]:
    """Return the calls of dtaidistance, by name."""
    return {
        "dtaidistance.dtw_ndim.distance_fast": lambda: dtw_ndim.distance_fast(
            first, second
        ),
        "dtaidistance.dtw_ndim.warping_path(use_c)": lambda: dtw_ndim.warping_path(
            first, second, use_c=True
        ),
    }


def cpu_medians_ms(
    calls: dict[str, Callable[[], object]], repeats: int
) -> dict[str, float]:
    """Return the median CPU time of each call [ms]; each repeat runs all calls under the same clock rate."""
    for call in calls.values():
        call()
    times_ms: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            start = time.thread_time()
            call()
            times_ms[name].append(1e3 * (time.thread_time() - start))
    return {name: statistics.median(values) for name, values in times_ms.items()}


def inputs() -> tuple[np.ndarray, np.ndarray]:
    """Return one motion at two rates with noise, each of shape [FRAME_COUNT, MARKER_COUNT]."""
    rng = np.random.default_rng(0)
    times, phases = (
        np.linspace(0.0, 12.0, FRAME_COUNT)[:, None],
        np.arange(MARKER_COUNT),
    )
    size = (FRAME_COUNT, MARKER_COUNT)
    first, second = (
        np.sin(times**power + phases) + rng.normal(scale=0.02, size=size)
        for power in (1.0, 1.05)
    )
    return first, second
