"""Features of a scene that the PhysX backend does not support. Needs no engine, so it is fast."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull

from gauge_envs.backends.physx.contacts import unsupported_contacts
from gauge_envs.scene import Compound, ConvexUnion, Ellipsoid, Hinge, Motion, Scene, Shape, Vector

HULL_LIMIT = 128
"""Largest number of vertices of a convex piece. PhysX makes 254 triangles at most, and simplifies larger hulls."""


def unsupported_features(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each kind of unsupported feature of a scene."""
    if scene.deformables:
        others = len(scene.deformables) - 1
        more = f" (and {others} more)" if others else ""
        yield (
            f"{scene.deformables[0].name!r}{more} is deformable: SAPIEN contains PhysX's rigid bodies only; its "
            "cloth and soft bodies need a GPU and Isaac Sim"
        )
    hinges = Counter(joint.body for joint in scene.joints if isinstance(joint, Hinge))
    for name, count in hinges.items():
        if count > 1:
            yield f"{name!r} hangs on {count} hinges: this backend builds one hinge per body"
            break
    for name in hinges:
        if scene.body(name).motion is not Motion.DYNAMIC:
            yield f"{name!r} hangs on a hinge and is {scene.body(name).motion.value}: only dynamic bodies have hinges"
            break
    for body in scene.bodies:
        parts = body.shape.parts if isinstance(body.shape, Compound) else ()
        if any(isinstance(part.shape, Ellipsoid) for part in parts):
            yield f"{body.name!r} contains an ellipsoid, and PhysX has no ellipsoids"
    yield from _unsupported_hulls(scene)
    yield from unsupported_contacts(scene)


def _unsupported_hulls(scene: Scene) -> Iterator[str]:
    for body in scene.bodies:
        for number, piece in enumerate(_pieces_m(body.shape)):
            vertices = len(ConvexHull(np.asarray(piece)).vertices) if len(piece) > HULL_LIMIT else 0
            if vertices > HULL_LIMIT:
                yield (
                    f"piece {number} of {body.name!r} has {vertices} vertices: PhysX simplifies pieces with more than "
                    f"{HULL_LIMIT}; divide it"
                )
                return


def _pieces_m(shape: Shape) -> list[tuple[Vector, ...]]:
    """Return the vertices of all convex pieces of a shape [m]."""
    solids = [part.shape for part in shape.parts] if isinstance(shape, Compound) else [shape]
    return [piece for solid in solids if isinstance(solid, ConvexUnion) for piece in solid.pieces_m]
