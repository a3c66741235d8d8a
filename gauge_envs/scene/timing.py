"""Rates at which this package records, scores and drives motions."""

import numpy as np
from numpy.typing import NDArray

FRAME_RATE_HZ = 30.0
"""Frame rate of recorded and scored trajectories [Hz] (paper, data acquisition)."""

MAX_FRAMES = 18_000
"""Largest number of frames in a task file: 10 minutes."""

SAMPLES_PER_FRAME = 6
"""Samples per frame: 180 Hz, the rate of the motion-capture cameras (paper, data acquisition)."""

SAMPLE_INTERVAL_S = 1.0 / (FRAME_RATE_HZ * SAMPLES_PER_FRAME)
"""Time between samples [s]."""

DRIVE_INTERVAL_S = 1.0 / 180.0
"""Interval in which environments drive bodies and advance the simulation [s]."""


def frame_times_s(count: int) -> NDArray[np.float64]:
    """Return the times of the first frames [s], shape [count]."""
    return np.arange(count) / FRAME_RATE_HZ
