"""Trials with a realistic scatter, and damages of one of them.

Clean trials are the bundled real ones, or the motion of a reference with releases, starts, constants and noise that
scatter like theirs. A damage changes the path of a body or marker, or the text of the file.
"""

from __future__ import annotations

import json

import numpy as np
from dataset_writer import (
    body_asset,
    driven_asset,
    driver_coordinates,
    marker_asset,
    trial_content,
)
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.references.band import load_band

MAX_RELEASE_FRAMES = 9
"""Largest delay of a release in real slides [frames]."""


def clean_contents(name, rng, count=20, *, noise_mm=0.1, lost=0.0, offset_mm=(0, 0, 0)):
    """Return clean trials of a variant as contents of files.

    Args:
        name: The variant.
        rng: Generator of the scatter.
        count: Number of trials.
        noise_mm: Standard deviation of each coordinate [mm].
        lost: Share of frames in which a body or all markers are not captured.
        offset_mm: Place of all trials relative to the published one [mm].
    """
    experiment = load_experiment(name)
    paths = clean_paths(experiment, rng, count)
    contents = []
    for path in paths:
        path = path + offset_mm + rng.normal(0.0, noise_mm, path.shape)
        path[rng.permutation(len(path))[: round(lost * len(path))]] = np.nan
        assets = assets_of(experiment, path)
        for driver in experiment.scene.drivers:
            assets[driver.body] = driven(experiment, driver.body, rng, noise_mm)
        contents.append(json.loads(as_text(trial_content(assets))))
    return contents


def as_text(content):
    """Return a file as the dataset writes it: four digits, and null for a lost sample."""
    text = json.dumps(content, default=float)
    return text.replace("NaN", "null")


def assets_of(experiment, path):
    """Return the recorded bodies or markers of a path, shape [T, P, 3]."""
    if experiment.recorded:
        return {
            body: body_asset(path[:, k]) for k, body in enumerate(experiment.recorded)
        }
    (name, *more) = experiment.scene.markers.bodies
    ids = [f"{k:03d}" for k in range(path.shape[1])]
    return {"markers" if more else name: marker_asset(path, ids)}


def clean_paths(experiment, rng, count):
    """Return paths of recorded bodies or markers [mm], shape [count, T, P, 3]."""
    band = load_band(experiment.name)
    if band is not None and band.trials is not None:
        chosen = np.arange(count) % len(band.trials)
        (direction,) = band.projection
        start = start_mm(experiment)
        across = start - (start @ direction)[:, None] * direction
        paths = across + band.trials[chosen, :, :, None] * direction
        # More than the real trials: another constant.
        share = 1.0 + 0.02 * rng.normal(size=(count, 1, 1, 1)) * (
            np.arange(count) >= len(band.trials)
        ).reshape(-1, 1, 1, 1)
        return paths[:, :1] + share * (paths - paths[:, :1])
    mean = reference_paths(experiment, band)
    frames = np.arange(len(mean))
    paths = []
    for _ in range(count):
        delay = 0.0
        if not experiment.scene.drivers:
            delay = rng.uniform(0.0, min(MAX_RELEASE_FRAMES, len(mean) / 4.0))
        rows = np.clip(frames - delay, 0.0, None)
        moved = np.stack(
            [
                np.interp(rows, frames, column)
                for column in mean.reshape(len(mean), -1).T
            ],
            axis=1,
        ).reshape(mean.shape)
        size = 1.0 + 0.03 * rng.normal()
        paths.append(moved[0] + size * (moved - moved[0]) + rng.normal(0.0, 1.5, 3))
    return np.array(paths)


def start_mm(experiment):
    scene = experiment.scene
    if experiment.recorded:
        places = [scene.body(body).pose.position_m for body in experiment.recorded]
        return 1e3 * np.array(places)
    return 1e3 * np.asarray(scene.markers.positions_m)


def reference_paths(experiment, band):
    """Return a motion of the recorded points [mm], shape [T, P, 3]: of the reference, or a swing."""
    start, count = start_mm(experiment), experiment.frame_count
    if band is not None and band.compared.unit == "mm":
        columns = band.compared.mean
        mean = (
            columns @ np.linalg.pinv(band.projection).T
            if band.points is None
            else columns
        )
        moved = going_on(mean - mean[0])
        return start + moved.reshape(count, -1, 3)
    times_s = np.arange(count)[:, None, None] / 30.0
    swing = 150.0 * (1.0 - np.cos(2.0 * np.pi * 0.8 * times_s)) * np.exp(-0.3 * times_s)
    lag = np.linspace(0.5, 1.0, len(start))[:, None]
    return start + swing * lag * [1.0, 0.2, -0.3]


def going_on(moved):
    """Return a motion that keeps its last known velocity."""
    known = np.flatnonzero(np.isfinite(moved).all(axis=1))
    last = known[-1]
    step = moved[last] - moved[last - 1]
    later = np.arange(1, len(moved) - last)[:, None]
    return np.vstack([moved[: last + 1], moved[last] + later * step])


def driven(experiment, body, rng, noise_mm):
    """Return a driven body whose motion scatters by 1 % and by noise."""
    driver = next(d for d in experiment.scene.drivers if d.body == body)
    asset = driven_asset(experiment, body, experiment.frame_count)
    pose = experiment.scene.body(body).pose
    size = 3.0 * (1.0 + 0.01 * rng.normal())
    positions = np.repeat(np.asarray(pose.position_m)[None], experiment.frame_count, 0)
    rotations = Rotation.concatenate([pose.rotation] * experiment.frame_count)
    values = size * driver_coordinates(len(driver.motions), experiment.frame_count)
    for motion, column in zip(driver.motions, values.T, strict=True):
        axis = np.asarray(motion.axis)
        if motion.kind == "translate":
            positions = positions + column[:, None] * axis
        else:
            steps = Rotation.from_rotvec(column[:, None] * axis)
            positions = steps.apply(positions - motion.point_m) + motion.point_m
            rotations = steps * rotations
    positions = 1e3 * positions + rng.normal(0.0, noise_mm, positions.shape)
    asset |= body_asset(positions, rotations)
    return asset


# --- damages of a path -----------------------------------------------------------------------------------------------


def moving_rows(path, rng, count):
    """Return rows in the middle of a motion, `count` of them."""
    rows = len(path)
    first = int(rng.integers(rows // 3, max(rows - count - 1, rows // 3 + 1)))
    return slice(first, first + count)


def some(share, least=1):
    return lambda path: max(least, round(share * len(path)))


def put(value, count=lambda path: 1, columns=slice(None)):
    def change(path, rng):
        path[moving_rows(path, rng, count(path)), columns] = value
        return path

    return change


def held(count):
    def change(path, rng):
        rows = moving_rows(path, rng, count(path))
        path[rows] = path[rows.start]
        return path

    return change


def from_row(action):
    """Return a change of all rows from one in the middle on."""

    def change(path, rng):
        first = int(rng.integers(len(path) // 3, 2 * len(path) // 3))
        path[first:] = action(path[first:], rng)
        return path

    return change


def added(size_mm, count=None):
    """Return a displacement of some rows, or of all from one on."""

    def change(path, rng):
        direction = rng.normal(size=3)
        step = size_mm * direction / np.linalg.norm(direction)
        rows = (
            moving_rows(path, rng, count)
            if count
            else slice(moving_rows(path, rng, 1).start, None)
        )
        path[rows] += step
        return path

    return change


def drift(size_mm):
    def change(path, rng):
        direction = rng.normal(size=3)
        ramp = np.linspace(0.0, size_mm, len(path))[:, None]
        return path + ramp * direction / np.linalg.norm(direction)

    return change


def axes(order, signs=(1, 1, 1), *, about_start):
    def change(path, rng):
        origin = path[np.isfinite(path).all(axis=1)][0] if about_start else 0.0
        return (path - origin)[:, list(order)] * signs + origin

    return change


def at_rate(rate_hz):
    """Return a path whose rows are at another rate; a rate above 30 Hz shows less of the motion."""

    def change(path, rng):
        rows = np.arange(len(path)) * 30.0 / rate_hz
        frames = np.arange(len(path))
        return np.stack([np.interp(rows, frames, column) for column in path.T], axis=1)

    return change


LOST_DAMAGES = {
    "x never captured": lambda path, rng: path * [np.nan, 1, 1],
    "z never captured": lambda path, rng: path * [1, 1, np.nan],
    "never captured": lambda path, rng: path * np.nan,
    "40 % not captured": put(np.nan, some(0.4)),
    "y 25 % not captured": put(np.nan, some(0.25), 1),
    "half of the frames": lambda path, rng: np.where(
        np.arange(len(path))[:, None] < 0.58 * len(path), path, np.nan
    ),
    "zeros in a frame": put(0.0),
    "zeros in frames": put(0.0, some(0.15, 2)),
    "zero x in a frame": put(0.0, columns=0),
    "-9999 in a frame": put(-9999.0),
    "-9999 in frames": put(-9999.0, some(0.2, 2)),
    "zeros to the end": from_row(lambda path, rng: 0.0 * path),
    "held": held(some(0.25, 3)),
    "held to the end": from_row(lambda path, rng: np.repeat(path[:1], len(path), 0)),
    "frozen": lambda path, rng: np.repeat(path[:1], len(path), 0),
    "12.5 m in a frame": added(12500.0, 1),
    "1 m in a frame": added(1000.0, 1),
    "60 mm in a frame": added(60.0, 1),
    "step of 1 m": added(1000.0),
    "step of 120 mm": added(120.0),
    "drift of 15 m": drift(15000.0),
    "drift of 2 m": drift(2000.0),
}
"""Damages of the path of a body or marker, shape [T, 3]; each returns the damaged path."""

RECORDING_DAMAGES = {
    "60 Hz": at_rate(60.0),
    "120 Hz": at_rate(120.0),
    "15 Hz": at_rate(15.0),
    "motion mirrored": axes((0, 1, 2), (-1, -1, -1), about_start=True),
    "x of motion mirrored": axes((0, 1, 2), (-1, 1, 1), about_start=True),
    "z of motion mirrored": axes((0, 1, 2), (1, 1, -1), about_start=True),
    "x and z of motion exchanged": axes((2, 1, 0), about_start=True),
    "y and z of motion exchanged": axes((0, 2, 1), about_start=True),
    "x and z exchanged": axes((2, 1, 0), about_start=False),
    "x and y exchanged": axes((1, 0, 2), about_start=False),
    "z mirrored": axes((0, 1, 2), (1, 1, -1), about_start=False),
    "metres as mm": lambda path, rng: path / 1e3,
    "cm as mm": lambda path, rng: path / 10.0,
    "reversed": lambda path, rng: path[::-1],
    "noise of 60 mm": lambda path, rng: path + rng.normal(0.0, 60.0, path.shape),
    "half as large": lambda path, rng: path[0] + 0.5 * (path - path[0]),
}
"""Damages of all paths of a recording."""


def damaged(content, experiment, asset, marker, change, rng):
    """Return a trial in which the path of a body, of a marker or of all markers is damaged."""
    entry = content[asset]
    keys = [key for key in entry if isinstance(entry[key], dict)]
    if marker is not None:
        keys = [keys[marker]]
    bodies = [entry[key] for key in keys] or [entry]
    seed = int(rng.integers(2**31))
    for body in bodies:
        path = np.array([body[axis] for axis in "xyz"], float).T
        path = change(path, np.random.default_rng(seed))
        body |= {
            axis: column.tolist() for axis, column in zip("xyz", path.T, strict=True)
        }
    return content


def exchanged(content, first, second):
    content[first], content[second] = content[second], content[first]
    return content


FILE_DAMAGES = {
    "copy with blanks": lambda contents: json.dumps(contents[1], indent=3),
    "copy with other keys": lambda contents: json.dumps(
        dict(reversed(contents[1].items())) | {"note": "copy"}
    ),
    "cut": lambda contents: json.dumps(contents[0])[:-200],
    "60 Hz stated": lambda contents: json.dumps(contents[0] | {"FPS": 60}),
    "feet stated": lambda contents: json.dumps(
        contents[0] | {"translation unit": "ft"}
    ),
    "body twice": lambda contents: json.dumps(
        contents[0]
        | {
            name.upper(): contents[1][name]
            for name in contents[0]
            if isinstance(contents[0][name], dict)
        }
    ),
    "name twice": lambda contents: (
        "{" + json.dumps(contents[1])[1:-1] + ", " + json.dumps(contents[0])[1:]
    ),
}
"""Damages of the text of the first trial, from the contents of all."""
