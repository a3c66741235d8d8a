"""Faces at which bodies touch at the start. Initial-state noise moves a body along a face, not across it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gauge_envs.scene.bodies import RigidBody
from gauge_envs.scene.geometry import (
    Box,
    Capsule,
    Compound,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    FloatArray,
    Plane,
    Pose,
    Shape,
    Sphere,
    vector,
)

TOUCHING_M = 1e-5
"""Largest gap between two faces in contact [m]; published positions have six decimals."""

PartShape = Box | Sphere | Cylinder | Capsule | Ellipsoid | ConvexUnion

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


class ContactFaces:
    """Pairs of bodies that collide and touch at a flat face, with the normals of the faces.

    Boxes, ends of cylinders, convex unions and planes have such faces. Round surfaces have none.

    Args:
        bodies: The bodies at their start.
        colliding: Names of each pair that collides; pairs with unknown names are ignored.
    """

    def __init__(
        self, bodies: Iterable[RigidBody], colliding: Iterable[tuple[str, str]]
    ) -> None:
        named = {body.name: body for body in bodies}
        pieces = {
            name: [*_pieces(body.shape, body.pose)] for name, body in named.items()
        }
        self._normals: dict[frozenset[str], list[FloatArray]] = {}
        for first, second in colliding:
            pair = frozenset((first, second))
            if pair <= named.keys() and pair not in self._normals:
                first_body, second_body = (
                    (named[first], pieces[first]),
                    (named[second], pieces[second]),
                )
                if normals := [*_touching(*first_body, *second_body)]:
                    self._normals[pair] = normals

    def groups(self, bodies: Sequence[RigidBody]) -> dict[str, TouchingGroup]:
        """Return the group of touching bodies of each body, by its name; bodies outside `bodies` join no group."""
        group = {body.name: {body.name} for body in bodies}
        for first, second in self._normals:
            if first in group and second in group and group[first] is not group[second]:
                joined = group[first] | group[second]
                group.update(dict.fromkeys(joined, joined))
        groups: dict[str, TouchingGroup] = {}
        for name, names in group.items():
            if name in groups:
                continue
            poses = [body.pose for body in bodies if body.name in names]
            touching = TouchingGroup(
                members=names,
                blocked=blocked_directions(poses[0], self.normals(names)),
                centre_m=np.mean([pose.position_m for pose in poses], axis=0),
            )
            groups.update(dict.fromkeys(names, touching))
        return groups

    def normals(self, names: Collection[str]) -> list[FloatArray]:
        """Return the normals at which a group touches other bodies, each direction once, each of shape [3].

        Args:
            names: Names of the bodies of the group.
        """
        distinct: list[FloatArray] = []
        for pair, normals in self._normals.items():
            if len(pair.intersection(names)) == 1:
                distinct += [
                    normal
                    for normal in normals
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


def _pieces(
    shape: Shape | PartShape, pose: Pose
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield corners [m] and planes of flat faces, shape [face_count, 4], of the pieces of a shape, in the world.

    A plane is an outward normal and an offset: minus the distance from the origin along the normal [m].
    """
    from scipy.spatial import ConvexHull

    if isinstance(shape, Compound):
        for part in shape.parts:
            place = vector(pose.to_world(np.asarray(part.pose.position_m)))
            yield from _pieces(
                part.shape,
                Pose.from_rotation(place, pose.rotation * part.pose.rotation),
            )
    elif isinstance(shape, ConvexUnion):
        for piece in shape.pieces_m:
            corners = pose.to_world(np.asarray(piece))
            yield corners, np.unique(ConvexHull(corners).equations.round(9), axis=0)
    elif isinstance(shape, Box | Cylinder):
        size_m = (
            shape.size_m if isinstance(shape, Box) else (np.inf, np.inf, shape.length_m)
        )
        axes = pose.matrix.T
        flat = np.isfinite(size_m)
        normals = np.concatenate([axes[flat], -axes[flat]])
        heights = np.tile(0.5 * np.asarray(size_m)[flat], 2)
        offsets = -(normals @ np.asarray(pose.position_m)) - heights
        yield pose.to_world(shape.corners_m), np.column_stack([normals, offsets])


def _touching(
    first: RigidBody,
    first_pieces: Sequence[tuple[FloatArray, FloatArray]],
    second: RigidBody,
    second_pieces: Sequence[tuple[FloatArray, FloatArray]],
) -> Iterator[FloatArray]:
    """Yield the normals of the faces at which the pieces of two bodies touch."""
    for plane, corners in ((first, second_pieces), (second, first_pieces)):
        if isinstance(plane.shape, Plane):
            normal = np.asarray(plane.pose.rotation.apply([0.0, 0.0, 1.0]))
            gaps = [
                ((piece - np.asarray(plane.pose.position_m)) @ normal).min()
                for piece, _ in corners
            ]
            if gaps and abs(min(gaps)) <= TOUCHING_M:
                yield normal
            return
    for corners_m, planes in first_pieces:
        for second_corners_m, second_planes in second_pieces:
            # If two convex bodies touch at a face, the plane of this face separates them with the largest gap.
            candidates = [
                (float(gaps.max()), faces[int(gaps.argmax()), :3])
                for faces, points in (
                    (planes, second_corners_m),
                    (second_planes, corners_m),
                )
                if len(faces)
                for gaps in [(points @ faces[:, :3].T + faces[:, 3]).min(axis=0)]
            ]
            if candidates:
                gap, normal = max(candidates, key=lambda candidate: candidate[0])
                if abs(gap) <= TOUCHING_M:
                    yield normal / np.linalg.norm(normal)
