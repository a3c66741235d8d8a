"""Scores computed anew from the trajectory of a result, beside those that its file states."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.score import Score, score_trajectory
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import json_ready
from gauge_envs.references.bands import BandGrade
from gauge_envs.runs.result import Outcome, Result

SCORE_TOLERANCE = 1e-6
"""Largest difference of a stated score, relative and absolute. Last digits depend on the processor, and the fit of the
release time ends within 1e-7 s. No table shows so many digits."""

WRITTEN_ANEW = ("budget", "sensitivities")
"""Keys that are written anew without a comparison, as all intervals `*_95`: they depend on sensitivities that
`gauge run --uncertainty` measures and stores on another machine."""


def rescored(result: Result, experiment: Experiment) -> Result:
    """Return a result with the score of its trajectory, and without what the trajectory does not prove.

    Wall times and statistics of deformation are left out: g(t) holds neither.

    Args:
        result: A result whose trajectory has no faults.
        experiment: Its experiment.
    """
    band = reference_band(experiment)
    if result.outcome is Outcome.FINISHED and result.trajectory is not None:
        times_s, values = result.trajectory.arrays(later=True)
        score = score_trajectory(experiment, band, times_s=times_s, values=values, backend=result.backend)
    else:
        grade = BandGrade.NONE if band is None else band.grade
        score = Score(grade=grade.value, unit=experiment.score.observable.unit)
    return replace(result, score=score, wall_s=None, deformation=None)


def differing_scores(stated: Score, computed: Score) -> Iterator[tuple[str, str]]:
    """Yield key and reason of each score that a file states and its trajectory does not give."""
    ours: dict[str, Any] = json_ready(computed.to_dict())
    theirs: dict[str, Any] = json_ready(stated.to_dict())
    for key, value in ours.items():
        if key in WRITTEN_ANEW or key.endswith("_95"):
            continue
        for place, said, given in _differences(f"score.{key}", theirs[key], value):
            yield place, f"the file states {_text(said)}, its trajectory gives {_text(given)}"


def _differences(place: str, said: Any, given: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield place and both values of each difference in two JSON values."""
    if isinstance(said, dict) and isinstance(given, dict) and said.keys() == given.keys():
        for key in given:
            yield from _differences(f"{place}.{key}", said[key], given[key])
    elif isinstance(said, list) and isinstance(given, list) and len(said) == len(given):
        for number, (one, other) in enumerate(zip(said, given, strict=True)):
            yield from _differences(f"{place}.{number}", one, other)
    elif _are_numbers(said, given):
        if not math.isclose(said, given, rel_tol=SCORE_TOLERANCE, abs_tol=SCORE_TOLERANCE):
            yield place, said, given
    elif said != given:
        yield place, said, given


def _are_numbers(*values: Any) -> bool:
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def _text(value: Any) -> str:
    text = "nothing" if value is None else f"{value:.9g}" if isinstance(value, float) else repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
