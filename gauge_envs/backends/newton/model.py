"""Scenes -> one Newton model with its solver: what each solver takes, and what it cannot do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import newton
import numpy as np
from newton.solvers import SolverMuJoCo
from numpy.typing import NDArray

from gauge_envs.backends.newton.loop import Loop
from gauge_envs.backends.newton.mujoco import LoopMuJoCo, add_contacts, shape_config
from gauge_envs.backends.newton.rigid import RigidIndex, add_bodies
from gauge_envs.backends.newton.settings import SettingsMuJoCoWarp, SettingsNewton
from gauge_envs.scene import Motion, Scene

__all__ = ["Copy", "Part", "build_model"]


class Part(Protocol):
    """A deformable body in a model."""

    def nodes(self, state: newton.State) -> NDArray[np.float64]:
        """World positions of the nodes in a state [m], shape [node_count, 3]."""

    def track(self, points_m: NDArray[np.float64]) -> Callable[[newton.State], NDArray[np.float64]] | None:
        """Reader of material points, given by where they are at the start; None where nodes must do."""


@dataclass(frozen=True, kw_only=True)
class Copy:
    """Where one copy of a scene is in a model.

    Attributes:
        rigid: Its rigid bodies.
        parts: Its deformable bodies, by name.
    """

    rigid: RigidIndex
    parts: dict[str, Part] = field(default_factory=dict)


def build_model(scenes: Sequence[Scene], settings: SettingsNewton) -> tuple[Loop, list[Copy]]:
    """Put scenes into one model, a world each, and record the step of its solver.

    Args:
        scenes: One or more, alike but for the poses at the start.
        settings: Settings of the solver; their type picks it.

    Returns:
        The loop, standing at the start, and the copies in the order of the scenes.
    """
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -scenes[0].gravity_m_per_s2))
    SolverMuJoCo.register_custom_attributes(builder)
    copies = []
    for scene in scenes:
        if len(scenes) > 1:
            builder.begin_world()
        copies.append(_add_scene(builder, scene, settings))
        if len(scenes) > 1:
            builder.end_world()
    model = builder.finalize(device=settings.device)
    driven = [
        copy.rigid.bodies[body.name]
        for scene, copy in zip(scenes, copies, strict=True)
        for body in scene.bodies
        if body.motion is Motion.KINEMATIC
    ]
    loop = LoopMuJoCo(model, driven=driven, settings=settings)
    loop.record()
    return loop, copies


def _add_scene(builder: newton.ModelBuilder, scene: Scene, settings: SettingsNewton) -> Copy:
    rigid = add_bodies(builder, scene, config=shape_config())
    if isinstance(settings, SettingsMuJoCoWarp):
        add_contacts(builder, scene, rigid, settings)
    return Copy(rigid=rigid)
