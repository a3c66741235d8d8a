"""Where the repository is, which ids are rigid, and which ones stand for others, for tests at any depth."""

from pathlib import Path

import pytest

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


def one_of_a_kind(names, kind_of=lambda name: name.rpartition("-")[0]):
    """Parameters of which the default run has the first of each kind, and `-m slow` the others."""
    seen = set()
    found = []
    for name in names:
        kind = kind_of(name)
        found.append(pytest.param(name, marks=pytest.mark.slow if kind in seen else ()))
        seen.add(kind)
    return found
