"""Soft bodies in MuJoCo: boxes of isotropic material, alone or bonded in a soft row, as quadratic finite elements.

A soft row is one flex. Its elements ("cells" in MuJoCo) are corotational 27-node boxes with linear elasticity; the
nodes are point bodies with three slide joints. Linear elements and tetrahedra of the same cost are up to 38 % too stiff
in torsion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.backends.mujoco.flex import (
    DAMPING_S,
    FlexPart,
    Points,
    free_joint_views,
    make_firm,
    rotation_matrix,
    slide_addresses,
)
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.backends.shared.cells import grid_points
from gauge_envs.backends.shared.soft_rows import TOLERANCE_M, Block, SoftRow
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Motion, SoftBody
from gauge_envs.scene.geometry import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

SINGLE_CELLS = (4, 2)
"""Default cells along and across a single body: torsion of a 1:3.5 bar is within 3 % of theory, shear within 3 % of a
finer mesh."""

BONDED_CELLS = (2, 1)
"""Default cells along and across each body of a soft row; twice as many make its swing 1 % slower at four times the
cost."""

LAYER_LIMIT = 12
"""Largest number of layers of cells in the longest body of a soft row whose bodies are not equally long."""

POINT_SPACING_M = 0.0125
"""Largest distance between neighbouring points of the colliding surface and of `nodes` [m]."""

SKIN_M = 1e-4
"""Thickness of the layer around the colliding surface [m]. Bodies touch the foam earlier by it: at 0.5 mm, a cube
pushes with 0.6 N too much. At 0.01 mm, a row of blocks is thrown off the edge that it touches."""

CONTACT_TIME_S = 0.0025
"""Time constant of contacts [s]; two time steps where these are longer, as `refsafe` does not raise it for a flex."""


class Grip:
    """The nodes of a soft body that move with a driven body: heavy point bodies, written before each interval.

    As points of the driven body they would double the cost of a step. MuJoCo assembles the stiffness of a flex node by
    node only if every node is fixed or has three slide joints along the world axes. Each node is as heavy as a
    driven body, so that the foam does not move it.

    Args:
        body: Name of the driven body.
        names: Names of the bodies of the nodes.
    """

    def __init__(self, body: str, names: Sequence[str]) -> None:
        self.body, self.names = body, tuple(names)

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Look up the bodies in a compiled model."""
        driven = model.body(self.body)
        self._pose, self._velocity = free_joint_views(model, data, self.body)
        self._force = data.xfrc_applied[driven.id]
        self._mass_kg = float(driven.mass[0])
        self._nodes = np.array([model.body(name).id for name in self.names])
        self._addresses, self._freedoms = slide_addresses(model, self._nodes)
        self._rest_m = model.body_pos[self._nodes]
        self._masses_kg = model.body_mass[self._nodes, None]
        # Positions of the nodes in the frame of the driven body.
        self._local_m = (self._rest_m - driven.pos) @ rotation_matrix(driven.quat)
        self._data = data

    def follow(self) -> None:
        """Write position, velocity and force of the nodes from those that were written for the driven body.

        A point at the arm r of a rigid body has the velocity v + w x r and the acceleration a + b x r + w x (w x r).
        """
        rotation = rotation_matrix(self._pose[3:])
        arms_m = self._local_m @ rotation.T
        # MuJoCo keeps a free joint's angular velocity in the body frame.
        spin = rotation @ self._velocity[3:]
        turning = np.cross(spin, arms_m)
        # The mass and all moments of inertia of a driven body are the same number.
        acceleration = self._force / self._mass_kg
        node_acceleration = (
            acceleration[:3]
            + np.cross(acceleration[3:], arms_m)
            + np.cross(spin, turning)
        )
        self._data.qpos[self._addresses] = self._pose[:3] + arms_m - self._rest_m
        self._data.qvel[self._freedoms] = self._velocity[:3] + turning
        self._data.xfrc_applied[self._nodes, :3] = self._masses_kg * node_acceleration


class SoftPartMuJoCo(FlexPart):
    """One soft body, or one soft row, of a MuJoCo model.

    Material in a grip moves rigidly and is not simulated: the elements span the free material and have its mass.
    `nodes` and `track` read the free material only.

    Attributes:
        names: Names of the bodies, in their order along the soft row.
        grips: Nodes that move with driven bodies.
    """

    def __init__(
        self,
        flex: mujoco.MjsFlex,
        lattice: _Lattice,
        soft_row: SoftRow,
        points: Points,
        layers: Sequence[int],
        grips: Sequence[Grip],
    ) -> None:
        # The nodes are a regular grid of points, surface included.
        super().__init__(flex, lattice.grid_m(lattice.subdivisions), points)
        self.names, self.grips = soft_row.names, tuple(grips)
        self._lattice = lattice
        self._soft_row = soft_row
        self._layers = tuple(layers)
        self._grid = lattice.weights(self.rest_m)
        self.node_indices = soft_row.nodes_of(self.rest_m)

    def complete(self, model: mujoco.MjModel) -> None:
        """Write the stiffness of each cell's material."""
        cells = self._lattice.cells
        start = int(model.flex_stiffnessadr[self.flex.id])
        matrices = model.flex_stiffness[
            start : start + np.prod(cells) * 81 * 81
        ].reshape(*cells, -1)
        along = np.moveaxis(matrices, self._lattice.axis, 0)
        first = 0
        for block, count in zip(self._soft_row.blocks, self._layers, strict=True):
            along[first : first + count] = _cell_stiffness(
                self._lattice.cell_m, block.body
            )
            first += count
        # Recompute the constants that MuJoCo derives from the stiffness.
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Look up the joints of all nodes."""
        super().bind(model, data)
        for grip in self.grips:
            grip.bind(model, data)

    def nodes(self) -> FloatArray:
        """Return the current world positions of the grid of points [m], shape [node_count, 3]."""
        return self._grid @ self.points.positions()

    def track(self, points_m: ArrayLike) -> Callable[[], FloatArray]:
        """Return a reader of material points by the shape functions of the elements; see `Simulation.track`."""
        points_m = np.asarray(points_m, dtype=np.float64)
        weights = self._lattice.weights(self._soft_row.checked(points_m))
        return lambda: weights @ self.points.positions()


class _Lattice:
    """Box-shaped lattice of 27-node cells, aligned with the world axes.

    Attributes:
        cells: Number of cells along x, y, z.
        axis: Index of the world axis of the soft row.
        cell_m: Edge lengths of a cell [m], shape [3].
        subdivisions: Intervals of the point grid in one cell along x, y, z.
        rest_m: Positions of the element nodes [m], z fastest, shape [lattice_node_count, 3].
    """

    def __init__(
        self,
        low_m: FloatArray,
        high_m: FloatArray,
        cells: tuple[int, ...],
        axis: int,
    ) -> None:
        self.cells = cells
        self.axis = axis
        self._low_m = low_m
        self.cell_m = (high_m - low_m) / cells
        self.subdivisions = tuple(
            max(2, ceil(edge / POINT_SPACING_M - 1e-6)) for edge in self.cell_m
        )
        self.shape = tuple(2 * count + 1 for count in cells)
        self.rest_m = self.grid_m((2, 2, 2))

    def grid_m(self, subdivisions: tuple[int, ...]) -> FloatArray:
        """Return a regular grid of positions [m], z fastest, with the given intervals in each cell."""
        steps = [
            np.arange(n * part + 1) / part
            for n, part in zip(self.cells, subdivisions, strict=True)
        ]
        return self._low_m + self.cell_m * grid_points(*steps)

    def node_masses(self, cell_kg: FloatArray) -> FloatArray:
        """Return the masses of the nodes [kg], z fastest, by Simpson's rule as in MuJoCo.

        Args:
            cell_kg: Mass of one cell in each layer along the soft row [kg], shape [cells[axis]].
        """
        masses = np.zeros(self.shape)
        simpson = np.array([1.0, 4.0, 1.0]) / 6.0
        share = np.einsum("i,j,k->ijk", simpson, simpson, simpson)
        for cell in np.ndindex(*self.cells):
            masses[tuple(slice(2 * index, 2 * index + 3) for index in cell)] += (
                cell_kg[cell[self.axis]] * share
            )
        return masses.ravel()

    def weights(self, points_m: FloatArray) -> csr_matrix:
        """Return the matrix from node positions to material points, shape [point_count, lattice_node_count]."""
        from scipy.sparse import csr_matrix

        places = (points_m - self._low_m) / self.cell_m
        cells = np.clip(np.floor(places).astype(int), 0, np.array(self.cells) - 1)
        x = places - cells
        # Quadratic Lagrange polynomials with nodes at 0, 1/2 and 1, shape [point_count, axis, 3].
        shapes = np.stack(
            [(2 * x - 1) * (x - 1), 4 * x * (1 - x), x * (2 * x - 1)], axis=-1
        )
        # The shape function of a node is the product of those along x, y and z.
        values = np.einsum("pi,pj,pk->pijk", *np.moveaxis(shapes, 1, 0)).reshape(-1, 27)
        steps = np.stack(np.unravel_index(np.arange(27), (3, 3, 3)))
        nodes = np.ravel_multi_index(
            tuple(2 * cells.T[:, :, None] + steps[:, None]), self.shape
        )
        offsets = 27 * np.arange(len(points_m) + 1)
        return csr_matrix(
            (values.ravel(), nodes.ravel(), offsets),
            shape=(len(points_m), len(self.rest_m)),
        )


def add_soft(
    spec: mujoco.MjSpec,
    soft_row: SoftRow,
    *,
    grip_mass_kg: float,
    timestep_s: float,
    cell_m: float | None,
) -> SoftPartMuJoCo:
    """Add a soft body or a soft row without contacts.

    Args:
        spec: Editable model that contains the rigid bodies.
        soft_row: The soft row.
        grip_mass_kg: Mass of each node that moves with a driven body.
        timestep_s: Time step [s]; contacts have a time constant of two or more.
        cell_m: Largest edge of a cell [m]; None gives each body `LONE_CELLS` or `BONDED_CELLS` along and across.
    """
    axis, blocks = soft_row.axis, soft_row.blocks
    low_m, high_m = soft_row.low_m, soft_row.high_m
    each = _cells_of_a_block(blocks, axis, cell_m)
    layers = _layers_of_blocks(blocks, axis, each[axis])
    cells = list(each)
    cells[axis] = sum(layers)
    lattice = _Lattice(low_m, high_m, tuple(cells), axis)

    name = blocks[0].body.name
    flex = spec.worldbody.make_flex(
        name,
        type="grid",
        dim=3,
        dof="quadratic",
        cellcount=list(lattice.cells),
        count=[
            n * part + 1
            for n, part in zip(lattice.cells, lattice.subdivisions, strict=True)
        ],
        spacing=(lattice.cell_m / lattice.subdivisions).tolist(),
        pos=(0.5 * (low_m + high_m)).tolist(),
        radius=SKIN_M,
    )
    # `complete` writes the stiffness of each cell; these two values only make MuJoCo reserve the memory.
    flex.young = blocks[0].body.young_modulus_pa
    flex.poisson = blocks[0].body.poisson_ratio
    flex.damping = DAMPING_S
    contact_time_s = max(CONTACT_TIME_S, 2.0 * timestep_s)
    make_firm(flex, (contact_time_s, 1.0))

    densities = np.repeat([block.density_kg_per_m3 for block in blocks], layers)
    masses_kg = lattice.node_masses(densities * np.prod(lattice.cell_m))
    for node, mass in zip(flex.nodebody, masses_kg, strict=True):
        spec.body(node).mass = mass
    sections = np.moveaxis(
        np.arange(len(lattice.rest_m)).reshape(lattice.shape), axis, 0
    )
    attached: dict[int, RigidAttachment] = {}
    grips = []
    for side, attachment in soft_row.ends.items():
        section = sections[{"low": 0, "high": -1}[side]].ravel().tolist()
        if attachment.motion is Motion.FIXED:
            attached |= dict.fromkeys(section, attachment)
        else:
            grips.append(
                Grip(attachment.body, [flex.nodebody[index] for index in section])
            )
            for name in grips[-1].names:
                spec.body(name).mass, spec.body(name).gravcomp = grip_mass_kg, 1.0
        low_m, high_m = soft_row.beyond_m(side, attachment.region.depth_m)
        _add_gripped_material(spec, flex, attachment, low_m, high_m)
    points = Points(list(flex.nodebody), lattice.rest_m, attached)
    flex.nodebody, flex.node = points.carriers()
    points.delete_attached(spec)
    return SoftPartMuJoCo(flex, lattice, soft_row, points, layers, grips)


def _cells_of_a_block(
    blocks: Sequence[Block], axis: int, cell_m: float | None
) -> tuple[int, ...]:
    """Return the number of cells of each block along x, y and z."""
    if cell_m is None:
        along, across = SINGLE_CELLS if len(blocks) == 1 else BONDED_CELLS
        cells = [across] * 3
        cells[axis] = along
        return tuple(cells)
    # Blocks at the ends of a row lose material to the grips; the longest one decides.
    edges = np.max([block.high_m - block.low_m for block in blocks], axis=0)
    return tuple(max(1, ceil(edge / cell_m - 1e-6)) for edge in edges)


def _layers_of_blocks(
    blocks: Sequence[Block], axis: int, layer_count: int
) -> tuple[int, ...]:
    """Return the number of layers of cells of each block along the row; the cells of a row are all equally long.

    Args:
        blocks: Blocks of the row.
        axis: Index of the world axis of the row.
        layer_count: Desired number of layers of the longest block.
    """
    lengths = np.array([block.high_m[axis] - block.low_m[axis] for block in blocks])
    if np.ptp(lengths) <= TOLERANCE_M:
        return (layer_count,) * len(blocks)
    for count in range(layer_count, LAYER_LIMIT + 1):
        layers = np.rint(lengths / lengths.max() * count)
        # Where blocks meet, the sum of these errors counts.
        error_m = np.abs(np.cumsum(layers * lengths.sum() / layers.sum() - lengths))
        if layers.min() >= 1 and error_m.max() <= TOLERANCE_M:
            return tuple(int(layer) for layer in layers)
    raise UnsupportedSceneError(
        f"bonded soft bodies {[block.body.name for block in blocks]} have free lengths of "
        f"{', '.join(f'{1e3 * length:.4g}' for length in lengths)} mm: equal cells would need more than {LAYER_LIMIT} "
        "layers in the longest; make the lengths multiples of a longer one"
    )


def _add_gripped_material(
    spec: mujoco.MjSpec,
    flex: mujoco.MjsFlex,
    attachment: RigidAttachment,
    low_m: FloatArray,
    high_m: FloatArray,
) -> None:
    """Add a massless box without contacts that shows the material in a grip between two corners [m], shape [3]."""
    if not attachment.region.depth_m:
        return
    spec.body(attachment.body).add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(0.5 * (high_m - low_m)).tolist(),
        pos=attachment.pose.to_body(0.5 * (low_m + high_m)).tolist(),
        quat=attachment.pose.rotation.inv().as_quat(scalar_first=True).tolist(),
        rgba=flex.rgba,
        mass=0.0,
        contype=0,
        conaffinity=0,
    )


def _cell_stiffness(size_m: FloatArray, body: SoftBody) -> FloatArray:
    """Return the stiffness of one cell as MuJoCo stores it, shape [81 * 81], from a model of one cell."""
    spec = mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    flex = spec.worldbody.make_flex(
        "cell",
        type="grid",
        dim=3,
        dof="quadratic",
        cellcount=[1, 1, 1],
        count=[2, 2, 2],
        spacing=size_m.tolist(),
    )
    flex.young, flex.poisson = body.young_modulus_pa, body.poisson_ratio
    flex.damping = 1.0
    return spec.compile().flex_stiffness.copy()
