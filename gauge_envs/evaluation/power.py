"""What a reference can tell: how far changes of its scene move the score, in units of what it leaves open."""

from collections.abc import Mapping
from dataclasses import dataclass

from gauge_envs.evaluation.deviation import aligned_baseline, band_baseline
from gauge_envs.evaluation.reference import reference_loads
from gauge_envs.evaluation.verification import (
    LEAST_POWER,
    frozen_distance,
    load_length,
    point_lengths,
    root_mean_square,
    solution_uncertainty,
    verification_band,
)
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band
from gauge_envs.references.power import power_rows

EXACT_SCALE_SHARE = 0.01
"""Share of the motion that stands for the uncertainty of an exact solution. It is a choice."""

AT_REST_SCALE_MM = 1.0
"""Distance that stands for it where the solution is at rest [mm]. It is a choice."""


@dataclass(frozen=True, kw_only=True)
class Power:
    """What a reference can tell.

    Attributes:
        unit: Unit of `scale`.
        scale: What the reference leaves open: u of a solution, 1 % of the motion where that is exact, or the mean
            distance of real trials.
        scale_text: What it is, in words.
        frozen: Distance of a scene in which nothing moves, over the scale.
        loads: What the loads of rods and grips tell beside it, each over u of its own, by quantity.
        changes: Distance that each change of the scene moves the motion, over the scale; None for a scene that fails.
    """

    unit: str
    scale: float
    scale_text: str
    frozen: float
    changes: Mapping[str, float | None]
    loads: Mapping[str, Mapping[str, float | None]]

    @property
    def told(self) -> Mapping[str, float]:
        """Changes that move the score or a load by at least `LEAST_POWER`, each by the quantity that tells it best.

        A scene in which nothing moves is the first.
        """
        best = {"nothing moves": ("", self.frozen)}
        quantities = {"": self.changes} | {
            f" by {name}": changes for name, changes in self.loads.items()
        }
        for quantity, changes in quantities.items():
            for name, size in changes.items():
                if size is not None and size > best.get(name, ("", 0.0))[1]:
                    best[name] = (quantity, size)
        return {
            name + quantity: size
            for name, (quantity, size) in best.items()
            if size >= LEAST_POWER
        }

    @property
    def not_told(self) -> list[str]:
        """Changes that neither it nor a load tells; at rest a solution is that of a scene in which nothing moves."""
        sizes = {"nothing moves": self.frozen or None, **self.changes}
        by_load = {
            name
            for changes in self.loads.values()
            for name, size in changes.items()
            if size is not None and size >= LEAST_POWER
        }
        return [
            name
            for name, size in sizes.items()
            if size is not None and size < LEAST_POWER and name not in by_load
        ]


def reference_power(experiment: Experiment, band: Band | None) -> Power | None:
    """Return what a reference can tell; None without a reference, or for one without any scale.

    Args:
        experiment: The experiment, with its calibrated scene.
        band: Its reference.
    """
    if band is None:
        return None
    compared = verification_band(band)
    scale: float | None
    if compared is not None:
        unit, frozen = compared.unit, frozen_distance(compared)
        scale, text = solution_uncertainty(band), "its u"
        if scale is None and frozen > 0.0:
            scale = EXACT_SCALE_SHARE * frozen
            text = "1 % of the motion, as the solution is exact"
        elif scale is None:
            scale, text = AT_REST_SCALE_MM, "1 mm, as the solution is exact and at rest"
    else:
        unit, frozen = band.unit, frozen_distance(band)
        published = band_baseline(experiment, band)
        scale, text = aligned_baseline(band), "the mean of real trials, aligned"
        if scale is None or experiment.scene.drivers:
            scale = None if published is None else published.mean
            text = "the published mean of real trials"
        if scale is None:
            scale = root_mean_square(point_lengths(band.sigma, band))
            text = "u of the trial"
    if not scale:
        return None
    return Power(
        unit=unit,
        scale=scale,
        scale_text=text,
        frozen=frozen / scale,
        changes={
            row.change: None if row.distance is None else row.distance / scale
            for row in power_rows(experiment.name)
        },
        loads={
            load.quantity: {
                row.change: None
                if row.distance is None
                else row.distance / load_length(load.uncertainty)
                for row in power_rows(experiment.name, load.quantity)
            }
            for load in reference_loads(experiment, band)
        },
    )
