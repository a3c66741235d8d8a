"""The same rigid scenes in engines other than MuJoCo: `python engines.py pybullet`. Needs the engine and NumPy alone.

It runs in the environment of a release, and prints a JSON object: the number of each scene, and of those that the
release cannot run, why. An engine has its own defaults, but for damping, which is off, and the step of 1/480 s.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

STEP_S = 1 / 480
G = 9.81

MODULUS_PA = 1e7
"""Modulus of moving bodies in Drake, whose default contact has one point for two boxes."""


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


def matrix(w: float, x: float, y: float, z: float) -> Any:
    """Return the rotation matrix of a quaternion."""
    u, v = np.array([x, y, z]), w
    cross = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
    return np.eye(3) + 2.0 * v * cross + 2.0 * cross @ cross


def density(one: Body) -> float:
    """Return the mass per volume of a body [kg/m^3]; a fixed one has 1 kg."""
    volume_m3 = 8.0 * np.prod(one.size_m)
    if len(one.size_m) == 1:
        volume_m3 = 4.0 / 3.0 * np.pi * one.size_m[0] ** 3
    return float(max(one.mass_kg, 1.0) / volume_m3)


# --- engines ---------------------------------------------------------------------------------------------------------


def pybullet(bodies: list[Body], gravity: Any) -> World:
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


def sapien(bodies: list[Body], gravity: Any) -> World:
    try:
        from sapien import physx
    except ImportError:
        return sapien_2(bodies, gravity)
    import sapien

    physx.set_scene_config(gravity=[*gravity], bounce_threshold=0.2)
    scene = sapien.Scene([physx.PhysxCpuSystem()])
    scene.set_timestep(STEP_S)
    made = []
    for one in bodies:
        builder = scene.create_actor_builder()
        material = physx.PhysxMaterial(one.friction, one.friction, one.restitution)
        if len(one.size_m) == 1:
            add, size = builder.add_sphere_collision, {"radius": one.size_m[0]}
        else:
            add, size = builder.add_box_collision, {"half_size": one.size_m}
        add(material=material, density=density(one), **size)
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


def sapien_2(bodies: list[Body], gravity: Any) -> World:
    """Return a scene of SAPIEN before 3.0, whose bodies have no components."""
    import sapien.core as sapien

    config = sapien.SceneConfig()
    config.gravity, config.bounce_threshold = [*gravity], 0.2
    scene = sapien.Engine().create_scene(config)
    scene.set_timestep(STEP_S)
    made = []
    for one in bodies:
        builder = scene.create_actor_builder()
        constants = (one.friction, one.friction, one.restitution)
        material = scene.create_physical_material(*constants)
        if len(one.size_m) == 1:
            add, size = builder.add_sphere_collision, {"radius": one.size_m[0]}
        else:
            add, size = builder.add_box_collision, {"half_size": one.size_m}
        add(material=material, density=density(one), **size)
        body = builder.build() if one.mass_kg else builder.build_static()
        body.set_pose(sapien.Pose(one.place_m))
        if one.mass_kg:
            body.set_damping(0.0, 0.0)
            body.set_angular_velocity(one.spin_rad_per_s)
        made.append(body)

    def state(index: int) -> tuple[Any, Any, Any, Any]:
        body = made[index]
        turned = matrix(*body.pose.q)
        return body.pose.p, body.velocity, body.angular_velocity, turned

    return World(scene.step, state)


def rapier3d(bodies: list[Body], gravity: Any) -> World:
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


def mujoco_warp(bodies: list[Body], gravity: Any) -> World:
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


def newton(bodies: list[Body], gravity: Any) -> World:
    """Return a scene of Newton with its own solver, XPBD."""
    import newton as engine
    import warp as wp

    builder = engine.ModelBuilder()
    made = []
    for one in bodies:
        place = wp.transform(one.place_m, wp.quat_identity())
        body = builder.add_body(xform=place) if one.mass_kg else -1
        made.append(body)
        shape = engine.ModelBuilder.ShapeConfig(
            density=density(one),
            mu=one.friction,
            restitution=one.restitution,
        )
        at = wp.transform_identity() if one.mass_kg else place
        if len(one.size_m) == 1:
            builder.add_shape_sphere(body, xform=at, radius=one.size_m[0], cfg=shape)
        else:
            hx, hy, hz = one.size_m
            builder.add_shape_box(body, at, hx=hx, hy=hy, hz=hz, cfg=shape)
    model = builder.finalize(device="cpu")
    model.set_gravity(tuple(map(float, gravity)))
    solver = engine.solvers.SolverXPBD(model, enable_restitution=True)
    states, control = [model.state(), model.state()], model.control()
    rates = states[0].body_qd.numpy()
    for index, one in enumerate(bodies):
        if one.mass_kg:
            rates[made[index], 3:] = one.spin_rad_per_s
    states[0].body_qd.assign(rates)

    def step() -> None:
        contacts = model.collide(states[0])
        states[0].clear_forces()
        solver.step(states[0], states[1], control, contacts, STEP_S)
        states.reverse()

    def state(index: int) -> tuple[Any, Any, Any, Any]:
        pose = states[0].body_q.numpy()[made[index]]
        rate = states[0].body_qd.numpy()[made[index]]
        x, y, z, w = pose[3:]
        return pose[:3], rate[:3], rate[3:], matrix(w, x, y, z)

    return World(step, state)


def drake(bodies: list[Body], gravity: Any) -> World:
    """Return a scene of Drake with compliant hydroelastic contact."""
    from pydrake import geometry, math
    from pydrake.multibody import math as spatial, plant as plants, tree
    from pydrake.systems import analysis, framework

    builder = framework.DiagramBuilder()
    plant, _ = plants.AddMultibodyPlantSceneGraph(builder, STEP_S)
    plant.mutable_gravity_field().set_gravity_vector(gravity)
    made = []
    for index, one in enumerate(bodies):
        properties = geometry.ProximityProperties()
        if one.mass_kg:
            soften = geometry.AddCompliantHydroelasticProperties
            soften(0.05, MODULUS_PA, properties)
        else:
            # A compliant floor resists a sliding box with a force that grows with its speed.
            geometry.AddRigidHydroelasticProperties(1.0, properties)
        friction = plants.CoulombFriction(one.friction, one.friction)
        geometry.AddContactMaterial(friction=friction, properties=properties)
        if len(one.size_m) == 1:
            shape = geometry.Sphere(one.size_m[0])
            inertia = tree.UnitInertia.SolidSphere(one.size_m[0])
        else:
            edges_m = [2.0 * half for half in one.size_m]
            shape = geometry.Box(*edges_m)
            inertia = tree.UnitInertia.SolidBox(*edges_m)
        body, at = plant.world_body(), math.RigidTransform(one.place_m)
        if one.mass_kg:
            solid = tree.SpatialInertia(one.mass_kg, np.zeros(3), inertia)
            body, at = plant.AddRigidBody(f"b{index}", solid), math.RigidTransform()
        plant.RegisterCollisionGeometry(body, at, shape, f"s{index}", properties)
        made.append(body)
    plant.Finalize()
    simulator = analysis.Simulator(builder.Build())
    context = plant.GetMyContextFromRoot(simulator.get_mutable_context())
    for index, one in enumerate(bodies):
        if one.mass_kg:
            body = made[index]
            plant.SetFreeBodyPose(context, body, math.RigidTransform(one.place_m))
            speed = spatial.SpatialVelocity(one.spin_rad_per_s, np.zeros(3))
            plant.SetFreeBodySpatialVelocity(body, speed, context)
    simulator.Initialize()

    def step() -> None:
        simulator.AdvanceTo(simulator.get_context().get_time() + STEP_S)

    def state(index: int) -> tuple[Any, Any, Any, Any]:
        pose = plant.EvalBodyPoseInWorld(context, made[index])
        rate = plant.EvalBodySpatialVelocityInWorld(context, made[index])
        turned = pose.rotation().matrix()
        return pose.translation(), rate.translational(), rate.rotational(), turned

    return World(step, state)


def genesis(bodies: list[Body], gravity: Any) -> World:
    import genesis as gs

    if not getattr(gs, "_initialized", False):
        gs.init(backend=gs.cpu, logging_level="error")
    pull = tuple(map(float, gravity))
    options = gs.options.SimOptions(dt=STEP_S, gravity=pull)
    # In 0.2.1 the gravity of the first scene stays in the default of these.
    rigid = gs.options.RigidOptions(dt=STEP_S, gravity=pull)
    scene = gs.Scene(sim_options=options, rigid_options=rigid, show_viewer=False)
    made = []
    for one in bodies:
        material = gs.materials.Rigid(rho=density(one), friction=one.friction)
        place = {"pos": one.place_m, "fixed": not one.mass_kg}
        if len(one.size_m) == 1:
            shape = gs.morphs.Sphere(radius=one.size_m[0], **place)
        else:
            shape = gs.morphs.Box(size=tuple(2 * half for half in one.size_m), **place)
        made.append(scene.add_entity(shape, material=material))
    scene.build()
    for index, one in enumerate(bodies):
        if one.mass_kg:
            speed = np.array([0.0, 0.0, 0.0, *one.spin_rad_per_s])
            made[index].set_dofs_velocity(speed)

    def state(index: int) -> tuple[Any, Any, Any, Any]:
        body = made[index]
        found = (body.get_pos(), body.get_vel(), body.get_ang(), body.get_quat())
        place, speed, spin, turned = (np.asarray(one.cpu(), float) for one in found)
        return place, speed, spin, matrix(*turned)

    return World(scene.step, state)


ENGINES = {
    "pybullet": pybullet,
    "sapien": sapien,
    "rapier3d": rapier3d,
    "mujoco-warp": mujoco_warp,
    "newton": newton,
    "drake": drake,
    "genesis-world": genesis,
}
WITHOUT_RESTITUTION = ("mujoco-warp", "drake", "genesis-world")
"""Engines that have no coefficient of restitution."""

# --- scenes ----------------------------------------------------------------------------------------------------------

FLOOR = Body((5.0, 5.0, 0.5), (0.0, 0.0, -0.5), 0.0)
HALF_M = 0.1


def tilted(degrees: float) -> Any:
    """Return gravity on a slope, along whose surface x points down [m/s^2]."""
    angle = np.radians(degrees)
    return G * np.array([np.sin(angle), 0.0, -np.cos(angle)])


def run(build: Any, bodies: list[Body], gravity: Any, seconds: float) -> World:
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
