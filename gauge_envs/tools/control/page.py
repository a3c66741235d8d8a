"""The page of a control task in `gauge show`."""

import inspect

import gymnasium

from gauge_envs.files import json_ready
from gauge_envs.pages.document import Document, Heading, Paragraph, Tone
from gauge_envs.pages.table import Facts
from gauge_envs.pages.text import with_unit
from gauge_envs.tools.control.env import ControlEnv
from gauge_envs.tools.control.tasks import ControlTask


def control_document(task: ControlTask) -> Document:
    """Return the definition of a control task, as text and as a JSON-ready object."""
    env = gymnasium.make(task.id).unwrapped
    assert isinstance(env, ControlEnv)
    limit = env.limit
    # The docstrings of the task and of the base that it shares with a similar task, without their arguments.
    bases = [base for base in type(env).mro()[:2] if base is not ControlEnv]
    texts = [(inspect.getdoc(base) or "").partition("\n\nArgs:")[0] for base in bases]
    text = "\n\n".join(texts)
    row = {
        "id": task.id,
        "scene": env.experiment.id,
        "duration_s": env.duration_s,
        "observed": env.OBSERVED,
        "limit": vars(limit),
        "task": text,
    }
    value = with_unit(f"{limit.value:.4g} +- {limit.sigma:.2g}", limit.unit)
    facts = {
        "scene": f"that of {env.experiment.id}, with the action instead of the driver",
        "episode": f"{env.duration_s:g} s, one step is 1/30 s",
        "observed": ", ".join(env.OBSERVED),
        "law": limit.law,
        "limit": f"{limit.quantity}: {value}",
        "uncertainty": limit.sigma_source,
    }
    title = Paragraph(f"{task.id}  control task", Tone.ANSWER)
    # Docstrings are wrapped at the width of the code.
    paragraphs = (Paragraph(" ".join(part.split())) for part in text.split("\n\n"))
    return Document(
        parts=(title, Facts(facts), Heading("Task"), *paragraphs),
        rows=[json_ready(row)],
    )
