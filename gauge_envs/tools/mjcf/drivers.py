"""Motion of driven bodies in MJCF files: rows of qpos, qvel and xfrc_applied in a custom numeric."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.errors import AssetError, ShapeError
from gauge_envs.scene import Pose, Scene
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scene.prescribed_motion import PrescribedMotion, prescribed_motions
from gauge_envs.scene.timing import DRIVE_INTERVAL_S
from gauge_envs.tools.bench.driver_fit import sampled_motions
from gauge_envs.tools.mjcf.diff import format_value

if TYPE_CHECKING:
    from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo

DRIVER_PREFIX = "driver/"
"""Prefix of the custom numeric with the motion of a driven body; the name of the body follows."""

DRIVER_COLUMNS = 19
"""Number of columns of driven motion: qpos 7, qvel 6, xfrc_applied 6."""

ROW_TOLERANCE = 1e-6
"""Relative difference below which rows of driven motion are equal; accelerations are second differences of poses."""


def numerics(model: mujoco.MjModel) -> dict[str, FloatArray]:
    """Return the custom numbers of a model, by name."""
    listed = [model.numeric(index) for index in range(model.nnumeric)]
    return {numeric.name: numeric.data for numeric in listed}


def pose_of(position_m: FloatArray, quaternion: FloatArray) -> Pose:
    """Return the pose of a position [m], shape [3], and a quaternion w, x, y, z."""
    w, x, y, z = quaternion.tolist()
    return Pose(position_m=vector(position_m), quaternion=(w, x, y, z))


def driver_rows(
    simulation: SimulationMuJoCo, motion: PrescribedMotion, count: int
) -> FloatArray:
    """Return the numbers that the backend writes to drive a body, interval by interval.

    Args:
        simulation: A simulation of the scene; its driven body moves.
        motion: Motion of the driven body.
        count: Number of intervals.

    Returns:
        qpos (7), qvel (6) and xfrc_applied (6) before each interval, shape [count, 19].
    """
    data = simulation.data
    joint, body = data.joint(motion.body), data.body(motion.body)
    zero_action = np.zeros((1, motion.motion_count))
    rows = np.empty((count, DRIVER_COLUMNS))
    for interval in range(count):
        simulation.drive(motion.body, motion.targets(interval, zero_action)[0])
        rows[interval] = np.concatenate([joint.qpos, joint.qvel, body.xfrc_applied])
    return rows


def read_driver(
    path: Path,
    model: mujoco.MjModel,
    scene: Scene,
    driver: Driver,
    simulation: SimulationMuJoCo,
) -> Driver:
    """Return the scene's driver if the file's rows equal its motion, otherwise a driver through the rows' poses.

    Args:
        path: The file.
        model: Its compiled model.
        scene: The scene with the start poses of the file.
        driver: Driver of the scene.
        simulation: A simulation that the backend builds from the scene of the task file.

    Raises:
        AssetError: The rows are missing, incomplete or inconsistent.
    """
    name = f"{DRIVER_PREFIX}{driver.body}"
    numbers = numerics(model).get(name, np.empty(0))
    if numbers.size == 0 or numbers.size % DRIVER_COLUMNS:
        reason = (
            f"it has {numbers.size} numbers: whole rows of {DRIVER_COLUMNS} are expected"
            if numbers.size
            else "the custom numeric with the motion of this driven body is missing: add it"
        )
        raise AssetError(path, name, reason)
    rows = numbers.reshape(-1, DRIVER_COLUMNS)
    count = round(scene.duration_s / DRIVE_INTERVAL_S)
    rows = rows[np.minimum(np.arange(count), len(rows) - 1)]
    motions = prescribed_motions(scene, scene.duration_s)
    motion = next(motion for motion in motions if motion.body == driver.body)
    mass_kg = float(model.body(driver.body).mass[0])
    expected = driver_rows(simulation, motion, count)
    expected[:, 13:] *= mass_kg / simulation.model.body(driver.body).mass[0]
    if _is_same_motion(rows, expected):
        return driver
    start = scene.body(driver.body).pose
    if _is_same_motion(rows[:, :7], expected[:, :7]):
        reason = "velocities or forces changed but poses did not: change the poses"
        raise AssetError(path, name, reason)
    if not _is_same_motion(
        rows[:1, :7], np.array([[*start.position_m, *start.quaternion]])
    ):
        reason = f"its rows start at {format_value(rows[0, :7])}, but the body elsewhere: make both poses equal"
        raise AssetError(path, name, reason)
    times_s = (np.arange(count + 1) * DRIVE_INTERVAL_S).tolist()
    poses = [pose_of(row[:3], row[3:7]) for row in rows]
    poses.append(_pose_after(rows[-1], mass_kg))
    try:
        sampled = sampled_motions(start, times_s, poses, like=driver.motions)
    except ShapeError as error:
        raise AssetError(path, name, str(error)) from error
    provenance = f"nominal: edited in {path.name}, was {driver.provenance}"
    return replace(driver, motions=sampled, provenance=provenance)


def _pose_after(row: FloatArray, mass_kg: float) -> Pose:
    """Return the pose at the end of the interval of a row: x + v t + a t^2 / 2, and alike for the rotation."""
    rotation = Rotation.from_quat(row[3:7], scalar_first=True)
    # MuJoCo's angular velocity of a free joint is in the body frame.
    velocity = np.concatenate([row[7:10], rotation.apply(row[10:13])])
    acceleration = row[13:] / mass_kg
    displacement = (
        velocity * DRIVE_INTERVAL_S + 0.5 * acceleration * DRIVE_INTERVAL_S**2
    )
    return Pose.from_rotation(
        vector(row[:3] + displacement[:3]),
        Rotation.from_rotvec(displacement[3:]) * rotation,
    )


def _is_same_motion(rows: FloatArray, expected: FloatArray) -> bool:
    """Return whether rows are equal, relative to the largest number of each column."""
    scale = np.maximum(np.abs(expected).max(axis=0), 1e-3)
    return bool((np.abs(rows - expected) <= ROW_TOLERANCE * scale).all())
