"""The page of a family of experiments in the documentation, in Markdown, and the page of what families share."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fnmatch import filter as matching
from fractions import Fraction
from typing import Any

from gauge_envs.backends.registry import backend_class, backend_names, is_bundled
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import beyond_variants, variants
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part
from gauge_envs.pages.table import grid
from gauge_envs.pages.text import (
    Markdown,
    event_title,
    plus_minus_text,
    quantity_text,
    short_id,
)
from gauge_envs.tools.catalog.description import description
from gauge_envs.tools.catalog.report import PLANTED_ERRORS, planted_error_scores
from gauge_envs.tools.catalog.spaces import shape_text
from scripts.generated import NUMBER, ROOT

Values = Mapping[str, Any]
"""Dictionary of `description`."""

Families = Mapping[str, Sequence[Values]]
"""Descriptions of the variants of each family."""

Place = tuple[str, str]
"""Name of a body and key of one of its constants."""

MAX_WORDS = 22
"""Longest text that stays one sentence; a title may precede it."""

BREAKS = re.compile(r"; (?![^(]*\))|: (?=it |both )")
"""Where a long text becomes several sentences."""

READING = "reading.md"
"""Page of what families share, in the folder of the pages."""

SHORT_ERRORS = {"no motion": "rest", "40 ms late": "late"}
"""Short names of planted errors."""

REWARDED = re.compile(r"the mean over (?P<names>.*) of \|deviation")
"""Compared coordinates in the text of a reward."""
SOLUTION = re.compile(
    r"the calibrated scene as (?P<solvers>.*) solves? it(?P<check>, checked with \w+)?, "
    r"refined one parameter at a time"
)
"""Text on the source of a numerical reference."""
QUOTED = re.compile(r"'[\w-]+'( \(and \d+ more\))?")
"""Body in the reason why an engine does not build a scene."""

MATERIALS = {
    "Fabrics": ("TextileStretching", "textile"),
    "Foams": ("FoamStretching", "foam"),
}
"""Materials with the same constants in several families: the family and the body that show them."""

SCENE_KEYS = ("mass_kg", "friction", "restitution")
"""Constants that belong to a body in one scene, not to its material."""


def described_families() -> Families:
    """Return the descriptions of all variants by family."""
    return grouped(
        (variant.family, description(load_experiment(variant)))
        for variant in (*variants(), *beyond_variants())
    )


def grouped(pairs: Iterable[tuple[Any, Any]]) -> dict[Any, list[Any]]:
    """Return the values of each key, in the order of their first appearance."""
    groups: dict[Any, list[Any]] = {}
    for key, value in pairs:
        groups.setdefault(key, []).append(value)
    return groups


# --- page of a family -------------------------------------------------------------------------------------------------


def family_document(
    family: str, families: Families, *, picture: str, caption: str
) -> Document:
    """Return the page of a family.

    Args:
        family: Name of the family.
        families: All families. What several of them say is on the page `READING`.
        picture: Its picture, relative to the page.
        caption: Caption of the picture.
    """
    members = _Members(family, families[family])
    first = families[family][0]
    ids = [f"`{short_id(values['id'])}`" for values in members.values()]
    title = first["title"].partition(",")[0]
    return Document(
        parts=(
            Heading(title, 1),
            Paragraph(Markdown(f"![{title}]({picture})")),
            Paragraph(Markdown(f"*{caption}*")),
            Paragraph(
                f"{_sentences(first['summary'])} It evaluates {', '.join(first['evaluates'])}."
            ),
            Paragraph(Markdown(f"Ids: {', '.join(ids)}.")),
            _references(members),
            Paragraph(Markdown(f"[Terms of this page]({READING})")),
            Bullets(
                [
                    *members.facts("Action", _action),
                    *members.facts("Observation", _observation),
                    *members.facts("Observable", _observable),
                    *members.facts("Reward", _reward),
                    *_sources(members),
                    *members.facts("Real events", _events),
                ]
            ),
            Heading("Engines"),
            Bullets([*_engines(members, _shared(families, _reasons))]),
            *_constants(members, families),
            *_limits(members, _shared(families, _limit_texts)),
        )
    )


class _Members(dict[str, Values]):
    """Descriptions of the variants of a family, by name without that of the family.

    Args:
        family: Name of the family.
        members: All its variants.
    """

    def __init__(self, family: str, members: Iterable[Values]) -> None:
        for values in members:
            self[short_id(values["id"]).removeprefix(f"{family}-")] = values
        parts = [name.partition("-") for name in self if "-" in name]
        self._patterns = dict.fromkeys(
            [f"{subtask}-*" for subtask, _, _ in parts]
            + [f"*-{material}" for _, _, material in parts]
        )

    def short(self, names: Iterable[str]) -> str:
        """Return names by materials, subtasks and patterns; `all ids` for all of them."""
        left = set(names)
        if left == self.keys():
            return "all ids"
        texts = []
        for pattern in self._patterns:
            same = {*matching(self, pattern)}
            if same <= left:
                texts.append(pattern)
                left -= same
        return ", ".join([*texts, *(name for name in self if name in left)])

    def label(self, form: str, names: Iterable[str]) -> str:
        """Return a form, such as `({})`, with the short names; nothing for all of them."""
        short = self.short(names)
        return "" if short == "all ids" else form.format(f"`{short}`")

    def facts(self, title: str, text: Callable[[Values], str]) -> list[str]:
        """Return each different text after its title and the variants that it describes; empty ones are left out."""
        texts = grouped((text(values), name) for name, values in self.items())
        return [
            f"**{title}**{self.label(', {}', names)}: {text}"
            for text, names in texts.items()
            if text
        ]


def _sentences(text: str) -> str:
    """Return a text with a full stop; a long one is split into sentences."""
    text = text.rstrip(".")
    if len(text.split()) > MAX_WORDS:
        first, *others = BREAKS.split(text)
        text = ". ".join([first, *map(_capitalized, others)])
    return f"{text}."


def _capitalized(text: str) -> str:
    """Return a text with a capital; symbols of one letter, as `z`, stay."""
    return text if re.match(r"(?!a\b)\w\b", text) else text[:1].upper() + text[1:]


def _references(members: _Members) -> Part:
    """Return a table of the references and of what their scores detect; similar ids share a row."""

    def key(values: Values) -> tuple[Any, ...]:
        reference, frames = values["reference"], values["frames"]
        is_partial = (reference["known_frames"] or frames) < frames
        return reference["kind"], is_partial, *_detected(reference)

    rows = []
    groups = grouped((key(values), name) for name, values in members.items())
    for (kind, _, *errors), names in groups.items():
        references = [members[name]["reference"] for name in names]
        frames = _range([members[name]["frames"] for name in names], str)
        known = _range([reference["known_frames"] for reference in references], str)
        rows.append(
            (
                members.short(names),
                frames if known in ("-", frames) else f"{known} of {frames}",
                kind,
                _distance(references, "standard_uncertainty"),
                _distance(references, "zero_motion_distance"),
                *errors,
            )
        )
    return grid(("ids", "frames", "reference", "u", "rest", "detects", "misses"), rows)


def _distance(references: Sequence[Values], key: str) -> str:
    """Return the range of a distance with its unit; a dash without a reference."""
    text = _range([reference[key] for reference in references], quantity_text)
    return text if text == "-" else f"{text} {references[0]['unit']}"


def _range(values: Sequence[Any], text: Callable[[Any], str]) -> str:
    """Return `least to largest`, one value if they are equal, or a dash for None."""
    if None in values:
        return "-"
    return " to ".join(dict.fromkeys((text(min(values)), text(max(values)))))


def _detected(reference: Values) -> tuple[str, str]:
    """Return the planted errors that change a score or an event, and those that do not.

    The errors of a quantity in both directions are one if both or neither are detected.
    """
    scores = [row for _, row in planted_error_scores(reference)]
    changed = {
        title: any(row.get(title) for row in scores)
        for title in PLANTED_ERRORS.values()
        if any(title in row for row in scores)
    }
    detected, missed = {}, {}
    for title, is_changed in changed.items():
        quantity, _, direction = title.partition(" 20 % ")
        both = {changed.get(f"{quantity} 20 % {side}") for side in ("lower", "higher")}
        name = quantity if len(both) == 1 else f"{direction} {quantity}"
        (detected if is_changed else missed)[SHORT_ERRORS.get(title, name)] = title
    return ", ".join(detected), ", ".join(missed)


def _action(values: Values) -> str:
    rows = values["action"]
    if rows[0]["unit"] == "1":
        return "0."
    return _sentences("; ".join(f"{row['meaning']}, {row['unit']}" for row in rows))


def _observation(values: Values) -> str:
    """Return the entries of the observation with their shapes; rows of an entry add up in the last axis."""
    shapes = grouped((row["entry"], row["shape"]) for row in values["observation"])
    entries = [
        f"{name} {shape_text([*same[0][:-1], sum(shape[-1] for shape in same)])}"
        for name, same in shapes.items()
    ]
    return f"{', '.join(entries)}."


def _observable(values: Values) -> str:
    observable = values["observable"]
    return f"{observable['kind'].replace('_', ' ')} [{observable['unit']}]."


def _reward(values: Values) -> str:
    """Return the reward in terms of z, which `READING` defines."""
    text = values["reference"]["reward"]
    match = REWARDED.search(text)
    if match is None:
        return "0."
    form = "-z / (1 + z)" if text.startswith("-z") else "-z"
    return f"{form}, z over {match['names']}."


def _sources(members: _Members) -> Iterator[str]:
    """Yield the sources of the references; texts that differ in numbers share a sentence."""
    names = grouped((_source(values), name) for name, values in members.items())
    for texts in grouped((NUMBER.sub("#", text), text) for text in names).values():
        parts = zip(*map(NUMBER.split, texts), strict=True)
        joined = "".join(" / ".join(dict.fromkeys(part)) for part in parts)
        title, _, text = joined.partition(": ")
        same = [name for text in texts for name in names[text]]
        yield f"**{title}**{members.label(', {}', same)}: {_sentences(text)}"


def _source(values: Values) -> str:
    text = values["reference"]["source"]
    if not text:
        return "Reference: none"
    if solved := SOLUTION.fullmatch(text):
        check = solved["check"] or ""
        return f"Reference: refined solution of {solved['solvers']}{check}"
    kind = "No reference" if values["reference"]["kind"] == "none" else "Reference"
    return f"{kind}: {text}"


def _events(values: Values) -> str:
    """Return the recorded events with their real values; empty without one."""
    texts = [
        f"{event_title(event['name'])} "
        + plus_minus_text(event["value"], event["standard_uncertainty"], event["unit"])
        for event in values["reference"]["events"]
    ]
    return f"{', '.join(texts)}." if texts else ""


def _shared(
    families: Families, texts: Callable[[Values], Iterable[str]]
) -> dict[str, list[str]]:
    """Return the texts that several families have, each with their names."""
    users = grouped(
        (text, family)
        for family, members in families.items()
        for values in members
        for text in texts(values)
    )
    names = {text: [*dict.fromkeys(same)] for text, same in users.items()}
    return {text: same for text, same in names.items() if len(same) > 1}


# --- engines ----------------------------------------------------------------------------------------------------------


def _engines(members: _Members, shared: Iterable[str]) -> Iterator[str]:
    """Yield the engines with their presets and steps, and those that do not build the scene.

    Args:
        members: The variants.
        shared: Reasons of other families too, which are not repeated.
    """
    running, unsupported = [], []
    for engine in filter(is_bundled, backend_names()):
        title = f"[{backend_class(engine).title}](../engines/{engine}.md)"
        rows = {
            name: next(row for row in values["engines"] if row["engine"] == engine)
            for name, values in members.items()
        }
        runs = [name for name, row in rows.items() if not row["missing"]]
        if runs:
            presets = dict.fromkeys(f"`{rows[name]['preset']}`" for name in runs)
            steps = _range([rows[name]["timestep_s"] for name in runs], step_text)
            text = f"{title} {', '.join(presets)} {steps}"
            running.append((members.label(", {}", runs), text))
        reasons = grouped(
            (_new_reason(row, shared), name)
            for name, row in rows.items()
            if row["missing"]
        )
        for reason, names in reasons.items():
            unsupported.append((members.label(", {}", names) + reason, title))
    for label, texts in grouped(running).items():
        yield f"**Preset and step [s]**{label}: {', '.join(texts)}."
    for text, titles in grouped(unsupported).items():
        yield f"Not on {', '.join(titles)}{text}."


def step_text(step_s: float) -> str:
    """Return a time step as a fraction of a second if it is one, otherwise in seconds."""
    fraction = Fraction(step_s).limit_denominator(1_000_000)
    return str(fraction) if fraction.numerator == 1 else f"{step_s:.4g}"


def _reason(row: Values) -> str:
    """Return the first reason why an engine cannot build a scene, and the number of the remaining reasons."""
    first, *others = row["missing"]
    return f"{first} (and {len(others)} more)" if others else first


def _new_reason(row: Values, shared: Iterable[str]) -> str:
    """Return the reason after a colon; nothing for a reason of other families too."""
    reason = _reason(row)
    return "" if _general(reason) in shared else f": {reason}"


def _general(reason: str) -> str:
    """Return a reason without the name of its body."""
    return QUOTED.sub("the body", reason)


def _reasons(values: Values) -> Iterator[str]:
    """Yield the reasons of the engines that do not build a scene, without the names of bodies."""
    for row in values["engines"]:
        if row["missing"] and is_bundled(row["engine"]):
            yield _general(_reason(row))


# --- constants --------------------------------------------------------------------------------------------------------


def _constants(members: _Members, families: Families) -> Iterator[Part]:
    """Yield the constants in use, a column for each group of ids with the same constants."""
    used = {name: _used_constants(values) for name, values in members.items()}
    materials = _material_titles(families)
    rows: dict[Place, dict[str, Values]] = {}
    shared: set[str] = set()
    for place in dict.fromkeys(place for table in used.values() for place in table):
        row = {name: table[place] for name, table in used.items() if place in table}
        titles = {
            materials.get((place[1], name.rpartition("-")[2], cell["value"]), "")
            for name, cell in row.items()
        }
        if "" in titles:
            rows[place] = row
        else:
            shared |= titles
    columns = grouped(
        (tuple(_constant_text(row.get(name)) for row in rows.values()), name)
        for name in members
    )
    yield Heading("Constants")
    yield grid(
        ("constant", *map(members.short, columns.values())),
        [
            (Markdown(f"{body} `{key}`"), *texts)
            for (body, key), *texts in zip(rows, *columns, strict=True)
        ],
    )
    notes = [
        f"{title} have [more constants]({READING}#{title.lower()})."
        for title in sorted(shared)
    ]
    sources = grouped(
        (source, place)
        for place, row in rows.items()
        for source in dict.fromkeys(cell["source"] for cell in row.values())
    )
    notes += [
        f"Source{_places_text(places, rows)}: {source}."
        for source, places in sources.items()
        if source != "metadata"
    ]
    if notes:
        yield Paragraph(Markdown(" ".join(notes)))


def _places_text(places: Sequence[Place], rows: Iterable[Place]) -> str:
    """Return ` of` and the names of constants: bodies where all their constants are meant, nothing for all rows."""
    others = {body for body, key in rows if (body, key) not in places}
    if not others:
        return ""
    names = [body if body not in others else f"{body} `{key}`" for body, key in places]
    return f" of {', '.join(dict.fromkeys(names))}"


def _constant_text(cell: Values | None) -> str:
    """Return a constant with four digits, or a large one without an exponent; a dash for None."""
    if cell is None:
        return "-"
    value = cell["value"]
    return f"{value:.0f}" if value >= 1e4 else f"{value:.4g}"


def _used_constants(values: Values) -> dict[Place, Values]:
    """Return the constants that change the motion.

    Masses of fixed and driven bodies have no effect. A contact has the friction and the restitution of one of its
    bodies; restitution counts in impacts alone.
    """
    moving = {
        _constants_name(values["constants"], body["name"])
        for body in values["bodies"]
        if body["kind"] != "rigid" or body["motion"] == "dynamic"
    }
    in_contact = {
        (_owner(values["constants"], contact, key), key)
        for contact in values["contacts"]
        for key in ("friction", "restitution")
        if key == "friction" or contact["mode"] == "impact"
    }

    def is_used(name: str, key: str) -> bool:
        if key in ("friction", "restitution"):
            return (name, key) in in_contact
        return name in moving and key != "density_kg_per_m3"

    return {
        (name, key): cell
        for name, table in values["constants"].items()
        for key, cell in table.items()
        if is_used(name, key)
    }


def _owner(constants: Mapping[str, Values], contact: Values, key: str) -> str:
    """Return the first body of a contact whose constant the contact has; empty for none."""
    for body in (*contact["first"], *contact["second"]):
        name = _constants_name(constants, body)
        cell = constants.get(name, {}).get(key)
        if cell and cell["value"] == contact[key]:
            return name
    return ""


def _constants_name(constants: Mapping[str, Values], body: str) -> str:
    """Return the name of the constants of a body: `ball-1`, or `ball` of all balls."""
    return body if body in constants else re.sub(r"-\d+$", "", body)


def _of_material(values: Values, body: str) -> dict[str, Values]:
    """Return the constants of the material of a body, by key."""
    return {
        key: cell
        for (name, key), cell in _used_constants(values).items()
        if name == body and key not in SCENE_KEYS
    }


def _material_titles(families: Families) -> dict[tuple[str, str, float], str]:
    """Return the title in `MATERIALS` of each constant, by its key, the name of its material and its value."""
    return {
        (key, values["id"].rpartition("-")[2], cell["value"]): title
        for title, (family, body) in MATERIALS.items()
        for values in families[family]
        for key, cell in _of_material(values, body).items()
    }


# --- limits -----------------------------------------------------------------------------------------------------------


def note_of(study: str) -> str:
    """Return the note of a study, or its heading in the list of finished studies."""
    if (ROOT / "studies" / study).is_dir():
        return f"{study}/README.md"
    return f"README.md#{study}"


def _limit_texts(values: Values) -> Iterator[str]:
    """Yield the known limits of a variant, with links to studies."""
    for limit in values["limits"]:
        link = f"../../studies/{note_of(limit['study'])}" if limit["study"] else ""
        yield limit["text"] + (f" ([study]({link}))" if link else "")


def _limits(members: _Members, shared: Iterable[str]) -> Iterator[Part]:
    """Yield the known limits of this family alone, and the sources of the prescribed motions."""
    limits = grouped(
        (text, name)
        for name, values in members.items()
        for text in _limit_texts(values)
    )
    motions = grouped(
        (
            f"{driver['body']}: {_sentences(driver['note'])}",
            (driver["provenance"], name),
        )
        for name, values in members.items()
        for driver in values["drivers"]
    )
    entries = [
        members.label("{}: ", names) + text
        for text, names in limits.items()
        if text not in shared
    ]
    for text, uses in motions.items():
        sources = grouped(uses)
        kinds = [
            source if len(sources) == 1 else f"{source} for `{members.short(names)}`"
            for source, names in sources.items()
        ]
        label = members.label("{}: ", (name for _, name in uses))
        entries.append(f"{label}Motion ({', '.join(kinds)}) of {text}")
    if limits.keys() & shared:
        entries.append(f"[Limits of several families]({READING}#limits) apply.")
    if entries:
        yield Heading("Known limits")
        yield Bullets(entries)


# --- page of what families share --------------------------------------------------------------------------------------

INTRODUCTION = """
After this page you can read the page of each experiment. `gauge show ID` also prints published scores and the scores
of planted errors. `--format wide` adds convergence, sources and decisions.

The pictures show MuJoCo with zero actions. Blue are the tracked points and their paths, red is the reference.

| column | meaning |
| --- | --- |
| ids | without `GAUGE/`, which `gymnasium.make` needs; similar ids share a row |
| frames | length at 30 Hz; `13 of 18`: the reference knows 13 |
| reference | its [kind](../scores.md#kinds-of-reference) |
| u | standard uncertainty of the reference |
| rest | distance of a scene at rest |
| detects, misses | planted errors in MuJoCo that change a score or an event by a tenth of u, or do not |

The planted errors are a scene at rest, a motion that is 40 ms late, and friction and stiffness 20 % lower and higher.

## Spaces and reward

Actions are in [-1, 1], or 0 where nothing is driven. A page gives their axes and scales.
[Getting started](../getting_started.md#observations) has the format of observations.

The reward of a frame is -z, or -z / (1 + z) with deformable bodies. Here z is the mean of |g - mean| / scale over the
listed coordinates. The scale is sigma, or the size of the motion with deformable bodies. Frames that the reference
does not know have the reward 0.

## Engines

A page gives the preset and the step that an engine chooses. The page of an engine says which bodies it does not build.
""".strip()

CONSTANTS = """
A page lists the constants that change the motion. Restitution counts in impacts alone. The source is `metadata`, the
calibrated files of the benchmark, unless a note says otherwise. These materials occur in several families:
""".strip()


def reading_document(families: Families) -> Document:
    """Return the page of what families share: columns, reward, materials and limits."""
    tables: list[Part] = []
    for title, (family, body) in MATERIALS.items():
        columns = [_of_material(values, body) for values in families[family]]
        rows = [
            (Markdown(f"`{key}`"), *(_constant_text(column[key]) for column in columns))
            for key in columns[0]
        ]
        labels = [values["id"].rpartition("-")[2] for values in families[family]]
        tables += [Heading(title, 3), grid(("constant", *labels), rows)]
    limits = [
        f"{', '.join(users)}: {text}"
        for text, users in _shared(families, _limit_texts).items()
    ]
    return Document(
        parts=(
            Heading("How to read these pages", 1),
            *(Paragraph(Markdown(part)) for part in INTRODUCTION.split("\n\n")),
            Heading("Constants"),
            Paragraph(Markdown(CONSTANTS)),
            *tables,
            Heading("Limits"),
            Bullets(limits),
        )
    )
