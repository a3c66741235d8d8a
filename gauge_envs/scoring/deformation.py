"""Compare the deformation of a solid with real trials: strain, volume ratio and non-affine residual of its markers.

The grade of these numbers is `statistics`: validation, of a quantity that is no g(t). They stand beside the score and
enter no other number.

Interval. The simulated value is exact, so the error of the difference is that of the real value. For one recording it
is the stated error of the measurement, s: +- 1.96 s. For n trials it is that of their mean: +- t s / sqrt(n) with their
scatter s and Student's t of n - 1 degrees of freedom.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.errors import ShapeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.deformation import DeformationReference, bundled_deformation
from gauge_envs.references.imported import load_imported
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.numerics import student_quantile
from gauge_envs.scoring.verification import COVERAGE_FACTOR


@dataclass(frozen=True, kw_only=True)
class StatisticScore:
    """One statistic of deformation, simulated and real, at the last frame where the real one is known.

    Attributes:
        name: Name, as `strain.zz`; see `gauge_envs.observables.deformation.deformation_statistics`.
        unit: `mm` for `non_affine`, `1` for the others.
        frame: Frame of the values.
        simulated: Simulated value.
        real: Real value.
        uncertainty: 1-sigma uncertainty of the real value, or scatter over several trials.
        z: Simulated minus real value, in units of the uncertainty; None where that is 0.
        z_rms: Root mean square of z over all known frames.
        difference_95: 95 % interval of simulated minus real, low and high; None in results of earlier versions.
    """

    name: str
    unit: str
    frame: int
    simulated: float
    real: float
    uncertainty: float
    z: float | None
    z_rms: float | None
    difference_95: tuple[float, float] | None = None

    @property
    def differs(self) -> bool:
        """Whether the interval of the difference leaves out 0."""
        if self.difference_95 is None:
            return False
        low, high = self.difference_95
        return low > 0.0 or high < 0.0


@dataclass(frozen=True, kw_only=True)
class RealStatistic:
    """One statistic of deformation of real trials.

    Attributes:
        name: Name, as in `StatisticScore`.
        unit: `mm` or `1`.
        frame: Frame of the value.
        value: Mean over the trials.
        reach_95: Half width of its 95 % interval.
        trial_count: Number of trials.
    """

    name: str
    unit: str
    frame: int
    value: float
    reach_95: float
    trial_count: int


@dataclass(frozen=True, kw_only=True)
class DeformationScore:
    """Statistics of the deformation of an episode beside real ones.

    Attributes:
        grade: Always `statistics`.
        trial_count: Number of real trials.
        source: Source of the real values.
        note: What limits them; None without a limit.
        statistics: The statistics.
    """

    grade: Literal["statistics"] = "statistics"
    trial_count: int
    source: str
    note: str | None
    statistics: tuple[StatisticScore, ...]

    def __getitem__(self, name: str) -> StatisticScore:
        """Return a statistic by its name; raise KeyError if it is not known."""
        for statistic in self.statistics:
            if statistic.name == name:
                return statistic
        raise KeyError(name)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready dictionary of all fields."""
        return asdict(self) | {
            "statistics": [asdict(statistic) for statistic in self.statistics]
        }


def deformation_reference(experiment: Experiment) -> DeformationReference | None:
    """Return the real statistics of an experiment from its reference source; None without any."""
    if experiment.reference is not None:
        return None
    if experiment.reference_source is DataSource.BUNDLED:
        return bundled_deformation(experiment.name)
    imported = load_imported(experiment.name)
    return None if imported is None else imported.deformation


def score_deformation(
    experiment: Experiment,
    markers_m: ArrayLike,
    *,
    reference: DeformationReference | None = None,
) -> DeformationScore | None:
    """Compare the deformation of a rollout with real trials.

    Rest is the first frame. If the reference rests on some of the markers, the simulated statistics use the same ones.

    Args:
        experiment: Experiment that was simulated.
        markers_m: Marker positions at the 30 Hz frames [m], shape [frame_count, marker_count, 3].
        reference: Real statistics; None takes those of `deformation_reference`.

    Returns:
        The comparison; None if the experiment has no markers on a solid, or no real statistics.
    """
    from gauge_envs.observables.deformation import (
        STATISTICS,
        deformation_statistics,
        marked_solid,
    )

    solid = marked_solid(experiment.scene)
    reference = deformation_reference(experiment) if reference is None else reference
    if solid is None or reference is None or experiment.scene.markers is None:
        return None
    markers = np.asarray(markers_m, dtype=np.float64)
    wanted = (experiment.frame_count, len(experiment.scene.markers.positions_m), 3)
    if markers.shape != wanted:
        raise ShapeError(
            f"markers_m has shape {markers.shape}; {experiment.name} needs {wanted}"
        )
    if len(reference.mean) != experiment.frame_count:
        raise ShapeError(
            f"the reference has {len(reference.mean)} frames; {experiment.name} needs {experiment.frame_count}. "
            "An import of another version is renewed by gauge data import."
        )
    if reference.markers is not None:
        markers = markers[:, list(reference.markers)]
    simulated = deformation_statistics(markers[0], markers, solid)
    scores = [
        _score(
            name,
            simulated[:, STATISTICS.index(name)],
            mean,
            sigma,
            trial_count=reference.trial_count,
        )
        for name, mean, sigma in zip(
            reference.statistics, reference.mean.T, reference.sigma.T, strict=True
        )
    ]
    return DeformationScore(
        trial_count=reference.trial_count,
        source=reference.source,
        note=reference.note,
        statistics=tuple(score for score in scores if score is not None),
    )


def _score(
    name: str,
    simulated: FloatArray,
    mean: FloatArray,
    sigma: FloatArray,
    *,
    trial_count: int,
) -> StatisticScore | None:
    from gauge_envs.observables.deformation import statistic_unit

    known = np.isfinite(simulated) & np.isfinite(mean) & np.isfinite(sigma)
    if not known.any():
        return None
    frame = int(np.flatnonzero(known)[-1])
    usable = known & (sigma > 0.0)
    difference = float(simulated[frame] - mean[frame])
    reach = reach_95(float(sigma[frame]), trial_count)
    z = np.divide(simulated - mean, sigma, out=np.full(len(mean), np.nan), where=usable)
    return StatisticScore(
        name=name,
        unit=statistic_unit(name),
        frame=frame,
        simulated=float(simulated[frame]),
        real=float(mean[frame]),
        uncertainty=float(sigma[frame]),
        z=float(z[frame]) if usable[frame] else None,
        z_rms=float(np.sqrt(np.square(z[usable]).mean())) if usable.any() else None,
        difference_95=(difference - reach, difference + reach),
    )


def reach_95(sigma: float, trial_count: int) -> float:
    """Return the half width of the 95 % interval of a real value.

    Args:
        sigma: Standard uncertainty of the value of one recording, or scatter of several trials.
        trial_count: Number of trials, of which the value is the mean.
    """
    if trial_count == 1:
        return COVERAGE_FACTOR * sigma
    return student_quantile(trial_count - 1, 0.975) * sigma / math.sqrt(trial_count)


def real_statistics(reference: DeformationReference) -> tuple[RealStatistic, ...]:
    """Return the statistics of real trials, each at the last frame where it is known."""
    from gauge_envs.observables.deformation import statistic_unit

    found = []
    for name, mean, sigma in zip(
        reference.statistics, reference.mean.T, reference.sigma.T, strict=True
    ):
        frame = int(np.flatnonzero(np.isfinite(mean) & np.isfinite(sigma))[-1])
        found.append(
            RealStatistic(
                name=name,
                unit=statistic_unit(name),
                frame=frame,
                value=float(mean[frame]),
                reach_95=reach_95(float(sigma[frame]), reference.trial_count),
                trial_count=reference.trial_count,
            )
        )
    return tuple(found)
