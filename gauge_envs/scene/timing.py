"""Rates at which trajectories are recorded, scored and driven."""

FRAME_RATE_HZ = 30.0
"""Rate at which trajectories are recorded and scored [Hz] (paper, data acquisition)."""

MOST_FRAMES = 18_000
"""Largest number of frames that a file can state: 10 minutes."""

SAMPLES_PER_FRAME = 6
"""Samples kept per frame: 180 Hz, the rate of the motion-capture cameras (paper, data acquisition)."""

SAMPLE_INTERVAL_S = 1.0 / (FRAME_RATE_HZ * SAMPLES_PER_FRAME)
"""Time between samples [s]."""

DRIVE_INTERVAL_S = 1.0 / 180.0
"""Interval in which environments prescribe motion and advance the simulation [s]."""
