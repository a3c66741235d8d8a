"""Check the gravity of a target."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import length_of
from gauge_envs.tools.sanity.model_checks.check import Finding, TargetCheck
from gauge_envs.tools.sanity.training import Need, TrainingConfiguration
from gauge_envs.tools.sanity.verdict import NotApplicableError, Reality

TARGET = "the target"
"""Part of a check of the target as a whole."""

MAX_SLOPE_DEG = 60.0
"""Largest angle between gravity and the normal of the ground [degrees]: a tilted gravity stands for a slope."""


def gravity_finding(configuration: TrainingConfiguration) -> Finding:
    """Return the size of gravity. Another size is a warning at worst, as it can be another planet's gravity."""
    absent = configuration.inapplicable.get(Need.GRAVITY)
    if absent is not None:
        raise NotApplicableError(absent)
    gravity = configuration.gravity_m_per_s2
    if gravity is None:
        raise NotApplicableError("the target does not give its gravity")
    size = length_of(np.asarray(gravity))
    down = -float(np.asarray(configuration.up) @ gravity)
    tilt_deg = math.degrees(math.acos(np.clip(down / size, -1.0, 1.0)))
    # A tilted gravity pushes to the side.
    size = min(size, down, key=lambda value: abs(value - GRAVITY_M_PER_S2))
    found = Finding(value=size, parts={TARGET: size}, is_usual=True)
    if tilt_deg <= MAX_SLOPE_DEG:
        return found
    remark = f"gravity and the ground's normal are {tilt_deg:.3g} degrees apart"
    return replace(found, remark=remark, is_usual=False, deviation=math.inf)


gravity = TargetCheck(
    id="gravity",
    title="size of gravity, which points to the ground",
    unit="m/s^2",
    reality=Reality(
        GRAVITY_M_PER_S2,
        tolerance=0.05,
        source="standard gravity",
        rationale="covers every place on Earth, 9.76 to 9.83 m/s^2",
    ),
    measure=gravity_finding,
)
