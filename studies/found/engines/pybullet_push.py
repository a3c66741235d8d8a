"""PyBullet: a cube that is pushed with a share of the friction limit creeps. Law: it rests below the limit."""

import pybullet as p

MASS_KG, G, FRICTION, EDGE_M = 0.2, 9.81, 0.5, 0.08


def moved_mm(share: float, step_s: float) -> float:
    """Return the displacement within 1 s [mm]."""
    p.resetSimulation()
    p.setGravity(0, 0, -G)
    p.setTimeStep(step_s)
    ground = p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE))
    shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=[EDGE_M / 2] * 3)
    cube = p.createMultiBody(MASS_KG, shape, basePosition=[0, 0, EDGE_M / 2])
    # Bullet multiplies the frictions of two bodies.
    for body, friction in ((ground, 1.0), (cube, FRICTION)):
        p.changeDynamics(body, -1, lateralFriction=friction)
    p.changeDynamics(cube, -1, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING)
    for _ in range(round(0.5 / step_s)):
        p.stepSimulation()
    start = p.getBasePositionAndOrientation(cube)[0][0]
    for _ in range(round(1.0 / step_s)):
        place = p.getBasePositionAndOrientation(cube)[0]
        force = [share * FRICTION * MASS_KG * G, 0, 0]
        p.applyExternalForce(cube, -1, force, place, p.WORLD_FRAME)
        p.stepSimulation()
    return 1e3 * (p.getBasePositionAndOrientation(cube)[0][0] - start)


p.connect(p.DIRECT)
for share in (0.5, 0.95, 0.99):
    values = ", ".join(
        f"{moved_mm(share, s):.3f} mm at 1/{1 / s:.0f} s" for s in (1 / 240, 1 / 900)
    )
    print(f"{share}: {values}; law 0")
