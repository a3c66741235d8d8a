"""Write a site: all pages into a new folder, which then takes the place of the old one."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

from gauge_envs.errors import GaugeError, ResultFileError
from gauge_envs.files import os_errors
from gauge_envs.pages.document import save_file
from gauge_envs.pages.figures import color_of
from gauge_envs.pages.html import Html, element, join, script_value, slug
from gauge_envs.pages.page import stylesheet
from gauge_envs.runs.result import Result
from gauge_envs.tools.compare import ExperimentComparison, compare
from gauge_envs.tools.site.experiment_page import experiment_page
from gauge_envs.tools.site.model import Site, first_results, page_file
from gauge_envs.tools.site.overview import overview_page
from gauge_envs.tools.site.replay import ghost_text, replay_data

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
    """Write the site of results into a folder: an overview, a page for each experiment, and replays.

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
    site = Site(
        comparison=compare(results.values()),
        files={id(result): file for file, result in results.items()},
        command=command,
    )
    notes: list[ReplayNote] = []
    with os_errors(lambda cause: ResultFileError(f"{out}: cannot be written: {cause}")):
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as folder:
            new = Path(folder) / "new"
            _save_assets(new)
            for experiment in site.comparison.experiments:
                progress(experiment.name)
                notes += _save_experiment(site, experiment, new, replays=replays)
            save_file(new / "index.html", overview_page(site))
            if out.exists():
                out.replace(Path(folder) / "old")
            new.replace(out)
    return tuple(notes)


def check_replaceable(out: Path) -> None:
    """Check that a site may take the place of a folder.

    Raises:
        ResultFileError: It holds something else than a site, or it cannot be read.
    """
    with os_errors(lambda cause: ResultFileError(f"{out}: cannot be read: {cause}")):
        is_folder = out.is_dir() and not out.is_symlink()
        is_free = not any(out.iterdir()) if is_folder else not out.exists()
        if not (is_free or (is_folder and (out / MARK).is_file())):
            raise ResultFileError(
                f"{out}: holds something else than a site of gauge report; give another folder"
            )


def _save_assets(out: Path) -> None:
    for name in SCRIPTS:
        save_file(out / "assets" / name, (ASSETS / name).read_bytes())
    save_file(out / "assets" / "site.css", stylesheet())
    save_file(out / MARK, MARK_TEXT)


def _save_experiment(
    site: Site, experiment: ExperimentComparison, out: Path, *, replays: bool
) -> list[ReplayNote]:
    """Write the page of an experiment and the replay of each configuration; return why some have none."""
    entries: list[dict[str, str]] = []
    ghosts, notes = [], []
    for index, result in first_results(experiment).items() if replays else ():
        label, (color, _) = site.labels[index], color_of(index)
        try:
            data = replay_data(result, label=label, color=color)
        except GaugeError as error:
            note = ReplayNote(id=experiment.id, label=label, reason=str(error))
            notes.append(note)
            continue
        if data["ghost"] is not None:
            ghosts.append(data["ghost"])
        key = f"{slug(experiment.name)}.{index}-{slug(label)}"
        file = f"data/{key}.js"
        call = f"gaugeReplay({script_value(key)},{script_value(data)});\n"
        save_file(out / file, call)
        entries.append({"key": key, "file": file, "label": label, "color": color})
    replay = _replay_html(entries, ghost_text(ghosts)) if entries else None
    reasons = [
        f"{note.label} has no replay: {note.reason}. Its curves are below."
        for note in notes
    ]
    page = experiment_page(site, experiment, replay, reasons)
    save_file(out / page_file(experiment), page)
    return notes


def _replay_html(entries: Sequence[Mapping[str, str]], ghost: str) -> Html:
    """Return the element that the script fills with pictures."""
    stage = Html((ASSETS / "stage.html").read_text(encoding="utf-8"))
    data = script_value({"entries": entries, "ghost": bool(ghost)})
    replay = element("div", stage, class_="replay", data_replays=data)
    return join([replay, element("p", f"{HELP} {ghost}".strip(), class_="small")])
