"""States of simulations with their origin, so that no state continues in another engine, setting or scene."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gauge_envs.errors import BackendError
from gauge_envs.scene import Scene


@dataclass(frozen=True)
class Snapshot:
    """A state and its origin.

    Attributes:
        engine: Engine and version, as `mujoco 4.0.0`.
        settings: Numerical settings in force.
        scene: Hash of the scene.
        values: The engine's state.
    """

    engine: str
    settings: Mapping[str, Any]
    scene: str
    values: Any


class StateOrigin:
    """Origin of the states of a simulation.

    Args:
        engine: Engine and version, as `mujoco 4.0.0`.
        settings: Numerical settings in force.
        scene: The scene.
    """

    def __init__(self, engine: str, settings: Mapping[str, Any], scene: Scene) -> None:
        self._engine, self._settings, self._scene = engine, settings, scene
        self._hash = ""

    def state(self, values: Any) -> Snapshot:
        """Return an engine's state with its origin."""
        return Snapshot(self._engine, dict(self._settings), self._scene_hash(), values)

    def values(self, state: Any) -> Any:
        """Return the engine's state of a snapshot from the same engine, settings and scene."""
        if not isinstance(state, Snapshot):
            raise BackendError(f"restore got a {type(state).__name__}: give it what state() returned")
        if state.engine != self._engine:
            self._refuse(state.engine, self._engine)
        changed = [
            name
            for name in sorted({*state.settings, *self._settings})
            if state.settings.get(name) != self._settings.get(name)
        ]
        if changed:
            self._refuse(*(_listed(settings, changed) for settings in (state.settings, self._settings)))
        if state.scene != self._scene_hash():
            self._refuse(f"scene {state.scene[:12]}", f"scene {self._scene_hash()[:12]} ({_names(self._scene)})")
        return state.values

    def _refuse(self, its: str, own: str) -> None:
        raise BackendError(
            f"the state is from a simulation with {its}, this one has {own}. "
            "A state continues only in the same engine, settings and scene: build that simulation, or start again."
        )

    def _scene_hash(self) -> str:
        if not self._hash:
            one = self._scene
            parts = (one.bodies, one.deformables, one.joints, one.attachments, one.contacts, one.gravity_m_per_s2)
            # Parts that few scenes have follow, so that the hashes of the others stay.
            rare = "".join(repr(part) for part in (one.air, one.body_hinges) if part)
            self._hash = hashlib.sha256((repr(parts) + rare).encode()).hexdigest()
        return self._hash


def _listed(settings: Mapping[str, Any], names: list[str]) -> str:
    return ", ".join(f"{name} = {settings.get(name)}" for name in names)


def _names(scene: Scene) -> str:
    return ", ".join(one.name for one in (*scene.bodies, *scene.deformables))
