"""Reader of MJCF files that replace a scene.

The file determines the time step, solver, masses, friction, poses and compiled tables. It must contain the rigid
bodies of the scene under their names, and a free joint of the same name for each driven body. The nodes of deformable
bodies must be where the backend places them. `writer` writes such files. Custom numbers hold the data for which MJCF
has no element:

- `driver/<body>`: rows of qpos (7), qvel (6) and xfrc_applied (6) to write before every 1/180 s. They must equal the
  prescribed motion of the scene.
- `flex_stiffness/<body>/kinds` and `/kind`: distinct rows of the table, and the index of the distinct row for each row.
- `flex_bending/<body>/weight`: a factor on each row of the table.

The `qvel` of a keyframe `start` holds the start velocities of dynamic bodies. Other keyframes have no effect.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.flex import flex_table
from gauge_envs.backends.mujoco.mjcf.diff import is_same, model_changes, rows_by_name
from gauge_envs.backends.mujoco.mjcf.writer import (
    DRIVER_COLUMNS,
    DRIVER_PREFIX,
    driver_rows,
)
from gauge_envs.backends.mujoco.model import START_KEY, build_model
from gauge_envs.backends.mujoco.options import option_settings
from gauge_envs.backends.mujoco.settings import settings_for
from gauge_envs.backends.mujoco.simulation import (
    KINEMATICS,
    SimulationMuJoCo,
    kinematic_state,
)
from gauge_envs.backends.mujoco.versions import sparse_advice
from gauge_envs.errors import AssetError, ParameterError
from gauge_envs.names import first_names
from gauge_envs.reading import reading
from gauge_envs.scene import Hinge, Motion, Pose, RigidBody, Scene
from gauge_envs.scene.diff import Change
from gauge_envs.scene.geometry import FloatArray, length_of, vector
from gauge_envs.scene.prescribed_motion import prescribed_motions
from gauge_envs.scene.timing import DRIVE_INTERVAL_S

RECORDED_SETTINGS = (
    "timestep_s",
    "integrator",
    "cone",
    "solver",
    "impratio",
    "iterations",
    "tolerance",
)
"""Settings of a file that a result records."""

MIN_TIMESTEP_S = 1e-7

ROW_TOLERANCE = 1e-6
"""Relative difference below which rows of driven motion are equal; accelerations are second differences of poses."""

JOINT_TERMS = ("frictionloss", "damping", "armature", "stiffness", "limited")
"""Terms of MuJoCo's joints that joints of a scene lack."""

HINGE, FREE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_FREE


class BackendMJCF(BackendMuJoCo):
    """MuJoCo with the model of a file, which contains all numerical settings.

    Args:
        path: The file. It builds only scenes that `read_model` returned for it.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path

    def compiled(
        self,
        scene: Scene,
        world_count: int = 1,
        settings: Mapping[str, Any] | None = None,
    ) -> SimulationMuJoCo:
        """Build worlds of the model of the file.

        Raises:
            ParameterError: There are `settings`.
            AssetError: The file is damaged, or the scene has other initial states.
        """
        path = self._path
        if settings:
            raise ParameterError(
                f"settings {', '.join(map(repr, settings))} with {path.name}: an MJCF file contains its own "
                "settings; change them in the file"
            )
        spec, model = _compiled(path)
        _, built, parts = build_model(scene, settings_for(scene, None))
        placed = _placed_scene(path, model, built, scene)
        for body, placed_body in zip(scene.bodies, placed.bodies, strict=True):
            if placed_body != body:
                reason = (
                    "an MJCF file fixes its start pose and velocity: "
                    "use a USD layer for another start, such as a jitter"
                )
                raise AssetError(path, body.name, reason)
        if advice := sparse_advice(model):
            warnings.warn(f"{path.name}: {advice}", stacklevel=2)
        effective = _settings(path, model)
        return SimulationMuJoCo(
            scene, effective, spec, model, parts, world_count=world_count
        )


def read_model(path: Path, scene: Scene) -> tuple[Scene, tuple[Change, ...]]:
    """Read the start poses, masses, hinges and gravity of a file, and its differences.

    Args:
        path: The file.
        scene: The scene whose bodies the file must contain.

    Returns:
        The scene, with the start poses and masses of the file; and the differences between the file and the model that
        the backend builds from the scene.

    Raises:
        AssetError: The file cannot be read, or does not fit the scene.
    """
    simulation = BackendMuJoCo().build(scene)
    _, model = _compiled(path)
    _settings(path, model)
    placed = _placed_scene(path, model, simulation.model, scene)
    intervals = round(placed.duration_s / DRIVE_INTERVAL_S)
    for motion in prescribed_motions(placed, placed.duration_s):
        rows = driver_rows(simulation, motion, intervals)
        _check_rows(path, model, f"{DRIVER_PREFIX}{motion.body}", rows)
    return placed, tuple(model_changes(model, simulation.model))


# --- compiled model --------------------------------------------------------------------------------------------------


def _compiled(path: Path) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """Return the editable and the compiled model of a file."""
    with reading(path, AssetError, "a model that MuJoCo can load") as content:
        spec = mujoco.MjSpec.from_string(content.decode())
        model = spec.compile()
    _apply_tables(path, model)
    return spec, model


def _settings(path: Path, model: mujoco.MjModel) -> dict[str, Any]:
    """Return the numerical settings of a file, under the names of `SettingsMuJoCo`."""
    timestep_s = model.opt.timestep
    # NaN is no step either.
    steps = DRIVE_INTERVAL_S / timestep_s if timestep_s >= MIN_TIMESTEP_S else 0.0
    if abs(steps - max(round(steps), 1)) > 1e-6:
        reason = f"is {timestep_s:g} s: choose a step of {MIN_TIMESTEP_S:g} s or more that divides 1/180 s"
        raise AssetError(path, "option timestep", reason)
    options = option_settings(model)
    return {"model_file": path.name} | {
        name: options[name] for name in RECORDED_SETTINGS
    }


def _numerics(model: mujoco.MjModel) -> dict[str, FloatArray]:
    """Return the custom numbers of a model, by name."""
    listed = [model.numeric(index) for index in range(model.nnumeric)]
    return {numeric.name: numeric.data for numeric in listed}


def _apply_tables(path: Path, model: mujoco.MjModel) -> None:
    """Write the file's custom numbers to the compiled flex tables."""
    numbers = _numerics(model)
    for name, values in numbers.items():
        place, _, part = name.rpartition("/")
        table, _, body = place.partition("/")
        if table not in ("flex_stiffness", "flex_bending") or part == "kind":
            continue
        try:
            flex = rows_by_name(model, "flex")[body]
            entries = flex_table(model, table, flex)
            if part == "weight":
                rows = entries.reshape(len(values), -1)
                rows *= values[:, None]
            else:
                kind = numbers[f"{place}/kind"].astype(int)
                rows = entries.reshape(len(kind), -1)
                rows[:] = values.reshape(-1, rows.shape[1])[kind]
        except (KeyError, ValueError, IndexError):
            reason = "does not fit the flexes of the file: restore the numerics of the export"
            raise AssetError(path, name, reason) from None


# --- required contents -----------------------------------------------------------------------------------------------


def _check_contents(
    path: Path, model: mujoco.MjModel, built: mujoco.MjModel, scene: Scene
) -> None:
    """Check that a file has the rigid bodies with their joints, and the nodes of deformable bodies at their places."""
    for kind in ("body", "flex"):
        names = rows_by_name(model, kind)
        for name in rows_by_name(built, kind):
            if name not in names:
                present = [known for known in names if known != "world"]
                reason = f"no {kind} of that name: the file has {first_names(present)}"
                raise AssetError(path, name, reason)
    rigid = {body.name: body for body in scene.bodies}
    for name, index in rows_by_name(built, "body").items():
        reason = ""
        if name in rigid:
            is_hinged = name in scene.hinges
            reason = _joint_fault(model, built, rigid[name], is_hinged=is_hinged)
        elif not is_same(model.body(name).pos, built.body_pos[index]):
            reason = "nodes of a deformable body cannot be moved in MJCF: move the body in USD"
        if reason:
            raise AssetError(path, name, reason)


def _joint_fault(
    model: mujoco.MjModel, built: mujoco.MjModel, body: RigidBody, *, is_hinged: bool
) -> str:
    """Return the missing or unsupported part of a rigid body of a file; empty for a body that fits."""
    if body.motion is Motion.FIXED:
        return ""
    number = model.body(body.name).id
    index = rows_by_name(model, "jnt").get(body.name)
    name, kind = ("hinge", HINGE) if is_hinged else ("free", FREE)
    if index != model.body_jntadr[number] or model.jnt_type[index] != kind:
        return f"it is {body.motion.value} and needs a {name} joint with its name"
    joint = model.joint(index)
    unsupported = [term for term in JOINT_TERMS if getattr(joint, term).any()]
    if index in model.actuator_trnid[:, 0]:
        unsupported.append("its motor")
    if model.body_parentid[number] or model.body_jntnum[number] > 1:
        unsupported.append("its parent or second joint")
    if unsupported:
        return f"unsupported joint: remove {', '.join(unsupported)}: joints of a scene move freely to the world"
    values = [
        np.append(source.body(body.name).inertia, source.body(body.name).mass)
        for source in (model, built)
    ]
    if body.motion is Motion.KINEMATIC and not is_same(*values):
        return "its mass and its moments of inertia must be the same as in the export: it is driven"
    return ""


def _check_rows(
    path: Path, model: mujoco.MjModel, name: str, expected: FloatArray
) -> None:
    """Check that a custom numeric holds the expected rows of driven motion; the last row holds until the end."""
    tolerance = ROW_TOLERANCE * np.maximum(np.abs(expected).max(axis=0), 1e-3)
    try:
        rows = _numerics(model)[name].reshape(-1, DRIVER_COLUMNS)
        rows = rows[np.minimum(np.arange(len(expected)), len(rows) - 1)]
        is_expected = (np.abs(rows - expected) <= tolerance).all()
    except (KeyError, ValueError):
        is_expected = False
    if not is_expected:
        reason = "its rows are not the motion of the scene: restore those of the export, and edit motion in USD"
        raise AssetError(path, name, reason)


# --- scene of a file -------------------------------------------------------------------------------------------------


def _start_data(path: Path, model: mujoco.MjModel, scene: Scene) -> mujoco.MjData:
    """Return the state of a model at the start, with the velocities of the keyframe `start`."""
    data = mujoco.MjData(model)
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, START_KEY)
    if key >= 0:
        place = f"keyframe {START_KEY}"
        if not is_same(model.key_qpos[key], model.qpos0):
            reason = "its qpos moves bodies away from their poses: delete qpos and move the bodies"
            raise AssetError(path, place, reason)
        data.qvel = model.key_qvel[key]
        dynamic = {body.name for body in scene.dynamic_bodies}
        for dof in np.flatnonzero(data.qvel):
            joint = model.joint(int(model.dof_jntid[dof])).name
            if joint not in dynamic:
                reason = f"its qvel moves joint {joint!r}: only dynamic rigid bodies start with velocity"
                raise AssetError(path, place, reason)
    for stage in KINEMATICS:
        stage(model, data)
    return data


def _placed_scene(
    path: Path, model: mujoco.MjModel, built: mujoco.MjModel, scene: Scene
) -> Scene:
    """Return a scene with the masses, initial states, hinges and gravity of a file.

    Values that equal the model of the backend stay the values of the scene, bit for bit.

    Raises:
        AssetError: The file lacks a body, or has an unsupported part.
    """
    _check_contents(path, model, built, scene)
    data, expected = (_start_data(path, source, scene) for source in (model, built))
    joints = []
    for joint in scene.joints:
        if isinstance(joint, Hinge):
            hinge, built_hinge = data.joint(joint.body), expected.joint(joint.body)
            line = np.concatenate([hinge.xanchor, hinge.xaxis])
            if not is_same(line, [*built_hinge.xanchor, *built_hinge.xaxis]):
                joint = replace(joint, anchor_m=vector(line[:3]), axis=vector(line[3:]))
        joints.append(joint)
    gravity_m_per_s2 = length_of(model.opt.gravity)
    if is_same(gravity_m_per_s2, scene.gravity_m_per_s2):
        gravity_m_per_s2 = scene.gravity_m_per_s2
    return replace(
        scene,
        bodies=tuple(_placed_body(body, data, expected) for body in scene.bodies),
        joints=tuple(joints),
        gravity_m_per_s2=gravity_m_per_s2,
    )


def _placed_body(
    body: RigidBody, data: mujoco.MjData, expected: mujoco.MjData
) -> RigidBody:
    """Return a body with the values of a file that differ from the backend's values.

    Args:
        body: Body of the scene.
        data: Start of the model of the file.
        expected: Start of the model that the backend builds.
    """
    number, built_number = (
        source.model.body(body.name).id for source in (data, expected)
    )
    mass_kg = float(data.model.body_mass[number])
    # The mass of a driven body is a numerical setting of the backend.
    if body.motion is Motion.DYNAMIC and not is_same(
        mass_kg, expected.model.body_mass[built_number]
    ):
        body = replace(body, mass_kg=mass_kg)
    state = kinematic_state(data, number)
    built_state = kinematic_state(expected, built_number)
    if not is_same(state[:7], built_state[:7]):
        body = replace(body, pose=Pose.of_state(state))
    if not is_same(state[7:], built_state[7:]):
        body = replace(
            body,
            linear_velocity_m_per_s=vector(state[7:10]),
            angular_velocity_rad_per_s=vector(state[10:]),
        )
    return body
