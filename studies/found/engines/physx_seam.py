"""PhysX (SAPIEN): a box slides over the seam of two flush boxes. Law: v - mu g t, as on one box."""

from itertools import pairwise

import sapien
from sapien import physx

SPEED, FRICTION, G, SECONDS = 1.5, 0.1, 9.81, 0.5
LAW = SPEED - FRICTION * G * SECONDS
FLOORS = {"one box": (-0.2, 3.0), "two flush boxes": (-0.2, 0.07, 3.0)}


def slide(edges_m: tuple[float, ...], step_s: float) -> tuple[float, float]:
    """Return the speed after 0.5 s [m/s] and the largest hop [mm] on a floor with edges along x."""
    scene = sapien.Scene([physx.PhysxCpuSystem()])
    scene.set_timestep(step_s)
    material = physx.PhysxMaterial(FRICTION, FRICTION, 0.0)
    for low, high in pairwise(edges_m):
        builder = scene.create_actor_builder()
        size = [0.5 * (high - low), 0.2, 0.025]
        builder.add_box_collision(half_size=size, material=material)
        builder.set_initial_pose(sapien.Pose([(low + high) / 2, 0, -0.025]))
        builder.build_static()
    builder = scene.create_actor_builder()
    builder.add_box_collision(half_size=[0.05, 0.04, 0.025], material=material)
    builder.set_initial_pose(sapien.Pose([0, 0, 0.025]))
    body = builder.build().find_component_by_type(physx.PhysxRigidDynamicComponent)
    body.set_linear_velocity([SPEED, 0, 0])
    heights = []
    for _ in range(round(SECONDS / step_s)):
        scene.step()
        heights.append(body.entity_pose.p[2])
    return float(body.linear_velocity[0]), 1e3 * (max(heights) - 0.025)


for step_s in (1 / 240, 1 / 900):
    for name, edges in FLOORS.items():
        speed, hop = slide(edges, step_s)
        text = f"{speed:.3f} m/s, hop {hop:.2f} mm; law {LAW:.3f} m/s, 0 mm"
        print(f"{name}, step 1/{1 / step_s:.0f} s: {text}")
