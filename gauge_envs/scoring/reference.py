"""The reference of an experiment, and the scenes that it cannot score."""

import re
from functools import lru_cache

import numpy as np

from gauge_envs.errors import ReferenceFileError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment, shots_of
from gauge_envs.references.band import Band, band_file, load_band
from gauge_envs.references.kind import Kind
from gauge_envs.references.single_shot import single_shots
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene import Scene
from gauge_envs.scene.diff import scene_changes
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.likely_mistakes import START_TOLERANCE_MM, start_values

GEOMETRY = re.compile(
    r": (added|removed|(pose|shape|size_m|length_m|radius_m|anchor_m|axis|gravity_m_per_s2)\b)"
)
"""Matches the lines of `scene_changes` about gravity, shapes and poses, which real trials cannot score."""


def reference_band(experiment: Experiment) -> Band | None:
    """Return the reference motion of an experiment; None if it has none.

    `reference_source` of the experiment selects the bundled reference or the imported trials. Rewards compare with the
    same motion, even if `refusal` says that the reference cannot score the scene.
    """
    shots = shots_of(experiment)
    if shots is not None and experiment.trial is not None:
        return shots.band(experiment.trial, experiment.frame_count)
    file = band_file(experiment.name, experiment.reference_source)
    band = load_band(experiment.name, experiment.reference_source)
    if file is None or band is None:
        return None
    shape = (len(band.mean), band.projection.shape[1])
    expected_shape = (
        experiment.spec.frame_count(experiment.variant),
        len(experiment.coordinates),
    )
    if shape != expected_shape:
        raise ReferenceFileError(
            file,
            None,
            f"its frames and coordinates of g(t) are {shape}, but those of {experiment.name} are {expected_shape}",
        )
    return band if experiment.trial is None else band.of_trial(experiment.trial)


def refusal(
    experiment: Experiment, band: Band | None, *, is_moved: bool = False
) -> str | None:
    """Return why a reference cannot score a scene, one sentence; None if it can.

    Real trials score scenes with their gravity and geometry, and with any constants. A solution scores only the
    calibrated scene and start: for another scene, the distance would also hold the effect of the change.

    Args:
        experiment: The experiment.
        band: Its reference.
        is_moved: Whether the initial state of the episode had noise.
    """
    if band is None:
        return None
    if band.kind.is_solution and is_moved:
        return f"no score: the {band.kind} reference holds for the nominal start, and this start had noise"
    changes = _changes(experiment)
    if band.kind.is_real:
        changes = _of_geometry(experiment, changes)
    if not changes:
        return None
    scored = "real scene" if band.kind.is_real else "calibrated scene"
    more = f", and {len(changes) - 1} more" if len(changes) > 1 else ""
    return f"no score: the {band.kind} reference holds for the {scored}, and this scene differs: {changes[0]}{more}"


def has_real_geometry(experiment: Experiment) -> bool:
    """Return whether gravity, shapes and poses equal those of the real scene, so that real events compare."""
    return not _of_geometry(experiment, _changes(experiment))


def _changes(experiment: Experiment) -> list[str]:
    """Return the differences from the calibrated scene, a line each; driven motion of actions does not count."""
    calibrated = _calibrated_scene(experiment.name, experiment.file_sha256)
    if experiment.scene == calibrated:
        return []
    changes = list(scene_changes(calibrated, experiment.scene))
    if experiment.drivers is DataSource.ACTION:
        changes = [change for change in changes if not change.startswith("driver of")]
    return changes


def _of_geometry(experiment: Experiment, changes: list[str]) -> list[str]:
    """Return the changes of gravity, shapes and poses that real trials cannot score.

    Parameter sets of the task file describe the real scene. Real starts scatter, so a start within
    `START_TOLERANCE_MM` is no change.
    """
    if experiment.parameters != "custom" and not experiment.edited:
        return []
    moving = {body.name for body in experiment.scene.dynamic_bodies}
    geometry = [change for change in changes if GEOMETRY.search(change)]
    start_changes = [
        change for change in geometry if change.partition(": pose")[0] in moving
    ]
    calibrated = _calibrated_start(experiment.name, experiment.file_sha256)
    deviation = np.abs(start_values(experiment) - calibrated)
    is_position = experiment.score.observable.unit == "mm"
    if not is_position or deviation.max() <= START_TOLERANCE_MM:
        geometry = [change for change in geometry if change not in start_changes]
    return geometry


@lru_cache(maxsize=128)
def _calibrated_start(variant: str, file_sha256: str) -> FloatArray:
    """Return g(t) at the start in the task file, shape [coordinate_count]."""
    return start_values(load_experiment(variant))


@lru_cache(maxsize=128)
def _calibrated_scene(variant: str, file_sha256: str) -> Scene:
    """Return the calibrated scene of a variant; the hash of the task file distinguishes versions in the cache."""
    return load_experiment(variant).scene


def reference_kind(variant: str, source: DataSource = DataSource.BUNDLED) -> Kind:
    """Return the kind of the reference of a variant."""
    if single_shots(variant) is not None:
        return Kind.TRIALS
    band = load_band(variant, source)
    return Kind.NONE if band is None else band.kind
