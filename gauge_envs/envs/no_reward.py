"""The warning for an environment whose reward is always 0."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from gauge_envs.errors import NoRewardWarning
from gauge_envs.evaluation.reference import load_band
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band
from gauge_envs.references.imported import has_import

CALLER = 4
"""Frames from the warning to the caller of `gymnasium.make`: this module, the entry point, `make`, the caller."""

_warned: set[str] = set()
_is_reported: ContextVar[bool] = ContextVar("is_reported", default=True)


@contextmanager
def unreported() -> Iterator[None]:
    """Give no warning within the block: the caller reports the grade of the reference itself."""
    token = _is_reported.set(False)
    try:
        yield
    finally:
        _is_reported.reset(token)


def warn_without_reward(experiment: Experiment, band: Band | None) -> None:
    """Warn, once for each id, that an environment has no reward, and say how to get one.

    Args:
        experiment: The experiment of the environment.
        band: Band that its rewards are relative to; with one, nothing is reported.
    """
    if band is not None or experiment.id in _warned or not _is_reported.get():
        return
    warnings.warn(_message(experiment), NoRewardWarning, stacklevel=CALLER)
    _warned.add(experiment.id)


def _message(experiment: Experiment) -> str:
    """Return what is missing and what to do; an experiment file states its own reference."""
    missing = f"{experiment.id} has no reference in use, so every reward is 0."
    if experiment.asset is not None and experiment.reference is not None:
        return f"{missing} Add a table 'band' to {experiment.asset.path.name}."
    ways = []
    if has_import(experiment.name):
        ways.append("pass reference='imported', as its real trials are imported")
    else:
        ways.append("import its real trials with 'gauge data import', then pass reference='imported'")
    stored = load_band(experiment.name, experiment.reference_source)
    if stored is not None and stored.withheld is not None:
        name = experiment.name
        ways.append(f"pass use_withheld=True to use a withheld band; 'gauge show {name}' says why it is withheld")
    ways.append("choose an id that 'gauge list --scored' shows")
    return f"{missing} To get one, {'; or '.join(ways)}."
