"""The first page: which engine is how far from reality, in what, and with what certainty."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from gauge_envs.pages.document import Heading, Paragraph, Part, Tone
from gauge_envs.pages.html import Html, below, element, join, listed
from gauge_envs.pages.results import SCORE_METRICS, versions_text
from gauge_envs.pages.table import Column, Table, grid
from gauge_envs.pages.text import GRADE_NOTES, QUESTIONS, counted
from gauge_envs.references.kind import Kind
from gauge_envs.tools.compare import (
    PUBLISHED,
    ExperimentComparison,
    GradeComparison,
    GradeScore,
    deciding_text,
    grades_of,
    mean_rank_text,
)
from gauge_envs.tools.site.model import (
    LOST,
    Site,
    Standing,
    score_cell,
    section,
    site_page,
    whisker_text,
)

SCALE_NOTE = (
    "Score: distance to the real mean over the mean distance of single real trials, which is 1. Lower is closer. In "
    "brackets: 95 % interval, from the sample of real trials."
)

SOLUTION_NOTE = (
    "Distance from the solution of the scene over u, its standard uncertainty; that from an exact solution is in its "
    "unit. In brackets: 95 % interval. RMSE and DTW: distances of g(t) from the solution. Nothing here is of reality."
)

ALIGNED_NOTE = (
    "RMSE aligned: after the best constant shift in time, because a real release is not at an exact time. So are the "
    "trials of the 1."
)

RANK_NOTE = (
    "Rank: mean over the experiments, with its 95 % interval by paired bootstrap. Only engines with the same constants "
    "are ranked against each other. The intervals of scores overlap more: engines share errors, which cancel in a "
    "difference."
)

MEAN_RANK_NOTE = (
    "Mean rank: over the experiments, which all count the same, with its 95 % interval. Rank in: best to worst rank in "
    "the experiments that move the mean most."
)

EVENTS_NOTE = (
    "Metrics of events over the real value. LSD: longest rest of the last ball of the cradle. MTE: momentum that the "
    "cradle hands on. PD: period of the pendulum. EL: energy loss of the pendulum."
)

PARTIAL_NOTE = (
    "No scatter of real trials is published for what these references compare. So there is no 1 to compare with and no "
    "interval."
)

UNSCORED_NOTE = (
    "No real reference is published, so nothing says which engine is right. Distance and motion: root mean square "
    "over the frames; the motion is the displacement from the start."
)


def overview_page(site: Site) -> str:
    """Return the first page of a site."""
    comparison = site.comparison
    graded = [grade for grade in comparison.grades if grade.ids]
    references = ", ".join(
        f"{len(grade.ids)} against {_grade_title(grade)}" for grade in graded
    )
    lead = (
        f"{counted(len(comparison.experiments), 'experiment')}, "
        f"{counted(len(comparison.configurations), 'configuration')} of {counted(len(site.engines), 'engine')}. "
        f"Compared: {references or 'none'}."
    )
    asked = [question for question in QUESTIONS if grades_of(comparison, question)]
    parts: list[Part] = [
        element("p", lead, class_="lead"),
        *(part for question in asked for part in _question(site, question)),
        *section(
            "Distance to a part of the motion",
            _scores_table(site, "experiment", _unscaled(site)),
            PARTIAL_NOTE,
        ),
        *section("Events", _scores_table(site, "event", _events(site)), EVENTS_NOTE),
        *section(
            "Without a reference: how far engines are apart",
            _unscored_table(site),
            UNSCORED_NOTE,
        ),
        *_engines(site),
        *(Paragraph(f"Note: {note}.", Tone.WARNING) for note in comparison.notes),
    ]
    titles = [QUESTIONS[question].partition(": ")[2].capitalize() for question in asked]
    title = " ".join(titles) or "How far are engines apart?"
    return site_page(title, parts, here="index.html")


def _question(site: Site, question: str) -> Iterator[Part]:
    """Yield the scores and the ranks of the grades that answer one question."""
    grades = grades_of(site.comparison, question)
    graded = [grade for grade in grades if grade.ids]
    none: list[str] = ["No experiment has a score in all configurations."]
    answers = [_answer(site, grade) for grade in graded] or none
    yield Heading(QUESTIONS[question])
    yield from _matrix(site, is_verified=question == "verification")
    yield Heading("Mean ranks, grade by grade", 3)
    yield element("div", *(element("p", one) for one in answers), class_="answer")
    for grade in graded:
        if len(grade.scores) > 1:
            yield from _ranking(site, grade)
    yield Paragraph(MEAN_RANK_NOTE, Tone.NOTE)


def _grade_title(grade: GradeComparison) -> str:
    titles = {
        "trials": "real trials",
        "recording": "one recorded trial",
        "law": "a law",
        "model": "the solved model, not reality",
    }
    return titles.get(grade.grade, grade.grade) + (
        ", withheld band" if grade.withheld else ""
    )


# --- the answer ---


def _answer(site: Site, grade: GradeComparison) -> Html:
    """Return the configuration with the lowest mean rank of a grade."""
    best, *others = grade.ranked
    assert best.mean_rank is not None
    over = f"{_constants(grade)}{counted(len(grade.ids), 'experiment')}"
    start = f"Against {_grade_title(grade)} ({over}): "
    if not others:
        return join(
            [
                element("b", start),
                site.links[best.configuration],
                " alone, so without a rank.",
            ]
        )
    return join(
        [
            element("b", start + "lowest mean rank "),
            site.links[best.configuration],
            f" {mean_rank_text(best.mean_rank)} of {len(grade.scores)}.",
        ]
    )


def _constants(grade: GradeComparison) -> str:
    return "" if grade.constants == PUBLISHED else f"parameters {grade.constants}, "


def _ranking(site: Site, grade: GradeComparison) -> list[Part]:
    rows = [
        (
            join([site.swatch(one.configuration), site.labels[one.configuration]]),
            site.comparison.configurations[one.configuration].physics,
            mean_rank_text(one.mean_rank),
            deciding_text(grade, one.configuration),
        )
        for one in grade.ranked
        if one.mean_rank is not None
    ]
    table = grid(("configuration", "physics", "mean rank", "rank in"), rows)
    return section(
        f"Against {_grade_title(grade)}",
        table,
        f"{GRADE_NOTES[Kind(grade.grade)].capitalize()}.",
    )


# --- engine x phenomenon ---


@dataclass(frozen=True)
class _Phenomenon:
    """Experiments of one family against references of one grade and one scale, of which one has a score."""

    title: str
    tests: str
    grades: Sequence[GradeComparison]
    members: Sequence[ExperimentComparison]

    @property
    def scale_unit(self) -> str:
        """Unit of the scores; that of all members is the same."""
        return self.members[0].scale_unit

    @property
    def is_exact(self) -> bool:
        """Whether scores are distances from exact solutions, which have no interval."""
        return self.scale_unit not in ("1", "u")

    def of(self, configuration: int) -> tuple[GradeComparison, GradeScore] | None:
        """Return the comparison that ranks a configuration, and its score there; None without a mean."""
        found = (
            (grade, one)
            for grade in self.grades
            for one in grade.scores
            if one.configuration == configuration
        )
        return next((entry for entry in found if entry[1].mean is not None), None)


def _phenomena(site: Site, *, is_verified: bool) -> Iterator[_Phenomenon]:
    groups: dict[tuple[str, str, str, bool, str], list[ExperimentComparison]] = {}
    for one in site.comparison.experiments:
        if one.is_verified is is_verified:
            key = (*site.family(one), one.grade, one.withheld, one.scale_unit)
            groups.setdefault(key, []).append(one)
    for (title, tests, *_), members in groups.items():
        if compared := site.comparison.compare_within(members):
            yield _Phenomenon(title, tests, compared, members)


def _matrix(site: Site, *, is_verified: bool) -> list[Part]:
    def heading(one: _Phenomenon) -> Html:
        links = (
            element(
                "a",
                member.name.partition("-")[2] or member.name,
                href=site.experiment_page(member),
            )
            for member in one.members
        )
        metric = ", ".join(
            dict.fromkeys(SCORE_METRICS[member.primary].title for member in one.members)
        )
        about = below(f"{metric}: ", join(links, " \u00b7 "))
        return join(
            [
                element("b", f"{one.title}, {_grade_title(one.grades[0])}"),
                below(one.tests),
                about,
            ]
        )

    def standing(index: int, one: _Phenomenon) -> str:
        found = one.of(index)
        if found is None or found[1].mean is None or one.is_exact:
            return ""
        ends = found[1].mean.interval_95
        return Standing.of(ends, is_verified=is_verified).value

    columns = (
        Column(
            "", link, html=partial(_matrix_cell, index), style=partial(standing, index)
        )
        for index, link in enumerate(site.headings)
    )
    rows = list(_phenomena(site, is_verified=is_verified))
    if not rows:
        return []
    solved = (Standing.SOLVED, Standing.DIFFERS)
    shown = [one for one in Standing if (one in solved) is is_verified]
    matrix = Table(
        columns=(Column("", "phenomenon", html=heading), *columns),
        rows=rows,
        look="matrix",
    )
    key = listed((standing.badge for standing in shown), class_="key")
    return [
        Heading("Engine by phenomenon", 3),
        key,
        matrix,
        Paragraph(SOLUTION_NOTE if is_verified else SCALE_NOTE, Tone.NOTE),
        Paragraph(RANK_NOTE, Tone.NOTE),
        *([] if is_verified else [Paragraph(ALIGNED_NOTE, Tone.NOTE)]),
    ]


def _matrix_cell(index: int, one: _Phenomenon) -> Html:
    """Return the score and the rank of a configuration in a phenomenon, and what has no score."""
    cells = [
        cell for member in one.members if (cell := member.cells[index]) is not None
    ]
    lost = []
    for outcome in LOST:
        count = sum(cell.count(outcome) for cell in cells)
        if count:
            lost.append(below(f"{count} {outcome.value}"))
    found = one.of(index)
    mean = None if found is None else found[1].mean
    if found is None or mean is None:
        return join(
            [element("span", "no score" if cells else "not run", class_="quiet"), *lost]
        )
    grade, score = found
    parts = [
        whisker_text(
            mean.value, None if one.is_exact else mean.interval_95, one.scale_unit
        ),
        below(place_text(grade, score)),
    ]
    if len(grade.ids) < len(one.members):
        parts.append(below(f"over {len(grade.ids)} of {len(one.members)} experiments"))
    return join([*parts, *lost])


def place_text(grade: GradeComparison, score: GradeScore) -> str:
    """Return a mean rank in words; empty where there is nothing to compare with."""
    if score.mean_rank is None or len(grade.scores) < 2:
        return ""
    return f"rank {mean_rank_text(score.mean_rank)} of {len(grade.scores)}"


# --- the rest ---

MetricRow = tuple[ExperimentComparison, str, str]
"""Experiment, metric, and what stands below its name."""


def _scores_table(site: Site, title: str, rows: Iterable[MetricRow]) -> Table:
    """Return the score of each configuration in a metric of each experiment."""
    lines = (
        [
            site.experiment_link(one, text),
            *(score_cell(one, cell, name) for cell in one.cells),
        ]
        for one, name, text in rows
    )
    return grid([title, *site.headings], lines, look="matrix")


def _events(site: Site) -> Iterator[MetricRow]:
    for one in site.comparison.experiments:
        for name in one.metrics():
            metric = SCORE_METRICS[name]
            if metric.is_event and any(
                cell and cell.spread(name, normalized=False) for cell in one.cells
            ):
                yield (
                    one,
                    name,
                    f"{metric.title}, {'0 is ideal' if name == 'el' else '1 is the real value'}",
                )


def _unscaled(site: Site) -> Iterator[MetricRow]:
    """Yield the experiments with a reference and no published scatter that covers it: their RMSE in its unit."""
    for one in site.comparison.experiments:
        cells = [
            cell
            for cell in one.cells
            if cell is not None and cell.spread("rmse", normalized=False) is not None
        ]
        if (
            not one.is_verified
            and cells
            and not any(
                cell.draws is not None or cell.spread("rmse", normalized=True)
                for cell in cells
            )
        ):
            yield one, "rmse", f"RMSE, {one.grade}"


def _unscored_table(site: Site) -> Table:
    """Return the largest distance between two configurations in each experiment without a reference."""
    rows: list[list[str]] = []
    for one in site.comparison.experiments:
        if one.grade != Kind.NONE.value:
            continue
        cells = ["one configuration: nothing to compare", "", ""]
        if one.distances:
            far = max(one.distances, key=lambda distance: distance.rms.mean)
            between = f"{site.labels[far.first]} and {site.labels[far.second]}"
            cells = [between, far.text(far.rms.mean), far.text(far.motion_rms)]
        rows.append([site.experiment_link(one), *cells])
    return grid(
        ("experiment", "furthest apart", "distance", "motion"), rows, number_from=2
    )


def _engines(site: Site) -> list[Part]:
    comparison = site.comparison
    rows = [
        [
            site.links[index],
            versions_text(one) or "-",
            *map(str, (summary.ran, summary.scored, summary.diverged, summary.not_run)),
        ]
        for index, (one, summary) in enumerate(
            zip(comparison.configurations, comparison.summaries(), strict=True)
        )
    ]
    titles = ("engine", "versions", "ran", "scored", "diverged", "not run")
    return section("Engines", grid(titles, rows, number_from=2))
