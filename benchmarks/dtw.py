"""Time `trajectory_dtw` against tslearn and dtaidistance on two trajectories of the longest textile task, 562 x 63.

Prints the ratio of medians (ours over theirs, below 1 is faster) of interleaved runs. The exit code is 1 if another
library is faster. All run on one thread and are timed by its CPU clock, so the load of the machine does not matter.

    python benchmarks/dtw.py [--repeats 101]
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np

from gauge_envs.errors import MissingExtraError
from gauge_envs.scoring.metrics import trajectory_dtw

FRAME_COUNT, MARKER_COUNT = 562, 63


def competitors(
    first: np.ndarray, second: np.ndarray
) -> dict[str, Callable[[], object]]:
    try:
        from dtaidistance import dtw_ndim
        from tslearn.metrics import dtw_path as tslearn_path, dtw_path_from_metric
    except ImportError as error:
        raise MissingExtraError("the DTW benchmark", "bench", error) from error
    return {
        "tslearn.dtw_path": lambda: tslearn_path(first, second),
        "tslearn.dtw_path_from_metric(euclidean)": lambda: dtw_path_from_metric(
            first, second, metric="euclidean"
        ),
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
        call()  # Some libraries compile at first use.
    times_ms: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            start = time.thread_time()
            call()
            times_ms[name].append(1e3 * (time.thread_time() - start))
    return {name: statistics.median(values) for name, values in times_ms.items()}


def inputs() -> dict[str, list[np.ndarray]]:
    """Return pairs of trajectories by description."""
    rng = np.random.default_rng(0)
    return {
        "random walks": [
            rng.normal(size=(FRAME_COUNT, MARKER_COUNT)).cumsum(axis=0)
            for _ in range(2)
        ],
        "one motion, warped and noisy": [
            np.sin(
                np.linspace(0.0, 12.0, FRAME_COUNT)[:, None] ** power
                + np.arange(MARKER_COUNT)
            )
            + rng.normal(scale=0.02, size=(FRAME_COUNT, MARKER_COUNT))
            for power in (1.0, 1.05)
        ],
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=101)
    repeats = parser.parse_args().repeats
    slower = False
    for title, (first, second) in inputs().items():
        try:
            competitor_calls = competitors(first, second)
            from threadpoolctl import threadpool_limits  # comes with tslearn
        except MissingExtraError as error:
            print(error, file=sys.stderr)
            return 2
        calls = {
            "gauge_envs.trajectory_dtw": lambda a=first, b=second: trajectory_dtw(a, b)
        } | competitor_calls
        with threadpool_limits(1):
            medians = cpu_medians_ms(calls, repeats)
        ours = medians.pop("gauge_envs.trajectory_dtw")
        print(f"{title}: gauge_envs.trajectory_dtw {ours:.2f} ms")
        for name, theirs in medians.items():
            verdict = "  SLOWER" if ours >= theirs else ""
            print(f"  {ours / theirs:5.2f} of {name} ({theirs:.2f} ms){verdict}")
            slower |= ours >= theirs
    return int(slower)


if __name__ == "__main__":
    sys.exit(main())
