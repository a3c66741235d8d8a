"""The Gymnasium ids of the control tasks, for the registry. It imports no engine and no task."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING

import gymnasium
from gymnasium.envs import registration

if TYPE_CHECKING:
    from gauge_envs.pages.document import Document

CUBES = ("wood", "plastic", "metal")

FAMILIES = {
    "Turntable": ("friction:TurntableLimit", CUBES, 150),
    "SlopeSlider": ("friction:SlopeSliderLimit", CUBES, 150),
    "Pendulum": ("pendulum:PendulumLimit", ("metal",), 180),
    "Carry": ("least_time:CarryLimit", CUBES, 90),
    "Push": ("least_time:PushLimit", CUBES, 60),
    "Throw": ("throw:ThrowLimit", ("rubber",), 90),
    "Fling": ("fling:FlingLimit", ("satin",), 120),
}
"""Module and class of each family, its materials, and the steps of an episode, 30 a second.

Registration reads them without the modules of the tasks.
"""


ENTRY_POINT = "gauge_envs.tools.control"


def register() -> None:
    """Register every control task with Gymnasium; `import gauge_envs` calls this."""
    for family, (_, materials, episode_steps) in FAMILIES.items():
        for material in materials:
            key = f"GAUGE/{family}-Limit-{material}"
            if key not in registration.registry:
                registration.register(
                    id=key,
                    entry_point=f"{ENTRY_POINT}.env:ControlEnv",
                    vector_entry_point=f"{ENTRY_POINT}.env:ControlVectorEnv",
                    max_episode_steps=episode_steps,
                    kwargs={"family": family, "material": material},
                )


def names() -> tuple[str, ...]:
    """Return the names of all control tasks, as `Turntable-Limit-wood`."""
    return tuple(
        f"{family}-Limit-{material}"
        for family, (_, materials, _) in FAMILIES.items()
        for material in materials
    )


def summary() -> str:
    """Return the control tasks in a line."""
    families = ", ".join(f"{family}-Limit-*" for family in FAMILIES)
    return f"Control tasks with a theoretical maximum reward: {families}"


def document(name: str) -> Document:
    """Return the page of a control task, as text and as a JSON-ready object."""
    from gauge_envs.files import json_ready
    from gauge_envs.pages.document import Document, Heading, Paragraph, Tone
    from gauge_envs.pages.table import Facts
    from gauge_envs.pages.text import with_unit

    task = gymnasium.make(f"GAUGE/{name}").unwrapped.task  # type: ignore[attr-defined]
    limit = task.limit()
    # The docstrings of the task and of its base, without their arguments.
    bases = type(task).mro()[:2]
    texts = [(inspect.getdoc(base) or "").partition("\n\nArgs:")[0] for base in bases]
    text = "\n\n".join(texts)
    row = {
        "id": f"GAUGE/{name}",
        "scene": task.experiment.id,
        "duration_s": task.duration_s(),
        "observed": task.OBSERVED,
        "limit": vars(limit),
        "return_limit": task.return_limit(),
        "task": text,
    }
    value = with_unit(f"{limit.value:.4g} +- {limit.sigma:.2g}", limit.unit)
    facts = {
        "scene": f"that of {task.experiment.id}, for {task.duration_s():g} s",
        "observed": ", ".join(task.OBSERVED),
        "law": limit.law,
        "limit": f"{limit.quantity}: {value}",
        "largest return": f"{task.return_limit():.4g}",
        "uncertainty": limit.sigma_source,
    }
    title = Paragraph(f"GAUGE/{name}  control task", Tone.ANSWER)
    # Docstrings are wrapped at the width of the code.
    paragraphs = (Paragraph(" ".join(part.split())) for part in text.split("\n\n"))
    return Document(
        parts=(title, Facts(facts), Heading("Task"), *paragraphs),
        rows=[json_ready(row)],
    )
