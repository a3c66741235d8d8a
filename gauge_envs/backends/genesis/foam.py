"""Soft bodies by Genesis's implicit finite elements (FEM) and by its explicit material point method (MPM).

With FEM, a soft row is one entity of linear corotational tetrahedra. With MPM, points in a grip are a million times as
heavy as free points and are placed before each step, so the nearby grid has the velocity of the grip. The voxel is
chosen so that a grid plane lies at each face of a grip. The points begin half a voxel behind that plane, so that it is
the last plane that they move.
"""

import tempfile
from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from gauge_envs.backends.genesis.engine import engine
from gauge_envs.backends.genesis.parts import (
    DeformablePart,
    PinGenesis,
    particle_positions_m,
)
from gauge_envs.backends.genesis.settings import (
    COURANT_LIMIT,
    SOFT_CELL_M,
    VOXEL_M,
    SettingsExplicitMPM,
    SettingsFEM,
    sound_time_s,
)
from gauge_envs.backends.shared.bundled import replaced
from gauge_envs.backends.shared.cells import grid_points
from gauge_envs.backends.shared.soft_rows import (
    Block,
    SoftRow,
    TetrahedralMesh,
    grid_lines_m,
    lame_constants,
    linear_weights,
    points_in_box_m,
    soft_rows,
)
from gauge_envs.backends.simulation import MaterialPoints
from gauge_envs.scene import Motion, Scene
from gauge_envs.scene.geometry import FloatArray, IntArray

FLOOR_M = -1e6
"""Height of Genesis's own floor [m], which no body touches."""

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


Weights = tuple[IntArray, FloatArray]
"""Nodes or points around each place and their weights in it, both of shape [place_count, weight_count]."""


class _Row(ABC):
    """One soft row among the nodes or points of a solver.

    Attributes:
        soft_row: The soft row.
        nodes_of: Indices of each body's nodes among those of `nodes_m`, by name.
        entities: Its entities in the Genesis scene.
    """

    def __init__(self, soft_row: SoftRow, nodes_m: FloatArray) -> None:
        self.soft_row = soft_row
        self.nodes_of = soft_row.nodes_of(nodes_m)
        self.entities: list[Any] = []

    @abstractmethod
    def positions_m(self) -> FloatArray:
        """Return the current positions of the solver's nodes or points [m], shape [count, 3]."""

    def nodes_m(self) -> FloatArray:
        """Return the current positions of the nodes [m], shape [node_count, 3]."""
        return self.positions_m()

    @abstractmethod
    def weights(self, places_m: FloatArray) -> Weights:
        """Return the weights of `positions_m` in places at the start [m], shape [place_count, 3]."""

    def places_m(self, weights: Weights) -> FloatArray:
        """Return the current positions of places with some weights [m], shape [place_count, 3]."""
        indices, shares = weights
        return np.einsum("pk,pki->pi", shares, self.positions_m()[indices])


class SoftPart(DeformablePart):
    """All soft bodies of a scene.

    Material in a grip moves rigidly and is not simulated.
    """

    def __init__(
        self,
        scene: Scene,
        settings: SettingsFEM | SettingsExplicitMPM,
        rows: Sequence[_Row],
    ) -> None:
        self._row_of = {name: row for row in rows for name in row.soft_row.names}
        self._softness_m = settings.contact_softness_m
        super().__init__(scene, list(self._row_of))

    def add(self, model: Any) -> None:
        """Set how rigid bodies act on the velocities of nodes and of a grid; they have no restitution."""
        super().add(model)
        for geom, friction in self.coupled_geoms(model):
            geom._coup_friction = friction
            geom._coup_restitution = 0.0
            geom._coup_softness = self._softness_m

    def nodes(self, name: str) -> FloatArray:
        """Return the positions of a body's nodes [m], shape [node_count, 3]; bonded faces belong to both bodies."""
        row = self._row_of[name]
        return row.nodes_m()[row.nodes_of[name]]

    def track(self, name: str, points_m: FloatArray) -> MaterialPoints | None:
        """Return a reader of material points; see `Simulation.track`."""
        row = self._row_of[name]
        weights = row.weights(row.soft_row.checked(np.asarray(points_m, np.float64)))
        return lambda: row.places_m(weights)[None]


# --- finite elements -------------------------------------------------------------------------------------------------


class _FEMRow(_Row):
    """One soft row among the nodes, which is one entity.

    Attributes:
        mesh: Its tetrahedra.
    """

    def __init__(self, soft_row: SoftRow, cell_m: float) -> None:
        self.mesh = TetrahedralMesh.of(soft_row, [], cell_m)
        super().__init__(soft_row, self.mesh.points_m)

    def positions_m(self) -> FloatArray:
        """Return the positions of the nodes of the mesh."""
        return self.entities[0].get_state().pos[0].numpy().astype(np.float64)

    def weights(self, places_m: FloatArray) -> Weights:
        """Return the weights of linear interpolation in each tetrahedron, as in the elements."""
        return self.mesh.weights(places_m)

    def add(self, model: Any, folder: Path) -> None:
        """Add the entity to a scene that is not built; `finish` writes the constants of each block."""
        gs = engine()
        block = self.soft_row.blocks[0]
        points_m, tetrahedra = self.mesh.points_m, self.mesh.tetrahedra
        path = folder / f"{block.body.name}.obj"
        surface = trimesh.Trimesh(points_m, self.mesh.surface(), process=False)
        surface.export(path, digits=17)
        from genesis.utils import element

        # Genesis takes the elements of the mesh instead of making its own.
        given = {
            "mesh_to_elements": lambda *_, **__: (points_m.copy(), tetrahedra.copy()),
            "split_all_surface_tets": lambda *mesh: mesh,
        }
        with replaced(element, **given):
            entity = model.add_entity(
                material=gs.materials.FEM.Elastic(
                    E=block.body.young_modulus_pa,
                    nu=block.body.poisson_ratio,
                    rho=block.density_kg_per_m3,
                    model="linear_corotated",
                ),
                morph=gs.morphs.Mesh(file=str(path)),
            )
        self.entities.append(entity)


class FEMPart(SoftPart):
    """All soft bodies of a scene as tetrahedra, which span the free material and have its mass."""

    def __init__(self, scene: Scene, settings: SettingsFEM) -> None:
        self._settings = settings
        self._rows = [
            _FEMRow(row, settings.cell_m or SOFT_CELL_M) for row in soft_rows(scene)
        ]
        super().__init__(scene, settings, self._rows)

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

    def add(self, model: Any) -> None:
        """Add the entities."""
        super().add(model)
        with tempfile.TemporaryDirectory() as folder:
            for row in self._rows:
                row.add(model, Path(folder))

    def finish(self, model: Any) -> None:
        """Set the constants of the elements, the masses and the pinned nodes."""
        gs = engine()
        solver = model.sim.fem_solver
        materials, masses = [], []
        for row in self._rows:
            blocks = row.soft_row.blocks
            constants = np.array([lame_constants(block.body) for block in blocks])
            materials.append(constants[row.mesh.blocks])
            densities = [block.density_kg_per_m3 for block in blocks]
            masses.append(row.mesh.masses_kg(densities))
            (entity,) = row.entities
            for attachment, nodes in row.soft_row.gripped(row.mesh.points_m):
                points_m = row.mesh.points_m[nodes]
                entity.set_vertex_constraints(nodes, points_m.astype(gs.np_float))
                if attachment.motion is Motion.KINEMATIC:
                    self.pin(entity, nodes, attachment, points_m)
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

    def pin_motion(
        self, pin: PinGenesis, path_m: FloatArray, spin: FloatArray
    ) -> tuple[FloatArray, ...]:
        """Return the positions of pinned nodes at the end of each step."""
        return (path_m[1:],)

    def hold_pin(self, pin: PinGenesis, *arrays: NDArray[Any]) -> None:
        """Set the positions of the nodes at the end of the step."""
        pin.entity.update_constraint_targets(pin.nodes, *arrays)


# --- material points -------------------------------------------------------------------------------------------------


def fitted_voxel_m(rows: Sequence[SoftRow], voxel_m: float) -> float:
    """Return the voxel edge [m], close to the desired edge, that puts grid planes at the faces of all grips.

    Grid planes lie at multiples of the edge. The first soft row with a grip counts.
    """
    candidates = voxel_m * np.linspace(*VOXEL_RANGE, 1201)
    misses = np.zeros(len(candidates))
    for row in rows:
        for side in row.ends:
            face = row.face_m(side)
            misses += np.square(np.rint(face / candidates) * candidates - face)
        if row.ends:
            break
    return float(candidates[np.argmin(misses)])


class _MPMRow(_Row):
    """One soft row among the points, with an entity for each block, then an entity for each grip.

    Attributes:
        points_m: Free points at the start [m], shape [free_count, 3].
        blocks: Block of each free point, shape [free_count].
        volumes_m3: Volume of each free point [m^3], shape [free_count].
        grips: Attachment of each end, and its gripped points at the start [m].
        all_m: Free points, then gripped ones, at the start [m].
    """

    def __init__(
        self, soft_row: SoftRow, voxel_m: float, points_per_edge: float
    ) -> None:
        # A grid of places in the free material, its surface included.
        nodes_m = grid_points(*grid_lines_m(soft_row.blocks, soft_row.axis, voxel_m))
        super().__init__(soft_row, nodes_m)
        spacing_m = voxel_m / points_per_edge
        clouds = [
            points_in_box_m(block.low_m, block.high_m, spacing_m)
            for block in soft_row.blocks
        ]
        counts = [len(points) for points, _ in clouds]
        volumes_m3 = [float(np.prod(cell_m)) for _, cell_m in clouds]
        self.points_m = np.concatenate([points for points, _ in clouds])
        self.blocks = np.repeat(np.arange(len(clouds)), counts)
        self.volumes_m3 = np.repeat(volumes_m3, counts)
        self.grips = [
            (attachment, self._grip_m(side, voxel_m, spacing_m))
            for side, attachment in soft_row.ends.items()
        ]
        self.all_m = np.concatenate(
            [self.points_m, *(points for _, points in self.grips)]
        )
        self._node_weights = self._weights_of_nodes(nodes_m)

    def positions_m(self) -> FloatArray:
        """Return the positions of all points."""
        return np.concatenate(
            [particle_positions_m(entity) for entity in self.entities]
        )

    def nodes_m(self) -> FloatArray:
        """Return the nodes, interpolated between the points."""
        return self.places_m(self._node_weights)

    def weights(self, places_m: FloatArray) -> Weights:
        """Return the weights of the nearest points, exact for linear deformation."""
        return linear_weights(self.all_m, places_m)

    def _weights_of_nodes(self, nodes_m: FloatArray) -> Weights:
        """Return the weights of the nearest points in each node; nodes at a grip follow its points alone."""
        indices, shares = self.weights(nodes_m)
        gripped = self.soft_row.gripped(nodes_m)
        start = len(self.points_m)
        for (_, points_m), (_, nodes) in zip(self.grips, gripped, strict=True):
            nearest, shares[nodes] = linear_weights(points_m, nodes_m[nodes])
            indices[nodes] = start + nearest
            start += len(points_m)
        return indices, shares

    def _grip_m(self, side: str, voxel_m: float, spacing_m: float) -> FloatArray:
        """Return the points of a grip [m], shape [count, 3]: layers of the cross-section behind the grid plane."""
        row = self.soft_row
        block = row.end(side)
        plane = round(row.face_m(side) / voxel_m) * voxel_m
        low_m, high_m = block.low_m.copy(), block.high_m.copy()
        low_m[row.axis], high_m[row.axis] = 0.0, spacing_m
        section = points_in_box_m(low_m, high_m, spacing_m)[0]
        outward_m = -voxel_m if side == "low" else voxel_m
        points = np.tile(section, (len(GRIP_LAYERS), 1))
        points[:, row.axis] = plane + np.repeat(GRIP_LAYERS, len(section)) * outward_m
        return points


class MPMPart(SoftPart):
    """All soft bodies of a scene as material points."""

    def __init__(self, scene: Scene, settings: SettingsExplicitMPM) -> None:
        self._settings = settings
        rows = soft_rows(scene)
        self.voxel_m = fitted_voxel_m(rows, settings.cell_m or VOXEL_M)
        self._rows = [
            _MPMRow(row, self.voxel_m, settings.points_per_voxel_edge) for row in rows
        ]
        super().__init__(scene, settings, self._rows)
        # Genesis has one volume for all points; masses and moduli are scaled to the volume of each point.
        self._volume_m3 = float(self._rows[0].volumes_m3[0])

    def scene_options(self) -> dict[str, Any]:
        """Return the options of the MPM solver and of the coupling."""
        gs = engine()
        points = np.concatenate([row.points_m for row in self._rows])
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

    def add(self, model: Any) -> None:
        """Add one entity for each block and one for each grip."""
        super().add(model)
        for row in self._rows:
            blocks = row.soft_row.blocks
            for index, block in enumerate(blocks):
                volumes_m3 = row.volumes_m3[row.blocks == index]
                share = float(volumes_m3[0]) / self._volume_m3
                row.entities.append(
                    self._points(model, block, len(volumes_m3), share, share)
                )
            for _, points_m in row.grips:
                row.entities.append(
                    self._points(model, blocks[0], len(points_m), 1.0, GRIP_MASS_RATIO)
                )

    def _points(
        self, model: Any, block: Block, count: int, stiffness: float, mass: float
    ) -> Any:
        """Add points of a block with multiples of the body's moduli and density."""
        gs, body = engine(), block.body
        mu, lame = lame_constants(body)
        return model.add_entity(
            material=gs.materials.MPM.Elastic(
                E=body.young_modulus_pa,
                nu=body.poisson_ratio,
                mu=mu * stiffness,
                lam=lame * stiffness,
                rho=block.density_kg_per_m3 * mass,
                model=self._settings.model,
            ),
            morph=gs.morphs.Nowhere(n_particles=count),
            surface=gs.surfaces.Default(vis_mode="particle"),
        )

    def finish(self, model: Any) -> None:
        """Place the points, and pin the points in grips."""
        from gauge_envs.backends.genesis.kernels import MPMKernels

        self._kernels = MPMKernels(model)
        boundary = model.sim.mpm_solver.boundary
        self._walls_m = boundary.lower, boundary.upper
        for row in self._rows:
            start = 0
            for entity in row.entities:
                points_m = row.all_m[start : start + entity.n_particles]
                entity.set_particles_pos(points_m)
                entity.set_particles_active(True)
                start += entity.n_particles
            grips = row.entities[len(row.soft_row.blocks) :]
            for entity, (attachment, points_m) in zip(grips, row.grips, strict=True):
                self.pin(entity, np.arange(len(points_m)), attachment, points_m)

    def pin_motion(
        self, pin: PinGenesis, path_m: FloatArray, spin: FloatArray
    ) -> tuple[FloatArray, ...]:
        """Return the positions of gripped points, and the velocity and spin of their body."""
        step_s = self._settings.timestep_s
        # Genesis adds the weight to the velocity of the grid, grips included.
        weight = np.array([0.0, 0.0, self._scene.gravity_m_per_s2 * step_s])
        velocities = np.diff(path_m, axis=0) / step_s + weight
        return path_m[:-1], velocities, 0.5 * (spin[:-1] + spin[1:])

    def hold_pin(self, pin: PinGenesis, *arrays: NDArray[Any]) -> None:
        """Place the points, and give them the motion of their body."""
        self._kernels.hold(pin.entity.particle_start, *arrays)

    def diverged(self) -> str | None:
        """Return that material points stand at a wall of the grid, where Genesis stops them, or are not finite."""
        low, high = self._walls_m
        slack = WALL_SLACK * self.voxel_m
        for row in self._rows:
            points = row.positions_m()[: len(row.points_m)]
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
        return f"Genesis stops material points {ROOM_M:g} m from their start or earlier; move the body less"
