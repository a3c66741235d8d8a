"""Compute g(t) and the driver's coordinates of a trial, as for a simulation."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from gauge_envs.errors import ShapeError, first_names
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
from gauge_envs.tools.dataset.trial import PoseTrack, Trial, check_lengths

MAX_START_DISTANCE_MM = 300.0
"""Largest distance of a start from the calibrated start; beyond it frame, unit or body is another one."""

AXES_TOLERANCE_MM = 30.0
"""Distance from the calibrated start above which axes may be exchanged; exchanged back, it must be a quarter of it.
Real starts are within 20 mm."""

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

    Raises:
        TrialError: What is recorded is missing, damaged, or starts elsewhere; or the trial is too short.
    """
    markers = experiment.scene.markers
    if experiment.score.observable is Observable.POSITION or markers is None:
        tracks = {name: _pose_track(trial, name) for name in experiment.recorded}
        check_lengths({name: track.positions_mm for name, track in tracks.items()})
        for name, track in tracks.items():
            _check_start(name, track, experiment.scene.body(name).pose)
        values = np.concatenate(
            [track.positions_mm for track in tracks.values()], axis=1
        )
    else:
        markers_m = trial_markers_m(trial, experiment)
        try:
            values = observe_markers(markers_m, markers, experiment.score.observable)
        except ShapeError as error:
            expected = "markers as in the metadata are expected"
            raise TrialError("markers", str(error), expected) from None
    needed = experiment.frame_count if published_baselines(experiment.name) else 2
    if len(values) < needed:
        problem = f"it has {len(values)} frames"
        raise TrialError("(file)", problem, f"{needed} or more are needed")
    frames = np.full((experiment.frame_count, values.shape[1]), np.nan)
    count = min(len(values), experiment.frame_count)
    frames[:count] = values[:count]
    if np.isnan(frames).all():
        problem = "no frame of what is recorded was captured"
        raise TrialError("(file)", problem, "samples are expected")
    return frames


def start_quaternions(trial: Trial, experiment: Experiment) -> FloatArray:
    """Return the orientations of the recorded bodies in the first frames of a trial.

    Returns:
        Unit quaternions x y z w, body to world, shape [START_FRAMES, body_count, 4]; NaN where a trial has none.
    """
    tracks = [_pose_track(trial, name) for name in experiment.recorded]
    quaternions = np.full((START_FRAMES, len(tracks), 4), np.nan)
    for index, track in enumerate(tracks):
        if track.quaternions_xyzw is not None:
            first = track.quaternions_xyzw[:START_FRAMES]
            quaternions[: len(first), index] = first
    return quaternions


def driver_tracks(trial: Trial, experiment: Experiment) -> tuple[DriverTrack, ...]:
    """Return the recorded motion of the driven bodies, in the order of the scene's drivers.

    Raises:
        TrialError: A driven body is missing or damaged, starts elsewhere, or was not captured at first.
    """
    return tuple(
        _driver_track(
            driver,
            _pose_track(trial, driver.body),
            experiment.scene.body(driver.body).pose,
            experiment.frame_count,
        )
        for driver in experiment.scene.drivers
    )


Asset = TypeVar("Asset")


def _assets(
    trial: Trial, assets: Mapping[str, Asset], names: Iterable[str]
) -> dict[str, Asset]:
    """Return the assets of some names, in any spelling, or raise the fault of one of them."""
    plain = {_plain(name) for name in names}
    for name, fault in trial.faults.items():
        if _plain(name) in plain:
            raise fault
    return {name: asset for name, asset in assets.items() if _plain(name) in plain}


def _plain(name: str) -> str:
    return "".join(character for character in name.lower() if character.isalnum())


def _pose_track(trial: Trial, name: str) -> PoseTrack:
    tracks = _assets(trial, trial.poses, [name])
    if not tracks:
        raise TrialError(name, "the rigid body is missing", _contents(trial))
    return next(iter(tracks.values()))


def _contents(trial: Trial) -> str:
    return f"the file has {first_names([*trial.poses, *trial.markers])}"


def _check_start(name: str, track: PoseTrack, start: Pose) -> None:
    positions_mm = track.positions_mm[~np.isnan(track.positions_mm).any(axis=1)]
    if not len(positions_mm):
        raise TrialError(name, "it was never captured", "samples are expected")
    _check_place(name, positions_mm[0], 1e3 * np.asarray(start.position_m))


def _check_place(name: str, place_mm: FloatArray, start_mm: FloatArray) -> None:
    """Raise an error if a first place is far from the calibrated start, or near to it with exchanged axes."""
    distance_mm = length_of(place_mm - start_mm)
    expected = f"within {MAX_START_DISTANCE_MM:.0f} mm, in the motion-capture frame and in mm, is expected"
    problem = f"it starts {distance_mm:.0f} mm from its calibrated start"
    if distance_mm > MAX_START_DISTANCE_MM:
        raise TrialError(name, problem, expected)
    for order in itertools.permutations(range(3)):
        exchanged_mm = length_of(place_mm[list(order)] - start_mm)
        if exchanged_mm < 0.25 * distance_mm and distance_mm > AXES_TOLERANCE_MM:
            axes = ", ".join("xyz"[axis] for axis in order)
            expected = f"its lists {axes} hold x, y, z of the motion-capture frame: exchange them"
            raise TrialError(name, f"{problem}: its axes look exchanged", expected)


# --- markers ---------------------------------------------------------------------------------------------------------


def trial_markers_m(trial: Trial, experiment: Experiment) -> FloatArray:
    """Return the marker positions of a trial in the order of the task file.

    Returns:
        Positions [m], shape [recorded_frame_count, marker_count, 3]; NaN where a marker is missing.

    Raises:
        TrialError: Markers are missing, damaged, or in another order.
    """
    markers = experiment.scene.markers
    if markers is None:
        problem = "the experiment has no markers"
        raise TrialError("(file)", problem, "its task file lists them")
    sets = _assets(trial, trial.markers, [*markers.bodies, "markers"]) or trial.markers
    if not sets:
        raise TrialError("markers", "the marker set is missing", _contents(trial))
    positions = {
        marker: positions_mm
        for marker_set in sets.values()
        for marker, positions_mm in marker_set.items()
    }
    count = len(markers.positions_m)
    if len(positions) != count:
        problem = f"it has {len(positions)} markers"
        raise TrialError(", ".join(sets), problem, f"{count} are expected")
    check_lengths({name: next(iter(sets[name].values())) for name in sets})
    are_numbers = all(marker.isdecimal() for marker in positions)
    ids = sorted(positions, key=int if are_numbers else str)
    positions_mm = np.stack([positions[marker] for marker in ids], axis=1)
    _check_order(ids, positions_mm, 1e3 * np.asarray(markers.positions_m))
    return 1e-3 * positions_mm


def _check_order(
    ids: Sequence[str], positions_mm: FloatArray, rest_mm: FloatArray
) -> None:
    """Raise an error if the markers start elsewhere, or in a clearly permuted order.

    Args:
        ids: Marker ids in the order of the metadata.
        positions_mm: Positions of the markers, shape [frame_count, marker_count, 3].
        rest_mm: Calibrated positions, shape [marker_count, 3].
    """
    captured = np.asarray(~np.isnan(positions_mm).any(axis=2))
    seen = np.flatnonzero(captured.any(axis=0))
    if not seen.size:
        raise TrialError(
            "markers", "no marker was ever captured", "samples are expected"
        )
    starts_mm = positions_mm[captured[:, seen].argmax(axis=0), seen]
    _check_place("markers", starts_mm.mean(axis=0), rest_mm[seen].mean(axis=0))
    squares = cdist(starts_mm, rest_mm[seen], "sqeuclidean")
    rows, places = linear_sum_assignment(squares)
    given_mm = np.sqrt(np.diag(squares).mean())
    best_mm = np.sqrt(squares[rows, places].mean())
    if given_mm > SWAPPED_MARKERS_MM and best_mm < 0.5 * given_mm:
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
    _check_start(driver.body, track, start)
    positions_m = 1e-3 * track.positions_mm[:frame_count]
    is_known = np.asarray(~np.isnan(positions_m).any(axis=1))
    has_rotation = track.quaternions_xyzw is not None
    if track.quaternions_xyzw is not None:
        quaternions = track.quaternions_xyzw[:frame_count]
        is_known &= ~np.isnan(quaternions).any(axis=1)
    elif any(motion.kind == "rotate" for motion in driver.motions):
        expected = "a driver that rotates needs qx, qy, qz and qw"
        raise TrialError(f"{driver.body}.qx", "it is missing", expected)
    if not is_known[0]:
        expected = "the motion of a driver is measured from frame 0"
        raise TrialError(f"{driver.body}[0]", "frame 0 was not captured", expected)
    known = np.flatnonzero(is_known)
    rotations = (
        Rotation.from_quat(quaternions[known])
        if has_rotation
        else Rotation.identity(len(known))
    )
    # The axis of a motion belongs to the body, so it is shifted by the offset of the trial's start.
    offset_m = positions_m[0] - start.position_m
    motions = [
        replace(motion, point_m=tuple((motion.point_m + offset_m).tolist()))
        for motion in driver.motions
    ]
    values, missed_m, missed_rad = motion_coordinates(
        motions, positions_m[0], positions_m[known], rotations * rotations[0].inv()
    )
    coordinates = np.full((frame_count, len(motions)), np.nan)
    residual_mm = np.full(frame_count, np.nan)
    residual_rad = np.full(frame_count, np.nan)
    coordinates[known] = values
    residual_mm[known] = 1e3 * missed_m
    if has_rotation:
        residual_rad[known] = missed_rad
    return DriverTrack(
        body=driver.body,
        coordinates=coordinates,
        residual_mm=residual_mm,
        residual_rad=residual_rad,
        start_offset_mm=1e3 * length_of(offset_m),
    )
