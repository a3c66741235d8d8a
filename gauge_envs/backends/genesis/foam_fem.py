"""Soft bodies by Genesis's implicit finite elements: a soft row is one entity of linear corotational tetrahedra."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from gauge_envs.backends.genesis.coupling import couple_only_marked_geoms, driven_places, set_coupling, touching_bodies
from gauge_envs.backends.genesis.engine import engine
from gauge_envs.backends.genesis.foam_settings import SOFT_CELL_M, SettingsFEM
from gauge_envs.backends.genesis.parts import DeformablePart, Motions
from gauge_envs.backends.shared.attachments import attachments_by_body, bonded_soft_bodies
from gauge_envs.backends.shared.soft_rows import SoftRow
from gauge_envs.backends.shared.tetrahedra import TetrahedralMesh, lame_constants
from gauge_envs.scene import Motion, Scene, SoftBody

FLOOR_M = -1e6
"""Height of Genesis's own floor, out of reach [m]."""


class _Row:
    """One soft row among the nodes.

    Attributes:
        soft_row: The soft row.
        mesh: Its tetrahedra.
        entity: Its entity in the Genesis scene.
    """

    def __init__(self, scene: Scene, bodies: Sequence[SoftBody], cell_m: float) -> None:
        self.soft_row = SoftRow.of(bodies, attachments_by_body(scene, bodies))
        self.mesh = TetrahedralMesh.of(self.soft_row, [], cell_m)
        self.entity: Any = None
        self.nodes_of = {
            block.body.name: np.flatnonzero(block.holds(self.mesh.points_m)) for block in self.soft_row.blocks
        }

    @property
    def nodes(self) -> slice:
        """Its nodes in the solver."""
        return slice(self.entity.v_start, self.entity.v_start + len(self.mesh.points_m))

    def add(self, scene: Any, folder: Path) -> None:
        """Add the entity to a scene that is not built; `finish` writes the constants of each block."""
        gs = engine()
        block = self.soft_row.blocks[0]
        path = folder / f"{block.body.name}.obj"
        trimesh.Trimesh(self.mesh.points_m, self.mesh.surface(), process=False).export(path, digits=17)
        with _mesh_given(self.mesh):
            self.entity = scene.add_entity(
                material=gs.materials.FEM.Elastic(
                    E=block.body.young_modulus_pa,
                    nu=block.body.poisson_ratio,
                    rho=block.density_kg_per_m3,
                    model="linear_corotated",
                ),
                morph=gs.morphs.Mesh(file=str(path)),
            )

    def constants(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return both Lame constants of each element [Pa], shape [element_count]."""
        materials = np.array([lame_constants(block.body) for block in self.soft_row.blocks])
        return materials[self.mesh.blocks, 0], materials[self.mesh.blocks, 1]

    def masses_kg(self) -> NDArray[np.float64]:
        """Return the masses of the nodes [kg], shape [node_count]."""
        return self.mesh.masses_kg([block.density_kg_per_m3 for block in self.soft_row.blocks])


@contextmanager
def _mesh_given(mesh: TetrahedralMesh) -> Iterator[None]:
    """Let Genesis take the elements of a mesh instead of making its own."""
    from genesis.utils import element

    made, split = element.mesh_to_elements, element.split_all_surface_tets
    # Genesis orders the nodes of an element the other way round.
    element.mesh_to_elements = lambda *_, **__: (mesh.points_m.copy(), mesh.tetrahedra.copy())
    element.split_all_surface_tets = lambda points, elements: (points, elements)
    try:
        yield
    finally:
        element.mesh_to_elements, element.split_all_surface_tets = made, split


class FEMPart(DeformablePart):
    """All soft bodies of a scene.

    Material in a grip moves rigidly and is not simulated: the mesh spans the free material and has its mass.

    Args:
        scene: The scene.
        settings: Numerical settings.
    """

    def __init__(self, scene: Scene, settings: SettingsFEM) -> None:
        self._scene = scene
        self._settings = settings
        cell_m = settings.cell_m or SOFT_CELL_M
        rows = [_Row(scene, bodies, cell_m) for bodies in bonded_soft_bodies(scene)]
        self._rows = {block.body.name: row for row in rows for block in row.soft_row.blocks}
        self._unique = rows
        self.names = tuple(self._rows)
        self._kernels: Any = None
        self._start: tuple[NDArray[Any], NDArray[Any]] = (np.zeros((0, 3)), np.zeros((0, 3)))
        self._pins: dict[str, tuple[NDArray[np.int32], NDArray[np.float64]]] = {}
        self._planned: dict[str, tuple[NDArray[np.int32], NDArray[Any]]] = {}

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
            "coupler_options": gs.options.LegacyCouplerOptions(rigid_fem=bool(self.touches())),
        }

    def touches(self) -> Mapping[str, float]:
        """Return the friction of the rigid bodies that collide with soft bodies, by name."""
        return touching_bodies(self._scene, self.names)

    def touch_margin_m(self) -> float:
        """Return by how much the geoms that touch the nodes exceed their bodies [m]."""
        return self._settings.contact_margin_m

    def add(self, scene: Any) -> None:
        """Add the entities, and set how rigid bodies act on their nodes."""
        couple_only_marked_geoms(scene)
        set_coupling(scene, self._scene, self.touches(), self._settings.contact_softness_m)
        with tempfile.TemporaryDirectory() as folder:
            for row in self._unique:
                row.add(scene, Path(folder))

    def finish(self, scene: Any) -> None:
        """Set the constants of the elements, the masses and the held nodes."""
        from gauge_envs.backends.genesis.foam_kernels import FEMKernels

        gs = engine()
        solver = scene.sim.fem_solver
        constants = [row.constants() for row in self._unique]
        for field, place in ((solver.elements_i.mu, 0), (solver.elements_i.lam, 1)):
            field.from_numpy(np.concatenate([pair[place] for pair in constants]).astype(gs.np_float))
        masses = np.concatenate([row.masses_kg() for row in self._unique])
        information = solver.elements_v_info
        information.mass.from_numpy(masses.astype(gs.np_float))
        information.mass_inv.from_numpy((1.0 / masses).astype(gs.np_float))
        information.mass_over_dt2.from_numpy((masses / self._settings.timestep_s**2).astype(gs.np_float))
        self._kernels = FEMKernels(scene)
        for row in self._unique:
            for attachment, nodes in row.soft_row.gripped(row.mesh.points_m):
                row.entity.set_vertex_constraints(nodes, row.mesh.points_m[nodes].astype(gs.np_float))
                if attachment.motion is Motion.KINEMATIC:
                    places = attachment.pose.to_body(row.mesh.points_m[nodes])
                    known = self._pins.get(attachment.body, (np.zeros(0, np.int32), np.zeros((0, 3))))
                    indices = (row.nodes.start + nodes).astype(np.int32)
                    self._pins[attachment.body] = (
                        np.concatenate([known[0], indices]),
                        np.concatenate([known[1], places]),
                    )
        points = np.concatenate([row.mesh.points_m for row in self._unique]).astype(gs.np_float)
        self._start = points, np.zeros_like(points)

    def reset(self) -> None:
        """Return the nodes to their start."""
        self._kernels.write(*self._start)
        self._planned = {}

    def prescribe(self, motions: Motions, time_s: float, step_s: float) -> None:
        """Set where held nodes are at the end of the step."""
        gs = engine()
        if time_s == 0.0:
            times = step_s * np.arange(1, round(self._settings.drive_interval_s / step_s) + 1)
            self._planned = {
                body: (nodes, np.ascontiguousarray(driven_places(motions[body], places, times), dtype=gs.np_float))
                for body, (nodes, places) in self._pins.items()
            }
        step = round(time_s / step_s)
        for nodes, path in self._planned.values():
            self._kernels.hold(nodes, path[step])

    def nodes(self, name: str) -> NDArray[np.float64]:
        """Return the positions of a body's nodes [m], shape [node_count, 3]; bonded faces belong to both bodies."""
        row = self._rows[name]
        return self._positions(row)[row.nodes_of[name]]

    def track(self, name: str, points_m: NDArray[np.float64]) -> Callable[[], NDArray[np.float64]] | None:
        """Return a reader of material points, which interpolates linearly in each tetrahedron, as the elements do."""
        row = self._rows[name]
        corners, weights = row.mesh.weights(row.soft_row.checked(np.asarray(points_m, dtype=np.float64)))
        return lambda: np.asarray(np.einsum("pk,pki->pi", weights, self._positions(row)[corners]))

    def _positions(self, row: _Row) -> NDArray[np.float64]:
        positions: NDArray[np.float64] = self._read()[0][row.nodes].astype(np.float64)
        return positions

    def _read(self) -> tuple[NDArray[Any], NDArray[Any]]:
        positions, velocities = (np.empty((self._kernels.node_count, 3), dtype=engine().np_float) for _ in range(2))
        self._kernels.read(positions, velocities)
        return positions, velocities

    def state(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return positions [m] and velocities [m/s] of all nodes, both of shape [node_count, 3]."""
        return self._read()

    def restore(self, state: tuple[NDArray[Any], NDArray[Any]]) -> None:
        """Restore positions and velocities; the next interval prescribes the held nodes anew."""
        self._kernels.write(*state)
        self._planned = {}
