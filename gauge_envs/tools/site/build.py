"""Write a site: all pages into a new folder, which then takes the place of the old one."""

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from secrets import token_hex
from string import Template
from typing import Any

from gauge_envs.errors import GaugeError, ResultFileError
from gauge_envs.files import os_errors
from gauge_envs.pages.document import Heading, Part, save_file
from gauge_envs.pages.figures import color_of
from gauge_envs.pages.html import (
    Html,
    element,
    folded,
    join,
    listed,
    script_value,
    slug,
)
from gauge_envs.pages.page import stylesheet
from gauge_envs.pages.results import discretization_text
from gauge_envs.pages.table import Table, grid
from gauge_envs.pages.text import shortened
from gauge_envs.references.convergence import convergence_rows
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.tools.compare import (
    ExperimentComparison,
    compare,
    judging_band,
    mean_rank_text,
)
from gauge_envs.tools.site.experiment_page import experiment_page
from gauge_envs.tools.site.model import (
    Site,
    first_result,
    first_results,
    score_cell,
    section,
    site_page,
)
from gauge_envs.tools.site.overview import overview_page
from gauge_envs.tools.site.replay import (
    replay,
)
from gauge_envs.tools.site.replay_data import ghost_text, replay_data
from gauge_envs.tools.site.reproduce import reproduce_page

MARK = "gauge-report-site.txt"
"""File that marks a folder as a site, which a later one may replace."""

MARK_TEXT = "A site of `gauge report`. The next one with this folder replaces everything in it.\n"

ASSETS = files("gauge_envs.tools.site") / "assets"

SCRIPTS = ("replay.js", "three.min.js", "three.LICENSE.txt")

HELP = (
    "Drag to turn, click and scroll to zoom. Keys in the picture: Space, left and right, Home, End, A, D. Poses of the "
    "run, which was repeated with the same versions."
)


@dataclass(frozen=True, kw_only=True)
class ReplayNote:
    """Why a configuration has no replay in an experiment.

    Attributes:
        id: Gymnasium id of the experiment.
        label: Label of the configuration.
        reason: The reason.
    """

    id: str
    label: str
    reason: str


def save_site(
    results: Mapping[Path, Result],
    out: Path,
    *,
    replays: bool = True,
    command: str = "gauge report",
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[ReplayNote, ...]:
    """Write the site of results into a folder: a page for all, one for each experiment and engine, and replays.

    The pages are written beside the folder and then take its place, so that an interruption leaves the old site.

    Args:
        results: Result files and their contents, one or more.
        out: Folder of the site. It must be new, empty, or a site.
        replays: Whether to run the episodes again for their poses; see `gauge_envs.tools.site.replay`.
        command: Command that makes the site, which it shows.
        progress: Receives the name of each experiment before its page is made.

    Returns:
        Why configurations have no replay; the pages say the same.

    Raises:
        ResultFileError: There is no result, the folder holds something else, or it cannot be written.
    """
    if not results:
        raise ResultFileError("there is no result to report")
    check_replaceable(out)
    part = out.with_name(f".{out.name}.{token_hex(8)}.tmp")
    try:
        notes = _write(
            results, part, replays=replays, command=command, progress=progress
        )
        _replace(part, out)
    except GaugeError:
        raise
    except OSError as error:
        raise ResultFileError(
            f"{out}: cannot be written: {error.strerror or error}"
        ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return notes


def check_replaceable(out: Path) -> None:
    """Check that a site may take the place of a folder."""
    with os_errors(lambda cause: ResultFileError(f"{out}: cannot be read: {cause}")):
        is_taken = out.is_symlink() or (
            out.exists() and (not out.is_dir() or any(out.iterdir()))
        )
    if is_taken and (out.is_symlink() or not (out / MARK).is_file()):
        raise ResultFileError(
            f"{out}: holds something else than a site of gauge report; give another folder"
        )


def _replace(part: Path, out: Path) -> None:
    old = out.with_name(f".{out.name}.{token_hex(8)}.old")
    if out.exists():
        out.replace(old)
    try:
        part.replace(out)
    except OSError:
        with suppress(OSError):
            old.replace(out)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _write(
    results: Mapping[Path, Result],
    out: Path,
    *,
    replays: bool,
    command: str,
    progress: Callable[[str], None],
) -> tuple[ReplayNote, ...]:
    comparison = compare(results.values())
    site = Site(
        comparison=comparison,
        files={id(result): file for file, result in results.items()},
    )
    for name in SCRIPTS:
        save_file(out / "assets" / name, (ASSETS / name).read_bytes())
    save_file(out / "assets" / "site.css", stylesheet())
    save_file(out / MARK, MARK_TEXT)
    notes: list[ReplayNote] = []
    for one in comparison.experiments:
        progress(one.name)
        replay, missing = _replays(site, one, out) if replays else (None, [])
        notes += missing
        texts = [
            f"{note.label} has no replay: {note.reason}. Its curves are below."
            for note in missing
        ]
        save_file(
            out / site.experiment_page(one), experiment_page(site, one, replay, texts)
        )
    for name in site.engines:
        save_file(out / site.engine_page(name), engine_page(site, name))
    save_file(out / "reproduce.html", reproduce_page(site, command))
    save_file(out / "index.html", overview_page(site))
    return tuple(notes)


# --- replays ---


def _replays(
    site: Site, one: ExperimentComparison, out: Path
) -> tuple[Html | None, list[ReplayNote]]:
    """Write the replay of each configuration in an experiment; return their element, and what has none and why."""
    entries: list[dict[str, str]] = []
    ghosts, notes = [], []
    for index, result in first_results(one).items():
        label = site.labels[index]
        try:
            data = _replay(site, index, result)
        except GaugeError as error:
            notes.append(ReplayNote(id=one.id, label=label, reason=str(error)))
            continue
        if data["ghost"] is not None:
            ghosts.append(data["ghost"])
        key = f"{slug(one.name)}.{site.slugs[index]}"
        path = Path("data") / f"{key}.js"
        save_file(
            out / path, f"gaugeReplay({script_value(key)},{script_value(data)});\n"
        )
        entries.append(
            {
                "key": key,
                "file": path.as_posix(),
                "label": label,
                "color": color_of(index)[0],
            }
        )
    return (_replay_element(entries, ghost_text(ghosts)) if entries else None), notes


def _replay(site: Site, index: int, result: Result) -> dict[str, Any]:
    made = replay(result)
    experiment = recorded_experiment(result)
    if "trial" in result.jitter:
        experiment = replace(experiment, trial=int(result.jitter["trial"]))
    band = judging_band(experiment, [result])
    return replay_data(
        experiment, made, band, label=site.labels[index], color=color_of(index)[0]
    )


def _replay_element(entries: Sequence[Mapping[str, str]], ghost: str) -> Html:
    boxes = [
        element(
            "label",
            element("input", type="checkbox", name="engine", value=entry["key"]),
            f" {entry['label']}",
        )
        for entry in entries
    ]
    if ghost:
        box = element("input", type="checkbox", name="ghost", checked=True)
        boxes.append(element("label", box, " reference"))
    stage = Template((ASSETS / "stage.html").read_text(encoding="utf-8")).substitute(
        boxes=join(boxes)
    )
    replay = element(
        "div", Html(stage), class_="replay", data_replays=script_value(list(entries))
    )
    return join(
        [replay, element("p", HELP, f" {ghost}" if ghost else "", class_="small")]
    )


def engine_page(site: Site, name: str) -> str:
    """Return the page of an engine; `file` is the name for trajectory files."""
    parts: list[Part] = []
    for index in site.engines[name]:
        parts += [
            *_means(site, index),
            *section("Scores", _scores(site, index)),
            *_settings(site, index),
            *_reasons(site, index),
        ]
    return site_page(f"Engine: {name}", parts, here=site.engine_page(name))


def _means(site: Site, index: int) -> list[Html]:
    one, summary = (
        site.comparison.configurations[index],
        site.comparison.summaries()[index],
    )
    versions = (
        ", ".join(f"{package} {text}" for package, text in one.engine_versions.items())
        or "not stated"
    )
    counts = f"{summary.ran} experiments ran, {summary.scored} have a score, {summary.diverged} diverged, "
    counts += f"{summary.not_run} did not run."
    heading = element("h2", site.swatch(index), site.labels[index])
    ranks = [
        f"{kind.name}: {mean_rank_text(score.mean_rank)} of {len(kind.scores)}"
        for kind in site.comparison.kinds
        for score in kind.scores
        if score.configuration == index
        and score.mean_rank is not None
        and len(kind.scores) > 1
    ]
    places = [element("p", f"Mean rank: {'; '.join(ranks)}.")] if ranks else []
    physics = f" Physics: {one.physics}." if one.physics else ""
    return [heading, element("p", f"Versions: {versions}.{physics} {counts}"), *places]


def _scores(site: Site, index: int) -> Table:
    rows = []
    for one in site.comparison.experiments:
        cell = one.cells[index]
        if cell is not None:
            result = first_result(cell)
            convergence = None
            if result is not None:
                convergence = discretization_text(
                    result, convergence_rows(result.backend, result.id)
                )
            name, score = (
                site.experiment_link(one, site.family(one)[0]),
                score_cell(one, cell, one.primary),
            )
            rows.append((name, one.kind, score, convergence or "-"))
    return grid(("experiment", "reference", "score [95 %]", "discretization"), rows)


def _settings(site: Site, index: int) -> list[Part]:
    groups: dict[str, list[str]] = {}
    for one in site.comparison.experiments:
        result = first_result(one.cells[index])
        if result is not None:
            text = "\n".join(
                f"{key} = {json.dumps(value)}" for key, value in result.settings.items()
            )
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
                reasons.setdefault(
                    (result.outcome.value, reason.replace(f"{one.id}: ", "")), []
                ).append(one.name)
    entries = [
        join([element("b", outcome), f": {shortened(names)}: {reason}"])
        for (outcome, reason), names in reasons.items()
    ]
    return [Heading("Did not finish", 3), listed(entries)] if entries else []
