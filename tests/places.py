"""Folder of the repository, rigid ids, and representative ids for tests."""

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


def first_of_each_kind(names, kind_of=lambda name: name.rpartition("-")[0]):
    """Return parameters: the default run has the first of each kind, and `-m slow` the others."""
    seen = set()
    parameters = []
    for name in names:
        kind = kind_of(name)
        parameters.append(
            pytest.param(name, marks=pytest.mark.slow if kind in seen else ())
        )
        seen.add(kind)
    return parameters
