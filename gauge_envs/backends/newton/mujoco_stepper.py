"""Stepper of rigid bodies on Newton's MuJoCo solver (MuJoCo Warp)."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import newton
import numpy as np
import warp as wp
from mujoco_warp import contact_force
from newton.solvers import SolverMuJoCo

from gauge_envs.backends.newton.settings import SettingsMuJoCoWarp
from gauge_envs.backends.newton.stepper import Stepper
from gauge_envs.scene.geometry import FloatArray

CONTACT_POINTS_PER_PAIR = 8
"""Reserved contact points per pair of shapes; Newton reduces two faces in contact to four or five points."""

ROWS_PER_POINT = 4
"""Constraints of a contact point: four for the edges of a pyramidal cone, three for an elliptic cone."""

ROWS_PER_WELD = 6
"""Constraints of a driven body."""


class StepperMuJoCo(Stepper):
    """Stepper of rigid bodies with MuJoCo Warp.

    Args:
        model: The finalized model.
        driven: Indices of the kinematic bodies.
        settings: Settings of the solver.
    """

    def __init__(
        self,
        model: newton.Model,
        *,
        driven: Sequence[int],
        settings: SettingsMuJoCoWarp,
    ) -> None:
        pairs = model.shape_contact_pair_count // model.world_count
        tendons = model.custom_frequency_counts.get("mujoco:tendon", 0)
        rows = ROWS_PER_POINT * CONTACT_POINTS_PER_PAIR * pairs
        rows += ROWS_PER_WELD * len(driven) + tendons // model.world_count
        with warnings.catch_warnings():
            # Newton 1.8 asks for MuJoCo 3.17, but this package needs 4.0; tests/backends/test_newton.py runs both.
            warnings.filterwarnings(
                "ignore", message="MuJoCo dependency version mismatch"
            )
            solver = SolverMuJoCo(
                model,
                solver="newton",
                integrator=settings.integrator,
                cone=settings.cone,
                jacobian=settings.jacobian,
                impratio=settings.impratio,
                iterations=settings.iterations,
                ls_iterations=settings.line_search_iterations,
                tolerance=settings.tolerance,
                # Otherwise Newton adds a weld for each body that could become kinematic, and many constraints.
                kinematic_switchable_roots=False,
                use_mujoco_contacts=settings.mujoco_contacts or not pairs,
                disable_contacts=not pairs,
                nconmax=CONTACT_POINTS_PER_PAIR * pairs or None,
                njmax=rows or None,
            )
        has_pipeline = pairs and not settings.mujoco_contacts
        self._pipeline = newton.CollisionPipeline(model) if has_pipeline else None
        self._contacts = self._pipeline.contacts() if self._pipeline else None
        super().__init__(model, solver, driven=driven, timestep_s=settings.timestep_s)

    def _complete(self, state: newton.State) -> None:
        newton.eval_ik(self.model, state, state.joint_q, state.joint_qd)

    def apply_wrench(self, body: int, wrenches: FloatArray) -> None:
        """Apply a force and a torque to a body; see `Simulation.apply_wrench`."""
        forces = self.states[0].body_f.numpy()
        forces.reshape(self.world_count, -1, 6)[:, body] = wrenches
        # Steps alternate between the two states, and each step reads the wrenches of its start state.
        for state in self.states:
            state.body_f.assign(forces)

    def touches(self) -> Iterator[tuple[int, int, int, FloatArray]]:
        """Yield the contacts of the last step: world, two shapes, and the force on the first [N], shape [3]."""
        data = self.solver.mjw_data
        count = int(data.nacon.numpy()[0])
        with wp.ScopedDevice(self.model.device):
            numbers = wp.array(np.arange(count), dtype=wp.int32)
            wrenches: Any = wp.zeros(count, dtype=wp.spatial_vector)
            contact_force(self.solver.mjw_model, data, numbers, True, wrenches)
        worlds = data.contact.worldid.numpy()[:count]
        geoms = data.contact.geom.numpy()[:count]
        shapes = self.solver.mjc_geom_to_newton_shape.numpy()[worlds[:, None], geoms]
        shapes %= self.model.shape_count // self.world_count
        forces_n = -wrenches.numpy()[:, :3].astype(np.float64)
        for world, (first, second), force_n in zip(
            worlds.tolist(), shapes.tolist(), forces_n, strict=True
        ):
            yield world, first, second, force_n

    def _step(self, state: newton.State, after: newton.State) -> None:
        self._prescribe(state.body_q, state.body_qd, counts=False)
        # This solver reads joint coordinates, so driven bodies are written to both bodies and joints.
        if self._driven_rows:
            newton.eval_ik(
                self.model,
                state,
                state.joint_q,
                state.joint_qd,
                body_flag_filter=newton.BodyFlags.KINEMATIC,
            )
        if self._pipeline is not None:
            self._pipeline.collide(state, self._contacts)
        self.solver.step(state, after, self.control, self._contacts, self.timestep_s)
        # The solver does not move driven bodies.
        self._prescribe(after.body_q, after.body_qd, steps_ahead=1)
