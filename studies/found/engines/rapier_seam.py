"""Rapier: a box slides over the seam of two flush boxes. Law: v - mu g t, as on one box."""

from itertools import pairwise

import rapier3d as rapier

SPEED, FRICTION, G, SECONDS = 1.5, 0.1, 9.81, 0.5
FLOORS = {"one box": (-0.2, 3.0), "two flush boxes": (-0.2, 0.07, 3.0)}


def slide(edges_m: tuple[float, ...], step_s: float) -> tuple[float, float]:
    """Return the speed after 0.5 s [m/s] and the largest hop [mm] on a floor with edges along x."""
    world = rapier.PhysicsWorld(gravity=(0.0, 0.0, -G))
    world.integration_parameters.dt = step_s
    for low, high in pairwise(edges_m):
        place = ((low + high) / 2, 0.0, -0.025)
        tile = rapier.Collider.cuboid((high - low) / 2, 0.2, 0.025).friction(FRICTION)
        world.add_body(rapier.RigidBody.fixed().translation(place), [tile])
    builder = (
        rapier.RigidBody.dynamic()
        .translation((0.0, 0.0, 0.025))
        .linvel((SPEED, 0.0, 0.0))
    )
    brick = rapier.Collider.cuboid(0.05, 0.04, 0.025).density(1000.0).friction(FRICTION)
    handle = world.add_body(builder, [brick])
    heights = []
    for _ in range(round(SECONDS / step_s)):
        world.step()
        heights.append(world.rigid_bodies[handle].translation.z)
    return world.rigid_bodies[handle].linvel.x, 1e3 * (max(heights) - 0.025)


for step_s in (1 / 60, 1 / 900):
    for name, edges in FLOORS.items():
        speed, hop = slide(edges, step_s)
        law = SPEED - FRICTION * G * SECONDS
        print(
            f"{name}, step 1/{1 / step_s:.0f} s: {speed:.3f} m/s, hop {hop:.2f} mm; law {law:.3f} m/s, 0 mm"
        )
