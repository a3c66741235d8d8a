"""PhysX (SAPIEN): a ball hits a plane obliquely and grips. Law: it leaves with 5/7 of its speed along the plane."""

import sapien
from sapien import physx

RADIUS_M, FRICTION, RESTITUTION, ALONG = 0.03, 0.6, 0.6, 1.0


def share(down: float, step_s: float) -> tuple[float, float]:
    """Return the speed along the plane and the rolling speed after the impact, over the speed before it."""
    scene = sapien.Scene([physx.PhysxCpuSystem()])
    scene.set_timestep(step_s)
    material = physx.PhysxMaterial(FRICTION, FRICTION, RESTITUTION)
    builder = scene.create_actor_builder()
    builder.add_box_collision(half_size=[5, 5, 0.5], material=material)
    builder.set_initial_pose(sapien.Pose([0, 0, -0.5]))
    builder.build_static()
    builder = scene.create_actor_builder()
    builder.add_sphere_collision(radius=RADIUS_M, material=material)
    builder.set_initial_pose(sapien.Pose([0, 0, RADIUS_M + 0.1 * down]))
    body = builder.build().find_component_by_type(physx.PhysxRigidDynamicComponent)
    body.disable_gravity = True
    body.set_linear_damping(0.0)
    body.set_angular_damping(0.0)
    body.set_linear_velocity([ALONG, 0, -down])
    for _ in range(round(0.2 / step_s)):
        scene.step()
    rolling = RADIUS_M * body.angular_velocity[1]
    return float(body.linear_velocity[0]) / ALONG, float(rolling) / ALONG


for down in (2.0, 3.0):  # PhysX rebounds above 2 m/s.
    for step_s in (1 / 240, 1 / 900, 1 / 1800):
        speed, rolling = share(down, step_s)
        text = f"{speed:.3f} and {rolling:.3f}; law 0.714 and 0.714"
        print(f"{down:.0f} m/s down, step 1/{1 / step_s:.0f} s: {text}")
