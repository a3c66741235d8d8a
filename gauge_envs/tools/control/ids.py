"""The Gymnasium ids of the control tasks, for the registry."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gymnasium.envs import registration

from gauge_envs.tools.control.tasks import control_tasks, find_control_task

if TYPE_CHECKING:
    from gauge_envs.pages.document import Document


def register() -> None:
    """Register every control task with Gymnasium; `import gauge_envs` calls this."""
    for task in control_tasks():
        if task.id not in registration.registry:
            registration.register(
                id=task.id,
                entry_point=task.entry_point,
                max_episode_steps=task.episode_steps,
                kwargs={"material": task.material},
            )


def names() -> tuple[str, ...]:
    """Return the names of all control tasks, as `Turntable-Limit-wood`."""
    return tuple(task.name for task in control_tasks())


def summary() -> str:
    """Return the control tasks in a line."""
    tasks = control_tasks()
    families = dict.fromkeys(task.name.rpartition("-")[0] for task in tasks)
    names = ", ".join(f"{family}-*" for family in families)
    return f"Control tasks with a theoretical maximum reward: {names}"


def document(name: str) -> Document:
    """Return the page of a control task."""
    from gauge_envs.tools.control.page import control_document

    return control_document(find_control_task(name))
