"""NVIDIA PhysX 5 through SAPIEN: rigid bodies on the CPU. The first build imports SAPIEN, which takes 0.4 s."""

from collections.abc import Callable, Iterator
from types import MappingProxyType

from gauge_envs.backends.features import Feature
from gauge_envs.backends.physx.contacts import unsupported_contacts
from gauge_envs.backends.physx.settings import settings_for
from gauge_envs.backends.shared.bundled import (
    SingleWorldBackend,
    first_of,
    unsupported_joints,
)
from gauge_envs.backends.simulation import Simulation
from gauge_envs.scene import Compound, ConvexUnion, Ellipsoid, RigidBody, Scene

__all__ = ["BackendPhysX"]

HULL_LIMIT = 128
"""Largest number of vertices of a convex piece. PhysX makes 254 triangles at most, and simplifies larger hulls."""


class BackendPhysX(SingleWorldBackend):
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
        yield from unsupported_joints(scene)
        for body in scene.bodies:
            yield from _unsupported_shape(body)
        yield from unsupported_contacts(scene)

    def simulation(self) -> Callable[..., Simulation]:
        """Return the class of simulations; the first call imports the engine."""
        from gauge_envs.backends.physx.simulation import SimulationPhysX

        return SimulationPhysX


def _unsupported_shape(body: RigidBody) -> Iterator[str]:
    shape = body.shape
    if isinstance(shape, Compound):
        if any(isinstance(part.shape, Ellipsoid) for part in shape.parts):
            yield f"{body.name!r} contains an ellipsoid, and PhysX has no ellipsoids"
        unions = [p.shape for p in shape.parts if isinstance(p.shape, ConvexUnion)]
    else:
        unions = [shape] if isinstance(shape, ConvexUnion) else []
    pieces = [piece for union in unions for piece in union.pieces_m]
    for number, piece in enumerate(pieces):
        count = len(piece)
        if count > HULL_LIMIT:
            # This slow import is not needed to list engines.
            from scipy.spatial import ConvexHull

            count = len(ConvexHull(piece).vertices)
        if count > HULL_LIMIT:
            yield (
                f"piece {number} of {body.name!r} has {count} vertices: PhysX simplifies pieces with more than "
                f"{HULL_LIMIT}; divide it"
            )
