"""Rapier: a box of 20 kg sinks into a box of 0.1 kg under it. Law: rigid boxes carry any weight."""

import rapier3d as rapier

SIZE_M = (0.1, 0.1, 0.05)


def sinks_mm(heavy_kg: float, step_s: float) -> float:
    """Return how far the upper box sinks within 1 s [mm]."""
    world = rapier.PhysicsWorld(gravity=(0.0, 0.0, -9.81))
    world.integration_parameters.dt = step_s
    floor = rapier.Collider.cuboid(1.0, 1.0, 0.5)
    world.add_body(rapier.RigidBody.fixed().translation((0.0, 0.0, -0.5)), [floor])
    volume = SIZE_M[0] * SIZE_M[1] * SIZE_M[2]
    for height, mass_kg in ((0.025, 0.1), (0.075, heavy_kg)):
        collider = rapier.Collider.cuboid(*(edge / 2 for edge in SIZE_M))
        builder = (
            rapier.RigidBody.dynamic().translation((0.0, 0.0, height)).can_sleep(False)
        )
        handle = world.add_body(
            builder, [collider.density(mass_kg / volume).friction(0.4)]
        )
    for _ in range(round(1.0 / step_s)):
        world.step()
    return 1e3 * (0.075 - world.rigid_bodies[handle].translation.z)


for step_s in (1 / 60, 1 / 900):
    values = ", ".join(
        f"{kg} kg {sinks_mm(kg, step_s):.3f} mm" for kg in (0.1, 1.0, 20.0)
    )
    print(f"step 1/{1 / step_s:.0f} s: {values}; law 0")
