"""Surface of a deformable body in pictures: a mesh over its nodes that moves with them.

The order of the nodes differs between engines, so the mesh follows from their rest positions.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from gauge_envs.scene import Cloth, SoftBody

__all__ = ["Skin"]


class Skin:
    """Two-sided mesh over the nodes of a sheet, or over the outer nodes of a solid.

    Args:
        body: The deformable body.
        rest_m: Its nodes at rest [m], shape [node_count, 3].

    Attributes:
        name: Name of the body.
        faces: Triangles of node indices on the front, shape [face_count, 3].
    """

    def __init__(self, body: Cloth | SoftBody, rest_m: NDArray[np.float64]) -> None:
        self.name = body.name
        local = body.pose.to_body(rest_m)
        faces = _sheet_faces(local) if isinstance(body, Cloth) else _boundary_faces(local)
        # The back has its own vertices, because each vertex has one normal.
        self._faces = np.concatenate([faces, faces[:, ::-1] + len(rest_m)])
        self.faces = faces
        self._rest_m = rest_m

    def add(self, spec: mujoco.MjSpec, rgba: tuple[float, ...]) -> None:
        """Add the mesh to a visual model."""
        vertices, normals = self._surface(self._rest_m)
        mesh = spec.add_mesh(
            name=self._mesh_name,
            uservert=vertices.ravel(),
            usernormal=normals.ravel(),
            userface=self._faces.ravel(),
            userfacenormal=self._faces.ravel(),
        )
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        geom = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, name=mesh.name, rgba=rgba)
        geom.contype = geom.conaffinity = 0

    def place(self, model: mujoco.MjModel) -> None:
        """Undo MuJoCo's centring of the mesh, so that vertices are in the world frame."""
        self._mesh = model.mesh(self._mesh_name).id
        geom = model.geom(self._mesh_name).id
        model.geom_pos[geom] = 0.0
        model.geom_quat[geom] = (1.0, 0.0, 0.0, 0.0)
        # Frustum culling uses the rest shape, which the body leaves.
        model.geom_rbound[geom] = 100.0

    def upload(self, model: mujoco.MjModel, device: mujoco.MjrContext, nodes_m: NDArray[np.float64]) -> None:
        """Move the mesh to the nodes [m], shape [node_count, 3]."""
        vertices, normals = self._surface(nodes_m)
        first, first_normal = model.mesh_vertadr[self._mesh], model.mesh_normaladr[self._mesh]
        model.mesh_vert[first : first + len(vertices)] = vertices
        model.mesh_normal[first_normal : first_normal + len(normals)] = normals
        mujoco.mjr_uploadMesh(model, device, self._mesh)

    @property
    def _mesh_name(self) -> str:
        return f"{self.name}/skin"

    def _surface(self, nodes_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return vertices [m] and normals of front and back, each of shape [2 * node_count, 3]."""
        corners = nodes_m[self.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.zeros_like(nodes_m)
        for corner in range(3):
            np.add.at(normals, self.faces[:, corner], across)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.where(length > 0.0, normals / np.maximum(length, 1e-30), [0.0, 0.0, 1.0])
        return np.concatenate([nodes_m, nodes_m]), np.concatenate([normals, -normals])


def _sheet_faces(local_m: NDArray[np.float64]) -> NDArray[np.intp]:
    faces: NDArray[np.intp] = Delaunay(local_m[:, :2]).simplices.astype(np.intp)
    return faces


def _boundary_faces(local_m: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the faces that belong to one tetrahedron only, with outward normals."""
    cells = Delaunay(local_m).simplices
    faces = np.concatenate([cells[:, kept] for kept in ([0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3])])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    outer: NDArray[np.intp] = faces[first[count == 1]].astype(np.intp)
    corners = local_m[outer]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (across * (corners.mean(axis=1) - local_m.mean(axis=0))).sum(axis=1) < 0.0
    outer[inward] = outer[inward][:, ::-1]
    return outer
