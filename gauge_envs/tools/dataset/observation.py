"""Compute g(t) and the driver's coordinates of a trial, as for a simulation."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from gauge_envs.errors import ShapeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.observables.observer import observe_markers
from gauge_envs.references.imported import START_FRAMES
from gauge_envs.references.published import published_baselines
from gauge_envs.scene import Pose
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.bench.driver_fit import motion_coordinates
from gauge_envs.tools.dataset.findings import TrialError
from gauge_envs.tools.dataset.trial import PoseTrack, Trial

START_RANGE_MM = 300.0
"""Largest distance of a start from the calibrated start; beyond it frame, unit or body is another one."""

SWAPPED_MARKERS_MM = 10.0
"""Distance from their places at which markers may be swapped; exchanged places must be half as far."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DriverTrack:
    """Motion of a driven body in one trial, projected on the motions of its driver.

    Attributes:
        body: Name of the body.
        coordinates: Coordinates relative to the trial's own start [m or rad], shape [frame_count, motion_count]; NaN
            where the body was not captured.
        residual_mm: Distance between the recorded origin and that of the coordinates [mm], shape [frame_count].
        residual_rad: Angle of the recorded rotation that the coordinates do not cover [rad], shape [frame_count]; NaN
            for a file without orientation.
        start_offset_mm: Distance of the trial's start from the calibrated start [mm].
    """

    body: str
    coordinates: FloatArray
    residual_mm: FloatArray
    residual_rad: FloatArray
    start_offset_mm: float


def trial_trajectory(trial: Trial, experiment: Experiment) -> FloatArray:
    """Return g(t) of a trial over the frames of an experiment.

    Args:
        trial: The trial.
        experiment: Experiment of the trial.

    Returns:
        g(t) in the observable's unit, shape [frame_count, coordinate_count]; NaN where a sample is missing. A trial may
        end early if no frame count was published for the variant; its later frames are NaN.
    """
    if experiment.score.observable is Observable.POSITION:
        names = experiment.recorded
        tracks = [_pose(trial, name).positions_mm for name in names]
        for name, positions in zip(names, tracks, strict=True):
            if len(positions) != len(tracks[0]):
                raise TrialError(
                    name,
                    f"it has {len(positions)} frames",
                    f"{len(tracks[0])} are expected, as {names[0]} has",
                )
            _check_start(
                name, positions, np.asarray(experiment.scene.body(name).pose.position_m)
            )
        values = np.concatenate(tracks, axis=1)
    else:
        markers_m, markers = (
            trial_markers_m(trial, experiment),
            experiment.scene.markers,
        )
        assert markers is not None
        try:
            values = observe_markers(markers_m, markers, experiment.score.observable)
        except ShapeError as error:
            raise TrialError(
                "markers", str(error), "markers as in the metadata are expected"
            ) from None
    needed = experiment.frame_count if published_baselines(experiment.name) else 2
    if len(values) < needed:
        raise TrialError(
            "(file)", f"it has {len(values)} frames", f"{needed} or more are needed"
        )
    frames = np.full((experiment.frame_count, values.shape[1]), np.nan)
    count = min(len(values), experiment.frame_count)
    frames[:count] = values[:count]
    if np.isnan(frames).all():
        raise TrialError(
            "(file)",
            "no frame of what is recorded was captured",
            "samples are expected",
        )
    return frames


def start_quaternions(trial: Trial, experiment: Experiment) -> FloatArray:
    """Return the orientations of the recorded bodies in the first frames of a trial.

    Returns:
        Unit quaternions x y z w, body to world, shape [START_FRAMES, body_count, 4]; NaN where a trial has none.
    """
    tracks = [_pose(trial, name).quaternions_xyzw for name in experiment.recorded]
    found = np.full((START_FRAMES, len(tracks), 4), np.nan)
    for index, track in enumerate(tracks):
        if track is not None:
            found[: len(track), index] = track[:START_FRAMES]
    return found


def driver_tracks(trial: Trial, experiment: Experiment) -> tuple[DriverTrack, ...]:
    """Return the recorded motion of the driven bodies, in the order of the scene's drivers."""
    return tuple(
        _driver_track(
            driver,
            _pose(trial, driver.body),
            experiment.scene.body(driver.body).pose,
            experiment.frame_count,
        )
        for driver in experiment.scene.drivers
    )


def _plain(name: str) -> str:
    return "".join(character for character in name.lower() if character.isalnum())


def _check_faults(trial: Trial, names: Container[str]) -> None:
    """Raise the fault of an asset of these names, in plain spelling."""
    for key, fault in trial.faults.items():
        if _plain(key) in names:
            raise fault


def _pose(trial: Trial, name: str) -> PoseTrack:
    _check_faults(trial, {_plain(name)})
    found = next(
        (track for key, track in trial.poses.items() if _plain(key) == _plain(name)),
        None,
    )
    if found is None:
        raise TrialError(
            name,
            "the rigid body is missing",
            f"the file has {_listed([*trial.poses, *trial.markers])}",
        )
    return found


def _listed(names: Sequence[str]) -> str:
    text = ", ".join(sorted(names)[:8]) or "no asset"
    return text if len(names) <= 8 else f"{text}, ... {len(names)} in all"


def _check_start(name: str, positions_mm: FloatArray, start_m: FloatArray) -> None:
    captured = np.flatnonzero(~np.isnan(positions_mm).any(axis=1))
    if not captured.size:
        raise TrialError(name, "it was never captured", "samples are expected")
    distance = length_of(positions_mm[captured[0]] - 1e3 * start_m)
    if distance > START_RANGE_MM:
        raise TrialError(
            name,
            f"it starts {distance:.0f} mm from its calibrated start",
            f"within {START_RANGE_MM:.0f} mm, in the motion-capture frame and in mm, is expected",
        )


# --- markers ---------------------------------------------------------------------------------------------------------


def trial_markers_m(trial: Trial, experiment: Experiment) -> FloatArray:
    """Return the marker positions of a trial in the order of the task file.

    Returns:
        Positions [m], shape [recorded_frame_count, marker_count, 3]; NaN where a marker is missing.
    """
    markers = experiment.scene.markers
    if markers is None:
        raise TrialError(
            "(file)", "the experiment has no markers", "its task file lists them"
        )
    ids, positions_mm = _markers(trial, markers.bodies, len(markers.positions_m))
    rest_mm = 1e3 * np.asarray(markers.positions_m)
    _check_order(ids, positions_mm, rest_mm)
    return 1e-3 * positions_mm


def _markers(
    trial: Trial, bodies: Iterable[str], count: int
) -> tuple[list[str], FloatArray]:
    """Return marker ids in the metadata's order, and positions [mm], shape [frame_count, marker_count, 3]."""
    names = {_plain(name) for name in (*bodies, "markers")}
    _check_faults(trial, names)
    sets = {
        key: found for key, found in trial.markers.items() if _plain(key) in names
    } or trial.markers
    if not sets:
        raise TrialError(
            "markers",
            "the marker set is missing",
            f"the file has {_listed([*trial.poses])}",
        )
    merged: dict[str, FloatArray] = {}
    for name, found in sets.items():
        for marker, positions in found.items():
            if marker in merged:
                raise TrialError(
                    f"{name}.{marker}",
                    "another marker set has the same id",
                    "ids are unique",
                )
            merged[marker] = positions
    if len(merged) != count:
        raise TrialError(
            ", ".join(sets), f"it has {len(merged)} markers", f"{count} are expected"
        )
    lengths = {name: len(next(iter(found.values()))) for name, found in sets.items()}
    for name, length in lengths.items():
        if length != max(lengths.values()):
            raise TrialError(
                name,
                f"it has {length} frames",
                f"{max(lengths.values())} are expected, as others have",
            )
    ids = _sorted_ids(merged)
    return ids, np.stack([merged[marker] for marker in ids], axis=1)


def _sorted_ids(ids: Iterable[str]) -> list[str]:
    """Return ids sorted as numbers if all are numbers, so that 10 comes after 9; else sorted as text."""
    ids = sorted(ids)
    if all(
        marker.isascii() and marker.isdecimal() and len(marker) < 19 for marker in ids
    ):
        return sorted(ids, key=int)
    return ids


def _check_order(
    ids: Sequence[str], positions_mm: FloatArray, rest_mm: FloatArray
) -> None:
    """Raise if the markers start in a clearly permuted order."""
    captured = np.asarray(~np.isnan(positions_mm).any(axis=2))
    seen = np.flatnonzero(captured.any(axis=0))
    if not seen.size:
        raise TrialError(
            "markers", "no marker was ever captured", "samples are expected"
        )
    starts = positions_mm[np.argmax(captured[:, seen], axis=0), seen]
    _check_start(
        "markers", starts.mean(axis=0, keepdims=True), 1e-3 * rest_mm[seen].mean(axis=0)
    )
    squares = cdist(starts, rest_mm[seen], "sqeuclidean")
    rows, places = linear_sum_assignment(squares)
    given, best = (
        np.sqrt(np.diag(squares).mean()),
        np.sqrt(squares[rows, places].mean()),
    )
    if given > SWAPPED_MARKERS_MM and best < 0.5 * given:
        wrong = int(np.argmax(rows != places))
        raise TrialError(
            f"markers.{ids[seen[wrong]]}",
            f"it starts where marker {seen[places[wrong]]} of the metadata is, not {seen[wrong]}",
            "sorted ids are expected in the order of the metadata's markers",
        )


# --- drivers ---------------------------------------------------------------------------------------------------------


def _driver_track(
    driver: Driver, track: PoseTrack, start: Pose, frame_count: int
) -> DriverTrack:
    """Return the coordinates whose poses are nearest to the recorded ones, frame by frame."""
    calibrated = np.asarray(start.position_m)
    _check_start(driver.body, track.positions_mm, calibrated)
    rotation_count = sum(motion.kind == "rotate" for motion in driver.motions)
    if rotation_count > 1:
        raise TrialError(
            driver.body,
            "its driver has several rotations",
            "one rotation at most is expected, as several cannot be separated",
        )
    if rotation_count and track.quaternions_xyzw is None:
        raise TrialError(
            f"{driver.body}.qx",
            "it is missing",
            "a driver that rotates needs qx, qy, qz and qw",
        )

    positions = 1e-3 * track.positions_mm[:frame_count]
    quaternions = (
        np.zeros((0, 4))
        if track.quaternions_xyzw is None
        else track.quaternions_xyzw[:frame_count]
    )
    captured = (
        positions if not len(quaternions) else np.column_stack([positions, quaternions])
    )
    known = np.flatnonzero(~np.isnan(captured).any(axis=1))
    if known[:1].tolist() != [0]:
        raise TrialError(
            f"{driver.body}[0]",
            "frame 0 was not captured",
            "the motion of a driver is measured from frame 0",
        )

    first = positions[0]
    offset = first - calibrated
    # The axis of a motion belongs to the body, so it is shifted by the offset of the trial's start.
    motions = [
        replace(motion, point_m=tuple((motion.point_m + offset).tolist()))
        for motion in driver.motions
    ]
    rotations = (
        Rotation.from_quat(quaternions[known])
        if len(quaternions)
        else Rotation.identity(len(known))
    )
    values, missed_m, rest_rad = motion_coordinates(
        motions, first, positions[known], rotations * rotations[0].inv()
    )
    coordinates = np.full((frame_count, len(driver.motions)), np.nan)
    residual_mm, residual_rad = (np.full(frame_count, np.nan) for _ in range(2))
    coordinates[known], residual_mm[known] = values, 1e3 * missed_m
    if len(quaternions):
        residual_rad[known] = rest_rad
    return DriverTrack(
        body=driver.body,
        coordinates=coordinates,
        residual_mm=residual_mm,
        residual_rad=residual_rad,
        start_offset_mm=1e3 * length_of(offset),
    )
