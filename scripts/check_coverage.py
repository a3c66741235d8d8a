"""Which shapes, motions and calls the conformance checks load: read from their scenes on an engine without physics."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from gauge_envs.backends import Backend, Simulation, Support
from gauge_envs.backends.features import Feature
from gauge_envs.scene import Compound, Hinge, Motion, RigidBody, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.states import nominal_states
from gauge_envs.tools.conformance import checks
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.run import run_check
from scripts.generated import markdown_table

SHAPES = ("Box", "Sphere", "Cylinder", "ConvexUnion", "Capsule", "Ellipsoid")
"""Shapes that move; compounds count by their parts."""
CALLS = ("drive", "apply_wrench", "reset(starts)", "contact_forces", "build_worlds")


class _Still(Simulation):
    """A scene in which nothing moves; it records the bodies of each call."""

    def __init__(self, scene: Scene, count: int, calls: set[tuple[str, str]]) -> None:
        self.settings = {"timestep_s": 1.0 / 180.0}
        self.world_count = count
        self._scene, self._calls = scene, calls
        self._names = [body.name for body in scene.bodies]
        self._states = np.tile(nominal_states(scene), (count, 1, 1))
        if count > 1:
            self._note("build_worlds", self._names)

    def _note(self, call: str, names: Sequence[str]) -> None:
        for name in names:
            for shape in _shapes(self._scene.body(name)):
                self._calls.add((call, shape))

    def reset(self, starts: FloatArray | None = None, seed: int = 0) -> None:
        """Note the bodies that may start elsewhere."""
        if starts is not None:
            moving = [body.name for body in self._scene.dynamic_bodies]
            self._note("reset(starts)", moving)

    def drive(self, body: str, targets: FloatArray) -> None:
        """Note the body."""
        self._note("drive", [body])

    def apply_wrench(self, body: str, wrenches: FloatArray) -> None:
        """Note the body."""
        self._note("apply_wrench", [body])

    def contact_forces(self, pairs: Sequence[tuple[str, str]]) -> None:
        """Note the bodies of the pairs."""
        for pair in pairs:
            self._note("contact_forces", pair)

    def advance(self, seconds: float) -> None:
        """Do nothing."""

    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Return the start."""
        return self._states[:, [self._names.index(name) for name in names]]

    def close(self) -> None:
        """Do nothing."""


class _Records(Backend):
    """An engine that builds rigid scenes and records them."""

    name = "records"
    features = frozenset(Feature)

    def __init__(self) -> None:
        self.scenes: list[Scene] = []
        self.calls: set[tuple[str, str]] = set()

    def versions(self) -> Mapping[str, str]:
        """Return no versions."""
        return {}

    def supports(self, scene: Scene) -> Support:
        """Support rigid scenes."""
        return Support(("no deformable bodies",) if scene.deformables else ())

    def build(self, scene: Scene, settings: Any = None) -> Simulation:
        """Record a scene."""
        return self.build_worlds(scene, 1, settings)

    def build_worlds(
        self, scene: Scene, count: int, settings: Any = None
    ) -> Simulation:
        """Record a scene of several worlds."""
        self.scenes.append(scene)
        return _Still(scene, count, self.calls)


def _shapes(body: RigidBody) -> list[str]:
    """Return the names of the shapes of a body, of its parts if it is a compound."""
    if isinstance(body.shape, Compound):
        return [type(part.shape).__name__ for part in body.shape.parts]
    return [type(body.shape).__name__]


def _kinds(scene: Scene, body: RigidBody) -> Iterator[tuple[str, str]]:
    """Yield the motion of a body and each of its shapes."""
    hinged = {joint.body for joint in scene.joints if isinstance(joint, Hinge)}
    motion = {Motion.KINEMATIC: "driven"}.get(body.motion, body.motion.value)
    if body.name in hinged:
        motion = "hinged"
    for shape in _shapes(body):
        yield motion, shape


def _pairs(scene: Scene) -> Iterator[tuple[str, str]]:
    """Yield the shape of a dynamic body, and motion and shape of its partner, for each pair that may collide."""
    for contact in scene.contacts:
        for names in scene.colliding_pairs(contact):
            first, second = (scene.body(name) for name in names)
            for one, other in ((first, second), (second, first)):
                if one.motion is not Motion.DYNAMIC:
                    continue
                for _, shape in _kinds(scene, one):
                    for motion, partner in _kinds(scene, other):
                        yield shape, f"{motion} {partner}"


def tables() -> str:
    """Return the tables of contacts and of calls, with the number of checks that load a cell, or a dash."""
    by_pair: dict[tuple[str, str], set[str]] = defaultdict(set)
    by_call: dict[tuple[str, str], set[str]] = defaultdict(set)
    for check in checks():
        # Each check has a lab of its own, so that it builds the scenes that checks share.
        engine = _Records()
        with np.errstate(all="ignore"):
            run_check(Lab(engine), check)
        for scene in engine.scenes:
            for pair in _pairs(scene):
                by_pair[pair].add(check.id)
        for call in engine.calls:
            by_call[call].add(check.id)
    partners = [
        f"{motion} {shape}"
        for motion in ("fixed", "driven", "dynamic", "hinged")
        for shape in ("Plane", *SHAPES)
        if any(by_pair[one, f"{motion} {shape}"] for one in SHAPES)
    ]
    pair_rows = [
        [partner, *(_cell(by_pair[shape, partner]) for shape in SHAPES)]
        for partner in partners
    ]
    call_rows = [
        [call, *(_cell(by_call[call, shape]) for shape in SHAPES)] for call in CALLS
    ]
    head = [f"dynamic {shape}" for shape in SHAPES]
    contacts = markdown_table(["partner", *head], pair_rows)
    calls = markdown_table(["call", *SHAPES], call_rows)
    return "\n".join([*contacts, "", *calls])


def _cell(names: set[str]) -> str:
    """Return the only check of a cell, or the number of checks; a dash for none."""
    return next(iter(names)) if len(names) == 1 else str(len(names) or "-")
