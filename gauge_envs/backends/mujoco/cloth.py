"""Cloth in MuJoCo: a triangulated flex with independent stretch, shear and bending stiffness.

By itself, MuJoCo's surface flex is an isotropic plate. Two of its compiled tables are overwritten for a woven fabric:

- `flex_stiffness` holds, for each triangle, the upper triangle of a symmetric 3 x 3 matrix S. The vector s holds the
  changes of the squared edge lengths (edges from vertex 1 to 2, 2 to 0, 0 to 1). The membrane energy is s' S s / 4, a
  St. Venant-Kirchhoff law with S = (area / 2) B^-T C B^-1, where B maps Green's strains xx, yy and 2 xy to s / 2. The
  plane law C is arbitrary, so warp, weft and shear have the measured stiffness.
- `flex_bending` holds, for each edge, a quadratic form on the two triangles that meet there. It is exact for folds
  along grid lines; other folds depend on the layout and weight of the diagonals, see `_diagonal_weight`.
"""

from collections.abc import Sequence
from math import sqrt

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.flex import (
    FlexPart,
    Points,
    collide_with_nothing,
    flex_table,
)
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.backends.shared.cloth_grid import ClothGrid, attached_vertices
from gauge_envs.errors import ParameterError
from gauge_envs.scene import Air, Cloth, Pose, Scene
from gauge_envs.scene.geometry import FloatArray, length_of

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
        points: Its vertices.
    """

    def __init__(
        self, cloth: Cloth, flex: mujoco.MjsFlex, grid: ClothGrid, points: Points
    ) -> None:
        super().__init__(flex, grid.rest_m, points)
        self.cloth, self.grid = cloth, grid

    def set_pose(self, pose: Pose) -> None:
        """Move a cloth without attachments to an initial pose."""
        self.points.set_positions(self.grid.at(pose))

    def complete(self, model: mujoco.MjModel) -> None:
        """Write the fabric's membrane law and scale the bending stiffness of the diagonals."""
        flex = self.flex.id
        membrane = _membrane(self.grid, self.cloth)
        stiffness = flex_table(model, "flex_stiffness", flex).reshape(
            -1, STIFFNESS_PER_TRIANGLE
        )
        stiffness[: len(membrane), :6] = membrane

        weights = self.fold_weights(model)
        forms = flex_table(model, "flex_bending", flex).reshape(-1, BENDING_PER_EDGE)
        forms[: len(weights)] *= weights[:, None]

    def fold_weights(self, model: mujoco.MjModel) -> FloatArray:
        """Return the factor on MuJoCo's bending stiffness of each edge, shape [edge_count]."""
        first, count = (
            int(numbers[self.flex.id])
            for numbers in (model.flex_edgeadr, model.flex_edgenum)
        )
        edges = model.flex_edge[first : first + count]
        opposite = model.flex_edgeflap[first : first + count]
        return np.where(
            self.grid.is_diagonal(edges),
            _diagonal_weight(*self.grid.cell_m),
            self.grid.fold_stiffening(edges, opposite, self.points.attached),
        )


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
            holds one line of vertices, which is a hinge. Two lines clamp the slope.
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
    attached = attached_vertices(grid, cloth, attachments)
    rest = grid.rest_m
    names = [f"{cloth.name}/{index}" for index in range(len(rest))]
    for index, mass in enumerate(
        cloth.areal_density_kg_per_m2 * grid.vertex_areas_m2()
    ):
        if index in attached:
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
    points = Points(names, rest, attached)
    flex.vertbody, flex.vert = points.carriers()
    flex.elem = grid.triangles.ravel().tolist()
    flex.elastic2d = ELASTIC_BOTH
    # MuJoCo derives both stiffnesses from one solid plate; this plate has the stretch and the bending of the fabric.
    flex.thickness = sqrt(
        12.0 * bending_stiffness_n_m / cloth.stretch_stiffness_n_per_m
    )
    flex.young = cloth.stretch_stiffness_n_per_m / flex.thickness
    flex.poisson = 0.0
    flex.radius = (
        0.5 * cloth.thickness_m if contact_radius_m is None else contact_radius_m
    )
    collide_with_nothing(flex)
    return ClothPartMuJoCo(cloth, flex, grid, points)


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


def _membrane(grid: ClothGrid, cloth: Cloth) -> FloatArray:
    """Return MuJoCo's stiffness of each triangle for the law of `_plane_law`, shape [triangle_count, 6]."""
    corners_m = grid.plane_m[grid.triangles]
    edges_m = corners_m[:, [2, 0, 1]] - corners_m[:, [1, 2, 0]]
    x, y = edges_m[..., 0], edges_m[..., 1]
    # B: half the change of an edge's square is exx x^2 + eyy y^2 + 2 exy x y; S = (area / 2) B^-T C B^-1.
    to_edges = np.stack([x**2, y**2, x * y], axis=-1)
    to_strains = np.linalg.inv(to_edges)
    law = _plane_law(cloth)
    half_area_m2 = 0.25 * grid.cell_m[0] * grid.cell_m[1]
    matrices = half_area_m2 * (to_strains.transpose(0, 2, 1) @ law @ to_strains)
    rows, columns = np.triu_indices(3)
    return np.asarray(matrices[:, rows, columns])


def _plane_law(cloth: Cloth) -> FloatArray:
    """Return the law C of a cloth in its frame [N/m], shape [3, 3]: forces per width from strains xx, yy and 2 xy.

    Along warp and weft it is diag(stretch, stretch, shear). T gives the strains there from those in the frame of the
    cloth (R. M. Jones: Mechanics of composite materials, equation 2.78), so C = T' diag(...) T.
    """
    stretch, shear = cloth.stretch_stiffness_n_per_m, cloth.shear_stiffness_n_per_m
    cosine, sine = np.cos(cloth.warp_angle_rad), np.sin(cloth.warp_angle_rad)
    to_warp = np.array(
        [
            [cosine**2, sine**2, cosine * sine],
            [sine**2, cosine**2, -cosine * sine],
            [-2.0 * cosine * sine, 2.0 * cosine * sine, cosine**2 - sine**2],
        ]
    )
    return np.asarray(to_warp.T @ np.diag([stretch, stretch, shear]) @ to_warp)


# --- contact with itself ----------------------------------------------------------------------------------------------

LARGEST_ACCELERATION_M_PER_S2 = 100.0
"""Assumed largest acceleration of a point relative to a rigid motion, which predicts whether layers can touch."""


class FoldWatch:
    """Predicts intervals in which a cloth cannot touch itself, so that MuJoCo can skip the search for contacts.

    The search takes up to 40 % of a step. Now and then it runs with a larger thickness; if it finds no contact, layers
    are apart by the difference. Points then move by a translation, a rotation w x r and a rest e. The first two keep
    all distances, and the rest reduces a distance by 2 |e| at most.
    """

    def __init__(
        self, part: ClothPartMuJoCo, model: mujoco.MjModel, data: mujoco.MjData
    ) -> None:
        self._part, self._model, self._data = part, model, data
        # Elements of flat cloth that share no vertex are 0.7 of a cell apart.
        self._apart_m = 0.65 * min(part.grid.cell_m) - 2.0 * part.flex.radius
        self._seen_m: FloatArray | None = None

    def forget(self) -> None:
        """Forget where the cloth was, for another run."""
        self._seen_m = None

    def stays_apart(self, seconds: float) -> bool:
        """Return whether the cloth cannot touch itself in the next seconds."""
        places = self._part.points.positions()
        soon = places + self._part.points.velocities() * seconds
        limit_m = 0.5 * (self._apart_m - LARGEST_ACCELERATION_M_PER_S2 * seconds**2)
        if self._seen_m is None or _rest_m(self._seen_m, soon) >= limit_m:
            self._seen_m = (
                places if _rest_m(places, soon) < limit_m and self._is_apart() else None
            )
        return self._seen_m is not None

    def _is_apart(self) -> bool:
        """Return whether there is no contact with the larger thickness."""
        model, data, flex = self._model, self._data, self._part.flex.id
        radius = float(model.flex_radius[flex])
        model.flex_radius[flex] = radius + 0.5 * self._apart_m
        for stage in (
            mujoco.mj_kinematics,
            mujoco.mj_comPos,
            mujoco.mj_flex,
            mujoco.mj_collision,
        ):
            stage(model, data)
        model.flex_radius[flex] = radius
        return not data.ncon


def _rest_m(before: FloatArray, after: FloatArray) -> float:
    """Return the largest displacement [m] of a point after subtracting a translation and a rotation w x r."""
    arms = before - before.sum(axis=0) / len(before)
    moves = after - before
    moves -= moves.sum(axis=0) / len(moves)
    # The rotation w of points of equal mass: I w = sum(r x d), with the inertia I = sum(r.r) 1 - sum(r r').
    inertia = np.eye(3) * np.vdot(arms, arms) - arms.T @ arms
    products = arms.T @ moves
    products -= products.T
    turning = products[1, 2], products[2, 0], products[0, 1]
    x, y, z = np.linalg.solve(inertia, turning).tolist()
    moves -= arms @ ((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0))
    return float(np.sqrt(np.max(np.einsum("ij,ij->i", moves, moves))))


# --- air --------------------------------------------------------------------------------------------------------------


class AirOnCloth:
    """Forces of the air on one cloth by the law of `gauge_envs.scene.air`, as generalized forces on its free vertices.

    MuJoCo's own fluid model acts on rigid bodies by their boxes of inertia, and not on a flex.
    Each vertex takes its share of a triangle's force from `ClothGrid.triangle_shares`. The velocity of a triangle is
    the mean of its corners with the same shares. So the forces on vertices and on triangles have equal power, and a
    uniform wind accelerates a flat sheet uniformly. A cloth is attached to fixed or driven bodies only, so the air on
    attached vertices has no effect and is left out.

    Args:
        air: The air.
        part: The cloth, bound to the model.
        data: MuJoCo's state.
    """

    def __init__(self, air: Air, part: ClothPartMuJoCo, data: mujoco.MjData) -> None:
        from scipy.sparse import csr_array

        self._air = air
        self._points = part.points
        triangles = part.grid.triangles
        self._first, self._second, self._third = triangles.T
        columns = np.repeat(np.arange(len(triangles)), 3)
        shares = (part.grid.triangle_shares().ravel(), (triangles.ravel(), columns))
        self._to_vertices = csr_array(shares, shape=(len(part.rest_m), len(triangles)))
        self._to_triangles = csr_array(self._to_vertices.T)
        self._to_free = csr_array(self._to_vertices[self._points.free])
        self._forces = data.qfrc_applied

    def triangle_forces_n(self) -> FloatArray:
        """Return the forces on the triangles in the current state [N], shape [triangle_count, 3]."""
        places = self._points.positions()
        corner = places[self._first]
        areas = 0.5 * np.cross(
            places[self._second] - corner, places[self._third] - corner
        )
        return self._air.forces_n(areas, self._to_triangles @ self._points.velocities())

    def apply(self) -> None:
        """Write the forces of the current state, which act during the next step."""
        self._forces[self._points.dofs] = self._to_free @ self.triangle_forces_n()


def check_air_step(
    scene: Scene, parts: list[ClothPartMuJoCo], timestep_s: float
) -> None:
    """Raise an error if the explicit forces of the air could overshoot in a step.

    Args:
        scene: A scene with air.
        parts: Its cloth.
        timestep_s: Step of the simulation [s].
    """
    assert scene.air is not None
    fastest = scene.speed_limit_m_per_s + length_of(scene.air.wind_m_per_s)
    for part in parts:
        density = part.cloth.areal_density_kg_per_m2
        stable = scene.air.stable_speed_m_per_s(
            areal_density_kg_per_m2=density, timestep_s=timestep_s
        )
        if fastest > stable:
            raise ParameterError(
                f"air on cloth {part.name!r}: steps of {timestep_s:.3g} s are stable up to {stable:.3g} m/s relative "
                f"to the air, and the scene allows {fastest:.3g} m/s: reduce timestep_s to "
                f"{timestep_s * stable / fastest:.3g} s or less, or reduce the density or the coefficients of the air"
            )
