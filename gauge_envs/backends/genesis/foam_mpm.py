"""Soft bodies by Genesis's explicit material point method (MPM).

Points in a grip weigh a million times the others and are placed before each step, so that the grid near them has the
velocity of the grip. The voxel is chosen so that a grid plane lies at each face of a grip. The points begin half a
voxel behind that plane, so that it is the last one that they move.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from gauge_envs.backends.genesis.coupling import couple_only_marked_geoms, driven_places, set_coupling, touching_bodies
from gauge_envs.backends.genesis.engine import engine
from gauge_envs.backends.genesis.foam_settings import COURANT_LIMIT, VOXEL_M, SettingsMPM, sound_time_s
from gauge_envs.backends.genesis.parts import DeformablePart, Motions
from gauge_envs.backends.shared.attachments import RigidAttachment, attachments_by_body, bonded_soft_bodies
from gauge_envs.backends.shared.driven_motion import DrivenMotion
from gauge_envs.backends.shared.point_weights import linear_weights
from gauge_envs.backends.shared.soft_rows import SoftRow
from gauge_envs.backends.shared.tetrahedra import grid_lines_m, grid_points_m, lame_constants
from gauge_envs.scene import Motion, Scene, SoftBody

GRIP_MASS_RATIO = 1e6
"""Mass of a gripped point over that of a free one."""

GRIP_LAYERS = (0.501, 1.0, 1.5)
"""Distances of the layers of gripped points from the grid plane at the face, in voxels."""

VOXEL_RANGE = (0.85, 1.15)
"""Voxel sizes that `fitted_voxel_m` tries, as multiples of the desired size."""

ROOM_M = 0.15
"""Distance from the soft bodies to the walls of the grid [m]."""

WALL_SLACK = 1e-3
"""Distance from a wall at which a point counts as stopped by it, in voxels."""

State = tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]


def fitted_voxel_m(rows: Sequence[SoftRow], voxel_m: float) -> float:
    """Return the voxel edge [m], close to a desired one, with which grid planes lie at the faces of all grips.

    Grid planes lie at multiples of the edge. The first soft row with a grip counts.
    """
    candidates = voxel_m * np.linspace(*VOXEL_RANGE, 1201)
    misses = np.zeros(len(candidates))
    for row in rows:
        for side in row.ends:
            face = (row.low_m if side == "low" else row.high_m)[row.axis]
            misses += np.square(np.rint(face / candidates) * candidates - face)
        if row.ends:
            break
    return float(candidates[np.argmin(misses)])


class _Row:
    """One soft row among the points.

    Attributes:
        soft_row: The soft row.
        points_m: Free points at the start [m], shape [free_count, 3].
        blocks: Block of each free point, shape [free_count].
        grips: Attachment of each end, and its gripped points at the start [m].
        nodes_m: A grid of places in the free material, its surface included [m], shape [node_count, 3].
        node_weights: Weights of all points in each node, shape [node_count, count].
        nodes_of: Nodes of each body, by name; bonded faces belong to both.
        start: Its first point in the solver; free points come first.
    """

    def __init__(self, soft_row: SoftRow, voxel_m: float, points_per_edge: float) -> None:
        self.soft_row = soft_row
        spacing_m = voxel_m / points_per_edge
        clouds = [_points_m(block.low_m, block.high_m, spacing_m) for block in soft_row.blocks]
        self.points_m = np.concatenate([points for points, _ in clouds])
        self.blocks = np.concatenate([np.full(len(points), index) for index, (points, _) in enumerate(clouds)])
        self.volumes_m3 = np.array([volume for _, volume in clouds])[self.blocks]
        self.grips = [
            (attachment, self._grip_m(side, voxel_m, spacing_m)) for side, attachment in soft_row.ends.items()
        ]
        self.start = 0
        sources = np.concatenate([self.points_m, *(points for _, points in self.grips)])
        self._sources_m = sources
        lines = grid_lines_m(soft_row.blocks, soft_row.axis, voxel_m)
        self.nodes_m = grid_points_m(lines)
        self.node_weights = self._node_weights()
        self.nodes_of = {block.body.name: np.flatnonzero(block.holds(self.nodes_m)) for block in soft_row.blocks}

    def _node_weights(self) -> csr_matrix:
        """Return the weights of all points in each node; nodes at a grip follow its points alone."""
        weights = self.weights(self.nodes_m).tolil()
        first = len(self.points_m)
        gripped = {id(attachment): nodes for attachment, nodes in self.soft_row.gripped(self.nodes_m)}
        for attachment, points in self.grips:
            for node, row in zip(
                gripped[id(attachment)],
                _affine(self.nodes_m[gripped[id(attachment)]]) @ np.linalg.pinv(_affine(points)),
                strict=True,
            ):
                weights[node] = 0.0
                weights[node, first : first + len(points)] = row
            first += len(points)
        return weights.tocsr()

    def weights(self, points_m: NDArray[np.float64]) -> csr_matrix:
        """Return the weights of the row's points at some places [m], shape [place_count, count]."""
        nearest, weights = linear_weights(self._sources_m, points_m)
        rows = np.repeat(np.arange(len(points_m)), weights.shape[1])
        return csr_matrix((weights.ravel(), (rows, nearest.ravel())), shape=(len(points_m), len(self._sources_m)))

    def _grip_m(self, side: str, voxel_m: float, spacing_m: float) -> NDArray[np.float64]:
        """Return the points of a grip [m], shape [count, 3]: layers of the cross-section behind the grid plane."""
        row = self.soft_row
        block = row.blocks[0 if side == "low" else -1]
        face = (row.low_m if side == "low" else row.high_m)[row.axis]
        plane = round(face / voxel_m) * voxel_m
        low_m, high_m = block.low_m.copy(), block.high_m.copy()
        low_m[row.axis], high_m[row.axis] = 0.0, spacing_m
        section = _points_m(low_m, high_m, spacing_m)[0]
        layers = []
        for layer in GRIP_LAYERS:
            section[:, row.axis] = plane + (-layer if side == "low" else layer) * voxel_m
            layers.append(section.copy())
        return np.concatenate(layers)

    @property
    def count(self) -> int:
        """Number of its points, gripped ones included."""
        return len(self.points_m) + sum(len(points) for _, points in self.grips)


def _affine(points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([np.ones(len(points_m)), points_m])


def _points_m(
    low_m: NDArray[np.float64], high_m: NDArray[np.float64], spacing_m: float
) -> tuple[NDArray[np.float64], float]:
    """Return the centres of the cells of a box [m], shape [point_count, 3], and the volume of a cell [m^3]."""
    counts = np.maximum(1, np.ceil((high_m - low_m) / spacing_m - 1e-6)).astype(int)
    cell_m = (high_m - low_m) / counts
    steps = np.meshgrid(*(np.arange(count) + 0.5 for count in counts), indexing="ij")
    return low_m + cell_m * np.stack(steps, axis=-1).reshape(-1, 3), float(np.prod(cell_m))


class MPMPart(DeformablePart):
    """All soft bodies of a scene as material points.

    Args:
        scene: The scene.
        settings: Numerical settings.
    """

    def __init__(self, scene: Scene, settings: SettingsMPM) -> None:
        self._scene = scene
        self._settings = settings
        groups = bonded_soft_bodies(scene)
        soft_rows = [SoftRow.of(bodies, attachments_by_body(scene, bodies)) for bodies in groups]
        self.voxel_m = fitted_voxel_m(soft_rows, settings.cell_m or VOXEL_M)
        self._unique = [_Row(row, self.voxel_m, settings.points_per_voxel_edge) for row in soft_rows]
        start = 0
        for row in self._unique:
            row.start = start
            start += row.count
        self._rows = {block.body.name: row for row in self._unique for block in row.soft_row.blocks}
        self.names = tuple(self._rows)
        # Genesis has one volume for all points; masses and moduli are scaled to that of each.
        self._volume_m3 = float(self._unique[0].volumes_m3[0])
        self._kernels: Any = None
        self._walls_m: tuple[NDArray[Any], NDArray[Any]] = (np.full(3, -np.inf), np.full(3, np.inf))
        self._start: State | None = None
        self._grips: list[tuple[RigidAttachment, NDArray[np.int32], NDArray[np.float64]]] = []
        self._planned: list[tuple[NDArray[np.int32], NDArray[Any], NDArray[Any], NDArray[Any]]] = []

    def scene_options(self) -> dict[str, Any]:
        """Return the options of the MPM solver and of the coupling."""
        gs = engine()
        points = np.concatenate([row.points_m for row in self._unique])
        return {
            "mpm_options": gs.options.MPMOptions(
                particle_size=self._volume_m3 ** (1.0 / 3.0),
                grid_density=1.0 / self.voxel_m,
                lower_bound=tuple((points.min(axis=0) - ROOM_M).tolist()),
                upper_bound=tuple((points.max(axis=0) + ROOM_M).tolist()),
            ),
            "coupler_options": gs.options.LegacyCouplerOptions(rigid_mpm=bool(self.touches())),
        }

    def touches(self) -> Mapping[str, float]:
        """Return the friction of the rigid bodies that collide with soft bodies, by name."""
        return touching_bodies(self._scene, self.names)

    def add(self, scene: Any) -> None:
        """Add one entity for each block and one for each grip, and set how rigid bodies act on the grid."""
        couple_only_marked_geoms(scene)
        set_coupling(scene, self._scene, self.touches(), self._settings.contact_softness_m)
        for row in self._unique:
            for index, block in enumerate(row.soft_row.blocks):
                chosen = row.blocks == index
                share = float(row.volumes_m3[chosen][0]) / self._volume_m3
                self._add_points(scene, block.body, int(chosen.sum()), block.density_kg_per_m3 * share, share)
            for _, points in row.grips:
                block = row.soft_row.blocks[0]
                self._add_points(scene, block.body, len(points), GRIP_MASS_RATIO * block.density_kg_per_m3, 1.0)

    def _add_points(self, scene: Any, body: SoftBody, count: int, density: float, share: float) -> None:
        gs = engine()
        mu, lame = lame_constants(body)
        scene.add_entity(
            material=gs.materials.MPM.Elastic(
                E=body.young_modulus_pa,
                nu=body.poisson_ratio,
                mu=mu * share,
                lam=lame * share,
                rho=density,
                model=self._settings.model,
            ),
            morph=gs.morphs.Nowhere(n_particles=count),
            surface=gs.surfaces.Default(vis_mode="particle"),
        )

    def finish(self, scene: Any) -> None:
        """Place the points, and find those in grips."""
        from gauge_envs.backends.genesis.mpm_kernels import MPMKernels

        gs = engine()
        self._kernels = MPMKernels(scene)
        boundary = scene.sim.mpm_solver.boundary
        self._walls_m = boundary.lower, boundary.upper
        clouds: list[NDArray[np.float64]] = []
        for row in self._unique:
            clouds.append(row.points_m)
            first = row.start + len(row.points_m)
            for attachment, points in row.grips:
                indices = np.arange(first, first + len(points), dtype=np.int32)
                self._grips.append((attachment, indices, attachment.pose.to_body(points)))
                clouds.append(points)
                first += len(points)
        positions = np.concatenate(clouds).astype(gs.np_float)
        matrices = np.zeros((len(positions), 3, 3), dtype=gs.np_float)
        self._start = positions, np.zeros_like(positions), matrices, matrices + np.eye(3, dtype=gs.np_float)

    def reset(self) -> None:
        """Return the points to their start."""
        assert self._start is not None
        self._kernels.write(*self._start)
        self._planned = []

    def prescribe(self, motions: Motions, time_s: float, step_s: float) -> None:
        """Place gripped points, with the velocity that takes them along with their body in the step."""
        if time_s == 0.0:
            self._plan(motions, step_s)
        step = round(time_s / step_s)
        for points, path, velocities, spin in self._planned:
            self._kernels.grip(points, path[step], velocities[step], spin[step])

    def _plan(self, motions: Motions, step_s: float) -> None:
        """Compute the motion of the grips in all steps of the interval."""
        gs = engine()
        times = step_s * np.arange(round(self._settings.drive_interval_s / step_s) + 1)
        # Genesis adds the weight to the velocity of the grid, grips included.
        weight = np.array([0.0, 0.0, self._scene.gravity_m_per_s2 * step_s])
        self._planned = []
        for attachment, points, places in self._grips:
            motion = (
                motions[attachment.body]
                if attachment.motion is Motion.KINEMATIC
                else DrivenMotion(attachment.pose, np.zeros(6), np.zeros(6))
            )
            path = driven_places(motion, places, times)
            spin = motion.velocity[3:] + motion.acceleration[3:] * (times[:-1, None] + 0.5 * step_s)
            arrays = (path[:-1], np.diff(path, axis=0) / step_s + weight, spin)
            position, velocity, turn = (np.ascontiguousarray(array, dtype=gs.np_float) for array in arrays)
            self._planned.append((points, position, velocity, turn))

    def nodes(self, name: str) -> NDArray[np.float64]:
        """Return the positions of a body's nodes [m], shape [node_count, 3], interpolated between the points."""
        row = self._rows[name]
        return np.asarray((row.node_weights @ self._positions(row))[row.nodes_of[name]])

    def track(self, name: str, points_m: NDArray[np.float64]) -> Callable[[], NDArray[np.float64]] | None:
        """Return a reader of material points: a weighted mean of the nearest points, exact for linear deformation."""
        row = self._rows[name]
        weights = row.weights(row.soft_row.checked(np.asarray(points_m, dtype=np.float64)))
        return lambda: np.asarray(weights @ self._positions(row))

    def _positions(self, row: _Row) -> NDArray[np.float64]:
        positions: NDArray[np.float64] = self.state()[0][row.start : row.start + row.count].astype(np.float64)
        return positions

    def fault(self) -> str | None:
        """Return that material points stand at a wall of the grid, where Genesis stops them, or are not finite."""
        low, high = self._walls_m
        slack = WALL_SLACK * self.voxel_m
        positions = self.state()[0]
        for row in self._unique:
            points = positions[row.start : row.start + len(row.points_m)]
            # A point that is not finite is not inside either.
            inside = ((points > low + slack) & (points < high - slack)).all(axis=1)
            if not inside.all():
                block = row.soft_row.blocks[row.blocks[int(np.argmin(inside))]]
                return f"{block.body.name!r} left its grid: {self._cause(row.soft_row)}"
        return None

    def _cause(self, row: SoftRow) -> str:
        """Return why material points of a row may have left the grid, and what to do."""
        step_s = self._settings.timestep_s
        sound_s = min(sound_time_s(block.body, self.voxel_m) for block in row.blocks)
        if step_s > sound_s:
            interval_s = self._settings.drive_interval_s
            stable_s = interval_s / ceil(interval_s / (COURANT_LIMIT * sound_s))
            return (
                f"explicit MPM is unstable, since a step takes {step_s / sound_s:.2g} times as long as sound through a "
                f"voxel of {1e3 * self.voxel_m:.3g} mm; set timestep_s to 1/{1 / stable_s:.0f} s, or preset to 'mpm'"
            )
        return f"Genesis stops material points {ROOM_M:g} m from their start and less; move the body less"

    def state(self) -> State:
        """Return positions, velocities, velocity gradients and deformation gradients of all points."""
        count = self._kernels.point_count
        shapes = ((count, 3), (count, 3), (count, 3, 3), (count, 3, 3))
        first, second, third, fourth = (np.empty(shape, dtype=engine().np_float) for shape in shapes)
        self._kernels.read(first, second, third, fourth)
        return first, second, third, fourth

    def restore(self, state: State) -> None:
        """Restore the points; the next interval prescribes the gripped ones anew."""
        self._kernels.write(*state)
        self._planned = []
