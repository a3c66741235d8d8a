"""Choose the band that an experiment is scored against."""

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment, shots_of
from gauge_envs.references.bands import Band, bundled_band
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.grips import GripLoad, solved_loads
from gauge_envs.references.imported import load_imported
from gauge_envs.references.models import solved_model
from gauge_envs.references.published import (
    CarriedLaw,
    UniaxialLaw,
    carried_band,
    law_for,
    uncontacted_band,
)
from gauge_envs.references.single_shot import single_shots
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray, rotation_matrices
from gauge_envs.scene.timing import FRAME_RATE_HZ


def reference_band(
    experiment: Experiment, *, use_withheld: bool = False
) -> Band | None:
    """Return the band that an experiment is scored against: its trial or measured band, that of a law, or a model's.

    A model is the solution of the calibrated scene alone: other parameters, imported drivers or an asset have none.
    Actions that move the driven bodies are judged by the recorded motion.
    `reference_source` of the experiment selects the bundled band or that of the imported trials.

    Args:
        experiment: The experiment.
        use_withheld: Use a band that is withheld by default; `Band.withheld` gives the reason.

    Returns:
        The band; None if the experiment has neither.
    """
    if experiment.reference is not None:
        return experiment.reference.band
    shots = shots_of(experiment)
    if shots is not None and experiment.trial is not None:
        return shots.band(experiment.trial, experiment.frame_count)
    band = load_band(experiment.name, experiment.reference_source)
    if band is not None and (use_withheld or band.withheld is None):
        return band if experiment.trial is None else band.of_trial(experiment.trial)
    law = law_for(experiment.name)
    if law is None:
        solved = solved_model(experiment.name) if _is_calibrated(experiment) else None
        return None if solved is None else solved.band
    # An asset or actions change the simulated scene. The law holds for the calibrated one.
    is_changed = experiment.asset is not None or experiment.drivers is DataSource.ACTION
    calibrated = (
        load_experiment(experiment.name).scene if is_changed else experiment.scene
    )
    if isinstance(law, CarriedLaw):
        positions_mm = _carried_positions_mm(
            calibrated, law.body, law.carrier, experiment.frame_count
        )
        return carried_band(variant=experiment.name, positions_mm=positions_mm)
    if isinstance(law, UniaxialLaw):
        from gauge_envs.scoring.laws import bar_band

        return bar_band(
            law, calibrated, variant=experiment.name, frame_count=experiment.frame_count
        )
    from gauge_envs.scoring.laws import law_motion

    # Parameters change friction, restitution and start, on which these laws depend.
    scene = (
        calibrated
        if not experiment.overrides
        else load_experiment(experiment.name).scene
    )
    positions_mm, uncertainty_mm = law_motion(
        law, scene, variant=experiment.name, frame_count=experiment.frame_count
    )
    return uncontacted_band(
        law, positions_mm=positions_mm, uncertainty_mm=uncertainty_mm
    )


def reference_loads(experiment: Experiment, band: Band | None) -> tuple[GripLoad, ...]:
    """Return the loads of rods and grips that an experiment is verified by, beside its band.

    Args:
        experiment: The experiment.
        band: Band that its scores are relative to.
    """
    is_solved = band is not None and band.grade.is_solution
    if not is_solved or experiment.reference is not None:
        return ()
    return solved_loads(experiment.name) if _is_calibrated(experiment) else ()


def _is_calibrated(experiment: Experiment) -> bool:
    """Return whether the scene is the one that models were solved for."""
    return not (
        experiment.edited
        or experiment.overrides
        or experiment.drivers is DataSource.IMPORTED
    )


def _carried_positions_mm(
    scene: Scene, body: str, carrier: str, frame_count: int
) -> FloatArray:
    """Return the positions [mm] of a body that keeps its place on a carrier, shape [frame_count, 3]."""
    start = scene.body(carrier).pose
    place = start.to_body(np.asarray(scene.body(body).pose.position_m))
    poses = np.tile([*start.position_m, *start.quaternion], (frame_count, 1))
    times_s = np.arange(frame_count) / FRAME_RATE_HZ
    for driver in scene.drivers:
        if driver.body == carrier:
            poses = driver.path(start, times_s)
    turned_m = rotation_matrices(poses[:, 3:7]) @ place
    return 1e3 * (poses[:, :3] + turned_m)


def load_band(variant: str, source: DataSource = DataSource.BUNDLED) -> Band | None:
    """Return the band of a variant, or None.

    Args:
        variant: Name of the variant.
        source: `bundled`, or `imported` for the band of the imported trials.
    """
    if source is DataSource.BUNDLED:
        return bundled_band(variant)
    imported = load_imported(variant)
    return None if imported is None else imported.band


def grade_of(experiment: Experiment) -> BandGrade:
    """Return the grade of what an experiment is scored against, as `info` of its environment."""
    band = reference_band(experiment)
    return BandGrade.NONE if band is None else band.grade


def band_grade(variant: str, source: DataSource = DataSource.BUNDLED) -> BandGrade:
    """Return the grade of the band that a variant is scored against; a withheld band does not count."""
    if single_shots(variant) is not None:
        return BandGrade.TRIALS
    band = load_band(variant, source)
    if band is not None and band.withheld is None:
        return band.grade
    if law_for(variant) is not None:
        return BandGrade.LAW
    return BandGrade.NONE if solved_model(variant) is None else BandGrade.MODEL
