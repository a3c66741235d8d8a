"""Experiments in words: the list, and each in full."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part, Tone
from gauge_envs.pages.results import convergence_text
from gauge_envs.pages.table import Column, Facts, Table
from gauge_envs.pages.text import (
    KIND_NOTES,
    METRIC_TITLES,
    NORMALIZED_NOTE,
    digits_text,
    event_title,
    pairs_text,
    plus_minus_text,
    quantity_text,
    score_text,
    short_id,
    shortened,
    value_text,
)
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.tools.catalog.spaces import range_text, shape_text

PUBLISHED_NOTE = "Engine scores over real trials (GAUGE, Table 5)."

SEEN = {
    "nominal": "MuJoCo",
    "frozen": "frozen",
    "late_40_ms": "40 ms late",
    "friction_20_percent_lower": "friction 20 % lower",
    "friction_20_percent_higher": "20 % higher",
    "stiffness_20_percent_lower": "stiffness 20 % lower",
    "stiffness_20_percent_higher": "20 % higher",
}
"""What was scored, by column of `scoring/sees.csv`."""


def list_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return the rows of `list_rows` as a table."""
    imported = [short_id(row["id"]) for row in rows if row["imported"]]
    # An engine that runs nothing is not installed or broken; it is no exception in each row.
    working = {
        name for row in rows for name, lacks in row["backends"].items() if not lacks
    }
    return Table(
        columns=(
            Column("id", "id"),
            Column("group", "group", wide_only=True),
            Column("observable", "observable", wide_only=True),
            Column("frames", "frames", is_number=True, wide_only=True),
            Column("kind", "kind"),
            Column(
                "imported",
                "imported trials",
                lambda known: "yes" if known else "no",
                wide_only=True,
            ),
            Column("backends", "runs on", partial(_usable_text, working=working)),
        ),
        rows=rows,
        notes=(f"Real trials imported for {shortened(imported)}.",) if imported else (),
    )


def _usable_text(
    backends: Mapping[str, Sequence[str]], *, working: Collection[str]
) -> str:
    """Return the engines that run an experiment, of those that run any."""
    usable = [name for name, lacks in backends.items() if not lacks]
    others = [name for name, lacks in backends.items() if lacks and name in working]
    if len(usable) > 2 and len(others) < 2:
        return f"all {len(usable)}" if not others else f"all but {others[0]}"
    return ", ".join(usable) or "none"


def experiment_document(values: Mapping[str, Any], *, detailed: bool) -> Document:
    """Return the dictionary of `description` in words.

    Args:
        values: The dictionary.
        detailed: Whether to add the scene, the source of each number, decisions and parameter sets to what fits a page.
    """
    limits = [limit_text(one) for one in values["limits"]]
    short: tuple[Part, ...] = (
        Paragraph(f"{values['id']}  {values['title']}", Tone.ANSWER),
        Paragraph(values["summary"]),
        Paragraph(""),
        Facts(_facts(values)),
        Heading("Action and observation"),
        Facts(_entries([*values["action"], *values["observation"]])),
        *_engines(values),
        _published(values),
        *([Bullets(limits, "Known limits")] if limits else []),
        Heading("Constants"),
        Facts(_constants(values["constants"])),
        *_drivers(values),
    )
    if detailed:
        return Document(parts=(*short, *_details(values)), rows=[values])
    more = Paragraph("Scene, decisions and all sources: --format wide", Tone.NOTE)
    return Document(parts=(*short, more), rows=[values])


def _facts(values: Mapping[str, Any]) -> dict[str, str]:
    observable, reference, asset = (
        values["observable"],
        values["reference"],
        values["asset"],
    )
    g = f"{observable['kind']} [{observable['unit']}], {values['frames']} frames at 30 Hz"
    facts = {
        "g(t)": f"{g}: {shortened(observable['coordinates'])}",
        "reference": reference_text(reference, frames=values["frames"]),
        "source": reference["source"] or "",
        "recorded": events_text(reference["events"]),
        "sees": sees_text(reference["sees"]),
        "reward": reference["reward"],
        "published": reference["impossible"],
    }
    if asset is not None:
        facts["asset"] = f"{asset['file']}, sha256 {asset['sha256'][:8]}"
        facts["edited"] = "; ".join(asset["changes"]) or "no: the calibrated scene"
    return {name: text for name, text in facts.items() if text}


def reference_text(reference: Mapping[str, Any], *, frames: int) -> str:
    """Return kind, trials, u, distance without motion, known frames, and scores of exact solutions."""
    parts = [reference["kind"]]
    if reference["single_shot"]:
        parts.append("one trial with the same start, and each has its own")
    elif reference["trial_count"]:
        parts = [f"{reference['kind']} ({reference['trial_count']})"]
    if reference["unit"] is None:
        return f"{parts[0]}: {KIND_NOTES[Kind.NONE]}"
    for name, key in (
        ("u", "standard_uncertainty"),
        ("a frozen scene is off by", "zero_motion_distance"),
    ):
        parts.append(f"{name} {quantity_text(reference[key])} {reference['unit']}")
    if reference["known_frames"] < frames:
        parts.append(f"known at {reference['known_frames']} of {frames} frames")
    exact = [f"{score:.2f} ({name})" for name, score in reference["exact"].items()]
    if exact:
        parts.append(f"an exact solution scores {', '.join(exact)} over real trials")
    return ", ".join(parts)


def events_text(events: Sequence[Mapping[str, Any]]) -> str:
    """Return events with their real values and standard uncertainties; empty without any."""
    return "; ".join(
        f"{event_title(one['name'])}: "
        f"{plus_minus_text(one['value'], one['standard_uncertainty'], one['unit'])}"
        for one in events
    )


def sees_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows of `scoring/sees.csv` in a line; empty without any."""
    texts = []
    for row in rows:
        scores = [
            f"{title} {digits_text(row[key])}"
            for key, title in SEEN.items()
            if row[key] is not None
        ]
        unit = "" if row["unit"] == "1" else f" [{row['unit']}]"
        texts.append(f"{event_title(row['metric'])}{unit}: {', '.join(scores)}")
    return "; ".join(texts)


def _published(values: Mapping[str, Any]) -> Part:
    """Return the published scores, which are of reality whatever the reference is."""
    if not values["baselines"]:
        return Paragraph("Published: none")
    note = PUBLISHED_NOTE
    if Kind(values["reference"]["kind"]).is_solution:
        note += " This id is scored against a solution."
    return published_table(values["baselines"], title="Published", note=note)


def limit_text(limit: Mapping[str, Any]) -> str:
    """Return a known limit, with the study that shows it."""
    return limit["text"] + (f" (study: {limit['study']})" if limit["study"] else "")


def _constants(
    constants: Mapping[str, Mapping[str, Mapping[str, Any]]],
) -> dict[str, str]:
    """Return the constants of bodies that share them, those of a source before it."""
    names: dict[str, list[str]] = {}
    for name, table in constants.items():
        by_source: dict[str, dict[str, Any]] = {}
        for key, constant in table.items():
            by_source.setdefault(constant["source"], {})[key] = constant["value"]
        text = "; ".join(
            f"{pairs_text(group)} ({source})" for source, group in by_source.items()
        )
        names.setdefault(text, []).append(name)
    return {shortened(sharing): text for text, sharing in names.items()}


def _entries(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the entries of action and observation with their shapes, and what each holds."""
    found: dict[str, str] = {}
    for row in rows:
        key = f"{row['entry']} {shape_text(row['whole'])}".rstrip()
        text = f"{row['meaning']}, {range_text(row)}{'' if row['unit'] == '1' else ' ' + row['unit']}"
        found[key] = f"{found[key]}; {text}" if key in found else text
    return found


# --- engines ----------------------------------------------------------------------------------------------------------


def step_text(step_s: float) -> str:
    """Return a time step as a fraction of a second, or in seconds if it is none."""
    count = 1.0 / step_s
    return (
        f"1/{round(count)}"
        if abs(count - round(count)) < 1e-6 * count
        else f"{step_s:.4g}"
    )


def reasons_text(missing: Sequence[str]) -> str:
    """Return why an engine declines a scene: the first reason, and the number of the others; empty without any."""
    return (
        ""
        if not missing
        else missing[0]
        + (f" (and {len(missing) - 1} more)" if len(missing) > 1 else "")
    )


def _engines(values: Mapping[str, Any]) -> Iterator[Part]:
    """Yield the engines that build a scene, and why the others do not."""
    running = [row for row in values["engines"] if not row["missing"]]
    yield Table(
        title="Engines",
        columns=(
            Column(
                "engine",
                "engine",
                lambda name: (
                    f"{name} (default)" if name == EnvArguments.backend else name
                ),
            ),
            Column("preset", "preset"),
            Column("timestep_s", "step [s]", step_text, is_number=True),
            Column("", "works here", _works),
        ),
        rows=running,
    )
    yield Facts(
        {
            row["engine"]: f"no: {reasons_text(row['missing'])}"
            for row in values["engines"]
            if row["missing"]
        }
    )


def _works(row: Mapping[str, Any]) -> str:
    return "yes" if row["fault"] is None else "no, see gauge list backends"


def convergence_facts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return what half the step and half the cell change, by engine, of those that were measured."""
    has_cells = any(body["kind"] != "rigid" for body in values["bodies"])
    is_verified = Kind(values["reference"]["kind"]).is_solution
    return {
        row["engine"]: convergence_text(
            row["convergence"],
            has_cells=has_cells,
            with_unit=True,
            over_trials=not is_verified,
        )
        for row in values["engines"]
        if row["convergence"]
    }


# --- details ----------------------------------------------------------------------------------------------------------


def _drivers(values: Mapping[str, Any]) -> Iterator[Part]:
    for driver in values["drivers"]:
        yield Paragraph(
            f"Driver of {driver['body']} ({driver['provenance']}): {driver['note']}"
        )


def _details(values: Mapping[str, Any]) -> Iterator[Part]:
    sets = {
        name: f"{chosen['summary']}: {pairs_text(chosen['values']) or 'as stated'}"
        for name, chosen in values["parameter_sets"].items()
    }
    sections = {
        "Sources": {"evaluates": ", ".join(values["evaluates"])} | values["source"],
        "Bodies": {body["name"]: _fields(body) for body in values["bodies"]},
        "Contacts": {
            f"{shortened(one['first'])} on {shortened(one['second'])}": pairs_text(
                one, skip=("first", "second")
            )
            for one in values["contacts"]
        },
        "Joints": {
            f"{one.get('kind', 'attachment')} {number}": _fields(one)
            for number, one in enumerate((*values["joints"], *values["attachments"]), 1)
        },
        "Motions": {
            f"{driver['body']} {number}": _fields(motion)
            for driver in values["drivers"]
            for number, motion in enumerate(driver["motions"], 1)
        },
        "Air": {
            name: value_text(value) for name, value in (values["air"] or {}).items()
        },
        "Convergence": convergence_facts(values),
        "Where the numbers are from": values["provenance"],
        "Parameter sets": sets,
    }
    for title, facts in sections.items():
        if facts:
            yield Heading(title)
            yield Facts(facts)
    if values["decisions"]:
        yield Heading("Decisions")
        yield Bullets(values["decisions"])


def _fields(values: Mapping[str, Any]) -> str:
    """Return the values that are not zero, without the name."""
    stated = {
        key: value
        for key, value in values.items()
        if (any(value) if isinstance(value, list) else value)
    }
    return pairs_text(stated, skip=("name",))


def published_table(
    lines: Sequence[Mapping[str, Any]],
    *,
    title: str = "",
    note: str = NORMALIZED_NOTE,
    columns: Sequence[Column] = (),
) -> Table:
    """Return published scores as a table.

    Args:
        lines: The baselines.
        title: Its title; empty for none.
        note: Line below it; empty for none.
        columns: Columns before the metric.
    """

    def trials(line: Mapping[str, Any]) -> str:
        return plus_minus_text(line["mean"], line["std"], line["unit"])

    return Table(
        title=title,
        columns=(
            *columns,
            Column("metric", "metric", METRIC_TITLES.__getitem__),
            Column("", "real trials", trials, is_number=True),
            *(
                Column(f"engines.{key}", title, score_text, is_number=True)
                for key, title in PUBLISHED_ENGINES.items()
            ),
        ),
        rows=lines,
        notes=(note,) if lines and note else (),
    )
