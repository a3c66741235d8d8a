"""Write a site into a new folder that then replaces the old one."""

from collections.abc import Callable, Mapping
from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory

from gauge_envs.errors import GaugeError, ResultFileError
from gauge_envs.files import os_errors
from gauge_envs.pages.document import Paragraph, Part, Tone, save_file
from gauge_envs.pages.figures import color_of
from gauge_envs.pages.html import Html, element, script_value, slug
from gauge_envs.runs.motion import load_motion, motion_file
from gauge_envs.runs.result import Result
from gauge_envs.tools.compare import ExperimentComparison, compare
from gauge_envs.tools.site.motion_view import motion_view_data
from gauge_envs.tools.site.pages import Site, experiment_page, overview_page, page_file

MARK = "gauge-report-site.txt"
"""File that marks a folder as a site; a later site may replace it."""

MARK_TEXT = "A site of `gauge report`. The next site in this folder replaces all of its content.\n"

ASSETS = Path(__file__).parent / "assets"

HELP = (
    "Drag to rotate; click and scroll to zoom; arrow keys move the slider by a frame. The poses are "
    "those of the first repetition."
)


def save_site(
    results: Mapping[Path, Result],
    out: Path,
    *,
    motion_views: bool = True,
    command: str = "gauge report",
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[str, ...]:
    """Write the site of results into a folder: an overview, a page for each experiment, and 3D views of the motions.

    The pages are written to a temporary folder that then replaces the folder, so an interruption keeps the old site.

    Args:
        results: Result files and their contents, one or more.
        out: Folder of the site. It must be new, empty, or a site.
        motion_views: Whether to show the motions that `gauge run` stored beside the results.
        command: Command of the site, shown on its first page.
        progress: Receives the name of each experiment before its page is written.

    Returns:
        A sentence for each configuration without a 3D view in an experiment, as on the page.

    Raises:
        ResultFileError: There is no result, or the folder has other content or cannot be written.
        MissingExtraError: Matplotlib is not installed.
    """
    if not results:
        raise ResultFileError("no result is left to report; gauge run writes them")
    check_replaceable(out)
    site = Site(
        comparison=compare(results.values()),
        files={id(result): file for file, result in results.items()},
        command=command,
    )
    notes: list[str] = []
    with os_errors(lambda cause: ResultFileError(f"{out}: cannot be written: {cause}")):
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as folder:
            new = Path(folder) / "new"
            copytree(ASSETS, new / "assets")
            save_file(new / MARK, MARK_TEXT)
            for experiment in site.comparison.experiments:
                progress(experiment.name)
                views: list[Part] = []
                if motion_views:
                    views, missing = _save_motion_views(site, experiment, new)
                    notes += missing
                page = experiment_page(site, experiment, views)
                save_file(new / page_file(experiment), page)
            save_file(new / "index.html", overview_page(site))
            if out.exists():
                out.replace(Path(folder) / "old")
            new.replace(out)
    return tuple(notes)


def check_replaceable(out: Path) -> None:
    """Check that a site may replace a folder.

    Raises:
        ResultFileError: The folder has other content than a site, or cannot be read.
    """
    with os_errors(lambda cause: ResultFileError(f"{out}: cannot be read: {cause}")):
        is_new = not out.exists() or (out.is_dir() and not any(out.iterdir()))
        if not is_new and not (out / MARK).is_file():
            raise ResultFileError(
                f"{out}: not a site of gauge report; give an empty folder or a site"
            )


def _save_motion_views(
    site: Site, experiment: ExperimentComparison, out: Path
) -> tuple[list[Part], list[str]]:
    """Write the data of the 3D views of an experiment.

    Returns:
        The parts of its page, and the reasons for missing views.
    """
    entries: list[dict[str, str]] = []
    ghosts: list[str] = []
    missing: list[str] = []
    for index, cell in experiment.present:
        ran = [result for result in cell.results if result.error is None]
        if not ran:
            continue
        label = site.comparison.labels[index]
        try:
            motion = load_motion(motion_file(site.files[id(ran[0])]))
            data = motion_view_data(ran[0], motion)
        except GaugeError as error:
            missing.append(f"{label} has no 3D view: {error}.")
            continue
        if data["ghost"] is not None:
            ghosts.append(data["ghost"]["text"])
        key = f"{slug(experiment.name)}.{index}-{slug(label)}"
        call = f"gaugeMotionView({script_value(key)},{script_value(data)});\n"
        save_file(out / "data" / f"{key}.js", call)
        color, _ = color_of(index)
        entries.append({"key": key, "label": label, "color": color})
    parts: list[Part] = []
    if entries:
        # The script draws pictures into the element.
        stage = Html((ASSETS / "stage.html").read_text(encoding="utf-8"))
        data_views = script_value(entries)
        parts.append(element("div", stage, class_="motion-view", data_views=data_views))
        parts.append(Paragraph(" ".join([HELP, *ghosts[:1]]), Tone.NOTE))
    parts += [Paragraph(reason, Tone.WARNING) for reason in missing]
    return parts, missing
