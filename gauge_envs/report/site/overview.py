"""The first page: which engine is how far from reality, in what, and with what certainty."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gauge_envs.analysis.comparison import ExperimentComparison
from gauge_envs.analysis.grades import GradeComparison, GradedExperiment, GradeScore, compare_grade
from gauge_envs.analysis.scores import COMPARED_METRICS
from gauge_envs.references.bands import BandGrade
from gauge_envs.report.site.html import Html, element, join, page, table
from gauge_envs.report.site.model import TITLES, Site, Standing, badge, score_cell, standing_of, whisker_text
from gauge_envs.report.site.svg import ForestRow, forest
from gauge_envs.report.text import GRADE_NOTES, quantity_text, score_text
from gauge_envs.runs.result import Outcome

__all__ = ["overview_page", "place_text"]

SCALE_NOTE = (
    "Score: distance to the real mean over the mean distance of single real trials. 1 is as far as a real trial is on "
    "average; lower is closer. In brackets: 95 % interval, from the sample of real trials, the uncertain inputs and the "
    "discretization."
)

RANK_NOTE = (
    "Rank: 1 + number of engines with a distinguishably lower score. Engines of the same rank are not distinguishable "
    "from the best of it, or not from each other through another. Two engines are distinguishable if the 95 % interval of "
    "their paired difference excludes zero."
)


def overview_page(site: Site) -> str:
    """Return the first page of a site."""
    comparison = site.comparison
    count = len(comparison.experiments)
    lead = (
        f"{count} experiment{'' if count == 1 else 's'} of the GAUGE benchmark, "
        f"{len(comparison.configurations)} configuration{'' if len(comparison.configurations) == 1 else 's'} of "
        f"{len(site.engines)} engine{'' if len(site.engines) == 1 else 's'}, scored against real motion capture."
    )
    graded = [grade for grade in comparison.grades if grade.ids]
    parts = [
        element("p", lead, class_="lead"),
        _answers(site, graded),
        element("div", *(_grade_forest(site, grade) for grade in graded), class_="forest"),
        element("p", SCALE_NOTE, class_="small"),
        _matrix(site),
        _events(site),
        _unscored(site),
        _engines(site),
        *(element("p", f"Note: {note}.", class_="note") for note in comparison.notes),
    ]
    return page("How far is each engine from reality?", parts, here="index.html")


def _grade_title(grade: GradeComparison) -> str:
    return {"trials": "real trials", "recording": "one recorded trial", "law": "a law"}.get(grade.grade, grade.grade) + (
        ", withheld band" if grade.withheld else ""
    )


def _counted(ids: Sequence[str]) -> str:
    return f"{len(ids)} experiment{'' if len(ids) == 1 else 's'}"


# --- the answer ---


def _answers(site: Site, graded: Sequence[GradeComparison]) -> Html:
    """Return a sentence for each grade: the lowest mean score, what is not distinguishable from it, and what is."""
    if not graded:
        return element("div", element("p", "No experiment has a score in all configurations."), class_="answer")
    return element("div", *(element("p", _answer(site, grade)) for grade in graded), class_="answer")


def _answer(site: Site, grade: GradeComparison) -> Html:
    ranked = sorted(
        (one for one in grade.scores if one.mean is not None), key=lambda one: one.mean.value if one.mean else 0.0
    )
    best = ranked[0]
    assert best.mean is not None
    apart = {
        pair.second if pair.first == best.configuration else pair.first
        for pair in grade.pairs
        if best.configuration in (pair.first, pair.second) and pair.distinguishable
    }
    same = [site.labels[one.configuration] for one in ranked[1:] if one.configuration not in apart]
    further = [
        f"{site.labels[one.configuration]} {score_text(one.mean.value)}"
        for one in ranked[1:]
        if one.configuration in apart and one.mean is not None
    ]
    low, high = best.mean.interval_95
    sentences = [f" {score_text(best.mean.value)} [{score_text(low)}, {score_text(high)}]."]
    if same:
        sentences.append(f" Not distinguishable from it: {', '.join(same)}.")
    if further:
        sentences.append(f" Distinguishably further: {', '.join(further)}.")
    start = f"Against {_grade_title(grade)} ({_counted(grade.ids)}): lowest mean score "
    return join([element("b", start), site.configuration_link(best.configuration), *sentences])


def _grade_forest(site: Site, grade: GradeComparison) -> Html:
    rows = [
        ForestRow(
            label=site.labels[one.configuration],
            color=site.color(one.configuration),
            value=one.mean.value,
            interval=one.mean.interval_95,
        )
        for one in sorted(grade.scores, key=lambda one: one.mean.value if one.mean else 0.0)
        if one.mean is not None
    ]
    names = ", ".join(name.removeprefix("GAUGE/") for name in grade.ids[:4])
    more = f" and {len(grade.ids) - 4} more" if len(grade.ids) > 4 else ""
    note = f"Mean score over {_counted(grade.ids)}: {names}{more}. {GRADE_NOTES[BandGrade(grade.grade)].capitalize()}."
    return forest(f"Against {_grade_title(grade)}", rows, (note,))


# --- engine x phenomenon ---


def _phenomena(site: Site) -> Iterator[tuple[str, str, GradeComparison, list[ExperimentComparison]]]:
    """Yield title, what is tested, comparison and experiments of each phenomenon and grade that has a score."""
    groups: dict[tuple[str, str, str, bool], list[ExperimentComparison]] = {}
    for one in site.comparison.experiments:
        groups.setdefault((*site.family(one), one.grade, one.withheld), []).append(one)
    for (title, tests, grade, withheld), members in groups.items():
        experiments = [
            GradedExperiment(
                id=one.id, draws=tuple(None if cell is None else cell.draws for cell in one.cells), published={}
            )
            for one in members
        ]
        if any(draws is not None for one in experiments for draws in one.draws):
            yield title, tests, compare_grade(grade, withheld=withheld, experiments=experiments), members


def _matrix(site: Site) -> Html:
    rows = []
    for title, tests, grade, members in _phenomena(site):
        links = join((element("a", _variant(one), href=site.experiment_page(one)) for one in members), " \u00b7 ")
        heading = [element("b", title), element("span", tests, class_="quiet block")]
        heading.append(element("span", f"{_grade_title(grade)}: ", links, class_="quiet block"))
        scores = {one.configuration: one for one in grade.scores}
        shared = sum(one.rank == 1 for one in grade.scores)
        cells = [_matrix_cell(site, index, scores.get(index), grade, members, shared) for index in range(len(site.labels))]
        rows.append([join(heading), *cells])
    if not rows:
        return Html("")
    titles: list[str | Html] = ["phenomenon", *(site.configuration_link(index) for index in range(len(site.labels)))]
    head = element("tr", *(element("th", title) for title in titles))
    body = join(_matrix_row(cells) for cells in rows)
    matrix = element("table", element("thead", head), element("tbody", body), class_="matrix")
    key = element("ul", *(element("li", badge(standing)) for standing in Standing), class_="key")
    return join(
        [
            element("h2", "Engine by phenomenon"),
            key,
            element("div", matrix, class_="scroll", tabindex="0", role="region", aria_label="Engine by phenomenon"),
            element("p", RANK_NOTE, class_="small"),
        ]
    )


def _matrix_row(cells: Sequence[Html | tuple[Html, str]]) -> Html:
    heading, *others = cells
    assert isinstance(heading, Html)
    tds = [element("td", cell[0], class_=cell[1] or None) if isinstance(cell, tuple) else cell for cell in others]
    return element("tr", element("th", heading, scope="row"), *tds)


def _variant(one: ExperimentComparison) -> str:
    return one.name.partition("-")[2] or one.name


def _matrix_cell(
    site: Site,
    index: int,
    score: GradeScore | None,
    grade: GradeComparison,
    members: Sequence[ExperimentComparison],
    shared: int,
) -> tuple[Html, str]:
    """Return the content of a cell and its class."""
    results = [result for one in members if (cell := one.cells[index]) is not None for result in cell.results]
    lost = [
        element("span", f"{count} {outcome.value}", class_="quiet block")
        for outcome in (Outcome.DIVERGED, Outcome.FAILED, Outcome.DECLINED)
        if (count := sum(result.outcome is outcome for result in results))
    ]
    if score is None or score.mean is None:
        return join([element("span", "no score" if results else "not run", class_="quiet"), *lost]), ""
    parts = [whisker_text(score.mean.value, score.mean.interval_95)]
    parts.append(element("span", place_text(score.rank, shared, len(grade.scores)), class_="quiet block"))
    if len(grade.ids) < len(members):
        parts.append(element("span", f"over {len(grade.ids)} of {len(members)} experiments", class_="quiet block"))
    return join([*parts, *lost]), standing_of(score.mean.interval_95).value


def place_text(rank: int | None, shared: int, count: int) -> str:
    """Return a rank in words.

    Args:
        rank: The rank, or None.
        shared: Number of configurations with rank 1.
        count: Number of configurations with a score.
    """
    if rank is None or count < 2:
        return ""
    if rank == 1:
        return "not distinguishable" if shared == count else "rank 1" if shared == 1 else f"rank 1 of {count}, shared"
    return f"rank {rank} of {count}"


# --- the rest ---


def _events(site: Site) -> Html:
    rows: list[list[str | Html]] = []
    for one in site.comparison.experiments:
        for name in one.metrics():
            metric = COMPARED_METRICS[name]
            if not metric.is_event or not any(cell and cell.spread(metric, normalized=False) for cell in one.cells):
                continue
            ideal = "0 is ideal" if name == "el" else "1 is the real value"
            heading = [site.experiment_link(one), element("span", f"{TITLES[name]}, {ideal}", class_="quiet block")]
            rows.append([join(heading), *(score_cell(one, cell, name) for cell in one.cells)])
    if not rows:
        return Html("")
    titles = ["event", *(site.configuration_link(index) for index in range(len(site.labels)))]
    note = "Metrics of events over the real value. LSD: longest rest of the last ball of the cradle. MTE: momentum that "
    note += "the cradle hands on. PD: period of the pendulum. EL: energy loss of the pendulum."
    return join([element("h2", "Events"), table(titles, rows, kind="matrix"), element("p", note, class_="small")])


def _unscored(site: Site) -> Html:
    """Return the experiments without a reference: the largest distance between two configurations."""
    rows: list[list[str | Html]] = []
    for one in site.comparison.experiments:
        if one.grade != BandGrade.NONE.value:
            continue
        far = max(one.distances, key=lambda distance: distance.rms.mean, default=None)
        if far is None:
            rows.append([site.experiment_link(one), "one configuration: nothing to compare", "", ""])
            continue
        between = f"{site.labels[far.first]} and {site.labels[far.second]}"
        apart = f"{quantity_text(far.rms.mean)} {far.unit}"
        rows.append([site.experiment_link(one), between, apart, f"{quantity_text(far.motion_rms)} {far.unit}"])
    if not rows:
        return Html("")
    note = "No real reference is published, so nothing says which engine is right. Distance and motion: root mean square "
    note += "over the frames; the motion is the displacement from the start."
    titles = ("experiment", "furthest apart", "distance", "motion")
    return join(
        [
            element("h2", "Without a reference: how far engines are apart"),
            table(titles, rows, number_from=2),
            element("p", note, class_="small"),
        ]
    )


def _engines(site: Site) -> Html:
    summaries = site.comparison.summaries()
    rows = [
        [
            site.configuration_link(index),
            " ".join(f"{name} {text}" for name, text in one.engine_versions.items()) or "-",
            str(summary.ran),
            str(summary.scored),
            str(summary.diverged),
            str(summary.not_run),
            "-" if summary.wall_s_per_sim_s_common is None else f"{summary.wall_s_per_sim_s_common:.2g}",
        ]
        for index, (one, summary) in enumerate(zip(site.comparison.configurations, summaries, strict=True))
    ]
    titles = ("engine", "versions", "ran", "scored", "diverged", "not run", "wall s/sim s")
    note = (
        f"Wall s/sim s: wall time over simulated time, over the {len(site.comparison.run_by_all)} experiments that all "
        "ran. It compares engines on one machine alone."
    )
    return join(
        [element("h2", "Engines"), table(titles, rows, number_from=2), element("p", note, class_="small")]
    )
