"""Cloth by Genesis's position-based dynamics: springs between particles, and hinges between triangles.

Genesis's solver has no multipliers. Each iteration closes a spring by the share 1 / (w + a): w are the inverse masses,
and a is the compliance over the squared step. In equilibrium, with one iteration, the spring's force is therefore its
extension over (w h^2 + compliance). With the compliance 1 / k - w h^2 the stiffness is k, at every step. The same
iteration is then the semi-implicit Euler method with forces at x + h v, the end of a step without forces. A vibration w
decays at the rate w^2 h / 2, as with a viscosity of the relaxation time h. It grows only if (w h)^2 exceeds 4 / 3.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from gauge_envs.backends.genesis.engine import engine
from gauge_envs.backends.genesis.fabrics import pbd_constants
from gauge_envs.backends.genesis.parts import (
    DeformablePart,
    PinGenesis,
    particle_positions_m,
)
from gauge_envs.backends.genesis.settings import (
    CLOTH_CELL_M,
    SettingsPBD,
    cloth_cell_m,
    grid_springs,
    grid_stiffnesses,
)
from gauge_envs.backends.shared.attachments import RigidAttachment, rigid_attachments
from gauge_envs.backends.shared.bundled import replaced
from gauge_envs.backends.shared.cloth_grid import ClothGrid
from gauge_envs.errors import ParameterError
from gauge_envs.scene import Cloth, Motion, Pose, Scene
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.geometry import FloatArray, IntArray

ROOM_M = 20.0
"""Distance from the cloth to the walls of the domain, which every Genesis particle has [m]."""

HASH_CELLS = 16
"""Cells of the hash grid along each axis. The grid repeats itself, and its clearing would dominate the cost."""

EDGE_SHARE = 1e-4
"""Distance from an attached region at which a particle belongs to it, over the size of the cloth."""


class _Sheet:
    """One cloth among the particles.

    Attributes:
        cloth: The cloth.
        grid: Its regular mesh.
        rest_m: World positions of the particles at the start [m], shape [particle_count, 3].
        entity: Its entity in the Genesis scene.
        clamped: Particles of each attached region, a partition of all attached ones.
    """

    def __init__(
        self,
        cloth: Cloth,
        attachments: Sequence[RigidAttachment],
        settings: SettingsPBD,
        cell_m: float,
    ):
        self.cloth = cloth
        self.grid = ClothGrid(cloth, cell_m)
        self.rest_m = self.grid.rest_m
        self.entity: Any = None
        self.clamped: list[tuple[RigidAttachment, IntArray]] = []
        self._attachments = attachments
        self._settings = settings

    @property
    def fixed(self) -> list[int]:
        """All attached particles."""
        return [particle for _, rows in self.clamped for particle in rows.tolist()]

    def add(self, model: Any, folder: Path) -> None:
        """Add the entity to a scene that is not built."""
        gs, settings = engine(), self._settings
        nominal = pbd_constants(Fabric.of(self.cloth)).constants
        material = gs.materials.PBD.Cloth(
            rho=self.cloth.areal_density_kg_per_m2,
            static_friction=0.0,
            kinetic_friction=0.0,
            stretch_compliance=nominal["stretch_compliance"],
            bending_compliance=nominal["bending_compliance"],
            stretch_relaxation=settings.stretch_relaxation,
            bending_relaxation=settings.bending_relaxation,
            air_resistance=settings.air_resistance,
        )
        path = folder / f"{self.cloth.name}.obj"
        mesh = trimesh.Trimesh(self.rest_m, self.grid.triangles, process=False)
        mesh.export(path, digits=17)
        is_grid = settings.mesh == "grid"
        from genesis.engine.mesh import Mesh

        with replaced(Mesh, remesh=(lambda *_, **__: None) if is_grid else Mesh.remesh):
            self.entity = model.add_entity(
                material=material, morph=gs.morphs.Mesh(file=str(path))
            )
        if is_grid:
            springs = grid_springs(self.grid)
            ends = self.grid.plane_m[springs]
            lengths_m = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
            self.entity._edges = springs.astype(gs.np_int)
            self.entity._edges_len_rest = lengths_m.astype(gs.np_float)
            self.entity._particles = self.rest_m.astype(gs.np_float)
        else:
            self.rest_m = np.asarray(self.entity._particles, dtype=np.float64)
        self._clamp()

    def _clamp(self) -> None:
        """Find the particles of each attached region; of several regions, the first applies."""
        local_m = self.cloth.pose.to_body(self.rest_m)
        is_free = np.ones(len(local_m), dtype=bool)
        for attachment in self._attachments:
            axis = "xy".index(attachment.region.axis)
            size_m = self.cloth.size_m[axis]
            from_low_m = local_m[:, axis] + 0.5 * size_m
            is_low = attachment.region.side == "low"
            inward_m = from_low_m if is_low else size_m - from_low_m
            inside = inward_m <= attachment.region.depth_m + EDGE_SHARE * size_m
            self.clamped.append((attachment, np.flatnonzero(inside & is_free)))
            is_free &= ~inside

    def masses_kg(self) -> FloatArray:
        """Return the masses of the particles [kg]: the area around each on a grid, equal ones otherwise."""
        if self._settings.mesh == "remeshed":
            count = len(self.rest_m)
            areas_m2 = np.full(
                count, self.cloth.size_m[0] * self.cloth.size_m[1] / count
            )
        else:
            areas_m2 = self.grid.vertex_areas_m2()
        return self.cloth.areal_density_kg_per_m2 * areas_m2

    def spring_compliances(self) -> FloatArray:
        """Return the compliance of each spring [m/N], shape [spring_count]."""
        springs = np.asarray(self.entity._edges, dtype=np.intp)
        if self._settings.stiffness == "nominal":
            return np.full(len(springs), 1.0 / self.cloth.stretch_stiffness_n_per_m)
        step_s = self._settings.timestep_s
        inverse = 1.0 / self.masses_kg()
        inverse[self.fixed] = 0.0
        stiffnesses = grid_stiffnesses(self.cloth, self.grid, springs)
        compliances = 1.0 / stiffnesses - inverse[springs].sum(axis=1) * step_s**2
        if np.any(compliances <= 0.0):
            raise ParameterError(
                f"Genesis setting 'timestep_s' is {step_s:.4g} s, and a spring of cloth {self.cloth.name!r} with cells "
                f"of {1e3 * max(self.grid.cell_m):.4g} mm would close in less than one step: choose a smaller "
                "timestep_s or a larger cell_m"
            )
        return compliances


class ClothPart(DeformablePart):
    """All cloths of a scene."""

    def __init__(self, scene: Scene, settings: SettingsPBD) -> None:
        cloths = [body for body in scene.deformables if isinstance(body, Cloth)]
        super().__init__(scene, [cloth.name for cloth in cloths])
        self._settings = settings
        self._cell_m = settings.cell_m or (
            cloth_cell_m(scene) if settings.mesh == "grid" else CLOTH_CELL_M
        )
        self._size_m = settings.particle_size_m or max(
            cloth.thickness_m for cloth in cloths
        )
        self._sheets = {
            cloth.name: _Sheet(
                cloth, rigid_attachments(scene, cloth.name), settings, self._cell_m
            )
            for cloth in cloths
        }

    def scene_options(self) -> dict[str, Any]:
        """Return the options of the PBD solver and of the coupling."""
        gs, settings = engine(), self._settings
        points = np.concatenate([sheet.rest_m for sheet in self._sheets.values()])
        hash_cell_m = max(1.25 * self._size_m, self._cell_m)
        is_remeshed = settings.mesh == "remeshed"
        return {
            "pbd_options": gs.options.PBDOptions(
                particle_size=settings.cell_m if is_remeshed else self._size_m,
                hash_grid_cell_size=hash_cell_m,
                hash_grid_res=(HASH_CELLS * hash_cell_m,) * 3,
                max_stretch_solver_iterations=settings.stretch_iterations,
                max_bending_solver_iterations=settings.bending_iterations,
                lower_bound=tuple((points.min(axis=0) - ROOM_M).tolist()),
                upper_bound=tuple((points.max(axis=0) + ROOM_M).tolist()),
            ),
            # Genesis cannot couple particles with bodies that have no geoms.
            "coupler_options": gs.options.LegacyCouplerOptions(
                rigid_pbd=bool(self.touches())
            ),
        }

    def add(self, model: Any) -> None:
        """Add the entities."""
        super().add(model)
        with tempfile.TemporaryDirectory() as folder:
            for sheet in self._sheets.values():
                sheet.add(model, Path(folder))

    def finish(self, model: Any) -> None:
        """Set masses, compliances and clamped particles, and insert the kernels between the solver's kernels."""
        from gauge_envs.backends.genesis.kernels import PBDKernels

        gs, settings = engine(), self._settings
        solver = model.sim.pbd_solver
        sheets = list(self._sheets.values())
        masses = np.concatenate([sheet.masses_kg() for sheet in sheets])
        solver.particles_info.mass.from_numpy(masses.astype(gs.np_float))
        compliances = np.concatenate([sheet.spring_compliances() for sheet in sheets])
        solver.edges_info.stretch_compliance.from_numpy(compliances.astype(gs.np_float))
        kernels = PBDKernels(model)
        if settings.exact_hinges and solver.n_inner_edges:
            counts = [sheet.entity.n_inner_edges for sheet in sheets]
            bend = [1.0 / sheet.cloth.bend_stiffness_n_m_per_rad for sheet in sheets]
            kernels.set_compliance(np.repeat(bend, counts))
            _call_before(solver, "_kernel_solve_bending", kernels.exact_hinges)
        if settings.body_friction and self.touches():
            self._add_friction(model, kernels)
        if settings.self_contact == "scene" and not self._touches_itself():
            # Genesis always collides particles, which takes more than a third of a step.
            solver._kernel_solve_collision = lambda _: None
        for sheet in sheets:
            if sheet.fixed:
                sheet.entity.fix_particles(sheet.fixed)
            for attachment, rows in sheet.clamped:
                if attachment.motion is Motion.KINEMATIC and len(rows):
                    self.pin(sheet.entity, rows, attachment, sheet.rest_m[rows])

    def _touches_itself(self) -> bool:
        """Return whether a contact of the scene is between cloth and cloth."""
        cloths = set(self.names)
        return any(
            cloths & {*contact.first} and cloths & {*contact.second}
            for contact in self._scene.contacts
        )

    def _add_friction(self, model: Any, kernels: Any) -> None:
        """Apply friction after the kernel that moves particles out of rigid bodies."""
        coupler = model.sim.coupler
        friction = np.zeros(model.sim.rigid_solver.n_geoms)
        for geom, value in self.coupled_geoms(model):
            friction[geom.idx] = value
        kernels.set_friction(friction)
        collide = coupler.kernel_pbd_rigid_collide

        def collide_and_rub(**arguments: Any) -> None:
            kernels.keep()
            collide(**arguments)
            kernels.rub(
                *(
                    arguments[name]
                    for name in ("geoms_state", "geoms_info", "links_state", "sdf_info")
                )
            )

        coupler.kernel_pbd_rigid_collide = collide_and_rub

    def reset(self, initial_states: FloatArray) -> None:
        """Place the unclamped cloths."""
        for sheet, state in zip(self._sheets.values(), initial_states, strict=True):
            if not sheet.fixed:
                x, y, z, qw, qx, qy, qz = state[:7].tolist()
                pose = Pose(position_m=(x, y, z), quaternion=(qw, qx, qy, qz))
                local_m = sheet.cloth.pose.to_body(sheet.rest_m)
                sheet.entity.set_particles_pos(pose.to_world(local_m))

    def pin_motion(
        self, pin: PinGenesis, path_m: FloatArray, spin: FloatArray
    ) -> tuple[FloatArray, ...]:
        """Place the particles, and return the velocities that move them with their body in each step."""
        pin.entity.set_particles_pos(path_m[0], pin.nodes)
        return (np.diff(path_m, axis=0) / self._settings.timestep_s,)

    def hold_pin(self, pin: PinGenesis, *arrays: NDArray[Any]) -> None:
        """Give the particles their velocities."""
        pin.entity.set_particles_vel(*arrays, pin.nodes)

    def nodes(self, name: str) -> FloatArray:
        """Return the positions of a cloth's particles [m], shape [particle_count, 3]."""
        return particle_positions_m(self._sheets[name].entity)


def _call_before(owner: Any, method: str, function: Any) -> None:
    """Replace a method of an object by one that calls a function first."""
    replaced = getattr(owner, method)

    def both(*arguments: Any) -> None:
        function()
        replaced(*arguments)

    setattr(owner, method, both)
