"""Score a video by the law of its motion: tasks, tracks, metrics and their uncertainty.

Example:
    >>> from gauge_envs.tools.video import video_tasks
    >>> [task.id for task in video_tasks()][:2]
    ['SlopeSlider-2-wood', 'SlopeSlider-2-plastic']
"""

from gauge_envs.tools.video.frames import FileFrames as FileFrames
from gauge_envs.tools.video.scoring import (
    METRICS as METRICS,
    VideoScore as VideoScore,
    score as score,
    score_track as score_track,
)
from gauge_envs.tools.video.tasks import (
    MotionKind as MotionKind,
    VideoTask as VideoTask,
    video_task as video_task,
    video_tasks as video_tasks,
)
from gauge_envs.tools.video.track import (
    Track as Track,
    read_track as read_track,
    save_track as save_track,
)
