"""What the command line prints: rows for JSON, and the same as tables for reading."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from gauge_envs.backends import backend, backend_names
from gauge_envs.errors import MissingExtraError
from gauge_envs.experiment import Experiment, experiment
from gauge_envs.materials import MAPPINGS, Fabric, bending_length_m, shear_stiffness, uniaxial_stiffness
from gauge_envs.reference import BandGrade, band_grade, law_for, load_band, published_baselines
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
    "description",
    "description_view",
    "list_rows",
    "list_table",
    "material_values",
    "material_view",
    "result_label",
    "summary_view",
]

ENGINE_TITLES = {"isaacsim": "Isaac Sim", "genesis": "Genesis", "newton": "Newton"}
METRIC_TITLES = {"rmse": "RMSE", "dtw": "DTW", "lsd": "LSD", "mte": "MTE", "pd": "PD", "el": "EL"}

NORMALIZED_NOTE = (
    "Normalized: score over the mean score of the real trials, so 1.0 is a typical real trial. RMSE and DTW: lower is "
    "closer. LSD, MTE, PD: 1 is ideal. EL is never normalized, 0 is ideal. Engines: as published (GAUGE, Table 5)."
)
GRADE_NOTES = {
    BandGrade.TRIALS: "mean and scatter per frame over real trials",
    BandGrade.RECORDING: "one recorded trial, scatter from the published baseline",
    BandGrade.LAW: "a law with calibrated parameters, scatter from the published baseline",
    BandGrade.NONE: "no real reference: RMSE and DTW are not scored",
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
                "backends": {name: _lacks(name, resolved) for name in backend_names()},
            }
        )
    return rows


def _lacks(name: str, resolved: Experiment) -> list[str]:
    try:
        return list(backend(name).supports(resolved.scene).missing)
    except MissingExtraError as error:
        return [str(error)]


def list_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Rows of `list_rows` as a table."""
    names = list(rows[0]["backends"]) if rows else []
    table = Table(box=None, header_style="bold", pad_edge=False, padding=(0, 1, 0, 0))
    for title in ("id", "group", "observable", "frames", "grade", *names):
        table.add_column(title, no_wrap=True, justify="right" if title == "frames" else "left")
    for row in rows:
        can = [_yes_no(not row["backends"][name]) for name in names]
        table.add_row(row["id"], row["group"], row["observable"], str(row["frames"]), row["grade"], *can)
    return table


def _yes_no(yes: bool) -> str:
    return "[green]yes[/]" if yes else "[dim]no[/]"


# --- show ------------------------------------------------------------------------------------------------------------


def description(variant: Variant) -> dict[str, Any]:
    """Everything that defines one experiment, JSON-ready, with where each number is from."""
    resolved = experiment(variant)
    spec, scene = resolved.spec, resolved.scene
    subtask = spec.subtasks[variant.subtask] if variant.subtask else None
    band = load_band(variant.name)
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
                "law": None if law is None else law.condition,
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
    return {
        "body": driver.body,
        "provenance": driver.provenance,
        "note": stated.note,
        "motions": [motion.model_dump(exclude_none=True) for motion in stated.motions],
    }


def description_view(values: Mapping[str, Any]) -> Group:
    """The dictionary of `description`, for reading."""
    observable, reference = values["observable"], values["reference"]
    grade = BandGrade(reference["grade"])
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
                "grade": f"{grade.value}{trials} ({GRADE_NOTES[grade]})",
                "reference": reference["source"] or reference["law"] or "none",
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
    told = [result.backend or "file"]
    if isinstance(result.parameters, str):
        told.append(result.parameters)
    else:
        told.append(",".join(f"{key}={_value(value)}" for key, value in result.parameters.items()))
    told += [f"{key}={_value(value)}" for key, value in result.settings_given.items()]
    told += [f"seed {result.seed}"] if result.seed else []
    return ", ".join(told)


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


# --- backends --------------------------------------------------------------------------------------------------------


def backend_rows() -> list[dict[str, Any]]:
    """Installed backends: name, versions of the engine, and why it cannot be used when it cannot."""
    rows: list[dict[str, Any]] = []
    for name in backend_names():
        try:
            rows.append({"name": name, "versions": backend(name).versions(), "error": None})
        except MissingExtraError as error:
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
