"""Newton's vertex block descent (VBD) for deformable bodies: attached particles, contact constants, and the stepper.

Each step descends block by block (vertices of one colour at a time) towards the minimum of an implicit Euler step. The
remaining error falls with the number of iterations and, much faster, with the time step. It depends on the stiffness
at a vertex relative to its mass over the squared time step. Many short steps with few iterations are therefore cheaper
than few long steps with many.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import newton
import numpy as np
import warp as wp

from gauge_envs.backends.newton.contacts import SurfaceContacts
from gauge_envs.backends.newton.kernels import predict
from gauge_envs.backends.newton.parts import PinnedParticles, PinNewton
from gauge_envs.backends.newton.settings import SettingsLines, SettingsVBD
from gauge_envs.backends.newton.stepper import Stepper
from gauge_envs.scene.geometry import IntArray

SPEED_HEADROOM = 1.5
"""Assumed largest growth of the fastest particle's speed within an interval, in addition to free fall."""

LINE_GAP_M = 0.002
"""Distance from a shape at which Newton detects a contact in scenes of ropes and rods [m]."""


class _Solver(newton.solvers.SolverVBD):
    """Vertex block descent whose initial guess of a step uses the acceleration of the last step.

    Newton's initial guess is free fall. At rest it is wrong by g h^2, and few iterations remove only a part of that
    error. Cloth then sags as if it were softer: rayon by a fifth at 1440 Hz with 5 iterations. The last acceleration as
    a guess has no such error at rest and a smaller one in motion. It is unstable if the iterations remove less than
    about half of an error, see `ITERATIONS_PER_RATIO`.

    Args:
        model: The model.
        iterations: Descents in a step.
        predict: Whether to use the last acceleration; otherwise the guess is Newton's.
        given: Other settings of `newton.solvers.SolverVBD`.
    """

    def __init__(
        self, model: newton.Model, *, iterations: int, predict: bool, **given: Any
    ) -> None:
        super().__init__(model, iterations=iterations, **given)
        # Sum the contacts of each particle separately. Otherwise the order of the sum depends on the number of worlds,
        # and bodies that rest on cloth amplify its rounding error. The deterministic mode would prevent this too, but
        # its kernels take seconds to load on the CPU, where a single thread is deterministic anyway.
        self._particle_contact_use_gather = True
        self._predicts = predict
        self._last_qd = wp.zeros(
            model.particle_count, dtype=wp.vec3, device=model.device
        )

    def reset(
        self, state: newton.State, world_mask: wp.array | None = None, **given: Any
    ) -> None:
        """Forget the history of the last steps; see `newton.solvers.SolverVBD.reset`."""
        super().reset(state, world_mask=world_mask, **given)
        velocities = np.zeros((self.model.particle_count, 3))
        if world_mask is not None:
            kept = ~world_mask.numpy()[:-1, None]
            velocities += self._last_qd.numpy()
            velocities *= np.repeat(kept, len(velocities) // len(kept), axis=0)
        self._last_qd.assign(velocities)

    def _initialize_particles(
        self,
        state_in: newton.State,
        state_out: newton.State,
        contacts: newton.Contacts | None,
        dt: float,
    ) -> None:
        super()._initialize_particles(state_in, state_out, contacts, dt)
        if not self._predicts or not self.model.particle_count:
            return
        wp.launch(
            predict,
            dim=self.model.particle_count,
            inputs=[
                dt,
                state_in.particle_qd,
                self.model.particle_inv_mass,
                self._last_qd,
            ],
            outputs=[self.particle_displacements],
            device=self.model.device,
        )
        self._penetration_free_truncation(state_in, contacts)


class StepperVBD(Stepper):
    """Stepper of particles and dynamic rigid bodies with `newton.solvers.SolverVBD`.

    An implicit step needs the prescribed motion at its end. Driven bodies and the particles attached to them therefore
    first move to their positions at the end of the step.

    Args:
        model: The finalized, coloured model.
        driven: Indices of the kinematic bodies.
        settings: Settings of the solver. Ropes and rods have no particles, so they use only some of them.
        pins: Particles that are attached to kinematic bodies.
        contacts: Collision partners and friction of particles.
        contact_stiffness_n_per_m: Contact stiffness of a particle against a rigid shape or another surface of
            particles. Newton averages it with that of the shape, which is set to the same value.
        passing: Pairs of a particle and a shape that do not collide, shape [pair_count, 2]. The model then needs an
            inactive particle, and only vertices may collide.
    """

    def __init__(
        self,
        model: newton.Model,
        *,
        driven: Sequence[int],
        settings: SettingsVBD | SettingsLines,
        pins: Sequence[PinNewton] = (),
        contacts: SurfaceContacts | None = None,
        contact_stiffness_n_per_m: float = 1e3,
        passing: IntArray | None = None,
    ) -> None:
        surfaces = settings if isinstance(settings, SettingsVBD) else None
        contacts = contacts or SurfaceContacts()
        model.soft_contact_mu = contacts.friction
        model.soft_contact_ke = contact_stiffness_n_per_m
        model.soft_contact_kd = settings.contact_damping_n_s_per_m
        if model.shape_count:
            model.shape_material_ke.fill_(contact_stiffness_n_per_m)
            model.shape_material_kd.fill_(settings.contact_damping_n_s_per_m)
        self._integrates_bodies = model.body_count > model.world_count * len(driven)
        self._self_contact = surfaces if contacts.itself else None
        solver = _Solver(
            model,
            iterations=settings.iterations,
            predict=surfaces is not None and surfaces.starts_from_acceleration,
            friction_epsilon=settings.friction_speed_m_per_s,
            integrate_with_external_rigid_solver=not self._integrates_bodies,
            deterministic=wp.DeterministicMode.RUN_TO_RUN
            if model.device.is_cuda
            else None,
            **_self_contact_arguments(self._self_contact),
        )
        super().__init__(model, solver, driven=driven, timestep_s=settings.timestep_s)
        self._pipeline = None
        if contacts.touched or self._integrates_bodies:
            self._pipeline = newton.CollisionPipeline(
                model,
                soft_contact_gap=surfaces.contact_gap_m if surfaces else LINE_GAP_M,
                enable_rigid_soft_full_surface_contact=surfaces is not None
                and surfaces.full_surface,
            )
            self._let_pass(self._pipeline, passing)
        self._contacts = self._pipeline.contacts() if self._pipeline else None
        self._pinned = PinnedParticles(pins, self)

    def _let_pass(
        self, pipeline: newton.CollisionPipeline, passing: IntArray | None
    ) -> None:
        """Exclude pairs of a particle and a shape from Newton's collision detection."""
        if passing is None or not len(passing):
            return
        # The number of pairs is fixed, so an inactive particle, which has no contacts, replaces the excluded particles.
        model, count = self.model, self.world_count
        active = model.particle_flags.numpy() & int(newton.ParticleFlags.ACTIVE)
        idle = int(np.flatnonzero(active == 0)[0])
        particles = self.in_worlds(passing[:, 0], model.particle_count // count)
        shapes = self.in_worlds(passing[:, 1], model.shape_count // count)
        number_of = (model.shape_count, 1)
        excluded = np.column_stack([particles, shapes]) @ number_of
        pairs = pipeline.soft_rigid_contact_pairs.numpy()
        pairs[np.isin(pairs @ number_of, excluded), 0] = idle
        pipeline.soft_rigid_contact_pairs.assign(pairs)

    def _step(self, state: newton.State, after: newton.State) -> None:
        # Without dynamic bodies, the solver reads the poses at both ends of the step from the two states.
        ahead = state if self._integrates_bodies else after
        self._prescribe(ahead.body_q, ahead.body_qd, steps_ahead=1)
        self._pinned.hold(ahead.body_q, state.particle_q)
        if self._pipeline is not None:
            self._pipeline.collide(state, self._contacts)
        self.solver.step(state, after, self.control, self._contacts, self.timestep_s)

    def record(self) -> None:
        """Record the step in both directions, and again without self-contact if the scene has self-contact."""
        super().record()
        self._closed_graphs = self._open_graphs = self._graphs
        if self._self_contact is not None:
            # A graph keeps the value of this flag at its recording.
            self.solver.particle_enable_self_contact = False
            super().record()
            self._open_graphs = self._graphs
            self.solver.particle_enable_self_contact = True

    def advance(self, seconds: float) -> None:
        """Run the steps of an interval, without self-contact if no surfaces can touch in it."""
        may_meet = self._self_contact is not None and self._may_meet(seconds)
        self._graphs = self._closed_graphs if may_meet else self._open_graphs
        super().advance(seconds)

    def _may_meet(self, seconds: float) -> bool:
        """Return whether surfaces can touch in an interval [s]; self-contact takes half of the computing time."""
        assert self._self_contact is not None
        state = self.current_state
        speed = float(np.linalg.norm(state.particle_qd.numpy(), axis=1).max())
        if self._driven_rows:
            driven_speeds = state.body_qd.numpy()[self._driven.numpy()]
            speed = max(speed, float(np.abs(driven_speeds).max()))
        displacement_m = (SPEED_HEADROOM * speed + 10.0 * seconds) * seconds
        radius_m = self._self_contact.self_contact_thickness_m + 2.0 * displacement_m
        detector = self.solver.trimesh_collision_detector
        detector.refit(state.particle_q)
        detector.vertex_triangle_collision_detection(radius_m)
        detector.edge_edge_collision_detection(radius_m)
        info = self.solver.trimesh_collision_info
        return bool(
            info.vertex_colliding_triangles_count.numpy().any()
            or info.edge_colliding_edges_count.numpy().any()
        )


def _self_contact_arguments(settings: SettingsVBD | None) -> dict[str, Any]:
    """Return the solver's arguments for contacts between surfaces; None disables them."""
    if settings is None:
        return {}
    slot = newton.solvers.SolverBase.CollisionSlot.SOFT_SELF_CONTACT
    return {
        "particle_enable_self_contact": True,
        "particle_self_contact_margin": settings.self_contact_thickness_m,
        "particle_self_contact_gap": settings.self_contact_reach_m,
        # One detection per step is enough if the reach covers the motion in a step; the default is two.
        "collision_frequency_type": {
            slot: newton.solvers.SolverBase.CollisionFrequencyType.PRE_INIT
        },
    }
