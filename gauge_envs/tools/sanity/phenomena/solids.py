"""Soft solids: foam in tension and compression, and an oscillating beam of rubber blocks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.signal import argrelextrema

from gauge_envs.observables.functions import face_areas_mm2
from gauge_envs.runs.rollout import Rollout
from gauge_envs.tools.sanity.model import Reality
from gauge_envs.tools.sanity.phenomena.facts import RECORDINGS, facts, recorded
from gauge_envs.tools.sanity.phenomena.phenomenon import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.tools.sanity.scenario import Scenario

GRIPPED_S = 1.2
"""Time after which the grips rest; they stop at 1.10 and 1.15 s [s]."""

SWING_S = 1.1
"""Time of three extrema at the recorded frequency, or five at that of the scene's constants [s]."""

TIP_M = 1e-3
"""Distance from the furthest marker within which a marker belongs to the tip of the beam [m]."""


def phenomena() -> Iterator[Phenomenon]:
    """Yield the area of foam in tension and in compression, and the frequency of a beam."""
    yield _area("stretch", "FoamStretching-soft", "foam_stretching", "pulled")
    yield _area("compress", "FoamCompressing-soft", "foam_compressing", "compressed")
    yield _beam()


def _area(name: str, variant: str, recording: str, verb: str) -> Phenomenon:
    grip = recorded(recording, "grip_mm")["value"]

    def change(rollout: Rollout) -> FloatArray:
        assert rollout.scene.markers is not None
        area = face_areas_mm2(rollout.markers_m, rollout.scene.markers.faces).sum(axis=1)
        return np.asarray(100.0 * (area / area[0] - 1.0))

    return Phenomenon(
        id=f"foam-{name}",
        title=f"foam, {verb} by {abs(grip):.0f} mm: change of the area of its marked face",
        quantity="change",
        scenario=Scenario(name=f"foam-{name}", variant=variant, seconds=GRIPPED_S),
        unit="%",
        reality=Reality.measured(
            100.0 * recorded(recording, "area_change_ratio")["value"],
            scatter=100.0 * facts("recordings/recordings")[recording]["uncertainty"]["relative"],
            trial_count=1,
            source=f"one recorded trial of soft or hard foam; scatter: of the measurement ({RECORDINGS})",
        ),
        read=lambda rollout: PhenomenonValue(value=float(change(rollout)[-1])),
        trace=Trace(label="change of the area [%]", values=change),
    )


def _beam() -> Phenomenon:
    real = recorded("cantilever_beam", "frequency_hz")

    def height_mm(rollout: Rollout) -> FloatArray:
        # The beam starts level, along y, from its pedestal.
        reach = np.abs(rollout.markers_m[0, :, 1] - rollout.scene.body("base").pose.position_m[1])
        tip = reach > reach.max() - TIP_M
        return np.asarray(1e3 * rollout.markers_m[:, tip, 2].mean(axis=1))

    def read(rollout: Rollout) -> PhenomenonValue:
        return PhenomenonValue(value=_frequency_hz(rollout.times_s, height_mm(rollout)))

    return Phenomenon(
        id="beam",
        title="beam of rubber blocks: frequency of its oscillation",
        quantity="frequency",
        scenario=Scenario(name="beam", variant="CantileverBeam-soft", seconds=SWING_S),
        unit="Hz",
        reality=Reality.measured(
            real["value"],
            scatter=real["sigma"],
            trial_count=1,
            source=f"one recorded trial ({RECORDINGS})",
        ),
        advisory="the modulus of the blocks is not published, and the scene has that of the rubber rod",
        read=read,
        trace=Trace(label="height of the tip [mm]", values=height_mm),
    )


def _frequency_hz(times_s: FloatArray, height: FloatArray) -> float:
    """Return the frequency [Hz] from the times between extrema; NaN for fewer than two of them."""
    extrema = np.sort(np.concatenate([argrelextrema(height, np.less)[0], argrelextrema(height, np.greater)[0]]))
    if len(extrema) < 2:
        return float("nan")
    # Apex of the parabola through three samples.
    before, at, after = height[extrema - 1], height[extrema], height[extrema + 1]
    apex = times_s[extrema] + 0.5 * (before - after) / (before - 2.0 * at + after) * (times_s[1] - times_s[0])
    return float(0.5 * (len(apex) - 1) / (apex[-1] - apex[0]))
