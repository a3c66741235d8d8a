"""A backend with one planted fault."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from gauge_envs.backends import Backend
from gauge_envs.backends.mujoco.versions import FAULTY_SPARSE
from gauge_envs.backends.shared.wrapped import WrappedSimulation
from gauge_envs.scene import Motion, Scene
from gauge_envs.tools.conformance.run import run_checks

DATA = Path(__file__).parents[2] / "scoring"


class Passed(WrappedSimulation):
    """A healthy simulation, passed through; fixed bodies report the poses of the original scene.

    Args:
        inner: The simulation.
        scene: The scene that the caller asked for.
    """

    def __init__(self, inner, scene):
        super().__init__(inner)
        self.scene = scene
        self._fixed = {one.name for one in scene.bodies if one.motion is Motion.FIXED}
        self.begin()

    def begin(self):
        """Prepare the fault; a healthy simulation does nothing."""

    def fault(self):
        """Report none, so that checks measure what the fault does."""

    def body_states(self, names):
        """Pass on, with the original poses of fixed bodies."""
        states = np.array(self.inner.body_states(names))
        for row, name in zip(states, names, strict=True):
            if name in self._fixed:
                pose = self.scene.body(name).pose
                row[:7] = [*pose.position_m, *pose.quaternion]
        return states

    def nodes(self, name):
        """Pass on."""
        return np.array(self.inner.nodes(name))


def _same(scene):
    return scene


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One deliberate fault, and what a check should say about it.

    Attributes:
        what: The fault, in words.
        caught_by: Id of the first check that fails.
        says: Words of its diagnosis that name the fault.
        scene: What the faulty backend builds instead of a scene.
        simulation: Wrapper of its simulation.
        settings: Numerical settings that are forced upon the backend.
        engine: The only backend that can have the fault; empty for any.
        worlds: Function that builds worlds from a function that builds one, and the scenes; None for healthy batches.
    """

    what: str
    caught_by: str
    says: str
    scene: Callable[[Scene], Scene] = _same
    simulation: type[Passed] = Passed
    settings: Mapping[str, Any] = field(default_factory=dict)
    engine: str = ""
    worlds: Callable[..., Any] | None = None


class Mutant(Backend):
    """A backend with a fault.

    Args:
        backend: A healthy backend.
        fault: The fault.
    """

    name = "mutant"
    worlds_mix_constants = True
    worlds_restart_alone = True

    def __new__(cls, *arguments):
        # Checks see by the class whether an engine has batches.
        has_batches = cls is Mutant and arguments[1].worlds
        return object.__new__(_BatchMutant if has_batches else cls)

    def __init__(self, backend, fault):
        self.features = backend.features  # a class variable of engines
        self.engine_name = backend.name
        self.healthy = backend
        self.fault = fault

    def versions(self):
        """Return the versions of the healthy backend."""
        return self.healthy.versions()

    def supports(self, scene):
        """Return what the healthy backend supports."""
        return self.healthy.supports(scene)

    def build(self, scene, settings=None):
        """Build the faulty scene in the faulty simulation."""
        inner = self.healthy.build(
            self.fault.scene(scene), {**(settings or {}), **self.fault.settings}
        )
        return self.fault.simulation(inner, scene)


class _BatchMutant(Mutant):
    """A backend with a fault of its batches."""

    def build_worlds(self, scenes, settings=None):
        """Build the faulty worlds."""
        return self.fault.worlds(lambda scene: self.build(scene, settings), scenes)


_DATA = json.loads((DATA / "conformance.json").read_text(encoding="utf-8"))
PUBLISHED = {
    column["backend"]: column["findings"]
    for column in _DATA["columns"]
    if column["name"] == "default"
}
"""Published results of all checks with the default configuration of each engine, by its name and their ids."""
if mujoco.__version__ not in FAULTY_SPARSE:
    PUBLISHED["mujoco"]["solver-pile"]["status"] = "pass"

FAILS_ITSELF = {
    engine: frozenset(
        name for name, one in findings.items() if one["status"] in ("fail", "error")
    )
    for engine, findings in PUBLISHED.items()
}
"""Checks that a healthy engine fails by a physics of its own, as its page says."""


def first_failure(mutant):
    """Return the result of the first check that fails on a mutant, but not on its engine."""
    return next(one for one in run_checks(mutant) if is_of_the_fault(mutant, one))


def is_of_the_fault(mutant, result):
    """Return whether a check fails, and otherwise than it does on the healthy engine by more than its tolerance."""
    if not result.is_bad or result.check not in FAILS_ITSELF.get(
        mutant.engine_name, frozenset()
    ):
        return result.is_bad
    (healthy,) = run_checks(mutant.healthy, only=[result.check])
    if result.measured is None or healthy.measured is None:
        return result.status is not healthy.status
    return abs(result.measured - healthy.measured) > (result.width or 0.0)


def fault(id, what, caught_by, says, **how):
    """Return the entry of a fault in a table: its id and the fault."""
    return id, Fault(what=what, caught_by=caught_by, says=says, **how)
