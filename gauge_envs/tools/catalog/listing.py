"""Lists of experiments and of installed backends."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from gauge_envs.backends import backend, backend_names, is_bundled, support_of, versions_of
from gauge_envs.errors import GaugeError, MissingExtraError
from gauge_envs.evaluation.reference import band_grade
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import Variant
from gauge_envs.pages.table import Column, Table
from gauge_envs.pages.text import pairs_text, short_id, shortened
from gauge_envs.references.imported import has_import
from gauge_envs.runs.isolation import Worker

QUERY_LIMIT_S = 60.0
"""Time for which an engine outside this package may answer [s]."""


def list_rows(
    variants: Iterable[Variant],
    *,
    isolate: bool = False,
    notify: Callable[[str], None] | None = None,
) -> list[dict[str, Any]]:
    """Return one row per variant; `backends` maps each installed backend to the features of the scene that it lacks.

    Args:
        variants: The variants.
        isolate: Whether backends outside this package answer in a process of their own.
        notify: Receives one sentence for each backend that does not work.
    """
    experiments = {variant: load_experiment(variant) for variant in variants}
    scenes = list(experiments.values())
    lacking = {name: _lacking(name, scenes, isolate=isolate, notify=notify) for name in backend_names()}
    rows = []
    for index, (variant, experiment) in enumerate(experiments.items()):
        rows.append(
            {
                "id": variant.id,
                "family": variant.family,
                "group": experiment.spec.group.value,
                "observable": experiment.score.observable.value,
                "frames": experiment.frame_count,
                "grade": band_grade(variant.name).value,
                "imported": has_import(variant.name),
                "backends": {name: lacks[index] for name, lacks in lacking.items()},
            }
        )
    return rows


def _lacking(
    name: str, experiments: Sequence[Experiment], *, isolate: bool, notify: Callable[[str], None] | None
) -> list[list[str]]:
    """Return what a backend lacks for each experiment, or its error."""
    try:
        if not isolate or is_bundled(name):
            lacks, fault = _lacks_of_each(name, experiments)
        else:
            with Worker(QUERY_LIMIT_S) as worker:
                lacks, fault = worker.call(_lacks_of_each, name, experiments)
    except GaugeError as error:
        fault = f"backend {name!r}: {error}"
        lacks = [[fault]] * len(experiments)
    if fault is not None and notify is not None:
        notify(fault)
    return lacks


def _lacks_of_each(name: str, experiments: Sequence[Experiment]) -> tuple[list[list[str]], str | None]:
    """Return what a backend lacks for each experiment, and the first error that it raised, or None."""
    try:
        backend(name)
    except GaugeError as error:
        # No scene changes that; to look for the engine again takes longer than its answer would.
        return [[str(error)]] * len(experiments), None if isinstance(error, MissingExtraError) else str(error)
    lacks, fault = [], None
    for experiment in experiments:
        try:
            lacks.append(list(support_of(name, experiment.scene, experiment.model_file).missing))
        except GaugeError as error:
            lacks.append([str(error)])
            if not isinstance(error, MissingExtraError):
                fault = fault or str(error)
    return lacks, fault


def unsupported_features_of(experiment: Experiment) -> dict[str, list[str]]:
    """Return what each installed backend lacks for an experiment; an empty list for a backend that can run it.

    Backends outside this package answer in a process of their own.
    """
    return {name: _isolated_lacks(name, experiment) for name in backend_names()}


def _isolated_lacks(name: str, experiment: Experiment) -> list[str]:
    if is_bundled(name):
        return _lacks(name, experiment)
    try:
        with Worker(QUERY_LIMIT_S) as worker:
            return worker.call(_lacks, name, experiment)
    except GaugeError as error:
        return [f"backend {name!r}: {error}"]


def _lacks(name: str, experiment: Experiment) -> list[str]:
    try:
        return list(support_of(name, experiment.scene, experiment.model_file).missing)
    except GaugeError as error:
        return [str(error)]


def list_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the rows of `list_rows` as a table."""
    imported = [short_id(row["id"]) for row in rows if row["imported"]]
    # An engine that runs nothing is not installed or broken; it is no exception in each row.
    working = {name for row in rows for name, lacks in row["backends"].items() if not lacks}
    return Table(
        columns=(
            Column("id", "id"),
            Column("group", "group", wide_only=True),
            Column("observable", "observable", wide_only=True),
            Column("frames", "frames", is_number=True, wide_only=True),
            Column("grade", "grade"),
            Column("imported", "imported trials", lambda known: "yes" if known else "no", wide_only=True),
            Column("backends", "runs on", partial(_usable_text, working=working)),
        ),
        rows=rows,
        notes=(f"Real trials imported for {shortened(imported)}.",) if imported else (),
    )


def _usable_text(backends: dict[str, list[str]], *, working: Collection[str]) -> str:
    """Return the engines that run an experiment, of those that run any."""
    usable = [name for name, lacks in backends.items() if not lacks]
    others = [name for name, lacks in backends.items() if lacks and name in working]
    if len(usable) > 2 and len(others) < 2:
        return f"all {len(usable)}" if not others else f"all but {others[0]}"
    return ", ".join(usable) or "none"


def backend_rows(*, isolate: bool = False) -> list[dict[str, Any]]:
    """Return the installed backends: name, versions of the engine, and the error of one that cannot be used.

    Args:
        isolate: Whether backends outside this package answer in a process of their own.
    """
    rows: list[dict[str, Any]] = []
    for name in backend_names():
        try:
            rows.append({"name": name, "versions": _versions(name, isolate=isolate), "error": None})
        except GaugeError as error:
            rows.append({"name": name, "versions": {}, "error": str(error)})
    return rows


def _versions(name: str, *, isolate: bool) -> Mapping[str, str]:
    if not isolate or is_bundled(name):
        return versions_of(name)
    with Worker(QUERY_LIMIT_S) as worker:
        return worker.call(versions_of, name)


def backend_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the rows of `backend_rows` as a table."""
    return Table(columns=(Column("name", "backend"), Column("", "engine", _engine_text)), rows=rows)


def _engine_text(row: dict[str, Any]) -> str:
    return row["error"] or pairs_text(row["versions"]).replace(" = ", " ")
