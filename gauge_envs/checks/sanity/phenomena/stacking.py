"""A dry wall of 118 bricks: it stands."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from gauge_envs.checks.sanity.model import Reality
from gauge_envs.checks.sanity.phenomena.facts import placing_scatter_mm
from gauge_envs.checks.sanity.phenomena.kit import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.checks.sanity.scenario import Rollout, Scenario
from gauge_envs.scene import Scene

__all__ = [
    "phenomena",
]

STAND_S = 0.4
"""Soft contacts have sunk in and a wall that falls has moved by centimetres."""


def _without_ball(scene: Scene) -> Scene:
    return replace(
        scene,
        bodies=tuple(body for body in scene.bodies if body.name != "ball"),
        joints=(),
        contacts=tuple(contact for contact in scene.contacts if "ball" not in contact.first),
    )


def phenomena() -> Iterator[Phenomenon]:
    """Settling and drift of the wall."""
    stage = Scenario(name="wall", variant="WallBreaking-wood", seconds=STAND_S, change=_without_ball)
    bricks = [body.name for body in stage.scene.dynamic_bodies]

    def ways_mm(run: Rollout) -> FloatArray:
        """Shape [brick_count, sample_count, 3]."""
        places = np.array([run.position(name) for name in bricks])
        return np.asarray(1e3 * (places - places[:, :1]))

    def sag_mm(run: Rollout) -> FloatArray:
        return np.asarray(-ways_mm(run)[..., 2].min(axis=0))

    def drift_mm(run: Rollout) -> FloatArray:
        return np.asarray(np.linalg.norm(ways_mm(run)[..., :2], axis=-1).max(axis=0))

    scatter, origin = placing_scatter_mm()
    for name, title, values in (
        ("sag", "stacking: settling of a wall of 118 bricks", sag_mm),
        ("drift", f"stacking: drift of its bricks within {STAND_S:g} s", drift_mm),
    ):
        yield Phenomenon(
            id=f"wall-{name}",
            title=title,
            quantity=name,
            stage=stage,
            unit="mm",
            reality=Reality(value=0.0, scatter=scatter, source=f"a dry wall stands; scatter: {origin}"),
            read=_last_of(values),
            trace=Trace(label=f"{name} of the wall [mm]", values=values, is_level=True),
        )


def _last_of(values: Callable[[Rollout], FloatArray]) -> Callable[[Rollout], PhenomenonValue]:
    return lambda run: PhenomenonValue(value=float(values(run)[-1]))
