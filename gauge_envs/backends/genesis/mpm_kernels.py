"""Kernels beside Genesis's MPM solver: gripped points, and reading and writing of all points."""

from __future__ import annotations

from typing import Any

import genesis as gs
import quadrants as qd


@qd.data_oriented
class MPMKernels:
    """Kernels for one MPM solver with one environment and one substep per step.

    Args:
        scene: The built `gs.Scene`.
    """

    def __init__(self, scene: Any) -> None:
        self.mpm = scene.sim.mpm_solver
        self.point_count = self.mpm.n_particles

    @qd.kernel
    def read(
        self,
        positions: qd.types.ndarray(),
        velocities: qd.types.ndarray(),
        gradients: qd.types.ndarray(),
        deformations: qd.types.ndarray(),
    ):
        """Copy the state of all points: shapes [point_count, 3] twice and [point_count, 3, 3] twice."""
        for p in range(self.point_count):
            for i in qd.static(range(3)):
                positions[p, i] = self.mpm.particles[0, p, 0].pos[i]
                velocities[p, i] = self.mpm.particles[0, p, 0].vel[i]
                for j in qd.static(range(3)):
                    gradients[p, i, j] = self.mpm.particles[0, p, 0].C[i, j]
                    deformations[p, i, j] = self.mpm.particles[0, p, 0].F[i, j]

    @qd.kernel
    def write(
        self,
        positions: qd.types.ndarray(),
        velocities: qd.types.ndarray(),
        gradients: qd.types.ndarray(),
        deformations: qd.types.ndarray(),
    ):
        """Set the state of all points: shapes [point_count, 3] twice and [point_count, 3, 3] twice."""
        for p in range(self.point_count):
            self.mpm.particles_ng[0, p, 0].active = True
            for i in qd.static(range(3)):
                self.mpm.particles[0, p, 0].pos[i] = positions[p, i]
                self.mpm.particles[0, p, 0].vel[i] = velocities[p, i]
                for j in qd.static(range(3)):
                    self.mpm.particles[0, p, 0].C[i, j] = gradients[p, i, j]
                    self.mpm.particles[0, p, 0].F[i, j] = deformations[p, i, j]

    @qd.kernel
    def grip(
        self,
        points: qd.types.ndarray(),
        positions: qd.types.ndarray(),
        velocities: qd.types.ndarray(),
        spin: qd.types.ndarray(),
    ):
        """Place gripped points and give them the motion of their body.

        Args:
            points: Indices, shape [count].
            positions: Positions [m], shape [count, 3].
            velocities: Velocities [m/s], shape [count, 3].
            spin: Angular velocity of the body [rad/s], shape [3].
        """
        for row in range(points.shape[0]):
            p = points[row]
            for i in qd.static(range(3)):
                self.mpm.particles[0, p, 0].pos[i] = positions[row, i]
                self.mpm.particles[0, p, 0].vel[i] = velocities[row, i]
            self.mpm.particles[0, p, 0].F = qd.Matrix.identity(gs.qd_float, 3)
            self.mpm.particles[0, p, 0].C = qd.Matrix(
                [[0.0, -spin[2], spin[1]], [spin[2], 0.0, -spin[0]], [-spin[1], spin[0], 0.0]], dt=gs.qd_float
            )
