"""The page of a family of experiments in the documentation, in Markdown.

The facts and constants are those of `gauge show`. A fact that differs between the variants of a family names them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from fractions import Fraction
from typing import Any

from gauge_envs.backends.registry import backend_class, is_bundled
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.variants import Variant, beyond_variants, variants
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part
from gauge_envs.pages.table import Table, grid
from gauge_envs.pages.text import Markdown, shortened
from gauge_envs.scoring.answers import Answer
from gauge_envs.tools.catalog.description import description
from gauge_envs.tools.catalog.report import (
    PLANTED_ERRORS,
    constants_facts,
    distance_text,
    motion_facts,
    planted_error_scores,
)
from scripts.generated import ROOT

Values = Mapping[str, Any]
"""Result of `description`."""

Members = Mapping[Variant, Values]
"""Descriptions of the variants of a family."""

READING = "reading.md"
"""Page of the terms that families share, in the folder of the pages."""

IN_TABLE = ("frames", "reference", "planted errors", "reward")
"""Facts of `gauge show` that the table of references or `READING` gives."""


def described_families() -> dict[str, dict[Variant, Values]]:
    """Return the descriptions of all variants by family."""
    families: dict[str, dict[Variant, Values]] = {}
    for variant in (*variants(), *beyond_variants()):
        members = families.setdefault(variant.family, {})
        members[variant] = description(load_experiment(variant))
    return families


def family_document(
    family: str, members: Members, *, picture: str, caption: str
) -> Document:
    """Return the page of a family.

    Args:
        family: Name of the family.
        members: Descriptions of its variants.
        picture: Its picture, relative to the page.
        caption: Caption of the picture.
    """
    spec = task_spec(family)
    ids = ", ".join(f"`{variant.name}`" for variant in members)
    parts: list[Part] = [
        Heading(spec.title, 1),
        Paragraph(Markdown(f"![{spec.title}]({picture})")),
        Paragraph(Markdown(f"*{caption}*")),
        Paragraph(f"{spec.summary} It evaluates {', '.join(spec.evaluates)}."),
        Paragraph(Markdown(f"Ids: {ids}.")),
        _references(members),
        Paragraph(Markdown(f"[Terms of this page]({READING})")),
        _facts(members, _motion_facts),
        Heading("Engines"),
        _facts(members, _engine_facts),
        Heading("Constants"),
        _facts(members, constants_facts),
    ]
    limits = _limit_lines(members)
    if limits:
        parts += [Heading("Known limits"), Bullets(limits)]
    return Document(parts=parts)


def _short_name(variant: Variant) -> str:
    """Return the name of a variant without that of its family."""
    return variant.name.removeprefix(f"{variant.family}-")


def _label(chosen: Sequence[Variant], family: Collection[Variant]) -> str:
    """Return variants as `1-*, *-metal, 2-wood`; empty for all of the family."""
    left = set(chosen)
    if len(left) == len(family):
        return ""
    texts = []
    for pattern, same in _patterns(family).items():
        if same <= left:
            texts.append(pattern)
            left -= same
    texts += [_short_name(variant) for variant in family if variant in left]
    return ", ".join(texts)


def _patterns(family: Collection[Variant]) -> dict[str, set[Variant]]:
    """Return the variants of each subtask and of each material by pattern; empty for a family without subtasks."""
    by_subtask: dict[str, set[Variant]] = {}
    by_material: dict[str, set[Variant]] = {}
    for variant in family:
        if variant.subtask is not None:
            by_subtask.setdefault(f"{variant.subtask}-*", set()).add(variant)
            by_material.setdefault(f"*-{variant.material}", set()).add(variant)
    return by_subtask | by_material


# --- table of references ----------------------------------------------------------------------------------------------


def _references(members: Members) -> Table:
    """Return a row for each variant: its reference, and what its score detects."""
    titles = ("id", "frames", "reference", "compared", "u", "rest", "detects", "misses")
    rows = []
    for variant, values in members.items():
        reference = values["reference"]
        detected, missed = _detected(reference)
        rows.append(
            (
                _short_name(variant),
                _frames_text(values),
                reference["kind"],
                shortened(reference["compared"] or ["-"]),
                distance_text(reference, "standard_uncertainty"),
                distance_text(reference, "zero_motion_distance"),
                ", ".join(detected),
                ", ".join(missed),
            )
        )
    return grid(titles, rows)


def _frames_text(values: Values) -> str:
    """Return the number of frames, and how many of them the reference knows."""
    frames, known = values["frames"], values["reference"]["known_frames"]
    if known in (None, frames):
        return str(frames)
    return f"{known} of {frames}"


def _detected(reference: Values) -> tuple[list[str], list[str]]:
    """Return the planted errors that change an answer to no, and those that do not."""
    is_detected: dict[str, bool] = {}
    rows = reference["sees"]
    for row, (_, scores) in zip(rows, planted_error_scores(reference), strict=True):
        if row["answers"]["nominal"] == Answer.NO:
            continue
        for title, score in scores.items():
            is_detected[title] = bool(score) or is_detected.get(title, False)
    if not rows:
        return ["not tried"], ["not tried"]
    if not is_detected:
        return ["nothing: the unchanged scene fails"], []
    detected, missed = [], []
    for title in PLANTED_ERRORS.values():
        if is_detected.get(title):
            detected.append(title)
        elif title in is_detected:
            missed.append(title)
    return detected, missed


# --- facts ------------------------------------------------------------------------------------------------------------


def _facts(
    members: Members, facts_of: Callable[[Values], Mapping[str, str]]
) -> Bullets:
    """Return each different fact after its title and the variants that it describes."""
    groups: dict[str, dict[str, list[Variant]]] = {}
    for variant, values in members.items():
        for title, text in facts_of(values).items():
            groups.setdefault(title, {}).setdefault(text, []).append(variant)
    lines = []
    for title, texts in groups.items():
        for text, chosen in texts.items():
            start = f"**{title}**"
            label = _label(chosen, members)
            if label:
                start += f", `{label}`"
            lines.append(f"{start}: {text.rstrip('.')}.")
    return Bullets(lines)


def _motion_facts(values: Values) -> dict[str, str]:
    """Return the facts of `gauge show` that are not in the table of references."""
    facts = motion_facts(values)
    return {title: text for title, text in facts.items() if title not in IN_TABLE}


def _engine_facts(values: Values) -> dict[str, str]:
    """Return preset and step of each engine of this package, or why it does not build the scene."""
    facts = {}
    for row in values["engines"]:
        if not is_bundled(row["engine"]):
            continue
        title = backend_class(row["engine"]).title
        link = f"[{title}](../engines/{row['engine']}.md)"
        facts[link] = f"preset `{row['preset']}`, step {_step_text(row['timestep_s'])}"
        if row["missing"]:
            facts[link] = f"unsupported, {row['missing'][0]}"
            others = len(row["missing"]) - 1
            if others:
                facts[link] += f" (and {others} more)"
    return facts


def _step_text(step_s: float | None) -> str:
    """Return a time step as a fraction of a second if it is one, otherwise in seconds; a dash for None."""
    if step_s is None:
        return "-"
    fraction = Fraction(step_s).limit_denominator(1_000_000)
    if fraction.numerator == 1:
        return f"{fraction} s"
    return f"{step_s:.4g} s"


# --- limits -----------------------------------------------------------------------------------------------------------


def note_of(study: str) -> str:
    """Return the note of a study, or its heading in the list of finished studies."""
    if (ROOT / "studies" / study).is_dir():
        return f"{study}/README.md"
    return f"README.md#{study}"


def _limit_lines(members: Members) -> list[str]:
    """Return each known limit after the variants that have it, with a link to its study."""
    groups: dict[str, list[Variant]] = {}
    for variant, values in members.items():
        for limit in values["limits"]:
            text = limit["text"]
            if limit["study"]:
                text += f" ([study](../../studies/{note_of(limit['study'])}))"
            groups.setdefault(text, []).append(variant)
    lines = []
    for text, chosen in groups.items():
        label = _label(chosen, members)
        if label:
            text = f"`{label}`: {text}"
        lines.append(text)
    return lines
