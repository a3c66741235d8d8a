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

Cloth and foam that rods and grips hold have no start of their own. Instead the driven body is misplaced, by the same
jitter, and late by |N(0, `HELD_LATE_S`)|. Neither is published. White noise of the markers is fitted in place of s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.evaluation.scatter_groups import (
    TRIAL_COUNT,
    Spread,
    experiment_models,
)
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.published import Baseline, published_variants
from gauge_envs.references.scatter import held_rows, scatter_rows
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.jitter import Jitter, jittered

ASSUMED = "x 1"
"""Name of the answer for the assumed spread."""

LEVEL = 0.05
"""Level of the test."""

TOLD_SHARE = 0.8
"""Share of realities with a fault that a test refuses which tells this fault."""

TELLS_NOTHING = "tells no wrong constant"
"""What is said of a test that tells no fault of a scene that moves."""

NOT_TESTED = "published; not tested"
"""What is said of a published scatter whose test of MuJoCo was not run."""

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
        tells: Whether the test tells a wrong constant: of held bodies, by its stored power.
    """

    unit: str
    run_count: int
    trial_count: int
    real: tuple[float, float, float, float]
    spreads: tuple[Spread, ...]
    verdict: str
    tells: bool = True

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

    A configuration whose answer hangs on the starts has none, and none has one where all answers are the same, or where
    the test tells no fault.
    """
    answers = [one.differs if one is not None and one.tells else None for one in found]
    alike = answers.count(False)
    if not (alike and True in answers):
        return [None] * len(answers)
    ranks = {False: 1, True: 1 + alike, None: None}
    return [ranks[answer] for answer in answers]


def is_held(experiment: Experiment) -> bool:
    """Return whether no body starts free, so that driven bodies scatter in its place."""
    try:
        jittered(experiment.scene, Jitter(), seed=0)
    except ParameterError:
        return True
    return False


def scatter_text(experiment: Experiment) -> str:
    """Return what the test says of MuJoCo and what it can tell; `-` without published numbers."""
    if published_numbers(experiment.baselines) is None:
        return "-"
    if experiment.impossible_scores:
        return "published in another unit: not tested"
    attached_rows = held_rows().get(experiment.name)
    if attached_rows is not None:
        answer = SHORT_VERDICTS[differs([*attached_rows.p.values()])]
        if held_tells(experiment.name):
            return f"MuJoCo: {answer}"
        return f"MuJoCo: {answer}; {TELLS_NOTHING}"
    row = scatter_rows().get(experiment.name)
    if row is None:
        return NOT_TESTED
    answer = SHORT_VERDICTS[differs([*row.p.values()])]
    factor = (
        "no factor up to 4" if row.factor is None else f"a factor of {row.factor:g}"
    )
    return f"MuJoCo: {answer}; tells {factor} of E_DTW"


def scatter_test(
    experiment: Experiment,
    samples: Mapping[float, FloatArray],
    *,
    markers_m: FloatArray | None = None,
    seed: int = 0,
) -> Scatter:
    """Test whether runs scatter as the real trials of their experiment do.

    Args:
        experiment: The experiment, with published scores.
        samples: g(t) of runs that are released at time 0, 180 samples a second, by the spread of their starts over the
            assumed one; each of shape [run_count, sample_count, coordinate_count]. Of held bodies, with the assumed
            spread alone.
        markers_m: Markers of one run of a held body [m], shape [frame_count, marker_count, 3].
        seed: Seed of the groups.
    """
    models = experiment_models(experiment, samples, markers_m=markers_m, seed=seed)
    scatter = refused_scatter(experiment, "")
    spreads = tuple(
        model.answer(np.asarray(scatter.real), starts)
        for starts, model in models.items()
    )
    verdict = VERDICTS[differs([one.p_value for one in spreads])]
    tells = markers_m is None or held_tells(experiment.name)
    mute = TELLS_NOTHING if experiment.name in held_rows() else "its power is not known"
    return replace(
        scatter,
        run_count=min(map(len, samples.values())),
        spreads=spreads,
        verdict=verdict if tells else f"{verdict}; {mute}",
        tells=tells,
    )


def held_tells(name: str) -> bool:
    """Return whether the test tells some fault of a held body that moves in most realities."""
    row = held_rows().get(name)
    if row is None:
        return False
    return any(
        share is not None and share >= TOLD_SHARE
        for fault, share in row.told.items()
        if fault not in ("none", "frozen")
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
