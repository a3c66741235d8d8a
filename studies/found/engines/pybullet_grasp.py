"""PyBullet: two pads on sliders press an object with a known force. Law: it rests if its weight is below 2 mu N."""

import pybullet as p

MASS_KG, G, FRICTION = 0.3, 9.81, 0.8
HALF_M, PAD_M = (0.02, 0.03, 0.08), (0.005, 0.01, 0.01)
LINK = {"linkMasses": [0.1], "linkVisualShapeIndices": [-1], "linkParentIndices": [0]}
LINK |= {f"link{name}Positions": [[0, 0, 0]] for name in ("", "InertialFrame")}
LINK |= {f"link{name}Orientations": [[0, 0, 0, 1]] for name in ("", "InertialFrame")}
LINK |= {"linkJointTypes": [p.JOINT_PRISMATIC], "linkJointAxis": [[1, 0, 0]]}


def slip_mm_per_s(share: float, step_s: float) -> float:
    """Return the speed from 0.2 to 1 s of an object whose weight is a share of the limit [mm/s]."""
    p.resetSimulation()
    p.setGravity(0, 0, -G)
    p.setTimeStep(step_s)
    shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=PAD_M)
    places = [[side * (HALF_M[0] + PAD_M[0]), 0, 1] for side in (-1, 1)]
    link = LINK | {"linkCollisionShapeIndices": [shape]}
    pads = [p.createMultiBody(0, basePosition=place, **link) for place in places]
    for pad in pads:
        p.setJointMotorControl2(pad, 0, p.VELOCITY_CONTROL, force=0)
        p.changeDynamics(pad, 0, lateralFriction=1, jointDamping=0)
    shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=HALF_M)
    held = p.createMultiBody(MASS_KG, shape, basePosition=[0, 0, 1])
    p.changeDynamics(held, -1, lateralFriction=FRICTION, linearDamping=0)
    force_n, heights_m = MASS_KG * G / (2 * FRICTION * share), []
    for _ in range(round(1 / step_s)):
        for pad, push in zip(pads, (force_n, -force_n), strict=True):
            p.setJointMotorControl2(pad, 0, p.TORQUE_CONTROL, force=push)
        p.stepSimulation()
        heights_m.append(p.getBasePositionAndOrientation(held)[0][2])
    return 1e3 * (heights_m[round(0.2 / step_s)] - heights_m[-1]) / 0.8


p.connect(p.DIRECT)
for share in (0.5, 0.9):
    values = (f"{slip_mm_per_s(share, 1 / n):.1f} mm/s at 1/{n} s" for n in (240, 900))
    print(f"{share} of the limit: {', '.join(values)}; law 0")
