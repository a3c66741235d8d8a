"""The reference of an experiment: the one place that decides which band counts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.references.bands import Band, BandGrade, bundled_band
from gauge_envs.references.imported import DataSource, load_imported
from gauge_envs.references.published import carried_band, law_for
from gauge_envs.scene import Scene
from gauge_envs.scene.timing import FRAME_RATE_HZ

__all__ = [
    "band_grade",
    "load_band",
    "reference_band",
]


def reference_band(experiment: Experiment, *, use_withheld: bool = False) -> Band | None:
    """The best reference there is for an experiment: real trials, else a recording, else a law, else none.

    An experiment with `reference_source` imported is scored against the imported trials alone.

    Args:
        experiment: The experiment.
        use_withheld: Take a band too that is withheld by default, as it may be of another material or covers too
            little; `Band.withheld` gives the reason.
    """
    if experiment.reference is not None:
        return experiment.reference.band
    band = load_band(experiment.name, experiment.reference_source)
    if band is not None and (use_withheld or band.withheld is None):
        return band
    law = law_for(experiment.name)
    if law is None:
        return None
    # An asset changes what is simulated, not what it is held against.
    scene = experiment.scene if experiment.asset is None else load_experiment(experiment.name).scene
    return carried_band(
        variant=experiment.name,
        positions_mm=_carried_positions_mm(scene, law.body, law.carrier, experiment.frame_count),
    )


def _carried_positions_mm(scene: Scene, body: str, carrier: str, frame_count: int) -> NDArray[np.float64]:
    """Positions [mm] of a body that keeps its place on a carrier, shape [frame_count, 3]."""
    start = scene.body(carrier).pose
    place = start.to_body(np.asarray(scene.body(body).pose.position_m))
    driver = next((d for d in scene.drivers if d.body == carrier), None)
    poses = [start if driver is None else driver.pose(start, k / FRAME_RATE_HZ) for k in range(frame_count)]
    return 1e3 * np.array([pose.to_world(place) for pose in poses])


def load_band(variant: str, source: DataSource = DataSource.BUNDLED) -> Band | None:
    """The band of a variant; None where the source has none.

    Args:
        variant: Name of the variant.
        source: Bundled band, or that of the imported trials.

    Raises:
        ReferenceFileError: A file of the band is damaged.
    """
    if source is DataSource.BUNDLED:
        return bundled_band(variant)
    imported = load_imported(variant)
    return None if imported is None else imported.band


def band_grade(variant: str, source: DataSource = DataSource.BUNDLED) -> BandGrade:
    """The grade of what a variant is scored on; a band that is withheld does not count."""
    band = load_band(variant, source)
    if band is not None and band.withheld is None:
        return band.grade
    return BandGrade.NONE if law_for(variant) is None else BandGrade.LAW
