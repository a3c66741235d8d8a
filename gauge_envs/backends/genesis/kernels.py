"""Kernels beside Genesis's deformable solvers, for one environment and one substep per step.

Each class reads and writes the arrays of a state, whose shapes are `shapes`, and holds nodes.
"""

from typing import Any

import genesis as gs
import numpy as np
import quadrants as qd
from genesis.utils import sdf
from numpy.typing import NDArray

SINE_FLOOR = 1e-8
"""Least squared sine of a hinge's angle, so that a flat hinge has a compliance."""


@qd.data_oriented
class FEMKernels:
    """Kernels for one FEM solver with one environment and one substep per step.

    Args:
        scene: The built `gs.Scene`.
    """

    def __init__(self, scene: Any) -> None:
        self.fem = scene.sim.fem_solver
        self.node_count = self.fem.n_vertices
        self.shapes = ((self.node_count, 3),) * 2

    @qd.kernel
    def read(self, positions: qd.types.ndarray(), velocities: qd.types.ndarray()):
        """Copy positions [m] and velocities [m/s] of all nodes, both of shape [node_count, 3]."""
        for v in range(self.node_count):
            for i in qd.static(range(3)):
                positions[v, i] = self.fem.elements_v[0, v, 0].pos[i]
                velocities[v, i] = self.fem.elements_v[0, v, 0].vel[i]

    @qd.kernel
    def write(self, positions: qd.types.ndarray(), velocities: qd.types.ndarray()):
        """Set positions [m] and velocities [m/s] of all nodes, both of shape [node_count, 3]."""
        for v in range(self.node_count):
            for i in qd.static(range(3)):
                self.fem.elements_v[0, v, 0].pos[i] = positions[v, i]
                self.fem.elements_v[0, v, 0].vel[i] = velocities[v, i]

    @qd.kernel
    def hold(self, nodes: qd.types.ndarray(), targets: qd.types.ndarray()):
        """Set where held nodes are at the end of the next step [m], shapes [count] and [count, 3]."""
        for row in range(nodes.shape[0]):
            for i in qd.static(range(3)):
                self.fem.vertex_constraints[nodes[row], 0].target_pos[i] = targets[
                    row, i
                ]


@qd.data_oriented
class MPMKernels:
    """Kernels for one MPM solver with one environment and one substep per step.

    Args:
        scene: The built `gs.Scene`.
    """

    def __init__(self, scene: Any) -> None:
        self.mpm = scene.sim.mpm_solver
        self.point_count = self.mpm.n_particles
        self.shapes = ((self.point_count, 3),) * 2 + ((self.point_count, 3, 3),) * 2

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
    def hold(
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
        scene: The built `gs.Scene`.
    """

    def __init__(self, scene: Any) -> None:
        self.pbd = scene.sim.pbd_solver
        self.rigid = scene.sim.rigid_solver
        self.hinge_count = self.pbd.n_inner_edges
        self.particle_count = self.pbd.n_particles
        self.shapes = ((self.particle_count, 3),) * 2
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
    def read(self, positions: qd.types.ndarray(), velocities: qd.types.ndarray()):
        """Copy positions [m] and velocities [m/s] of all particles, both of shape [particle_count, 3]."""
        for p in range(self.particle_count):
            for i in qd.static(range(3)):
                positions[p, i] = self.pbd.particles[p, 0].pos[i]
                velocities[p, i] = self.pbd.particles[p, 0].vel[i]

    @qd.kernel
    def write(self, positions: qd.types.ndarray(), velocities: qd.types.ndarray()):
        """Set positions [m] and velocities [m/s] of all particles, both of shape [particle_count, 3]."""
        for p in range(self.particle_count):
            for i in qd.static(range(3)):
                self.pbd.particles[p, 0].pos[i] = positions[p, i]
                self.pbd.particles[p, 0].vel[i] = velocities[p, i]

    @qd.kernel
    def place(self, particles: qd.types.ndarray(), positions: qd.types.ndarray()):
        """Set the positions [m] of some particles, shapes [count] and [count, 3]."""
        for row in range(particles.shape[0]):
            for i in qd.static(range(3)):
                self.pbd.particles[particles[row], 0].pos[i] = positions[row, i]

    @qd.kernel
    def hold(self, particles: qd.types.ndarray(), velocities: qd.types.ndarray()):
        """Set the velocities [m/s] of some particles, shapes [count] and [count, 3]."""
        for row in range(particles.shape[0]):
            for i in qd.static(range(3)):
                self.pbd.particles[particles[row], 0].vel[i] = velocities[row, i]

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
                least = 1e10
                for g in range(self.rigid.n_geoms):
                    if geoms_info.needs_coup[g]:
                        gap = sdf.sdf_func_world(
                            g, 0, after, geoms_state, geoms_info, sdf_info
                        )
                        if gap < least:
                            least = gap
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
