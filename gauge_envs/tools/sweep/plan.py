"""The table of a sweep before it runs: every episode once, with its content key and the name of its file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

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
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.variants import Variant
from gauge_envs.files import json_ready, versions
from gauge_envs.references.imported import dataset_record
from gauge_envs.runs.isolation import call_engine
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene.jitter import JITTER_FORMAT
from gauge_envs.tools.sweep.spec import MAX_EPISODES, SweepSpec

PLAN_LIMIT_S = 600.0
"""Time limit of the questions to an engine of another package [s]."""


@dataclass(frozen=True)
class SweepRun:
    """Repeats of one experiment on one engine, with one choice of parameters and settings.

    Attributes:
        request: The request, with its first seed, its repeats and the jitter that applies.
        experiment: Name of the experiment.
        sha256: Hash that its episodes share.
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
        """Engine and experiment; a worker stays with a group as long as it can."""
        return self.request.backend, self.experiment

    def file_name(self, seed: int) -> str:
        """Return the name of the result file of an episode."""
        key = hashlib.sha256(f"{self.sha256}:{seed}".encode()).hexdigest()
        return f"{self.experiment}.{self.request.backend}.{key[:KEY_LENGTH]}.json"


@dataclass(frozen=True)
class SweepTask:
    """Episodes that one call runs: repeats with consecutive seeds.

    Attributes:
        run: Their run.
        seeds: Their seeds.
    """

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
    """
    count = spec.episode_count()
    if count > MAX_EPISODES:
        # Python writes no integer of thousands of digits, which long lists give.
        shown = f"{count:,}" if count < 10**15 else f"more than {10**15:,}"
        raise ParameterError(
            f"the sweep has {shown} episodes, the limit is {MAX_EPISODES:,}: shorten its lists, or split it"
        )
    subjects = [
        _subject(spec, one, parameters)
        for one in spec.subjects()
        for parameters in spec.parameters
    ]
    # Parameters that no experiment takes are an error.
    for number in range(len(spec.parameters)):
        refusals = [one.refusal for one in subjects[number :: len(spec.parameters)]]
        if refusals[0] is not None and None not in refusals:
            raise ParameterError(refusals[0])
    runs: dict[str, SweepRun] = {}
    for backend in dict.fromkeys(spec.backends):
        if backend not in backend_names():
            raise UnknownNameError("backend", backend, backend_names())
        found = call_engine(
            backend,
            _engine_runs,
            backend,
            subjects,
            list(spec.setting_choices(backend)),
            time_limit_s=PLAN_LIMIT_S,
            isolate=isolate or None,
        )
        for run in found:
            runs.setdefault(run.sha256, run)
    plan = SweepPlan(tuple(runs.values()))
    return replace(plan, duplicates=count - plan.episode_count)


class _Subject(NamedTuple):
    """One experiment with one choice of parameters.

    Attributes:
        request: A request for it.
        experiment: The experiment, or the calibrated one if it does not take the parameters.
        refusal: Why it does not take the parameters, or None.
    """

    request: RunRequest
    experiment: Experiment
    refusal: str | None = None


def _subject(
    spec: SweepSpec, subject: Variant | str, parameters: Parameters
) -> _Subject:
    """Load one experiment of a sweep with one choice of parameters."""
    request = RunRequest(
        subject,
        parameters=parameters,
        seed=spec.seed,
        repeats=spec.repeats,
        jitter=spec.start_jitter,
    )
    request = replace(request, jitter=request.scatter)
    try:
        return _Subject(request, request.experiment())
    except ParameterError as error:
        return _Subject(request, request.calibrated_experiment(), str(error))


def _engine_runs(
    backend: str, subjects: Sequence[_Subject], choices: Sequence[Mapping[str, Any]]
) -> list[SweepRun]:
    """Return the runs of an engine, which is asked for its versions, and whether it can build each experiment.

    Args:
        backend: Name of the engine.
        subjects: The experiments.
        choices: Settings that replace those of the presets.
    """
    engine = backend_for(backend, None)
    engine_versions = versions_of(backend) | {"gauge-envs": versions()["gauge-envs"]}
    runs = []
    for request, experiment, refusal in subjects:
        support = support_of(backend, experiment.scene, experiment.model_file)
        jitter = request.jitter
        content = {
            "format": KEY_FORMAT,
            "experiment": experiment_sha256(experiment),
            "backend": backend,
            "versions": engine_versions,
            "parameters": json_ready(request.parameters),
            "jitter": jitter and {**jitter.to_dict(), "format": JITTER_FORMAT},
        }
        for settings in choices:
            settings_sha256, timestep_s = str(settings), None
            if support:
                settings_sha256, timestep_s = _resolved(engine, experiment, settings)
            run = SweepRun(
                request=replace(request, backend=backend, settings=settings or None),
                experiment=experiment.name,
                sha256=content_sha256(content | {"settings": settings_sha256}),
                versions=engine_versions,
                shares_worlds=engine.worlds_share_simulation
                and type(engine).build_worlds is not Backend.build_worlds,
                declined="; ".join(support.missing) or refusal,
                steps=timestep_s and experiment.scene.duration_s / timestep_s,
            )
            runs.append(run)
    return runs


def _resolved(
    engine: Backend, experiment: Experiment, settings: Mapping[str, Any]
) -> tuple[str, float | None]:
    """Return the hash of the effective settings, and the time step [s]; None where the engine does not tell."""
    try:
        with engine_call(engine.name, "resolved_settings"):
            resolved = engine.resolved_settings(experiment.scene, settings)
    except UnsupportedSceneError:
        # The preset is one of other scenes: the episode will be declined.
        resolved = None
    except (ParameterError, UnknownNameError) as error:
        raise ParameterError(
            f"{experiment.name} on {engine.name}: {error}. A setting or preset of one engine belongs in its own table, "
            f"[settings.{engine.name}]"
        ) from None
    timestep_s = (settings if resolved is None else resolved).get("timestep_s")
    sha256 = content_sha256({"given": settings} if resolved is None else resolved)
    return sha256, timestep_s if isinstance(timestep_s, float) else None


def remaining_tasks(plan: SweepPlan, done: Container[str]) -> Iterator[SweepTask]:
    """Yield the tasks whose episodes have no file yet.

    Repeats on an engine that builds them as worlds of one simulation form one task; other episodes are tasks of their
    own.

    Args:
        plan: The plan.
        done: Names of the files that exist.
    """
    for run in plan.runs:
        missing = [
            seed for seed in run.request.seeds if run.file_name(seed) not in done
        ]
        started: list[list[int]] = []
        for seed in missing:
            if run.shares_worlds and started and started[-1][-1] == seed - 1:
                started[-1].append(seed)
            else:
                started.append([seed])
        for seeds in started:
            yield SweepTask(run, range(seeds[0], seeds[-1] + 1))


def shard(plan: SweepPlan, number: int, count: int) -> SweepPlan:
    """Return one of several parts of a plan. Neighbouring runs stay together, since they share engine and experiment.

    Args:
        plan: The plan.
        number: Number of the part, from 0.
        count: Number of parts.
    """
    if not 0 <= number < count:
        raise ParameterError(
            f"shard {number}/{count}: expected a number from 0 to {count - 1}"
        )
    total = len(plan.runs)
    return replace(
        plan, runs=plan.runs[number * total // count : (number + 1) * total // count]
    )


# --- keys ------------------------------------------------------------------------------------------------------------

KEY_FORMAT = 1
"""Number of this way to make keys; another way gets another number, so that no old result is taken for a new one."""

KEY_LENGTH = 16
"""Hexadecimal digits of a key in a file name: among a million episodes, two share them with a probability of 3e-8."""


def content_sha256(value: Any) -> str:
    """Return the hash of a value of dataclasses, mappings, sequences, arrays, enums, numbers, texts and None."""
    return hashlib.sha256(
        json.dumps(_plain(value), sort_keys=True, allow_nan=True).encode()
    ).hexdigest()


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        # What is not compared is derived from the other fields.
        kept = {
            field.name: _plain(getattr(value, field.name))
            for field in fields(value)
            if field.compare
        }
        return {"type": type(value).__name__, **kept}
    if isinstance(value, Enum):
        return _plain(value.value)
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return {"shape": list(np.shape(value)), "values": np.asarray(value).tolist()}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"{type(value).__name__} has no content hash")


def experiment_sha256(experiment: Experiment) -> str:
    """Return the hash of what is simulated and how it is scored, apart from engine, jitter and seed."""
    asset = experiment.asset
    return content_sha256(
        {
            "id": experiment.id,
            "task": experiment.file_sha256,
            "scene": experiment.scene,
            "recorded": experiment.recorded,
            "frames": experiment.frame_count,
            "trial": experiment.trial,
            "asset": None if asset is None else asset.sha256,
            "dataset": dataset_record(
                experiment.name,
                drivers=experiment.drivers,
                reference=experiment.reference_source,
            ),
        }
    )
