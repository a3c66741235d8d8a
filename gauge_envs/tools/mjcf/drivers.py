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

SAME_MOTION = 1e-6
"""Relative difference below which rows of driven motion are equal; accelerations are second differences of poses."""


def numerics(model: mujoco.MjModel) -> dict[str, FloatArray]:
    """Return the custom numbers of a model, by name."""
    listed = [model.numeric(index) for index in range(model.nnumeric)]
    return {one.name: one.data for one in listed}


def pose_of(position_m: FloatArray, quaternion: FloatArray) -> Pose:
    """Return the pose of a place [m], shape [3], and a quaternion w, x, y, z."""
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
    model, data = simulation.model, simulation.data
    joint, body = model.joint(motion.body), model.body(motion.body)
    position, speed = int(joint.qposadr[0]), int(joint.dofadr[0])
    still = np.zeros((1, motion.motion_count))
    rows = np.empty((count, DRIVER_COLUMNS))
    for interval, row in enumerate(rows):
        simulation.drive(motion.body, motion.targets(interval, still)[0])
        row[:7] = data.qpos[position : position + 7]
        row[7:13] = data.qvel[speed : speed + 6]
        row[13:] = data.xfrc_applied[body.id]
    return rows


def read_driver(
    path: Path,
    model: mujoco.MjModel,
    scene: Scene,
    driver: Driver,
    simulation: SimulationMuJoCo,
) -> Driver:
    """Return the scene's driver if the file's rows equal its motion, otherwise a driver through the rows' poses."""
    name = f"{DRIVER_PREFIX}{driver.body}"
    numbers = numerics(model).get(name)
    if numbers is None:
        raise AssetError(
            path,
            name,
            "the custom numeric with the motion of this driven body is missing: add it",
        )
    if numbers.size == 0 or numbers.size % DRIVER_COLUMNS:
        raise AssetError(
            path,
            name,
            f"it has {numbers.size} numbers: whole rows of {DRIVER_COLUMNS} are expected",
        )
    rows = numbers.reshape(-1, DRIVER_COLUMNS)
    count = round(scene.duration_s / DRIVE_INTERVAL_S)
    rows = rows[np.minimum(np.arange(count), len(rows) - 1)]
    prescribed = prescribed_motions(scene, scene.duration_s)
    (motion,) = (one for one in prescribed if one.body == driver.body)
    expected = driver_rows(simulation, motion, count)
    expected[:, 13:] *= (
        model.body(driver.body).mass[0] / simulation.model.body(driver.body).mass[0]
    )
    if _same_rows(rows, expected):
        return driver
    if _same_rows(rows[:, :7], expected[:, :7]):
        raise AssetError(
            path,
            name,
            "velocities or forces changed but poses did not: change the poses",
        )
    poses = [
        *(pose_of(row[:3], row[3:7]) for row in rows),
        _end_of(rows[-1], model.body(driver.body).mass[0]),
    ]
    start = scene.body(driver.body).pose
    if not _same_rows(rows[:1, :7], np.array([[*start.position_m, *start.quaternion]])):
        raise AssetError(
            path,
            name,
            f"its rows start at {format_value(rows[0, :7])}, but the body elsewhere: make both poses equal",
        )
    try:
        motions = sampled_motions(
            start,
            (np.arange(count + 1) * DRIVE_INTERVAL_S).tolist(),
            poses,
            like=driver.motions,
        )
    except ShapeError as error:
        raise AssetError(path, name, str(error)) from error
    return replace(
        driver,
        motions=motions,
        provenance=f"nominal: edited in {path.name}, was {driver.provenance}",
    )


def _end_of(row: FloatArray, mass_kg: float) -> Pose:
    """Return the pose at the end of the interval of a row of driven motion."""
    seconds = DRIVE_INTERVAL_S
    rotation = Rotation.from_quat(row[3:7], scalar_first=True)
    rates = np.concatenate([row[7:10], rotation.apply(row[10:13])])
    displacement = rates * seconds + 0.5 * row[13:] / mass_kg * seconds**2
    return Pose.from_rotation(
        vector(row[:3] + displacement[:3]),
        Rotation.from_rotvec(displacement[3:]) * rotation,
    )


def _same_rows(rows: FloatArray, expected: FloatArray) -> bool:
    size = np.abs(expected).max(axis=0, initial=0.0)
    return bool((np.abs(rows - expected) <= SAME_MOTION * np.maximum(size, 1e-3)).all())
