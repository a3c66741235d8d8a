"""Grasps: a box between two pads.

The contacts have the target's constants, and friction 0.5.
"""

from collections.abc import Callable
from dataclasses import replace

from gauge_envs.fixtures.grasp import (
    GRASPED,
    PRESSED,
    pad_creep_um_per_s,
    pad_depth_um,
)
from gauge_envs.fixtures.recording import Recording
from gauge_envs.tools.sanity.object_checks.check import ObjectCheck, Scenario
from gauge_envs.tools.sanity.training import Need
from gauge_envs.tools.sanity.verdict import Reality


def _check(
    title: str, reality: Reality, value: Callable[[Recording], float]
) -> ObjectCheck:
    scenario = Scenario(
        "grasp", "SlopeSlider-1-wood", GRASPED.duration_s, GRASPED, wrenches=PRESSED
    )
    return ObjectCheck(title, scenario, "um", reality, value, needs=(Need.FRICTION,))


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
    check = _check("creep of a box out of its grasp", law, pad_creep_um_per_s)
    return replace(check, unit="um/s")


def sink() -> ObjectCheck:
    """Return the depth of these pads in the box."""
    law = Reality(0.0, 200.0, "rigid bodies: depth = 0", "as for a height at rest")
    title = "depth of two pads in the box that they grasp"
    return _check(title, law, pad_depth_um)
