"""Volume, extent and radius of gyration of the shapes of a body."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.tools.sanity.robot.robot import Robot, once

TYPES = mujoco.mjtGeom

MARKER_M = 0.01
"""Size of shapes that mark the place of a link instead of showing it [m]."""


def mesh_volume_m3(model: mujoco.MjModel, geom: int) -> float:
    """Return the volume of the mesh of a geom by the divergence theorem [m^3]; NaN where it is not closed."""
    mesh = int(model.geom_dataid[geom])
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
    begins, ends = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    edges, reverse = (
        a.astype(np.int64) << 32 | b for a, b in ((begins, ends), (ends, begins))
    )
    if len(np.unique(edges)) < len(edges) or not np.isin(reverse, edges).all():
        return float("nan")
    first, second, third = vertices.astype(np.float64)[faces].transpose(1, 0, 2)
    return abs(float(np.einsum("ni,ni->", first, np.cross(second, third)))) / 6.0


def volumes_and_squares(model: mujoco.MjModel) -> tuple[FloatArray, FloatArray]:
    """Return volume and squared radius of gyration of each geom, shapes [ngeom]; of a mesh, those of its ellipsoid.

    The squared radius of gyration is half the trace of the inertia over the mass.
    """
    a, b, c = model.geom_size.T
    x, y, z = model.geom_aabb[:, 3:].T
    ellipsoid = 4.0 / 3.0 * np.pi * x * y * z, (x**2 + y**2 + z**2) / 5.0
    kinds = {
        TYPES.mjGEOM_SPHERE: (4.0 / 3.0 * np.pi * a**3, 0.6 * a**2),
        TYPES.mjGEOM_BOX: (8.0 * a * b * c, (a**2 + b**2 + c**2) / 3.0),
        TYPES.mjGEOM_CYLINDER: (2.0 * np.pi * a**2 * b, a**2 / 2.0 + b**2 / 3.0),
        TYPES.mjGEOM_CAPSULE: (
            2.0 * np.pi * a**2 * (b + 2.0 / 3.0 * a),
            a**2 / 2.0 + (b + 0.8 * a) ** 2 / 3.0,
        ),
    }
    volumes, squares = ellipsoid
    for kind, (volume, square) in kinds.items():
        is_kind = model.geom_type == kind
        volumes, squares = (
            np.where(is_kind, volume, volumes),
            np.where(is_kind, square, squares),
        )
    return volumes, squares


def solid_geoms(model: mujoco.MjModel) -> BoolArray:
    """Return which geoms can collide, shape [ngeom]."""
    solid: BoolArray = (model.geom_contype | model.geom_conaffinity) != 0
    solid[[*model.pair_geom1.tolist(), *model.pair_geom2.tolist()]] = True
    return solid


@dataclass(frozen=True, kw_only=True)
class BodyShape:
    """Shapes of a body.

    Attributes:
        low_m: Smallest coordinates of the shapes in the frame of the body [m], shape [3].
        high_m: Largest coordinates [m], shape [3].
        volume_m3: Smallest volume of its colliding or drawn shapes without meshes, which may be hollow [m^3].
        square_m2: Smallest squared radius of gyration of its colliding or drawn shapes with an even density [m^2].
    """

    low_m: FloatArray
    high_m: FloatArray
    volume_m3: float
    square_m2: float

    @property
    def box_m3(self) -> float:
        """Volume of the box around the shapes [m^3]."""
        return float((self.high_m - self.low_m).prod())

    def farthest_m(self, point_m: FloatArray) -> float:
        """Return the distance of a point from the farthest corner of the box [m]."""
        away = np.maximum(np.abs(self.low_m - point_m), np.abs(self.high_m - point_m))
        return float(np.linalg.norm(away))


@once
def body_shapes(robot: Robot) -> dict[int, BodyShape]:
    """Return the shapes of each moving body that has some larger than a marker."""
    model, shapes = robot.model, {}
    rotations = Rotation.from_quat(model.geom_quat, scalar_first=True)
    centres = model.geom_pos + rotations.apply(model.geom_aabb[:, :3])
    halves = np.einsum(
        "nij,nj->ni", np.abs(rotations.as_matrix()), model.geom_aabb[:, 3:]
    )
    volumes, squares = volumes_and_squares(model)
    solid = solid_geoms(model)
    solids = np.where(model.geom_type == TYPES.mjGEOM_MESH, 0.0, volumes)
    is_solid_shape = model.geom_type >= int(TYPES.mjGEOM_SPHERE)
    for body in np.flatnonzero(model.body_treeid >= 0).tolist():
        of_body = (model.geom_bodyid == body) & is_solid_shape
        groups = [of_body & solid, of_body & ~solid]
        groups = [np.flatnonzero(group) for group in groups if group.any()]
        if not groups:
            continue
        every = np.hstack(groups)
        if (
            np.ptp(
                [*(centres - halves)[every], *(centres + halves)[every]], axis=0
            ).max()
            < MARKER_M
        ):
            continue
        shapes[body] = BodyShape(
            low_m=(centres - halves)[every].min(axis=0),
            high_m=(centres + halves)[every].max(axis=0),
            volume_m3=min(float(solids[group].sum()) for group in groups),
            square_m2=min(
                _square(volumes[group], squares[group], centres[group])
                for group in groups
            ),
        )
    return shapes


def _square(volumes: FloatArray, squares: FloatArray, centres: FloatArray) -> float:
    """Return the squared radius of gyration of several shapes about their common centre [m^2]."""
    weights = volumes / max(volumes.sum(), 1e-300)
    away = centres - weights @ centres
    return float(weights @ (squares + (away**2).sum(axis=1)))
