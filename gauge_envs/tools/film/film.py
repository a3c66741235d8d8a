"""Films of result files: the episodes are run again and drawn side by side."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.registry import backend_title
from gauge_envs.errors import GaugeError, ParameterError, ResultFileError
from gauge_envs.evaluation.reference_path import reference_text
from gauge_envs.pages.results import (
    PLAIN,
    configuration_labels,
    configuration_parts,
    versions_text,
)
from gauge_envs.pages.text import short_id
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.replay import VIEWS_PER_FRAME, ReplayError
from gauge_envs.runs.result import Result
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.film.layout import Caption, FilmLayout
from gauge_envs.tools.film.panel import SimulatedPanel, Take, take_of
from gauge_envs.tools.video import check_film_format, film_writer

MOST_PANELS = 12
"""Largest number of panels of a film."""

LIMITS = {
    "width": (120, 4096, " pixels"),
    "height": (120, 4096, " pixels"),
    "fps": (1.0, 120.0, ""),
    "speed": (0.001, 100.0, ""),
}
"""Ranges of options; the text of a picture needs some room."""

HOLD_S = 1.0
"""Time for which the last frame stays [s]."""

MOST_FRAMES = 20_000
"""Largest number of frames of a film."""

Progress = Callable[[int, int], None]
"""Receiver of the number of pictures that are done, and of all."""


def _no_progress(done: int, count: int) -> None:
    """Receive the progress, and drop it."""


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """A result without a panel.

    Attributes:
        file: The result file.
        reason: Why it has none.
    """

    file: Path
    reason: str


@dataclass(frozen=True, kw_only=True)
class FilmOptions:
    """How a film shows its results.

    Attributes:
        width: Width of the picture of a panel [pixels].
        height: Height of the picture of a panel [pixels].
        from_s: Time of the first picture [s].
        to_s: Time of the last picture [s]; None for the end of the longest episode.
        fps: Frames a second of a film.
        speed: Seconds of the experiment in a second of a film.
        use_withheld: Whether to draw also a reference of low quality.
    """

    width: int = 480
    height: int = 360
    from_s: float = 0.0
    to_s: float | None = None
    fps: float = 30.0
    speed: float = 1.0
    use_withheld: bool = False

    def __post_init__(self) -> None:
        for name, (smallest, largest, unit) in LIMITS.items():
            value = getattr(self, name)
            # A comparison with NaN is false.
            if not smallest <= value <= largest:
                raise ParameterError(
                    f"{name} is {value:g}, expected {smallest:g} to {largest:g}{unit}"
                )
        if not 0.0 <= self.from_s < math.inf:
            raise ParameterError(f"from_s is {self.from_s:g}, expected 0 or more")
        if self.to_s is not None and not self.from_s <= self.to_s < math.inf:
            raise ParameterError(
                f"to_s is {self.to_s:g}, expected from_s = {self.from_s:g} or more"
            )

    @property
    def size(self) -> dict[str, int]:
        """Width and height of the picture of a panel [pixels], by name."""
        return {"width": self.width, "height": self.height}

    @property
    def views_per_frame(self) -> int:
        """Views of a replay in each 30 Hz frame that the film can show."""
        wanted = self.fps / self.speed / FRAME_RATE_HZ
        return next(
            (views for views in VIEWS_PER_FRAME if views >= wanted - 1e-9),
            VIEWS_PER_FRAME[-1],
        )


def results_of_one_experiment(
    results: Mapping[Path, Result], name: str | None = None
) -> dict[Path, Result]:
    """Return the results of one experiment.

    Args:
        results: Results by file.
        name: Id of the experiment, with or without `GAUGE/`; None if all are of one.
    """
    ids = sorted({short_id(result.id) for result in results.values()})
    if name is None and len(ids) > 1:
        raise ResultFileError(
            f"the results are of {len(ids)} experiments: {', '.join(ids)}; choose by --only"
        )
    if name is None and not ids:
        raise ResultFileError("no result is left to film; gauge run writes them")
    wanted = ids[0] if name is None else short_id(name)
    found = {
        file: result
        for file, result in results.items()
        if short_id(result.id) == wanted
    }
    if not found:
        raise ResultFileError(
            f"no result is of {wanted}; the results are of: {', '.join(ids) or 'nothing'}"
        )
    return found


def film_times(options: FilmOptions, last_s: float) -> NDArray[np.float64]:
    """Return the times of the frames [s], shape [frame_count]."""
    end_s = last_s if options.to_s is None else options.to_s
    if options.from_s > last_s:
        raise ParameterError(
            f"from_s is {options.from_s:g} s, and the longest episode ends at {last_s:.3f} s"
        )
    count = 1 + math.floor(
        (end_s - options.from_s) * options.fps / options.speed + 1e-6
    )
    if count > MOST_FRAMES:
        raise ParameterError(
            f"the film would have {count} frames, at most {MOST_FRAMES}: raise speed, or lower fps"
        )
    step_s = options.speed / options.fps
    return np.asarray(options.from_s + step_s * np.arange(count), dtype=np.float64)


def save_film(
    results: Mapping[Path, Result],
    out: Path,
    options: FilmOptions,
    *,
    progress: Progress = _no_progress,
) -> list[LeftOut]:
    """Write a film of results of one experiment, and return the results that have no panel.

    Args:
        results: Results by file, in the order of the panels.
        out: The film: `*.mp4`, `*.webp` or `*.gif`.
        options: How it shows them.
        progress: Receiver of what is done.
    """
    check_film_format(out)
    with ExitStack() as stack:
        panels, caption, left_out = _panels(results, options, stack)
        times_s = film_times(options, max(panel.last_s for panel in panels))
        layout = FilmLayout(
            [panel.text for panel in panels],
            caption,
            **options.size,
        )
        last_frames = round(HOLD_S * options.fps)
        writer = stack.enter_context(
            film_writer(out, size=layout.size, fps=options.fps)
        )
        for number, time_s in enumerate(times_s, 1):
            pictures = [panel.picture(float(time_s)) for panel in panels]
            frame = layout.frame(pictures, f"t = {time_s:.3f} s")
            writer.add(frame, times=1 + last_frames * (number == len(times_s)))
            progress(number, len(times_s))
    return left_out


# --- panels ---


def _panels(
    results: Mapping[Path, Result], options: FilmOptions, stack: ExitStack
) -> tuple[list[SimulatedPanel], Caption, list[LeftOut]]:
    """Return the panels, which the stack closes, the text of all, and the results that have none."""
    if len(results) > MOST_PANELS:
        raise ParameterError(
            f"{len(results)} panels: at most {MOST_PANELS} have room; name fewer result files"
        )
    takes: list[Take] = []
    left_out: list[LeftOut] = []
    views, use_withheld = options.views_per_frame, options.use_withheld
    for file, result in results.items():
        try:
            takes.append(
                take_of(result, file, views_per_frame=views, use_withheld=use_withheld)
            )
        except GaugeError as error:
            left_out.append(LeftOut(file=file, reason=str(error)))
    if not takes:
        reasons = "; ".join(f"{one.file.name}: {one.reason}" for one in left_out)
        raise ReplayError(f"no result can be drawn: {reasons}")
    panels: list[SimulatedPanel] = []
    configurations = [RunConfiguration.of(take.result) for take in takes]
    for take, configuration, title in zip(
        takes, configurations, _titles(configurations), strict=True
    ):
        detail = versions_text(configuration)
        panels.append(SimulatedPanel(take, title=title, detail=detail, **options.size))
        stack.callback(panels[-1].close)
    return panels, _caption(takes, options), left_out


def _titles(configurations: Sequence[RunConfiguration]) -> list[str]:
    """Return the engine of each configuration, and what they do not all share; the legend names the trial."""
    labels = configuration_labels(configurations)
    if len(configurations) == 1:
        parts = configuration_parts(configurations[0])
        labels = [
            ", ".join(
                text
                for kind, text in parts
                if (kind, text) != PLAIN and kind != "jitter"
            )
        ]
    split = [label.partition(", ") for label in labels]
    return [f"{backend_title(engine)}{comma}{rest}" for engine, comma, rest in split]


def _caption(takes: Sequence[Take], options: FilmOptions) -> Caption:
    experiment = takes[0].experiment
    end_s = max(take.last_s for take in takes) if options.to_s is None else options.to_s
    texts = [
        reference_text(one.band, one.reference, end_s=end_s, trial=one.experiment.trial)
        for one in takes
    ]
    remarks = []
    if options.speed != 1.0:
        remarks.append(f"speed x {options.speed:.3g}")
    if any(take.result.score.validation is not None for take in takes):
        remarks.append("score 1: mean distance of single real trials")
    return Caption(
        title=experiment.name,
        subtitle=experiment.title,
        reference="; ".join(filter(None, dict.fromkeys(texts))),
        remark=", ".join(remarks),
    )
