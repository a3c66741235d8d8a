"""Momentum that the first impact of Newton's cradle transfers, for gaps between the balls and steps of MuJoCo.

    python -m studies.newtons_cradle.cradle     prints the table of the study

Balls that touch share one impact. Balls with a gap collide one after another, as in an event-driven chain.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.evaluation.metrics.events import momentum_transfer_efficiency
from gauge_envs.pages.text import markdown_row
from gauge_envs.scene import Hinge
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

VARIANT = "NewtonsCradle-metal"
BALLS = tuple(f"ball-{number}" for number in range(1, 6))
GAPS_M = (0.0, 1e-5, 1e-4, 1e-3)
STEPS_PER_S = (1800, 9000, 36000)
DURATION_S = 0.6
"""The last ball turns within this time for every gap."""


def gap_parameters(gap_m: float, restitution: float | None = None) -> dict[str, Any]:
    """Return the overrides of a cradle with gaps between its balls.

    Args:
        gap_m: Gap between two neighbours [m].
        restitution: Restitution of all balls; None keeps the calibrated one.
    """
    scene = load_experiment(VARIANT).scene
    anchors = {
        joint.body: joint.anchor_m for joint in scene.joints if isinstance(joint, Hinge)
    }
    overrides: dict[str, Any] = {}
    for number, ball in enumerate(BALLS):
        x, y, z = anchors[ball]
        overrides[f"{ball}.hangs_from_m"] = (x, y + number * gap_m, z)
    if restitution is not None:
        # The contacts of all balls have that of the first.
        overrides[f"{BALLS[0]}.restitution"] = restitution
    return overrides


def transfer(parameters: Mapping[str, Any], *, steps_per_s: int) -> float:
    """Return the momentum transfer efficiency of the first impact, MuJoCo with a number of steps a second."""
    scene = load_experiment(VARIANT, dict(parameters)).scene
    hinge = next(
        j for j in scene.joints if isinstance(j, Hinge) and j.body == BALLS[-1]
    )
    simulation = backend("mujoco").build(scene, {"timestep_s": 1.0 / steps_per_s})
    simulation.reset(0)
    heights_mm = []
    for _ in range(round(DURATION_S / SAMPLE_INTERVAL_S)):
        heights_mm.append(1e3 * simulation.body_states([BALLS[-1]])[0, 2])
        simulation.advance(SAMPLE_INTERVAL_S)
    drop_mm = 1e3 * (hinge.anchor_m[2] - scene.body(BALLS[-1]).pose.position_m[2])
    return momentum_transfer_efficiency(
        np.array(heights_mm),
        drop_height_mm=drop_mm,
        rest_height_mm=1e3 * hinge.anchor_m[2] - drop_mm,
    )


def main() -> None:
    """Print the table."""
    effective = load_experiment(VARIANT, "effective").overrides[
        f"{BALLS[0]}.restitution"
    ]
    print(markdown_row(["e", "gap [mm]", *(f"1/{steps} s" for steps in STEPS_PER_S)]))
    print(markdown_row(["---"] * (2 + len(STEPS_PER_S))))
    for restitution in (None, float(effective)):
        for gap_m in GAPS_M:
            parameters = gap_parameters(gap_m, restitution)
            cells = [
                f"{transfer(parameters, steps_per_s=steps):.4f}"
                for steps in STEPS_PER_S
            ]
            print(
                markdown_row(
                    [
                        "0.202" if restitution is None else f"{restitution:.3f}",
                        f"{1e3 * gap_m:g}",
                        *cells,
                    ]
                )
            )


if __name__ == "__main__":
    main()
