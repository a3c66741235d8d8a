"""Additional kernels for Genesis's deformable solvers, for one environment and one substep per step."""

from typing import Any

import genesis as gs
import numpy as np
import quadrants as qd
from genesis.utils import sdf
from numpy.typing import NDArray

SINE_FLOOR = 1e-8
"""Smallest squared sine of a hinge's angle, so that a flat hinge has a compliance."""


@qd.data_oriented
class MPMKernels:
    """Kernels for one MPM solver with one environment and one substep per step.

    Args:
        model: The built `gs.Scene`.
    """

    def __init__(self, model: Any) -> None:
        self.mpm = model.sim.mpm_solver

    @qd.kernel
    def hold(
        self,
        start: qd.i32,
        positions: qd.types.ndarray(),
        velocities: qd.types.ndarray(),
        spin: qd.types.ndarray(),
    ):
        """Place consecutive points and give them the motion of their body.

        Args:
            start: Index of the first point.
            positions: Positions [m], shape [count, 3].
            velocities: Velocities [m/s], shape [count, 3].
            spin: Angular velocity of the body [rad/s], shape [3].
        """
        for row in range(positions.shape[0]):
            p = start + row
            for i in qd.static(range(3)):
                self.mpm.particles[0, p, 0].pos[i] = positions[row, i]
                self.mpm.particles[0, p, 0].vel[i] = velocities[row, i]
            self.mpm.particles[0, p, 0].F = qd.Matrix.identity(gs.qd_float, 3)
            self.mpm.particles[0, p, 0].C = qd.Matrix(
                [
                    [0.0, -spin[2], spin[1]],
                    [spin[2], 0.0, -spin[0]],
                    [-spin[1], spin[0], 0.0],
                ],
                dt=gs.qd_float,
            )


@qd.data_oriented
class PBDKernels:
    """Kernels for one PBD solver with one environment.

    Args:
        model: The built `gs.Scene`.
    """

    def __init__(self, model: Any) -> None:
        self.pbd = model.sim.pbd_solver
        self.rigid = model.sim.rigid_solver
        self.hinge_count = self.pbd.n_inner_edges
        self.particle_count = self.pbd.n_particles
        self.compliance = qd.field(dtype=gs.qd_float, shape=(max(1, self.hinge_count),))
        self.before = qd.Vector.field(
            3, dtype=gs.qd_float, shape=(self.particle_count,)
        )
        self.friction = qd.field(dtype=gs.qd_float, shape=(max(1, self.rigid.n_geoms),))

    def set_compliance(self, values: NDArray[np.float64]) -> None:
        """Set the compliance of each hinge [rad/(N m)], shape [hinge_count]."""
        self.compliance.from_numpy(values.astype(gs.np_float))

    def set_friction(self, values: NDArray[np.float64]) -> None:
        """Set Coulomb's coefficient of each geom, shape [geom_count]."""
        self.friction.from_numpy(values.astype(gs.np_float))

    @qd.kernel
    def exact_hinges(self):
        """Multiply the compliance of each hinge by the squared sine of its angle.

        With C = angle and the gradients q / sin, XPBD divides by w q^2 / sin^2 + a. Genesis divides by w q^2 + a with
        the same factor sin in front, so that its a must contain sin^2.
        """
        for i in range(self.hinge_count):
            start = self.pbd.particles[self.pbd.inner_edges_info[i].v1, 0].pos
            edge = self.pbd.particles[self.pbd.inner_edges_info[i].v2, 0].pos - start
            first = edge.cross(
                self.pbd.particles[self.pbd.inner_edges_info[i].v3, 0].pos - start
            )
            second = edge.cross(
                self.pbd.particles[self.pbd.inner_edges_info[i].v4, 0].pos - start
            )
            cosine = first.dot(second) / (first.norm(gs.EPS) * second.norm(gs.EPS))
            squared_sine = qd.max(1.0 - cosine * cosine, SINE_FLOOR)
            self.pbd.inner_edges_info[i].bending_compliance = (
                squared_sine * self.compliance[i]
            )

    @qd.kernel
    def keep(self):
        """Keep the positions of particles before they are moved out of rigid bodies."""
        for p in range(self.particle_count):
            self.before[p] = self.pbd.particles_reordered[p, 0].pos

    @qd.kernel
    def rub(
        self,
        geoms_state: qd.template(),
        geoms_info: qd.template(),
        links_state: qd.template(),
        sdf_info: qd.template(),
    ):
        """Apply Coulomb's friction to particles that were moved out of rigid bodies, as far as they were moved."""
        for p in range(self.particle_count):
            after = self.pbd.particles_reordered[p, 0].pos
            push = after - self.before[p]
            depth = push.norm()
            if depth > 0.0 and self.pbd.particles_reordered[p, 0].free:
                touched = -1
                smallest_gap = 1e10
                for g in range(self.rigid.n_geoms):
                    if geoms_info.needs_coup[g]:
                        gap = sdf.sdf_func_world(
                            g, 0, after, geoms_state, geoms_info, sdf_info
                        )
                        if gap < smallest_gap:
                            smallest_gap = gap
                            touched = g
                if touched >= 0:
                    normal = push / depth
                    carried = self.rigid._func_vel_at_point(
                        pos_world=after,
                        link_idx=geoms_info.link_idx[touched],
                        i_b=0,
                        links_state=links_state,
                    )
                    slip = (
                        after
                        - self.pbd.particles_reordered[p, 0].ipos
                        - carried * self.pbd._substep_dt
                    )
                    slip -= normal * normal.dot(slip)
                    length = slip.norm()
                    if length > 0.0:
                        share = qd.min(1.0, self.friction[touched] * depth / length)
                        self.pbd.particles_reordered[p, 0].pos = after - share * slip
                        self.pbd.particles_reordered[p, 0].vel -= (
                            share * slip / self.pbd._substep_dt
                        )
