"""Rows of bonded soft boxes, for every engine: grips, free material, tetrahedra, and interpolation between points.

Each cell of a regular grid is divided into five tetrahedra, one in the middle and four at corners, mirrored from cell
to cell. Of the usual divisions this is the least stiff for its number of elements. Linear tetrahedra lock in bending
and torsion: if cells have a quarter of the width, a clamped bar is too stiff by 1 % in tension, 13 to 15 % in shear and
28 % in torsion. These errors fall with the square of the cell size.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise, product
from math import ceil

import numpy as np

from gauge_envs.backends.shared.attachments import (
    RigidAttachment,
    bonded_soft_bodies,
    rigid_attachments,
)
from gauge_envs.backends.shared.cells import grid_points
from gauge_envs.errors import ShapeError, UnsupportedSceneError
from gauge_envs.scene import Scene, SoftBody
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray

TOLERANCE_M = 1e-5
"""Distance below which faces touch and points lie inside [m]."""

FIVE_TETRAHEDRA = np.array(
    [
        [(0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1)],
        [(1, 0, 0), (0, 0, 0), (1, 1, 0), (1, 0, 1)],
        [(0, 1, 0), (0, 0, 0), (1, 1, 0), (0, 1, 1)],
        [(0, 0, 1), (0, 0, 0), (1, 0, 1), (0, 1, 1)],
        [(1, 1, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1)],
    ]
)
"""Corners of the tetrahedra in a unit cell; every second cell is mirrored so that faces match."""

NEIGHBOURS = 24
"""Number of material points from which a tracked point is interpolated."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """The free material of one soft box, aligned with the world's axes.

    Attributes:
        body: The soft body that it belongs to.
        low_m: Lowest corner [m], shape [3].
        high_m: Highest corner [m], shape [3].
    """

    body: SoftBody
    low_m: FloatArray
    high_m: FloatArray

    @property
    def density_kg_per_m3(self) -> float:
        """Density of the body [kg/m^3], grips included."""
        return self.body.mass_kg / self.body.shape.volume_m3

    @property
    def centre_m(self) -> FloatArray:
        """Centre of the free material [m], shape [3]."""
        return 0.5 * (self.low_m + self.high_m)

    def contains(self, points_m: FloatArray) -> BoolArray:
        """Return whether points [m], shape [point_count, 3], lie inside or on the faces, shape [point_count]."""
        inside = (points_m > self.low_m - TOLERANCE_M) & (
            points_m < self.high_m + TOLERANCE_M
        )
        return np.asarray(inside.all(axis=1))


@dataclass(frozen=True, kw_only=True, eq=False)
class SoftRow:
    """Soft boxes bonded face to face along a world axis; a single box is a row of length one.

    Attributes:
        axis: Index of the world axis of the row.
        blocks: Free material of each box, from the low to the high end.
        ends: Attachments of the row's ends, by side: `low` or `high`.
    """

    axis: int
    blocks: tuple[Block, ...]
    ends: Mapping[str, RigidAttachment]

    @classmethod
    def of(cls, scene: Scene, bodies: Sequence[SoftBody]) -> SoftRow:
        """Sort bodies into a row and cut off the material in the grips.

        Args:
            scene: The scene, with the attachments of the bodies to rigid bodies.
            bodies: One body, or all bodies of a row in any order.
        """
        boxes = [_box(body) for body in bodies]
        grips = [
            (box, attachment)
            for box in boxes
            for attachment in rigid_attachments(scene, box.body.name)
        ]
        if len(boxes) > 1:
            axis = int(np.argmax(np.ptp([box.centre_m for box in boxes], axis=0)))
        elif grips:
            axis, _ = _world_axis(*grips[0])
        else:
            axis = int(np.argmax(boxes[0].high_m - boxes[0].low_m))
        boxes.sort(key=lambda box: float(box.low_m[axis]))
        for first, second in pairwise(boxes):
            _check_joined(first, second, axis)
        ends: dict[str, RigidAttachment] = {}
        for box, attachment in grips:
            attached_axis, side = _world_axis(box, attachment)
            end = {"low": boxes[0], "high": boxes[-1]}[side]
            if attached_axis != axis or box is not end or side in ends:
                raise UnsupportedSceneError(
                    f"soft body {box.body.name!r} is attached elsewhere than at a free end: attach each end once"
                )
            ends[side] = attachment
            # The corners belong to this box alone, so they can be changed in place.
            if side == "low":
                box.low_m[axis] += attachment.region.depth_m
            else:
                box.high_m[axis] -= attachment.region.depth_m
        return cls(axis=axis, blocks=tuple(boxes), ends=ends)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the bodies, in their order along the row."""
        return tuple(block.body.name for block in self.blocks)

    @property
    def low_m(self) -> FloatArray:
        """Lowest corner of the free material [m], shape [3]."""
        return self.blocks[0].low_m

    @property
    def high_m(self) -> FloatArray:
        """Highest corner of the free material [m], shape [3]."""
        return self.blocks[-1].high_m

    def face_m(self, side: str) -> float:
        """Return the place of an end face along the row [m]."""
        corner_m = self.low_m if side == "low" else self.high_m
        return float(corner_m[self.axis])

    def end(self, side: str) -> Block:
        """Return the block at an end."""
        return self.blocks[0 if side == "low" else -1]

    def beyond_m(self, side: str, depth_m: float) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and the highest corner of the material behind an end face to a depth [m], shape [3]."""
        low_m, high_m = self.low_m.copy(), self.high_m.copy()
        face_m = self.face_m(side)
        low_m[self.axis] = face_m - depth_m if side == "low" else face_m
        high_m[self.axis] = face_m if side == "low" else face_m + depth_m
        return low_m, high_m

    def gripped(
        self, points_m: FloatArray
    ) -> Iterator[tuple[RigidAttachment, IntArray]]:
        """Yield each attachment and the indices of the points that lie on its face or beyond it.

        Args:
            points_m: Points in the world [m], shape [point_count, 3].
        """
        along = points_m[:, self.axis]
        beyond = {
            "low": along < self.low_m[self.axis] + TOLERANCE_M,
            "high": along > self.high_m[self.axis] - TOLERANCE_M,
        }
        for side, attachment in self.ends.items():
            yield attachment, np.flatnonzero(beyond[side])

    def nodes_of(self, nodes_m: FloatArray) -> dict[str, IntArray]:
        """Return the indices of each body's nodes among those of the row [m], shape [node_count, 3], by name.

        Nodes on a bonded face belong to both bodies.
        """
        return {
            block.body.name: np.flatnonzero(block.contains(nodes_m))
            for block in self.blocks
        }

    def checked(self, points_m: FloatArray) -> FloatArray:
        """Return the points [m], shape [point_count, 3], unchanged if all of them lie in the free material."""
        outside = np.maximum(self.low_m - points_m, points_m - self.high_m).max(axis=1)
        if not np.all(outside < TOLERANCE_M):
            worst = int(np.argmax(outside))
            raise ShapeError(
                f"point {worst} lies {1e3 * outside[worst]:.3g} mm outside the free soft material"
            )
        return points_m


def _box(body: SoftBody) -> Block:
    rotation = body.pose.matrix
    if not np.allclose(rotation, np.rint(rotation), atol=1e-6):
        raise UnsupportedSceneError(
            f"soft body {body.name!r} is not rotated by right angles: align its box with the world's axes"
        )
    half = 0.5 * np.abs(np.rint(rotation)) @ body.shape.size_m
    centre = body.pose.position_m
    return Block(body=body, low_m=centre - half, high_m=centre + half)


def _world_axis(block: Block, attachment: RigidAttachment) -> tuple[int, str]:
    """Return the world axis and the side of an attached region, which is given in the body frame."""
    direction = block.body.pose.matrix[:, "xyz".index(attachment.region.axis)]
    axis = int(np.argmax(np.abs(direction)))
    side = attachment.region.side
    if direction[axis] < 0.0:
        return axis, {"low": "high", "high": "low"}[side]
    return axis, side


def _check_joined(first: Block, second: Block, axis: int) -> None:
    low, high = first.low_m.copy(), first.high_m.copy()
    high[axis] += second.high_m[axis] - second.low_m[axis]
    low[axis] = first.high_m[axis]
    missed_m = np.abs([second.low_m - low, second.high_m - high]).max()
    if missed_m > TOLERANCE_M:
        names = f"{first.body.name!r} and {second.body.name!r}"
        raise UnsupportedSceneError(
            f"soft bodies {names} do not join face to face: make equal faces meet"
        )


def soft_rows(scene: Scene) -> list[SoftRow]:
    """Return the soft rows of a scene."""
    return [SoftRow.of(scene, bodies) for bodies in bonded_soft_bodies(scene)]


def soft_row_problems(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each group of bonded soft bodies that is not a soft row."""
    for bodies in bonded_soft_bodies(scene):
        try:
            SoftRow.of(scene, bodies)
        except UnsupportedSceneError as error:
            yield str(error)


# --- tetrahedra ------------------------------------------------------------------------------------------------------


def lame_constants(body: SoftBody) -> tuple[float, float]:
    """Return the shear modulus and the first Lame constant [Pa]."""
    young, poisson = body.young_modulus_pa, body.poisson_ratio
    shear = young / (2.0 * (1.0 + poisson))
    return shear, 2.0 * shear * poisson / (1.0 - 2.0 * poisson)


@dataclass(frozen=True, kw_only=True)
class TetrahedralMesh:
    """Tetrahedra of the elastic blocks of a soft row.

    Attributes:
        points_m: Nodes at the start [m], shape [node_count, 3].
        tetrahedra: Node indices of each tetrahedron, positively oriented, shape [tetrahedron_count, 4].
        volumes_m3: Volumes of the tetrahedra [m^3], shape [tetrahedron_count].
        blocks: Index of each tetrahedron's block in the row, shape [tetrahedron_count].
    """

    points_m: FloatArray
    tetrahedra: IntArray
    volumes_m3: FloatArray
    blocks: IntArray

    @classmethod
    def of(
        cls, soft_row: SoftRow, rigid: Sequence[Block], cell_m: float
    ) -> TetrahedralMesh:
        """Return the mesh of all elastic blocks; neighbouring elastic blocks share nodes.

        Args:
            soft_row: The soft row.
            rigid: Blocks without elements.
            cell_m: Largest edge of a cell [m].
        """
        points, tetrahedra, blocks, count = [], [], [], 0
        for is_rigid, group in groupby(
            enumerate(soft_row.blocks), key=lambda item: item[1] in rigid
        ):
            if is_rigid:
                continue
            members = list(group)
            lines = grid_lines_m([block for _, block in members], soft_row.axis, cell_m)
            corners = _tetrahedra([len(line) for line in lines])
            points.append(grid_points(*lines))
            tetrahedra.append(count + corners)
            count += len(points[-1])
            middles = points[-1][corners].mean(axis=1)
            owner = np.zeros(len(corners), dtype=np.intp)
            for index, block in members:
                owner[block.contains(middles)] = index
            blocks.append(owner)
        all_points, all_tetrahedra = np.concatenate(points), np.concatenate(tetrahedra)
        volumes = (
            np.linalg.det(
                all_points[all_tetrahedra[:, 1:]] - all_points[all_tetrahedra[:, :1]]
            )
            / 6.0
        )
        flipped = volumes < 0.0
        all_tetrahedra[flipped] = all_tetrahedra[flipped][:, [1, 0, 2, 3]]
        return cls(
            points_m=all_points,
            tetrahedra=all_tetrahedra,
            volumes_m3=np.abs(volumes),
            blocks=np.concatenate(blocks),
        )

    def masses_kg(self, densities_kg_per_m3: Sequence[float]) -> FloatArray:
        """Return node masses [kg], shape [node_count]: a quarter of each tetrahedron's mass for each of its nodes."""
        shares = 0.25 * self.volumes_m3 * np.take(densities_kg_per_m3, self.blocks)
        masses = np.zeros(len(self.points_m))
        np.add.at(masses, self.tetrahedra, shares[:, None])
        return masses

    def surface(self) -> IntArray:
        """Return the boundary triangles, counter-clockwise seen from outside, shape [triangle_count, 3]."""
        faces = self.tetrahedra[
            :, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]
        ].reshape(-1, 3)
        _, first, count = np.unique(
            np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
        )
        return faces[first[count == 1]]

    def weights(self, points_m: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return four nodes and their barycentric weights for each point [m], both of shape [point_count, 4]."""
        corners = self.points_m[self.tetrahedra]
        first = corners[:, 0]
        # A point is x0 + E w with the edges E from the first corner; w are the weights of the other corners.
        edges = (corners[:, 1:] - first[:, None]).transpose(0, 2, 1)
        last_three = np.einsum(
            "tij,ptj->pti", np.linalg.inv(edges), points_m[:, None] - first
        )
        weights = np.concatenate(
            [1.0 - last_three.sum(axis=-1, keepdims=True), last_three], axis=-1
        )
        # On shared faces, and just outside the surface, take the tetrahedron that contains the point most deeply.
        best = np.argmax(weights.min(axis=-1), axis=1)
        return self.tetrahedra[best], weights[np.arange(len(points_m)), best]


def grid_lines_m(blocks: Sequence[Block], axis: int, cell_m: float) -> list[FloatArray]:
    """Return the grid lines along x, y and z [m] of blocks that join along an axis, including their interfaces."""
    lines = [_line_m(blocks[0].low_m[i], blocks[0].high_m[i], cell_m) for i in range(3)]
    for block in blocks[1:]:
        lines[axis] = np.append(
            lines[axis], _line_m(block.low_m[axis], block.high_m[axis], cell_m)[1:]
        )
    return lines


def _line_m(low_m: float, high_m: float, cell_m: float) -> FloatArray:
    return np.linspace(
        low_m, high_m, max(1, ceil((high_m - low_m) / cell_m - 1e-6)) + 1
    )


def _tetrahedra(counts: Sequence[int]) -> IntArray:
    """Return five tetrahedra for each cell of a grid with the given numbers of lines, shape [tetrahedron_count, 4]."""
    cells = np.array(list(product(*(range(count - 1) for count in counts))))
    mirrored = (cells % 2 == 1)[:, None, None]
    corners = cells[:, None, None] + np.where(
        mirrored, 1 - FIVE_TETRAHEDRA, FIVE_TETRAHEDRA
    )
    return np.ravel_multi_index(
        tuple(np.moveaxis(corners, -1, 0)), tuple(counts)
    ).reshape(-1, 4)


# --- scattered points ------------------------------------------------------------------------------------------------


def points_in_box_m(
    low_m: FloatArray, high_m: FloatArray, spacing_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return the centres of the cells of a box [m], shape [point_count, 3], and the size of a cell [m], shape [3].

    Args:
        low_m: Lowest corner of the box [m], shape [3].
        high_m: Highest corner [m], shape [3].
        spacing_m: Largest edge of a cell [m].
    """
    counts = np.maximum(1, np.ceil((high_m - low_m) / spacing_m - 1e-6)).astype(int)
    cell_m = (high_m - low_m) / counts
    middles = grid_points(*(np.arange(count) + 0.5 for count in counts))
    return low_m + cell_m * middles, cell_m


def linear_weights(
    sources_m: FloatArray, points_m: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return the nearest sources of each point and moving-least-squares weights that reproduce linear functions.

    Returns:
        Indices of the sources and their weights, both of shape [point_count, NEIGHBOURS].
    """
    from scipy.spatial import cKDTree

    distances_m, nearest = cKDTree(sources_m).query(points_m, k=NEIGHBOURS)
    farthest_m = distances_m[:, -1:]
    # The importance of a source falls to 2 % at the farthest neighbour.
    importance = np.exp(-4.0 * np.square(distances_m / farthest_m))
    offsets = (sources_m[nearest] - points_m[:, None]) / farthest_m[:, None]
    # A linear function about the point has the basis 1, x, y, z.
    basis = np.concatenate([np.ones_like(offsets[..., :1]), offsets], axis=-1)
    moments = np.einsum("pk,pki,pkj->pij", importance, basis, basis)
    # The value at the point itself is the first coefficient.
    selected = np.broadcast_to(np.eye(4)[:, :1], (len(points_m), 4, 1))
    coefficients = np.linalg.solve(moments, selected)[..., 0]
    return nearest, importance * np.einsum("pki,pi->pk", basis, coefficients)
