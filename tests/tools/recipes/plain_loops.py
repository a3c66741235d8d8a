"""Loops in the engines themselves, built from the snippet of a recipe and nothing else of this package.

Those with the name of an engine return the friction of a slide of a plate and the restitution of drops of a ball. Those
of `SLIDES` return the friction of one slide.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

G = 9.80665
RADIUS, DROP = 0.03, 0.2
PHASES = 4
"""Drops from heights that differ by less than the fall of a step."""
PLATE = (0.12, 0.12, 0.03)


def slope_of(friction: float) -> float:
    return math.atan(friction) + math.radians(10.0)


def friction_of(times: Any, path: Any, slope: float) -> float:
    """Friction from the acceleration of a slide after 0.1 s."""
    seen = np.asarray(times) >= 0.1
    acceleration = (
        2.0 * np.polyfit(np.asarray(times)[seen], np.asarray(path)[seen], 2)[0]
    )
    return float((G * math.sin(slope) - acceleration) / (G * math.cos(slope)))


def friction_under(times: Any, path: Any, lift: Any, slope: float) -> float:
    """Friction over normal force of a body on a slope, from its mean accelerations along and off it after 0.1 s."""
    seen = np.asarray(times) >= 0.1
    along, off = (
        2.0 * np.polyfit(np.asarray(times)[seen], np.asarray(one)[seen], 2)[0]
        for one in (path, lift)
    )
    return float((G * math.sin(slope) - along) / (G * math.cos(slope) + off))


def restitution_of(heights: Any) -> float:
    """Root of the second peak's height over the first one's."""
    heights = np.asarray(heights)
    low = int(np.argmax(np.diff(heights) > 1e-7))
    return math.sqrt(max(float(heights[low:].max()), 0.0) / float(heights[0]))


def heights_of_drops(step: float) -> list[float]:
    return [
        DROP + math.sqrt(2.0 * G * DROP) * step * index / PHASES
        for index in range(PHASES)
    ]


def mujoco(
    snippet: str, friction: float, mass: float, step: float, *, stepped: float = 1.0
) -> tuple[float, float]:
    """MuJoCo, from MJCF; `stepped` multiplies the time step of the loop behind the back of the recipe."""
    import mujoco as mj

    def model(geom: str, position: str) -> Any:
        return mj.MjModel.from_xml_string(
            f"<mujoco>{snippet}<worldbody><geom name='floor' type='plane' size='9 9 1'/>"
            f"<body pos='{position}'><freejoint/><geom name='foot' mass='{mass}' {geom}/></body></worldbody></mujoco>"
        )

    slope = slope_of(friction)
    plate = model(
        f"type='box' size='{PLATE[0] / 2} {PLATE[1] / 2} {PLATE[2] / 2}'",
        f"0 0 {PLATE[2] / 2}",
    )
    plate.opt.timestep = stepped * step
    plate.opt.gravity[:] = (G * math.sin(slope), 0.0, -G * math.cos(slope))
    data = mj.MjData(plate)
    times, path = [0.0], [0.0]
    while data.time < 0.5:
        mj.mj_step(plate, data)
        times.append(data.time)
        path.append(data.qpos[0])
    rebounds = []
    for height in heights_of_drops(step):
        ball = model(f"type='sphere' size='{RADIUS}'", f"0 0 {RADIUS + height}")
        ball.opt.timestep = stepped * step
        ball.opt.gravity[:] = (0.0, 0.0, -G)
        data = mj.MjData(ball)
        heights = [height]
        while data.time < 0.5:
            mj.mj_step(ball, data)
            heights.append(data.qpos[2] - RADIUS)
        rebounds.append(restitution_of(heights))
    return friction_of(times, path, slope), float(np.mean(rebounds))


def rapier(
    snippet: str, friction: float, mass: float, step: float
) -> tuple[float, float]:
    """Rapier, from Python."""
    import rapier3d as rp

    names: dict[str, Any] = {}
    exec(snippet, names)

    def world(
        gravity: tuple[float, float, float], height: float, shape: Any
    ) -> tuple[Any, Any]:
        made = rp.PhysicsWorld(gravity=gravity)
        names["set_parameters"](made)
        made.add_body(
            rp.RigidBody.fixed(),
            [names["with_contact"](rp.Collider.halfspace((0.0, 0.0, 1.0)))],
        )
        builder = (
            rp.RigidBody.dynamic().translation((0.0, 0.0, height)).can_sleep(False)
        )
        handle = made.add_body(builder, [names["with_contact"](shape.mass(mass))])
        return made, made.rigid_bodies[handle]

    slope = slope_of(friction)
    made, body = world(
        (G * math.sin(slope), 0.0, -G * math.cos(slope)),
        PLATE[2] / 2,
        rp.Collider.cuboid(*(0.5 * edge for edge in PLATE)),
    )
    times, path = [0.0], [0.0]
    while times[-1] < 0.5:
        made.step()
        times.append(times[-1] + step)
        path.append(body.translation.x)
    rebounds = []
    for height in heights_of_drops(step):
        made, body = world((0.0, 0.0, -G), RADIUS + height, rp.Collider.ball(RADIUS))
        heights = [height]
        for _ in range(round(0.5 / step)):
            made.step()
            heights.append(body.translation.z - RADIUS)
        rebounds.append(restitution_of(heights))
    return friction_of(times, path, slope), float(np.mean(rebounds))


def physx(
    snippet: str, friction: float, mass: float, step: float
) -> tuple[float, float]:
    """SAPIEN, from Python."""
    import sapien

    names: dict[str, Any] = {}
    before = sapien.physx.get_scene_config()
    kept = before.gravity, before.bounce_threshold

    def world(gravity: list[float], height: float, **shape: Any) -> tuple[Any, Any]:
        sapien.physx.set_scene_config(gravity=np.array(gravity))
        exec(snippet, names)
        system = sapien.physx.PhysxCpuSystem()
        made = sapien.Scene([system])
        made.set_timestep(names["timestep"])
        made.add_ground(0.0, render=False, material=names["material"])
        builder = made.create_actor_builder()
        if "radius" in shape:
            builder.add_sphere_collision(material=names["material"], **shape)
        else:
            builder.add_box_collision(material=names["material"], **shape)
        actor = builder.build()
        actor.set_pose(sapien.Pose([0.0, 0.0, height]))
        component = actor.find_component_by_type(
            sapien.physx.PhysxRigidDynamicComponent
        )
        component.mass = mass
        return made, actor

    try:
        slope = slope_of(friction)
        made, body = world(
            [G * math.sin(slope), 0.0, -G * math.cos(slope)],
            PLATE[2] / 2,
            half_size=[0.5 * edge for edge in PLATE],
        )
        times, path = [0.0], [0.0]
        while times[-1] < 0.5:
            made.step()
            times.append(times[-1] + step)
            path.append(float(body.pose.p[0]))
        rebounds = []
        for height in heights_of_drops(step):
            made, body = world([0.0, 0.0, -G], RADIUS + height, radius=RADIUS)
            heights = [height]
            for _ in range(round(0.5 / step)):
                made.step()
                heights.append(float(body.pose.p[2]) - RADIUS)
            rebounds.append(restitution_of(heights))
    finally:
        sapien.physx.set_scene_config(gravity=kept[0], bounce_threshold=kept[1])
    return friction_of(times, path, slope), float(np.mean(rebounds))


def pybullet(
    snippet: str, friction: float, mass: float, step: float
) -> tuple[float, float]:
    """PyBullet, from Python."""
    import pybullet as pb

    names: dict[str, Any] = {}
    exec(snippet, names)

    def world(
        gravity: tuple[float, float, float], height: float, **shape: Any
    ) -> tuple[int, int]:
        client = pb.connect(pb.DIRECT)
        pb.setGravity(*gravity, physicsClientId=client)
        flags = {"flags": pb.URDF_INITIALIZE_SAT_FEATURES}
        ground = pb.createCollisionShape(
            pb.GEOM_BOX,
            halfExtents=[8, 8, 8],
            collisionFramePosition=[0, 0, -8],
            physicsClientId=client,
            **flags,
        )
        floor = pb.createMultiBody(
            0, ground, physicsClientId=client, **names["COORDINATES"]
        )
        kind = pb.GEOM_SPHERE if "radius" in shape else pb.GEOM_BOX
        made = pb.createCollisionShape(kind, physicsClientId=client, **shape, **flags)
        foot = pb.createMultiBody(
            mass,
            made,
            basePosition=[0, 0, height],
            physicsClientId=client,
            **names["COORDINATES"],
        )
        names["set_contact"](foot, floor, client)
        return client, foot

    def place(client: int, foot: int) -> tuple[float, float, float]:
        found: tuple[float, float, float] = pb.getBasePositionAndOrientation(
            foot, physicsClientId=client
        )[0]
        return found

    slope = slope_of(friction)
    client, foot = world(
        (G * math.sin(slope), 0.0, -G * math.cos(slope)),
        PLATE[2] / 2,
        halfExtents=[0.5 * edge for edge in PLATE],
    )
    times, path = [0.0], [0.0]
    while times[-1] < 0.5:
        pb.stepSimulation(physicsClientId=client)
        times.append(times[-1] + step)
        path.append(place(client, foot)[0])
    pb.disconnect(client)
    rebounds = []
    for height in heights_of_drops(step):
        client, foot = world((0.0, 0.0, -G), RADIUS + height, radius=RADIUS)
        heights = [height]
        for _ in range(round(0.5 / step)):
            pb.stepSimulation(physicsClientId=client)
            heights.append(place(client, foot)[2] - RADIUS)
        pb.disconnect(client)
        rebounds.append(restitution_of(heights))
    return friction_of(times, path, slope), float(np.mean(rebounds))


def drake(
    snippet: str, friction: float, mass: float, step: float
) -> tuple[float, float]:
    """Drake, from Python; the plate has spheres at its corners."""
    from pydrake.geometry import HalfSpace, Sphere
    from pydrake.math import RigidTransform
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
    from pydrake.multibody.tree import SpatialInertia
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    names: dict[str, Any] = {}
    exec(snippet, names)

    def world(
        gravity: list[float],
        height: float,
        inertia: Any,
        points: list[list[float]],
        radius: float,
    ) -> Any:
        builder = DiagramBuilder()
        plant, _ = AddMultibodyPlantSceneGraph(builder, names["TIME_STEP"])
        names["set_contact"](plant)
        plant.mutable_gravity_field().set_gravity_vector(gravity)
        ground = names["properties"](is_ground=True)
        plant.RegisterCollisionGeometry(
            plant.world_body(), RigidTransform(), HalfSpace(), "floor", ground
        )
        foot = plant.AddRigidBody("foot", inertia)
        for index, point in enumerate(points):
            given = names["properties"](len(points))
            plant.RegisterCollisionGeometry(
                foot, RigidTransform(point), Sphere(radius), f"foot-{index}", given
            )
        plant.Finalize()
        simulator = Simulator(builder.Build())
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        plant.SetFreeBodyPose(context, foot, RigidTransform([0.0, 0.0, height]))
        simulator.Initialize()
        return simulator, lambda: plant.EvalBodyPoseInWorld(context, foot).translation()

    slope = slope_of(friction)
    corners = [
        [sx * PLATE[0] / 2, sy * PLATE[1] / 2, -PLATE[2] / 2]
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    inertia = SpatialInertia.SolidBoxWithMass(mass, *PLATE)
    gravity = [G * math.sin(slope), 0.0, -G * math.cos(slope)]
    simulator, place = world(gravity, PLATE[2] / 2, inertia, corners, 1e-6)
    times, path = [0.0], [0.0]
    while times[-1] < 0.5:
        times.append(times[-1] + step)
        simulator.AdvanceTo(times[-1])
        path.append(place()[0])
    rebounds = []
    for height in heights_of_drops(step):
        ball = SpatialInertia.SolidSphereWithMass(mass, RADIUS)
        simulator, place = world(
            [0.0, 0.0, -G], RADIUS + height, ball, [[0.0, 0.0, 0.0]], RADIUS
        )
        heights = [height]
        for index in range(round(0.5 / step)):
            simulator.AdvanceTo((index + 1) * step)
            heights.append(place()[2] - RADIUS)
        rebounds.append(restitution_of(heights))
    return friction_of(times, path, slope), float(np.mean(rebounds))


def newton(
    snippet: str, friction: float, mass: float, step: float
) -> tuple[float, float]:
    """Newton, from Python."""
    import newton as nt
    import warp as wp

    names: dict[str, Any] = {}
    exec(snippet, names)
    options = names["options"]

    def path_of(
        gravity: tuple[float, float, float], height: float, axis: int, **shape: float
    ) -> list[float]:
        builder = nt.ModelBuilder(gravity=gravity)
        nt.solvers.SolverMuJoCo.register_custom_attributes(builder)
        builder.add_shape_plane(
            body=-1, width=0.0, length=0.0, cfg=nt.ModelBuilder.ShapeConfig(gap=0.002)
        )
        moments = shape.pop("moments")
        foot = builder.add_body(
            xform=wp.transform(wp.vec3(0.0, 0.0, height), wp.quat_identity()),
            mass=mass,
            inertia=wp.mat33(np.diag(moments)),
            lock_inertia=True,
        )
        given = {"cfg": names["config"], "custom_attributes": names["attributes"]}
        names["config"].density = 0.0
        if "radius" in shape:
            builder.add_shape_sphere(foot, **shape, **given)
        else:
            builder.add_shape_box(foot, **shape, **given)
        model = builder.finalize(device="cpu")
        solver = nt.solvers.SolverMuJoCo(model, **options)
        pipeline = nt.CollisionPipeline(model)
        contacts = pipeline.contacts()
        state, after, control = model.state(), model.state(), model.control()
        found = [height]
        for _ in range(round(0.5 / step)):
            pipeline.collide(state, contacts)
            solver.step(state, after, control, contacts, names["timestep"])
            state, after = after, state
            found.append(float(state.body_q.numpy()[0, axis]))
        return found

    slope = slope_of(friction)
    x, y, z = PLATE
    moments = [
        mass * (y * y + z * z) / 12.0,
        mass * (x * x + z * z) / 12.0,
        mass * (x * x + y * y) / 12.0,
    ]
    gravity = (G * math.sin(slope), 0.0, -G * math.cos(slope))
    path = path_of(gravity, z / 2, 0, hx=x / 2, hy=y / 2, hz=z / 2, moments=moments)
    path[0] = 0.0
    rebounds = []
    for height in heights_of_drops(step)[:2]:
        moment = 0.4 * mass * RADIUS**2
        heights = path_of(
            (0.0, 0.0, -G), RADIUS + height, 2, radius=RADIUS, moments=[moment] * 3
        )
        rebounds.append(restitution_of(np.array(heights) - RADIUS))
    return friction_of(step * np.arange(len(path)), path, slope), float(
        np.mean(rebounds)
    )


def mujoco_warp(
    snippet: str, friction: float, mass: float, step: float
) -> tuple[float, float]:
    """mujoco_warp on the CPU, from MJCF."""
    import mujoco as mj
    import mujoco_warp as mjw
    import warp as wp

    def path_of(
        geom: str, position: str, gravity: tuple[float, float, float], axis: int
    ) -> list[float]:
        model = mj.MjModel.from_xml_string(
            f"<mujoco>{snippet}<worldbody><geom name='floor' type='plane' size='9 9 1'/>"
            f"<body pos='{position}'><freejoint/><geom name='foot' mass='{mass}' {geom}/></body></worldbody></mujoco>"
        )
        model.opt.gravity[:] = gravity
        with wp.ScopedDevice("cpu"):
            on_warp, state = mjw.put_model(model), mjw.put_data(model, mj.MjData(model))
            found = [float(state.qpos.numpy()[0, axis])]
            for _ in range(round(0.5 / step)):
                mjw.step(on_warp, state)
                found.append(float(state.qpos.numpy()[0, axis]))
        return found

    slope = slope_of(friction)
    gravity = (G * math.sin(slope), 0.0, -G * math.cos(slope))
    box = f"type='box' size='{PLATE[0] / 2} {PLATE[1] / 2} {PLATE[2] / 2}'"
    path = path_of(box, f"0 0 {PLATE[2] / 2}", gravity, 0)
    rebounds = []
    for height in heights_of_drops(step)[:2]:
        heights = path_of(
            f"type='sphere' size='{RADIUS}'",
            f"0 0 {RADIUS + height}",
            (0.0, 0.0, -G),
            2,
        )
        rebounds.append(restitution_of(np.array(heights) - RADIUS))
    return friction_of(step * np.arange(len(path)), path, slope), float(
        np.mean(rebounds)
    )


def genesis(
    snippet: str, friction: float, mass: float, step: float
) -> tuple[float, float]:
    """Genesis, from Python. Balls fall side by side in one scene."""
    import genesis as gs

    names: dict[str, Any] = {}
    exec(snippet, names)

    def paths_of(
        gravity: tuple[float, float, float], morphs: list[Any], volume: float
    ) -> Any:
        scene = gs.Scene(
            show_viewer=False,
            sim_options=gs.options.SimOptions(dt=names["DT"], gravity=gravity),
            rigid_options=names["rigid_options"](),
        )
        scene.add_entity(gs.morphs.Plane(), material=names["material"]())
        feet = []
        for morph in morphs:
            material = names["material"]()
            material.rho = mass / volume
            feet.append(scene.add_entity(morph, material=material))
        scene.build()
        names["set_contact"](scene)
        found = []
        for _ in range(round(0.5 / step)):
            found.append([foot.get_pos().cpu().numpy() for foot in feet])
            scene.step()
        return np.array(found)

    try:
        slope = slope_of(friction)
        gravity = (G * math.sin(slope), 0.0, -G * math.cos(slope))
        plate = gs.morphs.Box(size=PLATE, pos=(0.0, 0.0, PLATE[2] / 2))
        path = paths_of(gravity, [plate], PLATE[0] * PLATE[1] * PLATE[2])[:, 0, 0]
        places = [
            (0.2 * index, 0.0, RADIUS + height)
            for index, height in enumerate(heights_of_drops(step))
        ]
        balls = [gs.morphs.Sphere(radius=RADIUS, pos=place) for place in places]
        heights = (
            paths_of((0.0, 0.0, -G), balls, 4.0 / 3.0 * math.pi * RADIUS**3)[:, :, 2]
            - RADIUS
        )
        rebounds = [restitution_of(column) for column in heights.T]
    finally:
        gs.destroy()
    return friction_of(step * np.arange(len(path)), path, slope), float(
        np.mean(rebounds)
    )


def mujoco_slide(
    snippet: str,
    friction: float,
    mass: float,
    *,
    turn_deg: float,
    size: tuple[float, float, float] = PLATE,
    tip: tuple[float, float] = (0.0, 0.0),
    beyond_deg: float = 10.0,
    is_free: bool = False,
) -> float:
    """MuJoCo, from MJCF: a box on three sliding joints, which cannot turn, or a free one."""
    import mujoco as mj

    joints = "".join(
        f"<joint type='slide' axis='{axis}'/>" for axis in ("1 0 0", "0 1 0", "0 0 1")
    )
    x, y, z = (0.5 * edge for edge in size)
    height = z + x * abs(tip[1]) + y * abs(tip[0])
    model = mj.MjModel.from_xml_string(
        f"<mujoco><compiler eulerseq='XYZ' angle='radian'/>{snippet}<worldbody><geom name='floor' type='plane' "
        f"size='9 9 1'/><body pos='0 0 {height}' euler='{tip[0]} {tip[1]} {math.radians(turn_deg)}'>"
        f"{'<freejoint/>' if is_free else joints}<geom name='foot' type='box' size='{x} {y} {z}' mass='{mass}'/></body>"
        "</worldbody></mujoco>"
    )
    slope = math.atan(friction) + math.radians(beyond_deg)
    model.opt.gravity[:] = (G * math.sin(slope), 0.0, -G * math.cos(slope))
    data = mj.MjData(model)
    times, places = [], []
    while data.time < 0.5:
        mj.mj_step(model, data)
        times.append(data.time)
        places.append(
            data.xpos[1].copy()
        )  # before the step that `time` follows: the shift changes no acceleration
    return friction_under(times, np.array(places)[:, 0], np.array(places)[:, 2], slope)


def rapier_slide(
    snippet: str,
    friction: float,
    mass: float,
    *,
    turn_deg: float,
    size: tuple[float, float, float] = PLATE,
    beyond_deg: float = 10.0,
    is_free: bool = False,
) -> float:
    """Rapier, from Python: a box whose rotations are locked, or a free one."""
    import rapier3d as rp

    names: dict[str, Any] = {}
    exec(snippet, names)
    slope = math.atan(friction) + math.radians(beyond_deg)
    made = rp.PhysicsWorld(gravity=(G * math.sin(slope), 0.0, -G * math.cos(slope)))
    names["set_parameters"](made)
    made.add_body(
        rp.RigidBody.fixed(),
        [names["with_contact"](rp.Collider.halfspace((0.0, 0.0, 1.0)))],
    )
    builder = (
        rp.RigidBody.dynamic().translation((0.0, 0.0, size[2] / 2)).can_sleep(False)
    )
    builder = builder.rotation((0.0, 0.0, math.radians(turn_deg))).enabled_rotations(
        (is_free, is_free, is_free)
    )
    foot = rp.Collider.cuboid(*(0.5 * edge for edge in size)).mass(mass)
    body = made.rigid_bodies[made.add_body(builder, [names["with_contact"](foot)])]
    step = made.integration_parameters.dt
    times, path, lift = [0.0], [0.0], [0.0]
    while times[-1] < 0.5:
        made.step()
        times.append(times[-1] + step)
        path.append(body.translation.x)
        lift.append(body.translation.z)
    return friction_under(times[1:], path[1:], lift[1:], slope)


def physx_slide(
    snippet: str,
    friction: float,
    mass: float,
    *,
    turn_deg: float,
    size: tuple[float, float, float] = PLATE,
    beyond_deg: float = 10.0,
    is_free: bool = False,
) -> float:
    """SAPIEN, from Python: a box whose rotations are locked, or a free one."""
    import sapien

    names: dict[str, Any] = {}
    slope = math.atan(friction) + math.radians(beyond_deg)
    before = sapien.physx.get_scene_config()
    kept = before.gravity, before.bounce_threshold
    try:
        sapien.physx.set_scene_config(
            gravity=np.array([G * math.sin(slope), 0.0, -G * math.cos(slope)])
        )
        exec(snippet, names)
        made = sapien.Scene([sapien.physx.PhysxCpuSystem()])
        made.set_timestep(names["timestep"])
        made.add_ground(0.0, render=False, material=names["material"])
        builder = made.create_actor_builder()
        builder.add_box_collision(
            material=names["material"], half_size=[0.5 * edge for edge in size]
        )
        actor = builder.build()
        half = math.radians(turn_deg) / 2.0
        actor.set_pose(
            sapien.Pose(
                [0.0, 0.0, size[2] / 2], [math.cos(half), 0.0, 0.0, math.sin(half)]
            )
        )
        component = actor.find_component_by_type(
            sapien.physx.PhysxRigidDynamicComponent
        )
        component.mass = mass
        component.set_locked_motion_axes([False] * 3 + [not is_free] * 3)
        times, places = [0.0], [actor.pose.p]
        while times[-1] < 0.5:
            made.step()
            times.append(times[-1] + names["timestep"])
            places.append(actor.pose.p)
    finally:
        sapien.physx.set_scene_config(gravity=kept[0], bounce_threshold=kept[1])
    return friction_under(times, np.array(places)[:, 0], np.array(places)[:, 2], slope)


SLIDES = {"mujoco": mujoco_slide, "rapier": rapier_slide, "physx": physx_slide}
