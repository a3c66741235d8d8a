"""Cloth in MuJoCo: a triangulated flex with independent stretch, shear and bending stiffness.

By itself, MuJoCo's surface flex is an isotropic plate. Two of its compiled tables are overwritten for a woven fabric:

- `flex_stiffness` holds, for each triangle, the upper triangle of a symmetric 3 x 3 matrix S. With s the changes of the
  squared edge lengths (edges from vertex 1 to 2, 2 to 0, 0 to 1), the membrane energy is s' S s / 4. That is a St.
  Venant-Kirchhoff law with S = (area / 2) B^-T C B^-1, where B maps Green's strains xx, yy and 2 xy to s / 2. The
  plane law C is arbitrary, so warp, weft and shear have the measured stiffness.
- `flex_bending` holds, for each edge, a quadratic form on the two triangles that meet there. It is exact for folds
  along grid lines; other folds depend on the layout and weight of the diagonals, see `_diagonal_weight`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.mujoco.flex import FlexPart, Points, attached_points
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.backends.shared.cloth_grid import ClothGrid, held_vertices
from gauge_envs.errors import ParameterError
from gauge_envs.scene import Cloth

ELASTIC_BOTH = 3
"""MuJoCo's code for a flex that both stretches and bends."""

VERTEX_INERTIA_KG_M2 = 1e-6

STIFFNESS_PER_TRIANGLE = 21
"""Number of values that MuJoCo reserves for each element, enough for a tetrahedron; a triangle uses the first six."""

BENDING_PER_EDGE = 17
"""Number of values per edge: a 4 x 4 form on its ends and the two opposite vertices, and one for curved rest shapes."""


class ClothPartMuJoCo(FlexPart):
    """A cloth, whose vertices are point bodies or points of the rigid bodies that it is attached to.

    Args:
        cloth: The cloth.
        flex: Its flex in the editable model.
        grid: Its mesh.
        rest_m: World positions of the vertices at the start [m], shape [vertex_count, 3].
        points: Its vertices.

    Attributes:
        cloth: The cloth.
        grid: Its mesh.
    """

    def __init__(
        self,
        cloth: Cloth,
        flex: mujoco.MjsFlex,
        grid: ClothGrid,
        rest_m: NDArray[np.float64],
        points: Points,
    ) -> None:
        self.name = cloth.name
        self.flex = flex
        self.rest_m = rest_m
        self.cloth = cloth
        self.grid = grid
        self.points = points

    def complete(self, model: mujoco.MjModel) -> None:
        """Write the fabric's membrane law and scale the bending stiffness of the diagonals."""
        flex = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, self.name)
        membrane = _membrane(self.grid, self.cloth.stretch_stiffness_n_per_m, self.cloth.shear_stiffness_n_per_m)
        start = model.flex_stiffnessadr[flex]
        table = model.flex_stiffness[start : start + STIFFNESS_PER_TRIANGLE * len(membrane)]
        table.reshape(-1, STIFFNESS_PER_TRIANGLE)[:, :6] = membrane

        edge, count = model.flex_edgeadr[flex], model.flex_edgenum[flex]
        ends = self.grid.plane_m[model.flex_edge[edge : edge + count]]
        diagonal = (np.abs(ends[:, 1] - ends[:, 0]) > 1e-9).all(axis=1)
        start = model.flex_bendingadr[flex]
        forms = model.flex_bending[start : start + BENDING_PER_EDGE * count].reshape(-1, BENDING_PER_EDGE)
        forms[diagonal] *= _diagonal_weight(*self.grid.cell_m)

    def nodes(self) -> NDArray[np.float64]:
        """Return the current world positions of the vertices [m], shape [node_count, 3]; cloth y runs fastest."""
        return self.points.positions()


def add_cloth(
    spec: mujoco.MjSpec,
    cloth: Cloth,
    *,
    attachments: Sequence[RigidAttachment],
    cell_m: float,
    bending_stiffness_n_m: float,
    contact_radius_m: float | None = None,
) -> ClothPartMuJoCo:
    """Add a cloth without contacts to an editable model.

    The fabric has no Poisson effect and no material damping. The integrator `discrete` damps it: it treats elasticity
    implicitly and is first order in the time step.

    Args:
        spec: Editable model that contains the rigid bodies.
        cloth: The cloth.
        attachments: Attached regions; a vertex in two regions belongs to the first. A region no deeper than the edge
            holds one line of vertices, which is a hinge. Two lines clamp the slope, and act as a clamp halfway between
            them.
        cell_m: Desired edge length of the cells [m]; the nearest length that divides a side is used.
        bending_stiffness_n_m: Plate bending stiffness D, moment per width and curvature [N m]; positive.
        contact_radius_m: Half the thickness with which the cloth collides [m]; half the physical thickness by default.
            Layers of cloth pass through each other if this is much less than their displacement in one step (2 mm at
            1/900 s). Bodies rest at this distance from the cloth's mid-plane.
    """
    grid = ClothGrid(cloth, cell_m)
    if contact_radius_m is not None and 2.0 * contact_radius_m >= min(grid.cell_m):
        raise ParameterError(
            f"cloth {cloth.name!r} would collide with a thickness of {2e3 * contact_radius_m:g} mm, but its cells of "
            f"{1e3 * min(grid.cell_m):.3g} mm must be larger: reduce cloth_fold_radius_m or increase cell_m"
        )
    held = held_vertices(grid, cloth, attachments)
    rest = cloth.pose.to_world(np.column_stack([grid.plane_m, np.zeros(len(grid.plane_m))]))
    names = [f"{cloth.name}/{index}" for index in range(len(rest))]
    for index, mass in enumerate(cloth.areal_density_kg_per_m2 * grid.vertex_areas_m2()):
        if index in held:
            continue
        body = spec.worldbody.add_body(name=names[index], pos=rest[index])
        body.explicitinertial = True
        body.mass = mass
        body.ipos = [0.0, 0.0, 0.0]
        # A vertex does not rotate, but MuJoCo needs an inertia that it can write and read back.
        body.inertia = [VERTEX_INERTIA_KG_M2] * 3
        for axis in np.eye(3):
            body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)

    flex = spec.add_flex(name=cloth.name, dim=2)
    flex.vertbody, places = attached_points(names, rest, held)
    flex.vert = places.ravel()
    flex.elem = grid.triangles.ravel().tolist()
    flex.elastic2d = ELASTIC_BOTH
    # MuJoCo derives both stiffnesses from one solid plate; this plate has the stretch and the bending of the fabric.
    flex.thickness = sqrt(12.0 * bending_stiffness_n_m / cloth.stretch_stiffness_n_per_m)
    flex.young = cloth.stretch_stiffness_n_per_m / flex.thickness
    flex.poisson = 0.0
    flex.radius = 0.5 * cloth.thickness_m if contact_radius_m is None else contact_radius_m
    flex.contype = 0
    flex.conaffinity = 0
    flex.selfcollide = mujoco.mjtFlexSelf.mjFLEXSELF_NONE
    return ClothPartMuJoCo(cloth, flex, grid, rest, Points(names, rest, held))


def _diagonal_weight(along_x_m: float, along_y_m: float) -> float:
    """Return the factor on the bending form of diagonal edges that makes the mesh an isotropic plate.

    MuJoCo's form is K^2 / (A1 + A2) with K = edge length x fold angle. Per area, edges along x give kyy^2. Edges along
    y give (kxx +- r kxy)^2, r = hy / hx. The sign alternates between rows, so the average is kxx^2 + r^2 kxy^2.
    Diagonals give (r + 1/r)^2 kxy^2. A plate without Poisson effect has kxx^2 + kyy^2 + 2 kxy^2. Constant curvature is
    in equilibrium on this mesh, so no vertex relaxes below these energies; on a mesh with diagonals that alternate in
    both directions it is not. At the rim, folds along y lack every second hinge: n cells along x bend like n - 1/2.
    """
    ratio = along_y_m / along_x_m
    return max(0.0, 2.0 - ratio**2) / (ratio + 1.0 / ratio) ** 2


def _membrane(grid: ClothGrid, stretch_n_per_m: float, shear_n_per_m: float) -> NDArray[np.float64]:
    """Return MuJoCo's stiffness of each triangle for diag(stretch, stretch, shear), shape [triangle_count, 6]."""
    corners = grid.plane_m[grid.triangles]
    edges = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
    to_edges = np.stack([edges[..., 0] ** 2, edges[..., 1] ** 2, edges[..., 0] * edges[..., 1]], axis=-1)
    to_strains = np.linalg.inv(to_edges)
    law = np.diag([stretch_n_per_m, stretch_n_per_m, shear_n_per_m])
    half_area = 0.25 * grid.cell_m[0] * grid.cell_m[1]
    matrices = half_area * (to_strains.transpose(0, 2, 1) @ law @ to_strains)
    rows, columns = np.triu_indices(3)
    return np.asarray(matrices[:, rows, columns])
