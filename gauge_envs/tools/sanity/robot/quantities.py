"""What a robot's model states of each link, joint and motor, by names that two models share."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.phenomena.base import facts
from gauge_envs.tools.sanity.robot.finding import body_name, joint_name, name_of
from gauge_envs.tools.sanity.robot.joints import servos, start
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import (
    JOINT_TRANSMISSIONS,
    Robot,
    couplings_of,
    ends_of,
    tendon_joints,
)


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A quantity of the parts of a robot.

    Attributes:
        title: What it is, of which part.
        unit: Its unit; `1` for a pure number.
        least: Difference up to which two values count as the same, in its unit.
        ratio: The same relative to the larger one; 0 for lengths and angles.
    """

    title: str
    unit: str
    least: float
    ratio: float


QUANTITIES: Mapping[str, Quantity] = {
    name: Quantity(**stated) for name, stated in facts("robot_quantities").items()
}
"""Quantities by the id of their row in a comparison."""

TASK = "the task"
"""Part of what a task states of the robot as a whole."""

TRANSMISSIONS = {
    int(mujoco.mjtTrn.mjTRN_JOINT): mujoco.mjtObj.mjOBJ_JOINT,
    int(mujoco.mjtTrn.mjTRN_JOINTINPARENT): mujoco.mjtObj.mjOBJ_JOINT,
    int(mujoco.mjtTrn.mjTRN_TENDON): mujoco.mjtObj.mjOBJ_TENDON,
}
"""Kind of object that a motor moves, by its transmission."""

OPTIONS = (
    *("integrator", "cone", "impratio", "solver", "iterations", "ls_iterations"),
    *("density", "viscosity", "noslip_iterations"),
)
"""Options of the engine beside the step, which a comparison has a row for."""

PREFIX = re.compile(r"\S*/")
"""Prefix of a scene in a name, as `robot/`."""


def quantities(robot: Robot) -> dict[str, dict[str, float]]:
    """Return the value of each part of a robot by the name of the part, for each quantity that the model states.

    Names have no prefix of a scene, as `robot/`, unless prefixes tell its sides. Values without a limit are infinite.
    """
    names = [body_name(robot, body) for body in robot.bodies]
    is_unique = len(set(map(short_name, names))) == len(names)
    found: dict[str, dict[str, float]] = {name: {} for name in QUANTITIES}
    for name, part, value in (
        *_of_links(robot),
        *_of_joints(robot),
        *_of_motors(robot),
        *_of_contacts(robot),
        *_of_tendons(robot),
        *_of_couplings(robot),
        *_of_sensors(robot),
        *_of_options(robot),
    ):
        found[name][short_name(part) if is_unique else part] = float(value)
    if robot.delay_s is not None:
        found["delay"][TASK] = robot.delay_s
    if robot.action_rad is not None:
        found["action-scale"][TASK] = robot.action_rad
    return found


def short_name(part: str) -> str:
    """Return the name of a part without the prefix of a scene."""
    return PREFIX.sub("", part)


ENDS, UNLIMITED = ("low", "high"), (-np.inf, np.inf)
"""Ends of a range, and those of one without limits."""


def _each(
    quantity: str, name: str, values: Iterable[float], words: Iterable[Any] = "xyz"
) -> Iterator[tuple[str, str, float]]:
    """Yield each component of a quantity of a part, by its word."""
    for word, value in zip(words, values, strict=True):
        yield quantity, f"{name} {word}", value


def _of_links(robot: Robot) -> Iterator[tuple[str, str, float]]:
    model = robot.model
    for body in robot.bodies:
        name = body_name(robot, body)
        yield "mass", name, model.body_mass[body]
        # The order of principal axes is the compiler's choice.
        moments = np.sort(model.body_inertia[body])
        yield from _each("inertia", name, moments, ("least", "middle", "largest"))
        yield from _each("centre-of-mass", name, model.body_ipos[body])
        if model.body_parentid[body]:
            yield from _each("link-place", name, model.body_pos[body])
            turn_rad = _turn_rad(model.body_quat[body])
            yield from _each("link-turn", name, turn_rad)
        axes = _axes(model.body_iquat[body])
        tensor = (axes * model.body_inertia[body]) @ axes.T
        trace = max(float(np.trace(tensor)), 1e-12)
        for first, second in combinations_with_replacement(range(3), 2):
            entry = f"{name} {'xyz'[first]}{'xyz'[second]}"
            yield "inertia-axes", entry, tensor[first, second] / trace
        yield "gravcomp", name, model.body_gravcomp[body]


def _axes(quaternion: FloatArray) -> FloatArray:
    """Return the rotation matrix of a quaternion, w first, shape [3, 3]."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _turn_rad(quaternion: FloatArray) -> FloatArray:
    """Return the rotation vector of a quaternion [rad], shape [3]; of a half turn its first part is positive."""
    turn_rad: FloatArray = Rotation.from_quat(quaternion, scalar_first=True).as_rotvec()
    is_half = np.linalg.norm(turn_rad) > np.pi - 1e-4
    first = turn_rad[np.abs(turn_rad) > 1e-4][:1]
    return -turn_rad if is_half and first < 0.0 else turn_rad


def _of_joints(robot: Robot) -> Iterator[tuple[str, str, float]]:
    model, data, start_data = robot.model, mujoco.MjData(robot.model), start(robot)
    mujoco.mj_kinematics(model, data)
    is_simple = joints_of(model, "HINGE", "SLIDE")
    carriers = data.xmat[model.body_parentid[model.jnt_bodyid]].reshape(-1, 3, 3)
    axes = np.einsum("jba,jb->ja", carriers, data.xaxis)
    for dof in range(model.nv):
        joint, name = int(model.dof_jntid[dof]), joint_name(robot, dof)
        if int(model.dof_bodyid[dof]) not in robot.bodies or not is_simple[joint]:
            continue
        yield "damping", name, model.dof_damping[dof]
        yield "frictionloss", name, model.dof_frictionloss[dof]
        yield "armature", name, model.dof_armature[dof]
        yield "stiffness", name, model.jnt_stiffness[joint]
        place = model.jnt_qposadr[joint]
        yield "pose", name, start_data.qpos[place]
        yield "joint-zero", name, model.qpos0[place]
        if model.jnt_stiffness[joint]:
            yield "spring-zero", name, model.qpos_spring[place]
        yield from _each("joint-place", name, model.jnt_pos[joint])
        if model.jnt_actfrclimited[joint]:
            yield "joint-force", name, np.abs(model.jnt_actfrcrange[joint]).max()
        yield from _each("joint-axis", name, axes[joint])
        limits = model.jnt_range[joint] if model.jnt_limited[joint] else UNLIMITED
        yield from _each("joint-range", name, limits, ENDS)


def _of_motors(robot: Robot) -> Iterator[tuple[str, str, float]]:
    model, is_servo = robot.model, servos(robot.model)
    for actuator in range(model.nu):
        name = model.actuator(actuator).name or f"motor {actuator}"
        kind = TRANSMISSIONS.get(int(model.actuator_trntype[actuator]))
        if kind is not None and model.actuator(actuator).name:
            moved = mujoco.mj_id2name(model, kind, model.actuator_trnid[actuator, 0])
            yield "motor", f"{name} moves {moved}", 1.0
        # A motor goes by its joint, whose name models of one robot share more often.
        if model.actuator_trntype[actuator] in JOINT_TRANSMISSIONS:
            joint = int(model.actuator_trnid[actuator, 0])
            if int(model.jnt_bodyid[joint]) not in robot.bodies:
                continue
            name = joint_name(robot, int(model.jnt_dofadr[joint]))
        yield "motor-gear", name, model.actuator_gear[actuator, 0]
        gear = abs(float(model.actuator_gear[actuator, 0]))
        bias = model.actuator_biasprm[actuator]
        if is_servo[actuator]:
            yield "kp", name, -bias[1] * gear**2
            yield "kv", name, -bias[2] * gear**2
        else:
            yield "motor-gain", name, model.actuator_gainprm[actuator, 0] * gear
        limit = (
            gear * np.abs(model.actuator_forcerange[actuator]).max()
            if model.actuator_forcelimited[actuator]
            else np.inf
        )
        yield "motor-limit", name, limit
        is_limited = model.actuator_ctrllimited[actuator]
        limits = model.actuator_ctrlrange[actuator] if is_limited else UNLIMITED
        yield from _each("control-range", name, limits, ENDS)
        has_lag = int(model.actuator_dyntype[actuator]) != int(mujoco.mjtDyn.mjDYN_NONE)
        lag_s = float(model.actuator_dynprm[actuator, 0]) if has_lag else 0.0
        yield "motor-lag", name, lag_s
        for attribute in ("delay", "damping", "armature"):
            # MuJoCo 3.11 has none of them.
            several = getattr(model, f"actuator_{attribute}", np.zeros(model.nu))
            yield f"motor-{attribute}", name, several[actuator]
        yield "motor-order", name, actuator


def _of_contacts(robot: Robot) -> Iterator[tuple[str, str, float]]:
    """Yield the numbers of the shapes of each link that can touch something, without those that are drawn only."""
    model = robot.model
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    is_mesh = model.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH)
    for body in robot.bodies:
        name, is_own = body_name(robot, body), model.geom_bodyid == body
        geoms = np.flatnonzero(is_own & solid)
        if not is_own.any():
            continue
        yield "geoms", name, len(geoms)
        if not len(geoms):
            continue
        yield "contype", name, np.bitwise_or.reduce(model.geom_contype[geoms])
        yield "conaffinity", name, np.bitwise_or.reduce(model.geom_conaffinity[geoms])
        yield "condim", name, model.geom_condim[geoms].max()
        friction = model.geom_friction[geoms].max(axis=0)
        words = ("sliding", "torsional", "rolling")
        yield from _each("geom-friction", name, friction, words)
        yield "geom-solref", name, model.geom_solref[geoms, 0].min()
        yield "geom-priority", name, model.geom_priority[geoms].max()
        yield "geom-margin", name, model.geom_margin[geoms].max()
        primitive = geoms[~is_mesh[geoms]]
        if len(primitive):
            yield "geom-size", name, model.geom_rbound[primitive].sum()
            centre_m = model.geom_pos[primitive].mean(axis=0)
            yield from _each("geom-place", name, centre_m)
    for signature in model.exclude_signature.tolist():
        two = sorted(
            body_name(robot, one) for one in (signature >> 16, signature & 0xFFFF)
        )
        yield "exclude", " and ".join(two), 1.0


def _of_tendons(robot: Robot) -> Iterator[tuple[str, str, float]]:
    model, data = robot.model, mujoco.MjData(robot.model)
    mujoco.mj_fwdPosition(model, data)
    for tendon in range(model.ntendon):
        name = model.tendon(tendon).name or f"tendon {tendon}"
        for joint, coefficient in zip(*tendon_joints(model, tendon), strict=True):
            yield (
                "tendon-coefficient",
                f"{name} of {name_of(robot, joint)}",
                coefficient,
            )
        yield "tendon-length", name, data.ten_length[tendon]
        yield "tendon-stiffness", name, np.ravel(model.tendon_stiffness[tendon])[0]
        yield "tendon-damping", name, np.ravel(model.tendon_damping[tendon])[0]
        yield "tendon-friction", name, model.tendon_frictionloss[tendon]


def _of_couplings(robot: Robot) -> Iterator[tuple[str, str, float]]:
    model, is_joint = robot.model, couplings_of(robot.model)
    for number in range(model.neq):
        name = " and ".join(ends_of(model, number)[1])
        values = model.eq_data[number, : 5 if is_joint[number] else 3]
        yield from _each("coupling", name, values, range(len(values)))
        yield "coupling-solref", name, model.eq_solref[number, 0]


def _of_sensors(robot: Robot) -> Iterator[tuple[str, str, float]]:
    model = robot.model
    for sensor in range(model.nsensor):
        name = model.sensor(sensor).name
        if not name:
            continue
        kind = mujoco.mjtSensor(model.sensor_type[sensor]).name.removeprefix("mjSENS_")
        number, of = int(model.sensor_objid[sensor]), int(model.sensor_objtype[sensor])
        read = mujoco.mj_id2name(model, of, number) if number >= 0 else ""
        yield "sensor", f"{name} reads {kind.lower()} of {read}", 1.0
        yield "sensor-cutoff", name, model.sensor_cutoff[sensor]
    for site in np.flatnonzero(np.isin(model.site_bodyid, robot.bodies)).tolist():
        name = model.site(site).name
        if name:
            yield from _each("site-place", name, model.site_pos[site])
            yield from _each("site-turn", name, _turn_rad(model.site_quat[site]))


def _of_options(robot: Robot) -> Iterator[tuple[str, str, float]]:
    for name in OPTIONS:
        yield "option", name, getattr(robot.model.opt, name)
