"""Soft bodies for Newton's implicit material point method: boxes of particles on a grid, the pairing of the paper.

The grid limits how well this does. A velocity is linear within a voxel, and a gripped particle holds all nodes of its
voxel, so a voxel at a grip is rigid up to its far side. With the solver's default the stress of an elastic material
relaxes whenever a solve stops at its cap on iterations; here the strain is kept. Tetrahedra with vertex block descent
(`soft.py`) are closer to theory and much cheaper.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import newton
import numpy as np
import warp as wp
from newton.solvers import SolverImplicitMPM
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from gauge_envs.backends.newton.kernels import carry, hold
from gauge_envs.backends.newton.stepper import Stepper
from gauge_envs.backends.newton.vbd import Pin
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.backends.shared.soft_rows import SoftRow
from gauge_envs.scene import Motion, SoftBody

__all__ = [
    "LoopMPM",
    "MPMPart",
    "add_soft_mpm",
    "fitted_voxel_m",
]

GRIPPED_SIZE = 0.3
"""Size of a gripped point, which has no volume to fill, in terms of its cell."""

NEIGHBOURS = 24
"""Material points from which the place of another one is interpolated."""

VOXEL_RANGE = (0.85, 1.15)
"""Voxels between these multiples of the wanted one are tried by `fitted_voxel_m`."""


def fitted_voxel_m(
    bodies: Sequence[SoftBody],
    *,
    glued: Mapping[str, Sequence[RigidAttachment]],
    voxel_m: float,
    points_per_voxel_edge: int = 2,
) -> float:
    """Edge of a voxel [m], near a wanted one, that makes the rigid voxels at the grips end where the grips end.

    A voxel is centred at the world's origin, and a point in a grip holds its whole voxel. So the free length is that
    between two grid planes, which may be a voxel less than it should be.

    Raises:
        UnsupportedSceneError: The bodies do not form a row that is gripped at its ends; see `SoftRow.of`.
    """
    row = SoftRow.of(bodies, glued)
    low, high = row.low_m[row.axis], row.high_m[row.axis]
    candidates = voxel_m * np.linspace(*VOXEL_RANGE, 601)
    # The outermost gripped point sits half a spacing beyond the face.
    half = 0.5 * candidates / points_per_voxel_edge
    misses = np.zeros((2, len(candidates)))
    if "low" in row.ends:
        misses[0] = (np.ceil((low - half) / candidates - 0.5) + 0.5) * candidates - low
    if "high" in row.ends:
        misses[1] = high - (np.floor((high + half) / candidates - 0.5) + 0.5) * candidates
    return float(candidates[np.argmin(np.square(misses).sum(axis=0))])


class MPMPart:
    """One soft body, or several bonded in a row, as material points of a Newton model.

    Attributes:
        name: Name of the row's first body.
        names: Names of the bodies, in their order along the row.
        rest_m: World positions of the free material points at the start [m], shape [node_count, 3].
        particles: Its particles in the model; the free ones come first.
        pins: Points in the grip of a moving body, for `LoopMPM`.
    """

    def __init__(
        self,
        row: SoftRow,
        free_m: NDArray[np.float64],
        gripped_m: NDArray[np.float64],
        *,
        start: int,
        pins: Sequence[Pin],
    ) -> None:
        self.name = row.blocks[0].body.name
        self.names = tuple(block.body.name for block in row.blocks)
        self.rest_m = free_m
        self.particles = slice(start, start + len(free_m) + len(gripped_m))
        self.pins = tuple(pins)
        self._row = row
        self._points_m = np.concatenate([free_m, gripped_m])
        self._rows = {block.body.name: np.flatnonzero(block.holds(free_m)) for block in row.blocks}

    def nodes(self, state: newton.State) -> NDArray[np.float64]:
        """World positions of the free points in a state [m], shape [node_count, 3]; kept in single precision."""
        return state.particle_q.numpy()[self.particles][: len(self.rest_m)].astype(np.float64)

    def block_nodes(self, name: str) -> NDArray[np.intp]:
        """Rows of `nodes` that belong to a body, shape [block_node_count]."""
        return self._rows[name]

    def track(self, points_m: ArrayLike) -> Callable[[newton.State], NDArray[np.float64]]:
        """Reader of arbitrary points: weighted mean of the nearest ones, exact where these deform alike.

        Args:
            points_m: World positions at the start [m], shape [point_count, 3].

        Returns:
            Function of a state that returns where the points are in it [m], shape [point_count, 3].

        Raises:
            ShapeError: A point lies outside the free material.
        """
        points = self._row.checked(np.asarray(points_m, dtype=np.float64))
        nearest, weights = _linear_weights(self._points_m, points)

        def read(state: newton.State) -> NDArray[np.float64]:
            positions = state.particle_q.numpy()[self.particles].astype(np.float64)
            return np.asarray(np.einsum("pk,pki->pi", weights, positions[nearest]))

        return read


def _linear_weights(
    sources_m: NDArray[np.float64], points_m: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Moving least squares: for each point its nearest sources, and weights that reproduce linear functions.

    Returns:
        Rows of the sources and their weights, both of shape [point_count, NEIGHBOURS].
    """
    distance, nearest = cKDTree(sources_m).query(points_m, k=NEIGHBOURS)
    # Falls to 2 % at the farthest of the neighbours.
    near = np.exp(-4.0 * np.square(distance / distance[:, -1:]))
    offsets = sources_m[nearest] - points_m[:, None]
    basis = np.concatenate([np.ones_like(offsets[..., :1]), offsets / distance[:, -1:, None]], axis=-1)
    moments = np.einsum("pk,pki,pkj->pij", near, basis, basis)
    # The value at the point itself is the first coefficient.
    first = np.linalg.solve(moments, np.broadcast_to(np.eye(4)[:, :1], (len(points_m), 4, 1)))[..., 0]
    return nearest, near * np.einsum("pki,pi->pk", basis, first)


def add_soft_mpm(
    builder: newton.ModelBuilder,
    bodies: Sequence[SoftBody],
    *,
    glued: Mapping[str, Sequence[RigidAttachment]],
    indices: Mapping[str, int],
    spacing_m: float,
    damping_s: float = 0.0,
) -> MPMPart:
    """Add a soft body, or a row of soft bodies bonded face to face, as material points.

    `SolverImplicitMPM.register_custom_attributes` must have been called. Points in a grip have no mass, which to this
    solver means that they impose their velocity on the grid.

    Args:
        builder: Model in the making; it has the rigid bodies already.
        bodies: One body, or all bodies of a row in any order.
        glued: What is glued to rigid bodies, by name of the soft body; only the two ends of the row may be.
        indices: Index of each rigid body in the model, by its name; of those that grip the row and move.
        spacing_m: Largest distance between neighbouring points [m]; half a voxel gives 8 a voxel.
        damping_s: Relaxation time of the elastic stress, Newton's `mpm:damping`.

    Raises:
        UnsupportedSceneError: The bodies do not form a row that is gripped at its ends; see `SoftRow.of`.
    """
    row = SoftRow.of(bodies, glued)
    start = builder.particle_count
    free: list[NDArray[np.float64]] = []
    for block in row.blocks:
        points, cell_m = _points_m(block.low_m, block.high_m, spacing_m)
        _add_points(builder, points, cell_m, block.body, block.density_kg_per_m3, damping_s)
        free.append(points)
    gripped: list[NDArray[np.float64]] = [np.zeros((0, 3))]
    pins: list[Pin] = []
    for side, glue in row.ends.items():
        block = row.blocks[0] if side == "low" else row.blocks[-1]
        low_m, high_m = block.low_m.copy(), block.high_m.copy()
        depth_m = max(glue.region.depth_m, spacing_m)
        if side == "low":
            low_m[row.axis], high_m[row.axis] = block.low_m[row.axis] - depth_m, block.low_m[row.axis]
        else:
            low_m[row.axis], high_m[row.axis] = block.high_m[row.axis], block.high_m[row.axis] + depth_m
        points, cell_m = _points_m(low_m, high_m, spacing_m)
        first = builder.particle_count
        _add_points(builder, points, cell_m, block.body, 0.0, damping_s)
        gripped.append(points)
        if glue.motion is Motion.KINEMATIC:
            pins.extend(
                Pin(particle=first + number, body=indices[glue.body], place_m=(x, y, z))
                for number, (x, y, z) in enumerate(glue.pose.to_body(points).tolist())
            )
    return MPMPart(row, np.concatenate(free), np.concatenate(gripped), start=start, pins=pins)


def _points_m(
    low_m: NDArray[np.float64], high_m: NDArray[np.float64], spacing_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Middles of the cells of a box [m], shape [point_count, 3], and the size of a cell [m], shape [3]."""
    counts = np.maximum(1, np.ceil((high_m - low_m) / spacing_m - 1e-6)).astype(int)
    cell_m = (high_m - low_m) / counts
    steps = np.meshgrid(*(np.arange(count) + 0.5 for count in counts), indexing="ij")
    return low_m + cell_m * np.stack(steps, axis=-1).reshape(-1, 3), cell_m


def _add_points(
    builder: newton.ModelBuilder,
    points_m: NDArray[np.float64],
    cell_m: NDArray[np.float64],
    body: SoftBody,
    density_kg_per_m3: float,
    damping_s: float,
) -> None:
    count, volume_m3 = len(points_m), float(np.prod(cell_m))
    builder.add_particles(
        pos=[wp.vec3(*point) for point in points_m],
        vel=[wp.vec3(0.0, 0.0, 0.0)] * count,
        mass=[density_kg_per_m3 * volume_m3] * count,
        # The solver takes a point for a cube with edges of twice its radius. A gripped one must stay in its voxel.
        radius=[0.5 * volume_m3 ** (1 / 3) * (1.0 if density_kg_per_m3 else GRIPPED_SIZE)] * count,
        custom_attributes={
            "mpm:young_modulus": [body.young_modulus_pa] * count,
            "mpm:poisson_ratio": [body.poisson_ratio] * count,
            "mpm:damping": [damping_s] * count,
            # The default yields at once under tension.
            "mpm:tensile_yield_ratio": [1.0] * count,
        },
    )


# --- stepping --------------------------------------------------------------------------------------------------------


class LoopMPM(Stepper):
    """Steps particles with `newton.solvers.SolverImplicitMPM`; rigid bodies are fixed or driven.

    It runs without a graph: the grid is allocated anew in every step, which a recorded step cannot do on the CPU.

    Args:
        model: The finalized model.
        driven: Indices of the kinematic bodies.
        pins: Points that moving bodies hold.
        timestep_s: Step [s].
        voxel_m: Edge of a voxel [m].
        iterations: Cap on the iterations of the stress solver.
        tolerance: Residual at which the stress solver stops.
        integration_scheme: `gimp`, where points fill their cells, or `pic`, where they are points. A strain that is
            constant in a voxel does not see all motion of points that share it evenly: with `pic` and two points along
            an edge, voxels of 12 mm give a tenth of the stress. With `gimp` a bar that is twisted by more than 45
            degrees diverges.
    """

    def __init__(
        self,
        model: newton.Model,
        *,
        driven: Sequence[int],
        pins: Sequence[Pin],
        timestep_s: float,
        voxel_m: float,
        iterations: int,
        tolerance: float,
        integration_scheme: Literal["gimp", "pic"] = "gimp",
    ) -> None:
        config = SolverImplicitMPM.Config(
            voxel_size=voxel_m,
            max_iterations=iterations,
            tolerance=tolerance,
            # Strain that a capped solve leaves over would be forgotten: the stress came out at half.
            carry_residual_strain="unconverged",
            # Keeps the memory from one step to the next in the state, where a snapshot finds it.
            warmstart_mode="particles",
            integration_scheme=integration_scheme,
            # Contact at the points: by default, on the grid's nodes, a driven cube sinks 16 mm into the foam.
            collider_basis="pic27",
            air_drag=0.0,
            separate_worlds=model.world_count > 1,
        )
        super().__init__(model, SolverImplicitMPM(model, config), driven=driven, timestep_s=timestep_s)
        with wp.ScopedDevice(model.device):
            self._held = wp.array([pin.particle for pin in pins], dtype=wp.int32)
            self._holders = wp.array([pin.body for pin in pins], dtype=wp.int32)
            self._places = wp.array([pin.place_m for pin in pins], dtype=wp.vec3)

    def record(self) -> None:
        """Only keep the start."""
        self._first = [array.numpy().copy() for array in self._arrays()]

    def advance(self, seconds: float) -> None:
        """Run the steps one by one."""
        self._send_commands()
        for _ in range(round(seconds / self.timestep_s)):
            self._step(self._states[self._current], self._states[1 - self._current])
            self._current = 1 - self._current

    def _step(self, state: newton.State, after: newton.State) -> None:
        self._prescribe(after.body_q, after.body_qd, steps_ahead=1)
        pins = [self._held, self._holders, self._places]
        if self._held.size:
            wp.launch(
                carry,
                dim=self._held.size,
                inputs=[*pins, state.body_q, after.body_q, after.body_qd, self.timestep_s],
                outputs=[state.particle_q, state.particle_qd, state.mpm.particle_qd_grad],
                device=self.model.device,
            )
        # Contact impulses of the last step live in the solver, where no snapshot finds them: each step starts without.
        self.solver.reset(state, flags=0)
        self.solver.step(state, after, self._control, None, self.timestep_s)
        if self._held.size:
            wp.launch(
                hold,
                dim=self._held.size,
                inputs=[*pins, after.body_q],
                outputs=[after.particle_q],
                device=self.model.device,
            )

    def _arrays(self) -> list[wp.array]:
        """The states and the drive: the solver's own arrays are those of a grid that lives for one step."""
        found: list[wp.array] = []
        for state in self._states:
            found += [state.particle_q, state.particle_qd]
            found += [array for array in vars(state.mpm).values() if isinstance(array, wp.array)]
            found += [state.body_q, state.body_qd] if self.model.body_count else []
        return [*found, self._elapsed, self._start, self._velocity, self._acceleration]
