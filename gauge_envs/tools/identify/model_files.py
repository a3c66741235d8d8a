"""Joints of MJCF and URDF files, and of scenes, for `mujoco_joints`: named, without motors, and the others welded."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from gauge_envs.errors import AssetError, ParameterError
from gauge_envs.files import child_refusal
from gauge_envs.scene.hinged import joint_sign, parent_hinges
from gauge_envs.scene.servo_friction import SERVO_FRICTION
from gauge_envs.tools.identify.logs import Log
from gauge_envs.tools.identify.mujoco_joints import ModelJoints
from gauge_envs.tools.identify.paste import JOINT
from gauge_envs.tools.identify.rig import (
    BACKLASH,
    DYNAMICS,
    LIMIT,
    OFFSET,
    SERVO,
    Terms,
)
from gauge_envs.tools.mjcf import PROBE

if TYPE_CHECKING:
    from gauge_envs.scene import Scene
    from gauge_envs.tools.usd import UsdScene

STEP_S = 0.002
"""Step of a scene that states none [s], which is MuJoCo's default."""
LONGEST_STEP_S = 0.05
"""Longest step that is taken for one [s]: more is mostly a unit."""
FAR_BEYOND = 3.0
"""Angle of a log over the largest one of the joint's range from which the log is refused."""
LOGGED = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
"""Joints of a model that logs have."""
OPTIONS = ("timestep_s", "integrator")
"""Settings that replace those of a model."""


def read_mjcf(path: Path) -> mujoco.MjSpec:
    """Return the model of an MJCF or a URDF file."""
    if not path.is_file():
        raise AssetError(path, "", "there is no such file")
    if refusal := child_refusal(PROBE, str(path)):
        raise AssetError(path, "", f"{refusal}: simplify the model")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise AssetError(path, "", f"MuJoCo cannot load it: {reason}") from None
    return spec


def joints_of_model(
    spec: mujoco.MjSpec, log: Log, settings: Mapping[str, Any]
) -> ModelJoints:
    """Return the joints of a model that a log moves: those of its names, or all hinges and sliders.

    Raises:
        ParameterError: The log has other joints than the model, or a setting is unknown.
    """
    model = spec.compile()
    movable = [
        model.joint(index).name
        for index in range(model.njnt)
        if int(model.jnt_type[index]) in LOGGED
    ]
    if strange := [one for one in log.joints if one not in movable]:
        raise ParameterError(
            f"{log.name} names the joint {strange[0]}, and the model has the joints {', '.join(movable) or 'none'}: "
            "rename the columns of the log as the joints of the model"
        )
    names = log.joints or movable
    if log.position_rad.shape[1] != len(names):
        raise ParameterError(
            f"{log.name} has {log.position_rad.shape[1]} joints without names, and the model {len(movable)}: "
            "name the columns as joints of the model, as position_rad.elbow"
        )
    _check_ranges(model, names, log)
    changed = _without_motors(spec.copy(), names, settings)
    _weld(changed, model, {*names, *_joints_of_loops(model)})
    return ModelJoints(
        spec=changed,
        joints=tuple(names),
        signs=np.ones(len(names)),
        stated=[_stated(model, one) for one in names],
        has_servos=log.command_rad is not None,
    )


def _check_ranges(model: mujoco.MjModel, names: Sequence[str], log: Log) -> None:
    """Raise `ParameterError` if a log goes far beyond the range of a joint."""
    for place, name in enumerate(names):
        joint = model.joint(name)
        farthest_rad = float(np.abs(joint.range).max())
        reach_rad = float(np.abs(log.position_rad[:, place]).max())
        if joint.limited and reach_rad > FAR_BEYOND * farthest_rad:
            raise ParameterError(
                f"{log.name}: {name} reaches {reach_rad:.3g} rad, and its range in the model ends at "
                f"{farthest_rad:.3g}: are the angles in degrees, or their zero or the joint another one?"
            )


def _joints_of_loops(model: mujoco.MjModel) -> set[str]:
    """Return the names of the joints that equality constraints move with others: those of loops and couplings."""
    found: set[str] = set()
    kinds = mujoco.mjtEq
    for number in np.flatnonzero(model.eq_active0):
        kind = int(model.eq_type[number])
        sides = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
        if kind == kinds.mjEQ_JOINT:
            found |= {model.joint(side).name for side in sides if side >= 0}
        if kind not in (int(kinds.mjEQ_CONNECT), int(kinds.mjEQ_WELD)):
            continue
        if model.eq_objtype[number] == mujoco.mjtObj.mjOBJ_SITE:
            sides = [int(model.site_bodyid[side]) for side in sides]
        for body in sides:
            while body > 0:
                first = int(model.body_jntadr[body])
                joints = range(first, first + int(model.body_jntnum[body]))
                found |= {
                    model.joint(one).name
                    for one in joints
                    if model.jnt_type[one] != mujoco.mjtJoint.mjJNT_FREE
                }
                body = int(model.body_parentid[body])
    return found


def joints_of_scene(
    scene: Scene,
    spec: mujoco.MjSpec,
    log: Log,
    stated: Sequence[Terms],
    settings: Mapping[str, Any],
) -> ModelJoints:
    """Return the hinges of a scene in the model that the engine builds of it.

    Args:
        scene: The scene, with each hinge at angle 0.
        spec: Its model; a joint has the name of the body that it moves.
        log: A log of its hinges, of which the joints get the names.
        stated: Numbers that the scene states, by hinge.
        settings: Those with which `spec` was built. Unless they state step or integrator, these are what users' models
            mostly have.
    """
    bodies = _moved_bodies(scene)
    usual: dict[str, Any] = {}
    if not {"preset", "integrator"} & set(settings):
        usual = {"timestep_s": settings.get("timestep_s", STEP_S), "integrator": "implicitfast"}  # fmt: skip
    changed = _without_motors(spec.copy(), bodies, usual)
    names = joint_names(log, len(bodies))
    for body, name in zip(bodies, names, strict=True):
        changed.joint(body).name = name
    return ModelJoints(
        spec=changed,
        joints=names,
        signs=np.array(
            [joint_sign(*pair) for pair in zip(scene.hinges, bodies, strict=True)]
        ),
        stated=stated,
        has_servos=log.command_rad is not None,
    )


def model_of_sliders(usd: UsdScene) -> mujoco.MjSpec:
    """Return the model of a USD layer with sliders; its joints have the names of the bodies that they move."""
    from gauge_envs.backends import backend

    scene = usd.scene
    simulation = backend("mujoco").build(scene)
    spec: mujoco.MjSpec = simulation.spec.copy()  # type: ignore[attr-defined]
    simulation.close()
    bodies = _moved_bodies(scene)
    for hinge, body in zip(scene.hinges, bodies, strict=True):
        joint = spec.joint(body)
        joint.axis = joint_sign(hinge, body) * np.asarray(joint.axis)
    for motor in spec.actuators:
        motor.gear[0] = 1.0
    for place in usd.sliders:
        spec.joint(bodies[place]).type = mujoco.mjtJoint.mjJNT_SLIDE
    spec.option.timestep = STEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec


def has_slider(spec: mujoco.MjSpec, name: str) -> bool:
    """Return whether a joint of a model slides."""
    return bool(spec.joint(name).type == mujoco.mjtJoint.mjJNT_SLIDE)


def _moved_bodies(scene: Scene) -> list[str]:
    """Return the names of the bodies that hinges move, which are those of the joints of the scene's model."""
    children = {
        id(hinge): name
        for name, hinge in parent_hinges(scene.body_hinges, scene.hung).items()
    }
    return [getattr(one, "body", "") or children[id(one)] for one in scene.hinges]


def joint_names(log: Log, count: int) -> tuple[str, ...]:
    """Return the names of joints in a log, or their numbers."""
    return log.joints or tuple(f"joint_{number}" for number in range(count))


def _without_motors(
    spec: mujoco.MjSpec, names: Sequence[str], settings: Mapping[str, Any]
) -> mujoco.MjSpec:
    for key in list(spec.keys):
        spec.delete(key)
    for motor in list(spec.actuators):
        if motor.trntype == JOINT and motor.target in names:
            spec.delete(motor)
    for name, value in settings.items():
        if name not in OPTIONS:
            raise ParameterError(
                f"--set {name}: an MJCF takes {' and '.join(OPTIONS)}, and states all else itself"
            )
        if name == "timestep_s":
            if not isinstance(value, int | float) or not 0.0 < value <= LONGEST_STEP_S:
                raise ParameterError(
                    f"--set timestep_s={value}: a step above 0 and of at most {LONGEST_STEP_S} s is needed"
                )
            spec.option.timestep = value
            continue
        kinds = {
            one.removeprefix("mjINT_").lower(): kind
            for one, kind in mujoco.mjtIntegrator.__members__.items()
        }
        if str(value).lower() not in kinds:
            raise ParameterError(
                f"--set integrator={value}: known are {', '.join(kinds)}"
            )
        spec.option.integrator = kinds[str(value).lower()]
    return spec


def _weld(spec: mujoco.MjSpec, model: mujoco.MjModel, names: Collection[str]) -> None:
    """Remove all joints but the named ones; bodies stay where the first keyframe has them, or the model without one.

    Args:
        spec: The model to change.
        model: The same, compiled before any change.
        names: Names of the joints that stay.

    Raises:
        ParameterError: A body that would have to be turned is placed by a `<frame>`.
    """
    # A joint without a name has its number.
    removed = [one for one in range(model.njnt) if model.joint(one).name not in names]
    if not removed:
        return
    pose = np.array(model.key_qpos[0] if model.nkey else model.qpos0)
    for name in names:
        address = model.joint(name).qposadr
        pose[address] = model.qpos0[address]
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_kinematics(model, data)
    if not np.array_equal(pose, model.qpos0):
        for index in {int(model.jnt_bodyid[one]) for one in removed}:
            body, parent = spec.bodies[index], int(model.body_parentid[index])
            if body.frame is not None and body.frame.name != "":
                raise ParameterError(
                    f"body {body.name!r} lies in a <frame>: its joint is not in the log and cannot keep the keyframe's "
                    "angle. Remove the keyframe or the frame"
                )
            back, place, turn = np.zeros(4), np.zeros(3), np.zeros(4)
            mujoco.mju_negQuat(back, data.xquat[parent])
            mujoco.mju_rotVecQuat(place, data.xpos[index] - data.xpos[parent], back)
            mujoco.mju_mulQuat(turn, back, data.xquat[index])
            body.pos, body.quat = place, turn
            body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    wrapped = mujoco.mjtWrap.mjWRAP_JOINT
    for tendon in reversed(range(model.ntendon)):
        first = int(model.tendon_adr[tendon])
        rows = range(first, first + int(model.tendon_num[tendon]))
        if any(
            model.wrap_type[row] == wrapped and model.wrap_objid[row] in removed
            for row in rows
        ):
            spec.delete(spec.tendons[tendon])  # fmt: skip
    for one in reversed(removed):
        spec.delete(spec.joints[one])


def _stated(model: mujoco.MjModel, name: str) -> dict[str, float]:
    """Return the numbers that a model states for a joint."""
    joint = model.joint(name)
    dof = int(joint.dofadr[0])
    names = (*DYNAMICS, BACKLASH, *SERVO, LIMIT, OFFSET, *SERVO_FRICTION)
    numbers = dict.fromkeys(names, 0.0)
    numbers[DYNAMICS[0]] = float(model.dof_frictionloss[dof])
    numbers[DYNAMICS[1]] = float(np.ravel(model.dof_damping[dof])[0])
    numbers[DYNAMICS[2]] = float(model.dof_armature[dof])
    numbers[DYNAMICS[3]] = float(model.dof_dampingpoly[dof, 0])
    for motor in range(model.nu):
        is_of_joint = model.actuator_trntype[motor] == JOINT
        if not is_of_joint or model.actuator_trnid[motor, 0] != joint.id:
            continue
        # A torque is the force times the gear, and an angle times the gear is what the motor sees.
        gear = float(model.actuator_gear[motor, 0])
        kp, kv = (-float(one) for one in model.actuator_biasprm[motor, 1:3])
        numbers[SERVO[0]], numbers[SERVO[1]] = kp * gear**2, kv * gear**2
        if model.actuator_forcelimited[motor]:
            limit = float(model.actuator_forcerange[motor, 1])
            numbers[LIMIT] = limit * abs(gear)
    return numbers
