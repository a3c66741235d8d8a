"""Score trajectory files of users."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from gauge_envs.errors import TrajectoryFileError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment, shots_of, with_trial
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.variants import find_variant, recorded_variant
from gauge_envs.files import json_ready
from gauge_envs.reading import faults_of
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.references.user_data import DataSource
from gauge_envs.runs.result import Outcome, RecordedTrajectory, Result
from gauge_envs.runs.result_file import load_result, recorded_experiment, result_of
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.answers import Answer
from gauge_envs.scoring.metrics import MAX_TIME_OFFSET_S, frame_index
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.trajectory import score_trajectory
from gauge_envs.scoring.user_file.likely_mistakes import (
    START_TOLERANCE_MM,
    marker_mistake,
    start_values,
    value_mistake,
)
from gauge_envs.scoring.user_file.motion_checks import start_across, unusual_motion
from gauge_envs.scoring.user_file.trajectory_file import (
    FileOrigin,
    UserTrajectory,
    file_origin,
    read_trajectory,
)

MAX_SIGMAS = 6.0
"""Largest deviation of the start of a trajectory, in standard deviations of its noise."""

UNKNOWN_CONSTANTS = (
    "the file does not state its constants: state them to know whether its simulator "
    "solves the scene, as --parameter cube.friction=0.3"
)

LEVER_M = 1.0
"""Largest distance of a recorded point from the axis of a rotation by noise, in any experiment [m]."""


def score_file(
    file: Path,
    *,
    variant: str | None = None,
    parameters: Parameters | None = None,
    reference: DataSource | str = DataSource.BUNDLED,
) -> tuple[Result, tuple[str, ...]]:
    """Score a trajectory file of a user's own simulator; see `scoring.user_file.trajectory_file` for the formats.

    Args:
        file: CSV, NPZ or JSON file.
        variant: Name or id of the experiment, or a task file; None takes that of a JSON file.
        parameters: Parameters of the scene; None takes those of the file, or `published`.
        reference: `bundled` scores against the package's references, `imported` against the imported trials.

    Returns:
        The result, and notes on interpolated frames, a cropped rest, and unusual motion.
    """
    origin = file_origin(file)
    experiment = _experiment_of_file(file, origin, variant, parameters, reference)
    trajectory = read_trajectory(file, experiment)
    experiment = _with_its_trial(experiment, origin, trajectory.values[0])
    band = reference_band(experiment)
    index = frame_index(
        trajectory.times_s, experiment.frame_count, name=experiment.name
    )
    frames = trajectory.values[index]
    mistake = value_mistake(
        experiment,
        frames,
        tolerance_mm=START_TOLERANCE_MM + _jitter_mm(origin),
    )
    if mistake is None and trajectory.markers_m is not None:
        mistake = marker_mistake(experiment, trajectory.markers_m)
        mistake = mistake and f"markers_m: {mistake}"
    if mistake is not None:
        raise TrajectoryFileError(f"{file}: {mistake}")
    unusual = [] if band is None else [*unusual_motion(experiment, band, frames)]
    if trajectory.likely_rate_hz is not None:
        unusual.append(
            f"without time_s, rows are at 30 Hz; this motion follows the reference at {trajectory.likely_rate_hz} Hz"
        )
    score = score_trajectory(
        experiment,
        band,
        times_s=trajectory.times_s,
        values=trajectory.values,
        markers_m=trajectory.markers_m,
        is_moved=bool(origin.jitter) and experiment.trial is None,
        is_checked=True,
    )
    offset_s = score.time_offset_s or 0.0
    if abs(offset_s) > MAX_TIME_OFFSET_S - 1e-6:
        unusual.append(
            f"the time offset {offset_s:+.3f} s is a limit of its search, not an estimate"
        )
    if unusual:
        score = replace(score, estimates={})
    unknown: list[str] = []
    if origin.parameters is None and parameters is None:
        # The simulator of the file may have other constants than the exact motion.
        score = replace(score, exact=None, cause=None)
        is_other = score.solves is Answer.NO and not Kind(score.kind).is_solution
        if is_other:
            score = replace(score, solves=Answer.CANNOT_TELL)
            unknown = [UNKNOWN_CONSTANTS]
    result = result_of(
        experiment,
        outcome=Outcome.FINISHED,
        parameters=json_ready(experiment.overrides)
        if experiment.parameters == "custom"
        else experiment.parameters,
        score=score,
        frames=experiment.frame_count,
        sim_s=(experiment.frame_count - 1) / FRAME_RATE_HZ,
        jitter={} if experiment.trial is None else {"trial": experiment.trial},
        trajectory=RecordedTrajectory.of(
            experiment,
            trajectory.times_s,
            trajectory.values,
            markers_m=trajectory.markers_m,
        ),
    )
    notes = _notes(experiment, band, origin, trajectory, frames)
    return result, (*unusual, *unknown, *notes)


def _notes(
    experiment: Experiment,
    band: Band | None,
    origin: FileOrigin,
    trajectory: UserTrajectory,
    frames: FloatArray,
) -> Iterator[str]:
    """Yield what was changed in a file, and a start beside that of the scene; `frames` are g(t), shape [T, C]."""
    if trajectory.interpolated_frames:
        count = trajectory.interpolated_frames
        yield f"{count} of {len(frames)} frames have no sample: interpolated linearly"
    if trajectory.rest_s:
        yield f"the first {trajectory.rest_s:.3g} s are at rest: cropped, so time 0 is the release"
    if band is None or origin.jitter:
        return
    across = start_across(experiment, band, frames[0])
    if across is not None:
        yield across


def _with_its_trial(
    experiment: Experiment, origin: FileOrigin, start: FloatArray
) -> Experiment:
    """Return an experiment with the single-trial recording in the file, or else the one with the nearest start.

    Args:
        experiment: The experiment.
        origin: Origin in the file.
        start: g(t) of the first frame, shape [coordinate_count].
    """
    shots = shots_of(experiment)
    if shots is None:
        return experiment
    trial_number = origin.jitter.get("trial")
    trials = shots.trials() if trial_number is None else (int(trial_number),)
    candidates = [with_trial(experiment, trial) for trial in trials]
    return min(
        candidates, key=lambda candidate: length_of(start_values(candidate) - start)
    )


def _jitter_mm(origin: FileOrigin) -> float:
    """Return the largest displacement of a point by the noise in a file [mm]."""
    position_m = origin.jitter.get("position_m", 0.0)
    angle_rad = origin.jitter.get("angle_rad", 0.0)
    return MAX_SIGMAS * 1e3 * (position_m + LEVER_M * angle_rad)


def _experiment_of_file(
    file: Path,
    origin: FileOrigin,
    variant: str | None,
    parameters: Parameters | None,
    reference: DataSource | str,
) -> Experiment:
    """Return the experiment of the arguments, or else of the file."""
    if origin.asset and variant is None and parameters is None:
        result = load_result(file)
        if result.is_edited and "scene" not in result.asset:
            raise TrajectoryFileError(
                f"{file}: the result lacks its scene, which was the edited file {result.asset['file']}: run it again "
                "with --asset to score it"
            )
        with faults_of(file, TrajectoryFileError):
            return recorded_experiment(result)
    name = variant or origin.id
    if name is None:
        raise TrajectoryFileError(
            f"{file}: the file has no id. Give one, as --id GAUGE/SlopeSlider-2-wood."
        )
    if parameters is None:
        known = isinstance(origin.parameters, str | dict) and not origin.asset
        parameters = origin.parameters if known else "published"
    if origin.id is None:
        return load_experiment(name, parameters, reference=reference)
    with faults_of(file, TrajectoryFileError):
        if variant is None:
            recorded_variant(origin.id, origin.task_file)
        experiment = load_experiment(name, parameters, reference=reference)
        file_id = origin.id if origin.asset else find_variant(origin.id).id
        if file_id != experiment.id:
            raise ValueError(
                f"the id in the file is {origin.id!r}, not {experiment.id}"
            )
        return experiment
