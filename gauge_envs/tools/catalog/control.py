"""Control tasks: a summary, and one task in full."""

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
from gauge_envs.pages.table import Facts
from gauge_envs.pages.text import heading, shortened


def control_summary() -> str:
    """Return the control tasks in a line."""
    ids = [task.id for task in control_tasks()]
    return f"extra, {len(ids)} control tasks whose optimum a law gives: {shortened(ids)}; gauge show explains one"


def control_description(task: ControlTask) -> dict[str, Any]:
    """Return what defines one control task, JSON-ready."""
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
    """Return the dictionary of `control_description` for a terminal."""
    limit = values["limit"]
    unit = "" if limit["unit"] == "1" else f" {limit['unit']}"
    return Group(
        Text(f"{values['id']}  control task", style="bold"),
        Facts(
            {
                "scene": f"that of {values['scene']}, with the action instead of the driver",
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
