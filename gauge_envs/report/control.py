"""Control tasks, for the command line."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any

import gymnasium
from rich.console import Group
from rich.text import Text

from gauge_envs.envs.control.env import ControlEnv
from gauge_envs.envs.control.tasks import ControlTask, control_tasks
from gauge_envs.files import json_ready
from gauge_envs.report.text import facts_grid, heading, shortened

__all__ = [
    "control_description",
    "control_summary",
    "control_view",
]


def control_summary() -> str:
    """The control tasks in a line."""
    ids = [task.id for task in control_tasks()]
    return f"extra, {len(ids)} control tasks whose optimum a law gives: {shortened(ids)}; gauge show explains one"


def control_description(task: ControlTask) -> dict[str, Any]:
    """What defines one control task, JSON-ready."""
    env = gymnasium.make(task.id).unwrapped
    assert isinstance(env, ControlEnv)
    bases = [base for base in type(env).__mro__ if issubclass(base, ControlEnv) and base is not ControlEnv]
    return json_ready(
        {
            "id": task.id,
            "scene": env.experiment.id,
            "duration_s": env.DURATION_S,
            "observed": env.OBSERVED,
            "limit": dataclasses.asdict(env.limit),
            "task": "\n\n".join((inspect.getdoc(base) or "").partition("\n\nArgs:")[0] for base in bases),
        }
    )


def control_view(values: Mapping[str, Any]) -> Group:
    """The dictionary of `control_description`, for reading."""
    limit = values["limit"]
    unit = "" if limit["unit"] == "1" else f" {limit['unit']}"
    return Group(
        Text(f"{values['id']}  control task", style="bold"),
        facts_grid(
            {
                "scene": f"that of {values['scene']}, where the action takes the driver's place",
                "episode": f"{values['duration_s']:g} s, one step is 1/30 s",
                "observed": ", ".join(values["observed"]),
                "law": limit["law"],
                "limit": f"{limit['quantity']}: {limit['value']:.4g} +- {limit['sigma']:.2g}{unit}",
                "uncertainty": limit["sigma_source"],
            }
        ),
        heading("Task"),
        Text(values["task"]),
    )
