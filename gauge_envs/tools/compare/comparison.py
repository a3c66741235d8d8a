"""Results of any configurations side by side: their scores, costs and distances, and what the data say of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from gauge_envs.errors import GaugeError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.experiments.task_files import task_sha256
from gauge_envs.experiments.variants import find_variant, variants
from gauge_envs.references.bands import BandGrade
from gauge_envs.references.published import Baseline, published_baselines
from gauge_envs.runs.configuration import RunConfiguration, group_by_configuration
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.tools.compare.distance import Distance, trajectory_distance
from gauge_envs.tools.compare.draws import ScoreDraws, score_draws
from gauge_envs.tools.compare.grades import GradeComparison, GradedExperiment, compare_grade
from gauge_envs.tools.compare.scores import COMPARED_METRICS, ComparedMetric, ScoreSpread, repeats_interval


@dataclass(frozen=True, kw_only=True)
class Cell:
    """Results of one configuration in one experiment.

    Attributes:
        results: Repeats by seed, including those that were declined, failed or diverged.
        draws: Bootstrap draws of their scores; None if a repeat has no score, because a mean without failures would be
            too good.
    """

    results: tuple[Result, ...]
    draws: ScoreDraws | None = None

    def count(self, outcome: Outcome) -> int:
        """Return the number of repeats with an outcome."""
        return sum(result.outcome is outcome for result in self.results)

    @property
    def ran(self) -> bool:
        """Whether any repeat ran, also if it diverged."""
        return any(result.error is None for result in self.results)

    def values(self, metric: ComparedMetric, *, normalized: bool) -> list[float | None]:
        """Return the metric of each repeat, None for a repeat without it."""
        name = metric.normalized if normalized else metric.raw
        return [None if name is None else getattr(result.score, name) for result in self.results]

    def spread(self, metric: ComparedMetric, *, normalized: bool) -> ScoreSpread | None:
        """Return mean and scatter over the repeats that have the metric."""
        return ScoreSpread.of([value for value in self.values(metric, normalized=normalized) if value is not None])

    def interval_95(self, metric: ComparedMetric) -> tuple[float, float] | None:
        """Return the 95 % interval of the mean of the normalized metric; None if a repeat with the metric has none."""
        if metric.interval is None or metric.normalized is None:
            return None
        known = [
            (value, getattr(result.score, metric.interval))
            for result in self.results
            if (value := getattr(result.score, metric.normalized)) is not None
        ]
        if not known or any(ends is None for _, ends in known):
            return None
        return repeats_interval([value for value, _ in known], [ends for _, ends in known])

    def percentile(self, metric: ComparedMetric) -> float | None:
        """Return the percentage of real trials that are closer to their mean; mean over the repeats that have it."""
        if metric.percentile is None:
            return None
        known = [value for result in self.results if (value := getattr(result.score, metric.percentile)) is not None]
        return float(np.mean(known)) if known else None

    @property
    def times_s(self) -> tuple[float, float]:
        """Total wall time and simulated time of the repeats with a known wall time [s]."""
        timed = [(result.wall_s, result.sim_s) for result in self.results if result.wall_s is not None]
        return sum(wall for wall, _ in timed), sum(simulated for _, simulated in timed)

    @property
    def wall_s_per_sim_s(self) -> float | None:
        """Wall seconds per simulated second; None if no repeat has a wall time."""
        return _ratio(*self.times_s)


def _ratio(wall_s: float, sim_s: float) -> float | None:
    return wall_s / sim_s if sim_s > 0.0 and wall_s > 0.0 else None


@dataclass(frozen=True, kw_only=True)
class ExperimentComparison:
    """One experiment in all configurations.

    Attributes:
        id: Gymnasium id.
        grade: Grade of the reference.
        withheld: Whether its band is withheld by default.
        unit: Unit of the observable.
        cells: Results in the order of `Comparison.configurations`; None for a configuration without this experiment.
        baselines: Published scatter of real trials and scores of three engines, by metric.
        distances: Distance between each two configurations that ran it.
    """

    id: str
    grade: str
    withheld: bool
    unit: str
    cells: tuple[Cell | None, ...]
    baselines: Mapping[str, Baseline]
    distances: tuple[Distance, ...]

    @property
    def name(self) -> str:
        """Id without `GAUGE/`."""
        return self.id.removeprefix("GAUGE/")

    @property
    def primary(self) -> str:
        """Metric that reports show first: `rmse_aligned` if the experiment starts with a release, else `rmse`."""
        results = [result for cell in self.cells if cell is not None for result in cell.results]
        return next((one.score.primary for one in results if one.score.primary is not None), "rmse")

    def metrics(self, among: Iterable[str] = tuple(COMPARED_METRICS)) -> list[str]:
        """Return the metrics that a result has or whose published scores can stand beside it, the primary first."""
        names = [
            name
            for name in among
            if self.published(name) is not None
            or any(cell is not None and cell.spread(COMPARED_METRICS[name], normalized=False) for cell in self.cells)
        ]
        return sorted(names, key=lambda name: name != self.primary)

    def published(self, metric: str) -> Mapping[str, float | None] | None:
        """Return the published scores of a metric by engine; None where nothing comparable was published.

        The paper scored trajectories against the mean of real trials, so RMSE and DTW need a reference of that grade.
        Event metrics do not depend on the reference.
        """
        known = COMPARED_METRICS[metric]
        line = self.baselines.get(known.published or "")
        if line is None or not (known.is_event or (self.grade == BandGrade.TRIALS.value and not self.withheld)):
            return None
        return line.engines

    def graded(self) -> GradedExperiment:
        """Return the scores of this experiment for a comparison within its grade."""
        primary, raw = COMPARED_METRICS[self.primary], COMPARED_METRICS["rmse"]
        return GradedExperiment(
            id=self.id,
            draws=tuple(None if cell is None else cell.draws for cell in self.cells),
            published=self.published("rmse") or {},
            intervals=tuple(None if cell is None else cell.interval_95(primary) for cell in self.cells),
            raw_intervals=tuple(None if cell is None else cell.interval_95(raw) for cell in self.cells),
        )


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Counts and cost of one configuration over all its experiments.

    Attributes:
        ran: Number of experiments that ran.
        scored: Number of those in which every repeat has a normalized RMSE.
        diverged: Number of experiments in which a repeat diverged.
        not_run: Number of experiments that were declined or failed.
        wall_s_per_sim_s: Wall seconds per simulated second over all experiments that ran.
        wall_s_per_sim_s_common: Wall seconds per simulated second over `Comparison.run_by_all`.
    """

    ran: int
    scored: int
    diverged: int
    not_run: int
    wall_s_per_sim_s: float | None
    wall_s_per_sim_s_common: float | None


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Configurations side by side.

    Attributes:
        configurations: What was tested.
        experiments: Each experiment in all configurations, in the order of `gauge list`.
        notes: Results that were left out, and files that do not belong together, a sentence each.
    """

    configurations: tuple[RunConfiguration, ...]
    experiments: tuple[ExperimentComparison, ...]
    notes: tuple[str, ...]

    @cached_property
    def grades(self) -> tuple[GradeComparison, ...]:
        """What the scores of each grade say, best grade first; an experiment of several references is left out."""
        graded = [one for one in self.experiments if _has_one_reference(one)]
        return tuple(
            compare_grade(
                grade.value,
                withheld=withheld,
                experiments=[one.graded() for one in graded if (one.grade, one.withheld) == (grade.value, withheld)],
            )
            for grade in BandGrade
            for withheld in (False, True)
            if any((one.grade, one.withheld) == (grade.value, withheld) and _is_scored(one) for one in graded)
        )

    @property
    def run_by_all(self) -> tuple[ExperimentComparison, ...]:
        """Experiments that every configuration ran, also if an episode diverged."""
        return tuple(one for one in self.experiments if all(cell is not None and cell.ran for cell in one.cells))

    def summaries(self) -> tuple[Summary, ...]:
        """Return one summary for each configuration, in their order."""
        return tuple(self._summary(index) for index in range(len(self.configurations)))

    def _summary(self, index: int) -> Summary:
        cells = [cell for one in self.experiments if (cell := one.cells[index]) is not None]
        common = [cell for one in self.run_by_all if (cell := one.cells[index]) is not None]
        return Summary(
            ran=sum(cell.ran for cell in cells),
            scored=sum(all(one.score.rmse_normalized is not None for one in cell.results) for cell in cells),
            diverged=sum(cell.count(Outcome.DIVERGED) > 0 for cell in cells),
            not_run=sum(not cell.ran for cell in cells),
            wall_s_per_sim_s=_cost(cells),
            wall_s_per_sim_s_common=_cost(common),
        )


def _is_scored(one: ExperimentComparison) -> bool:
    return any(cell is not None and cell.draws is not None for cell in one.cells)


def _has_one_reference(one: ExperimentComparison) -> bool:
    """Return whether all results of an experiment are scored against the same reference."""
    results = [result for cell in one.cells if cell is not None for result in cell.results if result.error is None]
    return len({_reference_of(result) for result in results}) <= 1


def _reference_of(result: Result) -> tuple[object, ...]:
    return (result.score.grade, result.score.withheld, *sorted(result.dataset.items()))


def _cost(cells: Iterable[Cell]) -> float | None:
    times = [cell.times_s for cell in cells]
    return _ratio(sum(wall for wall, _ in times), sum(simulated for _, simulated in times))


def compare(results: Iterable[Result]) -> Comparison:
    """Return a comparison of results of any experiments, engines, parameters, settings and seeds.

    Of several results of one experiment, configuration and seed the latest counts; a note reports that.
    """
    every = list(results)
    groups = group_by_configuration(every)
    notes: list[str] = []
    by_id = {
        name: tuple(_cell(name, configuration, members, notes) for configuration, members in groups)
        for name in sorted({result.id for result in every}, key=_list_order)
    }
    experiments = []
    for name, cells in by_id.items():
        every_cell = [result for cell in cells if cell is not None for result in cell.results]
        first = next((result for result in every_cell if result.error is None), every_cell[0])
        baselines = published_baselines(name.removeprefix("GAUGE/"))
        present = [(index, cell.results) for index, cell in enumerate(cells) if cell is not None]
        distances = (
            trajectory_distance((first, second), some, others, baselines.get("rmse"))
            for (first, some), (second, others) in combinations(present, 2)
        )
        experiments.append(
            ExperimentComparison(
                id=name,
                grade=first.score.grade,
                withheld=first.score.withheld is not None,
                unit=first.score.unit,
                cells=cells,
                baselines=baselines,
                distances=tuple(distance for distance in distances if distance is not None),
            )
        )
    return Comparison(
        configurations=tuple(configuration for configuration, _ in groups),
        experiments=tuple(experiments),
        notes=(*notes, *_mismatches(every)),
    )


def _list_order(name: str) -> tuple[int, str]:
    """Return the sort key of `gauge list`; experiments of files follow by name."""
    places = {variant.id: place for place, variant in enumerate(variants())}
    return places.get(name, len(places)), name


def _cell(name: str, configuration: RunConfiguration, members: Sequence[Result], notes: list[str]) -> Cell | None:
    """Return the results of one experiment among those of a configuration, and add what was left out to the notes."""
    mine = [result for result in members if result.id == name]
    latest = {result.seed: result for result in sorted(mine, key=lambda result: result.created)}
    if len(latest) < len(mine):
        notes.append(
            f"{name.removeprefix('GAUGE/')}: {len(mine)} results of {mine[0].backend or 'files'} with "
            f"{len(latest)} seed{'s' if len(latest) > 1 else ''}; the latest of each counts"
        )
    in_force = [result.settings for result in latest.values() if result.error is None]
    if any(settings != in_force[0] for settings in in_force):
        notes.append(f"{name.removeprefix('GAUGE/')}: repeats of {mine[0].backend} differ in the settings in force")
    kept = tuple(sorted(latest.values(), key=lambda result: result.seed or 0))
    return Cell(results=kept, draws=_cell_draws(kept, configuration, notes)) if kept else None


def _cell_draws(results: Sequence[Result], configuration: RunConfiguration, notes: list[str]) -> ScoreDraws | None:
    """Return the draws of repeats; None without them, with a note if they should have some."""
    if any(result.score.rmse_normalized is None for result in results):
        return None
    name = results[0].id.removeprefix("GAUGE/")
    try:
        experiment = recorded_experiment(results[0])
        band = reference_band(experiment, use_withheld=results[0].score.withheld is not None)
        draws = None if band is None else score_draws(results, experiment, band, configuration)
    except GaugeError as error:
        notes.append(f"{name}: not compared in pairs, because its result cannot be scored again: {error}")
        return None
    stated = [result.score.rmse_normalized for result in results]
    if draws is None or np.allclose(draws.raw, np.array(stated, dtype=np.float64), rtol=1e-6, atol=1e-9):
        return draws
    notes.append(f"{name}: not compared in pairs, because its score was made against another reference; run it again")
    return None


def _mismatches(results: Sequence[Result]) -> list[str]:
    """Return a sentence for each way in which results do not belong together."""
    notes = []
    stale = _names(results, _is_stale)
    if stale:
        notes.append(f"made from another task file than the installed one: {stale}")
    for name in sorted({one.id for one in results if one.has_experiment_file}):
        if len({one.task_sha256 for one in results if one.id == name}) > 1:
            notes.append(f"{name.removeprefix('GAUGE/')}: made from different versions of its experiment file")
    made_with = sorted({one.versions.get("gauge-envs", "an unknown version") for one in results})
    if len(made_with) > 1:
        notes.append(f"scored by different versions of gauge-envs: {', '.join(made_with)}")
    for name in sorted({one.id for one in results}):
        grades = sorted({one.score.grade for one in results if one.id == name})
        if len(grades) > 1:
            notes.append(f"{name.removeprefix('GAUGE/')}: scored against references of grade {' and '.join(grades)}")
        imports = {tuple(sorted(one.dataset.items())) for one in results if one.id == name}
        if len(imports) > 1:
            notes.append(f"{name.removeprefix('GAUGE/')}: real trials or drivers are of different imports, or bundled")
    return notes


def _is_stale(result: Result) -> bool:
    if result.has_experiment_file:
        return False
    return result.task_sha256 != task_sha256(find_variant(result.id).family)


def _names(results: Iterable[Result], wanted: Callable[[Result], bool]) -> str:
    return ", ".join(dict.fromkeys(one.id.removeprefix("GAUGE/") for one in results if wanted(one)))
