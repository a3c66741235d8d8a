"""Regular triangle mesh of a cloth, for every engine."""

from collections.abc import Collection, Sequence

import numpy as np

from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.backends.shared.cells import grid_points
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Cloth, Motion, Pose, Region
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray


class ClothGrid:
    """Regular triangulation of a cloth in its own plane; diagonals alternate in direction from one row to the next.

    Args:
        cloth: The cloth.
        cell_m: Desired edge length of the cells [m]. The nearest length that divides each side is used.

    Attributes:
        cell_m: Edge lengths along x and y [m].
        plane_m: Vertices in the cloth's frame [m], shape [vertex_count, 2]; y runs fastest.
        rest_m: World positions of the vertices at the start [m], shape [vertex_count, 3].
        triangles: Vertex indices, shape [triangle_count, 3].
    """

    def __init__(self, cloth: Cloth, cell_m: float) -> None:
        size_x, size_y = self._size_m = cloth.size_m
        nx, ny = self._counts = tuple(
            max(1, round(size / cell_m)) for size in cloth.size_m
        )
        self.cell_m = (size_x / nx, size_y / ny)
        x = np.linspace(-0.5 * size_x, 0.5 * size_x, nx + 1)
        y = np.linspace(-0.5 * size_y, 0.5 * size_y, ny + 1)
        self.plane_m = grid_points(x, y)
        self.rest_m = self.at(cloth.pose)
        # Corners a, b, c, d of each cell, counter-clockwise from the lowest one.
        vertices = np.arange(len(self.plane_m)).reshape(nx + 1, ny + 1)
        a = vertices[:-1, :-1].ravel()
        b = vertices[1:, :-1].ravel()
        c = vertices[1:, 1:].ravel()
        d = vertices[:-1, 1:].ravel()
        rising = np.stack([a, b, c, a, c, d], axis=-1)
        falling = np.stack([a, b, d, b, c, d], axis=-1)
        rises = np.tile(np.arange(ny) % 2 == 0, nx)
        self.triangles = np.where(rises[:, None], rising, falling).reshape(-1, 3)

    def at(self, pose: Pose) -> FloatArray:
        """Return the world positions of the vertices of the flat cloth [m], shape [vertex_count, 3]."""
        return pose.to_world(np.pad(self.plane_m, ((0, 0), (0, 1))))

    def within(self, region: Region) -> BoolArray:
        """Return whether each vertex lies in a region, shape [vertex_count]."""
        axis = "xy".index(region.axis)
        from_low = self.plane_m[:, axis] + 0.5 * self._size_m[axis]
        inward = from_low if region.side == "low" else self._size_m[axis] - from_low
        return inward <= region.depth_m + 1e-6 * self._size_m[axis]

    def vertex_areas_m2(self) -> FloatArray:
        """Return a quarter of the area of the cells around each vertex [m^2], shape [vertex_count].

        Newton gives each vertex a third of its triangles instead. That weighs the vertices of an edge unevenly,
        because the diagonals meet at every second vertex.
        """
        along_x, along_y = (
            cell * np.where(np.arange(count + 1) % count == 0, 0.5, 1.0)
            for cell, count in zip(self.cell_m, self._counts, strict=True)
        )
        return np.outer(along_x, along_y).ravel()

    def triangle_shares(self) -> FloatArray:
        """Return the share of a triangle that each of its corners carries, shape [triangle_count, 3].

        It is 1/2 at the right angle and 1/4 at the ends of the diagonal. Under a uniform load, each vertex then
        carries the load of its area in `vertex_areas_m2`.
        """
        corners = self.plane_m[self.triangles]
        before = np.roll(corners, 1, axis=1) - corners
        after = np.roll(corners, -1, axis=1) - corners
        cosines = np.abs((before * after).sum(axis=2))
        is_right = cosines < 1e-9 * self.cell_m[0] * self.cell_m[1]
        return np.where(is_right, 0.5, 0.25)

    def is_diagonal(self, edges: IntArray) -> BoolArray:
        """Return whether each edge is the diagonal of a cell, shape [edge_count], from vertices, shape [..., 2]."""
        ends_m = self.plane_m[edges]
        return np.asarray((np.abs(ends_m[:, 1] - ends_m[:, 0]) > 1e-9).all(axis=1))

    def fold_stiffening(
        self, edges: IntArray, opposite: IntArray, held: Collection[int]
    ) -> FloatArray:
        """Return 2 for each edge along the line where a clamp ends, else 1, shape [edge_count].

        A fold stands for half a cell of bent cloth on both sides. Where a clamp ends, one half is rigid, so the fold is
        twice as stiff. Without the factor the clamp acts half a cell inside its region.

        Args:
            edges: Vertices of each edge, shape [edge_count, 2].
            opposite: Other vertex of each of its two triangles, -1 on the rim, shape [edge_count, 2].
            held: Attached vertices.
        """
        vertices = list(held)
        is_line = np.isin(edges, vertices).all(axis=1) & ~self.is_diagonal(edges)
        is_line &= np.isin(opposite, vertices).sum(axis=1) == 1
        return np.where(is_line, 2.0, 1.0)


def attached_vertices(
    grid: ClothGrid, cloth: Cloth, attachments: Sequence[RigidAttachment]
) -> dict[int, RigidAttachment]:
    """Return the attachment of each attached vertex, by vertex index; of several attachments, the first applies."""
    attached: dict[int, RigidAttachment] = {}
    for attachment in reversed(attachments):
        if attachment.motion is Motion.DYNAMIC:
            raise UnsupportedSceneError(
                f"cloth {cloth.name!r} is attached to {attachment.body!r}, which is dynamic: attach it to a fixed or "
                "kinematic body"
            )
        if attachment.region.axis == "z":
            raise UnsupportedSceneError(
                f"cloth {cloth.name!r} is attached to {attachment.body!r} by its face: give a region along axis x or y"
            )
        attached |= dict.fromkeys(
            np.flatnonzero(grid.within(attachment.region)).tolist(), attachment
        )
    return attached
