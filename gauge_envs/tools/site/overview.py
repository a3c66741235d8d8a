"""The first page: which engine is how far from reality, in what, and with what certainty."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gauge_envs.pages.html import Html, element, join, page, table
from gauge_envs.pages.svg import ForestRow, forest
from gauge_envs.pages.text import GRADE_NOTES, quantity_text, score_text
from gauge_envs.references.bands import BandGrade
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.compare.comparison import ExperimentComparison
from gauge_envs.tools.compare.grades import GradeComparison, GradeScore, PairComparison, compare_grade
from gauge_envs.tools.compare.scores import COMPARED_METRICS
from gauge_envs.tools.site.model import TITLES, Site, Standing, badge, score_cell, standing_of, whisker_text

SCALE_NOTE = (
    "Score: distance to the real mean over the published mean distance of single real trials, which is 1. Lower is "
    "closer. In brackets: 95 % interval, from the sample of real trials, the uncertain inputs and the discretization."
)

ALIGNED_NOTE = (
    "RMSE aligned: after the best constant shift in time, because a real release is not at an exact time. The 1 is of "
    "trials that are not aligned. So an aligned score below 1 does not mean closer than the real trials; the page of "
    "the experiment states the share of real trials that are closer."
)

RANK_NOTE = (
    "Rank: 1 + number of engines with a distinguishably lower score. Two engines are distinguishable if the 95 % "
    "interval of their paired difference excludes zero. The intervals in the cells overlap more: engines "
    "share errors, which cancel in a difference. Not distinguishable: no engine of the row is distinguishably lower "
    "than another."
)


def overview_page(site: Site) -> str:
    """Return the first page of a site."""
    comparison = site.comparison
    graded = [grade for grade in comparison.grades if grade.ids]
    against = ", ".join(f"{len(grade.ids)} against {_grade_title(grade)}" for grade in graded)
    lead = (
        f"{_number(len(comparison.experiments), 'experiment')}, "
        f"{_number(len(comparison.configurations), 'configuration')} of {_number(len(site.engines), 'engine')}. "
        f"Scored in all configurations: {against or 'none'}."
    )
    parts = [
        element("p", lead, class_="lead"),
        _answers(site, graded),
        element("div", *(_grade_forest(site, grade) for grade in graded), class_="forest"),
        element("p", SCALE_NOTE, class_="small"),
        _matrix(site),
        _unscaled(site),
        _events(site),
        _unscored(site),
        _engines(site),
        *(element("p", f"Note: {note}.", class_="note") for note in comparison.notes),
    ]
    return page("How far is each engine from reality?", parts, here="index.html")


def _grade_title(grade: GradeComparison) -> str:
    return {"trials": "real trials", "recording": "one recorded trial", "law": "a law"}.get(
        grade.grade, grade.grade
    ) + (", withheld band" if grade.withheld else "")


def _number(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _counted(ids: Sequence[str]) -> str:
    return _number(len(ids), "experiment")


# --- the answer ---


def _answers(site: Site, graded: Sequence[GradeComparison]) -> Html:
    """Return a sentence for each grade: the lowest mean score, what is not distinguishable from it, and what is."""
    if not graded:
        return element("div", element("p", "No experiment has a score in all configurations."), class_="answer")
    return element("div", *(element("p", _answer(site, grade)) for grade in graded), class_="answer")


def _answer(site: Site, grade: GradeComparison) -> Html:
    means = _means(site, grade)
    (best, value, (low, high)), *others = means
    apart = {
        pair.second if pair.first == best else pair.first: _away(pair, best)
        for pair in _common_pairs(site, grade)
        if best in (pair.first, pair.second) and pair.distinguishable
    }
    same = [site.labels[index] for index, _, _ in others if index not in apart]
    further = [
        f"{site.labels[index]} {score_text(mean)} ({apart[index]})" for index, mean, _ in others if index in apart
    ]
    sentences: list[str | Html] = [
        f" {score_text(value)} [{score_text(low)}, {score_text(high)}] ",
        badge(standing_of((low, high))),
        ".",
    ]
    if same:
        sentences.append(f" Not distinguishable from it: {', '.join(same)}.")
    if further:
        sentences.append(f" Distinguishably further: {'; '.join(further)}.")
    start = f"Against {_grade_title(grade)} ({_counted(grade.ids)}): lowest mean score "
    return join([element("b", start), site.configuration_link(best), *sentences])


def _common_pairs(site: Site, grade: GradeComparison) -> Sequence[PairComparison]:
    """Return the pairs of a grade over the experiments that all have scored; a pair may have more in common."""
    if all(pair.ids == grade.ids for pair in grade.pairs):
        return grade.pairs
    common = [one.graded() for one in site.comparison.experiments if one.id in grade.ids]
    return compare_grade(grade.grade, withheld=grade.withheld, experiments=common).pairs


def _away(pair: PairComparison, best: int) -> str:
    """Return how much further the other configuration of a pair is, with the interval of the paired difference."""
    sign = -1.0 if pair.first == best else 1.0
    low, high = sorted(sign * end for end in pair.difference_95)
    return f"by {score_text(sign * pair.difference)} [{score_text(low)}, {score_text(high)}]"


def _means(site: Site, grade: GradeComparison) -> list[tuple[int, float, tuple[float, float]]]:
    """Return configuration, mean and interval of each score, lowest first."""
    means = [(one.configuration, one.mean.value, one.mean.interval_95) for one in grade.scores if one.mean is not None]
    return sorted(means, key=lambda entry: entry[1])


def _grade_forest(site: Site, grade: GradeComparison) -> Html:
    rows = [
        ForestRow(label=site.labels[index], color=site.color(index), value=value, interval=interval)
        for index, value, interval in _means(site, grade)
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
        experiments = [one.graded() for one in members]
        if any(draws is not None for one in experiments for draws in one.draws):
            yield title, tests, compare_grade(grade, withheld=withheld, experiments=experiments), members


def _matrix(site: Site) -> Html:
    rows = []
    for title, tests, grade, members in _phenomena(site):
        links = join((element("a", _variant(one), href=site.experiment_page(one)) for one in members), " \u00b7 ")
        heading = [element("b", title), element("span", tests, class_="quiet block")]
        metric = ", ".join(dict.fromkeys(TITLES[one.primary] for one in members))
        heading.append(element("span", f"{metric}, {_grade_title(grade)}: ", links, class_="quiet block"))
        scores = {one.configuration: one for one in grade.scores}
        shared = sum(one.rank == 1 for one in grade.scores)
        cells = (
            _matrix_cell(site, index, scores.get(index), grade, members, shared) for index in range(len(site.labels))
        )
        rows.append(element("tr", element("th", join(heading), scope="row"), *cells))
    if not rows:
        return Html("")
    titles: list[str | Html] = ["phenomenon", *(site.configuration_link(index) for index in range(len(site.labels)))]
    head = element("tr", *(element("th", title) for title in titles))
    matrix = element("table", element("thead", head), element("tbody", *rows), class_="matrix")
    key = element("ul", *(element("li", badge(standing)) for standing in Standing), class_="key")
    return join(
        [
            element("h2", "Engine by phenomenon"),
            key,
            element("div", matrix, class_="scroll", tabindex="0", role="region", aria_label="Engine by phenomenon"),
            element("p", RANK_NOTE, class_="small"),
            element("p", ALIGNED_NOTE, class_="small"),
        ]
    )


def _variant(one: ExperimentComparison) -> str:
    return one.name.partition("-")[2] or one.name


def _matrix_cell(
    site: Site,
    index: int,
    score: GradeScore | None,
    grade: GradeComparison,
    members: Sequence[ExperimentComparison],
    shared: int,
) -> Html:
    """Return a cell, coloured by how its interval lies to 1."""
    results = [result for one in members if (cell := one.cells[index]) is not None for result in cell.results]
    lost = [
        element("span", f"{count} {outcome.value}", class_="quiet block")
        for outcome in (Outcome.DIVERGED, Outcome.FAILED, Outcome.DECLINED)
        if (count := sum(result.outcome is outcome for result in results))
    ]
    if score is None or score.mean is None:
        return element("td", element("span", "no score" if results else "not run", class_="quiet"), *lost)
    parts = [whisker_text(score.mean.value, score.mean.interval_95)]
    parts.append(element("span", place_text(score.rank, shared, len(grade.scores)), class_="quiet block"))
    if len(grade.ids) < len(members):
        parts.append(element("span", f"over {len(grade.ids)} of {len(members)} experiments", class_="quiet block"))
    return element("td", *parts, *lost, class_=standing_of(score.mean.interval_95).value)


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
    note = (
        "Metrics of events over the real value. LSD: longest rest of the last ball of the cradle. MTE: momentum that "
    )
    note += "the cradle hands on. PD: period of the pendulum. EL: energy loss of the pendulum."
    return join([element("h2", "Events"), table(titles, rows, kind="matrix"), element("p", note, class_="small")])


def _unscaled(site: Site) -> Html:
    """Return the experiments with a reference and no published scatter that covers it: their RMSE in its unit."""
    metric = COMPARED_METRICS["rmse"]
    rows: list[list[str | Html]] = []
    for one in site.comparison.experiments:
        cells = [cell for cell in one.cells if cell is not None and cell.spread(metric, normalized=False) is not None]
        if not cells or any(cell.draws is not None or cell.spread(metric, normalized=True) for cell in cells):
            continue
        heading = [site.experiment_link(one), element("span", f"RMSE, {one.grade}", class_="quiet block")]
        rows.append([join(heading), *(score_cell(one, cell, "rmse") for cell in one.cells)])
    if not rows:
        return Html("")
    titles = ["experiment", *(site.configuration_link(index) for index in range(len(site.labels)))]
    note = (
        "These references hold for a part of the motion, for which no scatter of real trials is published. So there is "
    )
    note += "no 1 to compare with and no interval."
    head = element("h2", "Distance to a part of the motion")
    return join([head, table(titles, rows, kind="matrix"), element("p", note, class_="small")])


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
    note = (
        "No real reference is published, so nothing says which engine is right. Distance and motion: root mean square "
    )
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
    common = _number(len(site.comparison.run_by_all), "experiment")
    note = (
        f"Wall s/sim s: wall time over simulated time, over {common} that all ran. It compares engines on one machine."
    )
    return join([element("h2", "Engines"), table(titles, rows, number_from=2), element("p", note, class_="small")])
