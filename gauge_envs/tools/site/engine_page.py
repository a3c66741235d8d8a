"""The page of one engine: all its scores, its settings and versions, and its convergence."""

from __future__ import annotations

import json

from gauge_envs.pages.document import Heading, Part
from gauge_envs.pages.html import Html, element, folded, join, listed
from gauge_envs.pages.results import discretization_text
from gauge_envs.pages.table import Table, grid
from gauge_envs.pages.text import COST_TITLE, shortened
from gauge_envs.tools.compare import mean_rank_text
from gauge_envs.tools.site.model import Site, first_result, score_cell, site_page


def engine_page(site: Site, name: str) -> str:
    """Return the page of an engine.

    Args:
        site: The site.
        name: Name of the engine, or `file` for trajectory files.
    """
    parts: list[Part] = []
    for index in site.engines[name]:
        parts += [*_means(site, index), _scores(site, index), *_settings(site, index), *_reasons(site, index)]
    return site_page(f"Engine: {name}", parts, here=site.engine_page(name))


def _means(site: Site, index: int) -> list[Html]:
    one, summary = site.comparison.configurations[index], site.comparison.summaries()[index]
    versions = ", ".join(f"{package} {text}" for package, text in one.engine_versions.items()) or "not stated"
    counts = f"{summary.ran} experiments ran, {summary.scored} have a score, {summary.diverged} diverged, "
    counts += f"{summary.not_run} did not run."
    heading = element("h2", site.swatch(index), site.labels[index])
    ranks = [
        f"{grade.name}: {mean_rank_text(score.mean_rank)} of {len(grade.scores)}"
        for grade in site.comparison.grades
        for score in grade.scores
        if score.configuration == index and score.mean_rank is not None and len(grade.scores) > 1
    ]
    places = [element("p", f"Mean rank: {'; '.join(ranks)}.")] if ranks else []
    return [heading, element("p", f"Versions: {versions}. {counts}"), *places]


def _scores(site: Site, index: int) -> Table:
    rows = []
    for one in site.comparison.experiments:
        cell = one.cells[index]
        if cell is not None:
            result, cost = first_result(cell), cell.wall_s_per_sim_s
            convergence = None if result is None else discretization_text(result)
            name, score = site.experiment_link(one, site.family(one)[0]), score_cell(one, cell, one.primary)
            rows.append((name, one.grade_name, score, "-" if cost is None else f"{cost:.2g}", convergence or "-"))
    return grid(("experiment", "grade", "score [95 %]", COST_TITLE, "discretization"), rows)


def _settings(site: Site, index: int) -> list[Part]:
    groups: dict[str, list[str]] = {}
    for one in site.comparison.experiments:
        result = first_result(one.cells[index])
        if result is not None:
            text = "\n".join(f"{key} = {json.dumps(value)}" for key, value in result.settings.items())
            groups.setdefault(text, []).append(one.name)
    blocks = (
        folded(shortened(names), element("pre", element("code", text or "none stated")))
        for text, names in groups.items()
    )
    return [Heading("Settings in force", 3), *blocks] if groups else []


def _reasons(site: Site, index: int) -> list[Part]:
    reasons: dict[tuple[str, str], list[str]] = {}
    for one in site.comparison.experiments:
        cell = one.cells[index]
        for result in cell.results if cell else ():
            if reason := result.error or result.diverged_reason:
                reasons.setdefault((result.outcome.value, reason.replace(f"{one.id}: ", "")), []).append(one.name)
    entries = [
        join([element("b", outcome), f": {shortened(names)}: {reason}"]) for (outcome, reason), names in reasons.items()
    ]
    return [Heading("Did not finish", 3), listed(entries)] if entries else []
