"""Scene files of the suite: USD layers, and experiment files, which name one.

`gauge_envs.registry.scene_files` gives this module to the core.
"""

from gauge_envs.tools.usd.experiment_file import (
    experiment_record as experiment_record,
    load_experiment_file as load_experiment_file,
    recorded_experiment_file as recorded_experiment_file,
)
from gauge_envs.tools.usd.reader import (
    read_points as read_points,
    read_usd as read_scene,
)
from gauge_envs.tools.usd.writer import to_usd as write_scene

__all__ = [
    "experiment_record",
    "load_experiment_file",
    "read_points",
    "read_scene",
    "recorded_experiment_file",
    "write_scene",
]
