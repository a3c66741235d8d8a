"""The reference of an experiment, and the scenes that it cannot score."""

from collections.abc import Collection
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from gauge_envs.errors import ReferenceFileError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment, shots_of, with_trial
from gauge_envs.references.band import Band, band_file, load_band, read_band_file
from gauge_envs.references.kind import Kind
from gauge_envs.references.single_shot import single_shots
from gauge_envs.references.tables import scoring_folder
from gauge_envs.references.user_data import DataSource, own_band_file
from gauge_envs.scene import Box, Cloth, Deformable, RigidBody, Scene, Shape
from gauge_envs.scene.diff import Change, ChangeKind, scene_changes
from gauge_envs.scene.geometry import Vector
from gauge_envs.scene.states import nominal_states, scene_at
from gauge_envs.scoring.user_file.gate import band_fault
from gauge_envs.scoring.user_file.likely_mistakes import START_TOLERANCE_MM

SOLUTION_ALLOWS = frozenset({ChangeKind.SETTING, ChangeKind.LABEL})
"""Changes with which a solution of the scene of the task file still scores a scene."""

REAL_ALLOWS = SOLUTION_ALLOWS | {ChangeKind.CONSTANT, ChangeKind.START}
"""Changes with which real trials still score a scene; a start only near theirs, because real starts scatter."""

MAX_GRAVITY_CHANGE = 1e-3
"""Largest relative change of gravity with which each reference still scores a scene.

Accelerations under gravity change by the same share. The rounded 9.81 m/s^2 of many simulators, MuJoCo among them,
is 0.034 % larger than standard gravity, so a body that falls 1 m is 0.34 mm further.
"""

GRAVITY_FIELDS = (("gravity_m_per_s2",), ("gravity",))
"""Fields of gravity: of a scene, and of the options of an MJCF file."""


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
    shape = len(band.mean), band.projection.shape[1]
    frame_count = experiment.spec.frame_count(experiment.variant)
    expected = frame_count, len(experiment.coordinates)
    if shape != expected:
        problem = f"its frames and coordinates of g(t) are {shape}, but those of {experiment.name} are {expected}"
        raise ReferenceFileError(file, None, problem)
    fault = _own_fault(band) if file == own_band_file(experiment.name) else None
    if fault is not None:
        raise ReferenceFileError(file.with_suffix(".npz"), None, str(fault))
    if experiment.trial is None or driven_trials_file(experiment) is None:
        return band
    return band.of_trial(experiment.trial)


def driven_trials_file(experiment: Experiment) -> Path | None:
    """Return the file of the bundled trials that an experiment can replay, or None.

    A replayed trial is the reference. A trial of an import only gives the start.
    """
    file = scoring_folder("trials") / f"{experiment.name}.toml"
    sources = (experiment.drivers, experiment.reference_source)
    is_other = experiment.edited or DataSource.IMPORTED in sources
    return None if is_other or not file.is_file() else file


_own_fault = lru_cache(maxsize=16)(band_fault)
"""The fault of a band of a user, found once for each version of its file."""


def refusal(
    experiment: Experiment, band: Band | None, *, is_moved: bool = False
) -> str | None:
    """Return why a reference cannot score a scene, one sentence; None if it can.

    Real trials, measured or published, score the scene in which they were recorded, with any constants (`REAL_ALLOWS`)
    and a start near theirs. A solution scores only the scene and the start of the task file: for another scene, the
    distance would also hold the effect of the change. Numerical settings of an engine may differ in both, and gravity
    by `MAX_GRAVITY_CHANGE`.

    Args:
        experiment: The experiment.
        band: Its reference.
        is_moved: Whether the initial state of the episode had noise.
    """
    if band is None:
        return None
    if band.kind.is_solution and is_moved:
        return f"no score: the {band.kind} reference holds for the nominal start, and this start had noise"
    scored, changes = "real scene", _real_changes(experiment)
    if band.kind.is_solution:
        solved = _nominal(experiment).scene
        scored = "scene of the task file"
        changes = _changes(solved, experiment, SOLUTION_ALLOWS)
    if not changes:
        return None
    more = f", and {len(changes) - 1} more" if len(changes) > 1 else ""
    return f"no score: the {band.kind} reference holds for the {scored}, and this scene differs: {changes[0]}{more}"


def has_real_structure(experiment: Experiment) -> bool:
    """Return whether only what `REAL_ALLOWS` differs from the real scene, so that real events compare."""
    return not _real_changes(experiment)


def _real_changes(experiment: Experiment) -> list[Change]:
    """Return the changes that real trials do not allow."""
    real, allowed = _real_scene(experiment), REAL_ALLOWS
    if not _starts_near(real, experiment.scene):
        allowed = REAL_ALLOWS - {ChangeKind.START}
    return _changes(real, experiment, allowed)


def _changes(
    before: Scene, experiment: Experiment, allowed: Collection[ChangeKind]
) -> list[Change]:
    """Return the forbidden changes between a scene and an experiment, and those in its MJCF file."""
    changes = [*scene_changes(before, experiment.scene)]
    if experiment.asset is not None and experiment.model_file is not None:
        changes += experiment.asset.changes
    return [change for change in changes if not _is_allowed(change, allowed)]


def _is_allowed(change: Change, kinds: Collection[ChangeKind]) -> bool:
    """Return whether a change is of an allowed kind, or of gravity by at most `MAX_GRAVITY_CHANGE`."""
    if change.field not in GRAVITY_FIELDS:
        return change.kind in kinds
    difference = np.linalg.norm(np.subtract(change.after, change.before))
    return bool(difference <= MAX_GRAVITY_CHANGE * np.linalg.norm(change.before))


def _real_scene(experiment: Experiment) -> Scene:
    """Return the scene of the real trials, with the measured start and prescribed motion of the episode.

    Each parameter set of the task file describes the real scene.
    """
    is_named = experiment.parameters != "custom"
    parameters = experiment.parameters if is_named else "published"
    nominal = _nominal(experiment, parameters)
    scene, trial = nominal.scene, experiment.trial
    if shots_of(experiment) is not None and trial is not None:
        return with_trial(nominal, trial).scene
    if trial is not None and not experiment.edited:
        scene = scene_at(scene, nominal_states(experiment.scene))
    if trial is not None or experiment.drivers is DataSource.IMPORTED:
        scene = replace(scene, drivers=experiment.scene.drivers)
    return scene


def _nominal(experiment: Experiment, parameters: str = "published") -> Experiment:
    """Return the experiment of the task file with a parameter set, moved by actions if the experiment is."""
    is_action = experiment.drivers is DataSource.ACTION
    drivers = DataSource.ACTION if is_action else DataSource.BUNDLED
    return _loaded(experiment.name, experiment.file_sha256, parameters, drivers)


@lru_cache(maxsize=128)
def _loaded(
    variant: str, file_sha256: str, parameters: str, drivers: DataSource
) -> Experiment:
    """Load an experiment; the hash of the task file distinguishes versions in the cache."""
    return load_experiment(variant, parameters, drivers=drivers)


def _starts_near(real: Scene, scene: Scene) -> bool:
    """Return whether each body that is free to move starts near that of the real trials, with its velocity."""
    real_bodies = {body.name: body for body in (*real.bodies, *real.deformables)}
    return all(
        _is_near(real_bodies[body.name], body)
        for body in (*scene.dynamic_bodies, *scene.deformables)
        if body.name in scene.free_cloths or isinstance(body, RigidBody)
        if body.name in real_bodies
    )


def _is_near(real: RigidBody | Deformable, body: RigidBody | Deformable) -> bool:
    """Return whether no corner of a body is further than `START_TOLERANCE_MM`, and its velocity is the real one."""
    if isinstance(body, Cloth):
        shape: Shape = Box(size_m=(*body.size_m, body.thickness_m))
    else:
        assert isinstance(body, RigidBody), "only a cloth or a rigid body can be free"
        shape = body.shape
    corners_m = shape.corners_m
    shifts_m = body.pose.to_world(corners_m) - real.pose.to_world(corners_m)
    is_there = 1e3 * np.linalg.norm(shifts_m, axis=1).max() <= START_TOLERANCE_MM
    velocities = _velocity(body), _velocity(real)
    return bool(is_there) and np.allclose(*velocities, rtol=1e-9, atol=1e-12)


def _velocity(body: RigidBody | Deformable) -> list[Vector]:
    """Return the start velocity [m/s] and the angular velocity [rad/s]; a deformable body starts at rest."""
    names = "linear_velocity_m_per_s", "angular_velocity_rad_per_s"
    return [getattr(body, name, (0.0, 0.0, 0.0)) for name in names]


def reference_kind(variant: str, source: DataSource = DataSource.BUNDLED) -> Kind:
    """Return the kind of the reference of a variant."""
    if single_shots(variant) is not None:
        return Kind.TRIALS
    file = band_file(variant, source)
    return Kind.NONE if file is None else Kind(read_band_file(file).kind)
