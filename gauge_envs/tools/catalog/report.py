"""Report the list of experiments, and an experiment on one screen or completely."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Tone
from gauge_envs.pages.table import Column, Facts, Table, grid
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

UNDETECTABLE_SHARE = 0.1
"""Largest undetectable change of a score, divided by the standard uncertainty u."""


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


def family_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return one row for each family in the result of `list_rows`: ids by kind of reference, and what it evaluates."""
    kinds: dict[str, Counter[str]] = {}
    evaluated = {}
    for row in rows:
        kinds.setdefault(row["family"], Counter())[row["kind"]] += 1
        evaluated[row["family"]] = load_experiment(row["id"]).spec.evaluates
    cells = [
        (
            family,
            ", ".join(f"{count} {kind}" for kind, count in counts.items()),
            ", ".join(evaluated[family]),
        )
        for family, counts in kinds.items()
    ]
    return grid(("family", "ids by kind of reference", "evaluates"), cells)


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
    """Return observable, reference, detected errors, engines and constants of an experiment.

    Args:
        values: Result of `description`.
    """
    observable, reference = values["observable"], values["reference"]
    measured = f"{observable['kind'].replace('_', ' ')} [{observable['unit']}]"
    measured += f" of {shortened(observable['coordinates'])}"
    exact = ", ".join(
        f"{score:.2f} ({name})" for name, score in reference["exact"].items()
    )
    facts = {
        "measured": f"{measured}; {values['frames']} frames at 30 Hz",
        "reference": reference_text(reference, frames=values["frames"]),
        "exact solution": f"scores {exact}, divided by real trials" if exact else "",
        "real events": events_text(reference["events"]),
        "planted errors": planted_errors_text(reference),
        "reward": reference["reward"],
        "action": "; ".join(
            f"{row['meaning']} ({row['unit']})"
            for row in values["action"]
            if row["unit"] != "1"
        )
        or "none",
        "observation": ", ".join(
            dict.fromkeys(
                f"{row['entry']} {shape_text(row['whole'])}"
                for row in values["observation"]
            )
        ),
        "engines": _engines_text(values["engines"]),
        "published wrongly": reference["impossible"],
    }
    if asset := values["asset"]:
        facts["asset"] = f"{asset['file']}, sha256 {asset['sha256'][:8]}"
        facts["gravity"] = f"{values['gravity_m_per_s2']:g} m/s^2"
        facts["edited"] = "; ".join(asset["changes"]) or "no: the calibrated scene"
    facts |= {body: _constants(table) for body, table in values["constants"].items()}
    limits = [counted(len(values["limits"]), "known limit")] if values["limits"] else []
    hidden = ", ".join([*limits, "sources, scene, spaces, decisions: --format wide"])
    return Document(
        parts=(
            Paragraph(f"{values['id']}  {values['title']}", Tone.ANSWER),
            Paragraph(values["summary"]),
            Paragraph(""),
            Facts({name: text for name, text in facts.items() if text}),
            Paragraph(hidden, Tone.NOTE),
        ),
        rows=[values],
    )


def reference_text(reference: Mapping[str, Any], *, frames: int) -> str:
    """Return the description of a reference, its uncertainty u, and the zero-motion distance."""
    if reference["single_shot"]:
        return "one real trial with the same initial state; it differs for each trial"
    parts = [KIND_NOTES[Kind(reference["kind"])]]
    if reference["trial_count"]:
        parts.append(counted(reference["trial_count"], "trial"))
    if reference["unit"] is not None:
        uncertainty, zero_motion = (
            f"{quantity_text(reference[key])} {reference['unit']}"
            for key in ("standard_uncertainty", "zero_motion_distance")
        )
        parts.append(f"standard uncertainty u = {uncertainty}")
        parts.append(f"a scene without motion is {zero_motion} away")
        if reference["known_frames"] < frames:
            parts.append(f"known at {reference['known_frames']} of {frames} frames")
    return "; ".join(parts)


def events_text(events: Sequence[Mapping[str, Any]]) -> str:
    """Return events with their real values and standard uncertainties; empty without events."""
    return "; ".join(
        f"{event_title(event['name'])}: "
        f"{plus_minus_text(event['value'], event['standard_uncertainty'], event['unit'])}"
        for event in events
    )


def planted_errors_text(reference: Mapping[str, Any]) -> str:
    """Return the scores of planted errors in a line; empty without planted errors."""
    texts = []
    for metric, scores in planted_error_scores(reference):
        detected = [f"{title} {score}" for title, score in scores.items() if score]
        text = f"{metric}: {', '.join(detected)}"
        undetectable = [title for title, score in scores.items() if not score]
        if undetectable:
            text += f"; undetectable: {', '.join(undetectable)}"
        texts.append(text)
    return ". ".join(texts)


def planted_error_scores(
    reference: Mapping[str, Any],
) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield each metric with its unit, and the score of each planted error by name; empty if undetectable.

    An error is undetectable if the score changes by less than a tenth of u, or not within three digits.
    """
    for row in reference["sees"]:
        has_uncertainty = row["unit"] == reference["unit"]
        uncertainty = reference["standard_uncertainty"] if has_uncertainty else 0.0
        unchanged = row["nominal"]
        scores = {"unchanged": digits_text(unchanged)}
        for key, title in PLANTED_ERRORS.items():
            score = row[key]
            if score is None:
                continue
            is_small = abs(score - unchanged) < UNDETECTABLE_SHARE * uncertainty
            is_equal = digits_text(score) == digits_text(unchanged)
            scores[title] = "" if is_small or is_equal else digits_text(score)
        unit = "" if row["unit"] == "1" else f" [{row['unit']}]"
        yield f"{event_title(row['metric'])}{unit}", scores


def _engines_text(engines: Sequence[Mapping[str, Any]]) -> str:
    """Return the engines that run here, that do not run here, and that cannot build the scene."""
    groups: dict[str, list[str]] = {"run it": [], "not here": [], "cannot build it": []}
    for row in engines:
        is_default = row["engine"] == EnvArguments.backend
        name = f"{row['engine']} (default)" if is_default else row["engine"]
        title = "not here" if row["fault"] else "run it"
        groups["cannot build it" if row["missing"] else title].append(name)
    return "; ".join(
        f"{title}: {', '.join(names)}" for title, names in groups.items() if names
    )


def _constants(table: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the constants of a body with their sources."""
    by_source: dict[str, dict[str, Any]] = {}
    for key, constant in table.items():
        by_source.setdefault(constant["source"], {})[key] = constant["value"]
    return "; ".join(
        f"{pairs_text(group)} ({source})" for source, group in by_source.items()
    )


# --- complete description ---------------------------------------------------------------------------------------------


def full_document(values: Mapping[str, Any]) -> Document:
    """Return the screen of an experiment, followed by limits, decisions, and the entries of `SECTIONS`."""
    limits = [limit["text"] for limit in values["limits"]]
    lists = {"Known limits": limits, "Decisions": values["decisions"]}
    sections = {title: _entries(values[key]) for key, title in SECTIONS.items()}
    return Document(
        parts=(
            *experiment_document(values).parts[:-1],
            *(Bullets(entries, title) for title, entries in lists.items() if entries),
            *(
                part
                for title, facts in sections.items()
                if facts
                for part in (Heading(title), Facts(facts))
            ),
        ),
        rows=[values],
    )


def _entries(
    part: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None,
) -> dict[str, str]:
    """Return the texts of a table or list by name or number; a list's empty and zero values are left out."""
    if isinstance(part, Mapping):
        return {name: value_text(value) for name, value in part.items()}
    texts = {}
    for number, entry in enumerate(part or (), 1):
        name = entry.get("name") or entry.get("engine") or str(number)
        nonzero = {
            key: value
            for key, value in entry.items()
            if (any(value) if isinstance(value, list) else value)
        }
        texts[name] = pairs_text(nonzero, skip=("name", "engine", "entry", "whole"))
    return texts
