"""The page of one experiment: curves over reality, scores, pairs, replay, error budgets, convergence, origin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gauge_envs.errors import GaugeError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.experiments.experiment import Experiment, TaskExperiment
from gauge_envs.pages.html import Html, element, join, page, table
from gauge_envs.pages.results import discretization_text
from gauge_envs.pages.svg import ForestRow, forest
from gauge_envs.pages.text import ENGINE_TITLES, GRADE_NOTES, quantity_text, score_text
from gauge_envs.references.bands import Band, BandGrade
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.tools.compare.comparison import Cell, ExperimentComparison
from gauge_envs.tools.compare.grades import compare_grade
from gauge_envs.tools.compare.scores import COMPARED_METRICS
from gauge_envs.tools.diagnose.budget_fit import BudgetStage
from gauge_envs.tools.diagnose.diagnosis import Diagnosis
from gauge_envs.tools.diagnose.error_budget import diagnose
from gauge_envs.tools.diagnose.words import findings
from gauge_envs.tools.site.curves import curve_section
from gauge_envs.tools.site.model import TITLES, Site, first_result, score_cell
from gauge_envs.tools.site.overview import place_text
from gauge_envs.tools.site.reproduce import run_commands

REPLAY_SCRIPTS = ("assets/three.min.js", "assets/replay.js")

STAGE_COLORS: Mapping[BudgetStage | None, str] = {
    BudgetStage.RELEASE: "#56b4e9",
    BudgetStage.OFFSET: "#009e73",
    BudgetStage.RATE: "#e69f00",
    None: "#8c8c8c",
}
"""Colour of each stage of an error budget; None is the rest."""


def experiment_page(site: Site, one: ExperimentComparison, replay: Html | None, replay_notes: Sequence[str]) -> str:
    """Return the page of an experiment.

    Args:
        site: The site.
        one: The experiment.
        replay: Element of the replay, or None.
        replay_notes: Why configurations have no replay, a sentence each.
    """
    results = {index: result for index, cell in enumerate(one.cells) if (result := first_result(cell)) is not None}
    experiment = _experiment(results)
    withheld = any(result.score.withheld is not None for result in results.values())
    band = None if experiment is None else reference_band(experiment, use_withheld=withheld)
    sections = [
        _head(one, experiment, band),
        _forest(site, one),
        _scores(site, one),
        _replay(replay, replay_notes),
        curve_section(site, one, band),
        _pairs(site, one),
        _distances(site, one),
        _error_budgets(site, results),
        _convergence(site, results),
        _uncertainty(site, results),
        _implied(site, results),
        _not_run(site, one),
        element("h2", "How to reproduce"),
        run_commands(site, [(index, cell.results) for index, cell in enumerate(one.cells) if cell is not None]),
    ]
    return page(one.name, sections, here=site.experiment_page(one), scripts=REPLAY_SCRIPTS if replay else ())


def _experiment(results: Mapping[int, Result]) -> Experiment | None:
    for result in results.values():
        try:
            return recorded_experiment(result)
        except GaugeError:
            continue
    return None


def _head(one: ExperimentComparison, experiment: Experiment | None, band: Band | None) -> Html:
    lines = []
    if isinstance(experiment, TaskExperiment):
        lines.append(element("p", experiment.spec.summary, class_="lead"))
        lines.append(element("p", element("b", "Tests: "), ", ".join(experiment.spec.evaluates), "."))
    grade = BandGrade(one.grade)
    text = f"{GRADE_NOTES[grade]}."
    source = "" if band is None else f" {band.source.rstrip('.')}."
    lines.append(element("p", element("b", f"Reference, grade {one.grade}: "), text, source))
    if band is not None and band.withheld is not None:
        lines.append(element("p", f"This band is withheld by default: {band.withheld}.", class_="note"))
    return join(lines)


def _forest(site: Site, one: ExperimentComparison) -> Html:
    """Return the primary score of each configuration with its interval, and those of the published engines."""
    metric = COMPARED_METRICS[one.primary]
    rows = [
        ForestRow(
            label=site.labels[index], color=site.color(index), value=spread.mean, interval=cell.interval_95(metric)
        )
        for index, cell in enumerate(one.cells)
        if cell is not None and (spread := cell.spread(metric, normalized=True)) is not None
    ]
    if not rows:
        return Html("")
    rows.sort(key=lambda row: row.value)
    published = one.published(one.primary) or {}
    rows += [
        ForestRow(label=f"{ENGINE_TITLES.get(name, name)}, paper", color="var(--quiet)", value=value, interval=None)
        for name, value in published.items()
        if value is not None
    ]
    figure = forest(f"{TITLES[one.primary]} over that of real trials", rows)
    return element("div", figure, _place(site, one), class_="forest")


def _place(site: Site, one: ExperimentComparison) -> Html:
    """Return the ranks within this experiment in words."""
    grade = compare_grade(one.grade, withheld=one.withheld, experiments=[one.graded()])
    shared = sum(score.rank == 1 for score in grade.scores)
    if len(grade.scores) < 2:
        return Html("")
    ranked = sorted(grade.scores, key=lambda score: (score.rank or 0, score.mean.value if score.mean else 0.0))
    entries = (
        element("li", site.configuration_link(score.configuration), f": {place_text(score.rank, shared, len(ranked))}")
        for score in ranked
    )
    return element("ul", *entries)


def _scores(site: Site, one: ExperimentComparison) -> Html:
    names = one.metrics()
    if not names:
        return Html("")
    primary = COMPARED_METRICS[one.primary]
    percentiles = [None if cell is None else cell.percentile(primary) for cell in one.cells]
    has_trials = any(percentile is not None for percentile in percentiles)
    rows: list[list[str | Html]] = []
    for index, (cell, percentile) in enumerate(zip(one.cells, percentiles, strict=True)):
        rows.append([site.configuration_link(index), *(score_cell(one, cell, name) for name in names)])
        if has_trials:
            rows[-1].append("-" if percentile is None else f"{percentile:.0f} %")
    for engine, title in ENGINE_TITLES.items():
        values = [(one.published(name) or {}).get(engine) for name in names]
        if any(value is not None for value in values):
            texts = ("-" if value is None else score_text(value) for value in values)
            rows.append([f"{title}, paper", *texts, *([""] if has_trials else [])])
    titles = ["", *(TITLES[name] for name in names)]
    note = "Scores over the mean score of the real trials; without one, in the unit of the metric. In brackets: 95 % "
    note += "interval."
    if has_trials:
        titles.append("real trials closer")
        note += " Real trials closer: share of the real trials that are closer to their mean."
    return join([element("h2", "Scores"), table(titles, rows), element("p", note, class_="small")])


def _replay(replay: Html | None, notes: Sequence[str]) -> Html:
    if replay is None and not notes:
        return Html("")
    parts = [element("h2", "3D replay")]
    if replay is not None:
        parts.append(replay)
    parts += [element("p", note, class_="note") for note in notes]
    return join(parts)


def _pairs(site: Site, one: ExperimentComparison) -> Html:
    rows: list[list[str | Html]] = []
    for grade in site.comparison.grades:
        for pair in grade.pairs:
            for difference in pair.experiments:
                if difference.id != one.id:
                    continue
                low, high = difference.difference_95
                rows.append(
                    [
                        join([site.swatch(pair.first), site.labels[pair.first]]),
                        join([site.swatch(pair.second), site.labels[pair.second]]),
                        f"{score_text(difference.difference)} [{score_text(low)}, {score_text(high)}]",
                        "distinguishable" if difference.distinguishable else "not distinguishable",
                    ]
                )
    if not rows:
        return Html("")
    apart = sum(row[-1] == "distinguishable" for row in rows)
    pairs = table(("first", "second", "difference [95 %]", "at 95 %"), rows)
    return join(
        [
            element("h2", "Pairs"),
            element("p", "Difference of the scores, first minus second, by paired bootstrap.", class_="small"),
            element("details", element("summary", f"{apart} of {len(rows)} pairs are distinguishable at 95 %"), pairs),
        ]
    )


def _distances(site: Site, one: ExperimentComparison) -> Html:
    if one.grade != BandGrade.NONE.value or not one.distances:
        return Html("")
    rows: list[list[str | Html]] = [
        [
            f"{site.labels[far.first]} : {site.labels[far.second]}",
            f"{quantity_text(far.rms.mean)} {far.unit}",
            f"{quantity_text(far.motion_rms)} {far.unit}",
            "never" if far.apart_at_s is None else f"{far.apart_at_s:.2f} s",
        ]
        for far in one.distances
    ]
    note = "Root mean square over the frames. Apart: first time at which the distance exceeds "
    note += ", ".join(sorted({f"{quantity_text(far.threshold)} {far.unit}" for far in one.distances})) + "."
    titles = ("between", "distance", "motion", "apart at")
    head = element("h2", "Distances between engines")
    return join([head, table(titles, rows, number_from=1), element("p", note, class_="small")])


def _error_budgets(site: Site, results: Mapping[int, Result]) -> Html:
    budgets: list[Html] = []
    for index, result in results.items():
        try:
            diagnosis = diagnose(result)
        except GaugeError:
            # Without a reference or to no end: the page states both elsewhere.
            continue
        budgets.append(_budget(site, index, diagnosis))
    if not budgets:
        return Html("")
    names = [(stage.value, STAGE_COLORS[stage]) for stage in BudgetStage] + [("rest", STAGE_COLORS[None])]
    key = [
        element("li", element("span", Html(""), class_="swatch area", style=f"background:{color}"), name)
        for name, color in names
    ]
    note = "Share of the squared error that is gone when the start moves in time (release), by a constant (offset), or "
    note += "when the motion has another rate (rate). The rest is none of these."
    return join(
        [
            element("h2", "What the error is"),
            element("p", note, class_="small"),
            element("ul", *key, class_="key"),
            *budgets,
        ]
    )


def _budget(site: Site, index: int, diagnosis: Diagnosis) -> Html:
    shares = [(part.stage.value, STAGE_COLORS[part.stage], part.share) for part in diagnosis.parts]
    shares.append(("rest", STAGE_COLORS[None], diagnosis.rest.share))
    bars = (
        element(
            "span",
            Html(""),
            style=f"width:{100.0 * max(share, 0.0):.2f}%;background:{color}",
            title=f"{name} {share:.1%}",
        )
        for name, color, share in shares
    )
    texts = ", ".join(f"{name} {100.0 * share:.1f} %" for name, _, share in shares)
    entries = (element("li", line) for line in findings(diagnosis))
    return element(
        "details",
        element(
            "summary",
            site.swatch(index),
            element("b", site.labels[index]),
            f": RMSE {quantity_text(diagnosis.rmse)} {diagnosis.unit}; {texts}",
            element("div", *bars, class_="shares", role="img", aria_label=texts),
        ),
        element("ul", *entries),
    )


def _convergence(site: Site, results: Mapping[int, Result]) -> Html:
    rows: list[list[str | Html]] = [
        [site.configuration_link(index), text]
        for index, result in results.items()
        if (text := discretization_text(result)) is not None
    ]
    if not rows:
        return Html("")
    note = (
        "Change of the whole trajectory when the time step or the cell of a mesh is halved, over the scatter of real "
    )
    note += "trials. It was measured once for each engine with its default settings (scoring/convergence)."
    return join(
        [
            element("h2", "Convergence"),
            table(("engine", "half step, half cell"), rows),
            element("p", note, class_="small"),
        ]
    )


def _uncertainty(site: Site, results: Mapping[int, Result]) -> Html:
    parts: list[Html] = []
    for index, result in results.items():
        if not result.score.budget:
            continue
        rows = [
            [
                entry.name,
                entry.evaluation,
                f"{entry.standard_uncertainty:.3f}",
                f"{100.0 * entry.share:.0f} %",
                entry.source,
            ]
            for entry in result.score.budget
        ]
        largest = result.score.budget[0]
        summary = element("summary", site.swatch(index), element("b", site.labels[index]), f": most is {largest.name}")
        titles = ("contribution", "type", "u", "share of the variance", "source")
        parts.append(element("details", summary, table(titles, rows)))
    if not parts:
        return Html("")
    note = (
        "Contributions to the interval of the first score. u: standard uncertainty of the normalized score. Type A is "
    )
    note += "from observations, B from other knowledge (GUM)."
    return join([element("h2", "Uncertainty"), element("p", note, class_="small"), *parts])


def _implied(site: Site, results: Mapping[int, Result]) -> Html:
    rows: list[list[str | Html]] = []
    for index, result in results.items():
        for entry in result.score.implied:
            unit = "" if entry.unit == "1" else f" {entry.unit}"
            if entry.real is None:
                real = "-"
            else:
                spread = "" if entry.real_uncertainty is None else f" \u00b1 {entry.real_uncertainty:.2g}"
                real = f"{entry.real:.4g}{spread}{unit}"
            name = entry.parameter.replace("_", " ")
            rows.append([site.configuration_link(index), name, f"{entry.value:.4g}{unit}", real])
    if not rows:
        return Html("")
    return join([element("h2", "Implied parameters"), table(("engine", "parameter", "simulated", "real"), rows)])


def _not_run(site: Site, one: ExperimentComparison) -> Html:
    rows: list[list[str | Html]] = [
        [site.configuration_link(index), result.outcome.value, reason]
        for index, cell in enumerate(one.cells)
        for result in _results(cell)
        if (reason := result.error or result.diverged_reason)
    ]
    return join([element("h2", "Did not finish"), table(("engine", "outcome", "reason"), rows)]) if rows else Html("")


def _results(cell: Cell | None) -> Sequence[Result]:
    return () if cell is None else cell.results
