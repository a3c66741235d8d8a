"""Compute g(t) and the coordinates of prescribed motions of a trial, as for a simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable, coordinate_names
from gauge_envs.observables.observer import observe_markers
from gauge_envs.references.band import displacements
from gauge_envs.references.imported import START_FRAMES
from gauge_envs.references.published import published_baselines
from gauge_envs.scene import Markers, Pose
from gauge_envs.scene.driver_fit import motion_coordinates
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.user_file.gate import SAME_MM
from gauge_envs.tools.dataset.findings import TrialError
from gauge_envs.tools.dataset.trial import PoseTrack, Trial, check_lengths

MAX_START_DISTANCE_MM = 300.0
"""Largest distance from the published initial position; a larger one means a wrong frame, unit or body."""

MAX_SIZE_RATIO = 1.4
"""Largest ratio of the size of the markers at the start to that in the metadata, and of its inverse.

It is halfway to a factor of 2; units differ by more."""

LEVERS_MM = ((100.0, 0.0, 0.0), (0.0, 0.0, 100.0))
"""Points whose motion shows the rotation of a driven body [mm]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DriverTrack:
    """Motion of a driven body in one trial, projected on its prescribed motions.

    Attributes:
        coordinates: Coordinates relative to the first frame of the trial [m or rad], shape [frame_count, motion_count];
            NaN if the body was not captured.
        residual_mm: Distance between the recorded and the projected origin [mm], shape [captured_count].
        residual_rad: Angle between the recorded and the projected rotation [rad], shape [captured_count]; empty for a
            file without orientation.
        start_offset_mm: Distance of the first position from the published initial position [mm].
        points_mm: The origin, and two points of the body 100 mm from it, turned since the first frame, shape
            [frame_count, 9]; NaN if the body was not captured.
    """

    coordinates: FloatArray
    residual_mm: FloatArray
    residual_rad: FloatArray
    start_offset_mm: float
    points_mm: FloatArray


def point_names(experiment: Experiment) -> tuple[str, ...]:
    """Return the names of the coordinates of `trial_points`, as `cube.x` or `marker-3.x`."""
    points: Sequence[str] = experiment.recorded
    if not points and experiment.scene.markers is not None:
        count = len(experiment.scene.markers.positions_m)
        points = [f"marker-{number}" for number in range(count)]
    return coordinate_names(Observable.POSITION, recorded=points, markers=None)


def generalized_trajectory(points_mm: FloatArray, experiment: Experiment) -> FloatArray:
    """Return g(t) of the points of a trial, shape [frame_count, coordinate_count]; NaN for missing samples."""
    markers = experiment.scene.markers
    if experiment.recorded or markers is None:
        return points_mm
    markers_m = 1e-3 * points_mm.reshape(len(points_mm), -1, 3)
    return observe_markers(markers_m, markers, experiment.score.observable)


def reference_motion_mm(experiment: Experiment) -> FloatArray | None:
    """Return the displacement of `trial_points` in the reference of an experiment; None without one in mm.

    Coordinates that the reference does not have are NaN.
    """
    band = reference_band(experiment)
    if band is None or band.compared.unit != "mm":
        return None
    projection = band.compared.projection
    motion = displacements(band.compared.mean) @ np.linalg.pinv(projection).T
    motion[:, ~projection.any(axis=0)] = np.nan
    return motion


def trial_points(trial: Trial, experiment: Experiment) -> FloatArray:
    """Return the positions of the recorded bodies or markers of a trial over the frames of an experiment.

    Args:
        trial: The trial.
        experiment: Experiment of the trial.

    Returns:
        Positions [mm], shape [frame_count, 3 point_count]; NaN for missing samples. A trial may end early if the
        variant has no published frame count; its later frames are NaN.

    Raises:
        TrialError: The recording is missing, damaged, too short, or has a wrong initial position.
    """
    markers = experiment.scene.markers
    if experiment.recorded or markers is None:
        tracks = {name: trial.pose_track(name) for name in experiment.recorded}
        check_lengths({name: track.positions_mm for name, track in tracks.items()})
        for name, track in tracks.items():
            _check_start(name, track, experiment.scene.body(name).pose)
        values = np.hstack([track.positions_mm for track in tracks.values()])
    else:
        values = trial_markers_mm(trial, markers)
    needed = START_FRAMES
    if published_baselines(experiment.name):
        needed = experiment.frame_count
    if len(values) < needed:
        problem = f"it has {len(values)} frames"
        raise TrialError("(file)", problem, f"at least {needed} are needed")
    frames = np.full((experiment.frame_count, values.shape[1]), np.nan)
    frames[: len(values)] = values[: experiment.frame_count]
    if np.isnan(frames).all():
        problem = "no frame is complete"
        raise TrialError("(file)", problem, "expected samples")
    _check_apart(point_names(experiment), frames)
    return frames


def _check_apart(names: Sequence[str], points_mm: FloatArray) -> None:
    """Raise an error if two points are at the same place in a frame; for the arguments, see `trial_points`."""
    places_mm = points_mm.reshape(len(points_mm), -1, 3)
    first, second = np.triu_indices(places_mm.shape[1], 1)
    offsets_mm = np.abs(places_mm[:, first] - places_mm[:, second])
    same = np.argwhere((offsets_mm <= SAME_MM).all(axis=2))
    if len(same):
        frame, pair = same[0]
        owners = [name.rpartition(".")[0] for name in names[::3]]
        problem = f"it is at the place of {owners[first[pair]]} in frame {frame}"
        remedy = "write null for lost frames"
        raise TrialError(owners[second[pair]], problem, remedy)


def start_quaternions(trial: Trial, experiment: Experiment) -> FloatArray:
    """Return the orientations of the recorded bodies in the first frames of a trial.

    Returns:
        Unit quaternions x y z w, body to world, shape [START_FRAMES, body_count, 4]; NaN for missing orientations.
    """
    tracks = [trial.pose_track(name) for name in experiment.recorded]
    return np.stack([track.quaternions_xyzw[:START_FRAMES] for track in tracks], axis=1)


def _check_start(name: str, track: PoseTrack, start: Pose) -> None:
    captured = np.flatnonzero(~np.isnan(track.positions_mm).any(axis=1))
    if captured.size:
        place_mm = track.positions_mm[captured[0]]
        _check_place(name, place_mm, 1e3 * np.asarray(start.position_m))


def _check_place(name: str, place_mm: FloatArray, start_mm: FloatArray) -> None:
    """Raise an error if the first position is far from the published one."""
    distance_mm = length_of(place_mm - start_mm)
    if distance_mm > MAX_START_DISTANCE_MM:
        problem = f"it starts {distance_mm:.0f} mm from its published position"
        expected = f"expected at most {MAX_START_DISTANCE_MM:.0f} mm: check the motion-capture frame, axes and unit"
        raise TrialError(name, problem, expected)


# --- markers ---------------------------------------------------------------------------------------------------------


def trial_markers_mm(trial: Trial, markers: Markers) -> FloatArray:
    """Return the marker positions of a trial in the order of the task file.

    Returns:
        Positions [mm], shape [recorded_frame_count, 3 marker_count]; NaN for missing markers.

    Raises:
        TrialError: Markers are missing, damaged, or in a wrong order.
    """
    positions = trial.markers_mm(markers.bodies)
    count = len(markers.positions_m)
    if len(positions) != count:
        problem = f"it has {len(positions)} markers"
        raise TrialError("markers", problem, f"expected {count}")
    ids = sorted(positions)
    if all(marker.isdecimal() for marker in ids):
        ids.sort(key=int)
    positions_mm = np.stack([positions[marker] for marker in ids], axis=1)
    # A marker with a missing coordinate counts as missing.
    positions_mm[np.isnan(positions_mm).any(axis=2)] = np.nan
    _check_order(ids, positions_mm, 1e3 * np.asarray(markers.positions_m))
    return positions_mm.reshape(len(positions_mm), -1)


def _size(places_mm: FloatArray) -> float:
    """Return the root mean square distance of places, shape [N, 3], from their centre [mm]."""
    return length_of(places_mm - places_mm.mean(axis=0)) / len(places_mm) ** 0.5


def _check_order(
    ids: Sequence[str], positions_mm: FloatArray, rest_mm: FloatArray
) -> None:
    """Raise an error if the markers start at wrong positions or in a wrong order.

    Args:
        ids: Marker ids in the order of the metadata.
        positions_mm: Positions of the markers, shape [frame_count, marker_count, 3].
        rest_mm: Published positions, shape [marker_count, 3].
    """
    captured = np.asarray(~np.isnan(positions_mm).any(axis=2))
    seen = np.flatnonzero(captured.any(axis=0))
    if not seen.size:
        return
    starts_mm = positions_mm[captured[:, seen].argmax(axis=0), seen]
    _check_place("markers", starts_mm.mean(axis=0), rest_mm[seen].mean(axis=0))
    size, expected = map(_size, (starts_mm, rest_mm[seen]))
    if max(size, expected) > MAX_SIZE_RATIO * min(size, expected):
        problem = f"they are {size:.3g} mm from their centre at the start, and {expected:.3g} mm in the metadata"
        raise TrialError("markers", problem, "check the unit and the markers")
    nearest = cdist(starts_mm, rest_mm[seen]).argmin(axis=1)
    places = np.arange(seen.size)
    if np.array_equal(np.sort(nearest), places) and (nearest != places).any():
        wrong = int(np.argmax(nearest != places))
        raise TrialError(
            f"markers.{ids[seen[wrong]]}",
            f"it starts at marker {seen[nearest[wrong]]} of the metadata, not at marker {seen[wrong]}",
            "expected sorted ids in the order of the metadata's markers",
        )


# --- drivers ---------------------------------------------------------------------------------------------------------


def driver_track(driver: Driver, trial: Trial, experiment: Experiment) -> DriverTrack:
    """Return the coordinates with the poses nearest to the recorded poses, frame by frame.

    Raises:
        TrialError: The driven body is missing, damaged, at a wrong initial position, or not captured in frame 0.
    """
    track = trial.pose_track(driver.body)
    start = experiment.scene.body(driver.body).pose
    frame_count = experiment.frame_count
    _check_start(driver.body, track, start)
    positions_m = 1e-3 * track.positions_mm[:frame_count]
    quaternions = track.quaternions_xyzw[:frame_count]
    has_rotation = bool(np.isfinite(quaternions).any())
    if not has_rotation and any(motion.kind == "rotate" for motion in driver.motions):
        expected = "a prescribed rotation needs qx, qy, qz and qw"
        raise TrialError(f"{driver.body}.qx", "it is missing", expected)
    samples = np.hstack([positions_m, quaternions]) if has_rotation else positions_m
    known = np.flatnonzero(np.isfinite(samples).all(axis=1))
    if not (known < START_FRAMES).any():
        expected = "a prescribed motion is measured from its start"
        problem = f"the first {START_FRAMES} frames were not captured"
        raise TrialError(f"{driver.body}[0]", problem, expected)
    first_m = positions_m[known[0]]
    rotations = Rotation.identity(len(known))
    if has_rotation:
        rotations = Rotation.from_quat(quaternions[known])
    # The axis of a motion belongs to the body, so it moves with the initial offset of the trial.
    offset_m = first_m - start.position_m
    motions = [
        replace(motion, point_m=tuple((motion.point_m + offset_m).tolist()))
        for motion in driver.motions
    ]
    turned = rotations * rotations[0].inv()
    values, missed_m, missed_rad = motion_coordinates(
        motions, first_m, positions_m[known], turned
    )
    coordinates = np.full((frame_count, len(motions)), np.nan)
    coordinates[known] = values
    points_mm = np.full((frame_count, 9), np.nan)
    levers_mm = [turned.apply(lever_mm) for lever_mm in LEVERS_MM]
    points_mm[known] = np.hstack([1e3 * positions_m[known], *levers_mm])
    return DriverTrack(
        coordinates=coordinates,
        residual_mm=1e3 * missed_m,
        residual_rad=missed_rad if has_rotation else np.empty(0),
        start_offset_mm=1e3 * length_of(offset_m),
        points_mm=points_mm,
    )
