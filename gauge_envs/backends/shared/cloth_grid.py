"""Regular mesh of a cloth, whatever the engine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Cloth, Motion, Region

__all__ = [
    "ClothGrid",
    "held_vertices",
]


class ClothGrid:
    """Regular triangulation of a cloth in its own plane; diagonals lean one way in even rows and the other in odd ones.

    Args:
        cloth: The cloth.
        cell_m: Wanted edge length of the cells [m].

    Attributes:
        cell_m: Edge lengths along x and y [m].
        plane_m: Vertices in the cloth's frame [m], shape [vertex_count, 2]; y runs fastest.
        triangles: Vertex indices, shape [triangle_count, 3].
    """

    def __init__(self, cloth: Cloth, cell_m: float) -> None:
        self._size_m = cloth.size_m
        nx, ny = self._counts = tuple(max(1, round(size / cell_m)) for size in cloth.size_m)
        self.cell_m = (cloth.size_m[0] / nx, cloth.size_m[1] / ny)
        x, y = (np.linspace(-0.5 * size, 0.5 * size, n + 1) for size, n in zip(cloth.size_m, (nx, ny), strict=True))
        self.plane_m = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        i, j = (index.ravel() for index in np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"))
        a, b = i * (ny + 1) + j, (i + 1) * (ny + 1) + j
        d, c = a + 1, b + 1
        rising = np.stack([a, b, c, a, c, d], axis=-1)
        falling = np.stack([a, b, d, b, c, d], axis=-1)
        self.triangles = np.where((j % 2 == 0)[:, None], rising, falling).reshape(-1, 3)

    def within(self, region: Region) -> NDArray[np.bool_]:
        """Which vertices lie in a region, shape [vertex_count]."""
        axis = "xy".index(region.axis)
        from_low = self.plane_m[:, axis] + 0.5 * self._size_m[axis]
        inward = from_low if region.side == "low" else self._size_m[axis] - from_low
        return np.asarray(inward <= region.depth_m + 1e-6 * self._size_m[axis])

    def vertex_areas_m2(self) -> NDArray[np.float64]:
        """A quarter of the cells around each vertex [m^2], shape [vertex_count].

        Thirds of triangles, Newton's choice, weigh the vertices of an edge unevenly: the diagonals meet at every
        other one.
        """
        along_x, along_y = (
            cell * np.where(np.arange(count + 1) % count == 0, 0.5, 1.0)
            for cell, count in zip(self.cell_m, self._counts, strict=True)
        )
        return np.outer(along_x, along_y).ravel()

    def mean_edge_length_m(self) -> float:
        """Mean length of the edges, each counted once [m]."""
        edges = np.sort(self.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        ends = self.plane_m[np.unique(edges, axis=0)]
        return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean())


def held_vertices(sheet: ClothGrid, cloth: Cloth, glued: Sequence[RigidAttachment]) -> dict[int, RigidAttachment]:
    """Which glue holds each glued vertex, the first of several."""
    held: dict[int, RigidAttachment] = {}
    for glue in reversed(glued):
        if glue.motion is Motion.DYNAMIC:
            raise UnsupportedSceneError(f"cloth {cloth.name!r} is glued to {glue.body!r}, which is dynamic")
        if glue.region.axis == "z":
            raise UnsupportedSceneError(f"cloth {cloth.name!r} is glued to {glue.body!r} by its face, not by an edge")
        held |= dict.fromkeys(np.flatnonzero(sheet.within(glue.region)).tolist(), glue)
    return held
