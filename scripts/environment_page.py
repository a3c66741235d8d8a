"""The page of a family of experiments in the documentation, in Markdown, from the descriptions of its variants."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from gauge_envs.backends.registry import backend_class, backend_names, is_bundled
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import beyond_variants, variants
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part
from gauge_envs.pages.table import grid
from gauge_envs.pages.text import (
    KIND_NOTES,
    Markdown,
    event_title,
    plus_minus_text,
    quantity_text,
    short_id,
    value_text,
)
from gauge_envs.references.kind import Kind
from gauge_envs.tools.catalog.description import description
from gauge_envs.tools.catalog.report import (
    PLANTED_ERRORS,
    planted_error_scores,
    reasons_text,
    step_text,
)
from gauge_envs.tools.catalog.spaces import shape_text
from scripts.generated import ROOT

Values = Mapping[str, Any]
"""Dictionary of `description`."""

TITLES = ("unchanged", *PLANTED_ERRORS.values())
"""Columns of the table of planted errors."""

REWARDED_FRAMES = re.compile(r",? at (\d+ of the )?frames \d+ to \d+ of \d+(; else 0)?")
"""Frames in the text of a reward; the table of ids has their number."""
MOTION_SIZE = re.compile(r"/ [\d.]+ mm, the size of the motion")
"""Size of the motion in the text of a reward, which differs between materials."""


def family_document(family: str, *, picture: str, caption: str) -> Document:
    """Return the page of a family.

    Args:
        family: Name of the family.
        picture: Its picture, relative to the page.
        caption: Caption of the picture.
    """
    members = [
        description(load_experiment(variant))
        for variant in (*variants(), *beyond_variants())
        if variant.family == family
    ]
    first = members[0]
    names = _Names(family, [short_id(values["id"]) for values in members])
    title = first["title"].partition(",")[0] if first["subtask"] else first["title"]
    return Document(
        parts=(
            Heading(title, 1),
            Paragraph(Markdown(f"![{title}]({picture})")),
            Paragraph(Markdown(f"*{caption}*")),
            Paragraph(
                f"{first['summary']} It evaluates {', '.join(first['evaluates'])}."
            ),
            *_ids(members),
            Heading("Spaces and reward"),
            Bullets([*_spaces(names, members), *_rewards(names, members)]),
            Heading("Reference"),
            Bullets(_sources(names, members)),
            *_planted_errors(names, members),
            *_events(names, members),
            Heading("Engines"),
            *_engines(names, members),
            Heading("Constants"),
            _constants(names, members),
            *_limits(names, members),
        )
    )


class _Names:
    """Names of variants in a few words: a material, a subtask, a pattern.

    Args:
        family: Name of the family.
        names: All its variants.
    """

    def __init__(self, family: str, names: Sequence[str]) -> None:
        self._all = tuple(names)
        self._family = family
        parts = [name.removeprefix(f"{family}-").split("-", 1) for name in names]
        patterns = [f"{part[0]}-*" for part in parts if len(part) > 1] + [
            f"*-{part[1]}" for part in parts if len(part) > 1
        ]
        self._patterns = tuple(dict.fromkeys(patterns))

    def short(self, chosen: Iterable[str]) -> str:
        """Return the variants in words; `all ids` for all of them."""
        left = set(chosen)
        if left == set(self._all):
            return "all ids"
        texts = []
        for pattern in self._patterns:
            matching = {
                name
                for name in self._all
                if fnmatchcase(name, f"{self._family}-{pattern}")
            }
            if matching <= left:
                texts.append(pattern)
                left -= matching
        texts += [
            name.removeprefix(f"{self._family}-") for name in self._all if name in left
        ]
        return ", ".join(texts)

    def grouped(
        self, members: Iterable[Values], value: Callable[[Values], Any]
    ) -> list[tuple[str, Any]]:
        """Return each different value of members with the names that have it; empty values are left out."""
        groups: list[tuple[Any, list[str]]] = []
        for values in members:
            result = value(values)
            name = short_id(values["id"])
            for known, same in groups:
                if known == result:
                    same.append(name)
                    break
            else:
                groups.append((result, [name]))
        return [(self.short(same), result) for result, same in groups if result]

    def sentences(
        self, members: Iterable[Values], text: Callable[[Values], str]
    ) -> list[str]:
        """Return each different text after the variants that it describes."""
        return [
            result if label == "all ids" else f"`{label}`: {result}"
            for label, result in self.grouped(members, text)
        ]


def _ids(members: Sequence[Values]) -> Iterator[Part]:
    """Yield the table of the ids with their references."""
    rows = []
    for values in members:
        reference = values["reference"]
        rows.append(
            (
                Markdown(values["id"]),
                str(values["frames"]),
                reference["kind"],
                str(reference["known_frames"] or "-"),
                _distance(reference, "standard_uncertainty"),
                _distance(reference, "zero_motion_distance"),
            )
        )
    kinds = dict.fromkeys(values["reference"]["kind"] for values in members)
    head = ("id", "frames at 30 Hz", "reference", "compared frames", "u", "no motion")
    yield grid(head, rows)
    kinds = dict.fromkeys(values["reference"]["kind"] for values in members)
    notes = [f"{kind}: {KIND_NOTES[Kind(kind)]}." for kind in kinds]
    notes.append("u: standard uncertainty. No motion: distance of a scene at rest.")
    yield Paragraph(" ".join(notes))


def _distance(reference: Values, key: str) -> str:
    """Return a distance of the reference with its unit; a dash without a reference."""
    if reference[key] is None:
        return "-"
    return f"{quantity_text(reference[key])} {reference['unit']}"


def _spaces(names: _Names, members: Sequence[Values]) -> Iterator[str]:
    """Yield the actions, the observations and the observable, one sentence for each different space."""

    def action(values: Values) -> str:
        rows = [f"{row['meaning']}, {row['unit']}" for row in values["action"]]
        if values["action"][0]["unit"] == "1":
            return "Action: 0; nothing is driven."
        return f"Action, in [-1, 1]: {'; '.join(rows)}."

    def observation(values: Values) -> str:
        sizes: dict[str, list[int]] = {}
        for row in values["observation"]:
            shape = sizes.setdefault(row["entry"], [*row["shape"][:-1], 0])
            shape[-1] += row["shape"][-1]
        entries = [f"{name} {shape_text(shape)}" for name, shape in sizes.items()]
        return f"Observation: {', '.join(entries)}."

    def observable(values: Values) -> str:
        kind = values["observable"]["kind"].replace("_", " ")
        return f"Observable g(t): {kind} [{values['observable']['unit']}]."

    for text in (action, observation, observable):
        yield from names.sentences(members, text)


def _rewards(names: _Names, members: Sequence[Values]) -> list[str]:
    def reward(values: Values) -> str:
        text = REWARDED_FRAMES.sub(
            " at the compared frames", values["reference"]["reward"]
        )
        return f"Reward: {MOTION_SIZE.sub('/ the size of the motion', text)}."

    return names.sentences(members, reward)


def _sources(names: _Names, members: Sequence[Values]) -> list[str]:
    def source(values: Values) -> str:
        return f"{values['reference']['source'] or KIND_NOTES[Kind.NONE]}."

    return names.sentences(members, source)


def _planted_errors(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    """Yield a table of the scores of planted errors, in which ids share rows."""
    ids: dict[tuple[str, ...], list[str]] = {}
    for values in members:
        for metric, scores in planted_error_scores(values["reference"]):
            row = (metric, *(scores.get(title, "-") for title in TITLES))
            ids.setdefault(row, []).append(short_id(values["id"]))
    if ids:
        yield Paragraph(
            "Scores of planted errors in MuJoCo. An empty cell is undetectable; a dash does not apply."
        )
        rows = [(names.short(same), *row) for row, same in ids.items()]
        yield grid(("id", "metric", *TITLES), rows)


def _events(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    """Yield a table of the recorded events, in which ids share rows."""
    ids: dict[tuple[str, str], list[str]] = {}
    for values in members:
        for event in values["reference"]["events"]:
            value = plus_minus_text(
                event["value"], event["standard_uncertainty"], event["unit"]
            )
            row = (event_title(event["name"]), value)
            ids.setdefault(row, []).append(short_id(values["id"]))
    if ids:
        rows = [(names.short(same), *row) for row, same in ids.items()]
        yield grid(("id", "recorded event", "value +- u"), rows)


def _engines(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    """Yield the presets and steps of the engines, and their unsupported features."""
    running: dict[tuple[str, str, str], list[str]] = {}
    unsupported: dict[tuple[str, str], list[str]] = {}
    for engine in filter(is_bundled, backend_names()):
        title = f"[{backend_class(engine).title}](../engines/{engine}.md)"
        facts = [_engine_row(values, engine) for values in members]
        runs = [
            (short_id(values["id"]), row)
            for values, row in zip(members, facts, strict=True)
            if not row["missing"]
        ]
        if runs:
            label = names.short(name for name, _ in runs)
            presets = ", ".join(dict.fromkeys(row["preset"] for _, row in runs))
            steps_s = sorted({row["timestep_s"] for _, row in runs})
            ends = dict.fromkeys((steps_s[0], steps_s[-1]))
            steps = " to ".join(map(step_text, ends))
            running.setdefault((label, presets, steps), []).append(title)

        def reasons(values: Values, engine: str = engine) -> str:
            return reasons_text(_engine_row(values, engine)["missing"])

        for key in names.grouped(members, reasons):
            unsupported.setdefault(key, []).append(title)
    rows = [(Markdown(", ".join(titles)), *row) for row, titles in running.items()]
    yield grid(("engine", "ids", "preset", "step [s]"), rows)
    if unsupported:
        yield Bullets(
            [
                f"Not supported by {', '.join(titles)}, {label}: {reason}."
                for (label, reason), titles in unsupported.items()
            ]
        )


def _engine_row(values: Values, engine: str) -> Values:
    row: Values = next(row for row in values["engines"] if row["engine"] == engine)
    return row


def _constants(names: _Names, members: Sequence[Values]) -> Part:
    """Return the constants of the bodies, a column for each group of ids with the same constants."""
    groups = names.grouped(members, lambda values: values["constants"])
    places = dict.fromkeys(
        (body, key)
        for values in members
        for body, table in values["constants"].items()
        for key in table
    )
    rows = []
    for body, key in places:
        cells = [tables.get(body, {}).get(key) for _, tables in groups]
        sources = dict.fromkeys(cell["source"] for cell in cells if cell)
        numbers = [value_text(cell["value"]) if cell else "-" for cell in cells]
        name = Markdown(f"{body} `{key}`")
        rows.append((name, *numbers, "; ".join(sources)))
    return grid(("constant", *(label for label, _ in groups), "source"), rows)


def note_of(study: str) -> str:
    """Return the note of a study, or its heading in the list of finished studies."""
    if (ROOT / "studies" / study).is_dir():
        return f"{study}/README.md"
    return f"README.md#{study}"


def _limits(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    """Yield the known limits and the sources of the prescribed motions."""
    limits: dict[str, list[str]] = {}
    for values in members:
        name = short_id(values["id"])
        for limit in values["limits"]:
            link = f"../../studies/{note_of(limit['study'])}" if limit["study"] else ""
            text = limit["text"] + (f" ([study]({link}))" if link else "")
            limits.setdefault(text, []).append(name)
        for driver in values["drivers"]:
            text = f"Motion of {driver['body']} ({driver['provenance']}): {driver['note']}."
            limits.setdefault(text, []).append(name)
    if limits:
        yield Heading("Known limits")
        labels = {text: names.short(same) for text, same in limits.items()}
        yield Bullets(
            [
                text if label == "all ids" else f"`{label}`: {text}"
                for text, label in labels.items()
            ]
        )
    yield Paragraph(
        Markdown(
            f"`gauge show {short_id(members[0]['id'])} --format wide` also prints published scores, convergence, "
            "sources and decisions."
        )
    )
