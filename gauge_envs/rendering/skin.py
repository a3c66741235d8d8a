"""Surface of a deformable body in pictures: a mesh that moves with its nodes.

The order of nodes differs between engines, so the mesh is built from their rest positions.
"""

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, Delaunay, QhullError

from gauge_envs.rendering.materials import LOOKS
from gauge_envs.scene import Cloth, SoftBody
from gauge_envs.scene.geometry import FloatArray, IntArray

ON_SIDE = 1e-4
"""Largest distance of a node from a side of the box around all nodes, relative to the longest edge of the box."""
MIN_HALF_THICKNESS_M = 0.0008
"""Smallest half thickness of cloth in pictures [m]; the table must not show through a cloth."""


class Skin:
    """Mesh over the nodes of a sheet, with a front and a back, or over the sides of a block.

    Each side has its own vertices and normals, so that the edges between sides are sharp.

    Args:
        body: The deformable body.
        rest_m: Its nodes at rest [m], shape [node_count, 3].

    Attributes:
        name: Name of the body.
        faces: Triangles of node indices, for a sheet only of its front, shape [face_count, 3].
    """

    def __init__(self, body: Cloth | SoftBody, rest_m: FloatArray) -> None:
        self.name = body.name
        self._rest_m = rest_m
        self._inflate_m = 0.0
        local_m = body.pose.to_body(rest_m)
        if isinstance(body, Cloth):
            self.faces = Delaunay(local_m[:, :2]).simplices.astype(np.intp)
            self._inflate_m = max(0.5 * body.thickness_m, MIN_HALF_THICKNESS_M)
            sides = [self.faces, self.faces[:, ::-1]]
        else:
            sides = _sides(local_m)
            self.faces = np.concatenate(sides)
        # Each side has its own copies of the nodes.
        copies = [side + number * len(rest_m) for number, side in enumerate(sides)]
        used, numbers = np.unique(np.concatenate(copies), return_inverse=True)
        self._nodes = used % len(rest_m)
        self._triangles = numbers.reshape(-1, 3)

    def add(self, spec: mujoco.MjSpec, material: str) -> None:
        """Add the mesh to a visual model: a skin of MuJoCo on a fixed bone."""
        count = len(self._nodes)
        spec.add_skin(
            name=self.name,
            vert=self._rest_m[self._nodes].ravel(),
            face=self._triangles.ravel(),
            inflate=self._inflate_m,
            material=material,
            rgba=[*LOOKS[material].color, 1.0],
            bodyname=["world"],
            bindpos=np.zeros(3),
            bindquat=[1.0, 0.0, 0.0, 0.0],
            vertid=[np.arange(count)],
            vertweight=[np.ones(count)],
        )

    def move(self, model: mujoco.MjModel, nodes_m: FloatArray) -> None:
        """Move the mesh of a compiled model to the nodes [m], shape [node_count, 3]."""
        skin = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SKIN, self.name)
        first = model.skin_vertadr[skin]
        model.skin_vert[first : first + len(self._nodes)] = nodes_m[self._nodes]


def _sides(local_m: FloatArray) -> list[IntArray]:
    """Return the outward triangles of each side of a block; irregular nodes have one side, their convex hull."""
    low_m, high_m = local_m.min(axis=0), local_m.max(axis=0)
    tolerance_m = ON_SIDE * float((high_m - low_m).max())
    sides = []
    try:
        for axis in range(3):
            for end_m, outward in ((low_m, -1.0), (high_m, 1.0)):
                distances_m = np.abs(local_m[:, axis] - end_m[axis])
                on_side = np.flatnonzero(distances_m <= tolerance_m)
                plane_m = np.delete(local_m[on_side], axis, axis=1)
                faces = on_side[Delaunay(plane_m).simplices]
                sides.append(_turned(faces, local_m, outward * np.eye(3)[axis]))
    except (QhullError, ValueError):
        hull = ConvexHull(local_m)
        return [_turned(hull.simplices, local_m, hull.equations[:, :3])]
    return sides


def _turned(faces: IntArray, points_m: FloatArray, outward: FloatArray) -> IntArray:
    """Return triangles whose normals point outward, shape [face_count, 3]."""
    first, second, third = points_m[faces].swapaxes(0, 1)
    normals = np.cross(second - first, third - first)
    is_inward = (normals * outward).sum(axis=1) < 0.0
    return np.where(is_inward[:, None], faces[:, ::-1], faces).astype(np.intp)
