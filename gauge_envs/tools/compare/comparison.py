"""Results of any configurations side by side: their scores, ranks and distances."""

import math
from collections.abc import Iterable, Mapping, Sequence
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
    normalized_score,
    raw_score,
    score_interval,
)
from gauge_envs.pages.text import counted, short_id
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import Baseline, published_baselines
from gauge_envs.runs.configuration import RunConfiguration, group_by_configuration
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.score import OVER_U, normalizing_baselines
from gauge_envs.tools.compare.difference import (
    Deviations,
    ScoreSpread,
    repeats_interval,
)
from gauge_envs.tools.compare.distance import Distance, trajectory_distance
from gauge_envs.tools.compare.ranks import (
    KindComparison,
    ScoredExperiment,
    compare_kind,
)
from gauge_envs.tools.compare.yardstick import choose_yardstick, is_aligned


@dataclass(frozen=True, kw_only=True)
class Cell:
    """Results of one configuration in one experiment.

    Attributes:
        results: Repeats by seed, including those that were declined, failed or diverged.
        deviations: Their deviations from the reference; None if a repeat has no score, because a mean without failures
            would be too good.
    """

    results: tuple[Result, ...]
    deviations: Deviations | None = None

    def count(self, outcome: Outcome) -> int:
        """Return the number of repeats with an outcome."""
        return sum(result.outcome is outcome for result in self.results)

    @property
    def ran(self) -> bool:
        """Whether any repeat ran, also if it diverged."""
        return any(result.error is None for result in self.results)

    def values(self, metric: str, *, normalized: bool) -> list[float | None]:
        """Return the metric of each repeat, None for a repeat without it."""
        value_of = normalized_score if normalized else raw_score
        return [value_of(result.score, metric) for result in self.results]

    def spread(self, metric: str, *, normalized: bool) -> ScoreSpread | None:
        """Return mean and scatter over the repeats that have the metric."""
        return ScoreSpread.of(
            [
                value
                for value in self.values(metric, normalized=normalized)
                if value is not None
            ]
        )

    def interval_95(self, metric: str) -> tuple[float, float] | None:
        """Return the 95 % interval of the mean of the normalized metric; None if a repeat with the metric has none."""
        scores = [
            one.score
            for one in self.results
            if normalized_score(one.score, metric) is not None
        ]
        intervals = [
            ends
            for score in scores
            if (ends := score_interval(score, metric)) is not None
        ]
        if not scores or len(intervals) < len(scores):
            return None
        return repeats_interval(
            [normalized_score(score, metric) or 0.0 for score in scores], intervals
        )

    @property
    def percentile(self) -> float | None:
        """Percentage of real trials that are closer to their mean, as mean over the repeats that have it."""
        known = [result.score.percentile for result in self.results]
        spread = ScoreSpread.of([value for value in known if value is not None])
        return None if spread is None else spread.mean

    @property
    def verdict(self) -> str:
        """Verdict of the repeats that finished: one word, or how often each occurs; empty without any."""
        words = [
            one.score.verdict for one in self.results if one.outcome is Outcome.FINISHED
        ]
        counts = {word: words.count(word) for word in words}
        if len(counts) < 2:
            return next(iter(counts), "")
        return ", ".join(f"{count} {word}" for word, count in counts.items())


@dataclass(frozen=True, kw_only=True)
class ExperimentComparison:
    """One experiment in all configurations.

    Attributes:
        id: Gymnasium id.
        kind: Kind of the reference; `none` also where it refuses to score any of the results.
        unit: Unit of the observable.
        cells: Results in the order of `Comparison.configurations`; None for a configuration without this experiment.
        baselines: Published scatter of real trials and scores of three engines, by metric.
        distances: Distance between each two configurations that ran it.
    """

    id: str
    kind: str
    unit: str
    cells: tuple[Cell | None, ...]
    baselines: Mapping[str, Baseline]
    distances: tuple[Distance, ...]

    @property
    def name(self) -> str:
        """Id without `GAUGE/`."""
        return short_id(self.id)

    @property
    def is_solution(self) -> bool:
        """Whether results are compared with the solution of their scene, and not with reality."""
        return Kind(self.kind).is_solution

    @property
    def results(self) -> list[Result]:
        """All results."""
        return [one for cell in self.cells if cell is not None for one in cell.results]

    @property
    def primary(self) -> str:
        """Metric that reports show first, as `Score.primary`; `rmse` without a score."""
        return next(
            (one.score.primary for one in self.results if one.score.primary), "rmse"
        )

    def metrics(self, among: Iterable[str] = tuple(SCORE_METRICS)) -> list[str]:
        """Return the metrics that a result has or whose published scores can stand beside it, the primary first."""
        cells = [cell for cell in self.cells if cell is not None]
        names = [
            name
            for name in among
            if self.published(name) is not None
            or any(cell.spread(name, normalized=False) for cell in cells)
        ]
        return sorted(names, key=lambda name: name != self.primary)

    def unit_of(self, metric: str) -> str:
        """Return the unit of a metric that is not normalized."""
        if metric == OVER_U:
            return next((one.score.distance_unit for one in self.results), self.unit)
        return SCORE_METRICS[metric].unit_of(self.unit)

    def published(self, metric: str) -> Mapping[str, float | None] | None:
        """Return the published scores of a metric by engine; None where nothing comparable was published.

        The paper scored trajectories against the mean of real trials, so RMSE and DTW need a reference of that kind.
        Event metrics do not depend on the reference.
        """
        line = self.baselines.get(metric)
        is_comparable = self.kind == Kind.TRIALS or SCORE_METRICS[metric].is_event
        return line.engines if line is not None and is_comparable else None

    def scored(self) -> ScoredExperiment:
        """Return the scores of this experiment for a comparison within its kind."""
        return ScoredExperiment(
            id=self.id,
            deviations=tuple(
                None if cell is None else cell.deviations for cell in self.cells
            ),
            intervals=tuple(
                None if cell is None else cell.interval_95(self.primary)
                for cell in self.cells
            ),
        )


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Counts of one configuration over all its experiments.

    Attributes:
        ran: Number of experiments that ran.
        scored: Number of those in which every repeat has a normalized RMSE, or a distance from the solution.
        diverged: Number of experiments in which a repeat diverged.
        not_run: Number of experiments that were declined or failed.
    """

    ran: int
    scored: int
    diverged: int
    not_run: int


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
    def labels(self) -> tuple[str, ...]:
        """Label of each configuration."""
        return tuple(configuration_labels(self.configurations))

    def names(self, of: Distance) -> dict[str, str]:
        """Return the labels of the two configurations that a distance is between."""
        return {"first": self.labels[of.first], "second": self.labels[of.second]}

    @cached_property
    def kinds(self) -> tuple[KindComparison, ...]:
        """Ranks within each kind of reference; an experiment of several references is left out."""
        groups = {
            kind: [
                one
                for one in self.experiments
                if one.kind == kind and _has_one_reference(one)
            ]
            for kind in Kind
        }
        return tuple(
            found for group in groups.values() for found in self.compare_within(group)
        )

    def compare_within(
        self, experiments: Sequence[ExperimentComparison]
    ) -> tuple[KindComparison, ...]:
        """Return ranks in experiments of one kind, for each set of constants."""
        if not experiments:
            return ()
        scored = [one.scored() for one in experiments]
        return compare_kind(experiments[0].kind, scored, self._constants)

    @cached_property
    def _constants(self) -> tuple[str, ...]:
        """Name of the constants of each configuration: its parameters, and the scene that it edits."""
        kinds = ("parameters", "asset")
        return tuple(
            ", ".join(
                text
                for kind, text in configuration_parts(one, digits=17)
                if kind in kinds
            )
            for one in self.configurations
        )

    def summaries(self) -> list[Summary]:
        """Return one summary for each configuration, in their order."""
        found = []
        for index in range(len(self.configurations)):
            every = [(one, one.cells[index]) for one in self.experiments]
            cells = [cell for _, cell in every if cell is not None]
            scales = [
                cell.values(OVER_U if one.is_solution else "rmse", normalized=True)
                for one, cell in every
                if cell is not None
            ]
            found.append(
                Summary(
                    ran=sum(cell.ran for cell in cells),
                    scored=sum(None not in values for values in scales),
                    diverged=sum(cell.count(Outcome.DIVERGED) > 0 for cell in cells),
                    not_run=sum(not cell.ran for cell in cells),
                )
            )
        return found


def _has_one_reference(one: ExperimentComparison) -> bool:
    """Return whether all results of an experiment are scored against the same reference."""
    references = {
        (result.score.kind, *sorted(result.dataset.items()))
        for result in one.results
        if result.error is None
    }
    return len(references) <= 1


def compare(results: Iterable[Result]) -> Comparison:
    """Return a comparison of results of any experiments, engines, parameters, settings and seeds.

    Of several results of one experiment the newest revision counts, and of one configuration and seed the latest; notes
    report both.
    """
    given = sorted(results, key=lambda result: result.revision)
    newest = {one.id: one.revision for one in given}
    every = [one for one in given if one.revision == newest[one.id]]
    older = dict.fromkeys(
        short_id(one.id) for one in given if one.revision < newest[one.id]
    )
    notes = [
        f"{name}: results of an older revision are left out; compare them apart"
        for name in older
    ]
    groups = group_by_configuration(every)
    # In the order of `gauge list`; experiments of files follow by name.
    places = {variant.id: place for place, variant in enumerate(variants())}
    experiments = []
    for name in sorted(newest, key=lambda name: (places.get(name, len(places)), name)):
        cells = [_cell(name, members, notes) for _, members in groups]
        experiments.append(_experiment(name, cells))
    return Comparison(
        configurations=tuple(configuration for configuration, _ in groups),
        experiments=tuple(experiments),
        notes=tuple(dict.fromkeys([*notes, *_mismatches(every)])),
    )


def _experiment(name: str, cells: Sequence[Cell | None]) -> ExperimentComparison:
    """Return an experiment in all configurations."""
    present = [
        (index, cell.results) for index, cell in enumerate(cells) if cell is not None
    ]
    results = [result for _, members in present for result in members]
    ran = [result for result in results if result.error is None] or results
    is_refused = all(one.score.refused is not None for one in ran)
    baselines = published_baselines(short_id(name))
    distances = []
    for (index, some), (other_index, others) in combinations(present, 2):
        distance = trajectory_distance(
            (index, other_index), some, others, baselines.get("rmse")
        )
        if distance is not None:
            distances.append(distance)
    return ExperimentComparison(
        id=name,
        kind=Kind.NONE.value if is_refused else ran[0].score.kind,
        unit=ran[0].score.unit,
        cells=tuple(cells),
        baselines=baselines,
        distances=tuple(distances),
    )


def _cell(name: str, members: Sequence[Result], notes: list[str]) -> Cell | None:
    """Return the results of one experiment among those of a configuration, and add what was left out to the notes."""
    mine = [result for result in members if result.id == name]
    latest = {
        result.seed: result
        for result in sorted(mine, key=lambda result: result.created)
    }
    if len(latest) < len(mine):
        notes.append(
            f"{short_id(name)}: {len(mine)} results of {mine[0].backend or 'files'} with "
            f"{counted(len(latest), 'seed')}; the latest of each counts"
        )
    in_force = [result.settings for result in latest.values() if result.error is None]
    if any(settings != in_force[0] for settings in in_force):
        notes.append(
            f"{short_id(name)}: repeats of {mine[0].backend} differ in the settings in force"
        )
    kept = tuple(sorted(latest.values(), key=lambda result: result.seed or 0))
    return Cell(results=kept, deviations=_deviations(kept, notes)) if kept else None


def _deviations(results: Sequence[Result], notes: list[str]) -> Deviations | None:
    """Return the deviations of repeats; None without scores, with a note if they should have some."""
    scores = [one.score for one in results if one.outcome is Outcome.FINISHED]
    if len(scores) < len(results) or any(
        one.primary_normalized is None for one in scores
    ):
        return None
    refused = f"{short_id(results[0].id)}: not ranked, because its"
    try:
        experiment = recorded_experiment(results[0])
        band = reference_band(experiment)
        if band is None:
            return None
        against = choose_yardstick(results[:1], band, names=())
        found = Deviations.of(
            band,
            [against.deviation(one, aligned=is_aligned(one)) for one in results],
            [one.seed for one in results],
            scale=_scale(experiment, band, scores[0].primary),
        )
    except GaugeError as error:
        notes.append(f"{refused} result cannot be scored again: {error}")
        return None
    stored = np.array([one.primary_normalized for one in scores], dtype=np.float64)
    if np.allclose(found.scores, stored, rtol=1e-6, atol=1e-9):
        return found
    notes.append(
        f"{refused} score was made against another reference or motion; run it again"
    )
    return None


def _scale(experiment: Experiment, band: Band, primary: str | None) -> float:
    """Return the distance that is 1 as normalized score; NaN without one."""
    if primary == OVER_U:
        return band.standard_uncertainty
    if primary == ALIGNED.key and band.trial_rmse_aligned is not None:
        return float(band.trial_rmse_aligned.mean())
    line = normalizing_baselines(experiment, band).get("rmse")
    return math.nan if line is None else line.mean


def _mismatches(results: Sequence[Result]) -> list[str]:
    """Return a sentence for each way in which results do not belong together."""
    notes = []
    by_id: dict[str, list[Result]] = {}
    for one in sorted(results, key=lambda one: one.id):
        by_id.setdefault(one.id, []).append(one)
    stale = dict.fromkeys(
        short_id(one.id)
        for one in results
        if one.task_sha256 != task_sha256(find_variant(one.id).family)
    )
    if stale:
        notes.append(
            f"made from another task file than the installed one: {', '.join(stale)}"
        )
    made_with = sorted(
        {one.versions.get("gauge-envs", "an unknown version") for one in results}
    )
    if len(made_with) > 1:
        notes.append(
            f"scored by different versions of gauge-envs: {', '.join(made_with)}"
        )
    for name, same in by_id.items():
        refused = {one.score.refused for one in same} - {None}
        notes += [f"{short_id(name)}: {reason}" for reason in sorted(map(str, refused))]
        kinds = sorted({one.score.kind for one in same})
        if len(kinds) > 1:
            notes.append(
                f"{short_id(name)}: scored against references of kind {' and '.join(kinds)}"
            )
        if len({tuple(sorted(one.dataset.items())) for one in same}) > 1:
            notes.append(
                f"{short_id(name)}: real trials or drivers are of different imports, or bundled"
            )
    return notes
