"""List of the control tasks: their ids and entry points."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from gymnasium.envs import registration

from gauge_envs.errors import UnknownNameError

if TYPE_CHECKING:
    from gauge_envs.pages.document import Document


@dataclass(frozen=True, kw_only=True)
class ControlTask:
    """One registered control task.

    Attributes:
        name: Name, as `Turntable-Limit-wood`.
        entry_point: Module and class of the environment, with a colon between.
        material: Material of the cube, the ball or the cloth.
    """

    name: str
    entry_point: str
    material: str

    @property
    def id(self) -> str:
        """Gymnasium id."""
        return f"GAUGE/{self.name}"


_TASKS = {
    "Turntable": ("gauge_envs.tools.control.turntable:TurntableLimit", ("wood", "plastic", "metal")),
    "SlopeSlider": ("gauge_envs.tools.control.slope_slider:SlopeSliderLimit", ("wood", "plastic", "metal")),
    "Pendulum": ("gauge_envs.tools.control.pendulum:PendulumLimit", ("metal",)),
    "Carry": ("gauge_envs.tools.control.carry:CarryLimit", ("wood", "plastic", "metal")),
    "Push": ("gauge_envs.tools.control.push:PushLimit", ("wood", "plastic", "metal")),
    "Throw": ("gauge_envs.tools.control.throw:ThrowLimit", ("rubber",)),
    "Fling": ("gauge_envs.tools.control.fling:FlingLimit", ("satin",)),
}


def control_tasks() -> tuple[ControlTask, ...]:
    """Return all control tasks; `gauge_envs.variants` does not list them."""
    return tuple(
        ControlTask(name=f"{family}-Limit-{material}", entry_point=entry_point, material=material)
        for family, (entry_point, materials) in _TASKS.items()
        for material in materials
    )


def find_control_task(name: str) -> ControlTask:
    """Return a control task by its name or Gymnasium id."""
    by_name = {task.name: task for task in control_tasks()}
    try:
        return by_name[name.removeprefix("GAUGE/")]
    except KeyError:
        raise UnknownNameError("control task", name, by_name) from None


# --- what the registry asks for --------------------------------------------------------------------------------------


def register() -> None:
    """Register every control task with Gymnasium; `import gauge_envs` calls this."""
    for task in control_tasks():
        if task.id not in registration.registry:
            registration.register(
                id=task.id,
                entry_point="gauge_envs.tools.control.wrapper:control_env",
                vector_entry_point="gauge_envs.tools.control.vector:ControlVectorEnv",
                kwargs={"task": task.name},
            )


def names() -> tuple[str, ...]:
    """Return the names of all control tasks, as `Turntable-Limit-wood`."""
    return tuple(task.name for task in control_tasks())


def summary() -> str:
    """Return the control tasks in a line."""
    from gauge_envs.pages.text import shortened

    ids = [task.id for task in control_tasks()]
    return f"extra, {len(ids)} control tasks whose optimum a law gives: {shortened(ids)}; gauge show explains one"


def document(name: str) -> "Document":
    """Return the page of a control task."""
    from gauge_envs.tools.control.page import control_description, control_document

    return control_document(control_description(find_control_task(name)))
