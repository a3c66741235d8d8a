"""Judge the gravity of a target, which needs no rollout."""

from __future__ import annotations

import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity.languages import Language
from gauge_envs.tools.sanity.model import (
    INSIDE_WITHIN,
    VISIBLE_WITHIN,
    Cause,
    Need,
    PhenomenonResult,
    Reality,
    TrainingConfiguration,
    Verdict,
)

GRAVITY_ID = "gravity"
GRAVITY_TITLE = "gravity: size and direction"

GRAVITY_REALITY = Reality.law(
    GRAVITY_M_PER_S2,
    tolerance=0.05,
    source="standard gravity, perpendicular to the ground",
    rationale="covers every place on Earth, 9.76 to 9.83 m/s^2, and a tilt of 0.3 degrees",
)
"""Gravity on Earth. A deviation is the length of the difference of the two vectors."""

LEAST_TILT_DEG = 0.1
"""Smallest tilt that is reported [degrees]."""


def upright_gravity(configuration: TrainingConfiguration) -> tuple[float, float, float]:
    """Return standard gravity against the direction away from the ground [m/s^2]."""
    x, y, z = (-GRAVITY_M_PER_S2 * np.asarray(configuration.up)).tolist()
    return x, y, z


def gravity_row(configuration: TrainingConfiguration, language: Language) -> PhenomenonResult:
    """Return the row on the gravity of a configuration; declined when the target states none or switches it off."""
    gravity = configuration.gravity_m_per_s2
    absent = configuration.inapplicable.get(Need.GRAVITY)
    if gravity is None or absent is not None:
        remark = absent or "the target states no gravity; the experiments have their own"
        return _row(None, Verdict.DECLINED, remark=remark, applies=False)
    vector, down = np.asarray(gravity), np.asarray(upright_gravity(configuration))
    size = float(np.linalg.norm(vector))
    cosine = float(vector @ down) / (size * GRAVITY_M_PER_S2)
    tilt = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    deviation = float(np.linalg.norm(vector - down)) / GRAVITY_REALITY.tolerance
    if deviation <= INSIDE_WITHIN:
        return _row(size, Verdict.INSIDE)
    verdict = Verdict.VISIBLE if deviation <= VISIBLE_WITHIN else Verdict.WRONG
    was = " ".join(f"{component:g}" for component in gravity)
    line = f"{language.gravity_text(upright_gravity(configuration))} instead of {was}"
    remark = f"tilted by {tilt:.2g} degrees" if tilt > LEAST_TILT_DEG else ""
    return _row(size, verdict, remark=remark, cause=Cause(settings=(GRAVITY_ID,), line=line))


def _row(
    value: float | None, verdict: Verdict, *, remark: str = "", applies: bool = True, cause: Cause | None = None
) -> PhenomenonResult:
    return PhenomenonResult(
        phenomenon=GRAVITY_ID,
        title=GRAVITY_TITLE,
        experiment="",
        unit="m/s^2",
        reality=GRAVITY_REALITY,
        default=None if value is None else GRAVITY_M_PER_S2,
        configured=value,
        verdict=verdict,
        default_verdict=Verdict.INSIDE,
        cause=cause,
        remark=remark,
        applies=applies,
    )
