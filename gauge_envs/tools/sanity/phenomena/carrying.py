"""A cube on a turntable: it rotates with the plate if friction suffices, and slips when the plate stops."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gauge_envs.runs.rollout import Rollout
from gauge_envs.tools.sanity.model import Reality
from gauge_envs.tools.sanity.phenomena.facts import RECORDINGS, position_scatter_mm, recorded
from gauge_envs.tools.sanity.phenomena.phenomenon import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.tools.sanity.scenario import Scenario

MATERIALS = ("wood", "plastic", "metal")
TURN_S = 94 / 30
"""Time of the published frames of the turntable [s]."""

STEADY_S = (2.3, 3.0)
"""Time between the acceleration after the first stop and the last published frame [s]."""


def phenomena() -> Iterator[Phenomenon]:
    """Yield co-rotation for three materials, and the slip at a stop."""
    for material in MATERIALS:
        yield _carried(material)
    yield _slip()


def _on_plate_mm(rollout: Rollout) -> FloatArray:
    """Return positions of the cube in the plate's frame [mm], shape [sample_count, 3]."""
    arm = rollout.position("cube") - rollout.position("plate")
    return np.asarray(1e3 * rollout.rotation("plate").apply(arm, inverse=True))


def _carried(material: str) -> Phenomenon:
    scenario = Scenario(name=f"turn-{material}", variant=f"Turntable-1-{material}", seconds=TURN_S)

    def slip_mm(rollout: Rollout) -> FloatArray:
        place = _on_plate_mm(rollout)[:, :2]
        return np.asarray(np.linalg.norm(place - place[0], axis=1))

    # The plane of the plate has two axes.
    scatter = float(np.sqrt(2.0)) * position_scatter_mm(scenario.variant)
    return Phenomenon(
        id=f"carry-{material}",
        title=f"static friction, {material}: slip on a slow turntable within 3 s",
        quantity="slip",
        scenario=scenario,
        unit="mm",
        reality=Reality.law(
            0.0,
            tolerance=scatter,
            source="Coulomb, omega^2 r < mu g",
            rationale="standard deviation of a position of this cube on this table in real trials (paper, Table 5)",
        ),
        needs_friction=True,
        read=lambda rollout: PhenomenonValue(value=float(slip_mm(rollout)[-1])),
        trace=Trace(label="slip on the plate [mm]", values=slip_mm, is_level=True),
    )


def _slip() -> Phenomenon:
    scenario = Scenario(name="stop", variant="Turntable-3-metal", seconds=TURN_S)
    real = recorded("turntable", "slip_after_first_stop_deg")
    radius = recorded("turntable", "radius_at_start_mm")

    def slip_deg(rollout: Rollout) -> FloatArray:
        place = _on_plate_mm(rollout)
        angle = np.unwrap(np.arctan2(place[:, 1], place[:, 0]))
        return np.asarray(np.degrees(angle - angle[0]))

    scatter = float(np.degrees(position_scatter_mm(scenario.variant) / radius["value"]))
    return Phenomenon(
        id="slip",
        title="kinetic friction, metal: slip when the turntable reverses",
        quantity="slip",
        scenario=scenario,
        unit="deg",
        reality=Reality.measured(
            real["value"],
            scatter=scatter,
            trial_count=1,
            source=f"one recorded trial ({RECORDINGS}); scatter: of a position along the circle of {scenario.variant} "
            "(paper, Table 5)",
        ),
        needs_friction=True,
        read=lambda rollout: PhenomenonValue(value=float(slip_deg(rollout)[rollout.between(*STEADY_S)].mean())),
        trace=Trace(label="slip on the plate [deg]", values=slip_deg),
    )
