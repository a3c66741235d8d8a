"""List the engines that can run each experiment."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from gauge_envs.backends import backend, backend_names, is_bundled, support_of
from gauge_envs.backends.base import scene_support
from gauge_envs.backends.registry import uninstalled_backend
from gauge_envs.errors import GaugeError, MissingExtraError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import Variant
from gauge_envs.references.user_data import has_import
from gauge_envs.runs.workers import call_engine
from gauge_envs.scoring.reference import reference_kind

QUERY_LIMIT_S = 60.0
"""Time limit for the answer of an engine outside this package [s]."""


def list_rows(
    variants: Iterable[Variant],
    *,
    notify: Callable[[str], None] = lambda _: None,
) -> list[dict[str, Any]]:
    """Return a row for each variant; `backends` maps each backend to the features of the scene that it lacks.

    Args:
        variants: The variants.
        notify: Receives a sentence for each backend that does not work.
    """
    experiments = [load_experiment(variant) for variant in variants]
    lacking = {
        name: lacking_features(name, experiments, notify) for name in backend_names()
    }
    return [
        {
            "id": experiment.id,
            "family": experiment.variant.family,
            "group": experiment.spec.group.value,
            "observable": experiment.score.observable.value,
            "frames": experiment.frame_count,
            "kind": reference_kind(experiment.name, experiment.reference_source).value,
            "imported": has_import(experiment.name),
            "backends": {name: lacks[index] for name, lacks in lacking.items()},
        }
        for index, experiment in enumerate(experiments)
    ]


def engine_rows(experiment: Experiment) -> list[dict[str, Any]]:
    """Return the support of an experiment by each backend, JSON-ready.

    `missing` has the features of the scene that the engine lacks; `fault` is the reason if it does not run here.
    Engines of this package also have the default `preset` and `timestep_s` of the scene.
    """
    rows = []
    for name in backend_names():
        row: dict[str, Any] = dict.fromkeys(
            ("missing", "fault", "preset", "timestep_s")
        )
        if not is_bundled(name) or experiment.model_file is not None:
            row["missing"] = lacking_features(name, [experiment])[0]
        else:
            engine = uninstalled_backend(name)
            row["missing"] = list(scene_support(engine, experiment.scene).missing)
            if not row["missing"]:
                settings = engine.resolved_settings(experiment.scene) or {}
                row |= {key: settings.get(key) for key in ("preset", "timestep_s")}
            try:
                backend(name)
            except GaugeError as error:
                row["fault"] = str(error)
        rows.append({"engine": name, **row})
    return rows


def lacking_features(
    name: str,
    experiments: Sequence[Experiment],
    notify: Callable[[str], None] = lambda _: None,
) -> list[list[str]]:
    """Return the missing features of a backend for each experiment, or its error; empty for supported experiments.

    A backend outside this package answers in a separate process.

    Args:
        name: Name of the backend.
        experiments: The experiments.
        notify: Receives a sentence if the backend does not work.
    """
    try:
        return call_engine(
            name, _missing_features, name, experiments, time_limit_s=QUERY_LIMIT_S
        )
    except MissingExtraError as error:
        reason = str(error)
    except GaugeError as error:
        reason = f"backend {name!r}: {error}"
        notify(reason)
    return [[reason]] * len(experiments)


def _missing_features(name: str, experiments: Sequence[Experiment]) -> list[list[str]]:
    """Return the missing features of a backend for each experiment."""
    backend(name)
    return [
        list(support_of(name, experiment.scene, experiment.model_file).missing)
        for experiment in experiments
    ]
