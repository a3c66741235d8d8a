"""The same rigid scenes in engines other than MuJoCo: `python engines.py pybullet`. Needs the engine and NumPy alone.

It runs in the environment of a release, and prints a JSON object: the number of each scene, and of those that the
release cannot run, why. An engine has its own defaults, but for damping, which is off, and the step of 1/480 s.
"""

import json
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

STEP_S = 1 / 480
G = 9.81


class Body(NamedTuple):
    """A box, or a ball where `size_m` is one number; fixed where it has no mass."""

    size_m: tuple[float, ...]
    place_m: tuple[float, float, float]
    mass_kg: float = 1.0
    friction: float = 0.5
    restitution: float = 0.0
    spin_rad_per_s: tuple[float, float, float] = (0.0, 0.0, 0.0)


class World(NamedTuple):
    """A scene in an engine.

    Attributes:
        step: Advances it by a step.
        state: Returns position [m], velocity [m/s], angular velocity in the world [rad/s] and rotation of a body.
    """

    step: Callable[[], Any]
    state: Callable[[int], tuple[Any, Any, Any, Any]]


Bodies = list[Body]


def matrix(w: float, x: float, y: float, z: float) -> Any:
    """Return the rotation matrix of a quaternion."""
    u, v = np.array([x, y, z]), w
    cross = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
    return np.eye(3) + 2.0 * v * cross + 2.0 * cross @ cross


# --- engines ---------------------------------------------------------------------------------------------------------


def pybullet(bodies: Bodies, gravity: Any) -> World:
    import pybullet as p

    p.connect(p.DIRECT)
    p.resetSimulation()
    p.setGravity(*gravity)
    p.setTimeStep(STEP_S)
    made = []
    for one in bodies:
        is_ball = len(one.size_m) == 1
        size = {"radius": one.size_m[0]} if is_ball else {"halfExtents": one.size_m}
        shape = p.createCollisionShape(p.GEOM_SPHERE if is_ball else p.GEOM_BOX, **size)
        body = p.createMultiBody(one.mass_kg, shape, basePosition=one.place_m)
        # The constants of a pair are products.
        p.changeDynamics(
            body,
            -1,
            lateralFriction=one.friction if one.mass_kg else 1.0,
            restitution=one.restitution if one.mass_kg else 1.0,
            linearDamping=0.0,
            angularDamping=0.0,
        )
        p.resetBaseVelocity(body, (0, 0, 0), one.spin_rad_per_s)
        made.append(body)

    def state(index: int) -> tuple[Any, Any, Any, Any]:
        place, (x, y, z, w) = p.getBasePositionAndOrientation(made[index])
        return (place, *p.getBaseVelocity(made[index]), matrix(w, x, y, z))

    return World(p.stepSimulation, state)


def sapien(bodies: Bodies, gravity: Any) -> World:
    import sapien
    from sapien import physx

    physx.set_scene_config(gravity=[*gravity], bounce_threshold=0.2)
    scene = sapien.Scene([physx.PhysxCpuSystem()])
    scene.set_timestep(STEP_S)
    made = []
    for one in bodies:
        builder = scene.create_actor_builder()
        material = physx.PhysxMaterial(one.friction, one.friction, one.restitution)
        volume = 8.0 * np.prod(one.size_m)
        if len(one.size_m) == 1:
            volume = 4.0 / 3.0 * np.pi * one.size_m[0] ** 3
            add, size = builder.add_sphere_collision, {"radius": one.size_m[0]}
        else:
            add, size = builder.add_box_collision, {"half_size": one.size_m}
        add(material=material, density=max(one.mass_kg, 1.0) / volume, **size)
        body = builder.build() if one.mass_kg else builder.build_static()
        body.set_pose(sapien.Pose(one.place_m))
        found = body.find_component_by_type(physx.PhysxRigidDynamicComponent)
        if found is not None:
            found.linear_damping = found.angular_damping = 0.0
            found.set_angular_velocity(one.spin_rad_per_s)
        made.append((body, found))

    def state(index: int) -> tuple[Any, Any, Any, Any]:
        body, found = made[index]
        turned = matrix(*body.get_pose().q)
        return (
            body.get_pose().p,
            found.linear_velocity,
            found.angular_velocity,
            turned,
        )

    return World(scene.step, state)


def rapier3d(bodies: Bodies, gravity: Any) -> World:
    import rapier3d as rapier

    world = rapier.PhysicsWorld(gravity=tuple(gravity))
    world.integration_parameters.dt = STEP_S
    made = []
    for one in bodies:
        kind = rapier.RigidBody.dynamic() if one.mass_kg else rapier.RigidBody.fixed()
        kind = kind.translation(one.place_m).angvel(one.spin_rad_per_s)
        handle = world.add_body(kind.gyroscopic_forces(True).can_sleep(False))
        shape = rapier.Collider.cuboid
        if len(one.size_m) == 1:
            shape = rapier.Collider.ball
        collider = shape(*one.size_m).friction(one.friction)
        world.add_collider(
            collider.restitution(one.restitution).mass(max(one.mass_kg, 1e-3)),
            parent=handle,
        )
        made.append(handle)

    def state(index: int) -> tuple[Any, Any, Any, Any]:
        body = world.rigid_bodies[made[index]]
        x, y, z, w = body.rotation.quaternion
        vectors = (body.translation, body.linvel, body.angvel)
        return (*(one.to_tuple() for one in vectors), matrix(w, x, y, z))

    return World(world.step, state)


def mujoco_warp(bodies: Bodies, gravity: Any) -> World:
    import mujoco
    import mujoco_warp as mjw

    text = f'<mujoco><option timestep="{STEP_S}" gravity="{" ".join(map(str, gravity))}"/><worldbody>'
    for one in bodies:
        shape = "sphere" if len(one.size_m) == 1 else "box"
        size, place = (" ".join(map(str, x)) for x in (one.size_m, one.place_m))
        free = "<freejoint/>" if one.mass_kg else ""
        text += (
            f'<body pos="{place}">{free}<geom type="{shape}" size="{size}" mass="{max(one.mass_kg, 1.0)}" '
            f'friction="{one.friction} 0 0"/></body>'
        )
    model = mujoco.MjModel.from_xml_string(text + "</worldbody></mujoco>")
    data = mujoco.MjData(model)
    moving = [one for one in bodies if one.mass_kg]
    for index, one in enumerate(moving):
        data.qvel[6 * index + 3 : 6 * index + 6] = one.spin_rad_per_s
    mujoco.mj_forward(model, data)
    there, state_there = mjw.put_model(model), mjw.put_data(model, data)

    def state(index: int) -> tuple[Any, Any, Any, Any]:
        row = sum(one.mass_kg > 0 for one in bodies[:index])
        pose = state_there.qpos.numpy()[0, 7 * row : 7 * row + 7]
        rate = state_there.qvel.numpy()[0, 6 * row : 6 * row + 6]
        turned = matrix(*pose[3:])
        return pose[:3], rate[:3], turned @ rate[3:], turned

    return World(lambda: mjw.step(there, state_there), state)


ENGINES = {
    "pybullet": pybullet,
    "sapien": sapien,
    "rapier3d": rapier3d,
    "mujoco-warp": mujoco_warp,
}
WITHOUT_RESTITUTION = ("mujoco-warp",)
"""Engines that have no coefficient of restitution."""

# --- scenes ----------------------------------------------------------------------------------------------------------

FLOOR = Body((5.0, 5.0, 0.5), (0.0, 0.0, -0.5), 0.0)
HALF_M = 0.1


def tilted(degrees: float) -> Any:
    """Return gravity on a slope, along whose surface x points down [m/s^2]."""
    angle = np.radians(degrees)
    return G * np.array([np.sin(angle), 0.0, -np.cos(angle)])


def run(build: Any, bodies: Bodies, gravity: Any, seconds: float) -> World:
    """Return a scene after a time."""
    world: World = build(bodies, gravity)
    for _ in range(round(seconds / STEP_S)):
        world.step()
    return world


def fall_speed(build: Any) -> float:
    """A free ball after 0.5 s: g t [m/s]."""
    world = run(build, [Body((0.1,), (0.0, 0.0, 10.0))], (0.0, 0.0, -G), 0.5)
    return -float(world.state(0)[1][2])


def slide(build: Any) -> float:
    """A box on 30 degrees with friction 0.25: g (sin - 0.25 cos) [m/s^2], from the speeds after 0.2 and 0.7 s."""
    floor = FLOOR._replace(friction=0.25)
    box = Body((HALF_M, HALF_M, 0.05), (0.0, 0.0, 0.05), friction=0.25)
    world = run(build, [floor, box], tilted(30.0), 0.2)
    before = float(world.state(1)[1][0])
    for _ in range(round(0.5 / STEP_S)):
        world.step()
    return (float(world.state(1)[1][0]) - before) / 0.5


def creep_mm(build: Any) -> float:
    """A box on 10 degrees with friction 0.5 stays: how far it is after 1 s [mm]."""
    box = Body((HALF_M, HALF_M, 0.05), (0.0, 0.0, 0.05))
    world = run(build, [FLOOR, box], tilted(10.0), 1.0)
    return 1e3 * float(world.state(1)[0][0])


def stack_mm(build: Any) -> float:
    """The top of three boxes that rest on each other for 1 s: how far it sinks [mm]."""
    boxes = [Body((HALF_M,) * 3, (0.0, 0.0, HALF_M * (1 + 2 * i))) for i in range(3)]
    world = run(build, [FLOOR, *boxes], (0.0, 0.0, -G), 1.0)
    return 1e3 * (5.0 * HALF_M - float(world.state(3)[0][2]))


def rebound(build: Any) -> float:
    """A ball with restitution 0.6 that falls 0.5 m: speed after the impact over the speed before it."""
    floor = FLOOR._replace(restitution=0.6)
    ball = Body((HALF_M,), (0.0, 0.0, 0.5 + HALF_M), restitution=0.6)
    world = build([floor, ball], (0.0, 0.0, -G))
    speeds = []
    for _ in range(round(0.5 / STEP_S)):
        world.step()
        speeds.append(float(world.state(1)[1][2]))
    return max(speeds) / -min(speeds)


def spin_percent(build: Any) -> float:
    """A free brick that turns about its middle axis for 1 s: by how much its energy changes [%]."""
    size = np.array([0.05, 0.1, 0.2])
    moments = (np.sum(size**2) - size**2) / 3.0

    def energy(world: World) -> float:
        _, _, spin, turned = world.state(0)
        return float(moments @ (turned.T @ np.asarray(spin)) ** 2)

    brick = Body(tuple(size), (0.0, 0.0, 1.0), spin_rad_per_s=(0.1, 5.0, 0.1))
    before = energy(build([brick], (0.0, 0.0, 0.0)))
    after = energy(run(build, [brick], (0.0, 0.0, 0.0), 1.0))
    return 100.0 * (after / before - 1.0)


SCENES = (fall_speed, slide, creep_mm, stack_mm, rebound, spin_percent)


def main(engine: str) -> None:
    """Print the number of each scene."""
    found: dict[str, Any] = {}
    for scene in SCENES:
        if scene is rebound and engine in WITHOUT_RESTITUTION:
            found[scene.__name__] = "no coefficient"
            continue
        try:
            found[scene.__name__] = float(scene(ENGINES[engine]))
        except Exception as error:  # A release may lack any call.
            found[scene.__name__] = f"{type(error).__name__}: {error}"[:200]
    # What engines print comes before.
    print("\n" + json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1])
