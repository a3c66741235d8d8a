"""Reader of MJCF files that replace a scene.

The file determines the time step, solver, masses, friction, poses, compiled tables and driven motion. It must contain
the rigid bodies of the scene under their names, and a free joint of the same name for each driven body. The nodes of
deformable bodies must be where the backend places them. `writer` writes such files. Custom numbers hold the data
for which MJCF has no element:

- `driver/<body>`: rows of qpos (7), qvel (6) and xfrc_applied (6) to write before every 1/180 s. If the rows equal
  those of the scene's driver, the driver stays; otherwise a sampled driver goes through their poses.
- `flex_stiffness/<body>/kinds` and `/kind`: distinct rows of the table, and the index of the distinct row for each row.
- `flex_bending/<body>/weight`: a factor on each row of the table.

The `qvel` of a keyframe `start` holds the start velocities of dynamic bodies. Other keyframes have no effect.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.flex import FlexPart, flex_table
from gauge_envs.backends.mujoco.model import (
    START_KEY,
    build_model,
    start_rates,
)
from gauge_envs.backends.mujoco.settings import settings_for
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.backends.mujoco.versions import sparse_advice
from gauge_envs.errors import AssetError, ParameterError, first_names
from gauge_envs.scene import (
    Hinge,
    Motion,
    Pose,
    RigidBody,
    Scene,
)
from gauge_envs.scene.geometry import FloatArray, length_of, vector
from gauge_envs.scene.timing import DRIVE_INTERVAL_S
from gauge_envs.tools.bench.model_settings import option_settings
from gauge_envs.tools.mjcf.diff import format_value, is_same, model_changes, same_or
from gauge_envs.tools.mjcf.drivers import numerics, pose_of, read_driver

STATED_SETTINGS = (
    "timestep_s",
    "integrator",
    "cone",
    "solver",
    "impratio",
    "iterations",
    "tolerance",
)
"""Settings that a result of a file holds."""

SHORTEST_STEP_S = 1e-7


class BackendMJCF(BackendMuJoCo):
    """MuJoCo with the model of a file, which contains all numerical settings.

    Args:
        path: The file. The scenes that it builds are those that `read_model` returned for it.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path

    def compiled(
        self, scene: Scene, world_count: int, settings: Mapping[str, Any] | None
    ) -> SimulationMuJoCo:
        """Build worlds of the model of the file; `settings` must be empty."""
        if settings:
            raise ParameterError(
                f"settings {', '.join(map(repr, settings))} with {self._path.name}: an MJCF file contains its own "
                "settings; change them in the file"
            )
        loaded = load_model(self._path, scene)
        simulation = SimulationMuJoCo(scene, *loaded, world_count=world_count)
        # The sparse models of this package agree with dense ones: `robot-solver` ran on all of them.
        if advice := sparse_advice(simulation.model):
            warnings.warn(f"{self._path.name}: {advice}", stacklevel=2)
        return simulation


# --- loading ---------------------------------------------------------------------------------------------------------


def load_model(
    path: Path, scene: Scene
) -> tuple[dict[str, Any], mujoco.MjSpec, mujoco.MjModel, dict[str, FlexPart]]:
    """Compile an MJCF file for the scene that `read_model` returned for it.

    Returns:
        The numerical settings, the editable model, the compiled model, and the parts of the deformable bodies by name.
    """
    spec, model = _compiled(path)
    _, _, parts = build_model(scene, settings_for(scene, None))
    _check_bodies(path, model, scene)
    for body, started in zip(scene.bodies, _started(path, model, scene), strict=True):
        if started != body:
            raise AssetError(
                path,
                body.name,
                "an MJCF file fixes its start pose and velocity: use a USD layer for another start, such as a jitter",
            )
    return _settings(path, model), spec, model, parts


def _compiled(path: Path) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    try:
        content = path.read_bytes()
        text = content.decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise AssetError(path, "", f"cannot be read: {reason or error}") from error
    try:
        spec = mujoco.MjSpec.from_string(text)
        model = spec.compile()
    except ValueError as error:
        raise AssetError(
            path, "", f"MuJoCo cannot load it: {' '.join(str(error).split())}"
        ) from None
    _complete(path, model)
    return spec, model


def _settings(path: Path, model: mujoco.MjModel) -> dict[str, Any]:
    """Return the numerical settings of a file, under the names of `SettingsMuJoCo`."""
    step_s = model.opt.timestep
    if not step_s >= SHORTEST_STEP_S:
        raise AssetError(
            path,
            "option timestep",
            f"is {step_s:g} s: {SHORTEST_STEP_S:g} s or more is expected",
        )
    steps = DRIVE_INTERVAL_S / step_s
    if abs(steps - round(steps)) > 1e-6 or round(steps) < 1:
        raise AssetError(
            path,
            "option timestep",
            f"1/180 s is {steps:.6g} steps of {step_s:g} s, not a whole number: choose a step that divides it",
        )
    known = option_settings(model)
    return {"model_file": path.name} | {name: known[name] for name in STATED_SETTINGS}


# --- custom numbers --------------------------------------------------------------------------------------------------


def _complete(path: Path, model: mujoco.MjModel) -> None:
    """Apply the file's custom numbers to the compiled flex tables."""
    numbers = numerics(model)
    for name, values in numbers.items():
        table, _, rest = name.partition("/")
        body, _, part = rest.rpartition("/")
        if part not in ("kinds", "weight") or table not in (
            "flex_stiffness",
            "flex_bending",
        ):
            continue
        flex, place = (
            mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, body),
            f"{table}/{body}",
        )
        if flex < 0:
            raise AssetError(
                path,
                place,
                "the file has no flex of this name: correct the name of the numeric",
            )
        rows = flex_table(model, table, flex)
        if part == "weight":
            weighed = rows.reshape(_divided(path, name, rows.size, len(values)), -1)
            weighed *= values[:, None]
            continue
        kind = numbers.get(f"{place}/kind")
        if kind is None:
            raise AssetError(
                path,
                name,
                f"custom numeric '{place}/kind', the index of each row, is missing: add it",
            )
        width = rows.size // _divided(path, f"{place}/kind", rows.size, len(kind))
        kinds = values.reshape(
            _divided(path, name, len(values), len(values) // max(width, 1)), -1
        )
        if kind.min() < 0 or kind.max() >= len(kinds):
            raise AssetError(
                path,
                f"{place}/kind",
                f"holds numbers beyond the {len(kinds)} rows of kinds",
            )
        rows[:] = kinds[kind.astype(int)].ravel()


def _divided(path: Path, name: str, size: int, count: int) -> int:
    """Return the row count if it divides the size of a table."""
    if count < 1 or size % count:
        raise AssetError(
            path,
            name,
            f"{count} rows do not fit a table of {size} numbers: write all rows",
        )
    return count


# --- scene of a file -------------------------------------------------------------------------------------------------


def read_model(path: Path, scene: Scene) -> tuple[Scene, tuple[str, ...]]:
    """Read the start poses, masses, hinges, gravity and driven motion of a file, and its differences.

    Args:
        path: The file.
        scene: The scene whose bodies the file must contain.

    Returns:
        The scene, with the start poses, masses and driven motion of the file; and the differences between the file and
        the model that the backend builds from the scene, one line each.
    """
    simulation = BackendMuJoCo().build(scene)
    _, model = _compiled(path)
    _settings(path, model)
    built = simulation.model
    _check_bodies(path, model, scene)
    _check_nodes(path, model, built, scene)
    bodies = tuple(
        replace(body, mass_kg=_mass_kg(model, built, body))
        for body in _started(path, model, scene)
    )
    placed = replace(
        scene,
        bodies=bodies,
        joints=tuple(
            _hinge(model, built, joint) if isinstance(joint, Hinge) else joint
            for joint in scene.joints
        ),
        gravity_m_per_s2=same_or(length_of(model.opt.gravity), scene.gravity_m_per_s2),
    )
    changes = [*model_changes(model, built), *_velocity_changes(scene, placed)]
    drivers = []
    for driver in placed.drivers:
        read = read_driver(path, model, placed, driver, simulation)
        drivers.append(read)
        if read != driver:
            changes.append(
                f"driver of {driver.body}: its motion is sampled from other rows"
            )
    return replace(placed, drivers=tuple(drivers)), tuple(changes)


def _check_bodies(path: Path, model: mujoco.MjModel, scene: Scene) -> None:
    known = [model.body(index).name for index in range(1, model.nbody)]
    for body in scene.bodies:
        if body.name not in known:
            raise AssetError(
                path,
                body.name,
                f"no body of that name: the file has {first_names(known)}",
            )
        if body.motion is Motion.FIXED:
            continue
        kind = (
            mujoco.mjtJoint.mjJNT_HINGE
            if body.name in scene.hinges
            else mujoco.mjtJoint.mjJNT_FREE
        )
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, body.name)
        if (
            joint < 0
            or model.jnt_type[joint] != kind
            or model.jnt_bodyid[joint] != model.body(body.name).id
        ):
            wanted = "hinge" if body.name in scene.hinges else "free"
            raise AssetError(
                path,
                body.name,
                f"it is {body.motion.value} and needs a {wanted} joint with its name",
            )
        if term := _joint_term(model, joint):
            raise AssetError(
                path,
                body.name,
                f"unsupported joint: it has {term}, and joints of a scene move freely to the world",
            )
        found = model.body(body.name)
        if body.motion is Motion.KINEMATIC and not np.all(found.inertia == found.mass):
            reason = "its mass and its moments of inertia must be the same number: it is driven"
            raise AssetError(path, body.name, reason)


def _joint_term(model: mujoco.MjModel, joint: int) -> str | None:
    """Return what the joint of a body has that joints of a scene do not have, or None."""
    body, freedom = model.jnt_bodyid[joint], model.jnt_dofadr[joint]
    terms = {
        "a moving parent": model.body_parentid[body] > 0,
        "a second joint": model.body_jntnum[body] > 1,
        "friction": model.dof_frictionloss[freedom] or model.dof_damping[freedom],
        "armature": model.dof_armature[freedom],
        "stiffness": model.jnt_stiffness[joint],
        "limits": model.jnt_limited[joint],
        "a motor": joint in model.actuator_trnid[:, 0],
    }
    return next((name for name, value in terms.items() if value), None)


def _check_nodes(
    path: Path, model: mujoco.MjModel, built: mujoco.MjModel, scene: Scene
) -> None:
    """Check that the nodes of deformable bodies exist at the positions that the backend gives them."""
    rigid = {body.name for body in scene.bodies}
    for index in range(1, built.nbody):
        name = built.body(index).name
        if name in rigid:
            continue
        found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
        if found < 0:
            raise AssetError(
                path, name, "the file lacks this node of a deformable body: restore it"
            )
        if not is_same(model.body_pos[found], built.body_pos[index]):
            raise AssetError(
                path,
                name,
                "nodes of a deformable body cannot be moved in MJCF: move the body in USD",
            )
    for index in range(built.nflex):
        name = mujoco.mj_id2name(built, mujoco.mjtObj.mjOBJ_FLEX, index)
        if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, name) < 0:
            raise AssetError(
                path,
                name,
                "the file lacks the flex of this deformable body: restore it",
            )


def _poses(model: mujoco.MjModel, scene: Scene) -> Iterator[Pose]:
    """Yield the start pose of each rigid body in a file, or the scene's pose if both are equal up to rounding."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for body in scene.bodies:
        place = data.body(body.name)
        same_rotation = abs(float(place.xquat @ body.pose.quaternion)) > 1.0 - 1e-12
        if same_rotation and is_same(place.xpos, body.pose.position_m):
            yield body.pose
        else:
            yield pose_of(place.xpos, place.xquat)


def _started(path: Path, model: mujoco.MjModel, scene: Scene) -> Iterator[RigidBody]:
    """Yield each rigid body with its start in a file; poses and velocities that equal the scene's are the scene's."""
    rates = _start_qvel(path, model)
    for body, pose in zip(scene.bodies, _poses(model, scene), strict=True):
        started = replace(body, pose=pose)
        if body.motion is Motion.DYNAMIC:
            expected = start_rates(started, scene.hinges.get(body.name))
            first = int(model.joint(body.name).dofadr[0])
            body_rates = rates[first : first + len(expected)]
            moving = _with_rates(model, started, body_rates)
            is_still = is_same(body_rates, expected)
            if not is_still and not is_same(_velocities(moving), _velocities(started)):
                started = moving
            body_rates[:] = 0.0
        yield started
    if rates.any():
        joint = model.joint(int(model.dof_jntid[np.flatnonzero(rates)[0]])).name
        raise AssetError(
            path,
            f"keyframe {START_KEY}",
            f"its qvel moves joint {joint!r}: only dynamic rigid bodies start with velocity",
        )


def _start_qvel(path: Path, model: mujoco.MjModel) -> FloatArray:
    """Return the start velocities of a file's joints, shape [nv], which are zero without the keyframe."""
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, START_KEY)
    if key < 0:
        return np.zeros(model.nv)
    if not is_same(model.key_qpos[key], model.qpos0):
        raise AssetError(
            path,
            f"keyframe {START_KEY}",
            "its qpos moves bodies away from their poses: delete qpos and move the bodies",
        )
    return np.array(model.key_qvel[key])


def _velocities(body: RigidBody) -> list[tuple[float, float, float]]:
    return [body.linear_velocity_m_per_s, body.angular_velocity_rad_per_s]


def _with_rates(model: mujoco.MjModel, body: RigidBody, rates: FloatArray) -> RigidBody:
    """Return a body whose joint starts with a velocity; see `start_rates`."""
    if len(rates) == 1:
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        angular = rates * data.joint(body.name).xaxis
        anchor = data.joint(body.name).xanchor
        linear = np.cross(angular, body.pose.position_m - anchor)
    else:
        linear, angular = rates[:3], body.pose.rotation.apply(rates[3:])
    return replace(
        body,
        linear_velocity_m_per_s=vector(linear),
        angular_velocity_rad_per_s=vector(angular),
    )


def _velocity_changes(before: Scene, after: Scene) -> Iterator[str]:
    """Yield one line for each start velocity that differs."""
    for old, new in zip(before.bodies, after.bodies, strict=True):
        for name in ("linear_velocity_m_per_s", "angular_velocity_rad_per_s"):
            if getattr(old, name) != getattr(new, name):
                yield f"{old.name}: {name} {format_value(getattr(old, name))} -> {format_value(getattr(new, name))}"


def _mass_kg(model: mujoco.MjModel, built: mujoco.MjModel, body: RigidBody) -> float:
    """Return the mass of a body in a file. Driven bodies keep the scene's mass, since theirs is a numerical setting."""
    mass, expected = (float(one.body(body.name).mass[0]) for one in (model, built))
    return (
        body.mass_kg
        if body.motion is not Motion.DYNAMIC or is_same(mass, expected)
        else mass
    )


def _hinge(model: mujoco.MjModel, built: mujoco.MjModel, hinge: Hinge) -> Hinge:
    """Return the hinge that is the joint of a body of a file."""
    found = []
    for one in (model, built):
        data = mujoco.MjData(one)
        mujoco.mj_kinematics(one, data)
        found.append((data.joint(hinge.body).xanchor, data.joint(hinge.body).xaxis))
    (anchor, axis), expected = found
    if is_same(anchor, expected[0]) and is_same(axis, expected[1]):
        return hinge
    return replace(hinge, anchor_m=vector(anchor), axis=vector(axis))
