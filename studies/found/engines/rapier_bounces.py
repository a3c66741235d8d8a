"""Rapier: a ball with restitution 1 loses or gains height in nine bounces. Law: it keeps its height."""

import rapier3d as rapier

RADIUS_M, DROP_M, G, BOUNCES = 0.03, 0.6, 9.81, 9


def height_m(step_s: float) -> float:
    """Return the height by energy after nine bounces [m]."""
    world = rapier.PhysicsWorld(gravity=(0.0, 0.0, -G))
    world.integration_parameters.dt = step_s
    floor = rapier.Collider.halfspace((0.0, 0.0, 1.0)).restitution(1.0)
    world.add_body(rapier.RigidBody.fixed(), [floor])
    ball = rapier.Collider.ball(RADIUS_M).density(1000.0).restitution(1.0)
    builder = rapier.RigidBody.dynamic().translation((0.0, 0.0, RADIUS_M + DROP_M))
    handle = world.add_body(builder.can_sleep(False), [ball])
    seconds = 2 * BOUNCES * (2 * DROP_M / G) ** 0.5
    for _ in range(round(seconds / step_s)):
        world.step()
    body = world.rigid_bodies[handle]
    return body.translation.z - RADIUS_M + body.linvel.z**2 / (2 * G)


for step_s in (1 / 60, 1 / 900):
    print(
        f"step 1/{1 / step_s:.0f} s: {1e3 * height_m(step_s):.1f} mm; law {1e3 * DROP_M:.0f} mm"
    )
