"""Kernels beside Genesis's FEM solver: held nodes, and reading and writing of all nodes."""

from __future__ import annotations

from typing import Any

import quadrants as qd


@qd.data_oriented
class FEMKernels:
    """Kernels for one FEM solver with one environment and one substep per step.

    Args:
        scene: The built `gs.Scene`.
    """

    def __init__(self, scene: Any) -> None:
        self.fem = scene.sim.fem_solver
        self.node_count = self.fem.n_vertices

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
                self.fem.vertex_constraints[nodes[row], 0].target_pos[i] = targets[row, i]
