"""Rates at which trajectories are recorded, scored and driven."""

from __future__ import annotations

__all__ = [
    "DRIVE_INTERVAL_S",
    "FRAME_RATE_HZ",
    "SAMPLES_PER_FRAME",
    "SAMPLE_INTERVAL_S",
]


FRAME_RATE_HZ = 30.0
"""Rate at which trajectories are recorded and scored [Hz] (paper, data acquisition)."""


SAMPLES_PER_FRAME = 6
"""Samples kept per frame: 180 Hz, the rate of the motion-capture cameras (paper, data acquisition)."""


SAMPLE_INTERVAL_S = 1.0 / (FRAME_RATE_HZ * SAMPLES_PER_FRAME)
"""Time between samples, and for which a driven body's motion is prescribed at once [s]."""


DRIVE_INTERVAL_S = 1.0 / 180.0
"""Environments prescribe motion in intervals of 1/180 s and advance by as much."""
