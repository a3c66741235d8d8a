"""Films and strips of result files: the episodes are run again and drawn side by side."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

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
from gauge_envs.tools.film.layout import Caption, FilmLayout, PanelText
from gauge_envs.tools.film.panel import (
    Panel,
    RecordedPanel,
    SimulatedPanel,
    Take,
    take_of,
)
from gauge_envs.tools.video import (
    check_film_format,
    check_suffix,
    film_writer,
    written_whole,
)

MOST_PANELS = 12
"""Largest number of panels of a film."""

LIMITS = {
    "width": (120, 4096, " pixels"),
    "height": (120, 4096, " pixels"),
    "columns": (1, MOST_PANELS, ""),
    "fps": (1.0, 120.0, ""),
    "speed": (0.001, 100.0, ""),
    "hold_s": (0.0, 60.0, ""),
}
"""Ranges of options; the text of a picture needs some room."""

MOST_FRAMES = 20_000
"""Largest number of frames of a film."""

STRIP_FORMATS: dict[str, dict[str, Any]] = {
    ".png": {"optimize": True},
    ".webp": {"quality": 82, "method": 6},
}
"""Options of Pillow by the suffix of a strip."""

Progress = Callable[[int, int], None]
"""Receiver of the number of pictures that are done, and of all."""


def _no_progress(done: int, count: int) -> None:
    """Receive the progress, and drop it."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A real recording beside the simulations.

    Attributes:
        file: Video file.
        start_s: Time in the video at which the experiment starts [s].
        rate_hz: Pictures that the camera took in a second of the experiment; None for the times in the file.
    """

    file: Path
    start_s: float = 0.0
    rate_hz: float | None = None


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
    """How a film or a strip shows its results.

    Attributes:
        width: Width of the picture of a panel [pixels].
        height: Height of the picture of a panel [pixels].
        columns: Panels in a row of a film; None for at most four.
        from_s: Time of the first picture [s].
        to_s: Time of the last picture [s]; None for the end of the longest episode.
        fps: Frames a second of a film.
        speed: Seconds of the experiment in a second of a film.
        hold_s: Time for which the last frame of a film stays [s].
        use_withheld: Whether to draw also a reference of low quality.
        recording: A real recording as the first panel, or None.
    """

    width: int = 480
    height: int = 360
    columns: int | None = None
    from_s: float = 0.0
    to_s: float | None = None
    fps: float = 30.0
    speed: float = 1.0
    hold_s: float = 1.0
    use_withheld: bool = False
    recording: Recording | None = None

    def __post_init__(self) -> None:
        for name, (smallest, largest, unit) in LIMITS.items():
            value = getattr(self, name)
            # A comparison with NaN is false.
            if value is not None and not smallest <= value <= largest:
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
            columns=options.columns,
            **options.size,
        )
        last_frames = round(options.hold_s * options.fps)
        writer = stack.enter_context(
            film_writer(out, size=layout.size, fps=options.fps)
        )
        for number, time_s in enumerate(times_s, 1):
            pictures = [panel.picture(float(time_s)) for panel in panels]
            frame = layout.frame(pictures, f"t = {time_s:.3f} s")
            writer.add(frame, times=1 + last_frames * (number == len(times_s)))
            progress(number, len(times_s))
    return left_out


def save_strip(
    results: Mapping[Path, Result],
    out: Path,
    options: FilmOptions,
    *,
    count: int = 3,
    progress: Progress = _no_progress,
) -> list[LeftOut]:
    """Write pictures at a few times beside each other, a row for each result, and return the results without a row.

    Args:
        results: Results by file, in the order of the rows.
        out: The strip: `*.png` or `*.webp`.
        options: How it shows them; speed and frame rate do not matter.
        count: Number of pictures in a row, the first and the last one included.
        progress: Receiver of what is done.
    """
    check_suffix(out, list(STRIP_FORMATS))
    if not 1 <= count <= MOST_PANELS:
        raise ParameterError(f"a strip of {count} pictures: choose 1 to {MOST_PANELS}")
    with ExitStack() as stack:
        panels, caption, left_out = _panels(results, options, stack)
        last_s = max(panel.last_s for panel in panels)
        film_times(options, last_s)
        end_s = last_s if options.to_s is None else options.to_s
        times_s = np.linspace(options.from_s, end_s, count)
        pictures: list[NDArray[np.uint8]] = []
        texts: list[PanelText] = []
        for number, panel in enumerate(panels, 1):
            pictures += [panel.picture(float(time_s)) for time_s in times_s]
            row = [
                PanelText(title="", detail=f"{time_s:.2f} s", note="")
                for time_s in times_s
            ]
            # A row has its title and its score under the first picture, and its versions under the last one.
            row[-1] = replace(row[-1], note=panel.text.detail)
            row[0] = replace(row[0], title=panel.text.title, note=panel.text.note)
            texts += row
            progress(number, len(panels))
        layout = FilmLayout(texts, caption, columns=count, **options.size)
        with written_whole(out) as part:
            Image.fromarray(layout.frame(pictures)).save(
                part, format=out.suffix[1:], **STRIP_FORMATS[out.suffix.lower()]
            )
    return left_out


# --- panels ---


def _panels(
    results: Mapping[Path, Result], options: FilmOptions, stack: ExitStack
) -> tuple[list[Panel], Caption, list[LeftOut]]:
    """Return the panels, which the stack closes, the text of all, and the results that have none."""
    recording = options.recording
    count = len(results) + (recording is not None)
    if count > MOST_PANELS:
        raise ParameterError(
            f"{count} panels: at most {MOST_PANELS} have room; name fewer result files"
        )
    panels: list[Panel] = []
    # Before the runs, which may take minutes.
    if recording is not None:
        panels.append(
            RecordedPanel(
                recording.file,
                start_s=recording.start_s,
                rate_hz=recording.rate_hz,
                **options.size,
            )
        )
        stack.callback(panels[-1].close)
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
