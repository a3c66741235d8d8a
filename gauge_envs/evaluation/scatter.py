"""Whether runs with starts and releases that scatter as real ones do scatter as real trials do.

For 53 variants the mean and the standard deviation over real trials of E_RMSE and E_DTW are published, each trial
against the mean of all of them, itself included. The trials are not. So a group of as many runs gives four numbers of
the same construction, and many groups give their distribution, against which the published four are tested.

Two things of a real trial are not known: where its body starts, and when it is released.

- Starts are those of `scene.jitter`. The answer is given for half, once and twice its standard deviations, and for
  uneven trials: a quarter of half and a quarter of twice the spread, with releases that are exponential.
- A body is late by |N(0, s)|, and rests until then. E_RMSE grows with s, and E_DTW hardly beyond the distance of two
  frames. So s is fitted in each group, the real one included.

With y the logarithms of the four numbers, m(s) their mean over groups and C(s) their covariance, s is the one whose
mean RMSE is that of y, and the statistic is T = (y - m)' C^-1 (y - m) there: E_DTW and the two standard deviations
judge the runs. The p-value is the share of groups with that s whose own T is as large.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.published import Baseline, published_variants
from gauge_envs.references.scatter import HeldRow, held_rows, scatter_rows
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.jitter import Jitter, jittered
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S

TRIAL_COUNT = 20
"""Number of real trials of each variant (paper, "Data Acquisition")."""

SPREADS = (0.5, 1.0, 2.0)
"""Spreads of the start for which the answer is given, over the assumed one."""

ASSUMED = "x 1"
"""Name of the answer for the assumed spread."""

UNEVEN_SHARES = (0.25, 0.5, 0.25)
"""Shares of the trials of uneven groups that have these spreads. They are a choice."""

LEVEL = 0.05
"""Level of the test."""

VERDICTS = {
    True: "unlike real trials, with half to twice the assumed spread of starts",
    None: "hangs on the spread of real starts, which is assumed",
    False: "no difference from the scatter of real trials is seen",
}
"""The answer in words: whether the runs scatter unlike real trials."""

SHORT_VERDICTS = {
    True: "unlike real trials",
    None: "hangs on the starts",
    False: "no difference seen",
}
"""The same in tables."""

RELEASES_S = (0.0, 0.0025, 0.005, 0.01, 0.014, 0.02, 0.028, 0.04, 0.056, 0.08, 0.12)
"""Spreads s of the release at which groups are drawn [s], up to twice the largest one that trials show: 0.056 s
(SlopeSlider-2). Between them, mean and covariance are linear in the index."""

_STEPS = 5  # of the release between two of them
_MODEL_GROUPS = 100
_NULL_GROUPS = 300
_PAIRS = 2000  # trials that are aligned at once
_ROUNDED_SHARE = 0.01  # of the published numbers: they have two digits or more
_NORMAL_95 = 1.96
# Paths whose costs differ by less than this share are tied, as in `metrics.trajectory`.
_TIE = 1e-12


@dataclass(frozen=True, kw_only=True)
class Spread:
    """The answer for one assumption on the starts.

    Attributes:
        starts: The assumption: a factor of the jitter, as `x 0.5`, or `uneven`.
        release_s: Spread of the release with which the mean RMSE is the real one, or closest to it [s].
        release_95_s: 95 % interval of it [s].
        simulated: Mean and standard deviation of E_RMSE, then of E_DTW, geometric means over groups of runs.
        p_value: Share of groups that are as far from these as the real one, or farther.
    """

    starts: str
    release_s: float
    release_95_s: tuple[float, float]
    simulated: tuple[float, float, float, float]
    p_value: float


@dataclass(frozen=True, kw_only=True)
class Scatter:
    """Scatter of runs beside the published scatter of real trials.

    Attributes:
        unit: Unit of the distances.
        run_count: Number of runs with each spread of the start.
        trial_count: Number of real trials, and of runs in a group.
        real: Published mean and standard deviation of E_RMSE, then of E_DTW.
        spreads: The answer for each assumption on the starts.
        verdict: The answer in words, with what was assumed, or why there is none.
    """

    unit: str
    run_count: int
    trial_count: int
    real: tuple[float, float, float, float]
    spreads: tuple[Spread, ...]
    verdict: str

    @property
    def differs(self) -> bool | None:
        """Whether the runs scatter unlike real trials; None where it hangs on the assumed starts."""
        return differs([one.p_value for one in self.spreads])


def differs(p_values: Sequence[float]) -> bool | None:
    """Return whether all assumptions on the starts refuse that runs scatter as real trials; None if only some do."""
    answers = {p_value < LEVEL for p_value in p_values}
    return answers.pop() if len(answers) == 1 else None


def scatter_ranks(found: Sequence[Scatter | None]) -> list[int | None]:
    """Return ranks of configurations in an experiment: 1 where no difference from real trials is seen, before others.

    A configuration whose answer hangs on the starts has none, and none has one where all answers are the same.
    """
    answers = [None if one is None else one.differs for one in found]
    alike = answers.count(False)
    if not (alike and True in answers):
        return [None] * len(answers)
    ranks = {False: 1, True: 1 + alike, None: None}
    return [ranks[answer] for answer in answers]


def check_starts(experiment: Experiment, jitter: Jitter) -> None:
    """Check that there is something that a hand places, so that the scatter of starts can be assumed.

    Raises:
        ParameterError: All bodies are held. It states what the published scatter of real trials is, if there is one.
    """
    try:
        jittered(experiment.scene, jitter, seed=0)
    except ParameterError as error:
        published = scatter_text(experiment)
        if published == "-":
            raise
        raise ParameterError(
            f"{error}. The published scatter: {published} (docs/coverage.md)"
        ) from error


def scatter_text(experiment: Experiment) -> str:
    """Return what the test says of MuJoCo and what it can tell; `-` without published numbers."""
    if published_numbers(experiment.baselines) is None:
        return "-"
    if experiment.impossible_scores:
        return "published in another unit: not tested"
    held = held_rows().get(experiment.name)
    if held is not None:
        if held.real["rmse_std"] > held.real["rmse"]:
            return f"one trial is {farthest_trial(held):.2g} {held.unit} off or more: tells nothing of an engine"
        return (
            f"marker noise of {held.noise_mm:.2g} ({held.noise_std_mm:.2g}) mm gives it, moving or not: tells nothing "
            "of an engine"
        )
    row = scatter_rows().get(experiment.name)
    if row is None:
        return "published; not tested"
    answer = SHORT_VERDICTS[differs([*row.p.values()])]
    factor = (
        "no factor up to 4" if row.factor is None else f"a factor of {row.factor:g}"
    )
    return f"MuJoCo: {answer}; tells {factor} of E_DTW"


def farthest_trial(row: HeldRow) -> float:
    """Return a distance that at least one real trial has, in the unit of its variant.

    Distances of 0 or more with the mean m and the variance v are not all below m + v / m (Bhatia and Davis, "A better
    bound on the variance", 2000).
    """
    variance = (TRIAL_COUNT - 1) / TRIAL_COUNT * row.real["rmse_std"] ** 2
    return row.real["rmse"] + variance / row.real["rmse"]


def scatter_test(
    experiment: Experiment, samples: Mapping[float, FloatArray], *, seed: int = 0
) -> Scatter:
    """Test whether runs scatter as the real trials of their experiment do.

    Args:
        experiment: The experiment, with published scores.
        samples: g(t) of runs that are released at time 0, 180 samples a second, by the spread of their starts over the
            assumed one; each of shape [run_count, sample_count, coordinate_count].
        seed: Seed of the groups.
    """
    frame_count = experiment.baselines["rmse"].frames
    models = group_models(samples, frame_count, seed=seed)
    scatter = refused_scatter(experiment, "")
    spreads = tuple(
        model.answer(np.asarray(scatter.real), starts)
        for starts, model in models.items()
    )
    return replace(
        scatter,
        run_count=min(map(len, samples.values())),
        spreads=spreads,
        verdict=VERDICTS[differs([one.p_value for one in spreads])],
    )


def refused_scatter(experiment: Experiment, reason: str) -> Scatter:
    """Return the published scatter of an experiment, without an answer, and why there is none."""
    real = published_numbers(experiment.baselines)
    if real is None:
        raise UnknownNameError(
            "variant with a published scatter", experiment.name, published_variants()
        )
    return Scatter(
        unit=experiment.baselines["rmse"].unit,
        run_count=0,
        trial_count=TRIAL_COUNT,
        real=real,
        spreads=(),
        verdict=f"none: {reason}",
    )


def published_numbers(
    baselines: Mapping[str, Baseline],
) -> tuple[float, float, float, float] | None:
    """Return the published mean and standard deviation of E_RMSE, then of E_DTW; None where one is not published."""
    known = [baselines[key] for key in ("rmse", "dtw") if key in baselines]
    numbers = [(one.mean, one.std) for one in known if one.std]
    if len(numbers) < 2:
        return None
    (rmse, rmse_std), (dtw, dtw_std) = numbers
    return rmse, rmse_std, dtw, dtw_std


def group_models(
    samples: Mapping[float, FloatArray],
    frame_count: int,
    *,
    seed: int = 0,
) -> dict[str, GroupModel]:
    """Return the distribution of groups for each assumption on the starts; arguments as of `scatter_test`."""
    models = {
        f"x {share:g}": GroupModel(runs, frame_count, seed=seed)
        for share, runs in samples.items()
    }
    if set(SPREADS) <= set(samples):
        runs = np.concatenate([samples[share] for share in SPREADS])
        chances = np.concatenate(
            [
                np.full(len(samples[share]), part / len(samples[share]))
                for share, part in zip(SPREADS, UNEVEN_SHARES, strict=True)
            ]
        )
        models["uneven"] = GroupModel(runs, frame_count, chances=chances, seed=seed)
    return models


class GroupModel:
    """Distribution of the four numbers of groups of runs, by the spread of the release.

    Args:
        samples: g(t) of runs, shape [run_count, sample_count, coordinate_count].
        frame_count: Number of 30 Hz frames that are compared.
        chances: Chance of each run to be drawn, shape [run_count]; None for equal ones. Other chances come with
            releases that are exponential.
        seed: Seed of the groups.
    """

    def __init__(
        self,
        samples: FloatArray,
        frame_count: int,
        *,
        chances: FloatArray | None = None,
        seed: int = 0,
    ) -> None:
        self._samples = samples
        self._frame_count = frame_count
        self._chances = chances
        self._random = np.random.default_rng(seed)
        self._nulls: dict[int, FloatArray] = {}
        # The same runs and delays at every spread, so that the mean is smooth in it.
        runs, delays = self._drawn(_MODEL_GROUPS)
        logs = [
            np.log(self._scores(runs, spread_s * delays)) for spread_s in RELEASES_S
        ]
        last = len(RELEASES_S) - 1
        fine = np.linspace(0.0, last, last * _STEPS + 1)
        low = np.minimum(fine.astype(int), last - 1)
        share = (fine - low)[:, None]
        self._releases_s = np.interp(fine, np.arange(last + 1), RELEASES_S)
        means = np.array([one.mean(axis=0) for one in logs])
        self._means = (1.0 - share) * means[low] + share * means[low + 1]
        rounding = _ROUNDED_SHARE**2 * np.eye(4)
        covariances = np.array([np.cov(one.T) + rounding for one in logs])
        share = share[:, :, None]
        self._covariances = (1.0 - share) * covariances[low] + share * covariances[
            low + 1
        ]

    def answer(self, real: FloatArray, starts: str) -> Spread:
        """Return the answer for a real group.

        Args:
            real: Mean and standard deviation of E_RMSE, then of E_DTW.
            starts: What is assumed on the starts.
        """
        logs = np.log(real)[None]
        statistics, releases = self._fitted(logs)
        statistic, best = statistics[0], int(releases[0])
        # Spreads with which an RMSE as far from its mean is in the 95 % of a normal distribution.
        rmse_std = np.sqrt(self._covariances[:, 0, 0])
        is_likely = np.abs(logs[0, 0] - self._means[:, 0]) <= _NORMAL_95 * rmse_std
        is_likely[best] = True
        fitting = self._releases_s[is_likely]
        null = self._null(best)
        larger = np.count_nonzero(null >= statistic)
        mean_rmse, std_rmse, mean_dtw, std_dtw = np.exp(self._means[best]).tolist()
        return Spread(
            starts=starts,
            release_s=float(self._releases_s[best]),
            release_95_s=(float(fitting[0]), float(fitting[-1])),
            simulated=(mean_rmse, std_rmse, mean_dtw, std_dtw),
            p_value=float((1.0 + larger) / (1.0 + len(null))),
        )

    def _null(self, release: int) -> FloatArray:
        """Return T of new groups whose release has the spread of an index, shape [group_count]."""
        if release not in self._nulls:
            runs, delays = self._drawn(_NULL_GROUPS, from_sample=True)
            scores = self._scores(runs, self._releases_s[release] * delays)
            self._nulls[release] = self._fitted(np.log(scores))[0]
        return self._nulls[release]

    def _drawn(
        self, count: int, *, from_sample: bool = False
    ) -> tuple[NDArray[np.intp], FloatArray]:
        """Return the numbers of the runs of groups, and delays of a spread of 1; shape [count, trial_count] each.

        Args:
            count: Number of groups.
            from_sample: Whether the runs of each group are drawn from a sample of as many runs as there are, drawn for
                this group. The runs themselves are such a sample of all starts, so this adds their own error.
        """
        shape, run_count = (count, TRIAL_COUNT), len(self._samples)
        if from_sample:
            pools = self._random.choice(
                run_count, size=(count, run_count), p=self._chances
            )
            places = self._random.integers(run_count, size=shape)
            runs = np.take_along_axis(pools, places, axis=1)
        else:
            runs = self._random.choice(run_count, size=shape, p=self._chances)
        if self._chances is None:
            return runs, np.abs(self._random.standard_normal(shape))
        return runs, self._random.exponential(size=shape)

    def _scores(self, runs: NDArray[np.intp], delays_s: FloatArray) -> FloatArray:
        trials = delayed(self._samples, runs, delays_s, self._frame_count)
        return group_scores(trials)

    def _fitted(self, logs: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
        """Return T of groups, and the index of the release with the mean RMSE of each, shape [group_count] each.

        Args:
            logs: Logarithms of the four numbers of groups, shape [group_count, 4].
        """
        releases = np.abs(logs[:, :1] - self._means[:, 0]).argmin(axis=1)
        from_mean = (logs - self._means[releases])[:, :, None]
        scaled = np.linalg.solve(self._covariances[releases], from_mean)
        return (from_mean * scaled).sum(axis=(1, 2)), releases


def delayed(
    samples: FloatArray, runs: NDArray[np.intp], delays_s: FloatArray, frame_count: int
) -> FloatArray:
    """Return g(t) of runs at the 30 Hz frames, each released late and at rest until then.

    Args:
        samples: g(t) of all runs, shape [run_count, sample_count, coordinate_count].
        runs: Numbers of the runs, any shape.
        delays_s: Delay of each [s], the same shape.
        frame_count: Number of frames.

    Returns:
        g(t), linear between samples; that shape, then [frame_count, coordinate_count].
    """
    frames_s = np.arange(frame_count) / FRAME_RATE_HZ
    places = np.maximum(frames_s - delays_s[..., None], 0.0) / SAMPLE_INTERVAL_S
    before = np.minimum(places.astype(int), samples.shape[1] - 2)
    share = (places - before)[..., None]
    numbers = runs[..., None]
    return (1.0 - share) * samples[numbers, before] + share * samples[
        numbers, before + 1
    ]


def group_scores(trials: FloatArray) -> FloatArray:
    """Return mean and standard deviation of E_RMSE, then of E_DTW, of groups of trials against their own mean.

    Args:
        trials: g(t), shape [group_count, trial_count, frame_count, coordinate_count].

    Returns:
        The four numbers of each group, shape [group_count, 4]; standard deviations over trial_count - 1.
    """
    means = np.broadcast_to(trials.mean(axis=1, keepdims=True), trials.shape)
    squares = np.square(trials - means).sum(axis=-1)
    rmse = np.sqrt(squares.mean(axis=-1))
    pairs = (-1, *trials.shape[2:])
    firsts, seconds = trials.reshape(pairs), means.reshape(pairs)
    count = -(-len(firsts) // _PAIRS)
    dtw = np.concatenate(
        [
            dtw_of_pairs(first, second)
            for first, second in zip(
                np.array_split(firsts, count),
                np.array_split(seconds, count),
                strict=True,
            )
        ]
    ).reshape(rmse.shape)
    return np.column_stack(
        [
            rmse.mean(axis=1),
            rmse.std(axis=1, ddof=1),
            dtw.mean(axis=1),
            dtw.std(axis=1, ddof=1),
        ]
    )


def dtw_of_pairs(firsts: FloatArray, seconds: FloatArray) -> FloatArray:
    """Return `metrics.trajectory.trajectory_dtw` of many pairs at once, without missing values.

    Where several paths have the least cost, the number of cells may be that of another one.

    Args:
        firsts: Trajectories, shape [pair_count, frame_count, coordinate_count].
        seconds: Their partners, the same shape.
    """
    first, second = (np.moveaxis(one, 0, -1).copy() for one in (firsts, seconds))
    frame_count, _, pair_count = first.shape
    # Cost and cell count of the best path to each cell of a row; the row above the first one has its start alone.
    cost = np.full((frame_count + 1, pair_count), np.inf)
    cells = np.zeros((frame_count + 1, pair_count))
    cost[0] = 0.0
    for row in first:
        local = np.sqrt(np.square(row - second).sum(axis=1))
        new_cost, new_cells = np.full_like(cost, np.inf), np.zeros_like(cells)
        for column in range(frame_count):
            up, left, diagonal = cost[column + 1], new_cost[column], cost[column]
            is_up = up <= left
            straight = np.where(is_up, up, left)
            is_diagonal = diagonal <= straight * (1.0 + _TIE)
            new_cost[column + 1] = local[column] + np.where(
                is_diagonal, diagonal, straight
            )
            straight_cells = np.where(is_up, cells[column + 1], new_cells[column])
            new_cells[column + 1] = 1.0 + np.where(
                is_diagonal, cells[column], straight_cells
            )
        cost, cells = new_cost, new_cells
    return np.asarray(cost[-1] / cells[-1])
