"""Draw the pictures of the gallery and write the list of `docs/gallery.md`: one strip for each experiment, and films.

    python scripts/build_gallery.py            runs what has no result yet, draws everything, writes the list
    python scripts/build_gallery.py --check    fails unless every family has an entry and every entry its picture

Results and poses stay in a folder, so that a second run draws alone. The films need the engines that they show.
"""

from __future__ import annotations

import argparse
import pickle
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import gymnasium
import numpy as np
from numpy.typing import NDArray

from gauge_envs import load_experiment, reference_band
from gauge_envs.backends import versions_of
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.envs.rendering.lazy import Pictures
from gauge_envs.envs.rendering.overlay import Overlay, tracked_overlay
from gauge_envs.evaluation.reference_path import reference_path, reference_text
from gauge_envs.experiments.variants import beyond_variants, find_variant, variants
from gauge_envs.observables.kinds import Observable
from gauge_envs.pages.text import BACKEND_TITLES
from gauge_envs.runs.batch import planned_results, run_many
from gauge_envs.runs.replay import replayed_experiment
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import load_result, result_file_name
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.film import (
    Caption,
    FilmOptions,
    PanelText,
    save_film,
    save_still,
    save_strip,
    score_line,
    strip_picture,
)

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- gallery, written by scripts/build_gallery.py -->", "<!-- end of gallery -->"
"""Lines of the page that enclose the list."""

STRIP_SIZE = {"width": 320, "height": 240}
FILM_SIZE = {"width": 300, "height": 225}
FILM_FPS = 20.0
CONTROL_FRACTION = 0.98
"""Share of its limit that the law's policy uses in the pictures of control tasks."""

MOST_FILM_BYTES = 600_000
MOST_BYTES = 4_000_000
"""Largest size of a film, and of all pictures of the gallery."""

OBSERVED = {
    Observable.POSITION: "positions",
    Observable.CURVATURE: "curvature at markers",
    Observable.LINE_CURVATURE: "turning angles along a line of markers",
    Observable.FACE_AREA: "areas between markers",
    Observable.MARKER_POSITION: "positions of markers",
}


@dataclass(frozen=True)
class Entry:
    """A strip of one experiment on MuJoCo.

    Attributes:
        name: Variant.
        to_s: Time of the last picture [s]; None for the end of the episode.
        use_withheld: Whether to draw a recording that is withheld from scores.
        is_scored: Whether it has a reference or a score. Of others, the episode is run to the last picture alone.
    """

    name: str
    to_s: float | None = None
    use_withheld: bool = False
    is_scored: bool = True


@dataclass(frozen=True)
class FilmEntry:
    """A film of one experiment on several engines.

    Attributes:
        name: Variant.
        backends: Engines, in the order of the panels.
        speed: Seconds of the experiment in a second of the film.
        to_s: Time of the last frame [s]; None for the end of the episode.
    """

    name: str
    backends: tuple[str, ...]
    speed: float
    to_s: float | None = None


FILMS = (
    FilmEntry("CubeToss-acrylic", ("mujoco", "rapier", "physx"), 0.25, 0.8),
    FilmEntry("TextileFlinging-oxford", ("mujoco", "newton"), 0.5, 1.8),
)


@dataclass(frozen=True)
class View:
    """What a picture of an episode shows.

    Attributes:
        time_s: Time [s].
        poses: Pose of each rigid body that moves.
        nodes_m: Nodes of each deformable body [m].
        overlay: What is drawn on top of them.
    """

    time_s: float
    poses: Mapping[str, NDArray[np.float64]]
    nodes_m: Mapping[str, NDArray[np.float64]]
    overlay: Overlay


GROUPS: dict[str, tuple[Entry, ...]] = {
    "Rigid bodies": (
        Entry("SlopeSlider-2-wood"),
        Entry("SlopeContact-wood"),
        Entry("NonsmoothContact-1-wood"),
        Entry("Turntable-3-metal"),
        Entry("BouncingBall-rubber"),
        Entry("NewtonsCradle-metal", 0.6),
        Entry("Pendulum-metal", 0.9, use_withheld=True),
        Entry("WallBreaking-wood", 1.5),
    ),
    "Rope and textiles": (
        Entry("RopeWinding-rubber", 2.0, is_scored=False),
        Entry("TextileStretching-satin", 3.0, is_scored=False),
        Entry("TextileBending-oxford", 4.8, is_scored=False),
        Entry("TextileFlinging-oxford", 1.8),
        Entry("Funnel-satin", 2.0, is_scored=False),
        Entry("RotatingBall-uniform", 2.0, is_scored=False),
        Entry("TableclothPulling-metal", 3.0, use_withheld=True, is_scored=False),
    ),
    "Foam": (
        Entry("FoamStretching-soft", 0.9, use_withheld=True, is_scored=False),
        Entry("FoamCompressing-soft", 0.9, use_withheld=True, is_scored=False),
        Entry("FoamShearing-soft", 1.2, use_withheld=True, is_scored=False),
        Entry("FoamTwisting-soft", 2.1, use_withheld=True),
        Entry("FoamBending-soft", 1.1, use_withheld=True, is_scored=False),
        Entry("StickStack-soft", 4.0, is_scored=False),
        Entry("CantileverBeam-soft", 0.5, use_withheld=True, is_scored=False),
    ),
    "Beyond the benchmark": (
        Entry("CubeToss-acrylic"),
        Entry("ElbowToss-blocks"),
        Entry("SiliconeBeam-52g-silicone", 0.5),
    ),
}

CONTROLS = (
    "Turntable-Limit-wood",
    "SlopeSlider-Limit-wood",
    "Pendulum-Limit-metal",
    "Carry-Limit-wood",
    "Push-Limit-wood",
    "Throw-Limit-rubber",
)
"""Control tasks, played by the policy of their law."""


# --- results ---------------------------------------------------------------------------------------------------------


def result_of(name: str, backend: str, folder: Path) -> tuple[Path, Result]:
    """Return the result of an experiment and its file, which an earlier call may have written."""
    request = RunRequest(name, backend=backend)
    (planned,) = planned_results(request)
    file = folder / result_file_name(planned)
    for result in run_many([request], out=folder, resume=True):
        if result.error is not None:
            raise SystemExit(f"{name} on {backend}: {result.error}")
    return file, load_result(file)


def stepped(entry: Entry, folder: Path) -> list[View]:
    """Return the first, middle and last view of an experiment without a score; an earlier call may have stored them."""
    assert entry.to_s is not None
    experiment = load_experiment(entry.name)
    last = min(round(FRAME_RATE_HZ * entry.to_s), experiment.frame_count - 1)
    key = repr((experiment.file_sha256, versions_of("mujoco"), last, entry.use_withheld))
    file = folder / f"{entry.name}.views.pickle"
    if file.is_file():
        known, views = pickle.loads(file.read_bytes())
        if known == key:
            return views
    views = list(_views(entry, last))
    folder.mkdir(parents=True, exist_ok=True)
    file.write_bytes(pickle.dumps((key, views)))
    return views


def _views(entry: Entry, last: int) -> Iterator[View]:
    """Run an episode to a frame with zero actions, and yield its first, middle and last view."""
    env = GaugeEnv(entry.name, use_withheld=entry.use_withheld)
    env.reset(seed=0)
    episode = env.episode
    zero = 0 if isinstance(env.action_space, gymnasium.spaces.Discrete) else np.zeros(env.action_space.shape)
    for frame in range(last + 1):
        if frame:
            env.step(zero)
        if frame in (0, last // 2, last):
            yield View(frame / FRAME_RATE_HZ, episode.poses(), episode.nodes_m(), tracked_overlay(episode))
    env.close()


def controlled(name: str) -> tuple[list[NDArray[np.uint8]], list[float], str]:
    """Return the first, middle and last picture of a control task, their times, and what was reached."""
    env = gymnasium.make(f"GAUGE/{name}", render_mode="rgb_array", **STRIP_SIZE)
    env.reset(seed=0)
    task = env.unwrapped
    pictures, over = [env.render()], False
    while not over:
        *_, terminated, truncated, info = env.step(task.law_action(CONTROL_FRACTION))
        over = terminated or truncated
        pictures.append(env.render())
    env.close()
    report, limit = info["limit"], info["limit"].limit
    chosen = (0, len(pictures) // 2, len(pictures) - 1)
    unit = "" if limit.unit == "1" else f" {limit.unit}"
    note = f"{limit.quantity} {report.reached:.3f}, limit {limit.value:.3f} +- {limit.sigma:.3f}{unit}"
    return [pictures[index] for index in chosen], [index / FRAME_RATE_HZ for index in chosen], note


# --- page ------------------------------------------------------------------------------------------------------------


def entry_text(entry: Entry, result: Result | None) -> str:
    """Return the sentences of an experiment: what happens, what is observed, its score if it has one, its reference."""
    experiment = load_experiment(entry.name) if result is None else replayed_experiment(result)
    spec = load_experiment(entry.name).spec
    band = reference_band(experiment, use_withheld=entry.use_withheld)
    observed = f"Observed: {OBSERVED[experiment.score.observable]}, for {', '.join(spec.evaluates)}."
    if result is not None:
        score = f"MuJoCo {result.versions['mujoco']}: {score_line(result, band)}."
    else:
        score = f"Not scored: {'the package has no real reference' if band is None else 'the reference is withheld'}."
    end_s = entry.to_s or (experiment.frame_count - 1) / FRAME_RATE_HZ
    reference = reference_text(band, reference_path(experiment, band), end_s=end_s, trial=experiment.trial)
    return " ".join([spec.summary, observed, score, *([f"Red: {reference}."] if reference else [])])


def picture_name(name: str) -> str:
    """Return the file name of the strip of an experiment or a control task."""
    return f"{name}.webp"


def film_name(film: FilmEntry) -> str:
    """Return the file name of a film."""
    return f"{film.name}.film.webp"


def engines(film: FilmEntry) -> str:
    """Return the engines of a film in words."""
    *first, last = (BACKEND_TITLES[backend] for backend in film.backends)
    return f"{', '.join(first)} and {last}"


def command(film: FilmEntry) -> str:
    """Return the command that makes a film from a folder of results."""
    to = "" if film.to_s is None else f" to_s={film.to_s:g}"
    return f"gauge video film results --only {film.name} speed={film.speed:g}{to} --out {film.name}.mp4"


def page_lines(texts: dict[str, str]) -> Iterator[str]:
    """Yield the lines of the list.

    Args:
        texts: Sentences of each experiment and each control task.
    """
    yield "## Engines side by side"
    for film in FILMS:
        yield from ("", f"### {film.name} on {engines(film)}", "")
        yield from (f"![{film.name} on {engines(film)}](images/gallery/{film_name(film)})", "")
        yield f"Speed x {film.speed:g}. `{command(film)}` makes it from results of these engines."
    groups = {title: [entry.name for entry in entries] for title, entries in GROUPS.items()}
    for title, names in (groups | {"Control tasks": list(CONTROLS)}).items():
        yield from ("", f"## {title}")
        for name in names:
            yield from ("", f"### {name}", "", f"![{name} at three times](images/gallery/{picture_name(name)})", "")
            yield texts[name]


def faults(page: str, folder: Path) -> list[str]:
    """Return what is missing: families without an entry, pictures without a file or a place on the page.

    Args:
        page: Text of the page.
        folder: Folder of the pictures.
    """
    shown = [entry.name for entries in GROUPS.values() for entry in entries]
    families = {variant.family for variant in (*variants(), *beyond_variants())}
    missing = sorted(families - {find_variant(name).family for name in shown})
    found = [f"{family}: no picture of this family: add an entry" for family in missing]
    wanted = [*(picture_name(name) for name in (*shown, *CONTROLS)), *(film_name(film) for film in FILMS)]
    linked = re.findall(r"\]\(images/gallery/([^)]+)\)", page)
    files = {file.name: file.stat().st_size for file in folder.iterdir()} if folder.is_dir() else {}
    found += [f"{name}: there is no such picture" for name in wanted if not files.get(name)]
    found += [f"{name}: the page does not show it" for name in wanted if name not in linked]
    found += [f"{name}: it is in the folder, and no entry names it" for name in sorted(set(files) - set(wanted))]
    films = [film_name(film) for film in FILMS]
    found += [f"{name}: larger than {MOST_FILM_BYTES} bytes" for name in films if files.get(name, 0) > MOST_FILM_BYTES]
    if sum(files.values()) > MOST_BYTES:
        found.append(f"all pictures: {sum(files.values())} bytes, at most {MOST_BYTES}")
    return found


# --- drawing ---------------------------------------------------------------------------------------------------------


def draw(results: Path, folder: Path) -> dict[str, str]:
    """Draw all pictures, and return the sentences of each entry."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {}
    for entry in (entry for entries in GROUPS.values() for entry in entries):
        file = folder / picture_name(entry.name)
        texts[entry.name] = (
            draw_scored(entry, results, file) if entry.is_scored else draw_unscored(entry, results, file)
        )
        report(file)
    for name in CONTROLS:
        texts[name] = draw_control(name, folder / picture_name(name))
        report(folder / picture_name(name))
    for film in FILMS:
        draw_film(film, results, folder / film_name(film))
        report(folder / film_name(film))
    return texts


def draw_scored(entry: Entry, results: Path, out: Path) -> str:
    """Draw the strip of a result, and return its sentences."""
    file, result = result_of(entry.name, "mujoco", results)
    options = FilmOptions(**STRIP_SIZE, to_s=entry.to_s, use_withheld=entry.use_withheld)
    raise_if_left_out(save_strip({file: result}, out, options))
    return entry_text(entry, result)


def draw_unscored(entry: Entry, results: Path, out: Path) -> str:
    """Draw the strip of an experiment without a score, and return its sentences."""
    experiment = load_experiment(entry.name)
    band = reference_band(experiment, use_withheld=True)
    if band is not None and band.withheld is None:
        raise SystemExit(f"{entry.name}: it has a reference: leave out is_scored=False")
    shown = band if entry.use_withheld else None
    views = stepped(entry, results)
    canvas = Pictures("rgb_array", **STRIP_SIZE)
    pictures = [
        canvas.draw(
            experiment, views[0].nodes_m, band=shown, poses=view.poses, nodes_m=view.nodes_m, overlay=view.overlay
        )
        for view in views
    ]
    canvas.close()
    note = "not scored" if band is None else "not scored: the reference is withheld"
    text = PanelText(title="MuJoCo", detail=f"mujoco {versions_of('mujoco')['mujoco']}", note=note)
    reference = reference_text(shown, reference_path(experiment, shown), end_s=views[-1].time_s)
    caption = Caption(title=entry.name, subtitle=experiment.title, reference=reference)
    save_still(strip_picture([pictures], [text], caption, [f"{view.time_s:.2f} s" for view in views]), out)
    return entry_text(entry, None)


def draw_control(name: str, out: Path) -> str:
    """Draw the strip of a control task, and return its sentences."""
    pictures, times_s, note = controlled(name)
    share = f"{100.0 * CONTROL_FRACTION:.0f} %"
    text = PanelText(title="MuJoCo", detail=f"policy of the law, {share} of its limit", note=note)
    caption = Caption(title=name, subtitle="Control task with a known optimum", reference="", simulated="")
    save_still(strip_picture([pictures], [text], caption, [f"{time_s:.2f} s" for time_s in times_s]), out)
    env = gymnasium.make(f"GAUGE/{name}")
    law = env.unwrapped.LAW
    env.close()
    return f"Law: {law}. The law's policy, with {share} of the limit: {note}."


def draw_film(film: FilmEntry, results: Path, out: Path) -> None:
    """Draw a film of several engines."""
    found = dict(result_of(film.name, backend, results) for backend in film.backends)
    options = FilmOptions(**FILM_SIZE, fps=FILM_FPS, speed=film.speed, to_s=film.to_s)
    raise_if_left_out(save_film(found, out, options))


def raise_if_left_out(left_out: Sequence[object]) -> None:
    """End the script if a result has no panel."""
    if left_out:
        raise SystemExit(f"left out: {left_out}")


def report(file: Path) -> None:
    """Print a file and its size."""
    print(f"{file.name}: {file.stat().st_size // 1000} kB", file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the gallery or check it; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="draw nothing; fail if a picture is missing")
    parser.add_argument("--results", type=Path, default=Path("results/gallery"), help="folder of results and poses")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "gallery.md", help="the page")
    options = parser.parse_args(arguments)
    folder = options.page.parent / "images" / "gallery"
    page = options.page.read_text(encoding="utf-8")
    if not options.check:
        texts = draw(options.results, folder)
        before, _, rest = page.partition(BEGIN)
        after = rest.partition(END)[2]
        page = "\n".join([f"{before}{BEGIN}", "", *page_lines(texts), "", f"{END}{after}"])
        options.page.write_text(page, encoding="utf-8", newline="\n")
    found = faults(page, folder)
    for fault in found:
        print(fault, file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
