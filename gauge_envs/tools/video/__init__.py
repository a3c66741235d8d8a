"""Judge a video by the law that its motion follows: tasks, tracks, metrics and their uncertainty.

Example:
    >>> from gauge_envs.tools.video import video_tasks
    >>> [task.id for task in video_tasks()][:2]
    ['SlopeSlider-2-wood', 'SlopeSlider-2-plastic']
"""

from gauge_envs.tools.video.frames import FileFrames
from gauge_envs.tools.video.plane import Lens, PlaneView, PointPairs, read_camera
from gauge_envs.tools.video.scoring import METRICS, Grade, VideoScore, score, score_track
from gauge_envs.tools.video.tasks import Motion, VideoTask, video_task, video_tasks
from gauge_envs.tools.video.track import Event, Track, read_track

__all__ = [
    "METRICS",
    "Event",
    "FileFrames",
    "Grade",
    "Lens",
    "Motion",
    "PlaneView",
    "PointPairs",
    "Track",
    "VideoScore",
    "VideoTask",
    "read_camera",
    "read_track",
    "score",
    "score_track",
    "video_task",
    "video_tasks",
]
