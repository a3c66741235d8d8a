"""The page of a family of experiments in the documentation, in Markdown, from the descriptions of its variants."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from gauge_envs.backends.registry import backend_names, backend_title, is_bundled
from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import (
    beyond_variants,
    find_variant,
    variants,
)
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part
from gauge_envs.pages.table import Column, Table, grid
from gauge_envs.pages.text import GRADE_NOTES, Markdown, short_id, value_text
from gauge_envs.references.band import SigmaSource
from gauge_envs.references.kind import Kind
from gauge_envs.tools.catalog.description import description
from gauge_envs.tools.catalog.spaces import range_text, shape_text
from gauge_envs.tools.catalog.words import (
    SIGMA_NOTES,
    convergence_facts,
    grade_note,
    published_table,
    reasons_text,
    step_text,
)
from scripts.build_coverage import coverage
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
    def known(values: Values) -> str:
        count = values["reference"]["known_frames"]
        return (
            "-"
            if count is None or values["reference"]["grade"] == Kind.NONE
            else str(count)
        )

    columns = (
        Column("id", "id", Markdown),
        *([Column("subtask", "subtask")] if members[0]["subtask"] else []),
        Column("frames", "frames", is_number=True),
        Column(
            "duration_s", "duration [s]", lambda value: f"{value:.3f}", is_number=True
        ),
        Column("reference.grade", "grade of the reference"),
        Column("reference.trial_count", "real trials", is_number=True),
        Column("", "frames compared", known, is_number=True),
    )
    notes = dict.fromkeys(
        f"{values['reference']['grade']}: {grade_note(values['reference'])}."
        for values in members
    )
    return Table(columns=columns, rows=members, notes=tuple(notes))


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
    used = [values for values in members if values["reference"]["grade"] != Kind.NONE]
    lines = _listed(
        names,
        used,
        lambda values: (
            values["reference"]["source"] and f"{values['reference']['source']}."
        ),
    )
    lines += _listed(names, used, _sigma)
    lines += _listed(names, members, _withheld)
    if bare := [short_id(values["id"]) for values in members if values not in used]:
        lines.append(_of(names.short(bare), f"{GRADE_NOTES[Kind.NONE]}."))
    lines += _listed(
        names,
        members,
        lambda values: (
            _unsolved(values)["reason"] and f"{_unsolved(values)['reason']}."
        ),
    )
    yield Bullets(lines)
    if rows := list(_statistics(names, members)):
        yield Paragraph(
            "In place of a solution, the last frame: mean +- scatter of runs with other steps and cells."
        )
        columns = list(dict.fromkeys(name for row in rows for name in row))
        yield grid(columns, [[row.get(name, "-") for name in columns] for row in rows])


def _unsolved(values: Values) -> Values:
    return values["reference"]["unsolved"] or {"reason": "", "statistics": {}}


def _statistics(names: _Names, members: Sequence[Values]) -> Iterator[dict[str, str]]:
    """Yield statistics of the last frame, a row for each id and engine."""
    for values in members:
        statistics = _unsolved(values)["statistics"]
        for engine in dict.fromkeys(
            engine for found in statistics.values() for engine in found
        ):
            cells = {
                name: found[engine]
                for name, found in statistics.items()
                if engine in found
            }
            runs = str(next(iter(cells.values()))[2])
            texts = {
                name: f"{mean:.4g} +- {spread:.2g}"
                for name, (mean, spread, _) in cells.items()
            }
            yield {
                "id": names.short([short_id(values["id"])]),
                "engine": backend_title(engine),
                "runs": runs,
            } | texts


def _sigma(values: Values) -> str:
    reference = values["reference"]
    if Kind(reference["grade"]).is_solution:
        return (
            "Verification: distances are over u of the solution, those from an exact one in its unit, and none is over "
            "the scatter of real trials."
        )
    text = f"Sigma: {SIGMA_NOTES[SigmaSource(reference['sigma_source'])]}."
    if reference["single_shot"]:
        return f"{text} Each trial has a start of its own; a reset with a trial or a seed selects another one."
    if reference["normalized_by_baseline"] is False:
        text += (
            " Not normalized: the published baseline is of another span of the motion."
        )
    return text


def _withheld(values: Values) -> str | None:
    reason = values["reference"]["withheld"]
    return (
        reason
        and f"A recording is withheld from scores: {reason}. `use_withheld=True` scores on it."
    )


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
    yield published_table(lines, columns=(Column("id", "id"),))
    notes = _limit_lines(names, members, lambda limit: limit["study"] == PUBLISHED)
    notes += _listed(names, members, _impossible)
    if notes:
        yield Bullets(notes)


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
        title = f"[{backend_title(engine)}](../engines/{engine}.md)"
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
        (names.short([short_id(values["id"])]), backend_title(engine), text)
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
