"""Compare results of any configurations: scores, ranks and distances."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from gauge_envs.errors import GaugeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.task_files import task_sha256
from gauge_envs.experiments.variants import find_variant, variants
from gauge_envs.pages.results import (
    ALIGNED,
    SCORE_METRICS,
    configuration_labels,
    configuration_parts,
    raw_and_normalized,
)
from gauge_envs.pages.text import counted, short_id
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import Baseline, published_baselines
from gauge_envs.runs.configuration import RunConfiguration, group_by_configuration
from gauge_envs.runs.result import MARKER_DECIMALS, Outcome, Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scoring.answers import Answer, normalizing_baselines
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.score import FROM_SOLUTION, Interval
from gauge_envs.tools.compare.distance import Distance, trajectory_distance
from gauge_envs.tools.compare.ranks import (
    KindComparison,
    Mean,
    compare_kind,
    rank_deviations,
)
from gauge_envs.tools.compare.reference import choose_reference
from gauge_envs.tools.compare.statistics import (
    Deviations,
    ScoreSpread,
    repeats_interval,
)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """Results of one configuration in one experiment.

    Attributes:
        results: Repeats by seed, including unsupported, failed and diverged ones.
    """

    results: tuple[Result, ...]

    def count(self, outcome: Outcome) -> int:
        """Return the number of repeats with an outcome."""
        return sum(result.outcome is outcome for result in self.results)

    def values(self, metric: str, *, normalized: bool) -> list[float | None]:
        """Return the metric of each repeat, None for a repeat without it."""
        pairs = [raw_and_normalized(result.score, metric) for result in self.results]
        return [pair[normalized] for pair in pairs]

    def spread(self, metric: str, *, normalized: bool) -> ScoreSpread | None:
        """Return mean and scatter over the repeats that have the metric."""
        return ScoreSpread.of(self.values(metric, normalized=normalized))

    def interval_95(self, metric: str) -> Interval | None:
        """Return the 95 % interval of the mean normalized metric; None if a repeat with the metric has no interval."""
        values = []
        intervals = []
        of_results = self.values(metric, normalized=True)
        for value, result in zip(of_results, self.results, strict=True):
            if value is None:
                continue
            interval = result.score.primary_interval
            if interval is None or metric != result.score.primary:
                return None
            values.append(value)
            intervals.append(interval)
        return repeats_interval(values, intervals) if values else None

    @property
    def is_wrong(self) -> bool:
        """Whether a finished repeat does not solve its scene, or, without a solution, is unlike reality."""
        scores = [
            result.score
            for result in self.results
            if result.outcome is Outcome.FINISHED
        ]
        solved = {score.solves for score in scores} - {None}
        return Answer.NO in (solved or {score.like_reality for score in scores})


@dataclass(frozen=True, kw_only=True)
class ExperimentComparison:
    """One experiment in all configurations.

    Attributes:
        id: Gymnasium id.
        kind: Kind of the reference; `none` also if the reference scores none of the results.
        unit: Unit of the observable.
        cells: Results of each configuration, in the order of the comparison; None without this experiment.
        baselines: Published scatter of real trials and scores of three engines, by metric.
        ranks: Rank of each configuration among those with the same constants. Configurations with a repeat without a
            score have no rank: a mean without failures is too good.
        read: Function that returns a result with its trajectory.
    """

    id: str
    kind: Kind
    unit: str
    cells: tuple[Cell | None, ...]
    baselines: Mapping[str, Baseline]
    ranks: Mapping[int, Mean]
    read: Callable[[Result], Result]

    @property
    def name(self) -> str:
        """Id without `GAUGE/`."""
        return short_id(self.id)

    @property
    def is_solution(self) -> bool:
        """Whether the reference is a solution of the scene, not real trials."""
        return self.kind.is_solution

    @property
    def present(self) -> list[tuple[int, Cell]]:
        """Index and results of each configuration with results."""
        return [(index, cell) for index, cell in enumerate(self.cells) if cell]

    @property
    def results(self) -> list[Result]:
        """All results."""
        return [result for _, cell in self.present for result in cell.results]

    @property
    def primary(self) -> str:
        """Metric that reports show first (`Score.primary`); `rmse` without a score."""
        primaries = (result.score.primary for result in self.results)
        return next(filter(None, primaries), "rmse")

    @cached_property
    def distances(self) -> tuple[Distance, ...]:
        """Distance between each pair of configurations that ran the experiment, computed on first access."""
        baseline = self.baselines.get("rmse")
        repeats = {
            index: [self.read(result) for result in cell.results]
            for index, cell in self.present
        }
        distances = (
            trajectory_distance(pair, repeats[pair[0]], repeats[pair[1]], baseline)
            for pair in combinations(repeats, 2)
        )
        return tuple(filter(None, distances))

    def metrics(self, among: Iterable[str] = tuple(SCORE_METRICS)) -> list[str]:
        """Return the metrics with a score or comparable published scores, the primary metric first."""
        names = []
        for name in among:
            is_known = any(
                raw_and_normalized(result.score, name)[0] is not None
                for result in self.results
            )
            if is_known or self.published(name) is not None:
                names.append(name)
        return sorted(names, key=lambda name: name != self.primary)

    def shown_metrics(self, among: Iterable[str] = tuple(SCORE_METRICS)) -> list[str]:
        """Return the metrics in tables. The distance from a solution replaces RMSE and DTW."""
        return [
            name
            for name in self.metrics(among)
            if not self.is_solution
            or name == FROM_SOLUTION
            or SCORE_METRICS[name].is_event
        ]

    def unit_of(self, metric: str) -> str:
        """Return the unit of a metric before normalization."""
        if metric == FROM_SOLUTION:
            return self.results[0].score.distance_unit
        return SCORE_METRICS[metric].unit_of(self.unit)

    def published(self, metric: str) -> Mapping[str, float | None] | None:
        """Return the published scores of a metric by engine; None without comparable published scores.

        The paper scores trajectories against the mean of real trials: RMSE and DTW need the kind `trials`
        or `published`.
        Event metrics do not depend on the reference.
        """
        is_event = SCORE_METRICS[metric].is_event
        is_comparable = self.kind.is_mean_of_trials or is_event
        if not is_comparable or metric not in self.baselines:
            return None
        return self.baselines[metric].engines


@dataclass(frozen=True, kw_only=True)
class ScoreComparison:
    """ScoreComparison of configurations.

    Attributes:
        configurations: The tested configurations.
        experiments: Each experiment in all configurations, in the order of `gauge list`.
        notes: A sentence for each group of results that is left out or inconsistent.
    """

    configurations: tuple[RunConfiguration, ...]
    experiments: tuple[ExperimentComparison, ...]
    notes: tuple[str, ...]

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Label of each configuration."""
        return tuple(configuration_labels(self.configurations))

    @property
    def constants(self) -> list[str]:
        """Name of the constants of each configuration."""
        return [constants_of(configuration) for configuration in self.configurations]

    @cached_property
    def kinds(self) -> tuple[KindComparison, ...]:
        """Ranks within each kind of reference; experiments with several references are left out."""
        comparisons: list[KindComparison] = []
        for kind in Kind:
            ranks = {
                experiment.id: experiment.ranks
                for experiment in self.experiments
                if experiment.kind is kind and _is_ranked(experiment)
            }
            comparisons += compare_kind(kind, ranks, self.constants)
        return tuple(comparisons)


def constants_of(configuration: RunConfiguration, digits: int = 17) -> str:
    """Return the name of the constants of a configuration: its parameters and its modified scene."""
    parts = configuration_parts(configuration, digits=digits)
    return ", ".join(text for part, text in parts if part in ("parameters", "asset"))


def _is_ranked(experiment: ExperimentComparison) -> bool:
    """Return whether all results of an experiment are scored against the same reference."""
    ran = [result for result in experiment.results if result.error is None]
    return len(set(map(_reference_of, ran))) <= 1


def compare(
    results: Iterable[Result], read: Callable[[Result], Result] = lambda result: result
) -> ScoreComparison:
    """Compare results of any experiments, engines, parameters, settings and seeds.

    The newest revision of each experiment counts, and the latest result of each configuration and seed. Notes name the
    results that are left out.

    Args:
        results: The results. Their trajectories may be None if `read` returns them.
        read: Function that returns a result with its trajectory. The trajectories of one experiment are read at a time.
    """
    given = sorted(results, key=lambda result: result.revision)
    newest = {result.id: result.revision for result in given}
    kept = [result for result in given if result.revision == newest[result.id]]
    older = {result.id for result in given if result.revision < newest[result.id]}
    notes = [
        f"{short_id(name)}: results of an older revision are left out; compare them separately"
        for name in sorted(older)
    ]
    groups = group_by_configuration(kept)
    constants = [constants_of(configuration) for configuration, _ in groups]
    experiments = []
    for name in sorted(newest, key=_list_position):
        cells = []
        deviations = {}
        for index, (_, members) in enumerate(groups):
            repeats = [result for result in members if result.id == name]
            cell = _cell(repeats, notes)
            cells.append(cell)
            scored = cell and _deviations(cell.results, notes, read)
            if scored:
                deviations[index] = scored
        ranks = rank_deviations(deviations, constants)
        experiments.append(_experiment(name, cells, ranks, read))
    notes += _mismatches(kept)
    return ScoreComparison(
        configurations=tuple(configuration for configuration, _ in groups),
        experiments=tuple(experiments),
        notes=tuple(dict.fromkeys(notes)),
    )


def _list_position(name: str) -> tuple[int, str]:
    """Return the position of an experiment in `gauge list`; experiments of files follow by name."""
    places = {variant.id: place for place, variant in enumerate(variants())}
    return places.get(name, len(places)), name


def _experiment(
    name: str,
    cells: Sequence[Cell | None],
    ranks: Mapping[int, Mean],
    read: Callable[[Result], Result],
) -> ExperimentComparison:
    """Return an experiment in all configurations."""
    results: list[Result] = []
    for cell in filter(None, cells):
        results += cell.results
    ran = [result for result in results if result.error is None] or results
    kind = Kind(ran[0].score.kind)
    if all(result.score.refused is not None for result in ran):
        kind = Kind.NONE
    return ExperimentComparison(
        id=name,
        kind=kind,
        unit=ran[0].score.unit,
        cells=tuple(cells),
        baselines=published_baselines(short_id(name)),
        ranks=ranks,
        read=read,
    )


def _cell(results: Sequence[Result], notes: list[str]) -> Cell | None:
    """Return the latest result of each seed, None without a result; add a note if results are left out."""
    if not results:
        return None
    by_seed = {
        result.seed: result
        for result in sorted(results, key=lambda result: result.created)
    }
    kept = tuple(sorted(by_seed.values(), key=lambda result: result.seed or 0))
    name = short_id(kept[0].id)
    if len(kept) < len(results):
        notes.append(
            f"{name}: {len(results)} results of {kept[0].backend or 'files'} with {counted(len(kept), 'seed')}; "
            "the latest of each counts"
        )
    return Cell(results=kept)


def _deviations(
    results: Sequence[Result], notes: list[str], read: Callable[[Result], Result]
) -> Deviations | None:
    """Return the deviations of repeats; None without scores. Add a note if stored scores cannot be reproduced."""
    is_finished = all(result.outcome is Outcome.FINISHED for result in results)
    scores = [result.score.primary_normalized for result in results]
    if not is_finished or None in scores:
        return None
    unranked = f"{short_id(results[0].id)}: not ranked, because its"
    try:
        experiment = recorded_experiment(results[0])
        band = reference_band(experiment)
        if band is None:
            return None
        reference = choose_reference(results, band)
        scale = _scale(experiment, band, results[0].score.primary)
        deviations = Deviations.of(
            band,
            (reference.deviation(read(result)) for result in results),
            [result.seed for result in results],
            scale=scale,
            is_aligned=results[0].score.primary == ALIGNED.key,
        )
    except GaugeError as error:
        notes.append(f"{unranked} result cannot be scored again: {error}")
        return None
    stored = np.array(scores, dtype=np.float64)
    # Files have rounded positions of markers.
    rounding = 10.0**-MARKER_DECIMALS / scale if band.points else 1e-9
    if np.allclose(deviations.scores, stored, rtol=1e-6, atol=rounding):
        return deviations
    notes.append(
        f"{unranked} score belongs to another reference or motion; run it again"
    )
    return None


def _scale(experiment: Experiment, band: Band, primary: str | None) -> float:
    """Return the distance with a normalized score of 1, in the unit of the band; NaN without a normalization."""
    if primary == FROM_SOLUTION:
        return band.zero_motion_distance
    if primary == ALIGNED.key and band.trial_rmse_aligned is not None:
        return float(band.trial_rmse_aligned.mean())
    baseline = normalizing_baselines(experiment, band).get("rmse")
    return math.nan if baseline is None else baseline.mean


def _mismatches(results: Sequence[Result]) -> Iterator[str]:
    """Yield a sentence for each inconsistency between results."""
    by_id: dict[str, list[Result]] = {}
    for result in results:
        by_id.setdefault(result.id, []).append(result)
    stale = []
    for name, group in by_id.items():
        installed = task_sha256(find_variant(name).family)
        if any(result.task_sha256 != installed for result in group):
            stale.append(short_id(name))
    if stale:
        yield f"the task file differs from the installed one: {', '.join(stale)}"
    packages = {
        result.versions.get("gauge-envs", "an unknown version") for result in results
    }
    if len(packages) > 1:
        yield f"scored by different versions of gauge-envs: {', '.join(sorted(packages))}"
    for name, group in sorted(by_id.items()):
        reasons = {result.score.refused for result in group} - {None}
        for reason in sorted(map(str, reasons)):
            yield f"{short_id(name)}: {reason}"
        if len(set(map(_reference_of, group))) > 1:
            yield f"{short_id(name)}: the references or the prescribed motions of its results differ"


def _reference_of(result: Result) -> tuple[object, ...]:
    """Return what identifies the reference of a score: its kind and the sources of its data."""
    return result.score.kind, *sorted(result.dataset.items())
