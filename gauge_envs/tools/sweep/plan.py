"""Plan of a sweep: every episode once, with the name of its result file, before anything runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from gauge_envs.backends import (
    Backend,
    backend_for,
    backend_names,
    engine_call,
    support_of,
    versions_of,
)
from gauge_envs.errors import ParameterError, UnknownNameError, UnsupportedSceneError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import json_ready, versions
from gauge_envs.references.imported import dataset_record
from gauge_envs.runs.isolation import call_engine
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene.jitter import JITTER_FORMAT
from gauge_envs.tools.sweep.spec import SweepSpec

MAX_EPISODES = 1_000_000
"""Largest number of episodes of a sweep."""

MAX_PLAN_S = 600.0
"""Time limit of the questions to an engine of another package [s]."""

KEY_LENGTH = 16
"""Hexadecimal digits of a key in a file name: among a million episodes, two share them with a probability of 3e-8."""


@dataclass(frozen=True)
class SweepRun:
    """Repeats of one experiment on one engine, with one choice of parameters and settings.

    Attributes:
        request: The request, with its first seed, its repeats and the jitter that applies.
        experiment: Name of the experiment.
        sha256: Hash of the content that its episodes share.
        versions: Versions of the engine's packages and of gauge-envs that the hash contains.
        shares_worlds: Whether the repeats run as worlds of one simulation.
        declined: Why no episode of it can run; None if the plan knows no reason.
        steps: Time steps of an episode; None where the engine does not tell.
    """

    request: RunRequest
    experiment: str
    sha256: str
    versions: dict[str, str]
    shares_worlds: bool
    declined: str | None
    steps: float | None

    @property
    def group(self) -> tuple[str, str]:
        """Engine and experiment."""
        return self.request.backend, self.experiment

    def file_name(self, seed: int) -> str:
        """Return the name of the result file of an episode."""
        key = hashlib.sha256(f"{self.sha256}:{seed}".encode()).hexdigest()
        return f"{self.experiment}.{self.request.backend}.{key[:KEY_LENGTH]}.json"


@dataclass(frozen=True)
class SweepTask:
    """Episodes that one call runs: repeats of a run with consecutive seeds."""

    run: SweepRun
    seeds: range

    @property
    def request(self) -> RunRequest:
        """The request of these episodes alone."""
        return replace(self.run.request, seed=self.seeds[0], repeats=len(self.seeds))

    @property
    def file_names(self) -> list[str]:
        """Names of the result files."""
        return [self.run.file_name(seed) for seed in self.seeds]


@dataclass(frozen=True)
class SweepPlan:
    """The runs of a sweep, each content once.

    Attributes:
        runs: The runs, grouped by engine and experiment.
        duplicates: Episodes that were left out, because others have the same content.
    """

    runs: tuple[SweepRun, ...]
    duplicates: int = 0

    @property
    def episode_count(self) -> int:
        """Number of episodes."""
        return sum(run.request.repeats for run in self.runs)

    @property
    def file_names(self) -> list[str]:
        """Names of the result files."""
        return [run.file_name(seed) for run in self.runs for seed in run.request.seeds]


def plan_sweep(spec: SweepSpec, *, isolate: bool = False) -> SweepPlan:
    """Return the plan of a sweep. No simulation is built.

    Args:
        spec: What it covers.
        isolate: Ask also the engines of this package in another process.

    Raises:
        ParameterError: The sweep is too large, or an engine or all experiments refuse a value.
    """
    count = spec.episode_count()
    if count > MAX_EPISODES:
        raise ParameterError(
            f"the sweep has more than {MAX_EPISODES:,} episodes: shorten its lists, or split it"
        )
    subjects = _subjects(spec)
    runs: dict[str, SweepRun] = {}
    for backend in dict.fromkeys(spec.backends):
        if backend not in backend_names():
            raise UnknownNameError("backend", backend, backend_names())
        of_engine = call_engine(
            backend,
            _engine_runs,
            backend,
            subjects,
            spec.setting_choices(backend),
            time_limit_s=MAX_PLAN_S,
            isolate=isolate or None,
        )
        for run in of_engine:
            runs.setdefault(run.sha256, run)
    plan = SweepPlan(tuple(runs.values()))
    return replace(plan, duplicates=count - plan.episode_count)


Subject = tuple[RunRequest, Experiment, str | None]
"""A request; its experiment, or the calibrated one if it does not take the parameters; and why it does not."""


def _subjects(spec: SweepSpec) -> list[Subject]:
    """Return each experiment with each choice of parameters, in the order of the experiments."""
    by_parameters = []
    for parameters in spec.parameters:
        subjects = [
            _subject(
                RunRequest(
                    variant,
                    parameters=parameters,
                    seed=spec.seed,
                    repeats=spec.repeats,
                    jitter=spec.start_jitter,
                )
            )
            for variant in spec.subjects()
        ]
        reason = subjects[0][-1]
        if reason is not None and all(refused for *_, refused in subjects):
            raise ParameterError(reason)
        by_parameters.append(subjects)
    return [one for group in zip(*by_parameters, strict=True) for one in group]


def _subject(request: RunRequest) -> Subject:
    """Load the experiment of a request."""
    request = replace(request, jitter=request.scatter)
    try:
        return request, request.experiment(), None
    except ParameterError as error:
        return request, request.calibrated_experiment(), str(error)


def _engine_runs(
    backend: str, subjects: Sequence[Subject], choices: Sequence[Mapping[str, Any]]
) -> list[SweepRun]:
    """Return the runs of an engine, which is asked for its versions, and whether it can build each experiment.

    Args:
        backend: Name of the engine.
        subjects: The experiments.
        choices: Settings that replace those of the presets.
    """
    engine = backend_for(backend, None)
    engine_versions = versions_of(backend) | {"gauge-envs": versions()["gauge-envs"]}
    shares_worlds = (
        engine.worlds_share_simulation
        and type(engine).build_worlds is not Backend.build_worlds
    )
    runs = []
    for request, experiment, refusal in subjects:
        support = support_of(backend, experiment.scene, experiment.model_file)
        jitter = request.jitter
        content = {
            "experiment": experiment_sha256(experiment),
            "backend": backend,
            "versions": engine_versions,
            "parameters": request.parameters,
            "jitter": jitter and {**jitter.to_dict(), "format": JITTER_FORMAT},
        }
        for settings in choices:
            effective: Mapping[str, Any] = settings
            if support:
                effective = _effective_settings(engine, experiment, settings)
            timestep_s = effective.get("timestep_s")
            run = SweepRun(
                request=replace(request, backend=backend, settings=settings or None),
                experiment=experiment.name,
                sha256=_sha256(content | {"settings": effective}),
                versions=engine_versions,
                shares_worlds=shares_worlds,
                declined="; ".join(support.missing) or refusal,
                steps=timestep_s and experiment.scene.duration_s / timestep_s,
            )
            runs.append(run)
    return runs


def _effective_settings(
    engine: Backend, experiment: Experiment, settings: Mapping[str, Any]
) -> Mapping[str, Any]:
    """Return all settings of an engine; those that were given where it does not tell.

    Raises:
        ParameterError: The engine refuses one.
    """
    try:
        with engine_call(engine.name, "resolved_settings"):
            resolved = engine.resolved_settings(experiment.scene, settings)
    except UnsupportedSceneError:
        # The preset is one of other scenes: the episode will be declined.
        return settings
    except (ParameterError, UnknownNameError) as error:
        raise ParameterError(
            f"{experiment.name} on {engine.name}: {error}. A setting or preset of one engine belongs in its own table, "
            f"[settings.{engine.name}]"
        ) from None
    return settings if resolved is None else resolved


def experiment_sha256(experiment: Experiment) -> str:
    """Return the hash of what is simulated and how it is scored, apart from engine, jitter and seed."""
    return _sha256(
        {
            "id": experiment.id,
            "task": experiment.file_sha256,
            "scene": asdict(experiment.scene),
            "recorded": experiment.recorded,
            "frames": experiment.frame_count,
            "trial": experiment.trial,
            "asset": experiment.asset and experiment.asset.sha256,
            "dataset": dataset_record(
                experiment.name,
                drivers=experiment.drivers,
                reference=experiment.reference_source,
            ),
        }
    )


def _sha256(content: Mapping[str, Any]) -> str:
    text = json.dumps(json_ready(content), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def remaining_tasks(plan: SweepPlan, done: Container[str]) -> Iterator[SweepTask]:
    """Yield the tasks whose episodes have no file yet.

    Repeats on an engine that builds them as worlds of one simulation form one task; other episodes are tasks of their
    own.

    Args:
        plan: The plan.
        done: Names of the files that exist.
    """
    for run in plan.runs:
        pending: list[range] = []
        for seed in run.request.seeds:
            if run.file_name(seed) in done:
                continue
            if run.shares_worlds and pending and pending[-1].stop == seed:
                pending[-1] = range(pending[-1].start, seed + 1)
            else:
                pending.append(range(seed, seed + 1))
        yield from (SweepTask(run, seeds) for seeds in pending)


def shard(plan: SweepPlan, number: int, count: int) -> SweepPlan:
    """Return one of several parts of a plan. Neighbouring runs stay together, since they share engine and experiment.

    Args:
        plan: The plan.
        number: Number of the part, from 0.
        count: Number of parts.

    Raises:
        ParameterError: There is no such part.
    """
    if not 0 <= number < count:
        raise ParameterError(
            f"shard {number}/{count}: expected a number from 0 to {count - 1}"
        )
    total = len(plan.runs)
    part = slice(number * total // count, (number + 1) * total // count)
    return replace(plan, runs=plan.runs[part])
