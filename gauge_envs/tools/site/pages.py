"""Write the pages of a site: the figures and tables of `gauge plot` and `gauge compare`, and the inputs of each run."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.pages.document import Heading, Paragraph, Part, Tone
from gauge_envs.pages.figures import embedded
from gauge_envs.pages.html import Html, element, folded, join, listed, slug
from gauge_envs.pages.page import page
from gauge_envs.pages.results import configuration_parts
from gauge_envs.pages.text import counted, pairs_text
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.tools.compare import (
    Cell,
    ExperimentComparison,
    ScoreComparison,
    compared_parts,
    draw_experiment,
    draw_overview,
)

SCRIPTS = ("assets/three.min.js", "assets/motion_view.js")
"""Scripts of a page with 3D views, in the order in which they run."""

REPRODUCE_NOTE = "A run with the same inputs and versions gives the same bits on the same type of processor."


@dataclass(frozen=True, kw_only=True)
class Site:
    """Content of a site.

    Attributes:
        comparison: The results.
        files: Result file of each result, by the identity of the result.
        command: Command of the site.
    """

    comparison: ScoreComparison
    files: Mapping[int, Path]
    command: str


def page_file(experiment: ExperimentComparison) -> str:
    """Return the file name of the page of an experiment."""
    return f"experiment-{slug(experiment.name)}.html"


# --- first page ---


def overview_page(site: Site) -> str:
    """Return the first page: all scores in a figure and a table, and links to the pages of experiments."""
    comparison = site.comparison
    experiments = counted(len(comparison.experiments), "experiment")
    configurations = counted(len(comparison.configurations), "configuration")
    parts: list[Part] = [
        element("p", f"{experiments}, {configurations}.", class_="lead")
    ]
    figure = draw_overview(comparison)
    if figure is not None:
        parts.append(embedded(figure, "Score of each experiment and configuration"))
    parts += [
        *compared_parts(comparison),
        Heading("Experiments"),
        listed(map(_link, comparison.experiments)),
        Heading("This site"),
        element("pre", element("code", site.command)),
        element(
            "p",
            "The page of an experiment has the inputs of each result. The 3D views are drawn by three.js, MIT ",
            element("a", "licence", href="assets/three.LICENSE.txt"),
            ". Real data: GAUGE, arXiv 2608.05948.",
        ),
    ]
    return page("How far is each engine off?", parts)


def _link(experiment: ExperimentComparison) -> Html:
    """Return a link to the page of an experiment, and what the experiment evaluates."""
    evaluates = ", ".join(load_experiment(experiment.name).spec.evaluates)
    link = element("a", experiment.name, href=page_file(experiment))
    return join([link, f": {evaluates}"])


# --- page of an experiment ---


def experiment_page(
    site: Site, experiment: ExperimentComparison, views: Sequence[Part]
) -> str:
    """Return the page of an experiment.

    Args:
        site: The site.
        experiment: The experiment.
        views: 3D views of its runs, and the reasons for missing views.
    """
    spec = load_experiment(experiment.name).spec
    alone = replace(site.comparison, experiments=(experiment,), notes=())
    parts: list[Part] = [
        element("nav", element("a", "Overview", href="index.html")),
        element("p", spec.summary, class_="lead"),
        element("p", element("b", "Tests:"), f" {', '.join(spec.evaluates)}."),
        *_figure(site, experiment),
        *compared_parts(alone, is_full=True),
    ]
    if views:
        scripts = (element("script", src=file, defer=True) for file in SCRIPTS)
        parts += [Heading("3D view"), *views, *scripts]
    parts += [
        Heading("In words"),
        listed(_sentences(site, experiment)),
        Heading("How to reproduce"),
        Paragraph(REPRODUCE_NOTE, Tone.NOTE),
        *_runs(site, experiment),
    ]
    return page(experiment.name, parts)


def _figure(site: Site, experiment: ExperimentComparison) -> Iterator[Html]:
    """Yield the figure of `gauge plot`; nothing without a trajectory."""
    drawn = [result for result in experiment.results if result.trajectory is not None]
    if not drawn:
        return
    # All results decide the colours, so that a configuration has the same colour on all pages.
    among: list[Result] = []
    for other in site.comparison.experiments:
        among += other.results
    figure = draw_experiment(drawn, among=among)
    yield embedded(figure, f"{experiment.name}: distance over time, coordinates")


def _sentences(site: Site, experiment: ExperimentComparison) -> Iterator[str]:
    """Yield the first score of each configuration in words, and why its other repeats did not finish."""
    for index, cell in experiment.present:
        label = site.comparison.labels[index]
        finished = [
            result for result in cell.results if result.outcome is Outcome.FINISHED
        ]
        if finished:
            yield f"{label}: {finished[0].score.summary()}"
        for result in cell.results:
            reason = result.error or result.diverged_reason
            if reason is not None:
                yield f"{label}, {result.outcome.value}: {reason}"


def _runs(site: Site, experiment: ExperimentComparison) -> Iterator[Part]:
    """Yield the inputs of the runs of each configuration, and its result files, versions and settings."""
    for index, cell in experiment.present:
        yield element("p", element("b", site.comparison.labels[index]))
        inputs = _inputs_text(site.comparison, index, cell)
        yield Paragraph(inputs, Tone.NOTE)
        origins = [
            f"{site.files[id(result)].name}, created {result.created}"
            for result in cell.results
        ]
        settings = [
            f"{name} = {value}" for name, value in cell.results[0].settings.items()
        ]
        yield folded("files, settings", listed(origins), listed(settings))


def _inputs_text(comparison: ScoreComparison, index: int, cell: Cell) -> str:
    """Return engine, parameters, seeds and versions of the runs of a configuration."""
    parts = configuration_parts(comparison.configurations[index])
    inputs = ", ".join(text for _, text in parts)
    seeds = ", ".join(str(result.seed) for result in cell.results)
    return f"{inputs}; seed {seeds}; {pairs_text(cell.results[0].versions)}."
