"""Grasps: a box between two pads; and a ball that rolls. The scenes are those of the conformance checks.

The contacts have the target's constants, and friction 0.5.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import Any

from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.bench.grasp import (
    HELD,
    PRESSED,
    TURNED,
    pad_creep_um_per_s,
    pad_depth_um,
    spin_torque_share,
)
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.bench.turning import turning_scene
from gauge_envs.tools.conformance import checks
from gauge_envs.tools.sanity.model import Reality
from gauge_envs.tools.sanity.phenomena.base import Phenomenon
from gauge_envs.tools.sanity.scenario import Scenario

MIDDLE = 0.545
"""Torque over mu N times the side of a pad, between even pressure and pressure at the corners."""

ROLLS_M_PER_S, RADIUS_M = 0.3, 0.03
"""Speed at the start, and radius of the ball [m]."""

MOST_ROLLING_MM = 7.0
"""Largest rolling friction of the published pairs, which hard rubber on steel has."""


def _replaced(_: Scene, *, scene: Scene) -> Scene:
    return scene


def _row(
    name: str,
    scene: Scene,
    value: Callable[[Recording], float],
    *,
    wrenches: Mapping[str, FloatArray] = {},
    **texts: Any,
) -> Phenomenon:
    change = partial(_replaced, scene=scene)
    scenario = Scenario(
        name=name,
        variant="SlopeSlider-1-wood",
        seconds=scene.duration_s,
        change=change,
        wrenches=wrenches,
    )
    return Phenomenon(scenario=scenario, value=value, needs_friction=True, **texts)


HANDS: Mapping[str, tuple[Scene, Callable[[Recording], float]]] = {
    "grasp-creep": (HELD, pad_creep_um_per_s),
    "grasp-sink": (HELD, pad_depth_um),
    "grasp-torsion": (TURNED, spin_torque_share),
}
"""Scene and reading of what a robot's hand is judged by, by id of the check that has its law."""


def grasped(id: str) -> Phenomenon:
    """Return a row on a box whose pads press with twice its weight, with law and tolerance of a conformance check.

    A hand that lifts its box with an acceleration a loads its pads as gravity g + a loads those of a hand at rest, so
    that the friction m (g + a) / (2 N) is needed. Here it is half of the pads' own: they hold while a is below g.
    """
    # The other families take a second to import.
    import_module("gauge_envs.tools.conformance.grasp")
    (known,), (scene, measure) = checks([id]), HANDS[id]
    name, law = (id, MIDDLE) if id == "grasp-torsion" else ("grasp", 0.0)
    source, allowed = f"{known.source}: {known.law}", known.tolerance
    real = Reality.law(
        law, tolerance=allowed.width(law), source=source, rationale=allowed.rationale
    )
    texts = {
        "title": known.title,
        "unit": known.unit,
        "reality": real,
    }
    return _row(name, scene, measure, wrenches=PRESSED, **texts)


def rolling() -> Phenomenon:
    """Return the torque against rolling over the normal force, from the energy that a ball loses on its path."""
    source, reason = (
        "hard rubber on steel: CDA3000, table 7.22",
        "the largest of the pairs of gauge list materials",
    )
    law = Reality.law(0.0, tolerance=MOST_ROLLING_MM, source=source, rationale=reason)
    real = replace(law, limits=f"at most {MOST_ROLLING_MM:g}")

    def arm_mm(rollout: Recording) -> float:
        lost = ROLLS_M_PER_S**2 - rollout.states["ball"][-1, 7] ** 2
        return float(
            700.0 * RADIUS_M * lost / (G * rollout.displacement("ball")[-1, 0])
        )

    scene = turning_scene(0.5, ROLLS_M_PER_S, (0.0, ROLLS_M_PER_S / RADIUS_M, 0.0))
    title = "torque against rolling over the normal force"
    return _row(
        "roll",
        scene,
        arm_mm,
        title=title,
        unit="mm",
        reality=real,
    )
