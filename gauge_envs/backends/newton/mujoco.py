"""Rigid scenes on Newton's MuJoCo solver (MuJoCo Warp), with contacts from Newton's collision pipeline.

The collision detection of MuJoCo Warp is used on request only (`mujoco_contacts`): its normals are inaccurate in single
precision. With mujoco_warp 4.0.0, of 400 poses of a cube on a leaning board, up to 0.8 % of the contacts that are 1 to
10 um deep are off by more than a degree, up to 1.2 % at a depth of 0.1 to 1 um, and 1 to 6 % at 0.01 to 0.1 um, some
by 90 degrees. A cube with a friction of 0.1 then slides down 30 degrees with 3.80 instead of 4.05 m/s^2. Newton's
normals are accurate to 0.02 degrees, and that cube has 4.055 m/s^2.
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
from gauge_envs.backends.newton.stepper import Stepper, collision_pipeline
from gauge_envs.scene import Scene

CONTACT_POINTS_PER_PAIR = 8
"""Reserved contact points per pair of shapes; Newton reduces two faces in contact to four or five points."""

ROWS_PER_POINT = 4
"""Constraints of a contact point: four for the edges of a pyramidal cone, three for an elliptic cone."""

ROWS_PER_WELD = 6
"""Constraints of a driven body."""

SOLIMP_SHAPE = (0.5, 2.0)
"""Midpoint and power of the impedance curve, MuJoCo's defaults; they have no effect on a constant impedance."""

NO_FRICTION = 2e-5
"""Friction of frictionless shapes and of those that carry no constants, just above MuJoCo Warp's smallest value."""

SOLREF_AS_GIVEN = 1
"""Newton's code for a shape whose `solref` is given, and not computed from its stiffness and damping."""

CONTACT_GAP_M = 0.002
"""Distance at which Newton detects a contact [m], more than the displacement of any body in one step."""


def shape_config() -> newton.ModelBuilder.ShapeConfig:
    """Return the constants of a shape before `add_contacts`; its density is zero because masses are given."""
    return newton.ModelBuilder.ShapeConfig(
        density=0.0, gap=CONTACT_GAP_M, mu=NO_FRICTION, mu_torsional=0.0, mu_rolling=0.0, kf=FRICTION_AS_NORMAL
    )


def add_contacts(builder: newton.ModelBuilder, scene: Scene, index: RigidIndex, settings: SettingsMuJoCoWarp) -> None:
    """Write the contact constants of shapes, and exclude all collisions without a contact in the scene."""
    pairs = pair_constants(scene, settings)
    keeps_material = settings.newton_material and settings.contact_solref is None
    for name, constants in carried_constants(pairs).items():
        for shape in index.shapes[name]:
            _carry(builder, shape, constants, newton_material=keeps_material)
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
            "geom_solimp": wp.types.vector(5, wp.float32)(*(*constants.solimp, *SOLIMP_SHAPE)[:5]),
        }
    for key, value in attributes.items():
        attribute = builder.custom_attributes[f"mujoco:{key}"]
        attribute.values = (attribute.values or {}) | {shape: value}


class StepperMuJoCo(Stepper):
    """Stepper of rigid bodies with MuJoCo Warp.

    Args:
        model: The finalized model.
        driven: Indices of the kinematic bodies.
        settings: Settings of the solver.
    """

    def __init__(self, model: newton.Model, *, driven: Sequence[int], settings: SettingsMuJoCoWarp) -> None:
        pair_count = model.shape_contact_pair_count // model.world_count
        with warnings.catch_warnings():
            # Newton 1.8 asks for MuJoCo 3.17, but this package needs 4.0; tests/backends/newton verify the combination.
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
                # Otherwise Newton adds a weld for each body that could become kinematic, and many constraints.
                kinematic_switchable_roots=False,
                use_mujoco_contacts=settings.mujoco_contacts or not pair_count,
                disable_contacts=not pair_count,
                nconmax=CONTACT_POINTS_PER_PAIR * pair_count or None,
                njmax=ROWS_PER_POINT * CONTACT_POINTS_PER_PAIR * pair_count + ROWS_PER_WELD * len(driven) or None,
            )
        has_pipeline = pair_count and not settings.mujoco_contacts
        self._pipeline = collision_pipeline(model) if has_pipeline else None
        self._contacts = self._pipeline.contacts() if self._pipeline else None
        super().__init__(model, solver, driven=driven, timestep_s=settings.timestep_s)
        # This solver reads joint coordinates, so driven bodies are written to both bodies and joints.
        joints = {body: joint for joint, body in enumerate(model.joint_child.numpy().tolist())}
        starts = [model.joint_q_start.numpy(), model.joint_qd_start.numpy()]
        with wp.ScopedDevice(model.device):
            self._coordinates, self._freedoms = (
                wp.array(np.array([start[joints[body]] for body in driven], dtype=np.int32), dtype=wp.int32)
                for start in starts
            )

    def apply_wrench(self, body: int, wrench: NDArray[np.float64]) -> None:
        """Apply a force and a torque to a body; see `World.apply_wrench`."""
        # Steps alternate between the two states, and each step reads the wrenches of its start state.
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
        # The solver does not move driven bodies.
        self._prescribe(after.body_q, after.body_qd, steps_ahead=1)
