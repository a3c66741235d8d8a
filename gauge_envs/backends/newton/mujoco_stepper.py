"""Stepper of rigid bodies on Newton's MuJoCo solver (MuJoCo Warp)."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from functools import cache
from importlib import metadata
from typing import Any

import newton
import numpy as np
import warp as wp
from mujoco_warp import contact_force
from newton.solvers import SolverMuJoCo
from numpy.typing import NDArray

from gauge_envs.backends.newton.kernels import bodies_to_joints
from gauge_envs.backends.newton.settings import SettingsMuJoCoWarp
from gauge_envs.backends.newton.stepper import Stepper, collision_pipeline
from gauge_envs.backends.settings import check_kept
from gauge_envs.backends.shared.bundled import replaced

CONTACT_POINTS_PER_PAIR = 8
"""Reserved contact points per pair of shapes; Newton reduces two faces in contact to four or five points."""

ROWS_PER_POINT = 4
"""Constraints of a contact point: four for the edges of a pyramidal cone, three for an elliptic cone."""

ROWS_PER_WELD = 6
"""Constraints of a driven body."""

installed = cache(metadata.version)
"""Version of an installed package, which MuJoCo Warp reads from its files five times for each model."""


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
        pair_count = model.shape_contact_pair_count // model.world_count
        strings = (
            model.custom_frequency_counts.get("mujoco:tendon", 0) // model.world_count
        )
        with warnings.catch_warnings(), replaced(metadata, version=installed):
            # Newton 1.8 asks for MuJoCo 3.17, but this package needs 4.0; tests/backends/newton verify the combination.
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
                use_mujoco_contacts=settings.mujoco_contacts or not pair_count,
                disable_contacts=not pair_count,
                nconmax=CONTACT_POINTS_PER_PAIR * pair_count or None,
                njmax=ROWS_PER_POINT * CONTACT_POINTS_PER_PAIR * pair_count
                + ROWS_PER_WELD * len(driven)
                + strings
                or None,
            )
        option = solver.mjw_model.opt
        kept = {
            "iterations": option.iterations,
            "line_search_iterations": option.ls_iterations,
        }
        kept |= {
            "tolerance": float(option.tolerance.numpy()[0]),
            "impratio": float(option.impratio_invsqrt.numpy()[0]) ** -2,
        }
        check_kept("Newton", settings.model_dump(), kept)
        has_pipeline = pair_count and not settings.mujoco_contacts
        self._pipeline = collision_pipeline(model) if has_pipeline else None
        self._contacts = self._pipeline.contacts() if self._pipeline else None
        super().__init__(model, solver, driven=driven, timestep_s=settings.timestep_s)
        # This solver reads joint coordinates, so driven bodies are written to both bodies and joints.
        with wp.ScopedDevice(model.device):
            self._coordinates, self._freedoms = (
                wp.array(one, dtype=wp.int32) for one in self.free_joints(driven)[1:]
            )

    def free_joints(self, bodies: Sequence[int]) -> list[NDArray[np.int32]]:
        """Return indices of bodies, and of the first coordinate and the first velocity of their joints."""
        model = self.model
        joints = {
            body: joint for joint, body in enumerate(model.joint_child.numpy().tolist())
        }
        chosen = [joints[body] for body in bodies]
        found = [
            np.array(bodies, dtype=np.int32),
            model.joint_q_start.numpy()[chosen],
            model.joint_qd_start.numpy()[chosen],
        ]
        return [one.astype(np.int32) for one in found]

    def apply_wrench(self, body: int, wrench: NDArray[np.float64]) -> None:
        """Apply a force and a torque to a body; see `World.apply_wrench`."""
        # Steps alternate between the two states, and each step reads the wrenches of its start state.
        for state in self.states:
            given = wp.array(wrench[None], dtype=wp.spatial_vector, device="cpu")
            wp.copy(state.body_f, given, dest_offset=body)

    def touches(self) -> Iterator[tuple[int, int, NDArray[np.float64]]]:
        """Yield the contacts of the last step: two shapes, and the force on the first [N], shape [3]."""
        data = self.solver.mjw_data
        count = int(data.nacon.numpy()[0])
        with wp.ScopedDevice(self.model.device):
            numbers = wp.array(np.arange(count), dtype=wp.int32)
            wrenches: Any = wp.zeros(count, dtype=wp.spatial_vector)
            contact_force(self.solver.mjw_model, data, numbers, True, wrenches)
        geoms = data.contact.geom.numpy()[:count]
        shapes = self.solver.mjc_geom_to_newton_shape.numpy()[0][geoms]
        for (first, second), wrench in zip(
            shapes.tolist(), wrenches.numpy(), strict=True
        ):
            yield first, second, -wrench[:3].astype(np.float64)

    def _step(self, state: newton.State, after: newton.State) -> None:
        self._prescribe(state.body_q, state.body_qd, counts=False)
        if len(self._driven):
            wp.launch(
                bodies_to_joints,
                dim=len(self._driven),
                inputs=[
                    self._driven,
                    self._coordinates,
                    self._freedoms,
                    state.body_q,
                    state.body_qd,
                ],
                outputs=[state.joint_q, state.joint_qd],
                device=self.model.device,
            )
        if self._pipeline is not None:
            self._pipeline.collide(state, self._contacts)
        self.solver.step(state, after, self.control, self._contacts, self.timestep_s)
        # The solver does not move driven bodies.
        self._prescribe(after.body_q, after.body_qd, steps_ahead=1)
