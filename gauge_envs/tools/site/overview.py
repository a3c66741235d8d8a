"""The first page: which engine is how far from reality, or from the solution of its scene, in what, how certainly."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from gauge_envs.pages.document import Paragraph, Part, Tone
from gauge_envs.pages.html import Html, below, element, join
from gauge_envs.pages.results import SCORE_METRICS, versions_text
from gauge_envs.pages.table import Column, Table, grid
from gauge_envs.pages.text import KIND_NOTES, counted
from gauge_envs.references.kind import Kind
from gauge_envs.tools.compare import (
    PUBLISHED,
    Cell,
    ExperimentComparison,
    KindComparison,
    KindScore,
    mean_rank_text,
)
from gauge_envs.tools.site.model import (
    LOST,
    Site,
    score_cell,
    section,
    site_page,
    standing,
    whisker_text,
)

SCALE_NOTE = (
    "Score: distance to the real mean over the mean distance of single real trials, which is 1. Lower is closer. In "
    "brackets: 95 % interval, from the sample of real trials. RMSE aligned: after the best constant shift in time, "
    "because a real release is not at an exact time. So are the trials of the 1."
)

SOLUTION_NOTE = (
    "Distance from the solution of the scene over u, its standard uncertainty. In brackets: 95 % interval. It says "
    "nothing of reality."
)

RANK_NOTE = (
    "Rank: mean over the experiments, which all count the same; in brackets from the best to the worst that the 95 % "
    "intervals of differences leave open. Only engines with the same constants are ranked against each other. The "
    "intervals of scores overlap more: engines share errors, which cancel in a difference."
)

EVENTS_NOTE = (
    "Metrics of events over the real value. LSD: longest rest of the last ball of the cradle. MTE: momentum that the "
    "cradle hands on. PD: period of the pendulum. EL: energy loss of the pendulum."
)

PARTIAL_NOTE = "No distance of real trials is published for what these references compare, so nothing is 1."

UNSCORED_NOTE = (
    "No real reference is published, so nothing says which engine is right. Distance and motion: root mean square "
    "over the frames; the motion is the displacement from the start."
)


def overview_page(site: Site) -> str:
    """Return the first page of a site."""
    comparison = site.comparison
    kinds = [kind for kind in comparison.kinds if kind.ids]
    references = ", ".join(f"{len(kind.ids)} against {_title(kind)}" for kind in kinds)
    lead = (
        f"{counted(len(comparison.experiments), 'experiment')}, "
        f"{counted(len(comparison.configurations), 'configuration')} of {counted(len(site.engines), 'engine')}. "
        f"Compared: {references or 'none'}."
    )
    parts: list[Part] = [
        element("p", lead, class_="lead"),
        *section(
            "Engine by phenomenon", _matrix(site), SCALE_NOTE, SOLUTION_NOTE, RANK_NOTE
        ),
        *(part for kind in kinds for part in _ranking(site, kind)),
        *section(
            "Distance without a scale",
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
    return site_page("How far is each engine off?", parts, here="index.html")


def _title(kind: KindComparison) -> str:
    return {
        "trials": "real trials",
        "recording": "one recorded trial",
        "analytic": "a closed form, not reality",
        "numerical": "a numerical solution, not reality",
    }[kind.kind]


# --- ranks and phenomena ---


def _ranking(site: Site, kind: KindComparison) -> list[Part]:
    """Return the mean ranks within a kind of reference."""
    if len(kind.scores) < 2:
        return []
    constants = "" if kind.constants == PUBLISHED else f", parameters {kind.constants}"
    rows = [
        (
            join([site.swatch(one.configuration), site.labels[one.configuration]]),
            site.comparison.configurations[one.configuration].physics,
            mean_rank_text(one.mean_rank),
        )
        for one in kind.ranked
        if one.mean_rank is not None
    ]
    return section(
        f"Ranks against {_title(kind)}{constants}, {counted(len(kind.ids), 'experiment')}",
        grid(("configuration", "physics", "mean rank"), rows),
        f"{KIND_NOTES[Kind(kind.kind)].capitalize()}.",
    )


@dataclass(frozen=True)
class _Phenomenon:
    """Experiments of one family against references of one kind, of which one has a score."""

    title: str
    tests: str
    kinds: Sequence[KindComparison]
    members: Sequence[ExperimentComparison]

    def of(self, configuration: int) -> tuple[KindComparison, KindScore] | None:
        """Return the comparison that ranks a configuration, and its score there; None without a mean."""
        found = (
            (kind, one)
            for kind in self.kinds
            for one in kind.scores
            if one.configuration == configuration and one.mean is not None
        )
        return next(found, None)

    def cells(self, configuration: int) -> list[Cell]:
        """Return the results of a configuration."""
        cells = (member.cells[configuration] for member in self.members)
        return [cell for cell in cells if cell is not None]


def _phenomena(site: Site) -> Iterator[_Phenomenon]:
    groups: dict[tuple[str, str, str], list[ExperimentComparison]] = {}
    for one in site.comparison.experiments:
        groups.setdefault((*site.family(one), one.kind), []).append(one)
    for kind in Kind:
        for (title, tests, name), members in groups.items():
            if name == kind and (found := site.comparison.compare_within(members)):
                yield _Phenomenon(title, tests, found, members)


def _matrix(site: Site) -> Table:
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
        return join(
            [
                element("b", f"{one.title}, {_title(one.kinds[0])}"),
                below(one.tests),
                below(f"{metric}: ", join(links, " \u00b7 ")),
            ]
        )

    columns = (
        Column(
            "", link, html=partial(_matrix_cell, index), style=partial(_style, index)
        )
        for index, link in enumerate(site.headings)
    )
    return Table(
        columns=(Column("", "phenomenon", html=heading), *columns),
        rows=list(_phenomena(site)),
        look="matrix",
    )


def _style(index: int, one: _Phenomenon) -> str:
    return standing(one.cells(index))[0]


def _matrix_cell(index: int, one: _Phenomenon) -> Html:
    """Return the score and the rank of a configuration in a phenomenon, and what has no score."""
    cells = one.cells(index)
    lost = [
        below(f"{count} {outcome.value}")
        for outcome in LOST
        if (count := sum(cell.count(outcome) for cell in cells))
    ]
    found = one.of(index)
    if found is None or found[1].mean is None:
        text = "no score" if cells else "not run"
        return join([element("span", text, class_="quiet"), *lost])
    kind, score = found
    mean, badge = found[1].mean, standing(cells)[1]
    parts = [
        whisker_text(mean.value, mean.interval_95, "u" if kind.is_solution else "1"),
        *([] if badge is None else [badge]),
        below(place_text(kind, score)),
    ]
    if len(kind.ids) < len(one.members):
        parts.append(below(f"over {len(kind.ids)} of {len(one.members)} experiments"))
    return join([*parts, *lost])


def place_text(kind: KindComparison, score: KindScore) -> str:
    """Return a mean rank in words; empty where there is nothing to compare with."""
    if score.mean_rank is None or len(kind.scores) < 2:
        return ""
    return f"rank {mean_rank_text(score.mean_rank)} of {len(kind.scores)}"


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
    """Yield the experiments with a real reference and no published distance of real trials: their RMSE in its unit."""
    for one in site.comparison.experiments:
        cells = [cell for cell in one.cells if cell is not None]
        has_scale = any(
            cell.deviations is not None or cell.spread("rmse", normalized=True)
            for cell in cells
        )
        if (
            not one.is_solution
            and not has_scale
            and any(cell.spread("rmse", normalized=False) for cell in cells)
        ):
            yield one, "rmse", f"RMSE, {one.kind}"


def _unscored_table(site: Site) -> Table:
    """Return the largest distance between two configurations in each experiment without a reference."""
    rows: list[list[str]] = []
    for one in site.comparison.experiments:
        if one.kind != Kind.NONE:
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
