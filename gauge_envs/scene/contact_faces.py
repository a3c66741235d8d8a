"""Faces at which bodies touch at the start. Initial-state noise moves a body along a face, not across it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from gauge_envs.scene.bodies import RigidBody
from gauge_envs.scene.geometry import (
    Box,
    Compound,
    ConvexUnion,
    Cylinder,
    FloatArray,
    PartShape,
    Plane,
    Pose,
    Shape,
    vector,
)

TOUCHING_M = 1e-5
"""Largest gap between two faces in contact [m]; published positions have six decimals."""

Piece = tuple[FloatArray, FloatArray]
"""Corners [m], shape [corner_count, 3], and planes of flat faces, shape [face_count, 4], of a convex solid.

A plane is an outward normal and an offset: minus the distance from the origin along the normal [m].
"""

PARALLEL = 1.0 - 1e-9
"""Smallest cosine between normals that count as parallel."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TouchingGroup:
    """Bodies that touch one another.

    Attributes:
        members: Their names.
        blocked: Directions in which noise must not move them, see `blocked_directions`.
        centre_m: Mean of their origins [m], shape [3].
    """

    members: Collection[str]
    blocked: FloatArray
    centre_m: FloatArray


Normals = dict[frozenset[str], list[FloatArray]]
"""Normals of the faces at which two bodies touch, each of shape [3], by the names of the bodies."""


def contact_normals(
    bodies: Iterable[RigidBody], colliding: Iterable[tuple[str, str]]
) -> Normals:
    """Return the normals of the faces at which bodies that collide touch.

    Boxes, ends of cylinders, convex unions and planes have flat faces. Round surfaces have none.

    Args:
        bodies: The bodies at their start.
        colliding: Names of each pair that collides; pairs with unknown names are ignored.
    """
    pieces = {body.name: [*_pieces(body.shape, body.pose)] for body in bodies}
    return {
        frozenset((first, second)): normals
        for first, second in colliding
        if first in pieces and second in pieces
        if (normals := [*_touching(pieces[first], pieces[second])])
    }


def touching_groups(
    bodies: Sequence[RigidBody], normals: Normals
) -> dict[str, TouchingGroup]:
    """Return the group of touching bodies of each body, by its name; bodies outside `bodies` join no group."""
    group = {body.name: {body.name} for body in bodies}
    for pair in normals:
        if pair <= group.keys():
            joined = set().union(*(group[name] for name in pair))
            group.update(dict.fromkeys(joined, joined))
    groups: dict[str, TouchingGroup] = {}
    for name, names in group.items():
        if name in groups:
            continue
        poses = [body.pose for body in bodies if body.name in names]
        touching = TouchingGroup(
            members=names,
            blocked=blocked_directions(poses[0], outer_normals(normals, names)),
            centre_m=np.mean([pose.position_m for pose in poses], axis=0),
        )
        groups.update(dict.fromkeys(names, touching))
    return groups


def outer_normals(normals: Normals, names: Collection[str]) -> list[FloatArray]:
    """Return the normals at which a group of bodies touches others, each direction once, each of shape [3]."""
    distinct: list[FloatArray] = []
    for pair, of_pair in normals.items():
        if len(pair.intersection(names)) == 1:
            distinct += [
                normal
                for normal in of_pair
                if all(abs(normal @ known) < PARALLEL for known in distinct)
            ]
    return distinct


def blocked_directions(pose: Pose, normals: Sequence[FloatArray]) -> FloatArray:
    """Return the orthonormal directions in which noise must not move a body, shape [1 to 3, 3].

    They are the normals of the faces at which the body touches others. A body that touches none, for example on a
    cloth, stays in the plane of its own face: the direction is the body axis closest to vertical.

    Args:
        pose: Pose of the body.
        normals: Normals of the faces at which it touches others, each of shape [3].
    """
    normal = face_normal(pose)
    if not normals or (len(normals) == 1 and abs(normal @ normals[0]) > PARALLEL):
        return normal[None]
    if len(normals) == 1:
        return np.asarray(normals)
    _, sizes, directions = np.linalg.svd(np.asarray(normals))
    return np.asarray(directions[: int((sizes > 1.0 - PARALLEL).sum())])


def face_normal(pose: Pose) -> FloatArray:
    """Return the body axis closest to vertical, in the world frame, shape [3]."""
    axes: FloatArray = pose.matrix.T
    return axes[int(np.abs(axes[:, 2]).argmax())]


def _pieces(shape: Shape | PartShape, pose: Pose) -> Iterator[Piece]:
    """Yield the pieces of a shape with flat faces; a plane has no corners."""
    from scipy.spatial import ConvexHull

    axes = pose.matrix.T
    position_m = np.asarray(pose.position_m)
    if isinstance(shape, Compound):
        for part in shape.parts:
            place = vector(pose.to_world(np.asarray(part.pose.position_m)))
            rotation = pose.rotation * part.pose.rotation
            yield from _pieces(part.shape, Pose.from_rotation(place, rotation))
    elif isinstance(shape, ConvexUnion):
        for piece in shape.pieces_m:
            corners = pose.to_world(np.asarray(piece))
            yield corners, np.unique(ConvexHull(corners).equations.round(9), axis=0)
    elif isinstance(shape, Plane):
        yield np.zeros((0, 3)), np.array([[*axes[2], -axes[2] @ position_m]])
    elif isinstance(shape, Box | Cylinder):
        size_m = np.array([np.inf, np.inf, 0.0])
        if isinstance(shape, Cylinder):
            size_m[2] = shape.length_m
        else:
            size_m[:] = shape.size_m
        flat = np.isfinite(size_m)
        normals = np.concatenate([axes[flat], -axes[flat]])
        heights = np.tile(0.5 * size_m[flat], 2)
        offsets = -(normals @ position_m) - heights
        yield pose.to_world(shape.corners_m), np.column_stack([normals, offsets])


def _touching(first: Sequence[Piece], second: Sequence[Piece]) -> Iterator[FloatArray]:
    """Yield the normals of the faces at which the pieces of two bodies touch."""
    for (first_m, first_faces), (second_m, second_faces) in product(first, second):
        # If two convex bodies touch at a face, the plane of this face separates them with the largest gap.
        gap_m, normal = max(
            _separation(first_faces, second_m),
            _separation(second_faces, first_m),
            key=lambda separation: separation[0],
        )
        if abs(gap_m) <= TOUCHING_M:
            yield normal / np.linalg.norm(normal)


def _separation(faces: FloatArray, corners_m: FloatArray) -> tuple[float, FloatArray]:
    """Return the largest gap between a face of a piece and the corners of another [m], and the normal of the face."""
    if not (len(faces) and len(corners_m)):
        return -np.inf, np.zeros(3)
    gaps_m = (corners_m @ faces[:, :3].T + faces[:, 3]).min(axis=0)
    widest = int(gaps_m.argmax())
    return float(gaps_m[widest]), faces[widest, :3]
