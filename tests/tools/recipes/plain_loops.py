"""Simulations in plain engines that use only the snippet of a recipe.

The function of each engine returns the positions of a body at each step of half a second. `slide` and `rebound` compute
friction and restitution from them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

G = 9.80665
RADIUS_M, DROP_M = 0.03, 0.2
DURATION_S = 0.5
PHASES = 4
"""Number of drops; their heights differ by less than the fall of a step."""
HALF_PLATE_M = (0.06, 0.06, 0.015)


@dataclass(frozen=True, kw_only=True)
class Foot:
    """A box or, without edges, a ball above the plane z = 0, which moves along x at the start."""

    mass_kg: float
    step_s: float
    height_m: float
    gravity: tuple[float, float, float] = (0.0, 0.0, -G)
    half_m: tuple[float, ...] = ()
    radius_m: float = RADIUS_M
    speed_m_per_s: float = 0.0


def slide(loop, snippet, friction, mass_kg, step_s):
    """Return the friction of a plate, from its mean accelerations along and off the slope after 0.1 s."""
    slope_rad = math.atan(friction) + math.radians(10.0)
    down, into = G * math.sin(slope_rad), G * math.cos(slope_rad)
    foot = Foot(
        mass_kg=mass_kg,
        step_s=step_s,
        height_m=HALF_PLATE_M[2],
        gravity=(down, 0.0, -into),
        half_m=HALF_PLATE_M,
    )
    places = loop(snippet, foot)
    times = step_s * np.arange(len(places))
    seen = times >= 0.1
    along, _, off = 2.0 * np.polyfit(times[seen], places[seen], 2)[0]
    return float((down - along) / (into + off))


def rebound(loop, snippet, mass_kg, step_s):
    """Return the mean restitution of drops: the square root of the ratio of the second to the first height."""
    restitutions = []
    for phase in range(PHASES):
        drop = DROP_M + math.sqrt(2.0 * G * DROP_M) * step_s * phase / PHASES
        foot = Foot(mass_kg=mass_kg, step_s=step_s, height_m=RADIUS_M + drop)
        heights = loop(snippet, foot)[:, 2] - RADIUS_M
        landed = heights[round(math.sqrt(2.0 * drop / G) / step_s) :]
        restitutions.append(math.sqrt(max(float(landed.max()), 0.0) / drop))
    return float(np.mean(restitutions))


def hop(loop, snippet, mass_kg, step_s, scale=1.0):
    """Return the largest rise of a plate that slides on level ground at 1 and 4 m/s [m]."""
    half_m = tuple(scale * edge for edge in HALF_PLATE_M)
    rises = []
    for speed in (1.0, 4.0):
        foot = Foot(
            mass_kg=mass_kg,
            step_s=step_s,
            height_m=half_m[2],
            half_m=half_m,
            speed_m_per_s=speed,
        )
        rises.append(float(loop(snippet, foot)[:, 2].max()) - half_m[2])
    return max(rises)


def impacts(loop, snippet, friction, mass_kg, step_s, scale=1.0):
    """Return friction over Coulomb's law in oblique impacts, and the mean rebound of those in which the ball slips.

    Velocities after n steps give the impulses of the contact. The rows are three speeds along the plane: two at which
    friction stops the slip, and one at which it cannot. The columns are phases within a step.
    """
    radius_m, down = scale * RADIUS_M, math.sqrt(2.0 * G * DROP_M)
    ratios, rebounds = [], []
    for tangent in (0.5, 1.0, 7.0 * friction * 1.6):
        for phase in range(PHASES):
            drop = DROP_M + down * step_s * phase / PHASES
            foot = Foot(
                mass_kg=mass_kg,
                step_s=step_s,
                height_m=radius_m + drop,
                radius_m=radius_m,
                speed_m_per_s=tangent * down,
            )
            places = loop(snippet, foot)
            impact_s = math.sqrt(2.0 * drop / G)
            last = round((impact_s + 0.05) / step_s)
            velocity = (places[last] - places[last - 1]) / step_s
            pressed = velocity[2] + G * last * step_s
            taken = tangent * down - velocity[0]
            ratios.append(taken / min(friction * pressed, 2.0 / 7.0 * tangent * down))
            landed = places[round(impact_s / step_s) :, 2] - radius_m
            rebounds.append(math.sqrt(max(float(landed.max()), 0.0) / drop))
    return np.reshape(ratios, (3, PHASES)), float(np.mean(rebounds[-PHASES:]))


def impact_friction(loop, snippet, friction, mass_kg, step_s):
    """Return the friction of the oblique impact that is farthest from Coulomb's law."""
    ratios, _ = impacts(loop, snippet, friction, mass_kg, step_s)
    return friction * float(max(ratios.ravel(), key=lambda ratio: abs(ratio - 1.0)))


def names_of(snippet):
    """Return the names that a snippet of Python defines."""
    names = {}
    exec(snippet, names)
    return names


def stepped_places(foot, step, place):
    """Return the positions before each step and after the last step, shape [count, 3]."""
    places = [np.array(place(), dtype=float)]
    for _ in range(round(DURATION_S / foot.step_s)):
        step()
        places.append(np.array(place(), dtype=float))
    return np.array(places)


def mujoco(snippet, foot):
    """Simulate in MuJoCo, from MJCF."""
    import mujoco as mj

    half = " ".join(map(str, foot.half_m))
    shape = (
        f"type='box' size='{half}'" if half else f"type='sphere' size='{foot.radius_m}'"
    )
    model = mj.MjModel.from_xml_string(
        f"<mujoco>{snippet}<worldbody><geom name='floor' type='plane' size='9 9 1'/>"
        f"<body pos='0 0 {foot.height_m}'><freejoint/><geom name='foot' mass='{foot.mass_kg}' {shape}/></body>"
        "</worldbody></mujoco>"
    )
    model.opt.gravity[:] = foot.gravity
    data = mj.MjData(model)
    data.qvel[0] = foot.speed_m_per_s
    mj.mj_forward(model, data)

    def step():
        mj.mj_step(model, data)
        mj.mj_kinematics(model, data)

    return stepped_places(foot, step, lambda: data.xpos[1])


def rapier(snippet, foot):
    """Simulate in Rapier, from Python."""
    import rapier3d as rp

    names = names_of(snippet)
    world = rp.PhysicsWorld(gravity=foot.gravity)
    names["set_parameters"](world)
    ground = rp.Collider.halfspace((0.0, 0.0, 1.0))
    world.add_body(rp.RigidBody.fixed(), [names["with_contact"](ground)])
    builder = rp.RigidBody.dynamic().translation((0.0, 0.0, foot.height_m))
    builder = builder.linvel((foot.speed_m_per_s, 0.0, 0.0))
    shape = (
        rp.Collider.cuboid(*foot.half_m)
        if foot.half_m
        else rp.Collider.ball(foot.radius_m)
    )
    colliders = [names["with_contact"](shape.mass(foot.mass_kg))]
    body = world.rigid_bodies[world.add_body(builder.can_sleep(False), colliders)]

    def place():
        return body.translation.x, body.translation.y, body.translation.z

    return stepped_places(foot, world.step, place)


def physx(snippet, foot):
    """Simulate in SAPIEN, from Python; its configurations are global."""
    import sapien

    before = sapien.physx.get_scene_config()
    kept = {"gravity": before.gravity, "bounce_threshold": before.bounce_threshold}
    try:
        sapien.physx.set_scene_config(gravity=np.array(foot.gravity))
        names = names_of(snippet)
        scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
        scene.set_timestep(names["timestep"])
        scene.add_ground(0.0, render=False, material=names["material"])
        builder = scene.create_actor_builder()
        if foot.half_m:
            builder.add_box_collision(half_size=foot.half_m, material=names["material"])
        else:
            builder.add_sphere_collision(
                radius=foot.radius_m, material=names["material"]
            )
        actor = builder.build()
        actor.set_pose(sapien.Pose([0.0, 0.0, foot.height_m]))
        kind = sapien.physx.PhysxRigidDynamicComponent
        part = actor.find_component_by_type(kind)
        # A new mass keeps the inertia of the density.
        part.inertia = part.inertia * foot.mass_kg / part.mass
        part.mass = foot.mass_kg
        part.linear_velocity = [foot.speed_m_per_s, 0.0, 0.0]
        return stepped_places(foot, scene.step, lambda: actor.pose.p)
    finally:
        sapien.physx.set_scene_config(**kept)


def pybullet(snippet, foot):
    """Simulate in PyBullet, from Python."""
    import pybullet as pb

    names = names_of(snippet)
    client = pb.connect(pb.DIRECT)
    here = {"physicsClientId": client}
    shaped = {"flags": pb.URDF_INITIALIZE_SAT_FEATURES, **here}
    pb.setGravity(*foot.gravity, **here)
    ground = pb.createCollisionShape(
        pb.GEOM_BOX, halfExtents=[8, 8, 8], collisionFramePosition=[0, 0, -8], **shaped
    )
    floor = pb.createMultiBody(0, ground, **names["COORDINATES"], **here)
    if foot.half_m:
        shape = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=foot.half_m, **shaped)
    else:
        shape = pb.createCollisionShape(pb.GEOM_SPHERE, radius=foot.radius_m, **shaped)
    place = {"basePosition": [0, 0, foot.height_m]}
    body = pb.createMultiBody(
        foot.mass_kg, shape, **place, **names["COORDINATES"], **here
    )
    names["set_contact"](body, floor, client)
    pb.resetBaseVelocity(body, [foot.speed_m_per_s, 0, 0], **here)
    places = stepped_places(
        foot,
        lambda: pb.stepSimulation(**here),
        lambda: pb.getBasePositionAndOrientation(body, **here)[0],
    )
    pb.disconnect(client)
    return places


LOOPS = {loop.__name__: loop for loop in (mujoco, rapier, physx, pybullet)}
