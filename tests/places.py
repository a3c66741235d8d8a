"""Where the repository is, and which ids are rigid, for tests at any depth."""

from pathlib import Path

import gauge_envs

ROOT = Path(__file__).parents[1]

RIGID_FAMILIES = (
    "SlopeContact",
    "NonsmoothContact",
    "SlopeSlider",
    "Turntable",
    "BouncingBall",
    "NewtonsCradle",
    "WallBreaking",
    "Pendulum",
)
RIGID = tuple(v.name for v in gauge_envs.variants() if v.family in RIGID_FAMILIES)
