"""NVIDIA PhysX 5 through SAPIEN: rigid bodies on the CPU. The first build imports SAPIEN, which takes 0.4 s."""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from gauge_envs.backends.features import Feature
from gauge_envs.backends.physx.contacts import unsupported_contacts
from gauge_envs.backends.physx.settings import settings_for
from gauge_envs.backends.shared.bundled import BundledBackend, first_of
from gauge_envs.backends.simulation import Simulation
from gauge_envs.scene import (
    Compound,
    ConvexUnion,
    Ellipsoid,
    Motion,
    RigidBody,
    Scene,
)

__all__ = ["BackendPhysX"]

HULL_LIMIT = 128
"""Largest number of vertices of a convex piece. PhysX makes 254 triangles at most, and simplifies larger hulls."""


class BackendPhysX(BundledBackend):
    """NVIDIA PhysX 5 on the CPU, in single precision, as SAPIEN ships it: rigid bodies, hinges and strings."""

    name = "physx"
    title = "PhysX"
    color = "#009e73"
    marker = "^"
    modules = ("sapien",)
    packages = ("sapien",)
    settings_for = staticmethod(settings_for)
    configurations = MappingProxyType(
        {"PGS": {"solver": "PGS"}}
        | {name: {"preset": name} for name in ("out_of_box", "isaac", "paper")}
    )
    corrections = ("a cylinder is a capsule or a ball in a prism",)
    features = frozenset({Feature.STATED_INERTIA})
    own_defaults = frozenset({"out_of_box", "isaac", "paper"})

    def versions(self) -> dict[str, str]:
        """Return the version of SAPIEN and of the PhysX that it contains."""
        from gauge_envs.backends.physx.model import physx_version

        return {**super().versions(), "physx": physx_version()}

    def unsupported(self, scene: Scene) -> Iterator[str]:
        """Yield one sentence for each kind of unsupported feature of a scene."""
        if scene.deformables:
            yield (
                f"{first_of([body.name for body in scene.deformables])} is deformable: PhysX's cloth and foam need "
                "a GPU, and SAPIEN has no ropes or rods"
            )
        for name in scene.hinges:
            motion = scene.body(name).motion
            if motion is not Motion.DYNAMIC:
                yield f"{name!r} has a hinge and is {motion.value}: only dynamic bodies have hinges"
                break
        for body in scene.bodies:
            yield from _unsupported_shape(body)
        yield from unsupported_contacts(scene)

    def build(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Simulation:
        """Build a scene; settings are the fields of `SettingsPhysX`."""
        chosen = settings_for(scene, settings)
        from gauge_envs.backends.physx.simulation import SimulationPhysX

        return SimulationPhysX(scene, chosen)


def _unsupported_shape(body: RigidBody) -> Iterator[str]:
    solids: list[object] = [body.shape]
    if isinstance(body.shape, Compound):
        solids = [part.shape for part in body.shape.parts]
    if any(isinstance(solid, Ellipsoid) for solid in solids):
        yield f"{body.name!r} contains an ellipsoid, and PhysX has no ellipsoids"
    unions = [solid for solid in solids if isinstance(solid, ConvexUnion)]
    pieces = [piece for union in unions for piece in union.pieces_m]
    for number, piece in enumerate(pieces):
        count = len(piece)
        if count > HULL_LIMIT:
            # This slow import is not needed to list engines.
            from scipy.spatial import ConvexHull

            count = len(ConvexHull(np.asarray(piece)).vertices)
        if count > HULL_LIMIT:
            yield (
                f"piece {number} of {body.name!r} has {count} vertices: PhysX simplifies pieces with more than "
                f"{HULL_LIMIT}; divide it"
            )
