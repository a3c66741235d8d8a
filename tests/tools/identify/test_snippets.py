"""Printed lines of each engine, run on a pendulum that only the engine's own interface builds, against the backend."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gauge_envs.backends import backend
from gauge_envs.scene import Hinge
from gauge_envs.scene.motors import Servo
from gauge_envs.scene.servo_friction import SERVO_FRICTION
from gauge_envs.tools.bench.parts import ramp
from gauge_envs.tools.identify import Log, one_joint
from gauge_envs.tools.identify.rig import numbers, simulated, with_terms
from gauge_envs.tools.identify.snippets import snippet_lines

MASS_KG, LENGTH_M, G = 0.5, 0.2, 9.80665
RADIUS_M = 0.05 * LENGTH_M
INERTIA_KG_M2 = 0.4 * MASS_KG * RADIUS_M**2
STEP_S, STEPS = 1 / 1800, 1440
DRY, VISCOUS, ARMATURE = (
    "dry_friction_n_m",
    "viscous_friction_n_m_s_per_rad",
    "armature_kg_m2",
)
KP, KV = "kp_n_m_per_rad", "kv_n_m_s_per_rad"
START_RAD, LIMIT_N_M = 0.5, 0.8
PASSIVE = {DRY: 0.05, VISCOUS: 0.01, ARMATURE: 0.01}
SERVO = {KP: 3.0, KV: 0.15, ARMATURE: 0.01}


def mujoco_angles(lines, command, torque):
    import mujoco

    _, joint, *servo = lines.splitlines()
    place = f'type="hinge" axis="0 1 0" pos="0 0 {LENGTH_M}"/>'
    inertial = f'<inertial pos="0 0 0" mass="{MASS_KG}" diaginertia="{f"{INERTIA_KG_M2} " * 3}"/>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{STEP_S}" integrator="RK4" gravity="0 0 {-G}"/><worldbody>'
        f'<body pos="0 0 {-LENGTH_M}">{joint.replace("/>", place)}{inertial}</body></worldbody>'
        f"<actuator>{''.join(servo)}</actuator></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qpos[:] = START_RAD
    data.ctrl[:] = command
    angles = [START_RAD]
    for _ in range(STEPS):
        data.qfrc_applied[:] = torque(data.qpos[0], data.qvel[0])
        mujoco.mj_step(model, data)
        angles.append(float(data.qpos[0]))
    return np.array(angles)


def pybullet_angles(lines, command, torque):
    import pybullet
    from pybullet_utils.bullet_client import BulletClient

    client = BulletClient(pybullet.DIRECT)
    client.setGravity(0.0, 0.0, -G)
    client.setTimeStep(STEP_S)
    body = client.createMultiBody(
        baseMass=0.0,
        linkMasses=[MASS_KG],
        linkCollisionShapeIndices=[-1],
        linkVisualShapeIndices=[-1],
        linkPositions=[[0.0, 0.0, 0.0]],
        linkOrientations=[[0.0, 0.0, 0.0, 1.0]],
        linkInertialFramePositions=[[0.0, 0.0, -LENGTH_M]],
        linkInertialFrameOrientations=[[0.0, 0.0, 0.0, 1.0]],
        linkParentIndices=[0],
        linkJointTypes=[pybullet.JOINT_REVOLUTE],
        linkJointAxis=[[0.0, 1.0, 0.0]],
    )
    client.changeDynamics(
        body,
        0,
        localInertiaDiagonal=[INERTIA_KG_M2] * 3,
        linearDamping=0.0,
        angularDamping=0.0,
    )
    client.resetJointState(body, 0, START_RAD)
    names = ("changeDynamics", "setJointMotorControl2")
    exec(
        lines,
        {"body": body, "VELOCITY_CONTROL": pybullet.VELOCITY_CONTROL}
        | {n: getattr(client, n) for n in names},
    )
    angles = [START_RAD]
    for _ in range(STEPS):
        angle, rate = client.getJointState(body, 0)[:2]
        client.setJointMotorControl2(
            body, 0, pybullet.TORQUE_CONTROL, force=torque(angle, rate)
        )
        client.stepSimulation()
        angles.append(client.getJointState(body, 0)[0])
    client.disconnect()
    return np.array(angles)


def physx_angles(lines, command, torque):
    import sapien
    from sapien import physx

    system = physx.PhysxCpuSystem()
    system.timestep = STEP_S
    system.config.gravity = np.array([0.0, 0.0, -G])
    scene = sapien.Scene([system])
    builder = scene.create_articulation_builder()
    root = builder.create_link_builder()
    root.set_mass_and_inertia(1.0, sapien.Pose(), [1.0, 1.0, 1.0])
    link = builder.create_link_builder(root)
    turn = sapien.Pose(q=[np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    link.set_joint_properties("revolute", [[-np.inf, np.inf]], turn, turn)
    link.set_mass_and_inertia(
        MASS_KG, sapien.Pose([0.0, 0.0, -LENGTH_M]), [INERTIA_KG_M2] * 3
    )
    arm = builder.build(fix_root_link=True)
    (joint,) = arm.active_joints
    for part in arm.links:
        part.linear_damping = part.angular_damping = 0.0
    arm.set_qpos([START_RAD])
    exec(lines, {"joint_0": joint})
    joint.set_drive_target(command)
    angles = [START_RAD]
    for _ in range(STEPS):
        arm.set_qf([torque(arm.qpos[0], arm.qvel[0])])
        scene.step()
        angles.append(float(arm.qpos[0]))
    return np.array(angles)


def rapier_angles(lines, command, torque):
    import rapier3d as rapier

    world = rapier.PhysicsWorld(gravity=(0.0, 0.0, -G))
    world.integration_parameters.dt = STEP_S
    # A link starts where both frames agree, which is angle 0 of its motor.
    start = Rotation.from_euler("y", START_RAD)
    turn = Rotation.from_euler("z", 90, degrees=True)
    place = rapier.Isometry3(
        tuple(start.apply([0.0, 0.0, -LENGTH_M])), tuple(start.as_quat())
    )
    mass = rapier.MassProperties(
        (0.0, 0.0, 0.0), MASS_KG, (INERTIA_KG_M2,) * 3, (0.0, 0.0, 0.0, 1.0)
    )
    bob = world.add_body(
        rapier.RigidBody.dynamic()
        .position(place)
        .additional_mass_properties(mass)
        .can_sleep(False)
    )
    anchor = world.add_body(rapier.RigidBody.fixed())
    builder = rapier.GenericJointBuilder(rapier.JointAxesMask.LOCKED_REVOLUTE_AXES)
    builder = builder.local_frame1(
        rapier.Isometry3((0.0, 0.0, 0.0), tuple(turn.as_quat()))
    )
    top = rapier.Isometry3((0.0, 0.0, LENGTH_M), tuple((start.inv() * turn).as_quat()))
    world.multibody_joints.insert(anchor, bob, builder.local_frame2(top).build())
    link = world.multibody_joints.rigid_body_link(bob)
    chain = world.multibody_joints.get_multibody(link.multibody)
    given = {
        "chain": chain,
        "link_0": link.id,
        "axis_0": rapier.JointAxis.ANG_X,
        "command": command - START_RAD,
    }
    exec(lines, given | {"MotorModel": rapier.MotorModel})
    angles = [START_RAD]
    for _ in range(STEPS):
        rate = chain.generalized_velocity()[0]
        body = world.rigid_bodies[bob]
        body.reset_torques()
        body.add_torque((0.0, torque(angles[-1], rate), 0.0))
        world.step()
        x, _, z = world.rigid_bodies[bob].translation.to_tuple()
        angles.append(float(np.arctan2(-x, -z)))
    return np.array(angles)


def newton_angles(lines, command, torque):
    import newton
    import warp as wp
    from newton.solvers import SolverMuJoCo

    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -G))
    SolverMuJoCo.register_custom_attributes(builder)
    made = {"wp": wp, "newton": newton}
    exec(lines, made)
    inertia = wp.mat33(np.eye(3) * INERTIA_KG_M2)
    bob = builder.add_link(mass=MASS_KG, inertia=inertia, xform=wp.transform())
    joint = builder.add_joint_revolute(
        -1,
        bob,
        child_xform=wp.transform(wp.vec3(0.0, 0.0, LENGTH_M)),
        axis=(0.0, 1.0, 0.0),
        **made["joint_0"],
    )
    builder.add_articulation([joint])
    builder.joint_q[:] = [START_RAD]
    model = builder.finalize(device="cpu")
    solver, control = SolverMuJoCo(model), model.control()
    state, after = model.state(), model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    control.joint_target_q.fill_(command)
    angles = [START_RAD]
    for _ in range(STEPS):
        solver.step(state, after, control, None, STEP_S)
        state, after = after, state
        angles.append(float(state.joint_q.numpy()[0]))
    return np.array(angles)


def drake_angles(lines, command, torque):
    from pydrake.math import RigidTransform
    from pydrake.multibody import plant as plants, tree
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    builder = DiagramBuilder()
    plant, _ = plants.AddMultibodyPlantSceneGraph(builder, STEP_S)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -G])
    plant.set_discrete_contact_approximation(plants.DiscreteContactApproximation.kSap)
    inertia = tree.UnitInertia.SolidSphere(RADIUS_M)
    bob = plant.AddRigidBody("bob", tree.SpatialInertia(MASS_KG, np.zeros(3), inertia))
    joint = plant.AddJoint(
        tree.RevoluteJoint(
            "hinge",
            plant.world_frame(),
            plant.AddFrame(
                tree.FixedOffsetFrame(
                    "top", bob.body_frame(), RigidTransform([0.0, 0.0, LENGTH_M])
                )
            ),
            [0.0, 1.0, 0.0],
        )
    )
    exec(
        lines,
        {"plant": plant, "joint_0": joint, "PdControllerGains": tree.PdControllerGains},
    )
    joint.set_default_angle(START_RAD)
    plant.Finalize()
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.get_actuation_input_port().FixValue(context, np.zeros(plant.num_actuators()))
    plant.get_desired_state_input_port(
        plant.GetModelInstanceByName("DefaultModelInstance")
    ).FixValue(context, np.zeros(2 * plant.num_actuators()))
    angles = [START_RAD]
    for step in range(STEPS):
        simulator.AdvanceTo((step + 1) * STEP_S)
        angles.append(joint.get_angle(context))
    return np.array(angles)


BUILT = {
    "mujoco": mujoco_angles,
    "pybullet": pybullet_angles,
    "physx": physx_angles,
    "rapier": rapier_angles,
    "newton": newton_angles,
    "drake": drake_angles,
}
MODULES = {"drake": "pydrake", "physx": "sapien", "rapier": "rapier3d"}


@pytest.mark.parametrize(
    "terms", [PASSIVE, SERVO, PASSIVE | SERVO], ids=["passive", "servo", "both"]
)
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name, marks=pytest.mark.slow if name in ("newton", "drake") else ()
        )
        for name in BUILT
    ],
)
def test_the_printed_lines_move_a_joint_as_the_backend_does(name, terms):
    pytest.importorskip(MODULES.get(name, name))
    terms = {
        one: value
        for one, value in terms.items()
        if name != "pybullet" or one != ARMATURE
    }
    times_s = np.arange(0, STEPS + 1, 10) * STEP_S
    command = np.zeros((times_s.size, 1)) if KP in terms else None
    log, start = (
        Log("", times_s, np.full((times_s.size, 1), START_RAD), command),
        np.array([START_RAD]),
    )
    engine, scene = backend(name), one_joint(MASS_KG, LENGTH_M)
    if KP in terms:
        motor = Servo(
            command=ramp(0.0, start_s=0.0, duration_s=1.0, ramp_s=0.0),
            kp_n_m_per_rad=1.0,
            torque_limit_n_m=LIMIT_N_M,
        )
        (hinge,) = scene.joints
        assert isinstance(hinge, Hinge)
        scene = replace(scene, joints=(replace(hinge, motor=motor),))
    expected = simulated(
        engine, scene, log, [terms], (start, np.zeros(1)), {"timestep_s": STEP_S}
    )[:, 0]
    joints = numbers(with_terms(scene, [terms], log, start))
    lines = snippet_lines(name, ["elbow"], joints, [()], [{}], STEP_S)
    left = {one: value for one, value in terms.items() if f": {one} =" in lines}
    assert not left or name in ("pybullet", "physx", "rapier"), left

    def torque(angle, rate):
        servo = -left.get(KP, 0.0) * angle - left.get(KV, 0.0) * rate
        return (
            float(np.clip(servo, -LIMIT_N_M, LIMIT_N_M)) - left.get(VISCOUS, 0.0) * rate
        )

    angles = BUILT[name](lines, 0.0, torque)[::10]
    assert np.abs(angles - expected).max() < 0.002


# Parameters of mjlab 1.6 (ActuatorCfg), Isaac Lab 2.3 and 3.0 (ActuatorBaseCfg) and ManiSkill 3.0.
STACK_PARAMETERS = {
    "BuiltinPositionActuatorCfg": "stiffness damping effort_limit frictionloss viscous_damping armature "
    "target_names_expr delay_min_lag delay_max_lag",
    "DelayedPDActuatorCfg": "stiffness damping effort_limit friction dynamic_friction viscous_friction armature "
    "joint_names_expr min_delay max_delay",
    "PDJointPosControllerConfig": "joint_names lower upper stiffness damping force_limit friction",
}
ALL = PASSIVE | SERVO | {"torque_limit_n_m": 0.8, "delay_s": 0.0102}


@pytest.mark.parametrize("stack", ["mjlab", "isaaclab", "maniskill"])
def test_a_training_stack_gets_parameters_that_it_has(stack):
    """The lines of each stack run with classes of its parameters, and set every number but what they say."""
    set_by, made = {}, {}

    def config(name):
        def make(*joints, **given):
            assert {*given} <= {*STACK_PARAMETERS[name].split()}
            made.update(given)

        return make

    class Joint:
        solimp_friction = np.zeros(5)
        solref_friction = np.zeros(2)

        def set_armature(self, values):
            set_by["armature"] = values[0]

    joint = Joint()
    joint._objs = [joint]
    place = {name: config(name) for name in STACK_PARAMETERS}
    place["robot"] = SimpleNamespace(joints_map={"elbow": joint})
    place["spec"] = SimpleNamespace(joint=lambda name: joint)
    terms = dict.fromkeys((*SERVO_FRICTION, "quadratic_friction_n_m_s2_per_rad2"), 0.0) | ALL  # fmt: skip
    lines = snippet_lines(stack, ["elbow"], [terms], [()], [{}], 0.005)
    for line in lines.splitlines():
        exec(line, place)
    limit = {"maniskill": "force_limit"}.get(stack, "effort_limit")
    assert (made["stiffness"], made["damping"], made[limit]) == (3.0, 0.15, 0.8)
    assert made.get("armature", set_by.get("armature")) == 0.01
    steps = {"mjlab": made.get("delay_max_lag"), "isaaclab": made.get("max_delay")}
    assert steps.get(stack, 2) == 2
    left = [name for name in ALL if f": {name} =" in lines]
    assert left == ([DRY, VISCOUS, "delay_s"] if stack == "maniskill" else [])
    if stack == "mjlab":
        assert joint.solimp_friction[0] == 0.9999
