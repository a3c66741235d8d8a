"""The reference in pictures and pages: its positions in space, and a text."""

from dataclasses import dataclass

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.user_file.likely_mistakes import start_values


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferencePath:
    """Path of each point that the reference follows.

    Attributes:
        names: Names of the points: bodies, or `marker-3`.
        places_m: Positions at the 30 Hz frames [m], shape [frame_count, point_count, 3]; NaN if unknown.
        is_full: Whether all directions were measured; the other directions keep the start of the scene.
    """

    names: tuple[str, ...]
    places_m: FloatArray
    is_full: bool


def reference_path(experiment: Experiment, band: Band | None) -> ReferencePath | None:
    """Return the mean of a band as positions in space; None without a band or if the band has no positions.

    If a band has only some directions, each position is the point nearest to the start with the real values in these
    directions. Points without a measured direction are left out.

    Args:
        experiment: The experiment with its effective initial state.
        band: Its band, or None.
    """
    if band is None or band.unit != "mm":
        return None
    if not experiment.score.observable.is_of_places:
        return None
    start_mm = start_values(experiment)
    names = [name.rpartition(".")[0] for name in experiment.coordinates[::3]]
    deviation = band.mean - band.projection @ start_mm
    places_m = 1e-3 * (
        start_mm + deviation @ np.linalg.pinv(band.projection).T
    ).reshape(len(band.mean), -1, 3)
    touched = (np.abs(band.projection).sum(axis=0) > 0.0).reshape(-1, 3)
    shown = np.flatnonzero(touched.any(axis=1)).tolist()
    return ReferencePath(
        names=tuple(names[index] for index in shown),
        places_m=places_m[:, shown],
        is_full=bool(np.linalg.matrix_rank(band.projection) == len(start_mm)),
    )


def reference_words(kind: Kind, trial_count: int | None) -> str:
    """Return a text about the mean of a band.

    Args:
        kind: Kind of the reference.
        trial_count: Number of its trials; None is unknown.
    """
    if kind is Kind.TRIALS and trial_count == 1:
        return "one real trial"
    if kind is Kind.TRIALS:
        return f"the mean of {trial_count or 'the'} real trials"
    names = {
        Kind.PUBLISHED: "a motion computed from published numbers of real trials",
        Kind.RECORDING: "one recorded real trial",
        Kind.NUMERICAL: "the refined solution of the scene, not a real trial",
    }
    return names.get(kind, "the closed form of the scene")
