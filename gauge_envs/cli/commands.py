"""What the `gauge` command offers: its commands, and the kinds of things that it lists.

A new instrument is a folder in `gauge_envs.tools` and a line here. No tool is imported for the help of the command.
"""

import re
from collections.abc import Iterable
from importlib import import_module
from typing import Any

from gauge_envs.errors import ParameterError

COMMANDS = {
    "list": ("catalog:list_", "List experiments; or backends, checks, phenomena, materials, scenes, ..."),
    "show": ("catalog", "Show one experiment or control task: reference, reward, spaces, engines, constants."),
    "run": ("run", "Run experiments, score them against reality, and write a result file for each."),
    "score": ("run", "Score a trajectory from your own simulator; no engine is needed."),
    "compare": ("compare", "Compare engines, parameters and settings: scores with intervals, ranks and pairs."),
    "plot": ("compare", "Draw results: experiments over real bands, a comparison, a diagnosis, or cost."),
    "diagnose": ("diagnose", "Split the error of episodes: release time, constant offset, rate of the motion, rest."),
    "report": ("site", "Write results as a static site: engines, phenomena, curves, errors and 3D replays."),
    "sweep": ("sweep", "Run engines, settings and experiments in all combinations; continue an earlier run."),
    "sanity": ("sanity", "Report which physics a training configuration gets wrong, and what corrects it."),
    "sanity probe": ("sanity", "Print a Python file that saves the settings of a training environment."),
    "recipe": ("recipes", "Give contact settings of an engine for a measured behaviour, and what they reach."),
    "recipe fabrics": ("recipes", "Show the six fabrics in every engine's constants, and what is lost."),
    "recipe joint": ("identify", "Give friction, armature and gains of joints from logs, with 95 % intervals."),
    "transfer": ("transfer", "Replay trained policies in other engines: how much of their reward do they keep?"),
    "transfer envelope": ("transfer", "Show what uncertain constants and starts do to a reward or a score."),
    "backend": ("", "Check physics engines."),
    "backend check": ("conformance", "Check engines against closed forms, with a diagnosis of each failure."),
    "data": ("", "Real trials and scenes: download, import, write for other tools."),
    "data download": ("dataset", "Download the GAUGE dataset (10 GB in all); an interrupted download resumes."),
    "data import": ("dataset", "Make bands and drivers of real trials, beside the published baselines; offline."),
    "data scenes": ("assets", "Write every scene as USD and MJCF, and every solid as OBJ."),
    "data isaac-sim": ("assets", "Write experiments as USD layers that Isaac Sim simulates."),
    "video": ("", "Film results, and judge videos of world models by the laws of motion."),
    "video film": ("film", "Film results of one experiment side by side, or write one for the Rerun viewer."),
    "video prompts": ("video", "Fetch the first frame and the prompt of each task of the benchmark (3 MB)."),
    "video board": ("video", "Write a board to print, beside which a phone held by hand can film a motion."),
    "video render": ("video", "Make a video of an engine with the view of the first frame of a task."),
    "video score": ("video", "Follow the object in videos, fit the law of the task, and report its metrics."),
    "video report": ("video", "Score the videos of many models, and write a page with a table and pictures."),
    "leaderboard": ("", "Check and rank results that vendors of engines submit as files."),
    "leaderboard check": ("leaderboard", "Check submissions: layout, versions, task hashes, trajectories and scores."),
    "leaderboard table": ("leaderboard", "Print scores of all submissions without faults: intervals, ranks and pairs."),
}
"""Instrument and line in the help of each command; a group has no instrument.

A name of two words is listed in the help of the first one. The function in `gauge_envs.tools.INSTRUMENT.command` has
the name of the command.
"""

LISTINGS = {
    "backends": "conformance",
    "checks": "conformance",
    "phenomena": "sanity",
    "materials": "recipes",
    "video-tasks": "video",
    "scenes": "assets",
    "references": "dataset",
}
"""Instrument of each kind that `gauge list` knows beside experiments; `list_KIND` takes patterns and returns tables."""

DRAWINGS = {"experiments": "compare", "compare": "compare", "diagnose": "diagnose", "cost": "compare"}
"""Instrument of each kind of picture of `gauge plot`; `draw_KIND` returns files and the number of skipped results."""


def load(instrument: str, name: str) -> Any:
    """Return a function of an instrument's commands.

    Args:
        instrument: Name of its folder; behind a colon, the name of the function where it is another one.
        name: Name of the command.
    """
    folder, _, function = instrument.partition(":")
    module = import_module(f"gauge_envs.tools.{folder}.command")
    return getattr(module, function or re.sub(r"\W", "_", name))


def check_spelling(command: str, option: str, details: Iterable[str]) -> None:
    """Raise an error that states the detail which an option is meant for: `--hold-s 1` is `hold_s=1`.

    Args:
        command: Name of the command.
        option: An option that it does not have.
        details: Names of its details, NAME=VALUE.
    """
    plain = option.removeprefix("--").replace("-", "_")
    similar = [name for name in details if name.startswith(plain) or plain.startswith(f"{name}_")]
    if similar:
        nearest = min(similar, key=lambda name: abs(len(name) - len(plain)))
        raise ParameterError(f"`gauge {command} {option}` is `gauge {command} {nearest}=...`")
