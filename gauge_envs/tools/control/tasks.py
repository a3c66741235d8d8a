"""The control tasks: their ids, for the registry, and their entry points. It imports no engine and no task."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from gymnasium.envs import registration

from gauge_envs.errors import UnknownNameError

if TYPE_CHECKING:
    from gauge_envs.pages.document import Document

CUBES = ("wood", "plastic", "metal")

EPISODE_STEPS = {
    "Turntable": 150,
    "SlopeSlider": 150,
    "Pendulum": 180,
    "Carry": 90,
    "Push": 60,
    "Throw": 90,
    "Fling": 120,
}
"""Steps of an episode of each family, 30 a second. Registration reads them without the modules of the tasks."""

FAMILIES = {
    "Turntable": ("friction:TurntableLimit", CUBES),
    "SlopeSlider": ("friction:SlopeSliderLimit", CUBES),
    "Pendulum": ("pendulum:PendulumLimit", ("metal",)),
    "Carry": ("least_time:CarryLimit", CUBES),
    "Push": ("least_time:PushLimit", CUBES),
    "Throw": ("throw:ThrowLimit", ("rubber",)),
    "Fling": ("fling:FlingLimit", ("satin",)),
}
"""Module and class of each family, and its materials."""


@dataclass(frozen=True, kw_only=True)
class ControlTask:
    """One registered control task.

    Attributes:
        name: Name, as `Turntable-Limit-wood`.
        entry_point: Module and class of the environment, with a colon between.
        material: Material of the cube, the ball or the cloth.
        episode_steps: Steps of an episode, one for each frame after the first.
    """

    name: str
    entry_point: str
    material: str
    episode_steps: int

    @property
    def id(self) -> str:
        """Gymnasium id."""
        return f"GAUGE/{self.name}"


def control_tasks() -> tuple[ControlTask, ...]:
    """Return all control tasks; `gauge_envs.variants` does not list them."""
    return tuple(
        ControlTask(
            name=f"{family}-Limit-{material}",
            entry_point=f"gauge_envs.tools.control.{entry_point}",
            material=material,
            episode_steps=EPISODE_STEPS[family],
        )
        for family, (entry_point, materials) in FAMILIES.items()
        for material in materials
    )


def find_control_task(name: str) -> ControlTask:
    """Return a control task by its name or Gymnasium id.

    Raises:
        UnknownNameError: There is no such task.
    """
    by_name = {task.name: task for task in control_tasks()}
    try:
        return by_name[name.removeprefix("GAUGE/")]
    except KeyError:
        raise UnknownNameError("control task", name, by_name) from None


# --- for the registry ---


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
    from gauge_envs.pages.text import shortened

    ids = [task.id for task in control_tasks()]
    return f"extra, {len(ids)} control tasks whose optimum a law gives: {shortened(ids)}; gauge show explains one"


def document(name: str) -> Document:
    """Return the page of a control task."""
    from gauge_envs.tools.control.page import control_document

    return control_document(find_control_task(name))
