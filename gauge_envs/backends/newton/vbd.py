"""Newton's vertex block descent for deformable bodies: held particles, contact constants, and the loop.

Each step descends block by block (vertices of one colour at a time) towards the minimum of an implicit Euler step. The
error that is left falls with iterations and, much faster, with the step: the stiffness that a vertex sees is weighed
against its mass over the step squared. Many short steps with few iterations are therefore cheaper than the converse.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, sqrt
from typing import Any

import newton
import numpy as np
import warp as wp
from numpy.typing import NDArray

from gauge_envs.backends.newton.kernels import hold, predict
from gauge_envs.backends.newton.stability import ITERATIONS_PER_RATIO
from gauge_envs.backends.newton.stepper import Stepper
from gauge_envs.backends.newton.surface import SurfaceContacts
from gauge_envs.errors import ParameterError

__all__ = [
    "LoopVBD",
    "Pin",
    "SelfContact",
    "apply_contacts",
    "passing_pairs",
    "stiffness_ratio",
]

SPEED_HEADROOM = 1.5
"""Factor on the fastest particle's speed within which no particle is at the end of an interval, beside free fall."""


@dataclass(frozen=True, kw_only=True)
class Pin:
    """A particle without mass of its own that a moving rigid body holds.

    Attributes:
        particle: Its index in the model.
        body: Index of the body; one that no force moves.
        place_m: Where it is in the body's frame [m].
    """

    particle: int
    body: int
    place_m: tuple[float, float, float]


def apply_contacts(
    contacts: SurfaceContacts, builder: newton.ModelBuilder, shapes: Mapping[str, Sequence[int]]
) -> None:
    """Write friction and collision flags of the shapes of each rigid body, by its name, into a builder."""
    for name, indices in shapes.items():
        for shape in indices:
            if name in contacts.shape_friction:
                builder.shape_material_mu[shape] = contacts.shape_friction[name]
            flag = int(newton.ShapeFlags.COLLIDE_PARTICLES)
            flags = int(builder.shape_flags[shape]) & ~flag
            builder.shape_flags[shape] = flags | flag if name in contacts.touched else flags


def passing_pairs(
    contacts: SurfaceContacts, particles: Mapping[str, NDArray[np.intp]], shapes: Mapping[str, Sequence[int]]
) -> NDArray[np.intp]:
    """Particles and shapes that pass through each other although others of either do not.

    Args:
        contacts: What collides.
        particles: Indices in the model of each body's particles, by its name; one on a bonded face is of both bodies,
            and collides with what either does.
        shapes: Indices of the shapes of each rigid body, by its name.

    Returns:
        Index of a particle and of a shape, shape [pair_count, 2].
    """
    pairs = [np.zeros((0, 2), dtype=np.intp)]
    for rigid, through in contacts.passed.items():
        held = [indices for name, indices in particles.items() if name not in through]
        free = np.setdiff1d(np.concatenate([particles[name] for name in through]), np.concatenate(held))
        pairs.extend(np.column_stack([free, np.full_like(free, shape)]) for shape in shapes[rigid])
    return np.concatenate(pairs)


# --- stepping --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class SelfContact:
    """How surfaces made of particles keep apart.

    Attributes:
        thickness_m: Distance at which they start to push; well below the mesh's edges.
        reach_m: Further distance at which pairs are found. Newton cuts every particle's motion between two detections
            to 0.425 of both together, so the fastest particle must stay below that in a step.
    """

    thickness_m: float
    reach_m: float


class _Solver(newton.solvers.SolverVBD):
    """Vertex block descent that starts each step where the last one's acceleration leads.

    Newton starts from free fall. What is at rest is then g h^2 away from where a step must end, and the part of this
    that few iterations leave over makes cloth sag as if it were softer: rayon by a fifth at 1440 Hz with 5 iterations.
    Starting with the last acceleration has no such error at rest and a smaller one in motion. It is unstable where
    iterations remove less than about half of an error, see `ITERATIONS_PER_RATIO`.

    Args:
        model: The model.
        iterations: Descents in a step.
        predict: Whether to do so; otherwise it is Newton's own.
        given: Further settings of `newton.solvers.SolverVBD`.
    """

    def __init__(self, model: newton.Model, *, iterations: int, predict: bool, **given: Any) -> None:
        super().__init__(model, iterations=iterations, **given)
        # Adds up each particle's contacts by themselves. Otherwise, unless the mode is deterministic, the order depends
        # on the number of worlds, and what rests on cloth makes much of a rounding. The mode itself would do, but its
        # kernels take seconds to load on a CPU, whose one thread always does the same.
        self._particle_contact_use_gather = True
        self._predicts = predict
        self._last_qd = wp.zeros(model.particle_count, dtype=wp.vec3, device=model.device)

    def _initialize_particles(
        self, state_in: newton.State, state_out: newton.State, contacts: newton.Contacts | None, dt: float
    ) -> None:
        super()._initialize_particles(state_in, state_out, contacts, dt)
        if not self._predicts or not self.model.particle_count:
            return
        wp.launch(
            predict,
            dim=self.model.particle_count,
            inputs=[dt, state_in.particle_qd, self.model.particle_inv_mass, self._last_qd],
            outputs=[self.particle_displacements],
            device=self.model.device,
        )
        self._penetration_free_truncation(state_in, contacts)


def stiffness_ratio(model: newton.Model, timestep_s: float) -> float:
    """Largest ratio of the elastic to the inertial stiffness of a vertex, others held, in the shape at the start.

    The elastic one is, of each membrane and tetrahedron, its P wave modulus times volume times the squared gradient of
    the vertex's shape function; of each hinge its stiffness times the squared gradient of its angle.
    """
    stiffness = np.zeros(model.particle_count)
    if model.tri_count:
        shear, lame = model.tri_materials.numpy()[:, :2].astype(np.float64).T
        modulus = (lame + 2.0 * shear) * model.tri_areas.numpy()
        _add_stiffness(stiffness, model.tri_indices.numpy(), model.tri_poses.numpy(), modulus)
    if model.tet_count:
        shear, lame = model.tet_materials.numpy()[:, :2].astype(np.float64).T
        poses = model.tet_poses.numpy().astype(np.float64)
        modulus = (lame + 2.0 * shear) / (6.0 * np.abs(np.linalg.det(poses)))
        _add_stiffness(stiffness, model.tet_indices.numpy(), poses, modulus)
    if model.edge_count:
        _add_hinges(stiffness, model)
    inverse_masses = model.particle_inv_mass.numpy().astype(np.float64)
    return float(timestep_s**2 * (stiffness * inverse_masses).max(initial=0.0))


def _add_stiffness(
    total: NDArray[np.float64], elements: NDArray[Any], poses: NDArray[Any], modulus: NDArray[np.float64]
) -> None:
    """Add each element's share at its vertices; rows of a pose are gradients of all but the first shape function."""
    later = np.asarray(poses, dtype=np.float64)
    gradients = np.concatenate([-later.sum(axis=1, keepdims=True), later], axis=1)
    np.add.at(total, elements, modulus[:, None] * np.square(gradients).sum(axis=-1))


def _add_hinges(total: NDArray[np.float64], model: newton.Model) -> None:
    edges = model.edge_indices.numpy()
    inner = (edges[:, :2] >= 0).all(axis=1)
    points = model.particle_q.numpy().astype(np.float64)[edges[inner]]
    along = points[:, 3] - points[:, 2]
    lengths = np.linalg.norm(along, axis=1)
    gradients = np.zeros((len(points), 4))
    for opposite in (0, 1):
        arm = points[:, opposite] - points[:, 2]
        foot = (arm * along).sum(axis=1) / lengths**2
        slope = 1.0 / np.linalg.norm(arm - foot[:, None] * along, axis=1)
        gradients[:, opposite] = slope
        gradients[:, 2] += (1.0 - foot) * slope
        gradients[:, 3] += foot * slope
    stiffness = model.edge_bending_properties.numpy()[inner, 0] * lengths
    np.add.at(total, edges[inner], stiffness[:, None] * np.square(gradients))


class LoopVBD(Stepper):
    """Steps particles, and dynamic rigid bodies if there are any, with `newton.solvers.SolverVBD`.

    An implicit step wants what is prescribed at its end: driven bodies are put there first, and with them the
    particles that they hold.

    Args:
        model: The finalized, coloured model.
        driven: Indices of the kinematic bodies.
        pins: Particles that moving bodies hold.
        timestep_s: Step [s].
        iterations: Descents over all colours in a step.
        predict: Whether a step starts where the last one's acceleration leads, and not in free fall as Newton has it:
            cloth then has its full stiffness with a third of the iterations.
        contacts: What particles touch.
        contact_stiffness_n_per_m: Penalty of a particle against a rigid shape or another particle's surface. Newton
            averages this and the shape's own; `Model.shape_material_ke` is set to the same.
        contact_damping_n_s_per_m: Damping while a contact closes, set on both sides likewise. Newton counts it to the
            normal force but not to the load of friction, so chattering contacts lose friction by it.
        contact_gap_m: Distance from a shape at which a particle's contact is found; more than it goes in a step.
        full_surface: Whether edges and faces of a mesh collide with shapes, and not its vertices alone: for bodies
            narrower than the mesh. Several contacts then share a load, and friction takes ten iterations to come right.
        passing: Particles and shapes that do not collide, from `passing_pairs`, shape [pair_count, 2]. The model needs
            a particle that is not active, which stands for each of these in the solver's list of pairs.
        friction_speed_m_per_s: Speed of sliding from which friction is that of Coulomb; below, it falls to zero.
        self_contact: How surfaces keep apart; None lets them pass through each other, whatever `contacts` say.

    Raises:
        ParameterError: The last acceleration is to be used and iterations are too few for that.
    """

    def __init__(
        self,
        model: newton.Model,
        *,
        driven: Sequence[int],
        pins: Sequence[Pin] = (),
        timestep_s: float,
        iterations: int,
        predict: bool = False,
        contacts: SurfaceContacts | None = None,
        contact_stiffness_n_per_m: float = 1e3,
        contact_damping_n_s_per_m: float = 0.0,
        contact_gap_m: float = 0.002,
        full_surface: bool = False,
        passing: NDArray[np.intp] | None = None,
        friction_speed_m_per_s: float = 1e-4,
        self_contact: SelfContact | None = None,
    ) -> None:
        if predict:
            _check_iterations(model, timestep_s=timestep_s, iterations=iterations)
        contacts = contacts or SurfaceContacts()
        model.soft_contact_mu = contacts.friction
        model.soft_contact_ke = contact_stiffness_n_per_m
        model.soft_contact_kd = contact_damping_n_s_per_m
        self._integrates_bodies = _has_dynamic_bodies(model)
        if model.shape_count:
            model.shape_material_ke.fill_(contact_stiffness_n_per_m)
            model.shape_material_kd.fill_(contact_damping_n_s_per_m)
        self._pipeline = None
        if contacts.touched or self._integrates_bodies:
            self._pipeline = newton.CollisionPipeline(
                model, soft_contact_gap=contact_gap_m, enable_rigid_soft_full_surface_contact=full_surface
            )
            if passing is not None and len(passing):
                assert not full_surface
                _let_pass(self._pipeline, passing)
        self._contacts = self._pipeline.contacts() if self._pipeline else None
        self._self_contact = self_contact if contacts.itself else None
        solver = _Solver(
            model,
            iterations=iterations,
            predict=predict,
            friction_epsilon=friction_speed_m_per_s,
            integrate_with_external_rigid_solver=not self._integrates_bodies,
            deterministic=wp.DeterministicMode.RUN_TO_RUN if model.device.is_cuda else None,
            **_self_contact_settings(self._self_contact),
        )
        super().__init__(model, solver, driven=driven, timestep_s=timestep_s)
        with wp.ScopedDevice(model.device):
            self._held = wp.array([pin.particle for pin in pins], dtype=wp.int32)
            self._holders = wp.array([pin.body for pin in pins], dtype=wp.int32)
            self._places = wp.array([pin.place_m for pin in pins], dtype=wp.vec3)
        self._open_graphs: list[Any] = []
        self._closed_graphs: list[Any] = []

    def _step(self, state: newton.State, after: newton.State) -> None:
        # Where no body moves under forces the solver takes poses at both ends of the step from the two states.
        ahead = state if self._integrates_bodies else after
        self._prescribe(ahead.body_q, ahead.body_qd, steps_ahead=1)
        if self._held.size:
            wp.launch(
                hold,
                dim=self._held.size,
                inputs=[self._held, self._holders, self._places, ahead.body_q],
                outputs=[state.particle_q],
                device=self.model.device,
            )
        if self._pipeline is not None:
            self._pipeline.collide(state, self._contacts)
        self.solver.step(state, after, self._control, self._contacts, self.timestep_s)

    def record(self) -> None:
        """Record the step in both directions, with and without self-contact where there is any."""
        super().record()
        self._closed_graphs = self._graphs
        if self._self_contact is None:
            return
        # The solver reads this in every step that it runs, so a graph keeps the value that it was recorded with.
        self.solver.particle_enable_self_contact = False
        self._graphs = []
        super().record()
        self._open_graphs = self._graphs
        self.solver.particle_enable_self_contact = True

    def advance(self, seconds: float) -> None:
        """Replay the recorded step, without self-contact as long as nothing can meet in this interval."""
        if self._self_contact is not None:
            self._graphs = self._closed_graphs if self._may_meet(seconds) else self._open_graphs
        super().advance(seconds)

    def _may_meet(self, seconds: float) -> bool:
        """Whether surfaces can come within their thickness in an interval: half of this model's cost hangs on it."""
        assert self._self_contact is not None
        now = self.now
        speed = float(np.sqrt(np.square(now.particle_qd.numpy()).sum(axis=1).max()))
        if self._rows:
            speed = max(speed, float(np.abs(now.body_qd.numpy()[list(self._rows)]).max()))
        way = (SPEED_HEADROOM * speed + 10.0 * seconds) * seconds
        radius = self._self_contact.thickness_m + 2.0 * way
        detector = self.solver.trimesh_collision_detector
        detector.refit(now.particle_q)
        detector.vertex_triangle_collision_detection(radius)
        detector.edge_edge_collision_detection(radius)
        info = self.solver.trimesh_collision_info
        return bool(
            info.vertex_colliding_triangles_count.numpy().any() or info.edge_colliding_edges_count.numpy().any()
        )


def _check_iterations(model: newton.Model, *, timestep_s: float, iterations: int) -> None:
    needed = ITERATIONS_PER_RATIO * stiffness_ratio(model, timestep_s)
    if iterations < needed:
        raise ParameterError(
            f"{iterations} iterations of vertex block descent at 1/{1.0 / timestep_s:.6g} s are too few for this "
            f"stiffness and mesh: take {ceil(needed)}, or 1/{ceil(sqrt(needed / iterations) / timestep_s)} s"
        )


def _let_pass(pipeline: newton.CollisionPipeline, passing: NDArray[np.intp]) -> None:
    """Take pairs of a particle and a shape out of those that Newton looks at."""
    # The number of pairs is fixed when the pipeline is made, but a particle that is not active touches nothing.
    model = pipeline.model
    idle = int(np.flatnonzero((model.particle_flags.numpy() & int(newton.ParticleFlags.ACTIVE)) == 0)[0])
    pairs = pipeline.soft_rigid_contact_pairs.numpy()
    pairs[np.isin(pairs @ (model.shape_count, 1), passing @ (model.shape_count, 1)), 0] = idle
    pipeline.soft_rigid_contact_pairs.assign(pairs)


def _has_dynamic_bodies(model: newton.Model) -> bool:
    if not model.body_count:
        return False
    kinematic = model.body_flags.numpy() & int(newton.BodyFlags.KINEMATIC)
    return bool((kinematic == 0).any())


def _self_contact_settings(self_contact: SelfContact | None) -> dict[str, Any]:
    if self_contact is None:
        return {}
    slot = newton.solvers.SolverBase.CollisionSlot.SOFT_SELF_CONTACT
    return {
        "particle_enable_self_contact": True,
        "particle_self_contact_margin": self_contact.thickness_m,
        "particle_self_contact_gap": self_contact.reach_m,
        # Once a step is enough where the reach covers a step's motion; the default detects twice.
        "collision_frequency_type": {slot: newton.solvers.SolverBase.CollisionFrequencyType.PRE_INIT},
    }
