"""What a plan needs to know of an engine: versions, whether repeats share a simulation, and its resolved settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gauge_envs.backends import Backend, backend_for, backend_names, engine_call, is_bundled, support_of, versions_of
from gauge_envs.errors import GaugeError, ParameterError, UnknownNameError, UnsupportedSceneError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import versions
from gauge_envs.runs.isolation import Worker
from gauge_envs.tools.sweep.key import content_sha256

FACTS_LIMIT_S = 600.0
"""Time limit of the questions to an engine of another package [s]."""


@dataclass(frozen=True)
class SettingsFacts:
    """One choice of settings for one experiment.

    Attributes:
        sha256: Hash of the resolved settings, or of the given ones where the engine does not resolve them.
        timestep_s: Time step of the integrator [s]; None where the engine does not tell.
    """

    sha256: str
    timestep_s: float | None


@dataclass(frozen=True)
class EngineFacts:
    """What a plan needs to know of an engine.

    Attributes:
        versions: Versions of its packages and of gauge-envs.
        shares_worlds: Whether repeats are worlds of one simulation.
        declined: Why the engine cannot build an experiment, by the number of the experiment.
        settings: Facts by the number of the experiment and the number of the choice, for experiments it can build.
    """

    versions: dict[str, str]
    shares_worlds: bool
    declined: dict[int, str]
    settings: dict[tuple[int, int], SettingsFacts]


def engine_facts(
    backend: str, experiments: Sequence[Experiment], choices: Sequence[Mapping[str, Any]], *, isolate: bool = False
) -> EngineFacts:
    """Ask an engine; one of another package is asked in another process.

    Args:
        backend: Name of the engine.
        experiments: The experiments.
        choices: Settings that replace those of the presets.
        isolate: Ask an engine of this package in another process, too.
    """
    if backend not in backend_names():
        raise UnknownNameError("backend", backend, backend_names())
    if is_bundled(backend) and not isolate:
        return _facts(backend, experiments, choices)
    with Worker(FACTS_LIMIT_S) as worker:
        return worker.call(_facts, backend, experiments, choices)


def _facts(backend: str, experiments: Sequence[Experiment], choices: Sequence[Mapping[str, Any]]) -> EngineFacts:
    engine = backend_for(backend, None)
    facts = EngineFacts(
        versions=versions_of(backend) | {"gauge-envs": versions()["gauge-envs"]},
        shares_worlds=type(engine).build_worlds is not Backend.build_worlds,
        declined={},
        settings={},
    )
    for number, experiment in enumerate(experiments):
        support = support_of(backend, experiment.scene, experiment.model_file)
        if not support:
            facts.declined[number] = "; ".join(support.missing)
            continue
        for choice, settings in enumerate(choices):
            facts.settings[number, choice] = _settings_facts(engine, experiment, settings)
    return facts


def _settings_facts(engine: Backend, experiment: Experiment, settings: Mapping[str, Any]) -> SettingsFacts:
    try:
        with engine_call(engine.name, "resolved_settings"):
            resolved = engine.resolved_settings(experiment.scene, settings)
    except UnsupportedSceneError:
        # The preset is one of other scenes: the episode will be declined.
        resolved = None
    except (ParameterError, UnknownNameError) as error:
        raise _with_advice(engine.name, experiment, error) from None
    timestep_s = (settings if resolved is None else resolved).get("timestep_s")
    return SettingsFacts(
        sha256=content_sha256({"given": settings} if resolved is None else resolved),
        timestep_s=timestep_s if isinstance(timestep_s, float) else None,
    )


def _with_advice(backend: str, experiment: Experiment, error: GaugeError) -> ParameterError:
    return ParameterError(
        f"{experiment.name} on {backend}: {error}. A setting or preset of one engine belongs in its own table, "
        f"[settings.{backend}]"
    )
