"""Grasps: a box between two pads; and a ball that rolls.

The contacts have the target's constants, and friction 0.5.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

from gauge_envs.fixtures.grasp import (
    GRASPED,
    PRESSED,
    TURNED,
    pad_creep_um_per_s,
    pad_depth_um,
    spin_torque_share,
)
from gauge_envs.fixtures.recording import Recording
from gauge_envs.fixtures.turning import turning_scene
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.object_checks.check import ObjectCheck, Scenario
from gauge_envs.tools.sanity.training import Need
from gauge_envs.tools.sanity.verdict import Reality

ROLLS_M_PER_S, RADIUS_M = 0.3, 0.03
"""Speed at the start, and radius of the ball [m]."""

MAX_ROLLING_MM = 7.0
"""Largest rolling friction of the published pairs, which hard rubber on steel has."""


def _check(
    title: str,
    scenario: str,
    scene: Scene,
    unit: str,
    reality: Reality,
    value: Callable[[Recording], float],
    wrenches: Mapping[str, FloatArray] = PRESSED,
) -> ObjectCheck:
    shown = Scenario(
        scenario, "SlopeSlider-1-wood", scene.duration_s, scene, wrenches=wrenches
    )
    return ObjectCheck(title, shown, unit, reality, value, needs=(Need.FRICTION,))


def creep() -> ObjectCheck:
    """Return the creep of a box whose pads press with twice its weight.

    A hand that lifts its box with an acceleration a needs the friction m (g + a) / (2 N). At rest the pads need half of
    their friction: they hold while a is below g.
    """
    law = Reality(
        0.0,
        10.0,
        "Coulomb: v = 0 if m g < 2 mu N",
        "0.1 mm, as for a cube that holds, in a carry of 10 s",
    )
    title = "creep of a box out of its grasp"
    return _check(title, "grasp", GRASPED, "um/s", law, pad_creep_um_per_s)


def sink() -> ObjectCheck:
    """Return the depth of these pads in the box."""
    law = Reality(0.0, 200.0, "rigid bodies: depth = 0", "as for a height at rest")
    title = "depth of two pads in the box that they grasp"
    return _check(title, "grasp", GRASPED, "um", law, pad_depth_um)


def torsion() -> ObjectCheck:
    """Return the torque that these pads resist.

    The torque over mu N times the side of a pad is the mean distance of the pressure from the centre: 0.383 for even
    pressure, (sqrt 2 + ln(1 + sqrt 2)) / 6, and 0.707 for pressure at the corners.
    """
    law = Reality(
        0.545,
        0.16845,
        "Coulomb, integrated over a square face; rigid bodies leave the pressure open: mean distance of the "
        "pressure from the centre: 0.383 (even, (sqrt 2 + ln(1 + sqrt 2)) / 6) to 0.707 (corners)",
        "between even pressure, 0.38, and corners alone, 0.71",
    )
    title = "torque that a pair of pads holds"
    return _check(title, "grasp-torsion", TURNED, "1", law, spin_torque_share)


def rolling() -> ObjectCheck:
    """Return the torque against rolling over the normal force, from the energy that a ball loses on its path."""
    law = Reality(
        0.0,
        MAX_ROLLING_MM,
        "hard rubber on steel: CDA3000, table 7.22",
        "the largest of the pairs of gauge list materials",
    )
    real = replace(law, limits=f"at most {MAX_ROLLING_MM:g}")

    def arm_mm(rollout: Recording) -> float:
        lost = ROLLS_M_PER_S**2 - rollout.states["ball"][-1, 7] ** 2
        return float(
            700.0 * RADIUS_M * lost / (G * rollout.displacement("ball")[-1, 0])
        )

    scene = turning_scene(0.5, ROLLS_M_PER_S, (0.0, ROLLS_M_PER_S / RADIUS_M, 0.0))
    title = "torque against rolling over the normal force"
    return _check(title, "roll", scene, "mm", real, arm_mm, {})
