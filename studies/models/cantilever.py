"""Solve the cantilever test of fabrics on MuJoCo, and extrapolate it as references of grade `model` are.

    python -m studies.models.cantilever

ASTM D1388 and ISO 9073-7 slide a strip over an edge until the line from the edge to its tip falls by 41.5 degrees. The
overhang O is then twice the bending length, O^3 = 8 D / w, with the bending stiffness D and the weight w per area
(Peirce 1930). So a strip with O^3 w / D = 8 must hang at 41.5 degrees. Air brings it to rest; Newton has none.

A mesh clamps the strip half a cell inside its edge: the first hinge that can bend lies there. `heavy_elastica` says at
which angle such a strip hangs, so each cell has an expected angle of its own.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.integrate import solve_bvp

from gauge_envs.backends import backend
from gauge_envs.scene import Air
from gauge_envs.tools.conformance.cloth import (
    BENT_FABRIC,
    BENT_FREE_M,
    BENT_GRAVITY,
    CLAMP_SHARE,
    cantilever_strip,
)
from scripts.extrapolation import extrapolate

STANDARD_DEG = 41.5
"""Angle of the standards, at which the overhang is twice the bending length."""

LOAD = 8.0
"""O^3 w / D at the angle of the standards."""

CELL_M = 0.025
"""Cell of the default settings [m]."""

SECONDS = 20.0

STATED_S = 6.0
"""Duration of the scene, which bounds speeds and so the step that air allows."""

AIR = Air(density_kg_per_m3=2.0, normal_coefficient=2.0)

LEVELS = {
    "cell": (
        ({}, 1.0),
        ({"cell_m": CELL_M / 2.0}, 0.5),
        ({"cell_m": CELL_M / 3.0}, 1.0 / 3.0),
    ),
    "step": (({}, 1.0), ({"timestep_s": 1 / 1800}, 0.5)),
}
"""Settings of the runs of each parameter, and its size over the default one."""


def heavy_elastica(load: float) -> tuple[float, float]:
    """Return where the tip of a heavy strip lies from its clamp, forward and down, over its free length.

    D theta'' = -w (O - s) cos(theta), with theta = 0 at the clamp and no moment at the tip (Wang, "A critical review of
    the heavy elastica", 1986).

    Args:
        load: O^3 w / D.
    """

    def slopes(s: np.ndarray, state: np.ndarray) -> np.ndarray:
        theta, bend = state[:2]
        return np.array(
            [bend, -load * (1.0 - s) * np.cos(theta), np.cos(theta), np.sin(theta)]
        )

    def ends(clamp: np.ndarray, tip: np.ndarray) -> np.ndarray:
        return np.array([clamp[0], tip[1], clamp[2], clamp[3]])

    s = np.linspace(0.0, 1.0, 101)
    start = np.array([s, 1.0 - s, s, s**2])
    solution = solve_bvp(slopes, ends, s, start, tol=1e-9)
    if not solution.success:
        raise ArithmeticError(solution.message)
    return float(solution.y[2, -1]), float(solution.y[3, -1])


def expected_angle_deg(cell_m: float) -> float:
    """Return the angle from the edge to the tip of a strip that is clamped half a cell inside its edge [deg]."""
    inside_m = 0.5 * cell_m
    free_m = BENT_FREE_M + inside_m
    forward, down = heavy_elastica(LOAD * (free_m / BENT_FREE_M) ** 3)
    return float(np.degrees(np.arctan2(down * free_m, forward * free_m - inside_m)))


def resting_angle_deg(settings: dict[str, float | str]) -> tuple[float, float]:
    """Return the angle of the line from the edge to the tip [deg], and half its range over the last five seconds.

    The strip still swings a little. A mean under a Hann window over these seconds is the angle at rest.
    """
    # A softer fabric bends as far at the gravity of the check, and moves slowly enough for air to stop it.
    weight_n_per_m2 = BENT_FABRIC.areal_density_kg_per_m2 * BENT_GRAVITY
    load = BENT_FREE_M**3 * weight_n_per_m2 / BENT_FABRIC.bend_stiffness_n_m_per_rad
    softer = LOAD / load
    made_of = replace(
        BENT_FABRIC,
        bend_stiffness_n_m_per_rad=BENT_FABRIC.bend_stiffness_n_m_per_rad / softer,
    )
    scene = replace(
        cantilever_strip(made_of),
        gravity_m_per_s2=BENT_GRAVITY,
        air=AIR,
        duration_s=STATED_S,
    )
    simulation = backend("mujoco").build(scene, {"solver": "CG"} | settings)
    name = scene.deformables[0].name
    start = simulation.nodes(name).copy()
    edge = start[:, 0].min() + CLAMP_SHARE * BENT_FREE_M
    tip = start[:, 0] > start[:, 0].max() - 1e-6
    angles = []
    for _ in range(round(SECONDS * 30)):
        simulation.advance(1.0 / 30.0)
        x, _, z = simulation.nodes(name)[tip].mean(axis=0)
        angles.append(np.degrees(np.arctan2(start[0, 2] - z, x - edge)))
    simulation.close()
    last = np.array(angles[-150:])
    return float(np.average(last, weights=np.hanning(152)[1:-1])), 0.5 * float(
        np.ptp(last)
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the script and return its exit status."""
    plain = argparse.RawDescriptionHelpFormatter
    argparse.ArgumentParser(description=__doc__, formatter_class=plain).parse_args(
        arguments
    )
    base, still = resting_angle_deg({})
    total, square = base, 0.0
    expected = f"{expected_angle_deg(CELL_M):.3f}"
    rows = [["default", 1.0, f"{base:.3f}", f"{still:.3f}", "", "", expected]]
    for parameter, levels in LEVELS.items():
        found = [
            (base, still) if not settings else resting_angle_deg(settings)
            for settings, _ in levels
        ]
        factors = [factor for _, factor in levels]
        result = extrapolate([np.array([[angle]]) for angle, _ in found], factors)
        total, square = (
            total + float(result.correction[0, 0]),
            square + float(result.uncertainty[0, 0]) ** 2,
        )
        for (angle, moving), factor in zip(found, factors, strict=True):
            order = "" if result.order is None else f"{result.order:.2f}"
            cell_m = factor * CELL_M if parameter == "cell" else CELL_M
            rows.append(
                [
                    parameter,
                    f"{factor:.3g}",
                    f"{angle:.3f}",
                    f"{moving:.3f}",
                    order,
                    "",
                    f"{expected_angle_deg(cell_m):.3f}",
                ]
            )
    exact = expected_angle_deg(0.0)
    rows.append(
        ["solution", 0.0, f"{total:.3f}", "", "", f"{square**0.5:.3f}", f"{exact:.3f}"]
    )
    print(
        f"{total:.2f} +- {square**0.5:.2f} degrees, the elastica {exact:.2f}, the standards {STANDARD_DEG}"
    )
    with (Path(__file__).parent / "cantilever.csv").open(
        "w", encoding="utf-8", newline=""
    ) as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(
            [
                "refined",
                "factor",
                "angle_deg",
                "change_deg",
                "order",
                "uncertainty_deg",
                "elastica_deg",
            ]
        )
        writer.writerows(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
