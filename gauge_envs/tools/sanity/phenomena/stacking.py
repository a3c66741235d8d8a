"""Settling and drift of a dry wall of 118 bricks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import Scene
from gauge_envs.tools.sanity.model import Reality
from gauge_envs.tools.sanity.phenomena.facts import rigid_tolerance
from gauge_envs.tools.sanity.phenomena.phenomenon import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.tools.sanity.scenario import Scenario

STAND_S = 0.4
"""Simulated time [s]: soft contacts have settled, and a falling wall has moved by centimetres."""


def _without_ball(scene: Scene) -> Scene:
    return replace(
        scene,
        bodies=tuple(body for body in scene.bodies if body.name != "ball"),
        joints=(),
        contacts=tuple(contact for contact in scene.contacts if "ball" not in contact.first),
    )


def phenomena() -> Iterator[Phenomenon]:
    """Yield settling and drift of the wall."""
    scenario = Scenario(name="wall", variant="WallBreaking-wood", seconds=STAND_S, change=_without_ball)
    bricks = [body.name for body in scenario.scene.dynamic_bodies]

    def displacements_mm(rollout: Rollout) -> FloatArray:
        """Return displacements of the bricks [mm], shape [brick_count, sample_count, 3]."""
        return np.asarray(1e3 * np.array([rollout.displacement(name) for name in bricks]))

    def sag_mm(rollout: Rollout) -> FloatArray:
        return np.asarray(-displacements_mm(rollout)[..., 2].min(axis=0))

    def drift_mm(rollout: Rollout) -> FloatArray:
        return np.asarray(np.linalg.norm(displacements_mm(rollout)[..., :2], axis=-1).max(axis=0))

    for name, title, values, tolerance in (
        ("sag", "stacking: settling of a wall of 118 bricks", sag_mm, rigid_tolerance(1.0, "eleven layers of 15 mm")),
        (
            "drift",
            f"stacking: drift of the bricks of a wall within {STAND_S:g} s",
            drift_mm,
            rigid_tolerance(1.0, "the length of 40 mm of a brick"),
        ),
    ):
        yield Phenomenon(
            id=f"wall-{name}",
            title=title,
            quantity=name,
            scenario=scenario,
            unit="mm",
            reality=Reality.law(0.0, source="a dry wall does not move", **tolerance),
            needs_friction=True,
            read=_last_of(values),
            trace=Trace(label=f"{name} of the wall [mm]", values=values, is_level=True),
        )


def _last_of(values: Callable[[Rollout], FloatArray]) -> Callable[[Rollout], PhenomenonValue]:
    return lambda rollout: PhenomenonValue(value=float(values(rollout)[-1]))
