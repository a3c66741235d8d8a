"""The page of a control task in `gauge show`."""

import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any

import gymnasium

from gauge_envs.files import json_ready
from gauge_envs.pages.document import Document, Heading, Paragraph, Tone
from gauge_envs.pages.table import Facts
from gauge_envs.pages.text import with_unit
from gauge_envs.tools.control.env import ControlEnv
from gauge_envs.tools.control.tasks import ControlTask


def control_description(task: ControlTask) -> dict[str, Any]:
    """Return what defines one control task, JSON-ready."""
    env = gymnasium.make(task.id).unwrapped
    assert isinstance(env, ControlEnv)
    bases = [
        base
        for base in type(env).__mro__
        if issubclass(base, ControlEnv) and base is not ControlEnv
    ]
    return json_ready(
        {
            "id": task.id,
            "scene": env.experiment.id,
            "duration_s": env.duration_s,
            "observed": env.OBSERVED,
            "limit": dataclasses.asdict(env.limit),
            "task": "\n\n".join(
                (inspect.getdoc(base) or "").partition("\n\nArgs:")[0] for base in bases
            ),
        }
    )


def control_document(values: Mapping[str, Any]) -> Document:
    """Return the dictionary of `control_description` in words."""
    limit = values["limit"]
    value = with_unit(f"{limit['value']:.4g} +- {limit['sigma']:.2g}", limit["unit"])
    facts = {
        "scene": f"that of {values['scene']}, with the action instead of the driver",
        "episode": f"{values['duration_s']:g} s, one step is 1/30 s",
        "observed": ", ".join(values["observed"]),
        "law": limit["law"],
        "limit": f"{limit['quantity']}: {value}",
        "uncertainty": limit["sigma_source"],
    }
    title = Paragraph(f"{values['id']}  control task", Tone.ANSWER)
    # Docstrings are wrapped at the width of the code.
    task = (
        Paragraph(" ".join(lines.split())) for lines in values["task"].split("\n\n")
    )
    return Document(parts=(title, Facts(facts), Heading("Task"), *task), rows=[values])
