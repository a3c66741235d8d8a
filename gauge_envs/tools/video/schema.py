"""JSON lines of `gauge video score` and `gauge list video-tasks`."""

from typing import Annotated, TypedDict

from gauge_envs.cli.schemas import Form
from gauge_envs.tools.video.frames import Registration
from gauge_envs.tools.video.scoring import VideoScore


class Registered(TypedDict):
    """Registration of the video on the reference grid; null without one."""

    registration: Registration | None


VideoLine = Annotated[VideoScore, Form(without=("track",), more=Registered)]
"""Result of one video."""


class TaskLine(TypedDict):
    """A task for videos.

    Attributes:
        task: Name of the task.
        motion: Kind of motion.
        size_mm: Size of the object [mm].
        size_px: Size of the object in the first frame [px].
        law: Values of the law, in words.
        real: Values of real trials, in words.
    """

    task: str
    motion: str
    size_mm: float
    size_px: float
    law: str
    real: str
