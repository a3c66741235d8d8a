"""Soft bodies for Newton's implicit material point method (MPM), which the paper uses: boxes of particles on a grid.

The grid limits the accuracy. Velocity is linear within a voxel. A gripped particle holds all nodes of its voxel, so a
voxel at a grip is rigid up to its far side. By default, the solver relaxes elastic stress whenever a solve stops at
its maximum number of iterations; this module keeps the strain. Tetrahedra with VBD are more accurate and much
cheaper.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import newton
import numpy as np
import warp as wp
from newton.solvers import SolverImplicitMPM

from gauge_envs.backends.newton.parts import (
    PinnedParticles,
    PinNewton,
    Reader,
    SoftRowPart,
    pins_of,
)
from gauge_envs.backends.newton.settings import VOXEL_M, SettingsImplicitMPM
from gauge_envs.backends.newton.stepper import Stepper
from gauge_envs.backends.shared.soft_rows import (
    SoftRow,
    linear_weights,
    points_in_box_m,
)
from gauge_envs.scene import SoftBody
from gauge_envs.scene.geometry import FloatArray

GRIPPED_SIZE = 0.3
"""Size of a gripped point relative to its cell; a gripped point has no volume to fill."""

VOXEL_RANGE = (0.85, 1.15)
"""Voxel sizes that `fitted_voxel_m` tries, as multiples of the desired size."""


def fitted_voxel_m(soft_row: SoftRow, settings: SettingsImplicitMPM) -> float:
    """Return the voxel edge [m], close to the desired edge, that lets the rigid voxels end where the grips end.

    One voxel is centred at the world's origin, and a point in a grip holds its whole voxel. The free length is
    therefore the distance of two grid planes, which may be a voxel too short.
    """
    low_m, high_m = soft_row.face_m("low"), soft_row.face_m("high")
    voxels_m = (settings.cell_m or VOXEL_M) * np.linspace(*VOXEL_RANGE, 601)
    # The outermost gripped point sits half a spacing beyond the face.
    beyond_m = 0.5 * voxels_m / settings.points_per_voxel_edge
    squares = np.zeros(len(voxels_m))
    # Planes of the grid lie at (n + 1/2) voxels.
    if "low" in soft_row.ends:
        plane_m = (np.ceil((low_m - beyond_m) / voxels_m - 0.5) + 0.5) * voxels_m
        squares += np.square(plane_m - low_m)
    if "high" in soft_row.ends:
        plane_m = (np.floor((high_m + beyond_m) / voxels_m - 0.5) + 0.5) * voxels_m
        squares += np.square(high_m - plane_m)
    return float(voxels_m[np.argmin(squares)])


class SoftPartMPM(SoftRowPart):
    """One soft body, or several bonded in a row, as material points of a Newton model; its nodes are the free points.

    Args:
        soft_row: The soft row.
        free_m: Free points at the start [m], shape [node_count, 3]; they are the first particles.
        gripped_m: Gripped points at the start [m], shape [gripped_count, 3].
        start: Its first particle.
        pins: Particles that are attached to kinematic bodies.
    """

    def __init__(
        self,
        soft_row: SoftRow,
        free_m: FloatArray,
        gripped_m: FloatArray,
        *,
        start: int,
        pins: Sequence[PinNewton],
    ) -> None:
        super().__init__(
            soft_row, free_m, slice(start, start + len(free_m) + len(gripped_m)), pins
        )
        self._points_m = np.concatenate([free_m, gripped_m])

    def nodes(self, stepper: Stepper) -> FloatArray:
        """Return the positions of the free points."""
        return self.positions(stepper)[:, : len(self.rest_m)]

    def track(self, points_m: FloatArray) -> Reader:
        """Return a reader of material points: weighted means of the nearest particles, exact for linear deformation."""
        points = self._soft_row.checked(points_m)
        nearest, weights = linear_weights(self._points_m, points)
        return lambda stepper: np.einsum(
            "pk,npki->npi", weights, self.positions(stepper)[:, nearest]
        )


def add_soft_mpm(
    builder: newton.ModelBuilder,
    soft_row: SoftRow,
    *,
    indices: Mapping[str, int],
    spacing_m: float,
    damping_s: float,
) -> SoftPartMPM:
    """Add a soft body or a soft row as material points.

    `SolverImplicitMPM.register_custom_attributes` must have been called. Points in a grip have no mass; the solver lets
    such points impose their velocity on the grid.

    Args:
        builder: Model builder that contains the rigid bodies.
        soft_row: The soft row.
        indices: Model index of each kinematic body that grips the row, by name.
        spacing_m: Largest distance between neighbouring points [m]; half a voxel gives 8 points per voxel.
        damping_s: Relaxation time of the elastic stress, Newton's `mpm:damping` [s].
    """
    start = builder.particle_count
    free: list[FloatArray] = []
    for block in soft_row.blocks:
        points, cell_m = points_in_box_m(block.low_m, block.high_m, spacing_m)
        _add_points(
            builder, points, cell_m, block.body, block.density_kg_per_m3, damping_s
        )
        free.append(points)
    gripped: list[FloatArray] = [np.zeros((0, 3))]
    pins: list[PinNewton] = []
    for side, attachment in soft_row.ends.items():
        depth_m = max(attachment.region.depth_m, spacing_m)
        grip_m = soft_row.beyond_m(side, depth_m)
        points, cell_m = points_in_box_m(*grip_m, spacing_m)
        first = builder.particle_count
        body = soft_row.end(side).body
        _add_points(builder, points, cell_m, body, 0.0, damping_s)
        gripped.append(points)
        pins += pins_of(attachment, indices, range(first, first + len(points)), points)
    return SoftPartMPM(
        soft_row, np.concatenate(free), np.concatenate(gripped), start=start, pins=pins
    )


def _add_points(
    builder: newton.ModelBuilder,
    points_m: FloatArray,
    cell_m: FloatArray,
    body: SoftBody,
    density_kg_per_m3: float,
    damping_s: float,
) -> None:
    count, volume_m3 = len(points_m), float(np.prod(cell_m))
    builder.add_particles(
        pos=[wp.vec3(*point) for point in points_m],
        vel=[wp.vec3(0.0, 0.0, 0.0)] * count,
        mass=[density_kg_per_m3 * volume_m3] * count,
        # The solver treats a point as a cube with edges of twice its radius. A gripped point must stay in its voxel.
        radius=[
            0.5 * volume_m3 ** (1 / 3) * (1.0 if density_kg_per_m3 else GRIPPED_SIZE)
        ]
        * count,
        custom_attributes={
            "mpm:young_modulus": [body.young_modulus_pa] * count,
            "mpm:poisson_ratio": [body.poisson_ratio] * count,
            "mpm:damping": [damping_s] * count,
            # With the default ratio, the material yields immediately under tension.
            "mpm:tensile_yield_ratio": [1.0] * count,
        },
    )


# --- stepping --------------------------------------------------------------------------------------------------------


class StepperMPM(Stepper):
    """Stepper of particles with `newton.solvers.SolverImplicitMPM`; rigid bodies are fixed or driven.

    It records no graph, because each step allocates a new grid, and a recorded step cannot do so on the CPU.

    With the integration scheme `pic`, the constant strain of a voxel misses motions of evenly spaced points: with two
    points along an edge, voxels of 12 mm give a tenth of the stress. With `gimp`, a bar diverges at a twist of more
    than 45 degrees.

    Args:
        model: The finalized model.
        driven: Indices of the kinematic bodies.
        pins: Particles that are attached to kinematic bodies.
        voxel_m: Edge of a voxel [m].
        settings: Settings of the solver.
    """

    def __init__(
        self,
        model: newton.Model,
        *,
        driven: Sequence[int],
        pins: Sequence[PinNewton],
        voxel_m: float,
        settings: SettingsImplicitMPM,
    ) -> None:
        config = SolverImplicitMPM.Config(
            voxel_size=voxel_m,
            max_iterations=settings.iterations,
            tolerance=settings.tolerance,
            # Otherwise the residual strain of an unconverged solve is lost, and the stress is half the correct value.
            carry_residual_strain="unconverged",
            # Keeps the warm start in the state, which a reset writes.
            warmstart_mode="particles",
            integration_scheme=settings.integration_scheme,
            # Contact at the points. With contact at the grid nodes, the default, a driven cube sinks 16 mm into foam.
            collider_basis="pic27",
            air_drag=0.0,
        )
        solver = SolverImplicitMPM(model, config)
        super().__init__(model, solver, driven=driven, timestep_s=settings.timestep_s)
        self._pinned = PinnedParticles(pins, self)

    def record(self) -> None:
        """Record no graph."""
        self.reset()

    def reset(self, *args: Any, **given: Any) -> None:
        """Start all worlds in new states, because the solver adds fields to used states; see `Stepper.reset`."""
        self.states = (self.model.state(), self.model.state())
        super().reset(*args, **given)

    def _run_step(self) -> None:
        self._step(self.states[self.current], self.states[1 - self.current])

    def _step(self, state: newton.State, after: newton.State) -> None:
        self._prescribe(after.body_q, after.body_qd, steps_ahead=1)
        self._pinned.carry(state, after, self.timestep_s)
        # Each step starts without the contact impulses of the last one.
        self.solver.reset(state, flags=0)
        self.solver.step(state, after, self.control, None, self.timestep_s)
        self._pinned.hold(after.body_q, after.particle_q)
