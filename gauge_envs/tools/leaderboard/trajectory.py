"""Trajectory of a result: whether a simulation can give it, and the scores that it has.

A simulation has the grid, the start and the speeds of the scene, and is no copy of reality. Scores are computed anew,
beside those that the file states.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from gauge_envs.envs.episode import LATER_FRAMES
from gauge_envs.errors import GaugeError
from gauge_envs.evaluation.deviation import band_baseline
from gauge_envs.evaluation.metrics.trajectory import trajectory_rmse
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.score import VERIFICATION, Score, score_trajectory
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import json_ready, versions
from gauge_envs.observables.kinds import Observable
from gauge_envs.observables.observer import observe_markers
from gauge_envs.references.bands import Band
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.user_data import BUNDLED_DATA
from gauge_envs.runs.result import (
    MARKER_DECIMALS,
    Outcome,
    RecordedTrajectory,
    Result,
)
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME

FloatArray = NDArray[np.float64]
Found = tuple[str, str]

TIME_TOLERANCE_S = 1e-9
"""Rounding of the times of samples [s]."""

START_TOLERANCE = {"mm": 0.01, "mm^2": 0.01, "rad": 1e-6}
"""Largest difference of g(0) from the scene's start, by unit. Single precision rounds positions near 1 m to 6e-5 mm;
MuJoCo, Newton, PyBullet and Rapier start within 3e-5 mm and 3e-4 mm^2 in all experiments that they run."""

COPY_OF_BASELINE = 0.01
"""A trajectory closer to a real one than this share of the distance of real trials from their mean is a copy."""

COPY_OF_MOTION = 1e-3
"""It must also be closer than this share of the motion: a body that rests is at a place that an engine can know."""

SCORE_TOLERANCE = 1e-6
"""Largest difference of a stated score, relative and absolute. Last digits depend on the processor, and the fit of the
release time ends within 1e-7 s. No table shows so many digits."""

MARKER_TOLERANCE_MM = 10.0**-MARKER_DECIMALS
"""Largest difference of a distance of markers [mm]. A file rounds each coordinate by at most half of it, and so the
distance by at most sqrt(3) / 2 of it (triangle inequality)."""

WRITTEN_ANEW = ("budget", "explained", "sensitivities")
"""Keys that are written anew without a comparison, as all intervals `*_95`: they depend on sensitivities that
`gauge run --uncertainty` measures and stores on another machine."""


def start_values(experiment: Experiment) -> FloatArray:
    """Return g(0) of an experiment from its scene alone, without an engine, shape [coordinate_count]."""
    scene, observable = experiment.scene, experiment.score.observable
    if observable is Observable.POSITION:
        return 1e3 * np.concatenate(
            [scene.body(name).pose.position_m for name in experiment.recorded]
        )
    assert scene.markers is not None
    return observe_markers(
        np.asarray(scene.markers.positions_m)[None], scene.markers, observable
    )[0]


def trajectory_faults(result: Result, experiment: Experiment) -> Iterator[Found]:
    """Yield key and reason of each thing that no episode of an experiment can give.

    Args:
        result: A result with a trajectory.
        experiment: Its experiment.
    """
    trajectory = result.trajectory
    if trajectory is None:
        yield "trajectory", "is missing: the score is computed from it"
        return
    shape = list(_shape_faults(result, trajectory, experiment))
    yield from shape
    if shape:
        return
    times_s, samples = trajectory.arrays(later=True)
    grid_s = SAMPLE_INTERVAL_S * np.arange(len(times_s))
    wrong = np.abs(times_s - grid_s) > TIME_TOLERANCE_S
    if wrong.any():
        number = int(wrong.argmax())
        yield (
            "trajectory.times_s",
            f"sample {number} is at {times_s[number]:.9g} s, expected {grid_s[number]:.9g} s",
        )
    finite = np.isfinite(samples).all(axis=1)
    if result.outcome is Outcome.FINISHED and not finite.all():
        yield (
            "trajectory.samples",
            f"sample {int((~finite).argmax())} holds a value that is not finite",
        )
        return
    yield from _start_faults(samples[0], trajectory, experiment)
    yield from _speed_faults(samples, experiment)
    if result.outcome is Outcome.FINISHED:
        copied = copied_reference(samples, experiment)
        if copied is not None:
            yield "trajectory.samples", copied


def _shape_faults(
    result: Result, trajectory: RecordedTrajectory, experiment: Experiment
) -> Iterator[Found]:
    unit = experiment.score.observable.unit
    if trajectory.unit != unit:
        yield "trajectory.unit", f"is {trajectory.unit!r}, expected {unit!r}"
    if trajectory.coordinates != list(experiment.coordinates):
        yield (
            "trajectory.coordinates",
            f"are {_few(trajectory.coordinates)}, expected {_few(experiment.coordinates)}",
        )
    if result.diverged != (result.outcome is Outcome.DIVERGED):
        yield (
            "diverged",
            f"is {result.diverged} with the outcome {result.outcome.value!r}",
        )
    needed = experiment.frame_count
    if result.outcome is Outcome.FINISHED and result.frames != needed:
        yield "frames", f"is {result.frames}, expected {needed}"
    elif not 1 <= result.frames <= needed:
        yield "frames", f"is {result.frames}, expected 1 to {needed}"
    count = (result.frames - 1) * SAMPLES_PER_FRAME + 1
    if len(trajectory.times_s) != count:
        reason = f"has {len(trajectory.times_s)} samples, expected {count}: 180 a second for {result.frames} frames"
        yield "trajectory.times_s", reason
    if len(trajectory.later_times_s) > LATER_FRAMES * SAMPLES_PER_FRAME:
        yield (
            "trajectory.later_times_s",
            f"has {len(trajectory.later_times_s)} samples, expected at most 60",
        )
    seconds = (result.frames - 1) / FRAME_RATE_HZ
    if abs(result.sim_s - seconds) > TIME_TOLERANCE_S:
        yield (
            "sim_s",
            f"is {result.sim_s:.9g}, expected {seconds:.9g} for {result.frames} frames",
        )


def _few(names: Sequence[str]) -> str:
    return f"{', '.join(names[:3])}{', ...' if len(names) > 3 else ''} ({len(names)})"


def _start_faults(
    first: FloatArray, trajectory: RecordedTrajectory, experiment: Experiment
) -> Iterator[Found]:
    expected = start_values(experiment)
    apart = np.abs(np.nan_to_num(first, nan=np.inf) - expected)
    allowed = START_TOLERANCE[trajectory.unit]
    if apart.max() > allowed:
        worst = int(apart.argmax())
        yield (
            "trajectory.samples",
            f"{trajectory.coordinates[worst]} starts at {first[worst]:.6g} {trajectory.unit}, expected the calibrated "
            f"start {expected[worst]:.6g} within {allowed:g}",
        )


def _speed_faults(samples: FloatArray, experiment: Experiment) -> Iterator[Found]:
    """Yield a fault for a point that moves between two samples faster than anything in the scene can."""
    if experiment.score.observable.unit != "mm":
        return
    points = 1e-3 * samples.reshape(len(samples), -1, 3)
    with np.errstate(invalid="ignore"):
        speeds = (
            np.abs(np.diff(points, axis=0)).max(axis=2, initial=0.0) / SAMPLE_INTERVAL_S
        )
    limit = experiment.scene.speed_limit_m_per_s
    fast = np.nan_to_num(speeds) > limit
    if fast.any():
        sample, point = (int(index) for index in np.argwhere(fast)[0])
        name = experiment.coordinates[3 * point].rpartition(".")[0]
        yield (
            "trajectory.samples",
            f"{name} moves at {speeds[sample, point]:.3g} m/s after sample {sample}, "
            f"above the limit of the scene, {limit:.3g} m/s",
        )


def copied_reference(samples: FloatArray, experiment: Experiment) -> str | None:
    """Return why a trajectory is a copy of the real mean or of a real trial, or None.

    An aligned score reads the samples between the frames, so each of their phases is compared, with a spline through
    the real frames. Laws and models are left out: an exact engine follows them within rounding.

    Args:
        samples: g(t), `SAMPLES_PER_FRAME` in a frame, shape [sample_count, coordinate_count].
        experiment: The experiment.
    """
    band = reference_band(experiment, use_withheld=True)
    if band is None or not band.grade.is_real:
        return None
    simulated = band.project(samples)
    for name, real in _real_trajectories(band):
        known = np.flatnonzero(np.isfinite(real).all(axis=1))
        if len(known) < 4:
            continue
        path = CubicSpline(known, real[known], extrapolate=False)
        nearness = [
            _nearness(
                ours,
                path(phase / SAMPLES_PER_FRAME + np.arange(len(ours))),
                experiment,
                band,
            )
            for phase in range(SAMPLES_PER_FRAME)
            for ours in [simulated[phase::SAMPLES_PER_FRAME]]
        ]
        distance, allowed = min(nearness, key=lambda pair: pair[0] - pair[1])
        if distance < allowed:
            return (
                f"follows {name} within {distance:.3g} {band.unit}, closer than an engine can ({allowed:.3g}): "
                "a simulation is expected, and this is a copy of the reference or a fit to it"
            )
    return None


def _real_trajectories(band: Band) -> Iterator[tuple[str, FloatArray]]:
    yield "the real mean", band.mean
    for number, trial in enumerate(() if band.trials is None else band.trials):
        yield f"real trial {number}", trial


def _nearness(
    simulated: FloatArray, real: FloatArray, experiment: Experiment, band: Band
) -> tuple[float, float]:
    """Return the distance of a trajectory from a real one, without a constant offset, and that of a copy."""
    count = min(len(simulated), len(real))
    seen = np.isfinite(real[:count]).all(axis=1)
    if seen.sum() < 2:
        return np.inf, 0.0
    known, ours = real[:count][seen], simulated[:count][seen]
    allowed = COPY_OF_MOTION * trajectory_rmse(
        known, np.broadcast_to(known[0], known.shape)
    )
    baseline = band_baseline(experiment, band)
    if baseline is not None:
        allowed = min(allowed, COPY_OF_BASELINE * baseline.mean)
    apart = ours - known
    return trajectory_rmse(
        apart, np.broadcast_to(apart.mean(axis=0), apart.shape)
    ), allowed


def rescored(result: Result, experiment: Experiment) -> Result:
    """Return a result with the score of its trajectory, and without what the trajectory does not prove.

    Wall times and statistics of deformation are left out: g(t) holds neither.

    Args:
        result: A result whose trajectory has no faults.
        experiment: Its experiment.
    """
    band = reference_band(experiment)
    if result.outcome is Outcome.FINISHED and result.trajectory is not None:
        times_s, values = result.trajectory.arrays(later=True)
        backend = None if result.settings_given else result.backend
        score = score_trajectory(
            experiment,
            band,
            times_s=times_s,
            values=values,
            markers_m=result.trajectory.markers_m(),
            wrenches=result.trajectory.recorded_wrenches(),
            backend=backend,
            is_checked=True,
        )
    else:
        grade = BandGrade.NONE if band is None else band.grade
        score = Score(grade=grade.value, unit=experiment.score.observable.unit)
    return replace(result, score=score, wall_s=None, deformation=None)


def false_scores(result: Result) -> list[str]:
    """Return what a result of an engine states of its bundled experiment that its own trajectory does not give."""
    is_bundled = (
        result.dataset == BUNDLED_DATA
        and not result.asset
        and result.score.withheld is None
    )
    if (
        not is_bundled
        or result.backend is None
        or result.outcome is not Outcome.FINISHED
    ):
        return []
    try:
        computed = rescored(result, recorded_experiment(result))
    except GaugeError as error:
        return [str(error)]
    return [
        f"{key}: {reason}" for key, reason in differing_scores(result, computed.score)
    ]


def differing_scores(result: Result, computed: Score) -> Iterator[tuple[str, str]]:
    """Yield key and reason of each score that a file states and its trajectory does not give.

    Scores of another version of this package, which may have other definitions, are not compared.
    """
    if result.versions.get("gauge-envs") != versions()["gauge-envs"]:
        return
    ours: dict[str, Any] = json_ready(computed.to_dict())
    theirs: dict[str, Any] = json_ready(result.score.to_dict())
    for key, value in ours.items():
        if key in WRITTEN_ANEW or key.endswith("_95"):
            continue
        # Files of earlier versions have no distance from a solution.
        if key == VERIFICATION and theirs[key] is None:
            continue
        has_markers = result.trajectory is not None and result.trajectory.markers_mm
        tolerance = (
            MARKER_TOLERANCE_MM
            if key == VERIFICATION and has_markers
            else SCORE_TOLERANCE
        )
        for place, said, given in _differences(
            f"score.{key}", theirs[key], value, tolerance
        ):
            yield (
                place,
                f"the file states {_text(said)}, its trajectory gives {_text(given)}",
            )


def _differences(
    place: str, said: Any, given: Any, tolerance: float
) -> Iterator[tuple[str, Any, Any]]:
    """Yield place and both values of each difference in two JSON values, above a tolerance of numbers."""
    if (
        isinstance(said, dict)
        and isinstance(given, dict)
        and said.keys() == given.keys()
    ):
        for key in given:
            yield from _differences(f"{place}.{key}", said[key], given[key], tolerance)
    elif isinstance(said, list) and isinstance(given, list) and len(said) == len(given):
        for number, (one, other) in enumerate(zip(said, given, strict=True)):
            yield from _differences(f"{place}.{number}", one, other, tolerance)
    elif _are_numbers(said, given):
        if not math.isclose(said, given, rel_tol=SCORE_TOLERANCE, abs_tol=tolerance):
            yield place, said, given
    elif said != given:
        yield place, said, given


def _are_numbers(*values: Any) -> bool:
    return all(
        isinstance(value, int | float) and not isinstance(value, bool)
        for value in values
    )


def _text(value: Any) -> str:
    text = (
        "nothing"
        if value is None
        else f"{value:.9g}"
        if isinstance(value, float)
        else repr(value)
    )
    return text if len(text) <= 80 else f"{text[:77]}..."
