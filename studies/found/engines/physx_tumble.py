"""PhysX (SAPIEN): a free tumbling box changes its kinetic energy. Law: without forces it is constant."""

import numpy as np
import sapien
from sapien import physx

SIZE_M, RATE = np.array((0.1, 0.06, 0.03)), 12.0


def ratio(step_s: float) -> float:
    """Return the energy after 10 s over that at the start."""
    scene = sapien.Scene([physx.PhysxCpuSystem()])
    scene.set_timestep(step_s)
    builder = scene.create_actor_builder()
    builder.add_box_collision(half_size=SIZE_M / 2, density=1000.0)
    builder.set_initial_pose(sapien.Pose([0, 0, 0]))
    body = builder.build().find_component_by_type(physx.PhysxRigidDynamicComponent)
    body.disable_gravity = True
    body.set_linear_damping(0.0)
    body.set_angular_damping(0.0)
    inertia = np.sum(SIZE_M**2) - SIZE_M**2
    body.set_angular_velocity(RATE * np.array((0.1, 1.0, 0.05)))
    energies = []
    for _ in range(round(10 / step_s)):
        turn = body.entity_pose.to_transformation_matrix()[:3, :3]
        energies.append(float((turn.T @ body.angular_velocity) ** 2 @ inertia))
        scene.step()
    return energies[-1] / energies[0]


for step_s in (1 / 240, 1 / 900, 1 / 1800):
    print(f"energy after 10 s, step 1/{1 / step_s:.0f} s: {ratio(step_s):.4f}; law 1")
