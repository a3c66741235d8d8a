"""The page of one experiment: picture, scores, replay, convergence, origin."""

from collections.abc import Iterator, Sequence

from gauge_envs.errors import GaugeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.pages.document import Heading, Paragraph, Part, Tone
from gauge_envs.pages.figures import embedded
from gauge_envs.pages.html import Html, element, join, listed
from gauge_envs.pages.results import (
    SCORE_METRICS,
    discretization_text,
)
from gauge_envs.pages.table import Table, grid
from gauge_envs.pages.text import (
    KIND_NOTES,
    digits_text,
    event_title,
    score_text,
    with_unit,
)
from gauge_envs.references.band import Band
from gauge_envs.references.convergence import convergence_rows
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scoring.estimates import Measured
from gauge_envs.scoring.score import OVER_U
from gauge_envs.tools.compare import ExperimentComparison, draw_experiment, judging_band
from gauge_envs.tools.site.model import (
    Parts,
    Results,
    Site,
    first_results,
    score_cell,
    section,
    site_page,
)
from gauge_envs.tools.site.overview import SOLUTION_NOTE, place_text
from gauge_envs.tools.site.reproduce import run_commands

REPLAY_SCRIPTS = ("assets/three.min.js", "assets/replay.js")

SCORES_NOTE = (
    "Scores over the mean score of the real trials; without one, in the unit of the metric. "
    "In brackets: 95 % interval."
)

CONVERGENCE_NOTE = (
    "Change of the whole trajectory when the time step or the cell of a mesh is halved, over the scatter of real "
    "trials; where the reference is a solution, in the unit of g(t). It was measured once for each engine with its "
    "default settings (scoring/convergence)."
)


def experiment_page(
    site: Site,
    one: ExperimentComparison,
    replay: Html | None,
    replay_notes: Sequence[str],
) -> str:
    """Return the page of an experiment with its replay; the notes say why configurations have none."""
    results = first_results(one)
    experiment = _experiment(results)
    band = None if experiment is None else judging_band(experiment, results.values())
    replays: Parts = [
        *([] if replay is None else [replay]),
        *(Paragraph(note, Tone.WARNING) for note in replay_notes),
    ]
    parts = [
        *_head(one, experiment, band),
        *(_picture(site, one) if experiment is not None else []),
        *_ranks(site, one),
        *_scores(site, one),
        *([Heading("3D replay"), *replays] if replays else []),
        *_words(site, results),
        *_distances(site, one),
        *section("Convergence", _convergence(site, results), CONVERGENCE_NOTE),
        *section("Estimates", _estimates(site, results)),
        *section("Did not finish", _not_run(site, one)),
        Heading("How to reproduce"),
        *run_commands(site, one),
    ]
    return site_page(
        one.name,
        parts,
        here=site.experiment_page(one),
        scripts=REPLAY_SCRIPTS if replay else (),
    )


def _experiment(results: Results) -> Experiment | None:
    for result in results.values():
        try:
            return recorded_experiment(result)
        except GaugeError:
            continue
    return None


def _head(
    one: ExperimentComparison, experiment: Experiment | None, band: Band | None
) -> Iterator[Part]:
    if experiment is not None:
        yield element("p", experiment.spec.summary, class_="lead")
        yield element(
            "p", element("b", "Tests: "), ", ".join(experiment.spec.evaluates), "."
        )
    text = f"{KIND_NOTES[Kind(one.kind)]}."
    source = (
        ""
        if band is None
        else f" {band.source[:1].upper()}{band.source[1:].rstrip('.')}."
    )
    yield element("p", element("b", f"Reference, {one.kind}: "), text, source)


def _picture(site: Site, one: ExperimentComparison) -> Parts:
    """Return the picture of an experiment: distance over time, scores, and the coordinates that decide them."""
    among = [
        result
        for other in site.comparison.experiments
        for cell in other.cells
        for result in (cell.results if cell else ())
    ]
    shown = [
        result
        for result in among
        if result.id == one.id and result.trajectory is not None
    ]
    if not shown:
        return []
    figure = draw_experiment(shown, among=among)
    return [embedded(figure, f"{one.name}: distance over time, scores, coordinates")]


def _ranks(site: Site, one: ExperimentComparison) -> Parts:
    lines = [
        join([site.links[score.configuration], f": {place_text(kind, score)}"])
        for kind in site.comparison.compare_within([one])
        for score in kind.ranked
        if len(kind.scores) > 1
    ]
    return [listed(lines)] if len(lines) > 1 else []


def _scores(site: Site, one: ExperimentComparison) -> Parts:
    """Return the table of scores; RMSE and DTW from a solution have no scale, and its distance says it."""
    names = [
        name
        for name in one.metrics()
        if not one.is_solution or name == OVER_U or SCORE_METRICS[name].is_event
    ]
    if not names:
        return []
    has_trials = any(cell and cell.percentile is not None for cell in one.cells)
    titles = ["", *(SCORE_METRICS[name].title for name in names)]
    note = SOLUTION_NOTE if OVER_U in names else SCORES_NOTE
    if has_trials:
        titles.append("real trials closer")
        note += " Real trials closer: share of the real trials that are closer to their mean."
    titles.append("physics")
    rows: list[list[str]] = []
    for index, cell in enumerate(one.cells):
        row: list[str] = [
            site.links[index],
            *(score_cell(one, cell, name) for name in names),
        ]
        if has_trials:
            share = cell.percentile if cell else None
            row.append("-" if share is None else f"{share:.0f} %")
        row.append(site.comparison.configurations[index].physics or "-")
        rows.append(row)
    for engine, title in PUBLISHED_ENGINES.items():
        values = [(one.published(name) or {}).get(engine) for name in names]
        if any(value is not None for value in values):
            empty = [""] * (len(titles) - 1 - len(names))
            rows.append([f"{title}, paper", *map(score_text, values), *empty])
    return section("Scores", grid(titles, rows), note)


def _words(site: Site, results: Results) -> Parts:
    lines = [
        join([site.swatch(index), f"{site.labels[index]}: {result.score.summary()}"])
        for index, result in results.items()
    ]
    return [Heading("In words"), listed(lines)] if lines else []


def _distances(site: Site, one: ExperimentComparison) -> Parts:
    if one.kind != Kind.NONE:
        return []
    rows = [
        (
            f"{site.labels[far.first]} : {site.labels[far.second]}",
            far.text(far.rms.mean),
            far.text(far.motion_rms),
            far.apart_text,
        )
        for far in one.distances
    ]
    limits = sorted({far.text(far.threshold) for far in one.distances})
    note = "Root mean square over the frames. Apart: first time at which the distance exceeds "
    titles = ("between", "distance", "motion", "apart at")
    return section(
        "Distances between engines",
        grid(titles, rows, number_from=1),
        f"{note}{', '.join(limits)}.",
    )


def _convergence(site: Site, results: Results) -> Table:
    rows = []
    for index, result in results.items():
        text = discretization_text(result, convergence_rows(result.backend, result.id))
        if text is not None:
            rows.append((site.links[index], text))
    return grid(("engine", "half step, half cell"), rows)


def _estimates(site: Site, results: Results) -> Table:
    rows = [
        (
            site.links[index],
            event_title(name),
            with_unit(digits_text(one.value), one.unit),
            "-" if one.real is None else with_unit(_real_text(one), one.unit),
        )
        for index, result in results.items()
        for name, one in result.score.estimates.items()
    ]
    return grid(("engine", "quantity", "simulated", "real"), rows)


def _real_text(one: Measured) -> str:
    if one.real_uncertainty is None:
        return digits_text(one.real)
    return f"{digits_text(one.real)} \u00b1 {one.real_uncertainty:.2g}"


def _not_run(site: Site, one: ExperimentComparison) -> Table:
    rows = [
        (site.links[index], result.outcome.value, reason)
        for index, cell in enumerate(one.cells)
        for result in (cell.results if cell else ())
        if (reason := result.error or result.diverged_reason)
    ]
    return grid(("engine", "outcome", "reason"), rows)
