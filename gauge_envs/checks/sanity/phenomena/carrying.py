"""A cube on a plate that turns: carried along where friction suffices, slipping where the plate stops."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.checks.sanity.model import Reality
from gauge_envs.checks.sanity.phenomena.facts import RECORDINGS, position_scatter_mm, recorded
from gauge_envs.checks.sanity.phenomena.kit import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.checks.sanity.scenario import Rollout, Scenario

__all__ = [
    "phenomena",
]

MATERIALS = ("wood", "plastic", "metal")
TURN_S = 94 / 30
"""The published frames of the turntable [s]."""

STEADY_S = (2.3, 3.0)
"""Between the spin-up after the first stop and the last published frame."""


def phenomena() -> Iterator[Phenomenon]:
    """Co-rotation of three materials, and the slip at a stop."""
    for material in MATERIALS:
        yield _carried(material)
    yield _slip()


def _on_plate_mm(run: Rollout) -> FloatArray:
    """Place of the cube in the plate's frame [mm], shape [sample_count, 3]."""
    plate = run.states["plate"]
    turn = Rotation.from_quat(plate[:, 3:7], scalar_first=True)
    return np.asarray(1e3 * turn.apply(run.position("cube") - plate[:, :3], inverse=True))


def _carried(material: str) -> Phenomenon:
    stage = Scenario(name=f"turn-{material}", variant=f"Turntable-1-{material}", seconds=TURN_S)

    def slip_mm(run: Rollout) -> FloatArray:
        place = _on_plate_mm(run)[:, :2]
        return np.asarray(np.linalg.norm(place - place[0], axis=1))

    # Two axes lie in the plate's plane.
    scatter = float(np.sqrt(2.0)) * position_scatter_mm(stage.variant)
    return Phenomenon(
        id=f"carry-{material}",
        title=f"static friction, {material}: slip on a slow turntable within 3 s",
        quantity="slip",
        stage=stage,
        unit="mm",
        reality=Reality(
            value=0.0,
            scatter=scatter,
            source="Coulomb, omega^2 r < mu g; scatter: of a place in the plane of the table, of real trials (paper, "
            "Table 5)",
        ),
        read=lambda run: PhenomenonValue(value=float(slip_mm(run)[-1])),
        trace=Trace(label="slip on the plate [mm]", values=slip_mm, is_level=True),
    )


def _slip() -> Phenomenon:
    stage = Scenario(name="stop", variant="Turntable-3-metal", seconds=TURN_S)
    real = recorded("turntable", "slip_after_first_stop_deg")
    radius = recorded("turntable", "radius_at_start_mm")

    def slip_deg(run: Rollout) -> FloatArray:
        place = _on_plate_mm(run)
        angle = np.unwrap(np.arctan2(place[:, 1], place[:, 0]))
        return np.asarray(np.degrees(angle - angle[0]))

    scatter = float(np.degrees(position_scatter_mm(stage.variant) / radius["value"]))
    return Phenomenon(
        id="slip",
        title="kinetic friction, metal: slip when the turntable reverses",
        quantity="slip",
        stage=stage,
        unit="deg",
        reality=Reality(
            value=real["value"],
            scatter=scatter,
            source=f"one recorded trial ({RECORDINGS}); scatter: of a place along the circle of {stage.variant} "
            "(paper, Table 5)",
        ),
        read=lambda run: PhenomenonValue(value=float(slip_deg(run)[run.between(*STEADY_S)].mean())),
        trace=Trace(label="slip on the plate [deg]", values=slip_deg),
    )
