"""Surface of a deformable body in pictures: a mesh over its nodes that moves with them.

The order of the nodes differs between engines, so the mesh follows from their rest positions.
"""

from collections.abc import Iterator

import mujoco
import numpy as np
from scipy.spatial import Delaunay, QhullError

from gauge_envs.rendering.materials import Look
from gauge_envs.scene import Cloth, SoftBody
from gauge_envs.scene.geometry import FloatArray, IntArray

ON_SIDE = 1e-4
"""Largest distance of a node from a side of the box around all nodes, relative to its longest edge."""
CLOSED = 1e-6
"""Largest deviation of the volume inside the sides from that of the box, relative."""
SHEET_HALF_M = 0.0008
"""Half of the thickness that cloth has in pictures at least [m]: a cloth on a table must not shine through it."""


class Skin:
    """Two-sided mesh over the nodes of a sheet, or mesh over the sides of a solid.

    The sides of a block have sharp edges: each side has its own vertices, with its own normals.

    Args:
        body: The deformable body.
        rest_m: Its nodes at rest [m], shape [node_count, 3].

    Attributes:
        name: Name of the body.
        faces: Triangles of node indices on the front, shape [face_count, 3].
    """

    def __init__(self, body: Cloth | SoftBody, rest_m: FloatArray) -> None:
        self.name = body.name
        local = body.pose.to_body(rest_m)
        is_sheet = isinstance(body, Cloth)
        sides = (
            [Delaunay(local[:, :2]).simplices.astype(np.intp)]
            if is_sheet
            else _sides(local)
        )
        self.faces = np.concatenate(sides)
        # A vertex has one normal, so that front and back of a sheet, and each side of a block, have their own.
        patches = [(side, 1.0) for side in sides] + (
            [(sides[0][:, ::-1], -1.0)] if is_sheet else []
        )
        self._half_m = (
            max(0.5 * body.thickness_m, SHEET_HALF_M)
            if isinstance(body, Cloth)
            else 0.0
        )
        nodes, faces, first = [], [], 0
        for patch, _ in patches:
            used, renumbered = np.unique(patch, return_inverse=True)
            nodes.append(used)
            faces.append(renumbered.reshape(-1, 3) + first)
            first += len(used)
        self._nodes, self._faces = np.concatenate(nodes), np.concatenate(faces)
        self._rest_m = rest_m

    def add(self, spec: mujoco.MjSpec, look: Look, material: str = "") -> None:
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
        geom = spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=mesh.name,
            name=mesh.name,
            rgba=look.color,
            material=material,
        )
        geom.contype = geom.conaffinity = 0

    def place(self, model: mujoco.MjModel) -> None:
        """Undo MuJoCo's centring of the mesh, so that vertices are in the world frame."""
        self._mesh = model.mesh(self._mesh_name).id
        geom = model.geom(self._mesh_name).id
        model.geom_pos[geom] = 0.0
        model.geom_quat[geom] = (1.0, 0.0, 0.0, 0.0)
        # Frustum culling uses the rest shape, which the body leaves.
        model.geom_rbound[geom] = 100.0

    def upload(
        self, model: mujoco.MjModel, device: mujoco.MjrContext, nodes_m: FloatArray
    ) -> None:
        """Move the mesh to the nodes [m], shape [node_count, 3]."""
        vertices, normals = self._surface(nodes_m)
        first, first_normal = (
            model.mesh_vertadr[self._mesh],
            model.mesh_normaladr[self._mesh],
        )
        model.mesh_vert[first : first + len(vertices)] = vertices
        model.mesh_normal[first_normal : first_normal + len(normals)] = normals
        mujoco.mjr_uploadMesh(model, device, self._mesh)

    @property
    def _mesh_name(self) -> str:
        return f"{self.name}/skin"

    def _surface(self, nodes_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return vertices [m] and their normals, each of shape [vertex_count, 3]; a sheet is thickened along them."""
        vertices = nodes_m[self._nodes]
        corners = vertices[self._faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.zeros_like(vertices)
        for corner in range(3):
            np.add.at(normals, self._faces[:, corner], across)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.where(
            length > 0.0, normals / np.maximum(length, 1e-30), [0.0, 0.0, 1.0]
        )
        return vertices + self._half_m * normals, normals


def _sides(local_m: FloatArray) -> list[IntArray]:
    """Return the outward triangles of each side of a block.

    Nodes on the six sides of the box around all nodes are joined side by side, so that a side is flat. Where such nodes
    do not close the box, as in an irregular cloud, the surface of the whole cloud is one side.
    """
    low, high = local_m.min(axis=0), local_m.max(axis=0)
    sides = list(_box_sides(local_m, low, high))
    if len(sides) == 6:
        corners = (local_m - low)[np.concatenate(sides)]
        volume = (
            np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
            / 6.0
        )
        if abs(volume - np.prod(high - low)) <= CLOSED * np.prod(high - low):
            return sides
    return [_boundary_faces(local_m)]


def _box_sides(
    local_m: FloatArray, low: FloatArray, high: FloatArray
) -> Iterator[IntArray]:
    within = ON_SIDE * float((high - low).max())
    for axis in range(3):
        for end, outward in ((low, -1.0), (high, 1.0)):
            on_side = np.flatnonzero(np.abs(local_m[:, axis] - end[axis]) <= within)
            plane = np.delete(local_m[on_side], axis, axis=1)
            try:
                faces = on_side[Delaunay(plane).simplices]
            except (QhullError, ValueError):
                return
            corners = local_m[faces]
            across = np.cross(
                corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
            )[:, axis]
            yield np.where(
                (across * outward < 0.0)[:, None], faces[:, ::-1], faces
            ).astype(np.intp)


def _boundary_faces(local_m: FloatArray) -> IntArray:
    """Return the faces that belong to one tetrahedron only, with outward normals."""
    cells = Delaunay(local_m).simplices
    faces = np.concatenate(
        [cells[:, kept] for kept in ([0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3])]
    )
    _, first, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    outer: IntArray = faces[first[count == 1]].astype(np.intp)
    corners = local_m[outer]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (across * (corners.mean(axis=1) - local_m.mean(axis=0))).sum(axis=1) < 0.0
    outer[inward] = outer[inward][:, ::-1]
    return outer
