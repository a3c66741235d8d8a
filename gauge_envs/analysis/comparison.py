"""Engines side by side: results grouped by configuration, their scores, and how far apart their trajectories are.

A configuration is what was under test: the engine and its versions, the parameters of the scene or the edited asset in
their place, the settings that were given, the jitter of the start and what stands for a marker. Results that differ in
nothing but their seed are repeats of one configuration.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import UnknownNameError
from gauge_envs.evaluation.metrics import trajectory_rmse
from gauge_envs.experiments.task_files import task_sha256
from gauge_envs.experiments.variants import find_variant, variants
from gauge_envs.files import versions
from gauge_envs.references.published import Baseline, published_baselines
from gauge_envs.runs.result import Outcome, RecordedTrajectory, Result
from gauge_envs.scene.timing import FRAME_RATE_HZ

__all__ = [
    "METRICS",
    "MOTION_SHARE",
    "Cell",
    "Comparison",
    "RunConfiguration",
    "Distance",
    "ExperimentComparison",
    "Metric",
    "ScoreSpread",
    "Summary",
    "check_metrics",
    "compare",
    "distances_over_time",
    "group_by_configuration",
]

MOTION_SHARE = 0.05
"""Threshold of a distance between two engines, as a share of the motion, where no scatter of real trials is known."""

FRAME_TOLERANCE_S = 1e-4
"""How far a sample may be from a frame and still be its sample [s]; as in scoring."""


# --- what is compared ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A number of `Score` that is compared.

    Attributes:
        raw: Attribute that holds it in its own unit.
        normalized: Attribute that holds it over the mean of the real trials; None where there is no such number.
        published: Name that `published_baselines` has it under; None where nobody published it.
        unit: Its unit; None is that of the observable.
    """

    raw: str
    normalized: str | None
    published: str | None
    unit: str | None = None


METRICS: Mapping[str, Metric] = {
    "rmse": Metric(raw="rmse", normalized="rmse_normalized", published="rmse"),
    "dtw": Metric(raw="dtw", normalized="dtw_normalized", published="dtw"),
    "rmse_aligned": Metric(raw="rmse_aligned", normalized="rmse_aligned_normalized", published=None),
    "lsd": Metric(raw="lsd_s", normalized="lsd_normalized", published="lsd", unit="s"),
    "mte": Metric(raw="mte", normalized="mte_normalized", published="mte", unit="1"),
    "pd": Metric(raw="pd_s", normalized="pd_normalized", published="pd", unit="s"),
    "el": Metric(raw="el", normalized=None, published="el", unit="1"),
}
"""Metrics by name, in the order of tables. `el` is raw always: its ideal is 0, so there is nothing to divide by."""


def check_metrics(names: Iterable[str]) -> tuple[str, ...]:
    """The names without repetition, all metrics where there are none.

    Raises:
        UnknownNameError: One is no metric.
    """
    chosen = tuple(dict.fromkeys(names))
    for name in chosen:
        if name not in METRICS:
            raise UnknownNameError("metric", name, METRICS)
    return chosen or tuple(METRICS)


@dataclass(frozen=True, kw_only=True)
class RunConfiguration:
    """What was under test.

    Attributes:
        backend: Name of the physics engine; None for trajectories that a user brought.
        parameters: Name of the parameter set, or the overrides.
        settings_given: Numerical settings that replace the engine's defaults.
        jitter: Standard deviations that the start was jittered by; empty for none.
        marker_proxy: What stood for a marker on a deformable body.
        asset: File and hash of an asset that differs from the calibrated scene; empty where there is none.
        engine_versions: Versions of the engine's packages.
    """

    backend: str | None
    parameters: str | Mapping[str, Any]
    settings_given: Mapping[str, Any] = field(default_factory=dict)
    jitter: Mapping[str, float] = field(default_factory=dict)
    marker_proxy: str = "node"
    asset: Mapping[str, str] = field(default_factory=dict)
    engine_versions: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, result: Result) -> RunConfiguration:
        """RunConfiguration that a result is of."""
        common = versions()
        return cls(
            backend=result.backend,
            parameters=result.parameters,
            settings_given=result.settings_given,
            jitter=result.jitter,
            marker_proxy=result.marker_proxy,
            asset={key: result.asset[key] for key in ("file", "sha256")} if result.is_edited else {},
            engine_versions={name: text for name, text in result.versions.items() if name not in common},
        )


def group_by_configuration(results: Iterable[Result]) -> list[tuple[RunConfiguration, list[Result]]]:
    """Results of each configuration: by engine, calibrated parameters and default settings first.

    An episode that did not run knows no versions of its engine; it belongs to the first configuration that is equal
    otherwise.
    """
    ordered = sorted(results, key=lambda result: result.error is not None)
    groups: list[tuple[RunConfiguration, list[Result]]] = []
    for result in ordered:
        wanted = RunConfiguration.of(result)
        found = next((members for one, members in groups if _same(one, wanted, ran=result.error is None)), None)
        if found is None:
            groups.append((wanted, [result]))
        else:
            found.append(result)
    return sorted(groups, key=lambda group: _order(group[0]))


def _order(one: RunConfiguration) -> tuple[str, bool, int, str]:
    changes = (one.settings_given, one.jitter, one.asset, one.engine_versions)
    changed = len(one.settings_given) + len(one.jitter) + (one.marker_proxy != "node") + bool(one.asset)
    return (
        one.backend or "",
        one.parameters != "calibrated",
        changed,
        json.dumps((one.parameters, one.marker_proxy, *changes), sort_keys=True),
    )


def _same(one: RunConfiguration, other: RunConfiguration, *, ran: bool) -> bool:
    keys = ("backend", "parameters", "settings_given", "jitter", "marker_proxy", "asset")
    alike = all(getattr(one, key) == getattr(other, key) for key in keys)
    return alike and (not ran or one.engine_versions == other.engine_versions)


# --- one configuration in one experiment -----------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ScoreSpread:
    """Mean and scatter of repeats.

    Attributes:
        mean: Their mean.
        std: Their sample standard deviation (n - 1); None for a single one.
        count: How many.
    """

    mean: float
    std: float | None
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> ScoreSpread | None:
        """ScoreSpread of the values; None when there are none."""
        if not values:
            return None
        std = float(np.std(values, ddof=1)) if len(values) > 1 else None
        return cls(mean=float(np.mean(values)), std=std, count=len(values))


@dataclass(frozen=True, kw_only=True)
class Cell:
    """What one configuration did in one experiment.

    Attributes:
        results: Its repeats by seed, those that were declined, failed or diverged included.
    """

    results: tuple[Result, ...]

    def count(self, outcome: Outcome) -> int:
        """How many of the repeats ended like this."""
        return sum(result.outcome is outcome for result in self.results)

    @property
    def ran(self) -> bool:
        """Whether any of the repeats ran, to whichever end."""
        return any(result.error is None for result in self.results)

    def values(self, metric: Metric, *, normalized: bool) -> list[float | None]:
        """The metric of each repeat, in their order; None where it has none."""
        name = metric.normalized if normalized else metric.raw
        return [None if name is None else getattr(result.score, name) for result in self.results]

    def spread(self, metric: Metric, *, normalized: bool) -> ScoreSpread | None:
        """Mean and scatter over the repeats that have the metric."""
        return ScoreSpread.of([value for value in self.values(metric, normalized=normalized) if value is not None])

    @property
    def normalized_rmse(self) -> float | None:
        """Mean normalized RMSE; None unless every repeat has one, as the mean of survivors would flatter."""
        values = self.values(METRICS["rmse"], normalized=True)
        kept = [value for value in values if value is not None]
        return float(np.mean(kept)) if kept and len(kept) == len(values) else None

    @property
    def times_s(self) -> tuple[float, float]:
        """Wall time and simulated time of all repeats whose wall time is known [s]."""
        timed = [(result.wall_s, result.sim_s) for result in self.results if result.wall_s is not None]
        return sum(wall for wall, _ in timed), sum(simulated for _, simulated in timed)

    @property
    def wall_s_per_sim_s(self) -> float | None:
        """Wall seconds per simulated second; None where it is not known."""
        return _ratio(*self.times_s)


def _ratio(wall_s: float, sim_s: float) -> float | None:
    return wall_s / sim_s if sim_s > 0.0 and wall_s > 0.0 else None


# --- two configurations in one experiment ----------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Distance:
    """How far apart the trajectories of two configurations are, at the 30 Hz frames that both have.

    The distance at a frame is Euclidean over all coordinates, as in E_RMSE. Repeats are compared seed by seed; where
    the two have no seed in common, each with each.

    Attributes:
        first: Index of the one configuration.
        second: Index of the other.
        unit: Unit of the lengths.
        rms: Root-mean-square distance over the common frames, mean and scatter over the pairs of repeats.
        motion_rms: Root mean square of how far the two are from where they started, over the same frames and pairs.
        threshold: Distance that counts as apart.
        threshold_is_scatter: Whether it is the published mean RMSE of real trials; else `MOTION_SHARE` of `motion_rms`.
        apart_at_s: First frame at which any pair is farther apart than that [s]; None when none is.
        frames: Common frames of the shortest pair.
        diverged: Whether one of the trajectories ended because it diverged.
    """

    first: int
    second: int
    unit: str
    rms: ScoreSpread
    motion_rms: float
    threshold: float
    threshold_is_scatter: bool
    apart_at_s: float | None
    frames: int
    diverged: bool


def _distance(first: int, second: int, cells: Sequence[Cell | None], baseline: Baseline | None) -> Distance | None:
    """Distance of two cells; None when one of them did not run, or they share no frame."""
    one, other = cells[first], cells[second]
    if one is None or other is None:
        return None
    pairs = _paired(one.results, other.results)
    courses = [common for pair in pairs if (common := _common_frames(*pair)) is not None]
    rms = ScoreSpread.of([trajectory_rmse(a, b) for _, a, b in courses])
    if rms is None:
        return None
    motion = [np.vstack((a - a[0], b - b[0])) for _, a, b in courses]
    motion_rms = float(np.mean([trajectory_rmse(way, np.zeros_like(way)) for way in motion]))
    threshold = MOTION_SHARE * motion_rms if baseline is None else baseline.mean
    crossings = [
        times_s[beyond.argmax()]
        for times_s, distance in distances_over_time(one.results, other.results)
        if (beyond := distance > threshold).any()
    ]
    return Distance(
        first=first,
        second=second,
        unit=pairs[0][0].score.unit,
        rms=rms,
        motion_rms=motion_rms,
        threshold=threshold,
        threshold_is_scatter=baseline is not None,
        apart_at_s=float(min(crossings)) if crossings else None,
        frames=min(len(frames) for frames, _, _ in courses),
        diverged=any(result.diverged for pair in pairs for result in pair),
    )


def distances_over_time(
    some: Sequence[Result], others: Sequence[Result]
) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Distance between results of two configurations at each frame that both have, paired as `Distance` says.

    Returns:
        For each pair of repeats the times [s] and the distances in the observable's unit, both of shape [frame_count].
    """
    courses = (_common_frames(*pair) for pair in _paired(some, others))
    return [(c[0] / FRAME_RATE_HZ, np.linalg.norm(c[1] - c[2], axis=1)) for c in courses if c is not None]


def _paired(some: Sequence[Result], others: Sequence[Result]) -> list[tuple[Result, Result]]:
    every = [(a, b) for a, b in product(some, others) if a.trajectory is not None and b.trajectory is not None]
    # The same seed means the same jittered start, so what differs between the two is the engine alone.
    same_seed = [(a, b) for a, b in every if a.seed == b.seed]
    return same_seed or every


def _common_frames(
    one: Result, other: Result
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]] | None:
    """Frame numbers that both have, and g(t) of each there, shape [frame_count, coordinate_count]."""
    if one.trajectory is None or other.trajectory is None:
        return None
    if one.trajectory.coordinates != other.trajectory.coordinates:
        return None
    (frames_a, a), (frames_b, b) = _frames(one.trajectory), _frames(other.trajectory)
    common, index_a, index_b = np.intersect1d(frames_a, frames_b, return_indices=True)
    return (common, a[index_a], b[index_b]) if len(common) else None


def _frames(trajectory: RecordedTrajectory) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Numbers of the 30 Hz frames that were recorded and are finite, and g(t) there."""
    times_s, samples = trajectory.arrays()
    frames = np.rint(times_s * FRAME_RATE_HZ).astype(np.int64)
    hits = (np.abs(times_s - frames / FRAME_RATE_HZ) < FRAME_TOLERANCE_S) & np.isfinite(samples).all(axis=1)
    return frames[hits], samples[hits]


# --- the whole -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ExperimentComparison:
    """One experiment on all configurations.

    Attributes:
        id: Gymnasium id.
        grade: Grade of the reference that it was scored against.
        unit: Unit of the observable.
        cells: What each configuration did, in the order of `Comparison.configurations`; None where it was not run.
        baselines: Scatter of real trials and scores of three engines as published, by metric.
        distances: How far apart the configurations are, for each two that ran it.
    """

    id: str
    grade: str
    unit: str
    cells: tuple[Cell | None, ...]
    baselines: Mapping[str, Baseline]
    distances: tuple[Distance, ...]

    @property
    def name(self) -> str:
        """Id without `GAUGE/`."""
        return self.id.removeprefix("GAUGE/")

    def metrics(self, among: Iterable[str] = tuple(METRICS)) -> list[str]:
        """Those of the metrics that a result has or that were published."""
        return [
            name
            for name in among
            if METRICS[name].published in self.baselines
            or any(cell is not None and cell.spread(METRICS[name], normalized=False) for cell in self.cells)
        ]


@dataclass(frozen=True, kw_only=True)
class Summary:
    """One configuration over all its experiments. Descriptive: the experiments are neither alike nor independent.

    Attributes:
        ran: Experiments that it ran.
        scored: Those of them in which every repeat has a normalized RMSE.
        diverged: Experiments in which a repeat diverged.
        not_run: Experiments that it declined or failed in.
        geometric_mean: Geometric mean of the normalized RMSE over `Comparison.scored_by_all`; None when that is empty.
        wall_s_per_sim_s: Wall seconds per simulated second over all that it ran.
        wall_s_per_sim_s_common: The same over `Comparison.run_by_all`.
    """

    ran: int
    scored: int
    diverged: int
    not_run: int
    geometric_mean: float | None
    wall_s_per_sim_s: float | None
    wall_s_per_sim_s_common: float | None


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Configurations side by side.

    Attributes:
        configurations: What was under test.
        experiments: Each experiment on all of them, in the order of `gauge list`.
        notes: What a reader should know of the results: repeats left out, and files that do not belong together.
    """

    configurations: tuple[RunConfiguration, ...]
    experiments: tuple[ExperimentComparison, ...]
    notes: tuple[str, ...]

    @property
    def scored_by_all(self) -> tuple[ExperimentComparison, ...]:
        """Experiments in which every configuration has a normalized RMSE."""
        return tuple(
            one
            for one in self.experiments
            if all(cell is not None and cell.normalized_rmse is not None for cell in one.cells)
        )

    @property
    def run_by_all(self) -> tuple[ExperimentComparison, ...]:
        """Experiments that every configuration ran, to whichever end."""
        return tuple(one for one in self.experiments if all(cell is not None and cell.ran for cell in one.cells))

    def summaries(self) -> tuple[Summary, ...]:
        """One for each configuration, in their order."""
        return tuple(self._summary(index) for index in range(len(self.configurations)))

    def published_geometric_mean(self, engine: str) -> float | None:
        """Geometric mean of an engine's published normalized RMSE over `scored_by_all`; None unless it has them all."""
        values = [one.baselines["rmse"].engines[engine] for one in self.scored_by_all if "rmse" in one.baselines]
        return _geometric_mean(values) if len(values) == len(self.scored_by_all) else None

    def _summary(self, index: int) -> Summary:
        cells = [cell for one in self.experiments if (cell := one.cells[index]) is not None]
        common = [cell for one in self.run_by_all if (cell := one.cells[index]) is not None]
        scores = [cell.normalized_rmse for one in self.scored_by_all if (cell := one.cells[index]) is not None]
        return Summary(
            ran=sum(cell.ran for cell in cells),
            scored=sum(cell.normalized_rmse is not None for cell in cells),
            diverged=sum(cell.count(Outcome.DIVERGED) > 0 for cell in cells),
            not_run=sum(not cell.ran for cell in cells),
            geometric_mean=_geometric_mean(scores),
            wall_s_per_sim_s=_cost(cells),
            wall_s_per_sim_s_common=_cost(common),
        )


def _geometric_mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    if not known or len(known) < len(values):
        return None
    # A score of exactly 0, which a law can have, makes the mean 0; its logarithm would be a warning.
    return 0.0 if min(known) <= 0.0 else float(np.exp(np.mean(np.log(known))))


def _cost(cells: Iterable[Cell]) -> float | None:
    times = [cell.times_s for cell in cells]
    return _ratio(sum(wall for wall, _ in times), sum(simulated for _, simulated in times))


def compare(results: Iterable[Result]) -> Comparison:
    """Put results of any experiments, engines, parameters, settings and seeds side by side.

    Of several results of one experiment, configuration and seed the latest counts, and a note says so.
    """
    every = list(results)
    groups = group_by_configuration(every)
    notes: list[str] = []
    by_id = {
        name: tuple(_cell(name, members, notes) for _, members in groups)
        for name in sorted({result.id for result in every}, key=_list_order)
    }
    experiments = []
    for name, cells in by_id.items():
        first = next(result for cell in cells if cell is not None for result in cell.results)
        baselines = published_baselines(name.removeprefix("GAUGE/"))
        pairs = combinations(range(len(cells)), 2)
        distances = (_distance(one, other, cells, baselines.get("rmse")) for one, other in pairs)
        experiments.append(
            ExperimentComparison(
                id=name,
                grade=first.score.grade,
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
    """Place in `gauge list`; those of experiment files come after it, by name."""
    places = {variant.id: place for place, variant in enumerate(variants())}
    return places.get(name, len(places)), name


def _cell(name: str, members: Sequence[Result], notes: list[str]) -> Cell | None:
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
    return Cell(results=kept) if kept else None


def _mismatches(results: Sequence[Result]) -> list[str]:
    """Ways in which results do not belong together, a sentence each."""
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
