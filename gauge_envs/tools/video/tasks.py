"""Define the video tasks: the law, the object, and its place in the known first frame.

All video models have the same first frames. Numbers in pixels were read by eye on their grid of 832 x 480 pixels, with
the origin in the top left corner. `tasks.toml` has the numbers.

The "real baseline" of the published table is not a measurement: its accelerations are g (sin 30 - mu cos 30) with the
published friction, and g. This package calls it the `law` of a task.
"""

import csv
import math
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from importlib.resources import files

from pydantic import TypeAdapter

from gauge_envs.errors import UnknownNameError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.references.tables import scoring_folder
from gauge_envs.scene import Scene
from gauge_envs.text import csv_text, toml_document

REFERENCE_SIZE_PX = (832, 480)
"""Width and height of the first frames, the grid of all pixel numbers."""

PLATE_RADIUS_PX = 225.5
"""Radius of the turntable with its rim in the first frames [px]."""


class MotionKind(StrEnum):
    """Kind of motion of a task; it determines the law and the tracking."""

    SLIDE = "slide"
    """A cube slides down a board with constant acceleration."""
    FALL = "fall"
    """A ball falls with constant acceleration until the first impact."""
    TURN = "turn"
    """A cube rides or slips on a turntable, moved by limited friction."""
    CRADLE = "cradle"
    """A row of hanging balls transfers the momentum of the first ball to the last."""
    PENDULUM = "pendulum"
    """A ball on a rod swings, damped."""


@dataclass(frozen=True, kw_only=True)
class VideoTask:
    """One task of the world-model track.

    Attributes:
        id: Id of the experiment in this suite, such as `SlopeSlider-2-wood`.
        motion: Kind of motion.
        size_m: Length for the scale: edge of a cube or diameter of a ball [m].
        size_px: This length in the first frame [px].
        centre_px: Centre of the tracked object in the first frame [px], shape [2]: the front face of a cube, or a ball.
        direction: Unit vector of a straight motion in the picture, shape [2]; None for other motions.
        pivot_px: Pivot of a swing or of the turntable [px], shape [2]; None for straight motions.
        rest_px: Position of the last ball of a cradle at rest [px], shape [2]; None for other motions.
        is_shiny: Whether reflections change the face of a rotating object.
        release_height_m: Release height of the incoming ball of a cradle [m].
        real: Mean and standard deviation of real trials by metric.
    """

    id: str
    motion: MotionKind
    size_m: float
    size_px: float
    centre_px: tuple[float, float]
    direction: tuple[float, float] | None = None
    pivot_px: tuple[float, float] | None = None
    rest_px: tuple[float, float] | None = None
    is_shiny: bool = False
    release_height_m: float = 0.0
    real: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def law(self) -> dict[str, float]:
        """Values of the law by metric: the column "real baseline" of the published table."""
        return {
            metric: values["real_baseline"]
            for (task, metric), values in published_values().items()
            if task == self.id
        }

    @property
    def scale_m_per_px(self) -> float:
        """Size of a pixel of the first frame at the depth of the object [m]."""
        return self.size_m / self.size_px

    @property
    def angle_deg(self) -> float:
        """Angle of a straight motion in the picture, from the right downwards [degrees]."""
        assert self.direction is not None
        return math.degrees(math.atan2(*self.direction[::-1]))

    @property
    def arm_length_px(self) -> float:
        """Length of the string or rod of a swing, or of the arm of a turntable [px]."""
        assert self.pivot_px is not None
        return math.dist(self.rest_px or self.centre_px, self.pivot_px)


@cache
def task_scene(task: str) -> Scene:
    """Return the scene of the task file of a task by its id."""
    return load_experiment(task).scene


@cache
def published_values() -> dict[tuple[str, str], dict[str, float]]:
    """Return Table 3 of GAUGE's paper: values by task and metric, then by "real_baseline" or model."""
    file = scoring_folder("published") / "world_model_results.csv"
    values = {}
    for row in csv.DictReader(csv_text(file.read_bytes())):
        task, metric, _unit = (row.pop(key) for key in ("variant", "metric", "unit"))
        values[task, metric] = {name: float(text) for name, text in row.items() if text}
    return values


def published_models() -> frozenset[str]:
    """Return the names of the models in Table 3 of GAUGE's paper."""
    names = {name for values in published_values().values() for name in values}
    return frozenset(names - {"real_baseline"})


@cache
def video_tasks() -> tuple[VideoTask, ...]:
    """Return all tasks, in the order of the published table."""
    file = files("gauge_envs.tools.video") / "tasks.toml"
    entries = toml_document(file.read_bytes())["task"]
    return TypeAdapter(tuple[VideoTask, ...]).validate_python(entries)


def video_task(name: str) -> VideoTask:
    """Return a task by the id of its experiment.

    Raises:
        UnknownNameError: The task does not exist; the message suggests similar names.
    """
    tasks = {task.id: task for task in video_tasks()}
    if name not in tasks:
        raise UnknownNameError("video task", name, list(tasks))
    return tasks[name]
