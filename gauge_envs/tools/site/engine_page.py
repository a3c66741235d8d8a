"""The page of one engine: all its scores, its settings and versions, and its convergence."""

from __future__ import annotations

import json

from gauge_envs.pages.html import Html, element, join, page, table
from gauge_envs.pages.results import discretization_text
from gauge_envs.pages.svg import ForestRow, forest
from gauge_envs.pages.text import shortened
from gauge_envs.tools.site.model import Site, first_result, score_cell


def engine_page(site: Site, name: str) -> str:
    """Return the page of an engine.

    Args:
        site: The site.
        name: Name of the engine, or `file` for trajectory files.
    """
    parts: list[Html] = []
    for index in site.engines[name]:
        parts += [_means(site, index), _scores(site, index), _settings(site, index), _reasons(site, index)]
    return page(f"Engine: {name}", parts, here=site.engine_page(name))


def _means(site: Site, index: int) -> Html:
    one, summary = site.comparison.configurations[index], site.comparison.summaries()[index]
    versions = ", ".join(f"{package} {text}" for package, text in one.engine_versions.items()) or "not stated"
    counts = f"{summary.ran} experiments ran, {summary.scored} have a score, {summary.diverged} diverged, "
    counts += f"{summary.not_run} did not run."
    rows = [
        ForestRow(
            label=f"{grade.name}, {len(grade.ids)} exp.",
            color=site.color(index),
            value=score.mean.value,
            interval=score.mean.interval_95,
        )
        for grade in site.comparison.grades
        for score in grade.scores
        if score.configuration == index and score.mean is not None
    ]
    figure = element("div", forest("Mean score of each grade", rows), class_="forest") if rows else Html("")
    heading = element("h2", site.swatch(index), site.labels[index])
    return join([heading, element("p", f"Versions: {versions}. {counts}"), figure])


def _scores(site: Site, index: int) -> Html:
    rows: list[list[str | Html]] = []
    for one in site.comparison.experiments:
        cell = one.cells[index]
        if cell is None:
            continue
        result = first_result(cell)
        convergence = None if result is None else discretization_text(result)
        cost = cell.wall_s_per_sim_s
        rows.append(
            [
                join([site.experiment_link(one), element("span", site.family(one)[0], class_="quiet block")]),
                f"{one.grade}, withheld" if one.withheld else one.grade,
                score_cell(one, cell, one.primary),
                "-" if cost is None else f"{cost:.2g}",
                convergence or "-",
            ]
        )
    titles = ("experiment", "grade", "score [95 %]", "wall s/sim s", "discretization")
    return table(titles, rows)


def _settings(site: Site, index: int) -> Html:
    groups: dict[str, list[str]] = {}
    for one in site.comparison.experiments:
        result = first_result(one.cells[index])
        if result is not None:
            text = "\n".join(f"{key} = {json.dumps(value)}" for key, value in result.settings.items())
            groups.setdefault(text, []).append(one.name)
    if not groups:
        return Html("")
    blocks = (
        element("details", element("summary", shortened(names)), element("pre", element("code", text or "none stated")))
        for text, names in groups.items()
    )
    return join([element("h3", "Settings in force"), *blocks])


def _reasons(site: Site, index: int) -> Html:
    reasons: dict[tuple[str, str], list[str]] = {}
    for one in site.comparison.experiments:
        cell = one.cells[index]
        for result in () if cell is None else cell.results:
            reason = result.error or result.diverged_reason
            if reason:
                reasons.setdefault((result.outcome.value, reason.replace(f"{one.id}: ", "")), []).append(one.name)
    if not reasons:
        return Html("")
    entries = (
        element("li", element("b", outcome), f": {shortened(names)}: {reason}")
        for (outcome, reason), names in reasons.items()
    )
    return join([element("h3", "Did not finish"), element("ul", *entries)])
