"""Surface of a deformable body in pictures: a mesh over its nodes that moves with them.

The order of the nodes differs between engines, so the mesh follows from their rest positions.
"""

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, Delaunay, QhullError

from gauge_envs.rendering.materials import LOOKS
from gauge_envs.scene import Cloth, SoftBody
from gauge_envs.scene.geometry import FloatArray, IntArray

ON_SIDE = 1e-4
"""Largest distance of a node from a side of the box around all nodes, relative to its longest edge."""
MIN_HALF_THICKNESS_M = 0.0008
"""Smallest half thickness of cloth in pictures [m]: a cloth on a table must not shine through it."""


class Skin:
    """Mesh over the nodes of a sheet, with a front and a back, or over the sides of a block.

    Each side has its own vertices and normals, so that the edges between sides are sharp.

    Args:
        body: The deformable body.
        rest_m: Its nodes at rest [m], shape [node_count, 3].

    Attributes:
        name: Name of the body.
        faces: Triangles of node indices, of a sheet on its front alone, shape [face_count, 3].
    """

    def __init__(self, body: Cloth | SoftBody, rest_m: FloatArray) -> None:
        self.name = body.name
        self._rest_m = rest_m
        self._half_m = 0.0
        local_m = body.pose.to_body(rest_m)
        if isinstance(body, Cloth):
            self.faces = Delaunay(local_m[:, :2]).simplices.astype(np.intp)
            self._half_m = max(0.5 * body.thickness_m, MIN_HALF_THICKNESS_M)
            sides = [self.faces, self.faces[:, ::-1]]
        else:
            sides = _sides(local_m)
            self.faces = np.concatenate(sides)
        # Every side numbers its own copy of the nodes.
        copies = [side + number * len(rest_m) for number, side in enumerate(sides)]
        used, numbers = np.unique(np.concatenate(copies), return_inverse=True)
        self._nodes = used % len(rest_m)
        self._triangles = numbers.reshape(-1, 3)

    def add(self, spec: mujoco.MjSpec, material: str) -> None:
        """Add the mesh to a visual model."""
        vertices_m, normals = self._surface(self._rest_m)
        mesh = spec.add_mesh(
            name=self._mesh_name,
            uservert=vertices_m.ravel(),
            usernormal=normals.ravel(),
            userface=self._triangles.ravel(),
            userfacenormal=self._triangles.ravel(),
        )
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=mesh.name,
            name=mesh.name,
            rgba=[*LOOKS[material].color, 1.0],
            material=material,
        )

    def place(self, model: mujoco.MjModel) -> None:
        """Undo MuJoCo's centring of the mesh, and its culling by the rest shape: vertices are in the world frame."""
        geom = model.geom(self._mesh_name).id
        model.geom_pos[geom] = 0.0
        model.geom_quat[geom] = (1.0, 0.0, 0.0, 0.0)
        model.geom_rbound[geom] = 100.0

    def upload(
        self, model: mujoco.MjModel, device: mujoco.MjrContext, nodes_m: FloatArray
    ) -> None:
        """Move the mesh to the nodes [m], shape [node_count, 3]."""
        mesh = model.mesh(self._mesh_name).id
        vertices_m, normals = self._surface(nodes_m)
        first, first_normal = model.mesh_vertadr[mesh], model.mesh_normaladr[mesh]
        model.mesh_vert[first : first + len(vertices_m)] = vertices_m
        model.mesh_normal[first_normal : first_normal + len(normals)] = normals
        mujoco.mjr_uploadMesh(model, device, mesh)

    @property
    def _mesh_name(self) -> str:
        return f"{self.name}/skin"

    def _surface(self, nodes_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return vertices [m] and their normals, shape [vertex_count, 3] each; a sheet is thickened along them."""
        vertices_m = nodes_m[self._nodes]
        across = _across(vertices_m, self._triangles)
        normals = np.zeros_like(vertices_m)
        for corner in self._triangles.T:
            np.add.at(normals, corner, across)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.where(length > 0.0, normals / np.maximum(length, 1e-30), [0, 0, 1])
        return vertices_m + self._half_m * normals, normals


def _across(points: FloatArray, faces: IntArray) -> FloatArray:
    """Return the normal of each triangle, twice as long as its area, shape [face_count, 3]."""
    first, second, third = points[faces].swapaxes(0, 1)
    return np.cross(second - first, third - first)


def _sides(local_m: FloatArray) -> list[IntArray]:
    """Return the outward triangles of each side of a block; an irregular cloud of nodes is one side, its hull."""
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
                is_inward = _across(local_m, faces)[:, axis] * outward < 0.0
                faces[is_inward] = faces[is_inward, ::-1]
                sides.append(faces.astype(np.intp))
    except (QhullError, ValueError):
        hull = ConvexHull(local_m)
        faces = hull.simplices.astype(np.intp)
        is_inward = (_across(local_m, faces) * hull.equations[:, :3]).sum(axis=1) < 0.0
        faces[is_inward] = faces[is_inward, ::-1]
        return [faces]
    return sides
