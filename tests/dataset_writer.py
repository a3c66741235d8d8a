"""Write synthetic trials with known statistics, in the irregular layout of the published dataset.

The folder names do not come from the package, because they check the importer.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs import find_variant, load_experiment
from gauge_envs.experiments.experiment import Experiment

FloatArray = NDArray[np.float64]

TASK_FOLDERS = {
    "SlopeContact": "rigid/slope contact",
    "NonsmoothContact": "rigid/nonsmooth contact",
    "SlopeSlider": "rigid/slope slider",
    "Turntable": "rigid/turntable",
    "BouncingBall": "rigid/bouncing ball",
    "NewtonsCradle": "rigid/newton's cradle",
    "WallBreaking": "rigid/wall breaking",
    "Pendulum": "rigid/pendulum",
    "RopeWinding": "rope/rope winding",
    "TextileStretching": "textile/textile stretching",
    "TextileBending": "textile/textile bending",
    "TextileFlinging": "textile/textile flinging",
    "Funnel": "textile/funnel",
    "RotatingBall": "textile/rotating ball",
    "TableclothPulling": "textile/tablecloth pulling",
    "FoamStretching": "deformable/foam stretching",
    "FoamCompressing": "deformable/foam compression",
    "FoamShearing": "deformable/foam shearing",
    "FoamTwisting": "deformable/foam twisting",
    "FoamBending": "deformable/foam bending",
    "CantileverBeam": "deformable/cantilever beam",
    "StickStack": "deformable/stick-stack",
}
FABRICS = {"rayon": "cotton", "uniform": "suit"}

FRAMES_AFTER = 5
"""Number of frames after the published ones; the importer must cut them off."""

AMOUNTS = (-1.5, -1.0, 0.5, 0.75, 1.25)
"""Deviations of trials from their mean; their sum is 0."""


def trial_folder(name):
    """Return the folder of the trials of a variant in the published layout."""
    variant = find_variant(name)
    folder = f"data/{TASK_FOLDERS[variant.family]}/json"
    if variant.family == "BouncingBall":
        return folder
    task = f"/task-{variant.subtask}" if variant.subtask else ""
    return f"{folder}/{FABRICS.get(variant.material, variant.material)}{task}"


def write_trial(root, name, number, content):
    """Write one trial file of a variant."""
    file = root / trial_folder(name) / f"trial-{number}.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(
        content if isinstance(content, bytes) else json.dumps(content).encode()
    )
    return file


def trial_content(assets):
    """Return the content of a trial file with these assets."""
    return {"FPS": 30, "translation unit": "mm", **assets}


def body_asset(positions_mm, rotations=None):
    """Return a rigid body: positions [mm], shape [frame_count, 3], and orientations, upright by default."""
    rotations = rotations or Rotation.identity(len(positions_mm))
    columns = [*zip("xyz", np.asarray(positions_mm).T, strict=True)]
    columns += zip(("qx", "qy", "qz", "qw"), rotations.as_quat().T, strict=True)
    return {key: values.tolist() for key, values in columns}


def marker_asset(positions_mm, ids):
    """Return a marker set of positions [mm], shape [frame_count, marker_count, 3]."""
    return {
        str(marker): {
            axis: positions_mm[:, number, k].tolist() for k, axis in enumerate("xyz")
        }
        for number, marker in enumerate(ids)
    }


@dataclass(frozen=True)
class Synthetic:
    """Trials of one variant in closed form.

    Attributes:
        experiment: The experiment.
        contents: The trial files.
        coordinates: Mean coordinates of prescribed motions [m or rad], by body, shape [frame_count, motion_count].
    """

    experiment: Experiment
    contents: list[dict[str, Any]]
    coordinates: dict[str, FloatArray]


def synthetic_trials(name, amounts=AMOUNTS, *, frames_after=FRAMES_AFTER):
    """Return trials that differ by a constant.

    Bodies move along x by 2 mm per frame; each trial is shifted along y by its amount [mm]. Markers have their rest
    shape, scaled about the first marker by 1 + 1e-3 amount. Prescribed motions advance by 1e-3 m or rad per frame.
    """
    experiment = load_experiment(name)
    scene = experiment.scene
    count = experiment.frame_count + frames_after
    frames = np.arange(count)[:, None]
    contents = []
    for amount in amounts:
        assets = {}
        for body in experiment.recorded:
            start = 1e3 * np.asarray(scene.body(body).pose.position_m)
            positions = start + frames * [2.0, 0.0, 0.0] + np.array([0.0, amount, 0.0])
            positions[experiment.frame_count :] = 1e4
            assets[body] = body_asset(positions)
        if scene.markers is not None:
            positions = np.repeat(
                scaled_markers(experiment, amount)[None], count, axis=0
            )
            positions[experiment.frame_count :] = 1e4
            ids = 5 + 3 * np.arange(
                positions.shape[1]
            )  # one to three digits: as text, 11 precedes 5
            order = np.argsort(ids.astype(str))
            assets[
                "markers" if len(scene.markers.bodies) > 1 else scene.markers.bodies[0]
            ] = marker_asset(positions[:, order], ids[order].tolist())
        for driver in scene.drivers:
            assets[driver.body] = driven_asset(experiment, driver.body, count)
        contents.append(trial_content(assets))
    coordinates = {
        driver.body: driver_coordinates(len(driver.motions), experiment.frame_count)
        for driver in scene.drivers
    }
    return Synthetic(experiment, contents, coordinates)


def scaled_markers(experiment, amount):
    """Return the marker positions of a trial [mm], shape [marker_count, 3]."""
    assert experiment.scene.markers is not None
    rest = 1e3 * np.asarray(experiment.scene.markers.positions_m)
    return rest[0] + (1.0 + 1e-3 * amount) * (rest - rest[0])


def driver_coordinates(motion_count, frame_count):
    """Return coordinates [m or rad], shape [frame_count, motion_count]; the second motion has twice the speed."""
    return 1e-3 * np.arange(frame_count)[:, None] * np.arange(1, motion_count + 1)


def driven_asset(experiment, body, count):
    """Return a moving driven body, by composing its prescribed motions in order."""
    driver = next(driver for driver in experiment.scene.drivers if driver.body == body)
    start = experiment.scene.body(body).pose
    positions = np.repeat(np.asarray(start.position_m)[None], count, axis=0)
    rotations = Rotation.concatenate([start.rotation] * count)
    for motion, values in zip(
        driver.motions, driver_coordinates(len(driver.motions), count).T, strict=True
    ):
        axis = np.asarray(motion.axis)
        if motion.kind == "translate":
            positions = positions + values[:, None] * axis
        else:
            rotation_steps = Rotation.from_rotvec(values[:, None] * axis)
            positions = (
                rotation_steps.apply(positions - motion.point_m) + motion.point_m
            )
            rotations = rotation_steps * rotations
    return body_asset(1e3 * positions, rotations)


def write_synthetic(root, name, amounts=AMOUNTS):
    """Write the synthetic trials of a variant."""
    synthetic = synthetic_trials(name, amounts)
    for number, content in enumerate(synthetic.contents, start=1):
        write_trial(root, name, number, content)
    return synthetic
