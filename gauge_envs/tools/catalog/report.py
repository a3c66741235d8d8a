"""Report the list of experiments, and an experiment on one screen or completely.

The pages of the documentation print the same facts as `gauge show`.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.pages.document import (
    Bullets,
    Document,
    Heading,
    Paragraph,
    Part,
    Tone,
)
from gauge_envs.pages.table import Column, Facts, Table
from gauge_envs.pages.text import (
    KIND_NOTES,
    counted,
    digits_text,
    event_title,
    pairs_text,
    plus_minus_text,
    quantity_text,
    short_id,
    shortened,
    value_text,
)
from gauge_envs.references.kind import Kind
from gauge_envs.scoring.answers import Answer
from gauge_envs.tools.catalog.spaces import shape_text

PLANTED_ERRORS = {
    "frozen": "no motion",
    "late_40_ms": "40 ms late",
    "friction_20_percent_lower": "friction 20 % lower",
    "friction_20_percent_higher": "friction 20 % higher",
    "stiffness_20_percent_lower": "stiffness 20 % lower",
    "stiffness_20_percent_higher": "stiffness 20 % higher",
}
"""Planted errors in the scene of MuJoCo, by column of `scoring/sees.csv`."""

UNCHANGED = "unchanged"
"""Name of the scene without a planted error."""

SECTIONS = {
    "parameter_sets": "Parameter sets",
    "engines": "Engines",
    "action": "Action",
    "observation": "Observation",
    "bodies": "Bodies",
    "contacts": "Contacts",
    "joints": "Joints",
    "attachments": "Attachments",
    "drivers": "Prescribed motions",
    "air": "Air",
    "baselines": "Published scores",
    "source": "Sources",
    "provenance": "Sources of numbers",
}
"""Headings of the complete description, by key of `description`."""


def list_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return the rows of `list_rows` as a table."""

    def usable_text(backends: Mapping[str, Sequence[str]]) -> str:
        usable = [name for name, missing in backends.items() if not missing]
        return ", ".join(usable) or "none"

    return Table(
        columns=(
            Column("id", "id", short_id),
            Column("observable", "observable", wide_only=True),
            Column("frames", "frames", is_number=True, wide_only=True),
            Column("kind", "kind"),
            Column("backends", "runs on", usable_text),
        ),
        rows=rows,
    )


# --- one screen -------------------------------------------------------------------------------------------------------


def experiment_document(values: Mapping[str, Any]) -> Document:
    """Return the facts of an experiment and its constants.

    Args:
        values: Result of `description`.
    """
    hidden = ["sources, scene, spaces, decisions: --format wide"]
    if values["limits"]:
        hidden.insert(0, counted(len(values["limits"]), "known limit"))
    note = Paragraph(", ".join(hidden), Tone.NOTE)
    return Document(parts=[*_screen(values), note], rows=[values])


def _screen(values: Mapping[str, Any]) -> list[Part]:
    """Return title, summary, facts and constants of an experiment."""
    facts = motion_facts(values) | _support_facts(values) | constants_facts(values)
    return [
        Paragraph(f"{values['id']}  {values['title']}", Tone.ANSWER),
        Paragraph(values["summary"]),
        Paragraph(""),
        Facts(facts),
    ]


def motion_facts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return observable, reference, spaces and prescribed motions of an experiment; empty texts are left out."""
    observable, reference = values["observable"], values["reference"]
    measured = f"{observable['kind'].replace('_', ' ')} [{observable['unit']}]"
    measured += f" of {shortened(observable['coordinates'])}"
    facts = {
        "measured": measured,
        "frames": f"{values['frames']} at 30 Hz",
        "reference": reference_text(reference, frames=values["frames"]),
        "source": reference["source"],
        "exact solution": _exact_text(reference["exact"]),
        "real events": events_text(reference["events"]),
        "planted errors": planted_errors_text(reference),
        "reward": reference["reward"],
        "action": _action_text(values["action"]),
        "observation": _observation_text(values["observation"]),
    }
    for driver in values["drivers"]:
        motion = f"{driver['note']} ({driver['provenance']})"
        facts[f"motion of {driver['body']}"] = motion
    return {name: text for name, text in facts.items() if text}


def _support_facts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the engines of an experiment, impossible published scores, and the changes of an edited scene."""
    facts = {"engines": _engines_text(values["engines"])}
    if values["reference"]["impossible"]:
        facts["published wrongly"] = values["reference"]["impossible"]
    asset = values["asset"]
    if asset:
        facts["asset"] = f"{asset['file']}, sha256 {asset['sha256'][:8]}"
        facts["gravity"] = f"{values['gravity_m_per_s2']:g} m/s^2"
        facts["edited"] = (
            "; ".join(asset["changes"]) or "no: the scene of the task file"
        )
    return facts


def constants_facts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the constants of each body with their sources."""
    facts = {}
    for body, table in values["constants"].items():
        by_source: dict[str, dict[str, Any]] = {}
        for key, constant in table.items():
            by_source.setdefault(constant["source"], {})[key] = constant["value"]
        texts = [
            f"{pairs_text(group)} ({source})" for source, group in by_source.items()
        ]
        facts[body] = "; ".join(texts)
    return facts


def reference_text(reference: Mapping[str, Any], *, frames: int) -> str:
    """Return the description of a reference, its uncertainty u, and the zero-motion distance."""
    if reference["single_shot"]:
        return "one real trial with the same initial state; it differs for each trial"
    parts = [KIND_NOTES[Kind(reference["kind"])]]
    if reference["trial_count"]:
        parts.append(counted(reference["trial_count"], "trial"))
    if reference["unit"] is not None:
        uncertainty = distance_text(reference, "standard_uncertainty")
        zero_motion = distance_text(reference, "zero_motion_distance")
        parts.append(f"standard uncertainty u = {uncertainty}")
        parts.append(f"if nothing moved, the error would be {zero_motion}")
        if reference["known_frames"] < frames:
            parts.append(f"known at {reference['known_frames']} of {frames} frames")
    return "; ".join(parts)


def distance_text(reference: Mapping[str, Any], key: str) -> str:
    """Return a distance of a reference with its unit; a dash without a reference motion."""
    if reference["unit"] is None:
        return "-"
    return f"{quantity_text(reference[key])} {reference['unit']}"


def _exact_text(exact: Mapping[str, float]) -> str:
    """Return the scores of an exact solution by parameter set; empty without one."""
    if not exact:
        return ""
    scores = ", ".join(f"{score:.2f} ({name})" for name, score in exact.items())
    return f"scores {scores}, divided by real trials"


def events_text(events: Sequence[Mapping[str, Any]]) -> str:
    """Return events with their real values and standard uncertainties; empty without events."""
    texts = []
    for event in events:
        uncertainty = event["standard_uncertainty"]
        value = plus_minus_text(event["value"], uncertainty, event["unit"])
        texts.append(f"{event_title(event['name'])}: {value}")
    return "; ".join(texts)


def _action_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the meaning of each entry of the action that has an effect."""
    texts = [f"{row['meaning']} ({row['unit']})" for row in rows if row["unit"] != "1"]
    return "; ".join(texts) or "none"


def _observation_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the entries of the observation with their shapes; several rows may describe one entry."""
    entries = dict.fromkeys(
        f"{row['entry']} {shape_text(row['whole'])}" for row in rows
    )
    return ", ".join(entries)


def planted_errors_text(reference: Mapping[str, Any]) -> str:
    """Return the scores of planted errors in a line; empty without planted errors."""
    texts = []
    rows = reference["sees"]
    for row, (metric, scores) in zip(
        rows, planted_error_scores(reference), strict=True
    ):
        if row["answers"]["nominal"] == Answer.NO:
            text = f"the unchanged scene fails already with {scores[UNCHANGED]}"
            texts.append(f"{metric}: {text}, so no error can change the verdict")
            continue
        detected = [f"{title} {score}" for title, score in scores.items() if score]
        text = f"{metric}: {', '.join(detected)}"
        missed = [title for title, score in scores.items() if not score]
        if missed:
            text += f"; not detected: {', '.join(missed)}"
        texts.append(text)
    return ". ".join(texts)


def planted_error_scores(
    reference: Mapping[str, Any],
) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield each metric with its unit, and the score of each planted error by name; empty if it is not detected.

    An error is detected if it changes the answer to the unchanged scene to no. The score of that scene has the name
    `UNCHANGED`.
    """
    for row in reference["sees"]:
        scores = {UNCHANGED: digits_text(row["nominal"])}
        for key, title in PLANTED_ERRORS.items():
            score = row[key]
            if score is None:
                continue
            scores[title] = ""
            if row["answers"][key] == Answer.NO != row["answers"]["nominal"]:
                scores[title] = digits_text(score)
        metric = event_title(row["metric"])
        if row["unit"] != "1":
            metric += f" [{row['unit']}]"
        yield metric, scores


def _engines_text(engines: Sequence[Mapping[str, Any]]) -> str:
    """Return the engines that run here, that do not run here, and that cannot build the scene."""
    groups: dict[str, list[str]] = {"run it": [], "not here": [], "cannot build it": []}
    for row in engines:
        name = row["engine"]
        if name == EnvArguments.backend:
            name += " (default)"
        title = "run it"
        if row["missing"]:
            title = "cannot build it"
        elif row["fault"]:
            title = "not here"
        groups[title].append(name)
    texts = [f"{title}: {', '.join(names)}" for title, names in groups.items() if names]
    return "; ".join(texts)


# --- complete description ---------------------------------------------------------------------------------------------


def full_document(values: Mapping[str, Any]) -> Document:
    """Return the screen of an experiment, followed by limits, decisions, and the entries of `SECTIONS`."""
    parts = _screen(values)
    limits = [limit["text"] for limit in values["limits"]]
    for title, lines in (("Known limits", limits), ("Decisions", values["decisions"])):
        if lines:
            parts.append(Bullets(lines, title))
    for key, title in SECTIONS.items():
        facts = _entries(values[key])
        if facts:
            parts += [Heading(title), Facts(facts)]
    return Document(parts=parts, rows=[values])


def _entries(
    part: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None,
) -> dict[str, str]:
    """Return the texts of a table or list by name or number; a list's empty and zero values are left out."""
    if isinstance(part, Mapping):
        return {name: value_text(value) for name, value in part.items()}
    texts = {}
    for number, entry in enumerate(part or (), 1):
        name = entry.get("name") or entry.get("engine") or str(number)
        nonzero = {key: value for key, value in entry.items() if not _is_zero(value)}
        texts[name] = pairs_text(nonzero, skip=("name", "engine", "entry", "whole"))
    return texts


def _is_zero(value: Any) -> bool:
    """Return whether a value is empty or zero, as the entries of a list are."""
    if isinstance(value, list):
        return not any(value)
    return not value
