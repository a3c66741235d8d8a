"""Droop of a clamped strip of Bullet's cloth, by the stiffness of its bending springs.

    python studies/bullet_contact/cloth.py

A strip of 100 by 20 mm and 150 g/m^2 is held at its first two rows of nodes. The droop is the height that its free end
loses in 1 s, damped; a strip without bending stiffness hangs down by 90 mm.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pybullet

UNITS_PER_M, CELL_M, ROWS, COLUMNS = 100.0, 0.01, 11, 3
MASS_KG = 0.15 * 0.1 * 0.02


def droop_mm(stretch: float, bending: float) -> float:
    """Return the droop [mm] of a strip with stiffnesses of its edges and its bending springs [N/m]."""
    pybullet.resetSimulation(pybullet.RESET_USE_DEFORMABLE_WORLD)
    pybullet.setGravity(0.0, 0.0, -9.80665 * UNITS_PER_M)
    pybullet.setPhysicsEngineParameter(fixedTimeStep=1 / 9000, numSubSteps=0)
    lines = [
        f"v {x * CELL_M * UNITS_PER_M} {y * CELL_M * UNITS_PER_M} 0"
        for x in range(ROWS)
        for y in range(COLUMNS)
    ]
    for corner in (
        x * COLUMNS + y + 1 for x in range(ROWS - 1) for y in range(COLUMNS - 1)
    ):
        across = corner + COLUMNS
        lines += [
            f"f {corner} {across} {corner + 1}",
            f"f {across} {across + 1} {corner + 1}",
        ]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "strip.obj"
        file.write_text("\n".join(lines) + "\n")
        strip = pybullet.loadSoftBody(
            str(file),
            mass=MASS_KG,
            useMassSpring=1,
            useBendingSprings=1,
            springElasticStiffness=stretch,
            springDampingStiffness=1e-3,
            springBendingStiffness=bending,
            springDampingAllDirections=1,
        )
    for node in range(2 * COLUMNS):
        pybullet.createSoftBodyAnchor(strip, node, -1, -1)
    for _ in range(9000):
        pybullet.stepSimulation()
    nodes = np.array(
        pybullet.getMeshData(strip, -1, flags=pybullet.MESH_DATA_SIMULATION_MESH)[1]
    )
    return float(-1e3 * nodes[-COLUMNS:, 2].mean() / UNITS_PER_M)


def main() -> None:
    """Print the droop for bending springs of several stiffnesses."""
    pybullet.connect(pybullet.DIRECT)
    for bending in (0.0, 0.1, 1.0, 10.0, 100.0):
        print(
            f"edges 100 N/m, bending springs {bending:g} N/m: {droop_mm(100.0, bending):.1f} mm",
            flush=True,
        )


if __name__ == "__main__":
    main()
