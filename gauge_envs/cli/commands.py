"""What the `gauge` command offers: its commands, the kinds of things that it lists, and the old spellings of both.

A new instrument is a folder in `gauge_envs.tools` and a line here. No tool is imported for the help of the command.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib import import_module
from typing import Any

from gauge_envs.errors import ParameterError

COMMANDS = {
    "list": ("catalog:list_", "List experiments; or backends, checks, phenomena, materials, scenes, ..."),
    "show": (
        "catalog",
        "Show one experiment or control task: reference, reward, spaces, engines, constants.",
    ),
    "run": ("run", "Run experiments, score them against reality, and write a result file for each."),
    "score": ("run", "Score a trajectory from your own simulator; no engine is needed."),
    "compare": ("compare", "Compare engines, parameters and settings: scores with intervals, ranks and pairs."),
    "plot": ("compare", "Draw results: experiments over real bands, a comparison, a diagnosis, or cost."),
    "diagnose": ("diagnose", "Split the error of episodes: release time, constant offset, rate of the motion, rest."),
    "report": ("site", "Write results as a static site: engines, phenomena, curves, errors and 3D replays."),
    "sweep": ("sweep", "Run engines, settings and experiments in all combinations; continue an earlier run."),
    "sanity": ("sanity", "Report which physics a training configuration gets wrong, and what corrects it."),
    "sanity probe": ("sanity", "Print a Python file that saves the settings of a training environment."),
    "sanity export": ("sanity", "Write the scenes of a sanity check for any simulator."),
    "sanity judge": ("sanity", "Report which physics a simulator gets wrong, from its motion in exported scenes."),
    "recipe": ("recipes", "Give contact settings of an engine for a measured behaviour, and what they reach."),
    "recipe fabrics": ("recipes", "Show the six fabrics in every engine's constants, and what is lost."),
    "recipe joint": ("identify", "Give friction, armature and gains of joints from logs, with intervals."),
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

OLD_SPELLINGS = {
    "film": "gauge video film",
    "materials": "gauge recipe fabrics",
    "envelope": "gauge transfer envelope",
    "query": "sqlite3 sweep/sweep.sqlite 'SELECT id, backend, score FROM results'",
    "export": "gauge video film RESULT --out FILE.rrd",
    "export rerun": "gauge video film RESULT --out FILE.rrd",
    "assets": "gauge data scenes",
    "assets build": "gauge data scenes",
    "assets list": "gauge list scenes",
    "assets isaac-sim": "gauge data isaac-sim",
    "backend list": "gauge list backends",
    "data status": "gauge list references",
    "video list": "gauge list video-tasks",
    "--wide": "--format wide",
    "--markdown": "--format markdown",
    "--isolate": "--limits isolate",
    "--time-limit-s": "--limits 60s",
    "--memory-limit-gb": "--limits 4GB",
    "--drivers": "--use imported-drivers",
    "--reference": "--use imported-reference",
    "--use-withheld": "--use withheld",
    "--task": "--id",
    "--engine": "--backend",
    "--html": "--out PAGE.html",
    "--figure": "--out FILE.png",
    "run --all": "'*'",
    "plot --pareto": "--kind cost",
    "compare --out": "gauge plot --kind compare --out DIR",
    "diagnose --out": "gauge plot --kind diagnose --out DIR",
    "sweep --jobs": "--shard 16",
    "sanity --list": "gauge list phenomena",
    "sanity --all": "--only '*'",
    "sanity judge --engine": "--label NAME",
    "recipe --list-materials": "gauge list materials",
    "recipe --material": "wood-on-wood",
    "transfer envelope --fraction": "--policy law:fraction=0.95",
    "transfer envelope --informed": "--policy law:informed=true",
    "backend check --list": "gauge list checks",
    "backend check --all": "'*:*'",
    "backend check --configuration": "ENGINE:CONFIGURATION",
    "backend check --report": "--out PAGE.html",
    "backend check --from": "FILE.json",
    "data download --pattern": "PATTERN",
    "data download --to": "--out DIR",
    "data import --only": "PATTERN",
    "video film --id": "--only ID",
    "video prompts --source": "URL",
    "video score --track": "FILE.csv",
    "video score --overlay": "--out DIR",
    "video report --first-frames": "--first-frame DIR",
}
"""Spellings of version 0.1 and what is written now; they go with the next release.

An option without a command is one of every command that no longer has it, and its new spelling follows the command,
unless that is another one. Options that are details now need no line: `--hold-s 1` is `hold_s=1`.
"""


def load(instrument: str, name: str) -> Any:
    """Return a function of an instrument's commands.

    Args:
        instrument: Name of its folder; behind a colon, the name of the function where it is another one.
        name: Name of the command.
    """
    folder, _, function = instrument.partition(":")
    module = import_module(f"gauge_envs.tools.{folder}.command")
    return getattr(module, function or re.sub(r"\W", "_", name))


def check_spelling(command: str, option: str = "", details: Iterable[str] = ()) -> None:
    """Raise an error that states the new spelling, if a command or an option has an old one.

    Args:
        command: Name of the command.
        option: An option that it does not have.
        details: Names of its details, NAME=VALUE.
    """
    old, plain = f"{command} {option}".strip(), option.removeprefix("--").replace("-", "_")
    new = OLD_SPELLINGS.get(old) or OLD_SPELLINGS.get(option)
    similar = [name for name in details if name.startswith(plain) or plain.startswith(f"{name}_")]
    if new is None and similar:
        new = f"{min(similar, key=lambda name: abs(len(name) - len(plain)))}=..."
    if new:
        full = new if not option or new.startswith("gauge ") else f"gauge {command} {new}"
        raise ParameterError(f"`gauge {old}` is now `{full}`")
