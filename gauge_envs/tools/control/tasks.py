"""List of the control tasks: their ids and entry points. It imports no engine and no task."""

from dataclasses import dataclass

from gauge_envs.errors import UnknownNameError

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
            episode_steps=episode_steps,
        )
        for family, (entry_point, materials, episode_steps) in FAMILIES.items()
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
