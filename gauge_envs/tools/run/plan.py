"""Plan a run: check it, and list every episode once, with the name of its result file, before the first one runs."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain, product
from math import prod
from typing import Any

from gauge_envs.backends import (
    Backend,
    backend_for,
    engine_call,
    support_of,
    versions_of,
)
from gauge_envs.backends.registry import shares_worlds
from gauge_envs.errors import (
    GaugeError,
    ParameterError,
    ReferenceFileError,
    UnsupportedSceneError,
)
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.variants import matching_variants
from gauge_envs.files import json_ready
from gauge_envs.references.imported import dataset_record
from gauge_envs.registry import package_versions
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.workers import CrashError, call_engine
from gauge_envs.scene.jitter import JITTER_FORMAT
from gauge_envs.scoring.reference import reference_band
from gauge_envs.tools.run.spec import RunSpec

MAX_EPISODES = 1_000_000
"""Largest number of episodes of an engine."""

ANSWER_LIMIT_S = 120.0
"""Time limit of the questions to an engine outside this package [s]."""

KEY_LENGTH = 16
"""Hexadecimal digits of a key in a file name. A million episodes collide with a probability of 3e-8."""


@dataclass(frozen=True)
class PlannedRun:
    """Episodes with consecutive seeds of one experiment, engine and choice of parameters and settings.

    Attributes:
        request: The request, with the effective jitter.
        experiment: Name of the experiment.
        sha256: Hash of the common content of the episodes.
        shares_worlds: Whether the repeats run as worlds of one simulation.
        unsupported: Reason why no episode can run; empty if none is known.
        duration_s: Simulated time of an episode [s].
    """

    request: RunRequest
    experiment: str
    sha256: str
    shares_worlds: bool
    unsupported: str
    duration_s: float

    @property
    def backend(self) -> str:
        """Name of the engine."""
        return self.request.backend

    @property
    def file_names(self) -> list[str]:
        """Names of the result files, one for each episode."""
        return [self._file_name(seed) for seed in self.request.seeds]

    def _file_name(self, seed: int) -> str:
        key = hashlib.sha256(f"{self.sha256}:{seed}".encode()).hexdigest()
        return f"{self.experiment}.{self.backend}.{key[:KEY_LENGTH]}.json"


def episode_count(runs: Iterable[PlannedRun]) -> int:
    """Return the number of episodes of runs."""
    return sum(run.request.repeats for run in runs)


def plan_runs(spec: RunSpec) -> list[PlannedRun]:
    """Return the runs of a request without repetition, grouped by engine and experiment. This builds no simulation.

    Raises:
        ParameterError: The request is too large, or an engine or all experiments reject a value.
        UnknownNameError: An engine or experiment does not exist.
    """
    cases = _cases(spec)
    runs: dict[str, PlannedRun] = {}
    for backend in dict.fromkeys(spec.backends):
        lists = spec.setting_lists(backend)
        choice_count = prod(map(len, lists.values()))
        if choice_count * len(cases) * spec.repeats > MAX_EPISODES:
            raise ParameterError(
                f"the sweep has more than {MAX_EPISODES:,} episodes: shorten its lists or split it"
            )
        choices = [
            dict(zip(lists, values, strict=True)) for values in product(*lists.values())
        ]
        for run in _engine_runs(backend, cases, choices):
            runs.setdefault(run.sha256, run)
    return list(runs.values())


@dataclass(frozen=True)
class _Case:
    """An experiment with a choice of parameters.

    Attributes:
        request: The request without an engine and its settings, with the effective jitter.
        experiment: The experiment; it has published parameters if the request is rejected.
        rejected: Why the parameters or the reference are rejected; empty if they are not.
    """

    request: RunRequest
    experiment: Experiment
    rejected: str = ""

    def content(self) -> dict[str, Any]:
        """Return what identifies the episodes, beyond the engine and its settings."""
        experiment, jitter = self.experiment, self.request.jitter
        return {
            "experiment": experiment.id,
            "task": experiment.file_sha256,
            "scene": asdict(experiment.scene),
            "asset": experiment.asset and experiment.asset.sha256,
            "dataset": not self.rejected
            and dataset_record(
                experiment.name,
                drivers=experiment.drivers,
                reference=experiment.reference_source,
            ),
            "parameters": self.request.parameters,
            "marker_proxy": self.request.proxy,
            "jitter": jitter and {**jitter.to_dict(), "format": JITTER_FORMAT},
        }


def _cases(spec: RunSpec) -> list[_Case]:
    """Return each experiment with each choice of parameters.

    Raises:
        ParameterError: All experiments reject a choice of parameters.
    """
    variants = dict.fromkeys(chain.from_iterable(map(matching_variants, spec.variants)))
    cases = [
        _case(spec.request(variant, parameters))
        for variant, parameters in product(variants, spec.parameters)
    ]
    for index in range(len(spec.parameters)):
        same = cases[index :: len(spec.parameters)]
        if all(case.rejected for case in same):
            raise ParameterError(same[0].rejected)
    return cases


def _case(request: RunRequest) -> _Case:
    """Return the case of a request."""
    request = replace(request, jitter=request.scatter)
    try:
        experiment = request.experiment()
        reference_band(experiment)
        return _Case(request, experiment)
    except (ParameterError, ReferenceFileError) as error:
        return _Case(request, request.published_experiment(), str(error))


def _engine_runs(
    backend: str, cases: Sequence[_Case], choices: Sequence[Mapping[str, Any]]
) -> Iterator[PlannedRun]:
    """Yield the runs of an engine.

    Args:
        backend: Name of the engine.
        cases: The experiments.
        choices: Settings that replace settings of the presets.
    """
    experiments = [case.experiment for case in cases]
    try:
        answer = call_engine(
            backend,
            _answer_of,
            backend,
            experiments,
            choices,
            time_limit_s=ANSWER_LIMIT_S,
        )
    except CrashError:
        # Each of its episodes will fail, but those of other engines run.
        answer = _Answer({}, False, [""] * len(cases), [choices] * len(cases))
    versions = {**answer.versions, "gauge-envs": package_versions()["gauge-envs"]}
    for case, missing, resolved in zip(
        cases, answer.missing, answer.settings, strict=True
    ):
        content = case.content() | {"backend": backend, "versions": versions}
        for settings, effective in zip(choices, resolved, strict=True):
            content["settings"] = effective
            text = json.dumps(json_ready(content), sort_keys=True)
            yield PlannedRun(
                request=replace(
                    case.request, backend=backend, settings=settings or None
                ),
                experiment=case.experiment.name,
                sha256=hashlib.sha256(text.encode()).hexdigest(),
                shares_worlds=answer.shares_worlds,
                unsupported=missing or case.rejected,
                duration_s=case.experiment.scene.duration_s,
            )


@dataclass(frozen=True)
class _Answer:
    """What an engine knows of experiments before it builds them.

    Attributes:
        versions: Versions of its packages.
        shares_worlds: Whether it builds repeats as worlds of one simulation.
        missing: What each experiment has that the engine does not support, or empty.
        settings: All settings of the engine, for each experiment and choice.
    """

    versions: Mapping[str, str]
    shares_worlds: bool
    missing: list[str]
    settings: list[Sequence[Mapping[str, Any]]]


def _answer_of(
    backend: str,
    experiments: Sequence[Experiment],
    choices: Sequence[Mapping[str, Any]],
) -> _Answer:
    """Return the answer of an engine; its process calls this."""
    engine = backend_for(backend, experiments[0].model_file)
    answer = _Answer(versions_of(backend), shares_worlds(backend), [], [])
    for experiment in experiments:
        support = support_of(backend, experiment.scene, experiment.model_file)
        answer.missing.append("; ".join(support.missing))
        resolved = choices
        if support:
            resolved = [
                _effective_settings(engine, experiment, settings)
                for settings in choices
            ]
        answer.settings.append(resolved)
    return answer


def _effective_settings(
    engine: Backend, experiment: Experiment, settings: Mapping[str, Any]
) -> Mapping[str, Any]:
    """Return all settings of an engine; only the given settings if the engine does not resolve them.

    Raises:
        ParameterError: The engine rejects a setting.
    """
    try:
        with engine_call(engine.name, "resolved_settings"):
            resolved = engine.resolved_settings(experiment.scene, settings)
    except UnsupportedSceneError:
        # The preset does not apply to this scene: the episode is unsupported.
        return settings
    except GaugeError as error:
        raise ParameterError(f"{experiment.name} on {engine.name}: {error}") from None
    return settings if resolved is None else resolved


def remaining_tasks(
    runs: Iterable[PlannedRun], done: Container[str]
) -> Iterator[PlannedRun]:
    """Yield the episodes without a file as tasks; one call runs a task.

    If the engine builds repeats as worlds of one simulation, consecutive repeats are one task. Otherwise each episode
    is a task.

    Args:
        runs: The plan.
        done: Names of the existing files.
    """
    for run in runs:
        names = zip(run.request.seeds, run.file_names, strict=True)
        seeds = {seed for seed, name in names if name in done}
        for request in run.request.parts(seeds, together=run.shares_worlds):
            yield replace(run, request=request)


def part_of(runs: list[PlannedRun], text: str) -> list[PlannedRun]:
    """Return a part of a plan. Neighbouring runs have the same engine and experiment, so they stay together.

    Args:
        runs: The plan.
        text: Number of the part, from 0, and number of parts: `0/16`.

    Raises:
        ParameterError: The part does not exist.
    """
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
    if match is not None:
        number, count = map(int, match.groups())
        if number < count:
            return runs[number * len(runs) // count : (number + 1) * len(runs) // count]
    raise ParameterError(
        f"--shard {text!r}: expected NUMBER/COUNT with NUMBER from 0 to COUNT - 1, for example 0/16"
    )
