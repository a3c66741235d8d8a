"""What the command line prints: rows for JSON, and the same as tables for reading."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Group
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from gauge_envs.backends import backend, backend_names
from gauge_envs.comparison import (
    METRICS,
    MOTION_SHARE,
    Cell,
    Comparison,
    Configuration,
    Distance,
    ExperimentComparison,
    Metric,
    Spread,
)
from gauge_envs.dataset.store import DriverRecord, load_imported
from gauge_envs.diagnosis import Diagnosis, PublishedScore, StagePart
from gauge_envs.driver import DriverSource, Profile, SampledProfile
from gauge_envs.errors import BackendError, MissingExtraError
from gauge_envs.experiment import Experiment, experiment
from gauge_envs.materials import MAPPINGS, Fabric, bending_length_m, shear_stiffness, uniaxial_stiffness
from gauge_envs.reference import BandGrade, SigmaSource, band_grade, law_for, load_band, published_baselines
from gauge_envs.result import Outcome, Result, json_ready
from gauge_envs.scene import Deformable, Hinge, RigidBody
from gauge_envs.task_format import Variant
from gauge_envs.trajectory_file import coordinate_names

__all__ = [
    "ENGINE_TITLES",
    "GRADE_NOTES",
    "METRIC_TITLES",
    "NORMALIZED_NOTE",
    "backend_rows",
    "backend_table",
    "comparison_markdown",
    "comparison_rows",
    "comparison_view",
    "configuration_labels",
    "description",
    "description_view",
    "diagnosis_rows",
    "diagnosis_view",
    "list_rows",
    "list_table",
    "material_values",
    "material_view",
    "result_label",
    "score_text",
    "summary_view",
]

ENGINE_TITLES = {"isaacsim": "Isaac Sim", "genesis": "Genesis", "newton": "Newton"}
METRIC_TITLES = {"rmse": "RMSE", "dtw": "DTW", "lsd": "LSD", "mte": "MTE", "pd": "PD", "el": "EL"}
ALIGNED_TITLE = "RMSE aligned"
COST_TITLE = "wall s/sim s"

NORMALIZED_NOTE = (
    "Normalized: score over the mean score of the real trials, so 1.0 is a typical real trial. RMSE and DTW: lower is "
    "closer. LSD, MTE, PD: 1 is ideal. EL is never normalized, 0 is ideal. Engines: as published (GAUGE, Table 5)."
)
GRADE_NOTES = {
    BandGrade.TRIALS: "mean and scatter per frame over real trials",
    BandGrade.RECORDING: "one recorded trial, scatter from the published baseline where there is one",
    BandGrade.LAW: "a law with calibrated parameters, scatter from the published baseline",
    BandGrade.NONE: "no real reference: RMSE and DTW are not scored",
}

SIGMA_NOTES = {
    SigmaSource.TRIALS: "scatter of the trials, per frame",
    SigmaSource.BASELINE: "from the published scatter, constant and the same for each coordinate",
    SigmaSource.MEASUREMENT: "uncertainty of the measurement; the scatter of trials is not known",
}


# --- list ------------------------------------------------------------------------------------------------------------


def list_rows(variants: Iterable[Variant]) -> list[dict[str, Any]]:
    """One row a variant; `backends` maps each installed backend to an empty list, or to what it lacks."""
    rows = []
    for variant in variants:
        resolved = experiment(variant)
        rows.append(
            {
                "id": variant.id,
                "family": variant.family,
                "group": resolved.spec.group.value,
                "observable": resolved.spec.score.observable.value,
                "frames": resolved.frame_count,
                "grade": band_grade(variant.name).value,
                "imported": load_imported(variant.name) is not None,
                "backends": {name: _lacks(name, resolved) for name in backend_names()},
            }
        )
    return rows


def _lacks(name: str, resolved: Experiment) -> list[str]:
    try:
        return list(backend(name).supports(resolved.scene).missing)
    except (BackendError, MissingExtraError) as error:
        return [str(error)]


def list_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Rows of `list_rows` as a table."""
    names = list(rows[0]["backends"]) if rows else []
    table = Table(box=None, header_style="bold", pad_edge=False, padding=(0, 1, 0, 0))
    for title in ("id", "group", "observable", "frames", "grade", *names):
        table.add_column(title, no_wrap=True, justify="right" if title == "frames" else "left")
    for row in rows:
        can = [_yes_no(not row["backends"][name]) for name in names]
        grade = f"{row['grade']}, imported" if row["imported"] else row["grade"]
        table.add_row(row["id"], row["group"], row["observable"], str(row["frames"]), grade, *can)
    return table


def _yes_no(yes: bool) -> str:
    return "[green]yes[/]" if yes else "[dim]no[/]"


# --- show ------------------------------------------------------------------------------------------------------------


def description(variant: Variant) -> dict[str, Any]:
    """Everything that defines one experiment, JSON-ready, with where each number is from."""
    resolved = experiment(variant)
    spec, scene = resolved.spec, resolved.scene
    subtask = spec.subtasks[variant.subtask] if variant.subtask else None
    band, imported = load_band(variant.name), load_imported(variant.name)
    law = law_for(variant.name)
    return json_ready(
        {
            "id": variant.id,
            "title": spec.title if subtask is None else f"{spec.title}, {subtask.title}",
            "summary": spec.summary,
            "group": spec.group.value,
            "evaluates": spec.evaluates,
            "source": spec.source.model_dump(exclude_none=True),
            "frames": resolved.frame_count,
            "duration_s": scene.duration_s,
            "observable": {
                "kind": spec.score.observable.value,
                "unit": resolved.spec.score.observable.unit,
                "coordinates": coordinate_names(resolved),
            },
            "bodies": [_body(body, resolved) for body in (*scene.bodies, *scene.deformables)],
            "contacts": [dataclasses.asdict(contact) for contact in scene.contacts],
            "joints": [
                {"kind": "hinge" if isinstance(joint, Hinge) else "tether"} | dataclasses.asdict(joint)
                for joint in scene.joints
            ],
            "attachments": [dataclasses.asdict(attachment) for attachment in scene.attachments],
            "drivers": [_driver(resolved, index) for index in range(len(scene.drivers))],
            "markers": None if scene.markers is None else {"count": len(scene.markers.positions_m)},
            "constants": {
                name: tables.get(variant.material, next(iter(tables.values()), {}))
                for name, tables in spec.constants.items()
            },
            "parameter_sets": {
                "calibrated": {"summary": "calibrated constants of the metadata", "values": {}},
                **{
                    name: {"summary": chosen.summary, "values": dict(experiment(variant, name).overrides)}
                    for name, chosen in spec.parameters.items()
                },
            },
            "provenance": spec.provenance,
            "decisions": spec.decisions,
            "reference": {
                "grade": band_grade(variant.name).value,
                "trial_count": None if band is None else band.trial_count,
                "source": None if band is None else band.source,
                "imported": imported is not None,
                "law": None if law is None else law.condition,
                "sigma_source": None if band is None else band.sigma_source.value,
                "known_frames": None if band is None else int(np.isfinite(band.mean).any(axis=1).sum()),
                "withheld": None if band is None else band.withheld,
            },
            "baselines": [dataclasses.asdict(line) for line in published_baselines(variant.name).values()],
            "backends": {name: _lacks(name, resolved) for name in backend_names()},
        }
    )


def _body(body: RigidBody | Deformable, resolved: Experiment) -> dict[str, Any]:
    described: dict[str, Any] = {
        "name": body.name,
        "kind": "rigid" if isinstance(body, RigidBody) else type(body).__name__.lower(),
        "recorded": body.name in resolved.recorded,
    }
    values = {f.name: getattr(body, f.name) for f in dataclasses.fields(body)}
    shape = values.pop("shape", None)
    if shape is not None:
        described["shape"] = {"kind": type(shape).__name__} | dataclasses.asdict(shape)
    pose = values.pop("pose")
    return described | values | {"position_m": pose.position_m, "quaternion_wxyz": pose.quaternion}


def _driver(resolved: Experiment, index: int) -> dict[str, Any]:
    variant, spec, driver = resolved.variant, resolved.spec, resolved.scene.drivers[index]
    own = spec.subtasks[variant.subtask].drivers if variant.subtask else None
    stated = (own if own is not None else spec.drivers)[index]
    motions = [motion.model_dump(exclude_none=True) for motion in stated.motions]
    note, recorded = stated.note, _recorded_driver(resolved, driver.body)
    in_use = recorded is not None and resolved.drivers is DriverSource.IMPORTED
    if recorded is not None and in_use:
        note = f"{_recorded_note(recorded)}; not in use is the bundled one: {note}"
        for motion, used in zip(motions, driver.motions, strict=True):
            motion["profile"] = [_sampled(profile, motion["kind"]) for profile in used.profiles]
    elif recorded is not None:
        note = f"{note}; not in use is the imported one: gauge data use --drivers imported"
    return {
        "body": driver.body,
        "provenance": driver.provenance,
        "imported": in_use,
        "note": note,
        "motions": motions,
    }


def _recorded_driver(resolved: Experiment, body: str) -> DriverRecord | None:
    """The imported driver of a body, in use or not."""
    imported = load_imported(resolved.variant.name)
    if imported is None:
        return None
    return next((record for record in imported.record.drivers if record.body == body), None)


def _sampled(profile: Profile, kind: str) -> dict[str, Any]:
    """An imported profile as a task file would state it."""
    assert isinstance(profile, SampledProfile)
    values = profile.values if kind == "translate" else [math.degrees(value) for value in profile.values]
    unit = "m" if kind == "translate" else "deg"
    return {"kind": "sampled", "times_s": list(profile.times_s), f"values_{unit}": list(values)}


def _recorded_note(record: DriverRecord) -> str:
    angle = "" if record.residual_deg is None else f" and {record.residual_deg:.2g} deg"
    return (
        f"mean motion of the body in {record.trial_count} imported trials, from its calibrated start, which is "
        f"{record.start_offset_mm:.2g} mm from theirs; its motions leave {record.residual_mm:.2g} mm{angle} out (rms)"
    )


def description_view(values: Mapping[str, Any]) -> Group:
    """The dictionary of `description`, for reading."""
    observable, reference = values["observable"], values["reference"]
    grade = BandGrade(reference["grade"])
    withheld = reference["withheld"] is not None
    trials = f", {reference['trial_count']} trials" if reference["trial_count"] else ""
    parts: list[Any] = [
        Text(f"{values['id']}  {values['title']}", style="bold"),
        Text(values["summary"]),
        Text(""),
        _facts(
            {
                "evaluates": ", ".join(values["evaluates"]),
                "sources": "; ".join(f"{key}: {text}" for key, text in values["source"].items()),
                "episode": f"{values['frames']} frames at 30 Hz, {values['duration_s']:.3f} s",
                "g(t)": f"{observable['kind']} [{observable['unit']}]: {_shortened(observable['coordinates'])}",
                "grade": f"{grade.value}{trials} ({GRADE_NOTES[grade]})" + (", recording withheld" * withheld),
                "reference": reference["source"] or reference["law"] or "none",
                **_band_facts(values),
                **{f"on {name}": "; ".join(lacks) or "runs" for name, lacks in values["backends"].items()},
            }
        ),
        _heading("Bodies"),
        _rows(
            ("name", "motion", "shape", "mass [kg]", "position [m]", "quaternion wxyz"),
            [
                (
                    body["name"] + (" (recorded)" if body["recorded"] else ""),
                    body.get("motion", body["kind"]),
                    _shape(body),
                    f"{body['mass_kg']:.10g}" if body["mass_kg"] else "-",
                    _vector(body["position_m"]),
                    _vector(body["quaternion_wxyz"]),
                )
                for body in values["bodies"]
            ],
        ),
        _heading("Contacts"),
        _rows(
            ("first", "second", "friction", "restitution", "mode"),
            [
                (
                    _shortened(c["first"]),
                    _shortened(c["second"]),
                    f"{c['friction']:.10g}",
                    f"{c['restitution']:.10g}",
                    c["mode"],
                )
                for c in values["contacts"]
            ],
        ),
    ]
    if values["joints"] or values["attachments"]:
        parts.append(_heading("Joints"))
        parts += [Text(_pairs(joint)) for joint in (*values["joints"], *values["attachments"])]
    for driver in values["drivers"]:
        parts += [
            _heading(f"Driver of {driver['body']} ({driver['provenance']})"),
            Text(driver["note"]),
            *(Text(f"  {_pairs(motion)}") for motion in driver["motions"]),
        ]
    parts += [
        _heading("Constants"),
        _facts({name: _pairs(table) for name, table in values["constants"].items()}),
        _heading("Where the numbers are from"),
        _facts(values["provenance"]),
        _heading("Decisions"),
        *(Text(f"- {line}") for line in values["decisions"] or ["none"]),
        _heading("Parameter sets"),
        _facts(
            {
                name: chosen["summary"] + (f": {_pairs(chosen['values'])}" if chosen["values"] else "")
                for name, chosen in values["parameter_sets"].items()
            }
        ),
        _heading("Published"),
        _rows(
            ("metric", "real trials", *ENGINE_TITLES.values()),
            [
                (
                    METRIC_TITLES[line["metric"]],
                    _plus_minus(line["mean"], line["std"], line["unit"]),
                    *(_number(line["engines"][engine]) for engine in ENGINE_TITLES),
                )
                for line in values["baselines"]
            ],
        ),
        Text(NORMALIZED_NOTE, style="dim"),
    ]
    return Group(*parts)


def _band_facts(values: Mapping[str, Any]) -> dict[str, str]:
    """What there is to say of a band that does not cover everything, or that is not used."""
    reference = values["reference"]
    facts = {}
    if reference["known_frames"] is not None and reference["known_frames"] < values["frames"]:
        facts["known"] = f"{reference['known_frames']} of {values['frames']} frames"
    if reference["sigma_source"] is not None:
        facts["sigma"] = SIGMA_NOTES[SigmaSource(reference["sigma_source"])]
    if reference["withheld"] is not None:
        facts["withheld"] = f"{reference['withheld']}; use_withheld=True or gauge score --use-withheld scores on it"
    return facts


def _heading(text: str) -> Text:
    return Text(f"\n{text}", style="bold")


def _facts(pairs: Mapping[str, str]) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_column(style="cyan")
    table.add_column(overflow="fold")
    for key, value in pairs.items():
        table.add_row(escape(key), escape(value))
    return table


def _rows(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> Table | Text:
    if not rows:
        return Text("none", style="dim")
    table = Table(box=None, header_style="dim", pad_edge=False)
    for title in titles:
        table.add_column(escape(title), overflow="fold")
    for row in rows:
        table.add_row(*map(escape, row))
    return table


def _pairs(values: Mapping[str, Any], *, skip: Sequence[str] = ()) -> str:
    return ", ".join(f"{key} = {_value(value)}" for key, value in values.items() if key not in skip)


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        return f"({_pairs(value)})"
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value[:4]))}{f', ... {len(value)} in all' if len(value) > 4 else ''}]"
    return str(value)


def _shape(body: Mapping[str, Any]) -> str:
    shape = dict(body.get("shape") or {"kind": body["kind"]})
    kind = shape.pop("kind")
    if "pieces_m" in shape:
        return f"{kind}, {len(shape['pieces_m'])} pieces"
    skip = ("name", "kind", "recorded", "motion", "shape", "mass_kg", "position_m", "quaternion_wxyz")
    return " ".join(filter(None, (kind, _pairs(shape), _pairs(body, skip=skip))))


def _vector(values: Sequence[float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)


def _shortened(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 6 else f"{', '.join(names[:3])}, ... {names[-1]} ({len(names)})"


def _plus_minus(mean: float, std: float | None, unit: str) -> str:
    scatter = "" if std is None else f" +- {std:g}"
    return f"{mean:g}{scatter}{'' if unit == '1' else f' {unit}'}"


def _number(value: float | None) -> str:
    # Adding 0.0 makes a rounded -0.00 plain zero.
    return "-" if value is None else f"{round(value, 2) + 0.0:.2f}" if abs(value) < 100 else f"{value:.3g}"


# --- results ---------------------------------------------------------------------------------------------------------


def result_label(result: Result) -> str:
    """What sets a result apart from others of its experiment: `mujoco, calibrated, timestep_s=0.001, seed 3`."""
    told = [text for _, text in _parts(Configuration.of(result))]
    return ", ".join([*told, f"seed {result.seed}"] if result.seed else told)


def summary_view(results: Sequence[Result]) -> Group:
    """Scores of results beside the published ones, with grades and what the numbers mean; then what was not run."""
    ran = [result for result in results if result.error is None]
    parts: list[Any] = []
    if ran:
        parts += [_score_table(ran), Text("")]
        parts.append(Text(NORMALIZED_NOTE, style="dim"))
        parts.append(
            Text(
                "Aligned: normalized RMSE after the constant time shift in brackets (reality is let go later when +). "
                "|z|: mean deviation in sigma of the real trials; one more real trial has 0.80.",
                style="dim",
            )
        )
        grades = sorted({result.score.grade for result in ran})
        parts += [Text(f"Grade {grade}: {GRADE_NOTES[BandGrade(grade)]}.", style="dim") for grade in grades]
        parts += [
            Text(f"{result.id.removeprefix('GAUGE/')} is scored on a band that is withheld: {result.score.withheld}.")
            for result in ran
            if result.score.withheld
        ]
    for outcome, style in ((Outcome.DIVERGED, "red"), (Outcome.FAILED, "red"), (Outcome.DECLINED, "yellow")):
        # One line for each reason: a backend declines many experiments for the same one.
        reasons: dict[str, list[str]] = {}
        for result in results:
            if result.outcome is outcome:
                name = result.id.removeprefix("GAUGE/")
                reason = (result.error or result.diverged_reason or "").replace(f"{result.id}: ", "")
                reasons.setdefault(reason.removeprefix(f"{name} "), []).append(name)
        parts += [
            Text.assemble((f"{outcome.value}: ", style), f"{_shortened(ids)}: {reason}")
            for reason, ids in reasons.items()
        ]
    return Group(*parts)


def _score_table(results: Sequence[Result]) -> Table:
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("experiment", overflow="fold")
    table.add_column("grade")
    table.add_column("metric")
    for title in ("score", "normalized", *ENGINE_TITLES.values(), "aligned", "|z|"):
        table.add_column(title, justify="right", no_wrap=True)
    for result in results:
        rows = _score_rows(result)
        driven = ", nominal driver" if "nominal" in (result.driver_provenance or "") else ""
        names = [result.id.removeprefix("GAUGE/"), f"[dim]{escape(result_label(result) + driven)}[/]"]
        for index in range(max(len(rows), len(names))):
            name = names[index] if index < len(names) else ""
            table.add_row(name, result.score.grade if index == 0 else "", *(rows[index] if index < len(rows) else ()))
    return table


def _score_rows(result: Result) -> list[tuple[str, ...]]:
    """Rows of metric, score, normalized score, three engines, aligned, |z|: every metric that we or the paper have."""
    if result.diverged:
        return [("", "[red]diverged[/]", "-", "-", "-", "-", "-", "-")]
    score, baselines = result.score, published_baselines(result.id.removeprefix("GAUGE/"))
    rows = []
    for metric, title in METRIC_TITLES.items():
        raw = getattr(score, metric if metric in ("rmse", "dtw", "mte", "el") else f"{metric}_s")
        line = baselines.get(metric)
        if raw is None and line is None:
            continue
        unit = score.unit if metric in ("rmse", "dtw") else "s" if metric in ("lsd", "pd") else ""
        aligned, z = "", ""
        if metric == "rmse":
            z = _number(score.mean_abs_z)
            if score.rmse_aligned_normalized is not None and score.release_offset_s is not None:
                aligned = f"{_number(score.rmse_aligned_normalized)} ({score.release_offset_s:+.3f} s)"
        rows.append(
            (
                title,
                "-" if raw is None else f"{_number(raw)} {unit}".strip(),
                _number(getattr(score, f"{metric}_normalized", None)),
                *(_number(line.engines[engine] if line else None) for engine in ENGINE_TITLES),
                aligned,
                z,
            )
        )
    return rows or [("none", "-", "-", "-", "-", "-", "", "")]


# --- comparison ------------------------------------------------------------------------------------------------------

PLAIN = ("parameters", "calibrated")
"""What a configuration has where nothing else is said."""


def configuration_labels(configurations: Sequence[Configuration]) -> list[str]:
    """What sets each configuration apart from the others: the engine, and whatever they do not all share.

    A single one is told in full, `mujoco, calibrated`; among several, `calibrated` goes without saying.
    """
    labels = _labels(configurations, digits=4)
    if len(set(labels)) < len(labels):
        labels = _labels(configurations, digits=17)
    return [
        label if labels.count(label) == 1 else f"{label} ({labels[:index].count(label) + 1})"
        for index, label in enumerate(labels)
    ]


def _labels(configurations: Sequence[Configuration], *, digits: int) -> list[str]:
    exact = [_parts(configuration, digits=17) for configuration in configurations]
    left_out = set.intersection(*map(set, exact)) | {PLAIN} if len(exact) > 1 else set()
    versions_of: dict[str | None, set[str]] = {}
    for configuration in configurations:
        versions_of.setdefault(configuration.backend, set()).add(_versions(configuration))
    labels = []
    for configuration, parts in zip(configurations, exact, strict=True):
        rounded = _parts(configuration, digits=digits)
        kept = [
            text for part, (kind, text) in zip(parts, rounded, strict=True) if kind == "engine" or part not in left_out
        ]
        if len(versions_of[configuration.backend]) > 1:
            kept.append(_versions(configuration))
        labels.append(", ".join(kept))
    return labels


def _parts(configuration: Configuration, *, digits: int = 4) -> list[tuple[str, str]]:
    """What a configuration consists of, as kind and text; numbers are rounded to the digits."""

    def told(values: Mapping[str, Any]) -> list[str]:
        return [f"{key}={f'{v:.{digits}g}' if isinstance(v, float) else _value(v)}" for key, v in values.items()]

    named = configuration.parameters
    return [
        ("engine", configuration.backend or "file"),
        ("parameters", named if isinstance(named, str) else ",".join(told(named))),
        *(("setting", text) for text in told(configuration.settings_given)),
        *([("jitter", f"jitter {' '.join(told(configuration.jitter))}")] if configuration.jitter else []),
        *([("markers", f"markers by {configuration.marker_proxy}")] if configuration.marker_proxy != "node" else []),
    ]


def _versions(configuration: Configuration) -> str:
    return " ".join(f"{name} {text}" for name, text in configuration.engine_versions.items())


def comparison_rows(comparison: Comparison, metrics: Sequence[str] = tuple(METRICS)) -> list[dict[str, Any]]:
    """One JSON-ready object an experiment and metric, with everything that is known of it.

    An experiment that has none of the metrics has one object with `metric` None.
    """
    labels = configuration_labels(comparison.configurations)
    rows = []
    for one in comparison.experiments:
        names: list[str | None] = [*one.metrics(metrics)]
        for name in names or [None]:
            metric = METRICS[name] if name else None
            line = one.baselines.get((metric.published if metric else None) or "")
            rows.append(
                {
                    "id": one.id,
                    "grade": one.grade,
                    "metric": name,
                    "unit": _metric_unit(one, metric) if metric else None,
                    "real": None if line is None else {"mean": line.mean, "std": line.std},
                    "published": None if line is None else dict(line.engines),
                    "configurations": [
                        _configuration_row(label, configuration, cell, metric)
                        for label, configuration, cell in zip(labels, comparison.configurations, one.cells, strict=True)
                    ],
                    "distances": [
                        dataclasses.asdict(far) | {"first": labels[far.first], "second": labels[far.second]}
                        for far in one.distances
                    ],
                    "notes": list(comparison.notes),
                }
            )
    return json_ready(rows)


def _configuration_row(
    label: str, configuration: Configuration, cell: Cell | None, metric: Metric | None
) -> dict[str, Any]:
    ran = [] if cell is None else [result for result in cell.results if result.error is None]
    return {
        "label": label,
        **dataclasses.asdict(configuration),
        "outcomes": [] if cell is None else [result.outcome.value for result in cell.results],
        "reasons": [] if cell is None else [result.error or result.diverged_reason for result in cell.results],
        "seeds": [] if cell is None else [result.seed for result in cell.results],
        "raw": _spread_row(cell, metric, normalized=False),
        "normalized": _spread_row(cell, metric, normalized=True),
        "wall_s_per_sim_s": None if cell is None else cell.wall_s_per_sim_s,
        "settings": ran[0].settings if ran else None,
        "versions": ran[0].versions if ran else None,
    }


def _spread_row(cell: Cell | None, metric: Metric | None, *, normalized: bool) -> dict[str, Any] | None:
    spread = None if cell is None or metric is None else cell.spread(metric, normalized=normalized)
    if cell is None or metric is None or spread is None:
        return None
    return dataclasses.asdict(spread) | {"values": cell.values(metric, normalized=normalized)}


@dataclasses.dataclass(frozen=True)
class _Section:
    """A table and what is said about it, to be printed in colour or as Markdown."""

    heading: str
    titles: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    text_columns: int
    notes: tuple[str, ...] = ()


def comparison_view(comparison: Comparison, metrics: Sequence[str] = tuple(METRICS)) -> Group:
    """Scores, distances between engines, and a summary, for reading in a terminal."""
    parts: list[Any] = [] if comparison.experiments else [Text("no results to compare")]
    for section in _sections(comparison, metrics):
        table = Table(box=None, header_style="bold", pad_edge=False, padding=(0, 2, 0, 0))
        for index, title in enumerate(section.titles):
            is_text = index < section.text_columns
            lines = title if is_text else title.replace(", ", "\n").replace("=", "=\n")
            table.add_column(escape(lines), justify="left" if is_text else "right", overflow="fold", no_wrap=is_text)
        for row in section.rows:
            table.add_row(*(f"[red]{escape(cell)}[/]" if "diverged" in cell else escape(cell) for cell in row))
        parts += [_heading(section.heading), table, *(Text(note, style="dim") for note in section.notes)]
    return Group(*parts)


def comparison_markdown(comparison: Comparison, metrics: Sequence[str] = tuple(METRICS)) -> str:
    """The same as GitHub Markdown."""
    lines: list[str] = []
    for section in _sections(comparison, metrics):
        rule = ["---" if index < section.text_columns else "---:" for index in range(len(section.titles))]
        lines += [f"**{section.heading}**", ""]
        lines += [_markdown_row(row) for row in (section.titles, rule, *section.rows)]
        # Two blanks end a line in Markdown.
        lines += ["", *(f"{_markdown(note)}  " for note in section.notes), ""]
    return "\n".join(lines).rstrip() + "\n"


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(map(_markdown, cells))} |"


def _markdown(text: str) -> str:
    return re.sub(r"([|*_<\\])", r"\\\1", text)


def _sections(comparison: Comparison, metrics: Sequence[str]) -> list[_Section]:
    if not comparison.experiments:
        return []
    labels = configuration_labels(comparison.configurations)
    far = [one for one in comparison.experiments if one.grade == BandGrade.NONE.value and one.distances]
    sections = [_score_section(comparison, labels, metrics)]
    if far:
        sections.append(_distance_section(far, labels))
    sections.append(_summary_section(comparison, labels))
    return sections


def _score_section(comparison: Comparison, labels: Sequence[str], metrics: Sequence[str]) -> _Section:
    rows = []
    for one in comparison.experiments:
        names = one.metrics(metrics)
        lines = [_score_line(one, name) for name in names] or [
            ("none", "-", *(_cell_text(cell, None) for cell in one.cells), *("-" for _ in ENGINE_TITLES))
        ]
        costs = [_cost_text(None if cell is None else cell.wall_s_per_sim_s) for cell in one.cells]
        lines.append((COST_TITLE, "", *costs, *("" for _ in ENGINE_TITLES)))
        rows += [
            (one.name if index == 0 else "", one.grade if index == 0 else "", *line) for index, line in enumerate(lines)
        ]
    published = (f"{title}, paper" for title in ENGINE_TITLES.values())
    return _Section(
        "Scores over the mean score of the real trials",
        ("experiment", "grade", "metric", "1 = real trials", *labels, *published),
        rows,
        4,
        _legend(comparison, labels, rows),
    )


def _score_line(one: ExperimentComparison, name: str) -> tuple[str, ...]:
    metric = METRICS[name]
    line = one.baselines.get(metric.published or "")
    cells = (_cell_text(cell, metric) for cell in one.cells)
    engines = (score_text(line.engines[engine] if line else None) for engine in ENGINE_TITLES)
    real = "-"
    if name == "el":
        real = "0 is ideal"
    elif (scale := one.baselines.get("rmse") if name == "rmse_aligned" else line) is not None:
        real = _plus_minus(scale.mean, scale.std, scale.unit)
    return (METRIC_TITLES.get(name, ALIGNED_TITLE), real, *cells, *engines)


def _metric_unit(one: ExperimentComparison, metric: Metric) -> str:
    return one.unit if metric.unit is None else metric.unit


def _cell_text(cell: Cell | None, metric: Metric | None) -> str:
    """Mean and scatter of a cell, or why there is none."""
    if cell is None:
        return "-"
    count = len(cell.results)
    bad = [
        outcome.value if number == count else f"{number} {outcome.value}"
        for outcome in (Outcome.DIVERGED, Outcome.FAILED, Outcome.DECLINED)
        if (number := cell.count(outcome))
    ]
    told = []
    if metric is not None:
        # What has no baseline to be divided by is told in its own unit.
        normalized = cell.spread(metric, normalized=True)
        spread = normalized or cell.spread(metric, normalized=False)
        if spread is not None:
            unit = "" if normalized or metric.unit == "1" else f" {metric.unit or cell.results[0].score.unit}"
            told.append(_spread_text(spread) + unit)
    return ", ".join(told + bad) or "no score"


def _spread_text(spread: Spread) -> str:
    scatter = "" if spread.std is None else f" +- {score_text(spread.std)} ({spread.count})"
    return f"{score_text(spread.mean)}{scatter}"


def score_text(value: float | None) -> str:
    """Two decimals, or two digits where they would be lost."""
    return f"{value:.2g}" if value is not None and abs(value) < 0.1 else _number(value)


def _cost_text(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}" if value < 10.0 else f"{value:.0f}"


def _legend(comparison: Comparison, labels: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    notes = [NORMALIZED_NOTE]
    words = {
        "-": "-: not run, or not published",
        "no score": "no score: it ran, but there is no reference, or what is measured did not happen",
        "diverged": "diverged: the simulation left what is physically possible, so it has no score",
        "declined": "declined: the engine cannot build the scene",
        "failed": "failed: the episode ended in an error",
    }
    used = [cell for row in rows for cell in row[4:]]
    meanings = [
        text for word, text in words.items() if any(word == cell or (word != "-" and word in cell) for cell in used)
    ]
    notes += [f"{'; '.join(meanings)}."] if meanings else []
    if any("+-" in cell for row in rows for cell in row[4 : 4 + len(labels)]):
        notes.append("Repeats, which differ in their seed alone: mean +- sample standard deviation (how many).")
    if any(ALIGNED_TITLE in row for row in rows):
        notes.append(f"{ALIGNED_TITLE}: RMSE after the constant time shift that fits best.")
    grades = sorted({one.grade for one in comparison.experiments})
    notes.append(f"Grades: {'; '.join(f'{grade}: {GRADE_NOTES[BandGrade(grade)]}' for grade in grades)}.")
    first, *others = comparison.configurations
    if others:
        exact = [_parts(one, digits=17) for one in others]
        pairs = zip(_parts(first, digits=17), _parts(first), strict=True)
        shared = [text for part, (_, text) in pairs if all(part in parts for parts in exact)]
        notes += [f"All: {', '.join(shared)}."] if shared else []
        notes += ["Parameters are calibrated unless stated."] if PLAIN[1] not in shared else []
    engines = dict.fromkeys(f"{one.backend or 'file'}: {_versions(one) or '-'}" for one in comparison.configurations)
    notes.append(f"Versions: {'; '.join(engines)}.")
    if not others:
        notes.append("One configuration: there is nothing to compare it with but what was published.")
    return (*notes, *(f"Note: {note}." for note in comparison.notes))


def _distance_section(experiments: Sequence[ExperimentComparison], labels: Sequence[str]) -> _Section:
    rows = [
        (
            one.name if index == 0 else "",
            f"{labels[far.first]} : {labels[far.second]}",
            f"{_quantity(far.rms.mean)}{f' +- {_quantity(far.rms.std)}' if far.rms.std is not None else ''} {far.unit}",
            f"{_quantity(far.motion_rms)} {far.unit}",
            f"{_quantity(far.threshold)} {far.unit}{'' if far.threshold_is_scatter else ' *'}",
            _apart(far),
        )
        for one in experiments
        for index, far in enumerate(one.distances)
    ]
    notes = [
        "Distance: Euclidean over all coordinates at a frame, root mean square over the frames that both have. "
        "Motion: the same of the way from the start. Neither says who is right.",
        "Threshold: published mean RMSE of the real trials, that is how far a typical one is from their mean."
        + (f" * not published: {MOTION_SHARE:.0%} of the motion." if any("*" in row[4] for row in rows) else ""),
    ]
    titles = ("experiment", "between", "distance", "motion", "threshold", "first exceeded")
    return _Section("Where engines disagree: no reference, so distances between them", titles, rows, 2, tuple(notes))


def _apart(far: Distance) -> str:
    ending = ", diverged" if far.diverged else ""
    return ("never" if far.apart_at_s is None else f"{far.apart_at_s:.2f} s") + ending


def _quantity(value: float) -> str:
    """Three digits, without an exponent where the number is neither tiny nor huge."""
    if 1e3 <= value < 1e5:
        return f"{value:.0f}"
    return f"{value:.3g}" if value >= 1e-3 or value == 0.0 else f"{value:.1e}"


def _summary_section(comparison: Comparison, labels: Sequence[str]) -> _Section:
    common, ran = comparison.scored_by_all, comparison.run_by_all
    rows: list[tuple[str, ...]] = [
        (
            label,
            str(one.ran),
            str(one.scored),
            str(one.diverged),
            str(one.not_run),
            score_text(one.geometric_mean),
            _cost_text(one.wall_s_per_sim_s),
            _cost_text(one.wall_s_per_sim_s_common),
        )
        for label, one in zip(labels, comparison.summaries(), strict=True)
    ]
    for engine, title in ENGINE_TITLES.items():
        mean = comparison.published_geometric_mean(engine)
        if mean is not None:
            rows.append((f"{title}, paper", "-", "-", "-", "-", score_text(mean), "-", "-"))
    names = [one.name for one in common]
    over = f"over the {len(common)} that all have scored ({_shortened(names)})" if common else "none is scored by all"
    notes = (
        f"Geometric mean of the normalized RMSE, {over}. It is descriptive and ranks nothing: experiments differ in "
        "difficulty and in the quality of their reference, the variants of one family are not independent, and release "
        "timing is in it.",
        f"{COST_TITLE}: wall time of reset and steps over simulated time, building the scene not included; repeats "
        f"that ran together share it; in common: over the {len(ran)} that all ran. Comparable only on one machine.",
    )
    titles = ("configuration", "ran", "scored", "diverged", "not run", "geometric mean", COST_TITLE, "in common")
    return _Section("Summary", titles, rows, 1, notes)


# --- diagnosis -------------------------------------------------------------------------------------------------------

MOST_AXES = 6

DIAGNOSIS_LEGEND = (
    "Parts are added from the top down, each fitted together with those above it: what they take off the squared error "
    "(share) and off the normalized RMSE adds up to the whole. Alone: share taken off as the only change; last: after "
    "both others. Normalized: over the published mean RMSE of the real trials."
)


def diagnosis_rows(pairs: Iterable[tuple[Result, Diagnosis]]) -> list[dict[str, Any]]:
    """One JSON-ready object a result: what it is of, and its error budget."""
    keys = ("backend", "parameters", "settings_given", "seed", "jitter")
    return [
        json_ready({key: getattr(result, key) for key in keys} | {"label": result_label(result)}) | diagnosis.to_dict()
        for result, diagnosis in pairs
    ]


def diagnosis_view(pairs: Sequence[tuple[Result, Diagnosis]]) -> Group:
    """Error budgets for reading: a table and findings for each result, then what the columns mean."""
    parts: list[Any] = []
    for result, diagnosis in pairs:
        parts.append(_heading(f"{diagnosis.id.removeprefix('GAUGE/')}  {result_label(result)}"))
        parts.append(_budget_table(diagnosis))
        axes = _axis_table(diagnosis)
        parts += [] if axes is None else [axes]
        parts += [Text(f"- {line}") for line in diagnosis.findings()]
        parts += [Text(line, style="dim") for line in _budget_notes(diagnosis)]
    if pairs:
        parts += [Text(""), Text(DIAGNOSIS_LEGEND, style="dim")]
        parts += [Text(f"Published engines: {pairs[0][1].published_note}", style="dim")]
    return Group(*parts)


def _budget_table(diagnosis: Diagnosis) -> Table:
    table = Table(box=None, header_style="dim", pad_edge=False)
    for title in ("part", f"RMSE left [{diagnosis.unit}]", "normalized", "taken off", "share", "alone", "last"):
        table.add_column(escape(title), justify="left" if title == "part" else "right", no_wrap=True)
    table.add_column("fitted together", overflow="fold")
    whole = diagnosis.rmse_normalized
    table.add_row("as it is", _quantity(diagnosis.rmse), score_text(whole), "", "", "", "", "")
    for part in diagnosis.parts:
        before, after = part.rmse_before_normalized, part.rmse_after_normalized
        off = "-" if before is None or after is None else score_text(before - after)
        shares = (_share(part.share), _share(part.alone_share), _share(part.last_share))
        cells = (off, *shares, _changes(part)) if part.missing is None else ("-", "-", "-", "-", "does not apply")
        table.add_row(part.stage.value, _quantity(part.rmse_after), score_text(after), *map(escape, cells))
    rest = diagnosis.rest
    left = "-" if rest.rmse_normalized is None else score_text(rest.rmse_normalized)
    table.add_row("rest", "", "", left, _share(rest.share), "", "", "")
    return table


def _axis_table(diagnosis: Diagnosis) -> Table | None:
    """Shares of the whole squared error by axis; None where there is one coordinate only, or too many to tell."""
    axes = diagnosis.axes()
    if len(diagnosis.coordinates) == 1 or len(axes) > MOST_AXES or diagnosis.mean_square == 0.0:
        return None
    columns = {"all": diagnosis.by_coordinate}
    columns |= {part.stage.value: part.by_coordinate for part in diagnosis.parts if part.missing is None}
    columns["rest"] = diagnosis.rest.by_coordinate
    table = Table(box=None, header_style="dim", pad_edge=False)
    table.add_column("share along")
    for title in columns:
        table.add_column(title, justify="right", no_wrap=True)
    for axis, indices in axes.items():
        sums = (sum(values[index] for index in indices) for values in columns.values())
        table.add_row(escape(axis), *(_share(value / diagnosis.mean_square) for value in sums))
    return table


def _changes(part: StagePart) -> str:
    """All changes in force after a part; offsets of many coordinates by their root mean square."""
    told = []
    offsets = [change for change in part.changes if change.quantity == "offset"]
    for change in part.changes:
        unit = "" if change.unit == "1" else f" {change.unit}"
        mark = " (limit)" if change.at_bound else ""
        if change.quantity == "release_time":
            told.append(f"release {change.fitted:+.3f}{unit}{mark}")
        elif change.quantity != "offset":
            told.append(f"{change.quantity} {change.simulated:.4g} -> {change.fitted:.4g}{unit}{mark}")
        elif len(offsets) <= 3:
            told.append(f"{change.coordinate} {change.fitted:+.3g}{unit}")
        elif change is offsets[0]:
            rms = (sum(one.fitted**2 for one in offsets) / len(offsets)) ** 0.5
            told.append(f"{len(offsets)} offsets, rms {_quantity(rms)}{unit}")
    return ", ".join(told)


def _share(share: float) -> str:
    return f"{100.0 * share + 0.0:.1f} %"


def _budget_notes(diagnosis: Diagnosis) -> list[str]:
    grade = BandGrade(diagnosis.grade)
    lines = [f"Grade {grade.value}: {GRADE_NOTES[grade]}. Motion: {diagnosis.kind.value.replace('_', ' ')}."]
    if diagnosis.extrapolated_frames:
        lines.append(
            f"{diagnosis.extrapolated_frames} of {diagnosis.frames} frames are extrapolated, not measured; "
            f"{_share(diagnosis.extrapolated_share)} of the squared error lies in them."
        )
    lines += [f"Note: {note}." for note in diagnosis.notes]
    engines = [
        f"{ENGINE_TITLES[name]} {told}" for name, one in diagnosis.published.items() if (told := _published_text(one))
    ]
    if engines:
        own = "" if diagnosis.dtw_over_rmse is None else f" (here DTW/RMSE {diagnosis.dtw_over_rmse:.2f})"
        lines.append(f"Published{own}: {'; '.join(engines)}.")
    return lines


def _published_text(one: PublishedScore) -> str:
    told = {"RMSE": one.rmse_normalized, "DTW/RMSE": one.dtw_over_rmse, "period over the real one": one.period_ratio}
    return ", ".join(f"{title} {value:.2f}" for title, value in told.items() if value is not None)


# --- backends --------------------------------------------------------------------------------------------------------


def backend_rows() -> list[dict[str, Any]]:
    """Installed backends: name, versions of the engine, and why it cannot be used when it cannot."""
    rows: list[dict[str, Any]] = []
    for name in backend_names():
        try:
            rows.append({"name": name, "versions": backend(name).versions(), "error": None})
        except (BackendError, MissingExtraError) as error:
            rows.append({"name": name, "versions": {}, "error": str(error)})
    return rows


def backend_table(rows: Sequence[Mapping[str, Any]]) -> Table | Text:
    """Rows of `backend_rows` as a table."""
    return _rows(
        ("backend", "engine"),
        [(row["name"], row["error"] or _pairs(row["versions"]).replace(" = ", " ")) for row in rows],
    )


# --- materials -------------------------------------------------------------------------------------------------------


def material_values(fabrics: Mapping[str, Fabric]) -> dict[str, dict[str, dict[str, float]]]:
    """Constants of every fabric in every engine's terms: fabric, engine, constant."""
    return {
        name: {engine: mapping(fabric).constants for engine, mapping in MAPPINGS.items()}
        for name, fabric in fabrics.items()
    }


def material_view(fabrics: Mapping[str, Fabric]) -> Group:
    """Constants of every fabric in every engine's terms, what comes back from them, and every fall-back and loss."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    for title in ("", "unit", *fabrics):
        table.add_column(escape(title), justify="left" if title in ("", "unit") else "right", overflow="fold")

    def add(title: str, unit: str, values: Iterable[float], marks: Iterable[str], style: str | None = None) -> None:
        cells = (f"{value:.4g}{mark or ' '}" for value, mark in zip(values, marks, strict=True))
        table.add_row(f"  {title}", escape(unit), *cells, style=style)

    table.add_row("[bold]measured[/]")
    plain = [""] * len(fabrics)
    for title, unit, attribute in (
        ("K_s", "N/m", "stretch_stiffness_n_per_m"),
        ("K_sh", "N/m", "shear_stiffness_n_per_m"),
        ("K_theta", "N m/rad", "bend_stiffness_n_m_per_rad"),
        ("thickness", "m", "thickness_m"),
        ("areal density", "kg/m^2", "areal_density_kg_per_m2"),
    ):
        add(title, unit, (getattr(fabric, attribute) for fabric in fabrics.values()), plain)
    add("bending length", "m", map(bending_length_m, fabrics.values()), plain, "dim")
    notes: dict[str, list[str]] = {}
    for engine, mapping in MAPPINGS.items():
        mapped = {name: mapping(fabric) for name, fabric in fabrics.items()}
        table.add_row(f"[bold]{engine}[/]")
        for constant, unit in next(iter(mapped.values())).units.items():
            marks = ["*" if constant in constants.replaced else "" for constants in mapped.values()]
            add(constant, unit, (constants.constants[constant] for constants in mapped.values()), marks)
        add("gives stretch", "N/m", map(uniaxial_stiffness, mapped.values()), plain, "dim")
        losses = ["!" if constants.lost else "" for constants in mapped.values()]
        add("gives shear", "N/m", map(shear_stiffness, mapped.values()), losses, "dim")
        for name, constants in mapped.items():
            if constants.fallbacks or constants.lost:
                notes.setdefault(engine, []).append(f"{name}: {'; '.join((*constants.fallbacks, *constants.lost))}")
    parts: list[Any] = [table, Text("\n* set by a fall-back   ! not the measured shear stiffness", style="dim")]
    for engine, lines in notes.items():
        parts += [_heading(engine), *map(Text, lines)]
    return Group(*parts)
