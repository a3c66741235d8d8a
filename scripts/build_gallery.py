"""Draw the pictures of the gallery and write the list of `docs/gallery.md`: films of engines, and control tasks.

Results stay in a folder, so that a second run draws alone. The films need the engines that they show.
`build_environments` draws the experiments.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import gymnasium
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gauge_envs.backends.registry import backend_title
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.episodes import planned_results
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
    strip_picture,
)
from scripts.generated import ROOT, Request, page_part
from scripts.pictures import shrink

PAGE = ROOT / "docs" / "gallery.md"
SCRIPT = f"scripts/{Path(__file__).name}"

STRIP_SIZE = {"width": 320, "height": 240}
DRAWN_LARGER, MOVES_BY, MARGIN = 2, 24, 1.3
"""Size of the pictures from which strips are cut, over theirs; change of a colour that is a motion, of 255; and size of
the part that is shown over the part that moves."""
FILM_SIZE = {"width": 300, "height": 225}
FILM_FPS = 20.0
CONTROL_FRACTION = 0.98
"""Share of its limit that the law's policy uses in the pictures of control tasks."""


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


def controlled(name: str) -> tuple[list[NDArray[np.uint8]], list[float], str]:
    """Return the first, middle and last picture of a control task, their times, and what was reached."""
    large = {key: DRAWN_LARGER * value for key, value in STRIP_SIZE.items()}
    env = gymnasium.make(f"GAUGE/{name}", render_mode="rgb_array", **large)
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
    cropped = around_motion(pictures)
    return (
        [cropped[index] for index in chosen],
        [index / FRAME_RATE_HZ for index in chosen],
        note,
    )


def around_motion(pictures: Sequence[NDArray[np.uint8]]) -> list[NDArray[np.uint8]]:
    """Return the part of pictures in which something moves; the camera of a task shows all its goals."""
    frames = np.stack(pictures).astype(np.int16)
    moving = np.ptp(frames, axis=0).max(axis=2) > MOVES_BY
    rows, columns = (np.flatnonzero(moving.any(axis=axis)) for axis in (1, 0))
    height, width = moving.shape
    share = MARGIN * max(np.ptp(rows) / height, np.ptp(columns) / width)
    size = np.array([height, width]) * float(np.clip(share, 1.0 / DRAWN_LARGER, 1.0))
    middle = np.array([rows[0] + rows[-1], columns[0] + columns[-1]]) / 2.0
    top, left = np.clip(middle - size / 2.0, 0.0, np.array([height, width]) - size)
    box = (left, top, left + size[1], top + size[0])
    shown = (STRIP_SIZE["width"], STRIP_SIZE["height"])
    return [
        np.asarray(
            Image.fromarray(one).resize(shown, Image.Resampling.LANCZOS, box=box)
        )
        for one in pictures
    ]


# --- page ------------------------------------------------------------------------------------------------------------


def picture_name(name: str) -> str:
    """Return the file name of the strip of a control task."""
    return f"{name}.webp"


def film_name(film: FilmEntry) -> str:
    """Return the file name of a film."""
    return f"{film.name}.film.webp"


def engines(film: FilmEntry) -> str:
    """Return the engines of a film in words."""
    *first, last = (backend_title(backend) for backend in film.backends)
    return f"{', '.join(first)} and {last}"


def command(film: FilmEntry) -> str:
    """Return the command that makes a film from a folder of results."""
    to = "" if film.to_s is None else f" --until {film.to_s:g}"
    return f"gauge video film results --id {film.name} --speed {film.speed:g}{to} --out {film.name}.mp4"


def page_lines(texts: dict[str, str]) -> Iterator[str]:
    """Yield the lines of the list.

    Args:
        texts: Sentences of each control task.
    """
    yield "## Engines side by side"
    for film in FILMS:
        yield from ("", f"### {film.name} on {engines(film)}", "")
        yield from (
            f"![{film.name} on {engines(film)}](images/gallery/{film_name(film)})",
            "",
        )
        yield f"Speed x {film.speed:g}. `{command(film)}` makes it from results of these engines."
    yield from ("", "## Control tasks")
    for name in CONTROLS:
        yield from (
            "",
            f"### {name}",
            "",
            f"![{name} at three times](images/gallery/{picture_name(name)})",
            "",
        )
        yield texts[name]


# --- drawing ---------------------------------------------------------------------------------------------------------


def draw(results: Path, folder: Path) -> dict[str, str]:
    """Draw all pictures, and return the sentences of each control task."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {}
    for name in CONTROLS:
        texts[name] = draw_control(name, folder / picture_name(name))
        report(folder / picture_name(name))
    for film in FILMS:
        draw_film(film, results, folder / film_name(film))
        report(folder / film_name(film))
    return texts


def draw_control(name: str, out: Path) -> str:
    """Draw the strip of a control task, and return its sentences."""
    pictures, times_s, note = controlled(name)
    share = f"{100.0 * CONTROL_FRACTION:.0f} %"
    text = PanelText(
        title="MuJoCo", detail=f"policy of the law, {share} of its limit", note=note
    )
    caption = Caption(
        title=name,
        subtitle="Control task with a known optimum",
        reference="",
        simulated="",
    )
    save_still(
        strip_picture(
            [pictures], [text], caption, [f"{time_s:.2f} s" for time_s in times_s]
        ),
        out,
    )
    env = gymnasium.make(f"GAUGE/{name}")
    law = env.unwrapped.LAW
    env.close()
    return f"Law: {law}. The law's policy, with {share} of the limit: {note}."


def draw_film(film: FilmEntry, results: Path, out: Path) -> None:
    """Draw a film of several engines."""
    found = dict(result_of(film.name, backend, results) for backend in film.backends)
    options = FilmOptions(**FILM_SIZE, fps=FILM_FPS, speed=film.speed, to_s=film.to_s)
    raise_if_left_out(save_film(found, out, options))
    shrink(out)


def raise_if_left_out(left_out: Sequence[object]) -> None:
    """End the script if a result has no panel."""
    if left_out:
        raise SystemExit(f"left out: {left_out}")


def report(file: Path) -> None:
    """Print a file and its size."""
    print(f"{file.name}: {file.stat().st_size // 1000} kB", file=sys.stderr)


def measure(request: Request) -> None:
    """Run what has no result yet, draw everything, and write the list."""
    texts = draw(request.results, PAGE.parent / "images" / "gallery")
    part = "\n".join(page_lines(texts))
    for file, text in page_part(PAGE, "gallery", SCRIPT, part).items():
        file.write_text(text, encoding="utf-8", newline="\n")
