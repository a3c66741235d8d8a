"""Rigid scenes on Newton's MuJoCo solver (MuJoCo Warp), with contacts from Newton's own collision pipeline.

In single precision MuJoCo Warp's own normal between two boxes is off by more than a degree in 2 of 100 contacts that
are 1 to 10 um deep, in 8 that are 0.1 to 1 um deep, and in 56 below: cubes on a slope then scatter by up to 7 % about
Coulomb's acceleration. Newton's normals are good to 0.02 degrees, and the scatter is that of double precision.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import newton
import numpy as np
import warp as wp
from newton.solvers import SolverMuJoCo
from numpy.typing import NDArray

from gauge_envs.backends.newton.contacts import FRICTION_AS_NORMAL, ShapeConstants, carried_constants, pair_constants
from gauge_envs.backends.newton.kernels import bodies_to_joints
from gauge_envs.backends.newton.rigid import RigidIndex, keep_apart
from gauge_envs.backends.newton.settings import SettingsMuJoCoWarp
from gauge_envs.backends.newton.stepper import Stepper
from gauge_envs.scene import Scene

__all__ = [
    "LoopMuJoCo",
    "add_contacts",
    "shape_config",
]

CONTACT_POINTS_PER_PAIR = 8
"""Room for the contact points of a pair of shapes; Newton reduces a face on a face to four or five."""

ROWS_PER_POINT = 4
"""Constraints of a contact point: four edges of a pyramidal cone, or three of an elliptic one."""

ROWS_PER_WELD = 6
"""Constraints that hold a driven body."""

SOLIMP_SHAPE = (0.5, 2.0)
"""Midpoint and power of the impedance curve, MuJoCo's own; without effect where the impedance is constant."""

NO_FRICTION = 2e-5
"""Just above the least coefficient that MuJoCo Warp accepts, of shapes whose contacts are carried by others."""

SOLREF_AS_GIVEN = 1
"""Newton's code of a shape whose `solref` is MuJoCo's own, and not made of its stiffness and damping."""

CONTACT_GAP_M = 0.002
"""Distance at which Newton starts to list a contact; more than anything goes in a step."""


def shape_config() -> newton.ModelBuilder.ShapeConfig:
    """Constants of a shape before `add_contacts`; without density, as masses are given."""
    return newton.ModelBuilder.ShapeConfig(
        density=0.0, gap=CONTACT_GAP_M, mu=NO_FRICTION, mu_torsional=0.0, mu_rolling=0.0, kf=FRICTION_AS_NORMAL
    )


def add_contacts(builder: newton.ModelBuilder, scene: Scene, index: RigidIndex, settings: SettingsMuJoCoWarp) -> None:
    """Give shapes the constants of their contacts, and keep all others apart."""
    pairs = pair_constants(scene, settings)
    for name, constants in carried_constants(pairs).items():
        for shape in index.shapes[name]:
            _carry(builder, shape, constants, newton_material=settings.newton_material)
    keep_apart(builder, scene, index)


def _carry(builder: newton.ModelBuilder, shape: int, constants: ShapeConstants, *, newton_material: bool) -> None:
    builder.shape_material_mu[shape] = max(constants.friction, NO_FRICTION)
    attributes: dict[str, Any] = {"condim": 3 if constants.friction > 0.0 else 1, "geom_priority": 1}
    if newton_material:
        builder.shape_material_kf[shape] = newton.ModelBuilder.ShapeConfig().kf
    else:
        builder.shape_material_kf[shape] = constants.friction_gain_n_s_per_m
        attributes |= {
            "solref": wp.vec2(*constants.solref),
            "solref_mode": SOLREF_AS_GIVEN,
            "geom_solimp": wp.types.vector(5, wp.float32)(*constants.solimp, *SOLIMP_SHAPE),
        }
    for key, value in attributes.items():
        attribute = builder.custom_attributes[f"mujoco:{key}"]
        attribute.values = (attribute.values or {}) | {shape: value}


class LoopMuJoCo(Stepper):
    """Steps rigid bodies with MuJoCo Warp, which finds the contacts itself.

    Args:
        model: The finalized model.
        driven: Indices of the kinematic bodies.
        settings: Settings of the solver.
    """

    def __init__(self, model: newton.Model, *, driven: Sequence[int], settings: SettingsMuJoCoWarp) -> None:
        pair_count = model.shape_contact_pair_count // model.world_count
        with warnings.catch_warnings():
            # Newton 1.8 asks for MuJoCo 3.17. This package needs 4.0, and the laws hold with it (tests).
            warnings.filterwarnings("ignore", message="MuJoCo dependency version mismatch")
            solver = SolverMuJoCo(
                model,
                solver="newton",
                integrator=settings.integrator,
                cone=settings.cone,
                impratio=settings.impratio,
                iterations=settings.iterations,
                ls_iterations=settings.line_search_iterations,
                tolerance=settings.tolerance,
                # A weld for each body that could become kinematic would multiply the constraints.
                kinematic_switchable_roots=False,
                use_mujoco_contacts=not pair_count,
                disable_contacts=not pair_count,
                nconmax=CONTACT_POINTS_PER_PAIR * pair_count or None,
                njmax=ROWS_PER_POINT * CONTACT_POINTS_PER_PAIR * pair_count + ROWS_PER_WELD * len(driven) or None,
            )
        self._pipeline = newton.CollisionPipeline(model) if pair_count else None
        self._contacts = self._pipeline.contacts() if self._pipeline else None
        super().__init__(model, solver, driven=driven, timestep_s=settings.timestep_s)
        # This solver reads joints, not bodies: a driven body is written to both.
        joints = {body: joint for joint, body in enumerate(model.joint_child.numpy().tolist())}
        starts = [model.joint_q_start.numpy(), model.joint_qd_start.numpy()]
        with wp.ScopedDevice(model.device):
            self._coordinates, self._freedoms = (
                wp.array(np.array([start[joints[body]] for body in driven], dtype=np.int32), dtype=wp.int32)
                for start in starts
            )

    def apply_wrench(self, body: int, wrench: NDArray[np.float64]) -> None:
        """Force and torque on a body; see `World.apply_wrench`."""
        # Steps go to and fro between the two states, and each reads the wrenches of the one that it starts from.
        for state in self._states:
            wrenches = state.body_f.numpy()
            wrenches[body] = wrench
            state.body_f.assign(wrenches)

    def _step(self, state: newton.State, after: newton.State) -> None:
        self._prescribe(state.body_q, state.body_qd, counts=False)
        if self._rows:
            wp.launch(
                bodies_to_joints,
                dim=len(self._rows),
                inputs=[self._driven, self._coordinates, self._freedoms, state.body_q, state.body_qd],
                outputs=[state.joint_q, state.joint_qd],
                device=self.model.device,
            )
        if self._pipeline is not None:
            self._pipeline.collide(state, self._contacts)
        self.solver.step(state, after, self._control, self._contacts, self.timestep_s)
        # The solver leaves a driven body where the step found it.
        self._prescribe(after.body_q, after.body_qd, steps_ahead=1)
