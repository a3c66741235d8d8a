"""Write the first page: distances of engines from reality or from solutions, by phenomenon, with intervals."""

from collections.abc import Iterator, Sequence

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.pages.document import Heading, Paragraph, Part, Tone
from gauge_envs.pages.html import Html, below, element, join
from gauge_envs.pages.results import SCORE_METRICS
from gauge_envs.pages.table import Table, grid
from gauge_envs.pages.text import counted
from gauge_envs.references.kind import Kind
from gauge_envs.tools.compare import (
    ExperimentComparison,
    KindComparison,
    KindScore,
    mean_rank_text,
)
from gauge_envs.tools.site.model import (
    Site,
    losses,
    page_file,
    score_cell,
    score_html,
    section,
    site_page,
    verdict_of,
)

KIND_TITLES = {
    "trials": "real trials",
    "recording": "one recorded trial",
    "analytic": "a closed form, not reality",
    "numerical": "a numerical solution, not reality",
}

SCALE_NOTE = (
    "Score: distance from the mean of real trials, divided by the mean distance of single real trials. Lower is "
    "closer. In brackets: 95 % interval, from the sample of real trials. RMSE aligned: after the best constant time "
    "shift, for simulations and trials, because the time of a real release is uncertain."
)

SOLUTION_NOTE = (
    "Distance from the solution of the scene, divided by u, its standard uncertainty. In brackets: 95 % interval. It "
    "does not compare with reality."
)

RANK_NOTE = (
    "Rank: mean over the experiments, with equal weights. In brackets: best and worst rank by the 95 % intervals of "
    "differences. Only engines with the same constants are ranked together. Intervals of scores overlap more, because "
    "common errors cancel in a difference."
)

UNRANKED_NOTE = (
    "These scenes have neither real scatter nor a solution, or no result has a score. The page of an experiment has "
    "all metrics and the distances between engines."
)


def overview_page(site: Site) -> str:
    """Return the first page of a site."""
    comparison = site.comparison
    experiments = counted(len(comparison.experiments), "experiment")
    lead = f"{experiments}, {counted(len(site.names), 'configuration')}."
    parts: list[Part] = [
        element("p", lead, class_="lead"),
        *section(
            "Engine by phenomenon",
            grid(["phenomenon", *site.names], _phenomena(site), look="matrix"),
            SCALE_NOTE,
            SOLUTION_NOTE,
        ),
        *section("Mean ranks", _ranks(site), RANK_NOTE),
        *section(
            "Experiments without a rank",
            grid(["experiment", *site.names], _unranked(site), look="matrix"),
            UNRANKED_NOTE,
        ),
        *(Paragraph(f"Note: {note}.", Tone.WARNING) for note in comparison.notes),
        Heading("This site"),
        element("pre", element("code", site.command)),
        element(
            "p",
            "The page of an experiment has the inputs of each result. The 3D replays are drawn by three.js, MIT ",
            element("a", "licence", href="assets/three.LICENSE.txt"),
            ". Real data: GAUGE, arXiv 2608.05948.",
        ),
    ]
    return site_page("How far is each engine off?", parts)


# --- ranks and phenomena ---


def _ranks(site: Site) -> Table:
    """Return the mean rank of each configuration within each kind of reference."""
    rows = []
    for kind in site.comparison.kinds:
        ranks = {
            score.configuration: mean_rank_text(score.mean_rank)
            for score in kind.scores
            if score.mean_rank is not None
        }
        if len(ranks) > 1:
            constants = kind.name.removeprefix(kind.kind)
            title = element("b", f"{KIND_TITLES[kind.kind]}{constants}")
            count = counted(len(kind.ids), "experiment")
            cells = (ranks.get(index, "") for index in range(len(site.names)))
            rows.append([join([title, below(count)]), *cells])
    return grid(["reference", *site.names], rows, look="matrix")


def _phenomena(site: Site) -> Iterator[list[Html]]:
    """Yield a row for the experiments of each phenomenon and kind of reference with a score."""
    groups: dict[tuple[str, str, str], list[ExperimentComparison]] = {}
    for experiment in site.comparison.experiments:
        spec = load_experiment(experiment.name).spec
        key = (experiment.kind, spec.title, ", ".join(spec.evaluates))
        groups.setdefault(key, []).append(experiment)
    for kind in Kind:
        for (name, title, tests), members in groups.items():
            ranks = site.comparison.compare_within(members) if name == kind else ()
            if ranks:
                cells = (
                    _phenomenon_cell(index, members, ranks)
                    for index in range(len(site.names))
                )
                title = f"{title}, {KIND_TITLES[name]}"
                yield [_phenomenon(title, tests, members), *cells]


def _phenomenon(
    title: str, tests: str, members: Sequence[ExperimentComparison]
) -> Html:
    links = (
        element(
            "a",
            member.name.partition("-")[2] or member.name,
            href=page_file(member),
        )
        for member in members
    )
    metrics = dict.fromkeys(SCORE_METRICS[member.primary].title for member in members)
    experiments = below(f"{', '.join(metrics)}: ", join(links, " \u00b7 "))
    return join([element("b", title), below(tests), experiments])


def _phenomenon_cell(
    index: int,
    members: Sequence[ExperimentComparison],
    ranks: Sequence[KindComparison],
) -> Html:
    """Return the score and the rank of a configuration in a phenomenon, and the results without a score."""
    results = (member.cells[index] for member in members)
    cells = [cell for cell in results if cell is not None]
    lost = map(below, losses(*cells))
    scores = ((kind, score) for kind in ranks for score in kind.scores)
    for kind, score in scores:
        if score.configuration != index or score.mean is None:
            continue
        unit = "u" if kind.is_solution else "1"
        color, badge = verdict_of(*cells)
        parts = [
            score_html(score.mean.value, score.mean.interval_95, unit),
            badge,
            below(place_text(kind, score)),
        ]
        if len(kind.ids) < len(members):
            parts.append(below(f"in {counted(len(kind.ids), 'experiment')}"))
        return element("div", *parts, *lost, class_=color)
    text = "no score" if cells else "not run"
    return join([element("span", text, class_="quiet"), *lost])


def place_text(kind: KindComparison, score: KindScore) -> str:
    """Return a mean rank in words; empty for a single configuration."""
    if score.mean_rank is None or len(kind.scores) < 2:
        return ""
    return f"rank {mean_rank_text(score.mean_rank)} of {len(kind.scores)}"


# --- experiments without a rank ---


def _unranked(site: Site) -> Iterator[list[Html]]:
    """Yield a row for each experiment without a rank, with its primary metric."""
    ranked = {name for kind in site.comparison.kinds for name in kind.ids}
    for experiment in site.comparison.experiments:
        if experiment.id not in ranked:
            name = experiment.primary
            note = f"{SCORE_METRICS[name].title}, reference: {experiment.kind}"
            link = element("a", experiment.name, href=page_file(experiment))
            cells = (score_cell(experiment, cell, name) for cell in experiment.cells)
            yield [join([link, below(note)]), *cells]
