"""Soft bodies by Genesis's implicit finite elements (FEM) and by its explicit material point method (MPM).

With FEM, a soft row is one entity of linear corotational tetrahedra. With MPM, points in a grip weigh a million times
the others and are placed before each step, so that the grid near them has the velocity of the grip. The voxel is chosen
so that a grid plane lies at each face of a grip. The points begin half a voxel behind that plane, so that it is the
last one that they move.
"""

import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from gauge_envs.backends.genesis.engine import engine
from gauge_envs.backends.genesis.parts import DeformablePart, coupled_geoms
from gauge_envs.backends.genesis.settings import (
    COURANT_LIMIT,
    SOFT_CELL_M,
    VOXEL_M,
    SettingsFEM,
    SettingsMPM,
    sound_time_s,
)
from gauge_envs.backends.shared.bundled import replaced
from gauge_envs.backends.shared.cells import grid_points
from gauge_envs.backends.shared.rigid import DrivenMotion
from gauge_envs.backends.shared.soft_rows import (
    SoftRow,
    TetrahedralMesh,
    grid_lines_m,
    lame_constants,
    linear_weights,
    points_in_box_m,
    soft_rows,
)
from gauge_envs.scene import Motion, Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray, IntArray

FLOOR_M = -1e6
"""Height of Genesis's own floor, out of reach [m]."""

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


class _Row(ABC):
    """One soft row among the nodes or points of a solver.

    Attributes:
        soft_row: The soft row.
        nodes_of: Indices of each body's nodes among those of `nodes_m`, by name.
        start: Its first node or point in the solver.
        count: Number of its nodes or points.
    """

    soft_row: SoftRow
    nodes_of: dict[str, IntArray]
    start: int
    count: int

    @abstractmethod
    def nodes_m(self, positions_m: FloatArray) -> FloatArray:
        """Return the nodes [m], shape [node_count, 3], given what the solver moves [m], shape [count, 3]."""

    @abstractmethod
    def reader(self, points_m: FloatArray) -> Callable[[FloatArray], Any]:
        """Return a function of what the solver moves that returns the positions of material points [m]."""


class SoftPart(DeformablePart):
    """All soft bodies of a scene.

    Material in a grip moves rigidly and is not simulated.
    """

    def __init__(
        self, scene: Scene, settings: SettingsFEM | SettingsMPM, rows: Sequence[_Row]
    ) -> None:
        self._rows = {name: row for row in rows for name in row.soft_row.names}
        self._softness_m = settings.contact_softness_m
        super().__init__(scene, settings, list(self._rows))

    def add(self, scene: Any) -> None:
        """Set how rigid bodies act on the velocities of nodes and of a grid; they have no restitution."""
        super().add(scene)
        for geom, friction in coupled_geoms(scene, self._scene, self.touches()):
            geom._coup_friction, geom._coup_restitution, geom._coup_softness = (
                friction,
                0.0,
                self._softness_m,
            )

    def nodes(self, name: str) -> FloatArray:
        """Return the positions of a body's nodes [m], shape [node_count, 3]; bonded faces belong to both bodies."""
        row = self._rows[name]
        return row.nodes_m(self._moved(row))[row.nodes_of[name]]

    def track(self, name: str, points_m: FloatArray) -> Callable[[], FloatArray] | None:
        """Return a reader of material points; see `World.track`."""
        row = self._rows[name]
        read = row.reader(row.soft_row.checked(np.asarray(points_m, dtype=np.float64)))
        return lambda: np.asarray(read(self._moved(row)))

    def _moved(self, row: _Row) -> FloatArray:
        return self._positions(slice(row.start, row.start + row.count))


# --- finite elements -------------------------------------------------------------------------------------------------


class _FEMRow(_Row):
    """One soft row among the nodes.

    Attributes:
        mesh: Its tetrahedra.
    """

    def __init__(self, soft_row: SoftRow, cell_m: float) -> None:
        self.soft_row = soft_row
        self.mesh = TetrahedralMesh.of(soft_row, [], cell_m)
        self.nodes_of = soft_row.nodes_of(self.mesh.points_m)
        self.count = len(self.mesh.points_m)

    def nodes_m(self, positions_m: FloatArray) -> FloatArray:
        """Return the nodes of the mesh."""
        return positions_m

    def reader(self, points_m: FloatArray) -> Callable[[FloatArray], Any]:
        """Return a function that interpolates linearly in each tetrahedron, as the elements do."""
        corners, weights = self.mesh.weights(points_m)
        return lambda positions: np.einsum("pk,pki->pi", weights, positions[corners])

    def add(self, scene: Any, folder: Path) -> Any:
        """Add the entity to a scene that is not built, and return it; `finish` writes the constants of each block."""
        gs = engine()
        block = self.soft_row.blocks[0]
        path = folder / f"{block.body.name}.obj"
        trimesh.Trimesh(self.mesh.points_m, self.mesh.surface(), process=False).export(
            path, digits=17
        )
        from genesis.utils import element

        # Genesis takes the elements of the mesh instead of making its own.
        made = (self.mesh.points_m.copy(), self.mesh.tetrahedra.copy())
        given = {
            "mesh_to_elements": lambda *_, **__: made,
            "split_all_surface_tets": lambda *mesh: mesh,
        }
        with replaced(element, **given):
            return scene.add_entity(
                material=gs.materials.FEM.Elastic(
                    E=block.body.young_modulus_pa,
                    nu=block.body.poisson_ratio,
                    rho=block.density_kg_per_m3,
                    model="linear_corotated",
                ),
                morph=gs.morphs.Mesh(file=str(path)),
            )


class FEMPart(SoftPart):
    """All soft bodies of a scene as tetrahedra, which span the free material and have its mass."""

    def __init__(self, scene: Scene, settings: SettingsFEM) -> None:
        self._settings = settings
        self._unique = [
            _FEMRow(row, settings.cell_m or SOFT_CELL_M) for row in soft_rows(scene)
        ]
        super().__init__(scene, settings, self._unique)

    def scene_options(self) -> dict[str, Any]:
        """Return the options of the FEM solver and of the coupling."""
        gs, settings = engine(), self._settings
        return {
            "fem_options": gs.options.FEMOptions(
                use_implicit_solver=True,
                enable_vertex_constraints=True,
                floor_height=FLOOR_M,
                n_newton_iterations=settings.newton_iterations,
                n_pcg_iterations=settings.pcg_iterations,
                pcg_threshold=settings.pcg_residual_n2,
                damping_alpha=settings.damping_alpha_per_s,
                damping_beta=settings.damping_beta_s,
            ),
            "coupler_options": gs.options.LegacyCouplerOptions(
                rigid_fem=bool(self.touches())
            ),
        }

    def touch_margin_m(self) -> float:
        """Return by how much the geoms that touch the nodes exceed their bodies [m]."""
        return self._settings.contact_margin_m

    def add(self, scene: Any) -> None:
        """Add the entities."""
        super().add(scene)
        with tempfile.TemporaryDirectory() as folder:
            self._entities = [row.add(scene, Path(folder)) for row in self._unique]

    def finish(self, scene: Any) -> None:
        """Set the constants of the elements, the masses and the held nodes."""
        from gauge_envs.backends.genesis.kernels import FEMKernels

        gs = engine()
        solver = scene.sim.fem_solver
        self._kernels = FEMKernels(scene)
        materials, masses = [], []
        for row, entity in zip(self._unique, self._entities, strict=True):
            row.start = entity.v_start
            blocks = row.soft_row.blocks
            materials.append(
                np.array([lame_constants(block.body) for block in blocks])[
                    row.mesh.blocks
                ]
            )
            masses.append(
                row.mesh.masses_kg([block.density_kg_per_m3 for block in blocks])
            )
            for attachment, nodes in row.soft_row.gripped(row.mesh.points_m):
                places_m = row.mesh.points_m[nodes]
                entity.set_vertex_constraints(nodes, places_m.astype(gs.np_float))
                if attachment.motion is Motion.KINEMATIC:
                    self.pin(attachment, row.start + nodes, places_m)
        mass, step_s = np.concatenate(masses), self._settings.timestep_s
        mu, lam = np.concatenate(materials).T
        elements, nodes = solver.elements_i, solver.elements_v_info
        for field, values in (
            (elements.mu, mu),
            (elements.lam, lam),
            (nodes.mass, mass),
            (nodes.mass_inv, 1.0 / mass),
            (nodes.mass_over_dt2, mass / step_s**2),
        ):
            field.from_numpy(values.astype(gs.np_float))
        points = np.concatenate([row.mesh.points_m for row in self._unique]).astype(
            gs.np_float
        )
        self._start = points, np.zeros_like(points)

    def plan(
        self,
        rows: NDArray[np.int32],
        motion: DrivenMotion,
        path_m: NDArray[Any],
        times_s: NDArray[Any],
    ) -> tuple[NDArray[Any], ...]:
        """Return where held nodes are at the end of each step."""
        return (path_m[1:],)


# --- material points -------------------------------------------------------------------------------------------------


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


class _MPMRow(_Row):
    """One soft row among the points.

    Attributes:
        points_m: Free points at the start [m], shape [free_count, 3].
        blocks: Block of each free point, shape [free_count].
        grips: Attachment of each end, and its gripped points at the start [m].
    """

    def __init__(
        self, soft_row: SoftRow, voxel_m: float, points_per_edge: float
    ) -> None:
        self.soft_row = soft_row
        spacing_m = voxel_m / points_per_edge
        clouds = [
            points_in_box_m(block.low_m, block.high_m, spacing_m)
            for block in soft_row.blocks
        ]
        self.points_m = np.concatenate([points for points, _ in clouds])
        self.blocks = np.concatenate(
            [np.full(len(points), index) for index, (points, _) in enumerate(clouds)]
        )
        self.volumes_m3 = np.array([float(np.prod(cell_m)) for _, cell_m in clouds])[
            self.blocks
        ]
        self.grips = [
            (attachment, self._grip_m(side, voxel_m, spacing_m))
            for side, attachment in soft_row.ends.items()
        ]
        # Free points come first.
        self.all_m = np.concatenate(
            [self.points_m, *(points for _, points in self.grips)]
        )
        self.count = len(self.all_m)
        # A grid of places in the free material, its surface included.
        nodes_m = grid_points(*grid_lines_m(soft_row.blocks, soft_row.axis, voxel_m))
        self._node_weights = self._weights_of_nodes(nodes_m)
        self.nodes_of = soft_row.nodes_of(nodes_m)

    def nodes_m(self, positions_m: FloatArray) -> FloatArray:
        """Return the nodes, interpolated between the points."""
        return np.asarray(self._node_weights @ positions_m)

    def reader(self, points_m: FloatArray) -> Callable[[FloatArray], Any]:
        """Return a function that takes a weighted mean of the nearest points, exact for linear deformation."""
        weights = self._weights(points_m)
        return lambda positions: weights @ positions

    def _weights_of_nodes(self, nodes_m: FloatArray) -> csr_matrix:
        """Return the weights of all points in each node; nodes at a grip follow its points alone."""
        weights = self._weights(nodes_m).tolil()
        first = len(self.points_m)
        gripped = {
            id(attachment): nodes
            for attachment, nodes in self.soft_row.gripped(nodes_m)
        }
        for attachment, points in self.grips:
            nodes = gripped[id(attachment)]
            rows = _affine(nodes_m[nodes]) @ np.linalg.pinv(_affine(points))
            for node, row in zip(nodes, rows, strict=True):
                weights[node] = 0.0
                weights[node, first : first + len(points)] = row
            first += len(points)
        return weights.tocsr()

    def _weights(self, points_m: FloatArray) -> csr_matrix:
        """Return the weights of the row's points at some places [m], shape [place_count, count]."""
        nearest, weights = linear_weights(self.all_m, points_m)
        rows = np.repeat(np.arange(len(points_m)), weights.shape[1])
        return csr_matrix(
            (weights.ravel(), (rows, nearest.ravel())),
            shape=(len(points_m), self.count),
        )

    def _grip_m(self, side: str, voxel_m: float, spacing_m: float) -> FloatArray:
        """Return the points of a grip [m], shape [count, 3]: layers of the cross-section behind the grid plane."""
        row = self.soft_row
        block = row.blocks[0 if side == "low" else -1]
        face = (row.low_m if side == "low" else row.high_m)[row.axis]
        plane = round(face / voxel_m) * voxel_m
        low_m, high_m = block.low_m.copy(), block.high_m.copy()
        low_m[row.axis], high_m[row.axis] = 0.0, spacing_m
        section = points_in_box_m(low_m, high_m, spacing_m)[0]
        layers = []
        for layer in GRIP_LAYERS:
            section[:, row.axis] = (
                plane + (-layer if side == "low" else layer) * voxel_m
            )
            layers.append(section.copy())
        return np.concatenate(layers)


def _affine(points_m: FloatArray) -> FloatArray:
    return np.column_stack([np.ones(len(points_m)), points_m])


class MPMPart(SoftPart):
    """All soft bodies of a scene as material points."""

    def __init__(self, scene: Scene, settings: SettingsMPM) -> None:
        self._settings = settings
        rows = soft_rows(scene)
        self.voxel_m = fitted_voxel_m(rows, settings.cell_m or VOXEL_M)
        self._unique = [
            _MPMRow(row, self.voxel_m, settings.points_per_voxel_edge) for row in rows
        ]
        super().__init__(scene, settings, self._unique)
        # Genesis has one volume for all points; masses and moduli are scaled to that of each.
        self._volume_m3 = float(self._unique[0].volumes_m3[0])
        self._walls_m: tuple[NDArray[Any], NDArray[Any]] = (
            np.full(3, -np.inf),
            np.full(3, np.inf),
        )

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
            "coupler_options": gs.options.LegacyCouplerOptions(
                rigid_mpm=bool(self.touches())
            ),
        }

    def add(self, scene: Any) -> None:
        """Add one entity for each block and one for each grip."""
        super().add(scene)
        for row in self._unique:
            for index, block in enumerate(row.soft_row.blocks):
                chosen = row.blocks == index
                share = float(row.volumes_m3[chosen][0]) / self._volume_m3
                self._add_points(
                    scene,
                    block.body,
                    int(chosen.sum()),
                    block.density_kg_per_m3 * share,
                    share,
                )
            for _, points in row.grips:
                block = row.soft_row.blocks[0]
                self._add_points(
                    scene,
                    block.body,
                    len(points),
                    GRIP_MASS_RATIO * block.density_kg_per_m3,
                    1.0,
                )

    def _add_points(
        self, scene: Any, body: SoftBody, count: int, density: float, share: float
    ) -> None:
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
        from gauge_envs.backends.genesis.kernels import MPMKernels

        gs = engine()
        self._kernels = MPMKernels(scene)
        boundary = scene.sim.mpm_solver.boundary
        self._walls_m = boundary.lower, boundary.upper
        start = 0
        for row in self._unique:
            row.start = start
            first = start + len(row.points_m)
            for attachment, points in row.grips:
                self.pin(attachment, np.arange(first, first + len(points)), points)
                first += len(points)
            start += row.count
        positions = np.concatenate([row.all_m for row in self._unique]).astype(
            gs.np_float
        )
        matrices = np.zeros((len(positions), 3, 3), dtype=gs.np_float)
        self._start = (
            positions,
            np.zeros_like(positions),
            matrices,
            matrices + np.eye(3, dtype=gs.np_float),
        )

    def plan(
        self,
        rows: NDArray[np.int32],
        motion: DrivenMotion,
        path_m: NDArray[Any],
        times_s: NDArray[Any],
    ) -> tuple[NDArray[Any], ...]:
        """Return where gripped points are, and the velocity and spin that take them along with their body."""
        step_s = self._settings.timestep_s
        # Genesis adds the weight to the velocity of the grid, grips included.
        weight = np.array([0.0, 0.0, self._scene.gravity_m_per_s2 * step_s])
        spin = motion.velocity[3:] + motion.acceleration[3:] * (
            times_s[:-1, None] + 0.5 * step_s
        )
        return path_m[:-1], np.diff(path_m, axis=0) / step_s + weight, spin

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
