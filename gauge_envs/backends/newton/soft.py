"""Soft bodies for Newton's VBD: boxes of isotropic material, alone or bonded in a soft row, as linear tetrahedra.

Bonded boxes share one mesh. Each cell of a regular grid is divided into five tetrahedra, one in the middle and four at
corners, mirrored from cell to cell. Of the usual divisions this is the least stiff for its number of elements. Linear
tetrahedra lock in bending and torsion: with cells of a quarter of the width, a clamped bar is 1 % too stiff in tension,
13 to 15 % in shear and 28 % in torsion. These errors fall with the square of the cell size.

VBD would need a hundred times the steps to move a heavy stiff block on a light soft one. A block that is much stiffer
than the softest of its soft row is therefore a rigid body, to which the elastic blocks are bonded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf

import newton
import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends.newton.pins import Pin
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.backends.shared.soft_rows import (
    TOLERANCE_M,
    Block,
    SoftRow,
    TetrahedralMesh,
    grid_lines_m,
    grid_points_m,
    lame_constants,
)
from gauge_envs.scene import Box, Motion, SoftBody
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.meshes import mass_properties

CELL_M = 0.0125
"""Largest edge of a cell [m]: a quarter of the width of the benchmark's foam."""

CONTACT_RADIUS_M = 0.001
"""Thickness of the layer around the colliding surface [m]. A cube as wide as the foam pushes the nodes at its edges
sideways: with half this thickness they pass its lower face, with this thickness they stay below it."""

RIGID_RATIO = 50.0
"""Ratio of stiffness to the softest block of a soft row from which a block is rigid; the row then bends less by the
inverse of the ratio."""


class SoftPartNewton:
    """One soft body, or one soft row, of a Newton model.

    Material in a grip moves rigidly and is not simulated: the mesh spans the free material and has its mass.

    Attributes:
        name: Name of the first body of the soft row.
        names: Names of the bodies, in their order along the row.
        rest_m: World positions of the nodes at the start [m], shape [node_count, 3]: the nodes of the mesh, then a grid
            of points for each rigid block, whose faces coincide with nodes of the mesh.
        particles: Particles of the mesh in the model.
        pins: Particles that kinematic bodies hold, for `StepperVBD`.
        rigid: Model index of each rigid block, by name.
    """

    def __init__(
        self,
        soft_row: SoftRow,
        mesh: TetrahedralMesh,
        *,
        start: int,
        pins: Sequence[Pin],
        rigid: Mapping[str, int],
        cell_m: float,
    ) -> None:
        self.name = soft_row.blocks[0].body.name
        self.names = tuple(block.body.name for block in soft_row.blocks)
        self.particles = slice(start, start + len(mesh.points_m))
        self.pins = tuple(pins)
        self.rigid = dict(rigid)
        self._soft_row = soft_row
        self._mesh = mesh
        self._solids = [_Solid(block, rigid[block.body.name]) for block in soft_row.blocks if block.body.name in rigid]
        self._grids = [grid_points_m(grid_lines_m([solid.block], 0, cell_m)) for solid in self._solids]
        self.rest_m = np.concatenate([mesh.points_m, *self._grids])
        self._node_indices = {block.body.name: np.flatnonzero(block.holds(self.rest_m)) for block in soft_row.blocks}

    def nodes(self, state: newton.State) -> NDArray[np.float64]:
        """Return the world positions of the nodes in a state [m], shape [node_count, 3], in single precision."""
        elastic = state.particle_q.numpy()[self.particles].astype(np.float64)
        rigid = [solid.moved(state, grid) for solid, grid in zip(self._solids, self._grids, strict=True)]
        return np.concatenate([elastic, *rigid])

    def block_nodes(self, name: str) -> NDArray[np.intp]:
        """Return indices into `nodes` of a body's nodes, shape [block_node_count]; bonded faces belong to both."""
        return self._node_indices[name]

    def block_particles(self, name: str) -> NDArray[np.intp]:
        """Return the model's particles of a body; bonded faces belong to both, and a rigid block has only these."""
        nodes = self._node_indices[name]
        return self.particles.start + nodes[nodes < self.particles.stop - self.particles.start]

    def rigid_sizes_m(self) -> dict[str, NDArray[np.float64]]:
        """Return the edges of each rigid block along x, y and z [m], shape [3], by name."""
        return {solid.block.body.name: solid.block.high_m - solid.block.low_m for solid in self._solids}

    def track(self, points_m: ArrayLike) -> Callable[[newton.State], NDArray[np.float64]]:
        """Return a reader of material points, which interpolates linearly in each tetrahedron, as the elements do.

        Args:
            points_m: World positions at the start [m], shape [point_count, 3].

        Returns:
            Function of a state that returns the positions of the points [m], shape [point_count, 3].
        """
        points = self._soft_row.checked(np.asarray(points_m, dtype=np.float64))
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
    attachments: Mapping[str, Sequence[RigidAttachment]],
    indices: Mapping[str, int],
    cell_m: float = CELL_M,
    damping_s: float = 0.0,
    contact_radius_m: float = CONTACT_RADIUS_M,
    rigid_ratio: float = RIGID_RATIO,
) -> SoftPartNewton:
    """Add a soft body or a soft row.

    Nodes in a grip have no mass and are placed on the grip, so they are exact in single precision. `SurfaceContacts`
    determines the contacts of the other nodes. Rigid blocks have no contacts before `add_block_shapes`. Call
    `builder.color` before finalizing.

    Args:
        builder: Model builder that contains the rigid bodies.
        bodies: One body, or all bodies of a soft row in any order.
        attachments: Attachments to rigid bodies, by name of the soft body; only the row's ends may be attached.
        indices: Model index of each kinematic body that grips the row, by name.
        cell_m: Largest edge of a cell of five tetrahedra [m].
        damping_s: Viscosity [s]: the viscous stress is twice the shear modulus, times this, times the rate of Green's
            strain. The implicit Euler step of the solver acts as if the time step were added.
        contact_radius_m: Distance from a node at which contact starts [m].
        rigid_ratio: A block outside grips is rigid if its Young's modulus is at least this many times that of the
            softest block of its row; with infinity all blocks are elastic.
    """
    soft_row = SoftRow.of(bodies, attachments)
    softest = min(block.body.young_modulus_pa for block in soft_row.blocks)
    stiff = [
        block
        for block in soft_row.blocks
        if block.body.young_modulus_pa >= rigid_ratio * softest and not attachments.get(block.body.name)
    ]
    mesh = TetrahedralMesh.of(soft_row, stiff, cell_m)
    start = builder.particle_count
    pins = _add_particles(builder, soft_row, mesh, indices, contact_radius_m)
    materials = [lame_constants(block.body) for block in soft_row.blocks]
    for corners, block in zip((start + mesh.tetrahedra).tolist(), mesh.blocks.tolist(), strict=True):
        mu, lame = materials[block]
        # Newton's viscous stress is 4 k_damp times the rate of Green's strain.
        builder.add_tetrahedron(*corners, k_mu=mu, k_lambda=lame, k_damp=0.5 * mu * damping_s)
    for corners in (start + mesh.surface()).tolist():
        # A membrane without stiffness, for contacts only.
        builder.add_triangle(*corners, tri_ke=0.0, tri_ka=0.0, tri_kd=0.0, tri_drag=0.0, tri_lift=0.0)
    rigid = {block.body.name: _add_rigid(builder, block, soft_row.axis, start, mesh.points_m) for block in stiff}
    return SoftPartNewton(soft_row, mesh, start=start, pins=pins, rigid=rigid, cell_m=cell_m)


def add_block_shapes(
    builder: newton.ModelBuilder, part: SoftPartNewton, *, contact_radius_m: float = CONTACT_RADIUS_M
) -> dict[str, list[int]]:
    """Add collision shapes for the rigid blocks of a soft row.

    Args:
        builder: Model builder.
        part: The soft row.
        contact_radius_m: Thickness of the colliding layer around a block, as around the nodes [m].

    Returns:
        Model indices of the shapes, by name of the block.
    """
    config = newton.ModelBuilder.ShapeConfig(density=0.0, margin=contact_radius_m)
    shapes = {}
    for name, size_m in part.rigid_sizes_m().items():
        x, y, z = (0.5 * size_m).tolist()
        shapes[name] = [builder.add_shape_box(part.rigid[name], hx=x, hy=y, hz=z, label=name, cfg=config)]
    return shapes


def _add_particles(
    builder: newton.ModelBuilder,
    soft_row: SoftRow,
    mesh: TetrahedralMesh,
    indices: Mapping[str, int],
    contact_radius_m: float,
) -> list[Pin]:
    """Add the nodes of a mesh and return pins for those that kinematic bodies hold."""
    start = builder.particle_count
    masses = mesh.masses_kg([block.density_kg_per_m3 for block in soft_row.blocks])
    flags = np.full(len(masses), int(newton.ParticleFlags.ACTIVE))
    pins: list[Pin] = []
    for attachment, nodes in soft_row.gripped(mesh.points_m):
        masses[nodes], flags[nodes] = 0.0, 0
        if attachment.motion is Motion.KINEMATIC:
            places = attachment.pose.to_body(mesh.points_m[nodes]).tolist()
            pins.extend(
                Pin(particle=start + int(node), body=indices[attachment.body], place_m=(x, y, z))
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
    """Add a block as a rigid body, bond the nodes on its two faces to it, and return its index."""
    size_m = block.high_m - block.low_m
    _, inertia = mass_properties(Box(size_m=vector(size_m)), block.body.mass_kg)
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
        """Return the positions in a state of points given at the start [m], both of shape [point_count, 3]."""
        pose = state.body_q.numpy()[self._body].astype(np.float64)
        moved: NDArray[np.float64] = Rotation.from_quat(pose[3:]).apply(points_m - self.block.centre_m) + pose[:3]
        return moved
