"""Error over cost as the step and the iterations of an engine vary: numerical, model and parametric error apart.

Definitions. A *family* is one engine with one preset; its runs of an experiment differ in `EFFORT` settings alone, the
step and the iterations. All distances are those of `ErrorMeasure`, in the unit of the score.

- *Converged motion* of a family: its finest run at its usual iterations. If the next coarser neighbours are closer to
  each other than the finest run is to its neighbour, it is the finer one of those, and so on: an engine in single
  precision moves away again at very fine steps, where rounding dominates.
- *Resolution*: the largest distance of the converged motion to its coarser neighbour and to any finer run. Nothing
  smaller is known about it.
- *Numerical error* of a run: its distance to the converged motion of its own family.
- *Model error* of a family: the distance of its converged motion to the exact motion of the scene's own constants. It
  is what no finer step removes.
- *Parametric floor*: the distance by which the uncertain inputs of the scene move the motion, one standard uncertainty
  each, added in squares. An error below it cannot be told from that of the published constants.
- *Real scatter*: the mean distance of a real trial to the mean of the trials.
- *Sufficient step*: the largest one from which on, down to the converged motion, the numerical error stays below the
  parametric floor and the real scatter.
- *Error against reality*: the first score, over that of real trials. If it is aligned to the release, so are they.

Cost is the least CPU time over repeats per simulated second; it is wall time if a result states no CPU time.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Point:
    """One setting of a family on one phenomenon; errors are over the real scatter if there is one, else in `unit`.

    Over several experiments, each error is that of the worst experiment, and the cost is their common one.

    Attributes:
        effort: The settings of `EFFORT` in force.
        settings_given: Settings that a user gives to have it.
        step_s: Time step [s]; None for an engine without one.
        cost: CPU or wall seconds per simulated second, the least over repeats.
        cost_most: The same, the most over repeats.
        cost_ratio: `cost` over that of the reference configuration; None without one.
        repeats: Least number of repeats of an experiment.
        diverged: Whether a run of it left the bounds of its scene, or did not end.
        numerical: Numerical error; None where the family has a single step, or it diverged.
        to_closed_form: Distance to the exact motion of the scene's constants; None without one.
        to_reality: Error against reality; None without trials.
        is_reference: Whether it is the converged motion of its family.
        is_on_main_line: Whether only the step differs from the family's usual settings.
    """

    effort: Mapping[str, float]
    settings_given: Mapping[str, Any]
    step_s: float | None
    cost: float
    cost_most: float
    cost_ratio: float | None
    repeats: int
    diverged: bool
    numerical: float | None = None
    to_closed_form: float | None = None
    to_reality: float | None = None
    is_reference: bool = False
    is_on_main_line: bool = True


@dataclass(frozen=True, kw_only=True)
class Family:
    """One engine with one preset on one phenomenon; errors as in `Point`.

    Attributes:
        backend: Name of the engine.
        preset: Presets in force, several if the experiments have different ones.
        is_default: Whether the preset is the engine's own choice for the scene.
        given: Settings that were given, without the effort and the preset.
        versions: Versions of the engine's packages.
        points: Its settings, the cheapest first.
        resolution: Largest distance of the converged motion to its coarser neighbour and to any finer run; infinite if
            a finer run diverged, None with less than two steps.
        model: Model error; None without a closed form or a converged motion.
        floor: Parametric floor, the smallest of the experiments; None without sensitivities.
        sufficient_step_s: Sufficient step; None if there is none.
    """

    backend: str
    preset: str
    is_default: bool
    given: Mapping[str, Any]
    versions: Mapping[str, str]
    points: tuple[Point, ...]
    resolution: float | None
    model: float | None
    floor: float | None = None
    sufficient_step_s: float | None = None

    @property
    def name(self) -> str:
        """Short name, as `rapier` or `rapier out_of_box`."""
        extra = [] if self.is_default else [self.preset]
        extra += [
            f"{key}={value}"
            for key, value in self.given.items()
            if key != "drive_interval_s"
        ]
        return " ".join([self.backend, *extra])


@dataclass(frozen=True, kw_only=True)
class Phenomenon:
    """Experiments that differ in their material alone, with all families that ran all of them.

    Attributes:
        name: Name, as `SlopeSlider-2`, with the parameters if they are not the calibrated ones.
        ids: Ids of its experiments.
        metric: What the errors measure: `rmse`, or an event metric.
        unit: Unit of the errors: `scatter` if they are over the real scatter, else that of the score.
        scatter: Real scatter of each experiment in the unit of its score, by id; empty if there is none.
        families: Its families.
    """

    name: str
    ids: tuple[str, ...]
    metric: str
    unit: str
    scatter: Mapping[str, float]
    families: tuple[Family, ...]

    @property
    def has_trials(self) -> bool:
        """Whether an error against reality is known."""
        points = [point for family in self.families for point in family.points]
        return any(point.to_reality is not None for point in points)


@dataclass(frozen=True, kw_only=True)
class Tradeoff:
    """Error over cost of all phenomena in results.

    Attributes:
        cost: `cpu` or `wall`.
        reference: Configuration whose cost is 1.
        phenomena: The phenomena.
        versions: Versions of this package and of Python.
        notes: What was left out.
    """

    cost: str
    reference: str
    phenomena: tuple[Phenomenon, ...]
    versions: Mapping[str, str]
    notes: tuple[str, ...]
