"""Plan a sweep: list every episode once, with the name of its result file, before a run."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain, product
from math import prod
from typing import Any

import numpy as np

from gauge_envs.backends import (
    Backend,
    backend_for,
    engine_call,
    support_of,
    versions_of,
)
from gauge_envs.errors import GaugeError, ParameterError, UnsupportedSceneError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.variants import Variant, matching_variants
from gauge_envs.files import json_ready
from gauge_envs.registry import package_versions
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.workers import call_engine
from gauge_envs.scene.jitter import JITTER_FORMAT, Jitter
from gauge_envs.tools.sweep.spec import SweepSpec

MAX_EPISODES = 1_000_000
"""Largest number of episodes of an engine."""

KEY_LENGTH = 16
"""Hexadecimal digits of a key in a file name. A million episodes collide with a probability of 3e-8."""


@dataclass(frozen=True)
class SweepRun:
    """Episodes with consecutive seeds of one experiment, engine and choice of parameters and settings.

    Attributes:
        request: The request, with the effective jitter.
        experiment: Name of the experiment.
        sha256: Hash of the common content of the episodes.
        shares_worlds: Whether the repeats run as worlds of one simulation.
        unsupported: Reason why no episode can run, if known.
        duration_s: Simulated time of an episode [s].
    """

    request: RunRequest
    experiment: str
    sha256: str
    shares_worlds: bool
    unsupported: str | None
    duration_s: float

    @property
    def backend(self) -> str:
        """Name of the engine."""
        return self.request.backend

    @property
    def file_names(self) -> list[str]:
        """Names of the result files, one for each episode."""
        keys = [
            hashlib.sha256(f"{self.sha256}:{seed}".encode()).hexdigest()[:KEY_LENGTH]
            for seed in self.request.seeds
        ]
        return [f"{self.experiment}.{self.backend}.{key}.json" for key in keys]


def episode_count(runs: Iterable[SweepRun]) -> int:
    """Return the number of episodes of runs."""
    return sum(run.request.repeats for run in runs)


def plan_sweep(spec: SweepSpec) -> list[SweepRun]:
    """Return the runs of a sweep without repetition, grouped by engine and experiment. This builds no simulation.

    Raises:
        ParameterError: The sweep is too large, or an engine or all experiments reject a value.
        UnknownNameError: An engine or experiment does not exist.
    """
    variants = dict.fromkeys(chain.from_iterable(map(matching_variants, spec.variants)))
    subjects = _subjects(spec, variants)
    runs: dict[str, SweepRun] = {}
    for backend in spec.backends:
        lists = spec.setting_lists(backend)
        choice_count = prod(map(len, lists.values()))
        if choice_count * len(subjects) * spec.repeats > MAX_EPISODES:
            raise ParameterError(
                f"the sweep has more than {MAX_EPISODES:,} episodes: shorten its lists or split it"
            )
        choices = [
            dict(zip(lists, values, strict=True)) for values in product(*lists.values())
        ]
        for run in call_engine(backend, _engine_runs, backend, subjects, choices):
            runs.setdefault(run.sha256, run)
    return list(runs.values())


Subject = tuple[RunRequest, Experiment, str | None]
"""A request, its experiment, and the reason why the parameters are rejected; the experiment is then calibrated."""


def _subjects(spec: SweepSpec, variants: Iterable[Variant]) -> list[Subject]:
    """Return each experiment with each choice of parameters.

    Raises:
        ParameterError: All experiments reject a choice of parameters.
    """
    jitter = None if spec.jitter is None else Jitter(**spec.jitter)
    subjects: list[Subject] = []
    for variant, parameters in product(variants, spec.parameters):
        request = RunRequest(
            variant,
            parameters=parameters,
            seed=spec.seed,
            repeats=spec.repeats,
            jitter=jitter,
        )
        request = replace(request, jitter=request.scatter)
        reason = None
        try:
            experiment = request.experiment()
        except ParameterError as error:
            experiment, reason = request.calibrated_experiment(), str(error)
        subjects.append((request, experiment, reason))
    for index in range(len(spec.parameters)):
        reasons = [cause for *_, cause in subjects[index :: len(spec.parameters)]]
        if all(reasons):
            raise ParameterError(reasons[0])
    return subjects


def _engine_runs(
    backend: str, subjects: Sequence[Subject], choices: Sequence[Mapping[str, Any]]
) -> list[SweepRun]:
    """Return the runs of an engine, with its versions and its support for each experiment.

    Args:
        backend: Name of the engine.
        subjects: The experiments.
        choices: Settings that replace settings of the presets.
    """
    engine = backend_for(backend, None)
    shares_worlds = (
        engine.worlds_share_simulation
        and type(engine).build_worlds is not Backend.build_worlds
    )
    runs = []
    for request, experiment, reason in subjects:
        support = support_of(backend, experiment.scene, experiment.model_file)
        jitter = request.jitter
        content = {
            "experiment": experiment.id,
            "task": experiment.file_sha256,
            "scene": asdict(experiment.scene),
            "backend": backend,
            "versions": versions_of(backend)
            | {"gauge-envs": package_versions()["gauge-envs"]},
            "parameters": request.parameters,
            "jitter": jitter and {**jitter.to_dict(), "format": JITTER_FORMAT},
        }
        for settings in choices:
            effective = settings
            if support:
                effective = _effective_settings(engine, experiment, settings)
            content["settings"] = effective
            text = json.dumps(json_ready(content), sort_keys=True)
            run = SweepRun(
                request=replace(request, backend=backend, settings=settings or None),
                experiment=experiment.name,
                sha256=hashlib.sha256(text.encode()).hexdigest(),
                shares_worlds=shares_worlds,
                unsupported="; ".join(support.missing) or reason,
                duration_s=experiment.scene.duration_s,
            )
            runs.append(run)
    return runs


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
        raise ParameterError(
            f"{experiment.name} on {engine.name}: {error}. Put a setting or preset of one engine in the table "
            f"[settings.{engine.name}]"
        ) from None
    return settings if resolved is None else resolved


def remaining_tasks(
    runs: Iterable[SweepRun], done: Container[str]
) -> Iterator[SweepRun]:
    """Yield the episodes without a file as tasks; one call runs a task.

    If the engine builds repeats as worlds of one simulation, consecutive repeats are one task. Otherwise each episode
    is a task.

    Args:
        runs: The plan.
        done: Names of the existing files.
    """
    for run in runs:
        names = zip(run.request.seeds, run.file_names, strict=True)
        seeds = np.array([seed for seed, name in names if name not in done])
        max_step = 1 if run.shares_worlds else 0
        splits = np.flatnonzero(np.diff(seeds) > max_step) + 1
        for part in np.split(seeds, splits):
            if part.size:
                request = replace(run.request, seed=int(part[0]), repeats=len(part))
                yield replace(run, request=request)


def part_of(runs: list[SweepRun], text: str) -> list[SweepRun]:
    """Return a part of a plan. Neighbouring runs have the same engine and experiment, so they stay together.

    Args:
        runs: The plan.
        text: Number of the part, from 0, and number of parts: `0/16`.

    Raises:
        ParameterError: The part does not exist.
    """
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
    number, count = map(int, match.groups()) if match else (0, 0)
    if number >= count:
        raise ParameterError(
            f"--shard {text!r}: expected NUMBER/COUNT with NUMBER from 0 to COUNT - 1, for example 0/16"
        )
    return runs[number * len(runs) // count : (number + 1) * len(runs) // count]
