"""The page of a family of experiments in the documentation, in Markdown, and the page of what families share."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
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

MAX_WORDS = 22
"""Longest text that stays one sentence; a title may precede it."""

BREAKS = re.compile(r"; (?![^(]*\))|: (?=it |both )")
"""Where a long text becomes several sentences."""

READING = "reading.md"
"""Page of what families share, in the folder of the pages."""

SHORT_ERRORS = {"no motion": "rest", "40 ms late": "late"}
"""Short names of planted errors."""

ERROR_PAIRS = {
    "friction": ("friction 20 % lower", "friction 20 % higher"),
    "stiffness": ("stiffness 20 % lower", "stiffness 20 % higher"),
}
"""Planted errors in both directions, by the changed quantity."""

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
    families: dict[str, list[Values]] = {}
    for variant in (*variants(), *beyond_variants()):
        values = description(load_experiment(variant))
        families.setdefault(variant.family, []).append(values)
    return families


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
    members = families[family]
    first = members[0]
    names = _Names(family, [short_id(values["id"]) for values in members])
    title = first["title"].partition(",")[0] if first["subtask"] else first["title"]
    facts = [*_spaces(names, members), *_rewards(names, members)]
    return Document(
        parts=(
            Heading(title, 1),
            Paragraph(Markdown(f"![{title}]({picture})")),
            Paragraph(Markdown(f"*{caption}*")),
            Paragraph(
                f"{_sentences(first['summary'])} It evaluates {', '.join(first['evaluates'])}."
            ),
            *_ids(names, members),
            Paragraph(Markdown(f"[Terms of this page]({READING})")),
            Bullets([*facts, *_sources(names, members), *_events(names, members)]),
            Heading("Engines"),
            Bullets(list(_engines(names, members, _shared_reasons(families)))),
            *_constants(names, members, families),
            *_limits(names, members, _shared_limits(families)),
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

    def facts(
        self, title: str, members: Iterable[Values], text: Callable[[Values], str]
    ) -> list[str]:
        """Return each different text after its title and the variants that it describes."""
        return [
            _fact(title, label, result) for label, result in self.grouped(members, text)
        ]


def _fact(title: str, label: str, text: str) -> str:
    """Return a text after its title and the ids that it describes."""
    ids = "" if label == "all ids" else f", `{label}`"
    return f"**{title}**{ids}: {text}"


def _labelled(label: str, text: str) -> str:
    return text if label == "all ids" else f"`{label}`: {text}"


def _sentences(text: str) -> str:
    """Return a text with a full stop; a long one is split into sentences."""
    text = text.rstrip(".")
    if len(text.split()) > MAX_WORDS:
        first, *others = BREAKS.split(text)
        text = ". ".join([first, *map(_capitalized, others)])
    return f"{text}."


def _capitalized(text: str) -> str:
    """Return a text with a capital; symbols of one letter stay."""
    return text if re.match(r"\w\b", text) else text[:1].upper() + text[1:]


def _ids(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    """Yield the ids, and a table of their references and of what their scores detect; similar ids share a row."""
    listed = ", ".join(f"`{short_id(values['id'])}`" for values in members)
    yield Paragraph(Markdown(f"Ids: {listed}."))
    groups: dict[tuple[str, ...], list[Values]] = {}
    for values in members:
        reference = values["reference"]
        is_partial = (reference["known_frames"] or values["frames"]) < values["frames"]
        key = (reference["kind"], str(is_partial), *_detected(reference))
        groups.setdefault(key, []).append(values)
    rows = []
    for (kind, _, *errors), same in groups.items():
        references = [values["reference"] for values in same]
        frames = _range([values["frames"] for values in same], str)
        known = _range([reference["known_frames"] for reference in references], str)
        rows.append(
            (
                names.short(short_id(values["id"]) for values in same),
                frames if known in ("-", frames) else f"{known} of {frames}",
                kind,
                _distance(references, "standard_uncertainty"),
                _distance(references, "zero_motion_distance"),
                *errors,
            )
        )
    yield grid(("ids", "frames", "reference", "u", "rest", "detects", "misses"), rows)


def _distance(references: Sequence[Values], key: str) -> str:
    """Return the range of a distance with its unit; a dash without a reference."""
    text = _range([reference[key] for reference in references], quantity_text)
    return text if text == "-" else f"{text} {references[0]['unit']}"


def _range(values: Sequence[Any], text: Callable[[Any], str]) -> str:
    """Return `least to largest`, one value if they are equal, or a dash for None."""
    if None in values:
        return "-"
    return " to ".join(dict.fromkeys((text(min(values)), text(max(values)))))


def _detected(reference: Values) -> list[str]:
    """Return the planted errors that change a score or an event, and those that do not."""
    scores = [row for _, row in planted_error_scores(reference)]
    seen = {
        title: any(row.get(title) for row in scores)
        for title in PLANTED_ERRORS.values()
        if any(title in row for row in scores)
    }
    merged: dict[str, bool] = {}
    for title, is_seen in seen.items():
        quantity, _, direction = title.partition(" 20 % ")
        if not direction:
            merged[SHORT_ERRORS[title]] = is_seen
        elif len({seen[other] for other in ERROR_PAIRS[quantity]}) == 1:
            merged[quantity] = is_seen
        else:
            merged[f"{direction} {quantity}"] = is_seen
    return [
        ", ".join(title for title, is_seen in merged.items() if is_seen is chosen)
        for chosen in (True, False)
    ]


def _spaces(names: _Names, members: Sequence[Values]) -> Iterator[str]:
    """Yield the actions, the observations and the observable, one sentence for each different space."""

    def action(values: Values) -> str:
        rows = [f"{row['meaning']}, {row['unit']}" for row in values["action"]]
        if values["action"][0]["unit"] == "1":
            return "0."
        return _sentences("; ".join(rows))

    def observation(values: Values) -> str:
        sizes: dict[str, list[int]] = {}
        for row in values["observation"]:
            shape = sizes.setdefault(row["entry"], [*row["shape"][:-1], 0])
            shape[-1] += row["shape"][-1]
        entries = [f"{name} {shape_text(shape)}" for name, shape in sizes.items()]
        return f"{', '.join(entries)}."

    def observable(values: Values) -> str:
        kind = values["observable"]["kind"].replace("_", " ")
        return f"{kind} [{values['observable']['unit']}]."

    yield from names.facts("Action", members, action)
    yield from names.facts("Observation", members, observation)
    yield from names.facts("Observable", members, observable)


def _rewards(names: _Names, members: Sequence[Values]) -> list[str]:
    """Return the rewards in terms of z, which `READING` defines."""

    def reward(values: Values) -> str:
        text = values["reference"]["reward"]
        match = REWARDED.search(text)
        if match is None:
            return "0."
        form = "-z / (1 + z)" if text.startswith("-z") else "-z"
        return f"{form}, z over {match['names']}."

    return names.facts("Reward", members, reward)


def _sources(names: _Names, members: Sequence[Values]) -> Iterator[str]:
    """Yield the sources of the references; texts that differ in numbers share a sentence."""
    forms: dict[str, dict[str, list[str]]] = {}
    for values in members:
        text = _source(values)
        form = NUMBER.sub("#", text)
        forms.setdefault(form, {}).setdefault(text, []).append(short_id(values["id"]))
    for form, texts in forms.items():
        numbers = zip(*map(NUMBER.findall, texts), strict=True)
        between = form.split("#")
        filled = between[0] + "".join(
            " / ".join(dict.fromkeys(column)) + text
            for column, text in zip(numbers, between[1:], strict=True)
        )
        label = names.short(name for same in texts.values() for name in same)
        title, _, text = filled.partition(": ")
        yield _fact(title, label, _sentences(text))


def _source(values: Values) -> str:
    text = values["reference"]["source"]
    if not text:
        return "Reference: none"
    if solved := SOLUTION.fullmatch(text):
        check = solved["check"] or ""
        return f"Reference: refined solution of {solved['solvers']}{check}"
    kind = "No reference" if values["reference"]["kind"] == "none" else "Reference"
    return f"{kind}: {text}"


def _events(names: _Names, members: Sequence[Values]) -> list[str]:
    """Return the recorded events with their real values."""

    def events(values: Values) -> str:
        texts = [
            f"{event_title(event['name'])} "
            + plus_minus_text(
                event["value"], event["standard_uncertainty"], event["unit"]
            )
            for event in values["reference"]["events"]
        ]
        return f"{', '.join(texts)}." if texts else ""

    return names.facts("Real events", members, events)


# --- engines ----------------------------------------------------------------------------------------------------------


def _engines(
    names: _Names, members: Sequence[Values], shared: Sequence[str]
) -> Iterator[str]:
    """Yield the engines with their presets and steps, and those that do not build the scene.

    Args:
        names: Names of the variants.
        members: The variants.
        shared: Reasons of other families too, which are not repeated.
    """
    running: dict[str, list[str]] = {}
    unsupported: dict[str, list[str]] = {}
    for engine in filter(is_bundled, backend_names()):
        title = f"[{backend_class(engine).title}](../engines/{engine}.md)"
        rows = {
            short_id(values["id"]): _engine_row(values, engine) for values in members
        }
        runs = {name: row for name, row in rows.items() if not row["missing"]}
        if runs:
            presets = ", ".join(
                dict.fromkeys(f"`{row['preset']}`" for row in runs.values())
            )
            steps_s = sorted({row["timestep_s"] for row in runs.values()})
            ends = dict.fromkeys((steps_s[0], steps_s[-1]))
            steps = " to ".join(map(step_text, ends))
            running.setdefault(names.short(runs), []).append(
                f"{title} {presets} {steps}"
            )
        missing: dict[str, list[str]] = {}
        for name in rows.keys() - runs.keys():
            reason = reasons_text(rows[name]["missing"])
            text = "" if _general(reason) in shared else f": {reason}"
            missing.setdefault(text, []).append(name)
        for text, same in missing.items():
            label = names.short(same)
            listed = "" if label == "all ids" else f", `{label}`"
            unsupported.setdefault(listed + text, []).append(title)
    for label, texts in running.items():
        yield _fact("Preset and step [s]", label, f"{', '.join(texts)}.")
    for text, titles in unsupported.items():
        yield f"Not on {', '.join(titles)}{text}."


def step_text(step_s: float) -> str:
    """Return a time step as a fraction of a second if it is one, otherwise in seconds."""
    fraction = Fraction(step_s).limit_denominator(1_000_000)
    return str(fraction) if fraction.numerator == 1 else f"{step_s:.4g}"


def reasons_text(missing: Sequence[str]) -> str:
    """Return the first reason why an engine cannot build a scene, and the number of the remaining reasons."""
    if len(missing) < 2:
        return "".join(missing)
    return f"{missing[0]} (and {len(missing) - 1} more)"


def _engine_row(values: Values, engine: str) -> Values:
    row: Values = next(row for row in values["engines"] if row["engine"] == engine)
    return row


def _general(reason: str) -> str:
    """Return a reason without the name of its body."""
    return QUOTED.sub("the body", reason)


def _shared_reasons(families: Families) -> list[str]:
    """Return the reasons that several families have, without the names of bodies."""
    seen: dict[str, set[str]] = {}
    for family, members in families.items():
        for values in members:
            for row in values["engines"]:
                if row["missing"] and is_bundled(row["engine"]):
                    reason = _general(reasons_text(row["missing"]))
                    seen.setdefault(reason, set()).add(family)
    return [reason for reason, users in seen.items() if len(users) > 1]


# --- constants --------------------------------------------------------------------------------------------------------


def _constants(
    names: _Names, members: Sequence[Values], families: Families
) -> Iterator[Part]:
    """Yield the constants in use, a column for each group of ids with the same constants."""
    materials = {
        key: value
        for family, body in MATERIALS.values()
        for key, value in _material_constants(families[family], body).items()
    }
    used = [(short_id(values["id"]), _used_constants(values)) for values in members]
    shared: set[str] = set()
    rows = {}
    for place in dict.fromkeys(place for _, table in used for place in table):
        cells = {name: table.get(place) for name, table in used}
        known = [
            materials.get((place[1], name.rpartition("-")[2], cell["value"]))
            for name, cell in cells.items()
            if cell
        ]
        if all(known):
            shared.update(filter(None, known))
        else:
            rows[place] = cells
    columns: dict[tuple[str, ...], list[str]] = {}
    for name, _ in used:
        texts = tuple(_constant_text(cells[name]) for cells in rows.values())
        columns.setdefault(texts, []).append(name)
    yield Heading("Constants")
    labels = [names.short(same) for same in columns.values()]
    body_rows = [
        (Markdown(f"{body} `{key}`"), *(column[index] for column in columns))
        for index, (body, key) in enumerate(rows)
    ]
    yield grid(("constant", *labels), body_rows)
    notes = [
        f"{title} have [more constants]({READING}#{title.lower()})."
        for title in sorted(shared)
    ]
    sources: dict[str, list[tuple[str, str]]] = {}
    for place, cells in rows.items():
        for source in dict.fromkeys(cell["source"] for cell in cells.values() if cell):
            sources.setdefault(source, []).append(place)
    for source, places in sources.items():
        if source != "metadata":
            notes.append(f"Source{_places_text(places, rows)}: {source}.")
    if notes:
        yield Paragraph(Markdown(" ".join(notes)))


def _places_text(
    places: Sequence[tuple[str, str]], rows: Iterable[tuple[str, str]]
) -> str:
    """Return ` of` and the names of constants: bodies where all their constants are meant, nothing for all rows."""
    if set(places) == set(rows):
        return ""
    others = {body for body, key in rows if (body, key) not in places}
    names = [body if body not in others else f"{body} `{key}`" for body, key in places]
    return f" of {', '.join(dict.fromkeys(names))}"


def _constant_text(cell: Values | None) -> str:
    """Return a constant with four digits, or a large one without an exponent; a dash for None."""
    if cell is None:
        return "-"
    value = cell["value"]
    return f"{value:.0f}" if value >= 1e4 else f"{value:.4g}"


def _used_constants(values: Values) -> dict[tuple[str, str], Values]:
    """Return the constants that change the motion, by body and key.

    Masses of fixed and driven bodies have no effect. A contact has the friction and the restitution of one of its
    bodies; restitution counts in impacts alone.
    """
    moving = {
        body["name"]
        for body in values["bodies"]
        if body["kind"] != "rigid" or body["motion"] == "dynamic"
    }
    in_contact = {
        (_owner(values["constants"], contact, key), key)
        for contact in values["contacts"]
        for key in ("friction", "restitution")
        if key == "friction" or contact["mode"] == "impact"
    }
    used = {}
    for name, table in values["constants"].items():
        is_moving = any(_is_body(name, body) for body in moving)
        for key, cell in table.items():
            if key in ("friction", "restitution"):
                is_used = (name, key) in in_contact
            else:
                is_used = is_moving and key != "density_kg_per_m3"
            if is_used:
                used[name, key] = cell
    return used


def _owner(constants: Mapping[str, Values], contact: Values, key: str) -> str:
    """Return the first body of a contact whose constant the contact has; empty for none."""
    for body in (*contact["first"], *contact["second"]):
        for name, table in constants.items():
            cell = table.get(key)
            if _is_body(name, body) and cell and cell["value"] == contact[key]:
                return name
    return ""


def _is_body(constants_name: str, body: str) -> bool:
    """Return whether constants are of a body: `ball` has those of `ball-1` and `ball-2`."""
    return body == constants_name or re.sub(r"-\d+$", "", body) == constants_name


def _material_constants(
    members: Sequence[Values], body: str
) -> dict[tuple[str, str, float], str]:
    """Return the title of each constant of a material, by key, name of the material and value."""
    title = next(title for title, (_, shown) in MATERIALS.items() if shown == body)
    return {
        (key, values["id"].rpartition("-")[2], cell["value"]): title
        for values in members
        for (name, key), cell in _used_constants(values).items()
        if name == body and key not in SCENE_KEYS
    }


# --- limits -----------------------------------------------------------------------------------------------------------


def note_of(study: str) -> str:
    """Return the note of a study, or its heading in the list of finished studies."""
    if (ROOT / "studies" / study).is_dir():
        return f"{study}/README.md"
    return f"README.md#{study}"


def _limit_text(limit: Values) -> str:
    link = f"../../studies/{note_of(limit['study'])}" if limit["study"] else ""
    return limit["text"] + (f" ([study]({link}))" if link else "")


def _shared_limits(families: Families) -> dict[str, list[str]]:
    """Return the limits of several families, each with their names."""
    seen: dict[str, list[str]] = {}
    for family, members in families.items():
        for values in members:
            for limit in values["limits"]:
                users = seen.setdefault(_limit_text(limit), [])
                if family not in users:
                    users.append(family)
    return {text: users for text, users in seen.items() if len(users) > 1}


def _limits(
    names: _Names, members: Sequence[Values], shared: Mapping[str, Sequence[str]]
) -> Iterator[Part]:
    """Yield the known limits of this family alone, and the sources of the prescribed motions."""
    limits: dict[str, list[str]] = {}
    motions: dict[str, dict[str, list[str]]] = {}
    has_shared = False
    for values in members:
        name = short_id(values["id"])
        for limit in values["limits"]:
            text = _limit_text(limit)
            if text in shared:
                has_shared = True
            else:
                limits.setdefault(text, []).append(name)
        for driver in values["drivers"]:
            text = f"{driver['body']}: {_sentences(driver['note'])}"
            users = motions.setdefault(text, {}).setdefault(driver["provenance"], [])
            users.append(name)
    entries = [_labelled(names.short(same), text) for text, same in limits.items()]
    for text, sources in motions.items():
        kinds = [
            source if len(sources) == 1 else f"{source} for `{names.short(same)}`"
            for source, same in sources.items()
        ]
        label = names.short(name for same in sources.values() for name in same)
        entries.append(_labelled(label, f"Motion ({', '.join(kinds)}) of {text}"))
    if has_shared:
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
        members = families[family]
        used = [_used_constants(values) for values in members]
        keys = [key for name, key in used[0] if name == body and key not in SCENE_KEYS]
        rows = [
            (
                Markdown(f"`{key}`"),
                *(_constant_text(table[body, key]) for table in used),
            )
            for key in keys
        ]
        labels = [values["id"].rpartition("-")[2] for values in members]
        tables += [Heading(title, 3), grid(("constant", *labels), rows)]
    limits = [
        f"{', '.join(users)}: {text}"
        for text, users in _shared_limits(families).items()
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
