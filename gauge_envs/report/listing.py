"""Lists of experiments and of installed backends."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from gauge_envs.backends import backend, backend_for, backend_names
from gauge_envs.errors import BackendError, MissingExtraError
from gauge_envs.evaluation.reference import band_grade
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import Variant
from gauge_envs.references.imported import has_import
from gauge_envs.report.table import Column, Table
from gauge_envs.report.text import pairs_text, short_id, shortened

__all__ = ["backend_rows", "backend_table", "list_rows", "list_table", "unsupported_features_of"]


def list_rows(variants: Iterable[Variant]) -> list[dict[str, Any]]:
    """Return one row per variant; `backends` maps each installed backend to the features of the scene that it lacks."""
    rows = []
    for variant in variants:
        experiment = load_experiment(variant)
        rows.append(
            {
                "id": variant.id,
                "family": variant.family,
                "group": experiment.spec.group.value,
                "observable": experiment.score.observable.value,
                "frames": experiment.frame_count,
                "grade": band_grade(variant.name).value,
                "imported": has_import(variant.name),
                "backends": unsupported_features_of(experiment),
            }
        )
    return rows


def unsupported_features_of(experiment: Experiment) -> dict[str, list[str]]:
    """Return what each installed backend lacks for an experiment; an empty list for a backend that can run it."""
    return {name: _lacks(name, experiment) for name in backend_names()}


def _lacks(name: str, experiment: Experiment) -> list[str]:
    try:
        return list(backend_for(name, experiment.model_file).supports(experiment.scene).missing)
    except (BackendError, MissingExtraError) as error:
        return [str(error)]


def list_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the rows of `list_rows` as a table."""
    imported = [short_id(row["id"]) for row in rows if row["imported"]]
    return Table(
        columns=(
            Column("id", "id"),
            Column("group", "group", wide_only=True),
            Column("observable", "observable"),
            Column("frames", "frames", is_number=True, wide_only=True),
            Column("grade", "grade"),
            Column("imported", "imported trials", lambda known: "yes" if known else "no", wide_only=True),
            Column("backends", "runs on", _usable_text),
        ),
        rows=rows,
        notes=(f"Real trials imported for {shortened(imported)}.",) if imported else (),
    )


def _usable_text(backends: dict[str, list[str]]) -> str:
    return ", ".join(name for name, lacks in backends.items() if not lacks) or "none"


def backend_rows() -> list[dict[str, Any]]:
    """Return the installed backends: name, versions of the engine, and the error of one that cannot be used."""
    rows: list[dict[str, Any]] = []
    for name in backend_names():
        try:
            rows.append({"name": name, "versions": backend(name).versions(), "error": None})
        except (BackendError, MissingExtraError) as error:
            rows.append({"name": name, "versions": {}, "error": str(error)})
    return rows


def backend_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the rows of `backend_rows` as a table."""
    return Table(columns=(Column("name", "backend"), Column("", "engine", _engine_text)), rows=rows)


def _engine_text(row: dict[str, Any]) -> str:
    return row["error"] or pairs_text(row["versions"]).replace(" = ", " ")
