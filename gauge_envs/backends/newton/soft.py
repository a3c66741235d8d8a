"""Soft bodies for Newton's VBD: boxes of isotropic material, alone or bonded in a row, as linear tetrahedra.

Bonded boxes are one mesh. Each cell of a regular grid is cut into five tetrahedra, one in the middle and four at
corners, mirrored from cell to cell; of the usual cuts this is the least stiff for its number of elements. Linear
tetrahedra lock in bending and torsion: with cells of a quarter of the width a clamped bar is 1 % too stiff in tension,
13 to 15 % in shear and 28 % in torsion, and these fall with the square of the cell.

Vertex block descent hardly moves a heavy stiff block on a light soft one: a hundred times the steps would be needed. A
block that is much stiffer than the softest of its row is therefore a rigid body, which the soft ones are bonded to.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, product
from math import ceil, inf

import newton
import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends.newton.vbd import Pin
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.backends.shared.soft_rows import TOLERANCE_M, Block, SoftRow
from gauge_envs.scene import Box, Motion, SoftBody
from gauge_envs.scene.meshes import mass_properties

__all__ = [
    "CELL_M",
    "CONTACT_RADIUS_M",
    "RIGID_RATIO",
    "SoftPartNewton",
    "add_block_shapes",
    "add_soft",
    "lame_constants",
]

CELL_M = 0.0125
"""Largest edge of a cell: a quarter of the width of the benchmark's foam."""

CONTACT_RADIUS_M = 0.001
"""Thickness of the layer around the surface that collides. A cube as wide as the foam pushes the nodes at its edges out
sideways: with half of this they end up above its lower face, with this they stay below."""

RIGID_RATIO = 50.0
"""A block this many times as stiff as the softest of its row is rigid; a row bends less by the ratio's inverse."""

FIVE_TETRAHEDRA = np.array(
    [
        [(0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1)],
        [(1, 0, 0), (0, 0, 0), (1, 1, 0), (1, 0, 1)],
        [(0, 1, 0), (0, 0, 0), (1, 1, 0), (0, 1, 1)],
        [(0, 0, 1), (0, 0, 0), (1, 0, 1), (0, 1, 1)],
        [(1, 1, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1)],
    ]
)
"""Corners of a unit cell that make its tetrahedra; mirrored in every second cell so that faces match."""


def lame_constants(body: SoftBody) -> tuple[float, float]:
    """Shear modulus and first Lame constant [Pa]: Newton's `k_mu` and `k_lambda`.

    Newton adds mu to lambda itself, as its stable Neo-Hookean energy needs for the small-strain limit (Smith, De Goes
    and Kim 2018, section 3.4).
    """
    young, poisson = body.young_modulus_pa, body.poisson_ratio
    shear = young / (2.0 * (1.0 + poisson))
    return shear, 2.0 * shear * poisson / (1.0 - 2.0 * poisson)


class SoftPartNewton:
    """One soft body, or several bonded in a row, of a Newton model.

    Material in a grip moves rigidly with it and is not simulated: the mesh spans what is free, whose mass it has.

    Attributes:
        name: Name of the row's first body.
        names: Names of the bodies, in their order along the row.
        rest_m: World positions of the nodes at the start [m], shape [node_count, 3]: first those of the mesh, then for
            each rigid block a grid of points, whose faces lie on nodes of the mesh.
        particles: Nodes of the mesh among the model's particles.
        pins: Nodes that moving bodies hold, for `LoopVBD`.
        rigid: Index in the model of each body of the row that is rigid.
    """

    def __init__(
        self, row: SoftRow, mesh: _Mesh, *, start: int, pins: Sequence[Pin], rigid: Mapping[str, int], cell_m: float
    ) -> None:
        self.name = row.blocks[0].body.name
        self.names = tuple(block.body.name for block in row.blocks)
        self.particles = slice(start, start + len(mesh.points_m))
        self.pins = tuple(pins)
        self.rigid = dict(rigid)
        self._row = row
        self._mesh = mesh
        self._solids = [_Solid(block, rigid[block.body.name]) for block in row.blocks if block.body.name in rigid]
        self._grids = [_grid_m(_lines_m([solid.block], 0, cell_m)) for solid in self._solids]
        self.rest_m = np.concatenate([mesh.points_m, *self._grids])
        self._rows = {block.body.name: np.flatnonzero(block.holds(self.rest_m)) for block in row.blocks}

    def nodes(self, state: newton.State) -> NDArray[np.float64]:
        """World positions of the nodes in a state [m], shape [node_count, 3]; kept in single precision."""
        elastic = state.particle_q.numpy()[self.particles].astype(np.float64)
        rigid = [solid.moved(state, grid) for solid, grid in zip(self._solids, self._grids, strict=True)]
        return np.concatenate([elastic, *rigid])

    def block_nodes(self, name: str) -> NDArray[np.intp]:
        """Rows of `nodes` that belong to a body; those on a bonded face belong to both, shape [block_node_count]."""
        return self._rows[name]

    def block_particles(self, name: str) -> NDArray[np.intp]:
        """Particles in the model that belong to a body, those on a bonded face to both; a rigid block has no others."""
        rows = self._rows[name]
        return self.particles.start + rows[rows < self.particles.stop - self.particles.start]

    def rigid_sizes_m(self) -> dict[str, NDArray[np.float64]]:
        """Edges of each rigid block along x, y and z [m], shape [3]."""
        return {solid.block.body.name: solid.block.high_m - solid.block.low_m for solid in self._solids}

    def track(self, points_m: ArrayLike) -> Callable[[newton.State], NDArray[np.float64]]:
        """Reader of arbitrary material points, exact for the elements: linear in each tetrahedron.

        Args:
            points_m: World positions at the start [m], shape [point_count, 3].

        Returns:
            Function of a state that returns where the points are in it [m], shape [point_count, 3].

        Raises:
            ShapeError: A point lies outside the free material.
        """
        points = self._row.checked(np.asarray(points_m, dtype=np.float64))
        inside = [(solid, solid.block.holds(points)) for solid in self._solids]
        corners, weights = self._mesh.weights(points)

        def read(state: newton.State) -> NDArray[np.float64]:
            particles = state.particle_q.numpy()[self.particles].astype(np.float64)
            positions = np.einsum("pk,pki->pi", weights, particles[corners])
            for solid, rows in inside:
                positions[rows] = solid.moved(state, points[rows])
            return positions

        return read


def add_soft(
    builder: newton.ModelBuilder,
    bodies: Sequence[SoftBody],
    *,
    glued: Mapping[str, Sequence[RigidAttachment]],
    indices: Mapping[str, int],
    cell_m: float = CELL_M,
    damping_s: float = 0.0,
    contact_radius_m: float = CONTACT_RADIUS_M,
    rigid_ratio: float = RIGID_RATIO,
) -> SoftPartNewton:
    """Add a soft body, or a row of soft bodies bonded face to face.

    Nodes in a grip have no mass and are put where the grip is, so they are exact to single precision. What the others
    collide with is up to `SurfaceContacts`; rigid blocks collide with nothing before `add_block_shapes`. Call
    `builder.color` before finalizing.

    Args:
        builder: Model in the making; it has the rigid bodies already.
        bodies: One body, or all bodies of a row in any order.
        glued: What is glued to rigid bodies, by name of the soft body; only the two ends of the row may be.
        indices: Index of each rigid body in the model, by its name; of those that grip the row and move.
        cell_m: Largest edge of a cell of five tetrahedra [m].
        damping_s: Viscous part of the material's stress: twice the shear modulus, times this, times the rate of
            Green's strain. The solver's implicit Euler step acts as if its length were added to this.
        contact_radius_m: How far from a node something that touches it is held [m].
        rigid_ratio: A block whose Young's modulus is this many times that of the softest one of its row is a rigid
            body, if it is in no grip; infinity makes all elastic.

    Raises:
        UnsupportedSceneError: The bodies do not form a row that is gripped at its ends; see `SoftRow.of`.
    """
    row = SoftRow.of(bodies, glued)
    softest = min(block.body.young_modulus_pa for block in row.blocks)
    stiff = [
        block
        for block in row.blocks
        if block.body.young_modulus_pa >= rigid_ratio * softest and not glued.get(block.body.name)
    ]
    mesh = _Mesh.of(row, stiff, cell_m)
    start = builder.particle_count
    pins = _add_particles(builder, row, mesh, indices, contact_radius_m)
    materials = [lame_constants(block.body) for block in row.blocks]
    for corners, block in zip((start + mesh.tetrahedra).tolist(), mesh.blocks.tolist(), strict=True):
        mu, lame = materials[block]
        # Newton's viscous stress is 4 k_damp times the rate of Green's strain.
        builder.add_tetrahedron(*corners, k_mu=mu, k_lambda=lame, k_damp=0.5 * mu * damping_s)
    for corners in (start + mesh.surface()).tolist():
        # For contact only: a membrane without stiffness.
        builder.add_triangle(*corners, tri_ke=0.0, tri_ka=0.0, tri_kd=0.0, tri_drag=0.0, tri_lift=0.0)
    rigid = {block.body.name: _add_rigid(builder, block, row.axis, start, mesh.points_m) for block in stiff}
    return SoftPartNewton(row, mesh, start=start, pins=pins, rigid=rigid, cell_m=cell_m)


def add_block_shapes(
    builder: newton.ModelBuilder, part: SoftPartNewton, *, contact_radius_m: float = CONTACT_RADIUS_M
) -> dict[str, list[int]]:
    """Give the rigid blocks of a row shapes to collide with; they have none otherwise.

    Args:
        builder: Model in the making.
        part: The row.
        contact_radius_m: Thickness of the layer around a block that collides, as that around the nodes [m].

    Returns:
        Indices of the shapes in the model, by name of the block.
    """
    config = newton.ModelBuilder.ShapeConfig(density=0.0, margin=contact_radius_m)
    shapes = {}
    for name, size_m in part.rigid_sizes_m().items():
        x, y, z = (0.5 * size_m).tolist()
        shapes[name] = [builder.add_shape_box(part.rigid[name], hx=x, hy=y, hz=z, label=name, cfg=config)]
    return shapes


def _add_particles(
    builder: newton.ModelBuilder, row: SoftRow, mesh: _Mesh, indices: Mapping[str, int], contact_radius_m: float
) -> list[Pin]:
    """Add the nodes of a mesh; those that moving bodies hold are returned as pins."""
    start = builder.particle_count
    masses = mesh.masses_kg([block.density_kg_per_m3 for block in row.blocks])
    flags = np.full(len(masses), int(newton.ParticleFlags.ACTIVE))
    pins: list[Pin] = []
    for glue, nodes in row.gripped(mesh.points_m):
        masses[nodes], flags[nodes] = 0.0, 0
        if glue.motion is Motion.KINEMATIC:
            places = glue.pose.to_body(mesh.points_m[nodes]).tolist()
            pins.extend(
                Pin(particle=start + int(node), body=indices[glue.body], place_m=(x, y, z))
                for node, (x, y, z) in zip(nodes, places, strict=True)
            )
    builder.add_particles(
        pos=[wp.vec3(*point) for point in mesh.points_m],
        vel=[wp.vec3(0.0, 0.0, 0.0)] * len(masses),
        mass=masses.tolist(),
        radius=[contact_radius_m] * len(masses),
        flags=flags.tolist(),
    )
    return pins


def _add_rigid(builder: newton.ModelBuilder, block: Block, axis: int, start: int, points_m: NDArray[np.float64]) -> int:
    """Add a block as a rigid body and bond the nodes on its two faces to it; its index."""
    size_m = block.high_m - block.low_m
    x, y, z = size_m.tolist()
    _, inertia = mass_properties(Box(size_m=(x, y, z)), block.body.mass_kg)
    body = builder.add_body(
        xform=wp.transform(wp.vec3(*block.centre_m), wp.quat_identity()),
        mass=block.body.mass_kg,
        inertia=wp.mat33(inertia),
        lock_inertia=True,
        label=block.body.name,
    )
    for face_m in (block.low_m[axis], block.high_m[axis]):
        for node in np.flatnonzero(np.abs(points_m[:, axis] - face_m) < TOLERANCE_M):
            place = wp.vec3(*(points_m[node] - block.centre_m))
            builder.add_attachment_particle_body(start + int(node), body, body_point=place, stiffness=inf)
    return body


# --- geometry --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Mesh:
    """Tetrahedra of the elastic blocks of a row.

    Attributes:
        points_m: Nodes at the start [m], shape [node_count, 3].
        tetrahedra: Four nodes each, positively oriented, shape [tetrahedron_count, 4].
        volumes_m3: Their volumes [m^3], shape [tetrahedron_count].
        blocks: Which block of the row each is part of, shape [tetrahedron_count].
    """

    points_m: NDArray[np.float64]
    tetrahedra: NDArray[np.intp]
    volumes_m3: NDArray[np.float64]
    blocks: NDArray[np.intp]

    @classmethod
    def of(cls, row: SoftRow, rigid: Sequence[Block], cell_m: float) -> _Mesh:
        """Mesh of all blocks but the rigid ones, in one piece as far as they are bonded to each other."""
        points, tetrahedra, blocks, count = [], [], [], 0
        for is_rigid, group in groupby(enumerate(row.blocks), key=lambda item: item[1] in rigid):
            if is_rigid:
                continue
            members = list(group)
            lines = _lines_m([block for _, block in members], row.axis, cell_m)
            corners = _tetrahedra([len(line) for line in lines])
            points.append(_grid_m(lines))
            tetrahedra.append(count + corners)
            count += len(points[-1])
            middles = points[-1][corners].mean(axis=1)
            owner = np.zeros(len(corners), dtype=np.intp)
            for index, block in members:
                owner[block.holds(middles)] = index
            blocks.append(owner)
        all_points, all_tetrahedra = np.concatenate(points), np.concatenate(tetrahedra)
        volumes = np.linalg.det(all_points[all_tetrahedra[:, 1:]] - all_points[all_tetrahedra[:, :1]]) / 6.0
        flipped = volumes < 0.0
        all_tetrahedra[flipped] = all_tetrahedra[flipped][:, [1, 0, 2, 3]]
        return cls(
            points_m=all_points,
            tetrahedra=all_tetrahedra,
            volumes_m3=np.abs(volumes),
            blocks=np.concatenate(blocks),
        )

    def masses_kg(self, densities_kg_per_m3: Sequence[float]) -> NDArray[np.float64]:
        """A quarter of each tetrahedron's mass at each of its nodes [kg], shape [node_count]."""
        shares = 0.25 * self.volumes_m3 * np.asarray(densities_kg_per_m3)[self.blocks]
        masses: NDArray[np.float64] = np.zeros(len(self.points_m))
        np.add.at(masses, self.tetrahedra, shares[:, None])
        return masses

    def surface(self) -> NDArray[np.intp]:
        """Triangles that bound the mesh, seen from outside, shape [triangle_count, 3]."""
        faces = self.tetrahedra[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
        _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        return faces[first[count == 1]]

    def weights(self, points_m: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Four nodes and their barycentric weights for each point [m]; both of shape [point_count, 4]."""
        corner = self.points_m[self.tetrahedra[:, 0]]
        inverse = np.linalg.inv((self.points_m[self.tetrahedra[:, 1:]] - corner[:, None]).transpose(0, 2, 1))
        later = np.einsum("tij,ptj->pti", inverse, points_m[:, None] - corner)
        weights = np.concatenate([1.0 - later.sum(axis=-1, keepdims=True), later], axis=-1)
        # On shared faces, and a hair outside the surface, the one that it is deepest inside.
        best = np.argmax(weights.min(axis=-1), axis=1)
        return self.tetrahedra[best], weights[np.arange(len(points_m)), best]


class _Solid:
    """A block that is a rigid body, at rest in the world's axes.

    Args:
        block: The block.
        body: Its index in the model.
    """

    def __init__(self, block: Block, body: int) -> None:
        self.block = block
        self._body = body

    def moved(self, state: newton.State, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where points that were there at the start [m] are in a state [m], both of shape [point_count, 3]."""
        pose = state.body_q.numpy()[self._body].astype(np.float64)
        moved: NDArray[np.float64] = Rotation.from_quat(pose[3:]).apply(points_m - self.block.centre_m) + pose[:3]
        return moved


def _lines_m(blocks: Sequence[Block], axis: int, cell_m: float) -> list[NDArray[np.float64]]:
    """Grid lines along x, y and z [m] of blocks that join along an axis; planes between blocks are among them."""
    lines = [_line_m(blocks[0].low_m[i], blocks[0].high_m[i], cell_m) for i in range(3)]
    for block in blocks[1:]:
        lines[axis] = np.append(lines[axis], _line_m(block.low_m[axis], block.high_m[axis], cell_m)[1:])
    return lines


def _line_m(low_m: float, high_m: float, cell_m: float) -> NDArray[np.float64]:
    return np.linspace(low_m, high_m, max(1, ceil((high_m - low_m) / cell_m - 1e-6)) + 1)


def _grid_m(lines_m: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.stack(np.meshgrid(*lines_m, indexing="ij"), axis=-1).reshape(-1, 3)


def _tetrahedra(counts: Sequence[int]) -> NDArray[np.intp]:
    """Five tetrahedra in each cell of a grid with that many lines, shape [tetrahedron_count, 4]."""
    cells = np.array(list(product(*(range(count - 1) for count in counts))))
    mirrored = (cells % 2 == 1)[:, None, None]
    corners = cells[:, None, None] + np.where(mirrored, 1 - FIVE_TETRAHEDRA, FIVE_TETRAHEDRA)
    return np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), tuple(counts)).reshape(-1, 4)
