"""Groups of runs as many as the real trials, and the distribution of their scores; `scatter` says what for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from gauge_envs.evaluation.metrics.trajectory import frame_distances
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.observer import observe_markers
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S

TRIAL_COUNT = 20
"""Number of real trials of each variant (paper, "Data Acquisition")."""

SPREADS = (0.5, 1.0, 2.0)
"""Spreads of the start for which the answer is given, over the assumed one."""

UNEVEN_SHARES = (0.25, 0.5, 0.25)
"""Shares of the trials of uneven groups that have these spreads. They are a choice."""

RELEASES_S = (0.0, 0.0025, 0.005, 0.01, 0.014, 0.02, 0.028, 0.04, 0.056, 0.08, 0.12)
"""Spreads s of the release at which groups are drawn [s], up to twice the largest one that trials show: 0.056 s
(SlopeSlider-2). Between them, mean and covariance are linear in the index."""

HELD_LATE_S = 0.04
"""Spread of the start of the drive of a held body [s]. It is a choice: about a frame, as of rigid bodies."""

HELD_FRAMES = 45
"""Most frames of a held body that are compared: 1.5 s, in which rods and grips of all but FoamTwisting come to rest."""

NOISES_MM = (0.0, 0.02, 0.03, 0.045, 0.065, 0.1, 0.15, 0.22, 0.35)
"""Spreads of the noise of marker coordinates at which groups are drawn [mm]."""

_NOISE_STEP_MM = 0.05  # with which the response of g(t) to noise is measured

_NOISES = 60  # realizations of the noise of a trial

_STEPS = 5  # of the release between two of them

_NOISE_STEPS = 40  # of the noise, to which E_RMSE of many markers is so sensitive

_MODEL_GROUPS = 100

_NULL_GROUPS = 300

_HELD_SHARE = (
    0.5  # of these groups for held bodies, whose wide g(t) takes longer to align
)

_PAIRS = 2000  # trials that are aligned at once

_WIDE = 9  # coordinates above which distances of frames are products of matrices

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
            Of a held body, the one that is assumed.
        release_95_s: 95 % interval of it [s].
        noise_mm: Spread of the noise of the markers of a held body that gives the real mean RMSE [mm].
        simulated: Mean and standard deviation of E_RMSE, then of E_DTW, geometric means over groups of runs.
        p_value: Share of groups that are as far from these as the real one, or farther.
    """

    starts: str
    release_s: float
    release_95_s: tuple[float, float]
    noise_mm: float = 0.0
    simulated: tuple[float, float, float, float]
    p_value: float


def experiment_models(
    experiment: Experiment,
    samples: Mapping[float, FloatArray],
    *,
    markers_m: FloatArray | None = None,
    seed: int = 0,
) -> dict[str, GroupModel]:
    """Return the distribution of groups for each assumption on the starts; arguments as of `scatter_test`."""
    frame_count = experiment.baselines["rmse"].frames
    if markers_m is None:
        return group_models(samples, frame_count, seed=seed)
    runs = samples[1.0]
    mean = runs.mean(axis=0)
    # Misplacements are so small that g(t) is linear in them.
    samples = {share: mean + share * (runs - mean) for share in SPREADS}
    noise = marker_noise(experiment, markers_m[:HELD_FRAMES])
    return group_models(samples, min(frame_count, HELD_FRAMES), noise=noise, seed=seed)


def marker_noise(experiment: Experiment, markers_m: FloatArray) -> FloatArray:
    """Return the change of g(t) by white noise of 1 mm of each marker coordinate, as g(t) is linear in small noise.

    Args:
        experiment: The experiment.
        markers_m: Markers of a motion [m], shape [frame_count, marker_count, 3].

    Returns:
        Shape [realization_count, frame_count, coordinate_count].
    """
    markers = experiment.scene.markers
    assert markers is not None, "held cloth and foam are observed by markers"
    observed = partial(
        observe_markers, markers=markers, observable=experiment.score.observable
    )
    shape = (_NOISES, *markers_m.shape)
    drawn = np.random.default_rng(0).standard_normal(shape)
    noisy_m = markers_m + 1e-3 * _NOISE_STEP_MM * drawn
    g = observed(noisy_m.reshape(-1, *shape[2:])).reshape(*shape[:2], -1)
    return (g - observed(markers_m)) / _NOISE_STEP_MM


def group_models(
    samples: Mapping[float, FloatArray],
    frame_count: int,
    *,
    noise: FloatArray | None = None,
    seed: int = 0,
) -> dict[str, GroupModel]:
    """Return the distribution of groups for each assumption on the starts; arguments as of `GroupModel`."""
    make = partial(GroupModel, frame_count=frame_count, noise=noise, seed=seed)
    models = {f"x {share:g}": make(runs) for share, runs in samples.items()}
    if set(SPREADS) <= set(samples):
        runs = np.concatenate([samples[share] for share in SPREADS])
        chances = np.concatenate(
            [
                np.full(len(samples[share]), part / len(samples[share]))
                for share, part in zip(SPREADS, UNEVEN_SHARES, strict=True)
            ]
        )
        models["uneven"] = make(runs, chances=chances)
    return models


@dataclass(frozen=True, kw_only=True)
class Draws:
    """What is drawn for the trials of groups; shape [group_count, trial_count] each.

    Attributes:
        runs: Numbers of the runs.
        delays: Delays, of a spread of 1.
        noises: Numbers of the realizations of noise; None without noise.
    """

    runs: IntArray
    delays: FloatArray
    noises: IntArray | None


class GroupModel:
    """Distribution of the four numbers of groups of runs, by the spread of the release, or of the noise of markers.

    Args:
        samples: g(t) of runs, shape [run_count, sample_count, coordinate_count].
        frame_count: Number of 30 Hz frames that are compared.
        chances: Chance of each run to be drawn, shape [run_count]; None for equal ones. Other chances come with
            releases that are exponential.
        noise: Change of g(t) by the noise of the markers of a held body, as `marker_noise` returns it.
        seed: Seed of the groups.
    """

    def __init__(
        self,
        samples: FloatArray,
        frame_count: int,
        *,
        chances: FloatArray | None = None,
        noise: FloatArray | None = None,
        seed: int = 0,
    ) -> None:
        self._samples = samples
        self._frame_count = frame_count
        self._chances = chances
        self._noise = noise
        self._random = np.random.default_rng(seed)
        self._nulls: dict[int, FloatArray] = {}
        levels = RELEASES_S if noise is None else NOISES_MM
        # The same runs, delays and noise at every level, so that the mean is smooth in it.
        self._share = 1.0 if noise is None else _HELD_SHARE
        draws = self._drawn(round(self._share * _MODEL_GROUPS))
        logs = [np.log(self._scores(draws, level)) for level in levels]
        last = len(levels) - 1
        self._steps = _STEPS if noise is None else _NOISE_STEPS
        fine = np.linspace(0.0, last, last * self._steps + 1)
        low = np.minimum(fine.astype(int), last - 1)
        share = (fine - low)[:, None]
        self._levels = np.interp(fine, np.arange(last + 1), levels)
        if noise is not None:
            # The logarithm of E_RMSE is nearly linear in that of the noise.
            above = fine >= 1.0
            places = np.arange(1, last + 1)
            self._levels[above] = np.exp(
                np.interp(fine[above], places, np.log(levels[1:]))
            )
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
        statistics, fitted = self._fitted(logs)
        statistic, best = statistics[0], int(fitted[0])
        # Levels with which an RMSE as far from its mean is in the 95 % of a normal distribution.
        rmse_std = np.sqrt(self._covariances[:, 0, 0])
        is_likely = np.abs(logs[0, 0] - self._means[:, 0]) <= _NORMAL_95 * rmse_std
        is_likely[best] = True
        likely = self._levels[is_likely]
        level = float(self._levels[best])
        release_s, noise_mm = self._release_and_noise(level)
        low_s, _ = self._release_and_noise(float(likely[0]))
        high_s, _ = self._release_and_noise(float(likely[-1]))
        null = self._null(best)
        larger = np.count_nonzero(null >= statistic)
        mean_rmse, std_rmse, mean_dtw, std_dtw = np.exp(self._means[best]).tolist()
        return Spread(
            starts=starts,
            release_s=release_s,
            release_95_s=(low_s, high_s),
            noise_mm=noise_mm,
            simulated=(mean_rmse, std_rmse, mean_dtw, std_dtw),
            p_value=float((1.0 + larger) / (1.0 + len(null))),
        )

    def _release_and_noise(self, level: float) -> tuple[float, float]:
        """Return the spread of the release [s] and of the noise [mm] at a level."""
        return (level, 0.0) if self._noise is None else (HELD_LATE_S, level)

    def _null(self, level: int) -> FloatArray:
        """Return T of new groups at the level of an index, shape [group_count]; of held bodies at the nearest one."""
        if self._noise is not None:
            level = self._steps * round(level / self._steps)
        if level not in self._nulls:
            count = round(self._share * _NULL_GROUPS)
            draws = self._drawn(count, from_sample=True)
            scores = self._scores(draws, self._levels[level])
            self._nulls[level] = self._fitted(np.log(scores))[0]
        return self._nulls[level]

    def _drawn(self, count: int, *, from_sample: bool = False) -> Draws:
        """Return what is drawn for the trials of groups.

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
            delays = np.abs(self._random.standard_normal(shape))
        else:
            delays = self._random.exponential(size=shape)
        noises = None
        if self._noise is not None:
            noises = drawn_noises(self._random, self._noise, count)
        return Draws(runs=runs, delays=delays, noises=noises)

    def _scores(self, draws: Draws, level: float) -> FloatArray:
        release_s, noise_mm = self._release_and_noise(level)
        trials = delayed(
            self._samples, draws.runs, release_s * draws.delays, self._frame_count
        )
        if self._noise is not None and draws.noises is not None:
            trials += noise_mm * self._noise[draws.noises]
        return group_scores(trials)

    def _fitted(self, logs: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return T of groups, and the index of the level with the mean RMSE of each, shape [group_count] each.

        Args:
            logs: Logarithms of the four numbers of groups, shape [group_count, 4].
        """
        levels = np.abs(logs[:, :1] - self._means[:, 0]).argmin(axis=1)
        from_mean = (logs - self._means[levels])[:, :, None]
        scaled = np.linalg.solve(self._covariances[levels], from_mean)
        return (from_mean * scaled).sum(axis=(1, 2)), levels


def drawn_noises(
    random: np.random.Generator, noise: FloatArray, count: int
) -> IntArray:
    """Return numbers of realizations of noise, different ones in a group, shape [count, trial_count]."""
    every = np.tile(np.arange(len(noise)), (count, 1))
    return np.asarray(random.permuted(every, axis=1)[:, :TRIAL_COUNT])


def delayed(
    samples: FloatArray, runs: IntArray, delays_s: FloatArray, frame_count: int
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
    pair_count, frame_count, width = firsts.shape
    if width > _WIDE:
        pairs = zip(firsts, seconds, strict=True)
        rows: Iterable[FloatArray] = np.stack(
            [frame_distances(*pair) for pair in pairs], axis=2
        )
    else:
        first, second = (np.moveaxis(one, 0, -1).copy() for one in (firsts, seconds))
        rows = (np.sqrt(np.square(row - second).sum(axis=1)) for row in first)
    # Cost and cell count of the best path to each cell of a row; the row above the first one has its start alone.
    cost = np.full((frame_count + 1, pair_count), np.inf)
    cells = np.zeros((frame_count + 1, pair_count))
    cost[0] = 0.0
    for local in rows:
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
