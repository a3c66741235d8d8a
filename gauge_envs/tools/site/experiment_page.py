"""Write the page of one experiment: picture, scores, replay, estimates, and the inputs of its runs."""

from collections.abc import Iterator, Mapping, Sequence

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.pages.document import Heading, Paragraph, Part, Tone
from gauge_envs.pages.figures import embedded
from gauge_envs.pages.html import Html, below, element, folded, join, listed
from gauge_envs.pages.results import SCORE_METRICS, configuration_parts
from gauge_envs.pages.table import grid
from gauge_envs.pages.text import (
    KIND_NOTES,
    digits_text,
    event_title,
    pairs_text,
    score_text,
    with_unit,
)
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scoring.estimates import ComparedQuantity
from gauge_envs.scoring.score import OVER_U
from gauge_envs.tools.compare import (
    ExperimentComparison,
    distance_tables,
    draw_experiment,
    judging_band,
)
from gauge_envs.tools.site.model import (
    Site,
    first_results,
    score_cell,
    section,
    site_page,
)
from gauge_envs.tools.site.overview import SOLUTION_NOTE, place_text

REPLAY_SCRIPTS = ("assets/three.min.js", "assets/replay.js")

SCORES_NOTE = (
    "Scores divided by the mean score of real trials, or in the unit of the metric without real trials. "
    "In brackets: 95 % interval."
)

REPRODUCE_NOTE = "A run with the same inputs and versions gives the same bits on the same type of processor."


def experiment_page(
    site: Site,
    experiment: ExperimentComparison,
    replays: Sequence[Part],
) -> str:
    """Return the page of an experiment with its replays, or the reasons for missing replays."""
    results = first_results(experiment)
    parts: list[Part] = [
        *_head(experiment, results),
        *_picture(site, experiment),
        *_scores(site, experiment),
        *([Heading("3D replay"), *replays] if replays else []),
        *_sentences(site, results),
        *distance_tables([experiment], site.labels),
        *_unfinished(site, experiment),
        Heading("How to reproduce"),
        Paragraph(REPRODUCE_NOTE, Tone.NOTE),
        *_runs(site, experiment),
    ]
    scripts = REPLAY_SCRIPTS if replays else ()
    return site_page(experiment.name, parts, scripts=scripts)


def _head(
    experiment: ExperimentComparison, results: Mapping[int, Result]
) -> Iterator[Part]:
    """Yield the summary of the experiment and of its reference."""
    spec = load_experiment(experiment.name).spec
    yield element("p", spec.summary, class_="lead")
    yield element("p", element("b", "Tests:"), f" {', '.join(spec.evaluates)}.")
    title = element("b", f"Reference, {experiment.kind}: ")
    texts = [KIND_NOTES[Kind(experiment.kind)]]
    for result in list(results.values())[:1]:
        band = judging_band(recorded_experiment(result), results.values())
        texts += [] if band is None else [band.source.rstrip(".")]
    yield element("p", title, "; ".join(texts), ".")


def _picture(site: Site, experiment: ExperimentComparison) -> list[Html]:
    """Return the picture of an experiment: distance over time, scores, and the coordinates that decide the score."""
    drawn = [result for result in experiment.results if result.trajectory is not None]
    if not drawn:
        return []
    among = [result for item in site.comparison.experiments for result in item.results]
    figure = draw_experiment(drawn, among=among)
    text = f"{experiment.name}: distance over time, scores, coordinates"
    return [embedded(figure, text)]


def _scores(site: Site, experiment: ExperimentComparison) -> list[Part]:
    """Return the table of scores."""
    names = experiment.shown_metrics()
    if not names:
        return []
    ranks = {
        score.configuration: place_text(kind, score)
        for kind in site.comparison.compare_within([experiment])
        for score in kind.scores
    }
    rows: list[list[str]] = []
    for index, cell in enumerate(experiment.cells):
        notes = [ranks.get(index, "")]
        if cell and cell.percentile is not None:
            notes.append(f"{cell.percentile:.0f} % of the real trials are closer")
        name = join([site.names[index], *map(below, notes)])
        scores = (score_cell(experiment, cell, metric) for metric in names)
        rows.append([name, *scores])
    for engine, title in PUBLISHED_ENGINES.items():
        values = [(experiment.published(name) or {}).get(engine) for name in names]
        if any(value is not None for value in values):
            rows.append([f"{title}, paper", *map(score_text, values)])
    titles = ["", *(SCORE_METRICS[name].title for name in names)]
    note = SOLUTION_NOTE if OVER_U in names else SCORES_NOTE
    return section("Scores", grid(titles, rows), note)


def _sentences(site: Site, results: Mapping[int, Result]) -> list[Part]:
    """Return the score of each configuration in words, with its estimates."""
    entries = []
    for index, result in results.items():
        texts = [
            f"{event_title(name)}: {_estimate_text(estimate)}"
            for name, estimate in result.score.estimates.items()
        ]
        sentence = f"{site.labels[index]}: {result.score.summary()}"
        entries.append(join([site.swatch(index), sentence, *map(below, texts)]))
    return [Heading("In words"), listed(entries)] if entries else []


def _estimate_text(estimate: ComparedQuantity) -> str:
    text = f"simulated {with_unit(digits_text(estimate.value), estimate.unit)}"
    if estimate.real is not None:
        text += f", real {digits_text(estimate.real)}"
    if estimate.real_uncertainty is not None:
        text += f" \u00b1 {estimate.real_uncertainty:.2g}"
    return text


def _unfinished(site: Site, experiment: ExperimentComparison) -> list[Part]:
    reasons = [
        f"{site.labels[index]}, {result.outcome.value}: {reason}"
        for index, cell in enumerate(experiment.cells)
        for result in (cell.results if cell else ())
        if (reason := result.error or result.diverged_reason)
    ]
    return [Heading("Did not finish"), listed(reasons)] if reasons else []


# --- how to reproduce ---


def _runs(site: Site, experiment: ExperimentComparison) -> Iterator[Part]:
    """Yield the inputs of the runs of each configuration, and its result files, versions and settings."""
    configurations = site.comparison.configurations
    for index, cell in enumerate(experiment.cells):
        if cell is None:
            continue
        first = cell.results[0]
        inputs = [text for _, text in configuration_parts(configurations[index])]
        seeds = ", ".join(str(result.seed) for result in cell.results)
        versions = pairs_text(first.versions)
        yield element("p", site.swatch(index), site.labels[index])
        yield Paragraph(f"{', '.join(inputs)}; seed {seeds}; {versions}.", Tone.NOTE)
        settings = [f"{name} = {value}" for name, value in first.settings.items()]
        origins = (
            f"{site.files[id(result)].name}, created {result.created}"
            for result in cell.results
        )
        yield folded("files, settings", listed(origins), listed(settings))
