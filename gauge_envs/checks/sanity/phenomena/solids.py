"""Foam that is pulled and pushed, and a beam of rubber blocks that swings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.signal import argrelextrema

from gauge_envs.checks.sanity.model import Reality
from gauge_envs.checks.sanity.phenomena.facts import RECORDINGS, facts, recorded
from gauge_envs.checks.sanity.phenomena.kit import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.checks.sanity.scenario import Rollout, Scenario
from gauge_envs.observables.functions import face_areas_mm2

__all__ = [
    "phenomena",
]

GRIPPED_S = 1.2
"""The grips have come to rest, after 1.10 and 1.15 s [s]."""

SWING_S = 1.1
"""Three turning points at the recorded frequency, five at that of the scene's constants [s]."""

TIP_M = 1e-3
"""Markers this close to the furthest one sit at the tip of the beam [m]."""


def phenomena() -> Iterator[Phenomenon]:
    """Area of foam in tension and in compression, frequency of a beam."""
    yield _area("stretch", "FoamStretching-soft", "foam_stretching", "pulled")
    yield _area("compress", "FoamCompressing-soft", "foam_compressing", "pushed together")
    yield _beam()


def _area(name: str, variant: str, recording: str, verb: str) -> Phenomenon:
    grip = recorded(recording, "grip_mm")["value"]

    def change(run: Rollout) -> FloatArray:
        assert run.scene.markers is not None
        area = face_areas_mm2(run.markers_m, run.scene.markers.faces).sum(axis=1)
        return np.asarray(100.0 * (area / area[0] - 1.0))

    return Phenomenon(
        id=f"foam-{name}",
        title=f"foam, {verb} by {abs(grip):.0f} mm: change of the area of its marked face",
        quantity="change",
        stage=Scenario(name=f"foam-{name}", variant=variant, seconds=GRIPPED_S),
        unit="%",
        reality=Reality(
            value=100.0 * recorded(recording, "area_change_ratio")["value"],
            scatter=100.0 * facts("recordings/recordings")[recording]["uncertainty"]["relative"],
            source=f"one recorded trial of soft or hard foam; scatter: of the measurement ({RECORDINGS})",
        ),
        read=lambda run: PhenomenonValue(value=float(change(run)[-1])),
        trace=Trace(label="change of the area [%]", values=change),
    )


def _beam() -> Phenomenon:
    real = recorded("cantilever_beam", "frequency_hz")

    def height_mm(run: Rollout) -> FloatArray:
        # The beam starts level, along y, from its pedestal.
        reach = np.abs(run.markers_m[0, :, 1] - run.scene.body("base").pose.position_m[1])
        tip = reach > reach.max() - TIP_M
        return np.asarray(1e3 * run.markers_m[:, tip, 2].mean(axis=1))

    def read(run: Rollout) -> PhenomenonValue:
        return PhenomenonValue(value=_frequency_hz(run.times_s, height_mm(run)))

    return Phenomenon(
        id="beam",
        title="beam of rubber blocks: frequency of its swing",
        quantity="frequency",
        stage=Scenario(name="beam", variant="CantileverBeam-soft", seconds=SWING_S),
        unit="Hz",
        reality=Reality(
            value=real["value"],
            scatter=real["sigma"],
            source=f"one recorded trial ({RECORDINGS}); the modulus of the blocks is not published, and the scene has "
            "that of the rubber rod, so a stiffer beam is not the engine's doing",
        ),
        read=read,
        trace=Trace(label="height of the tip [mm]", values=height_mm),
    )


def _frequency_hz(times_s: FloatArray, height: FloatArray) -> float:
    """Swings a second, from the times between turning points; NaN for fewer than two of them."""
    turns = np.sort(np.concatenate([argrelextrema(height, np.less)[0], argrelextrema(height, np.greater)[0]]))
    if len(turns) < 2:
        return float("nan")
    # Apex of the parabola through three samples.
    before, at, after = height[turns - 1], height[turns], height[turns + 1]
    apex = times_s[turns] + 0.5 * (before - after) / (before - 2.0 * at + after) * (times_s[1] - times_s[0])
    return float(0.5 * (len(apex) - 1) / (apex[-1] - apex[0]))
