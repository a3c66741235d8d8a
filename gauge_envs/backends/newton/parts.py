"""Deformable bodies of a Newton model, and massless particles that are attached to kinematic bodies.

A cloth is a triangle mesh with a stable Neo-Hookean membrane and dihedral hinges. Soft bodies are boxes of isotropic
material, alone or bonded in a soft row, as linear tetrahedra; bonded boxes share one mesh.

VBD would need a hundred times the steps to move a heavy stiff block on a light soft one. A block that is much stiffer
than the softest of its soft row is therefore a rigid body, to which the elastic blocks are bonded.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from types import MappingProxyType
from typing import Any

import newton
import numpy as np
import warp as wp

from gauge_envs.backends.newton.fabrics import vbd_constants
from gauge_envs.backends.newton.kernels import carry, hold
from gauge_envs.backends.newton.settings import CLOTH_CELL_M, SOFT_CELL_M, SettingsVBD
from gauge_envs.backends.newton.stepper import TO_WARP, Stepper, rotated
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.backends.shared.cells import grid_points
from gauge_envs.backends.shared.cloth_grid import ClothGrid, attached_vertices
from gauge_envs.backends.shared.soft_rows import (
    TOLERANCE_M,
    Block,
    SoftRow,
    TetrahedralMesh,
    grid_lines_m,
    lame_constants,
)
from gauge_envs.errors import ParameterError
from gauge_envs.scene import Box, Cloth, Motion
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.geometry import FloatArray, IntArray, vector
from gauge_envs.scene.meshes import mass_properties

Reader = Callable[[Stepper], FloatArray]
"""Function of a stepper that returns the current positions of points in all worlds [m], shape [N, point_count, 3]."""


@dataclass(frozen=True, kw_only=True)
class PinNewton:
    """A massless particle that is attached to a kinematic body.

    Attributes:
        particle: Index of the particle in its world.
        body: Index of the kinematic body in its world.
        place_m: Position of the particle in the body's frame [m].
    """

    particle: int
    body: int
    place_m: tuple[float, float, float]


def pins_of(
    attachment: RigidAttachment,
    bodies: Mapping[str, int],
    particles: Iterable[int],
    points_m: FloatArray,
) -> Iterator[PinNewton]:
    """Yield the pins of attached particles, if their body is kinematic.

    Args:
        attachment: The attachment.
        bodies: Index of each kinematic body, by name.
        particles: Indices of the particles.
        points_m: Their positions at the start [m], shape [particle_count, 3].
    """
    if attachment.motion is Motion.KINEMATIC:
        for particle, (x, y, z) in zip(
            particles, attachment.pose.to_body(points_m).tolist(), strict=True
        ):
            yield PinNewton(
                particle=int(particle), body=bodies[attachment.body], place_m=(x, y, z)
            )


class PinnedParticles:
    """Pins in all worlds of a model on its device.

    Args:
        pins: The pins of a world.
        stepper: Stepper of the model.
    """

    def __init__(self, pins: Sequence[PinNewton], stepper: Stepper) -> None:
        model, world_count = stepper.model, stepper.world_count
        self._device = model.device
        self._count = world_count * len(pins)
        particles = [pin.particle for pin in pins]
        bodies = [pin.body for pin in pins]
        places_m = [pin.place_m for pin in pins] * world_count
        with wp.ScopedDevice(model.device):
            self._inputs = [
                wp.array(
                    stepper.in_worlds(particles, model.particle_count // world_count),
                    dtype=wp.int32,
                ),
                wp.array(
                    stepper.in_worlds(bodies, model.body_count // world_count),
                    dtype=wp.int32,
                ),
                wp.array(places_m, dtype=wp.vec3),
            ]

    def hold(self, body_q: wp.array, particle_q: wp.array) -> None:
        """Move the particles to their positions on bodies."""
        self._launch(hold, [body_q], [particle_q])

    def carry(
        self, state: newton.State, after: newton.State, timestep_s: float
    ) -> None:
        """Move the particles to their positions before a step, with the velocities to the positions after it."""
        outputs = [state.particle_q, state.particle_qd, state.mpm.particle_qd_grad]
        self._launch(
            carry, [state.body_q, after.body_q, after.body_qd, timestep_s], outputs
        )

    def _launch(
        self, kernel: wp.Kernel, inputs: list[Any], outputs: list[wp.array]
    ) -> None:
        if self._count:
            wp.launch(
                kernel,
                dim=self._count,
                inputs=[*self._inputs, *inputs],
                outputs=outputs,
                device=self._device,
            )


class PartNewton(ABC):
    """A deformable body or a soft row in a model.

    Attributes:
        rest_m: Positions of the nodes at the nominal start [m], shape [node_count, 3].
        pins: Particles that are attached to kinematic bodies.
        node_indices: Indices of each body's nodes among those of a soft row, by name; empty for a single body.
    """

    rest_m: FloatArray
    pins: tuple[PinNewton, ...] = ()
    node_indices: Mapping[str, IntArray] = MappingProxyType({})

    @abstractmethod
    def nodes(self, stepper: Stepper) -> FloatArray:
        """Return the current positions of the nodes in all worlds [m], shape [N, node_count, 3]."""

    def track(self, points_m: FloatArray) -> Reader | None:
        """Return a reader of material points, given by their start positions [m], or None to interpolate the nodes."""
        return None


class ParticlePart(PartNewton):
    """A deformable body or a soft row that consists of particles.

    Args:
        rest_m: Positions of the nodes at the nominal start [m], shape [node_count, 3].
        particles: Its particles in a world.
        pins: Particles that are attached to kinematic bodies.
    """

    def __init__(
        self, rest_m: FloatArray, particles: slice, pins: Sequence[PinNewton]
    ) -> None:
        self.rest_m = rest_m
        self.particles = particles
        self.pins = tuple(pins)

    def positions(self, stepper: Stepper) -> FloatArray:
        """Return the current positions of its particles [m], shape [N, particle_count, 3], in single precision."""
        return stepper.particles_m()[:, self.particles]

    def nodes(self, stepper: Stepper) -> FloatArray:
        """Return the positions of the particles, which are the nodes."""
        return self.positions(stepper)


class SoftRowPart(ParticlePart):
    """A soft body or a soft row as particles. Material in a grip moves rigidly.

    Args:
        soft_row: The soft row.
        rest_m: Positions of the nodes at the nominal start [m], shape [node_count, 3].
        particles: Its particles in a world.
        pins: Particles that are attached to kinematic bodies.

    Attributes:
        names: Names of the bodies, in their order along the row.
    """

    def __init__(
        self,
        soft_row: SoftRow,
        rest_m: FloatArray,
        particles: slice,
        pins: Sequence[PinNewton],
    ) -> None:
        super().__init__(rest_m, particles, pins)
        self._soft_row = soft_row
        self.names = soft_row.names
        self.node_indices = soft_row.nodes_of(rest_m)


# --- cloth -----------------------------------------------------------------------------------------------------------


HINGE_M = 1e-3
"""Edge of a square cell whose hinges have no stiffness in Newton: its normals are shorter than 1e-6 m^2."""


class ClothPartNewton(ParticlePart):
    """A cloth among the particles of a model, whose nodes are the vertices of its mesh.

    Args:
        grid: Its mesh.
        start: Its first particle in a world.
        pins: Vertices that are attached to kinematic bodies.
    """

    def __init__(self, grid: ClothGrid, start: int, pins: Sequence[PinNewton]) -> None:
        super().__init__(grid.rest_m, slice(start, start + len(grid.rest_m)), pins)
        self.grid = grid

    def at(self, states: FloatArray) -> FloatArray:
        """Return the positions of the vertices with given states of its frame [m], shape [N, vertex_count, 3].

        Args:
            states: States of the frame, shape [N, 13].
        """
        flat_m = np.pad(self.grid.plane_m, ((0, 0), (0, 1)))
        return states[:, None, :3] + rotated(states[:, None, TO_WARP], flat_m)


def add_cloth(
    builder: newton.ModelBuilder,
    cloth: Cloth,
    *,
    attachments: Sequence[RigidAttachment] = (),
    bodies: Mapping[str, int],
    settings: SettingsVBD,
) -> ClothPartNewton:
    """Add a cloth to a model builder; `SurfaceContacts` determines its contacts.

    `vbd_constants` gives its constants. A hinge of length l between strips of width h stores edge_ke l theta^2 / 2, and
    the fabric B h l (theta / h)^2 / 2, so `edge_ke` is B / h. Attached vertices have no mass and are placed on their
    body. They are exact in single precision: 0.06 micrometres within 1 m of the origin.

    Args:
        builder: Model builder that contains the rigid bodies.
        cloth: The cloth.
        attachments: Attached regions; a vertex in two regions belongs to the first.
        bodies: Model index of each kinematic body that the cloth is attached to, by name.
        settings: Size of the cells and damping.
    """
    grid = ClothGrid(cloth, settings.cell_m or CLOTH_CELL_M)
    attached = attached_vertices(grid, cloth, attachments)
    spacing_m = math.sqrt(math.prod(grid.cell_m))
    if spacing_m <= HINGE_M:
        raise ParameterError(
            f"Newton's hinges have no stiffness in the cells of {1e3 * spacing_m:.4g} mm of {cloth.name!r}: choose a "
            f"cell_m above {1e3 * HINGE_M:g} mm"
        )
    constants = vbd_constants(Fabric.of(cloth)).constants
    start, first_edge = len(builder.particle_q), len(builder.edge_indices)
    builder.add_cloth_mesh(
        pos=wp.vec3(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=wp.vec3(0.0, 0.0, 0.0),
        vertices=[wp.vec3(*point) for point in grid.rest_m],
        indices=grid.triangles.ravel().tolist(),
        density=cloth.areal_density_kg_per_m2,
        tri_ke=constants["tri_ke"],
        tri_ka=constants["tri_ka"],
        tri_kd=settings.stretch_damping_n_s_per_m,
        edge_ke=constants["edge_ke_times_mean_edge_length"] / spacing_m,
        edge_kd=settings.bend_damping_n_s,
        particle_radius=0.5 * cloth.thickness_m,
        label=cloth.name,
    )
    folds = np.array(builder.edge_indices[first_edge:]) - start
    stiffening = grid.fold_stiffening(folds[:, 2:], folds[:, :2], attached)
    for edge, factor in enumerate(stiffening.tolist(), first_edge):
        stiffness, damping = builder.edge_bending_properties[edge]
        builder.edge_bending_properties[edge] = factor * stiffness, damping
    masses = cloth.areal_density_kg_per_m2 * grid.vertex_areas_m2()
    masses[list(attached)] = 0.0
    builder.particle_mass[start : start + len(masses)] = masses.tolist()
    pins: list[PinNewton] = []
    for attachment in attachments:
        rows = np.array(
            [index for index, by in attached.items() if by is attachment], dtype=np.intp
        )
        pins += pins_of(attachment, bodies, start + rows, grid.rest_m[rows])
    return ClothPartNewton(grid, start, pins)


# --- soft bodies -----------------------------------------------------------------------------------------------------


class _RigidBlock:
    """A block that is a rigid body, at rest in the world's axes.

    Args:
        block: The block.
        body: Its index in the model.
        cell_m: Largest distance of neighbouring points of its grid [m].

    Attributes:
        grid_m: A grid of points in it at the start [m], shape [point_count, 3].
    """

    def __init__(self, block: Block, body: int, cell_m: float) -> None:
        self.block, self.body = block, body
        self.grid_m = grid_points(*grid_lines_m([block], 0, cell_m))

    def moved(self, stepper: Stepper, points_m: FloatArray) -> FloatArray:
        """Return the current positions of points in all worlds [m], given by their start, shape [N, point_count, 3]."""
        poses = stepper.poses()[:, self.body, None]
        from_centre_m = points_m - self.block.centre_m
        return poses[..., :3] + rotated(poses[..., 3:], from_centre_m)


class SoftPartNewton(SoftRowPart):
    """One soft body, or one soft row, of a Newton model.

    Material in a grip is not simulated: the mesh spans the free material and has its mass. The nodes are the nodes of
    the mesh, then a grid of points for each rigid block, whose faces coincide with nodes of the mesh.

    Args:
        soft_row: The soft row.
        mesh: Its tetrahedra.
        start: Its first particle.
        pins: Particles that are attached to kinematic bodies.
        solids: Its rigid blocks.
    """

    def __init__(
        self,
        soft_row: SoftRow,
        mesh: TetrahedralMesh,
        *,
        start: int,
        pins: Sequence[PinNewton],
        solids: Sequence[_RigidBlock],
    ) -> None:
        rest_m = np.concatenate([mesh.points_m, *(solid.grid_m for solid in solids)])
        super().__init__(
            soft_row, rest_m, slice(start, start + len(mesh.points_m)), pins
        )
        self._mesh, self._solids = mesh, solids

    def nodes(self, stepper: Stepper) -> FloatArray:
        """Return the positions of the particles and of the points in rigid blocks."""
        solids_m = [solid.moved(stepper, solid.grid_m) for solid in self._solids]
        return np.concatenate([self.positions(stepper), *solids_m], axis=1)

    def block_particles(self, name: str) -> IntArray:
        """Return the model's particles of a body; bonded faces belong to both, and a rigid block has no others."""
        nodes = self.node_indices[name]
        return (
            self.particles.start
            + nodes[nodes < self.particles.stop - self.particles.start]
        )

    def add_block_shapes(
        self, builder: newton.ModelBuilder, margin_m: float
    ) -> dict[str, list[int]]:
        """Add collision shapes for the rigid blocks to a builder, and return the model's indices by name of the block.

        Args:
            builder: Model builder.
            margin_m: Thickness of the colliding layer around a block, as around the nodes [m].
        """
        config = newton.ModelBuilder.ShapeConfig(density=0.0, margin=margin_m)
        shapes = {}
        for solid in self._solids:
            name, (x, y, z) = (
                solid.block.body.name,
                (0.5 * (solid.block.high_m - solid.block.low_m)).tolist(),
            )
            shapes[name] = [
                builder.add_shape_box(
                    solid.body, hx=x, hy=y, hz=z, label=name, cfg=config
                )
            ]
        return shapes

    def track(self, points_m: FloatArray) -> Reader:
        """Return a reader of material points, which interpolates linearly in each tetrahedron, as the elements do."""
        points = self._soft_row.checked(points_m)
        inside = [(solid, solid.block.contains(points)) for solid in self._solids]
        corners, weights = self._mesh.weights(points)

        def read(stepper: Stepper) -> FloatArray:
            particles_m = self.positions(stepper)[:, corners]
            positions = np.einsum("pk,npki->npi", weights, particles_m)
            for solid, rows in inside:
                positions[:, rows] = solid.moved(stepper, points[rows])
            return positions

        return read


def add_soft(
    builder: newton.ModelBuilder,
    soft_row: SoftRow,
    *,
    indices: Mapping[str, int],
    settings: SettingsVBD,
) -> SoftPartNewton:
    """Add a soft body or a soft row.

    Nodes in a grip have no mass and are placed on the grip, so they are exact in single precision. `SurfaceContacts`
    determines the contacts of the other nodes. Rigid blocks have no contacts before `add_block_shapes`. Call
    `builder.color` before finalizing. The implicit Euler step of the solver adds the time step to the effective time of
    the damping.

    Args:
        builder: Model builder that contains the rigid bodies.
        soft_row: The soft row.
        indices: Model index of each kinematic body that grips the row, by name.
        settings: Size of the cells, damping, radius of contact, and which blocks are rigid.
    """
    cell_m = settings.cell_m or SOFT_CELL_M
    softest = min(block.body.young_modulus_pa for block in soft_row.blocks)
    gripped = [soft_row.blocks[0 if side == "low" else -1] for side in soft_row.ends]
    stiff = [
        block
        for block in soft_row.blocks
        if block.body.young_modulus_pa >= settings.soft_rigid_ratio * softest
        and block not in gripped
    ]
    mesh = TetrahedralMesh.of(soft_row, stiff, cell_m)
    start = builder.particle_count
    masses = mesh.masses_kg([block.density_kg_per_m3 for block in soft_row.blocks])
    flags = np.full(len(masses), int(newton.ParticleFlags.ACTIVE))
    pins: list[PinNewton] = []
    for attachment, nodes in soft_row.gripped(mesh.points_m):
        masses[nodes], flags[nodes] = 0.0, 0
        pins += pins_of(attachment, indices, start + nodes, mesh.points_m[nodes])
    builder.add_particles(
        pos=[wp.vec3(*point) for point in mesh.points_m],
        vel=[wp.vec3(0.0, 0.0, 0.0)] * len(masses),
        mass=masses.tolist(),
        radius=[settings.soft_contact_radius_m] * len(masses),
        flags=flags.tolist(),
    )
    materials = [lame_constants(block.body) for block in soft_row.blocks]
    for corners, block in zip(
        (start + mesh.tetrahedra).tolist(), mesh.blocks.tolist(), strict=True
    ):
        mu, lame = materials[block]
        # Newton's viscous stress is 4 k_damp times the rate of Green's strain.
        builder.add_tetrahedron(
            *corners, k_mu=mu, k_lambda=lame, k_damp=0.5 * mu * settings.soft_damping_s
        )
    for corners in (start + mesh.surface()).tolist():
        # A membrane without stiffness, for contacts only.
        builder.add_triangle(
            *corners, tri_ke=0.0, tri_ka=0.0, tri_kd=0.0, tri_drag=0.0, tri_lift=0.0
        )
    solids = [
        _RigidBlock(
            block,
            _add_rigid(builder, block, soft_row.axis, start, mesh.points_m),
            cell_m,
        )
        for block in stiff
    ]
    return SoftPartNewton(soft_row, mesh, start=start, pins=pins, solids=solids)


def _add_rigid(
    builder: newton.ModelBuilder,
    block: Block,
    axis: int,
    start: int,
    points_m: FloatArray,
) -> int:
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
            builder.add_attachment_particle_body(
                start + int(node), body, body_point=place, stiffness=inf
            )
    return body
