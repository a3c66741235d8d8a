"""PhysX (SAPIEN): a cube that is pushed with a share of the friction limit creeps. Law: it rests below the limit."""

import numpy as np
import sapien
from sapien import physx

MASS_KG, G, FRICTION, EDGE_M = 0.2, 9.81, 0.5, 0.08


def moved_mm(share: float, step_s: float) -> float:
    """Return the displacement along the plane within 1 s [mm]."""
    scene = sapien.Scene([physx.PhysxCpuSystem()])
    scene.set_timestep(step_s)
    material = physx.PhysxMaterial(FRICTION, FRICTION, 0.0)
    builder = scene.create_actor_builder()
    builder.add_box_collision(half_size=[2, 2, 0.5], material=material)
    builder.set_initial_pose(sapien.Pose([0, 0, -0.5]))
    builder.build_static()
    builder = scene.create_actor_builder()
    density = MASS_KG / EDGE_M**3
    builder.add_box_collision(
        half_size=[EDGE_M / 2] * 3, material=material, density=density
    )
    builder.set_initial_pose(sapien.Pose([0, 0, EDGE_M / 2]))
    body = builder.build().find_component_by_type(physx.PhysxRigidDynamicComponent)
    limit = FRICTION * MASS_KG * G
    start = body.entity_pose.p.copy()
    for _ in range(round(1.0 / step_s)):
        body.add_force_at_point(
            share * limit * np.array([0.8, 0.6, 0.0]), body.entity_pose.p
        )
        scene.step()
    return 1e3 * float(np.linalg.norm((body.entity_pose.p - start)[:2]))


for share in (0.5, 0.95, 0.99):
    values = ", ".join(
        f"{moved_mm(share, s):.3f} mm at 1/{1 / s:.0f} s" for s in (1 / 240, 1 / 900)
    )
    print(f"{share}: {values}; law 0")
