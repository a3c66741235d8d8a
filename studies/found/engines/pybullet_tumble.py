"""PyBullet: a free tumbling box changes its kinetic energy. Law: without forces it is constant."""

import numpy as np
import pybullet as p

SIZE_M, MASS_KG, RATE = np.array((0.16, 0.03, 0.02)), 0.2, 12.0
INERTIA = MASS_KG / 12 * (np.sum(SIZE_M**2) - SIZE_M**2)


def energy_j(body: int) -> float:
    """Return the kinetic energy of rotation."""
    turn = np.reshape(
        p.getMatrixFromQuaternion(p.getBasePositionAndOrientation(body)[1]), (3, 3)
    )
    spin = turn.T @ p.getBaseVelocity(body)[1]
    return 0.5 * float(spin**2 @ INERTIA)


def ratio(step_s: float) -> float:
    """Return the energy after 10 s over that at the start."""
    p.resetSimulation()
    p.setTimeStep(step_s)
    shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=list(SIZE_M / 2))
    rod = p.createMultiBody(MASS_KG, shape)
    free = {"linearDamping": 0, "angularDamping": 0}
    p.changeDynamics(rod, -1, localInertiaDiagonal=list(INERTIA), **free)
    p.resetBaseVelocity(rod, [0, 0, 0], list(RATE * np.array((0.1, 1.0, 0.05))))
    start = energy_j(rod)
    for _ in range(round(10 / step_s)):
        p.stepSimulation()
    return energy_j(rod) / start


p.connect(p.DIRECT)
for step_s in (1 / 240, 1 / 900):
    print(f"energy after 10 s, step 1/{1 / step_s:.0f} s: {ratio(step_s):.4f}; law 1")
