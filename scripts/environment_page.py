"""The page of a family of experiments in the documentation, in Markdown, from the descriptions of its variants."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from gauge_envs.backends.registry import backend_class, backend_names, is_bundled
from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import beyond_variants, variants
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part
from gauge_envs.pages.table import Column, Table, grid
from gauge_envs.pages.text import (
    KIND_NOTES,
    METRIC_TITLES,
    NORMALIZED_NOTE,
    Markdown,
    event_title,
    pairs_text,
    plus_minus_text,
    quantity_text,
    score_text,
    short_id,
    value_text,
)
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.tools.catalog.description import description
from gauge_envs.tools.catalog.report import (
    convergence_facts,
    planted_errors_text,
    reasons_text,
    step_text,
)
from gauge_envs.tools.catalog.spaces import range_text, shape_text
from scripts.generated import ROOT

Values = Mapping[str, Any]
"""Dictionary of `description`."""

PUBLISHED = "published_scores"
"""Study of the published scores: limits with it stand below their table."""


def family_document(family: str, *, picture: str, caption: str) -> Document:
    """Return the page of a family.

    Args:
        family: Name of the family.
        picture: Its picture, relative to the page.
        caption: What the picture shows.
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
            Paragraph(first["summary"]),
            Bullets(list(_summary(first))),
            Heading("Ids"),
            _ids(members),
            *_spaces(names, members),
            *_reference(names, members),
            *_published(names, members),
            *_engines(names, members),
            *_limits(names, members),
            *_driven(names, members),
            *_constants(names, members),
            *_origin(first),
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
    ) -> list[tuple[str, Any, list[Values]]]:
        """Return each different value of members, but None and empty ones, with names and members that have it."""
        groups: list[tuple[Any, list[Values]]] = []
        for values in members:
            found = value(values)
            for known, having in groups:
                if known == found:
                    having.append(values)
                    break
            else:
                groups.append((found, [values]))
        return [
            (self.short(short_id(one["id"]) for one in having), found, having)
            for found, having in groups
            if found
        ]


def _summary(values: Values) -> Iterator[str]:
    observable = values["observable"]
    yield f"It evaluates {', '.join(values['evaluates'])}."
    yield f"Observed is g(t), {observable['kind'].replace('_', ' ')} [{observable['unit']}], 30 frames a second."
    yield f"Sources: {'; '.join(f'{key}: {text}' for key, text in values['source'].items())}."
    yield f'`gymnasium.make("{values["id"]}")` makes the first id, `gauge show {short_id(values["id"])}` prints it.'


def _ids(members: Sequence[Values]) -> Table:
    has_exact = any(values["reference"]["exact"] for values in members)
    columns = (
        Column("id", "id", Markdown),
        *([Column("subtask", "subtask")] if members[0]["subtask"] else []),
        Column("frames", "frames", is_number=True),
        Column(
            "duration_s", "duration [s]", lambda value: f"{value:.3f}", is_number=True
        ),
        Column("reference.kind", "kind of the reference"),
        Column("reference.trial_count", "real trials", is_number=True),
        Column("reference.known_frames", "frames compared", is_number=True),
        Column("", "u", lambda one: _length(one, "standard_uncertainty")),
        Column("", "frozen", lambda one: _length(one, "zero_motion_distance")),
        *([Column("reference.exact", "exact", pairs_text)] if has_exact else []),
    )
    kinds = dict.fromkeys(values["reference"]["kind"] for values in members)
    notes = [f"{kind}: {KIND_NOTES[Kind(kind)]}." for kind in kinds]
    notes.append(
        "u: standard uncertainty of the reference. Frozen: distance of a scene in which nothing moves."
    )
    if has_exact:
        notes.append("Exact: score over real trials of an exact solution.")
    return Table(columns=columns, rows=members, notes=tuple(notes))


def _length(values: Values, key: str) -> str:
    """Return a distance of the reference with its unit; a dash without a reference."""
    reference = values["reference"]
    if reference[key] is None:
        return "-"
    return f"{quantity_text(reference[key])} {reference['unit']}"


# --- spaces, reward, reference ----------------------------------------------------------------------------------------


def _spaces(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    for key, title in (
        ("action", "Action space"),
        ("observation", "Observation space"),
    ):
        yield Heading(title)
        groups = names.grouped(
            ({"id": values["id"], "rows": values[key]} for values in members),
            _without_ranges,
        )
        for label, _, having in groups:
            if len(groups) > 1:
                yield Paragraph(f"Ids {label}:")
            yield _space_table([values["rows"] for values in having])
    yield Paragraph("A range is that of the declared space, the widest of the ids.")


def _without_ranges(values: Values) -> list[dict[str, Any]]:
    return [
        {key: value for key, value in row.items() if key not in ("low", "high")}
        for row in values["rows"]
    ]


def _space_table(spaces: Sequence[Sequence[dict[str, Any]]]) -> Table:
    """Return the rows of spaces that differ in their ranges alone, with the widest range."""
    rows = []
    for same in zip(*spaces, strict=True):
        low, high = ([row[bound] for row in same] for bound in ("low", "high"))
        rows.append(
            same[0]
            | ({} if None in (*low, *high) else {"low": min(low), "high": max(high)})
        )
    return Table(
        columns=(
            Column("name", "entry", lambda name: Markdown(f"`{name}`")),
            Column("", "shape", lambda row: shape_text(row["shape"]) or "number"),
            Column("", "range", range_text),
            Column("unit", "unit"),
            Column("meaning", "meaning"),
        ),
        rows=rows,
    )


def _reference(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    yield Heading("Reward")
    yield Bullets(
        _listed(names, members, lambda values: f"{values['reference']['reward']}.")
    )
    yield Heading("Reference")

    def source(values: Values) -> str:
        return f"{values['reference']['source'] or KIND_NOTES[Kind.NONE]}."

    def sees(values: Values) -> str:
        text = planted_errors_text(values["reference"])
        return f"Scores of planted errors in MuJoCo, {text}." if text else ""

    yield Bullets([*_listed(names, members, source), *_listed(names, members, sees)])
    yield from _recorded(names, members)


def _recorded(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    """Yield a table of the recorded events, in which ids share rows."""
    ids: dict[tuple[str, str, str], list[str]] = {}
    for values in members:
        for event in values["reference"]["events"]:
            value = plus_minus_text(
                event["value"], event["standard_uncertainty"], event["unit"]
            )
            row = (event_title(event["name"]), value, event["source"])
            ids.setdefault(row, []).append(short_id(values["id"]))
    if ids:
        rows = [(names.short(having), *row) for row, having in ids.items()]
        yield grid(("id", "recorded event", "value +- u", "source"), rows)


def _listed(
    names: _Names, members: Sequence[Values], text: Callable[[Values], str | None]
) -> list[str]:
    """Return each different text, behind the variants that it is of."""
    groups = names.grouped(members, text)
    return [_of(label, found) for label, found, _ in groups]


def _code(label: str) -> str:
    return label if label == "all ids" else f"`{label}`"


def _of(label: str, text: str) -> str:
    """Return a sentence behind the variants that it is of; the asterisks of their patterns are no marks."""
    return text if label == "all ids" else f"`{label}`: {text}"


# --- scores, engines, limits ------------------------------------------------------------------------------------------


def _published(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    lines = [
        {"id": names.short([short_id(one["id"])])} | line
        for one in members
        for line in one["baselines"]
    ]
    yield Heading("Published scores")
    if not lines:
        yield Paragraph("None.")
        return
    yield _published_table(lines)
    notes = _limit_lines(names, members, lambda limit: limit["study"] == PUBLISHED)
    notes += _listed(names, members, _impossible)
    if notes:
        yield Bullets(notes)


def _published_table(baselines: Sequence[Values]) -> Table:
    """Return published scores as a table, with the short id before the metric."""

    def trials(line: Values) -> str:
        return plus_minus_text(line["mean"], line["std"], line["unit"])

    engines = [
        Column(f"engines.{key}", title, score_text, is_number=True)
        for key, title in PUBLISHED_ENGINES.items()
    ]
    return Table(
        columns=(
            Column("id", "id"),
            Column("metric", "metric", METRIC_TITLES.__getitem__),
            Column("", "real trials", trials, is_number=True),
            *engines,
        ),
        rows=baselines,
        notes=(NORMALIZED_NOTE,),
    )


def _impossible(values: Values) -> str:
    """Return a note on published scores that are larger than the observable allows."""
    if not values["reference"]["impossible"]:
        return ""
    return (
        "Some of these scores are larger than is possible, so that their unit or observable is another one; "
        "`gauge show` names them."
    )


def _engines(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    rows: list[dict[str, Any]] = []
    declined: list[str] = []
    for engine in filter(is_bundled, backend_names()):
        title = f"[{backend_class(engine).title}](../engines/{engine}.md)"
        rows += ({"engine": title} | row for row in _running(names, members, engine))
        declined += (
            f"{title} declines {reason}" for reason in _reasons(names, members, engine)
        )
    yield Heading("Engines")
    yield Paragraph(
        Markdown(
            f"`{EnvArguments.backend}` is the default; the preset follows from the scene."
        )
    )
    yield Table(
        columns=(
            Column("engine", "engine", Markdown),
            Column("ids", "ids"),
            Column("preset", "preset"),
            Column("timestep_s", "step [s]", step_text, is_number=True),
        ),
        rows=rows,
    )
    yield Bullets(declined) if declined else Paragraph("No engine declines.")
    yield from _convergence(names, members)


def _reasons(names: _Names, members: Sequence[Values], engine: str) -> list[str]:
    """Return what an engine declines and why, one sentence each."""

    def reason(values: Values) -> str:
        return reasons_text(_of_engine(values, engine)["missing"])

    return [
        f"{_code(label)}: {text}." for label, text, _ in names.grouped(members, reason)
    ]


def _running(
    names: _Names, members: Sequence[Values], engine: str
) -> Iterator[dict[str, Any]]:
    """Yield preset and step of the members that an engine runs."""
    keys = ("preset", "timestep_s")

    def facts(values: Values) -> dict[str, Any] | None:
        row = _of_engine(values, engine)
        return None if row["missing"] else {key: row[key] for key in keys}

    for label, found, _ in names.grouped(members, facts):
        yield {"ids": label} | found


def _of_engine(values: Values, engine: str) -> Values:
    found: Values = next(row for row in values["engines"] if row["engine"] == engine)
    return found


def _convergence(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    rows = [
        (names.short([short_id(values["id"])]), backend_class(engine).title, text)
        for values in members
        for engine, text in convergence_facts(values).items()
    ]
    if rows:
        yield Heading("Convergence")
        yield grid(("id", "engine", "difference that a finer step or mesh makes"), rows)


def note_of(study: str) -> str:
    """Return the note of a study, or its heading among those that ended."""
    if (ROOT / "studies" / study).is_dir():
        return f"{study}/README.md"
    return f"README.md#{study}"


def _limits(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    lines = _limit_lines(names, members, lambda limit: limit["study"] != PUBLISHED)
    yield Heading("Known limits")
    yield (
        Bullets(lines)
        if lines
        else Paragraph(Markdown("None but those of [all experiments](../limits.md)."))
    )


def _limit_lines(
    names: _Names, members: Sequence[Values], is_wanted: Callable[[Values], bool]
) -> list[str]:
    """Return the known limits that are wanted, each behind the variants that it is of."""
    found: dict[str, list[str]] = {}
    for values in members:
        for limit in filter(is_wanted, values["limits"]):
            study = (
                f" ([study](../../studies/{note_of(limit['study'])}))"
                if limit["study"]
                else ""
            )
            found.setdefault(limit["text"] + study, []).append(short_id(values["id"]))
    return [_of(names.short(having), text) for text, having in found.items()]


# --- constants and their sources --------------------------------------------------------------------------------------


def _driven(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    def drivers(values: Values) -> str:
        return " ".join(
            f"{one['body']} ({one['provenance']}): {one['note']}."
            for one in values["drivers"]
        )

    if lines := _listed(names, members, drivers):
        yield Heading("Driven motion")
        yield Bullets(lines)


def _constants(names: _Names, members: Sequence[Values]) -> Iterator[Part]:
    yield Heading("Constants")
    groups = names.grouped(members, lambda values: values["constants"])
    places = dict.fromkeys(
        (body, key)
        for values in members
        for body, table in values["constants"].items()
        for key in table
    )
    rows = []
    for body, key in places:
        cells = [tables.get(body, {}).get(key) for _, tables, _ in groups]
        sources = dict.fromkeys(cell["source"] for cell in cells if cell)
        numbers = [value_text(cell["value"]) if cell else "-" for cell in cells]
        rows.append((body, Markdown(f"`{key}`"), *numbers, "; ".join(sources)))
    yield grid(("body", "constant", *(label for label, _, _ in groups), "source"), rows)


def _origin(values: Values) -> Iterator[Part]:
    yield Heading("Where the numbers are from")
    rows = [
        (Markdown(f"`{key}`"), source) for key, source in values["provenance"].items()
    ]
    yield grid(("numbers", "source"), rows)
    if values["decisions"]:
        yield Heading("Decisions")
        yield Bullets(values["decisions"])
    sets = {name: one["summary"] for name, one in values["parameter_sets"].items()}
    yield Heading("Parameter sets")
    yield Bullets([f"`{name}`: {summary}" for name, summary in sets.items()])
