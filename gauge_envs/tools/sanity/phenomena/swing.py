"""A frictionless pendulum: its period, and its energy loss in a hundred seconds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gauge_envs.evaluation.metrics.events import energy_loss
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import Hinge, Sphere
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S
from gauge_envs.tools.conformance.laws import pendulum_period_s
from gauge_envs.tools.sanity.model import Reality
from gauge_envs.tools.sanity.phenomena.facts import RECORDINGS, recorded
from gauge_envs.tools.sanity.phenomena.phenomenon import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.tools.sanity.scenario import Scenario

VARIANT = "Pendulum-metal"
PERIOD_S = 10.0
"""Time of the first 300 frames, for which the period is published [s]."""

CURVE_S = 5.0
"""Drawn time, about four periods [s]."""

PRINTED = 0.01
"""Last printed digit of the published energy loss."""

PERIOD_TOLERANCE = 0.01
"""Relative tolerance of the period."""


def phenomena() -> Iterator[Phenomenon]:
    """Yield the period and the energy loss."""
    real = published_baselines(VARIANT)["el"]
    scenario = Scenario(
        name="pendulum", variant=VARIANT, seconds=(real.frames - 1) / FRAME_RATE_HZ, interval_s=SAMPLE_INTERVAL_S
    )
    hinge = next(joint for joint in scenario.scene.joints if isinstance(joint, Hinge))
    ball = scenario.scene.body(hinge.body)
    assert isinstance(ball.shape, Sphere)
    arm = np.asarray(ball.pose.position_m) - hinge.anchor_m
    length = float(np.linalg.norm(arm))

    def aside_mm(rollout: Rollout) -> FloatArray:
        return np.asarray(1e3 * (rollout.position(ball.name)[:, 0] - hinge.anchor_m[0]))

    def read_period(rollout: Rollout) -> PhenomenonValue:
        part = rollout.between(0.0, PERIOD_S)
        return PhenomenonValue(value=_period_s(rollout.times_s[part], aside_mm(rollout)[part]))

    def read_energy(rollout: Rollout) -> PhenomenonValue:
        height = 1e3 * rollout.position(ball.name)[:, 2]
        return PhenomenonValue(value=energy_loss(height, rest_height_mm=1e3 * (hinge.anchor_m[2] - length)))

    period = recorded("pendulum", "period_s")
    law = pendulum_period_s(
        length_m=length,
        gyration_m=float(np.sqrt(0.4)) * ball.shape.radius_m,
        amplitude_rad=float(np.arccos(-arm[2] / length)),
        gravity_m_per_s2=scenario.scene.gravity_m_per_s2,
    )
    yield Phenomenon(
        id="period",
        title="pendulum: period from 90 degrees",
        quantity="period",
        scenario=scenario,
        unit="s",
        reality=Reality.law(
            law,
            tolerance=PERIOD_TOLERANCE * law,
            source=f"elliptic integral with the scene's length; a recorded trial shows {period['value']:.3f} +- "
            f"{period['sigma']:.3f} s with real damping ({RECORDINGS})",
            rationale=f"{PERIOD_TOLERANCE:.0%}, an error of one swing in a hundred; the recording resolves no less",
        ),
        read=read_period,
        trace=Trace(label="horizontal displacement [mm]", values=aside_mm, until_s=CURVE_S),
    )
    yield Phenomenon(
        id="energy",
        title=f"pendulum: energy lost within {scenario.seconds:.0f} s",
        quantity="energy loss",
        scenario=scenario,
        unit="1",
        reality=Reality.law(
            real.mean,
            tolerance=PRINTED,
            source="energy loss of real trials, published as 0.00 (paper, Table 5)",
            rationale="last printed digit of the published loss",
        ),
        read=read_energy,
    )


def _period_s(times_s: FloatArray, aside: FloatArray) -> float:
    """Return the mean time between passes through the lowest point in one direction [s]; NaN for fewer than two."""
    passes = np.flatnonzero((aside[:-1] < 0.0) & (aside[1:] >= 0.0))
    share = -aside[passes] / (aside[passes + 1] - aside[passes])
    moments = times_s[passes] + share * (times_s[1] - times_s[0])
    return float((moments[-1] - moments[0]) / (len(moments) - 1)) if len(moments) > 1 else float("nan")
