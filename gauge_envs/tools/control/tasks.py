"""List of the control tasks: their ids and entry points."""

from dataclasses import dataclass

from gauge_envs.errors import UnknownNameError


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

_TASKS = {
    "Turntable": (
        "gauge_envs.tools.control.turntable:TurntableLimit",
        ("wood", "plastic", "metal"),
    ),
    "SlopeSlider": (
        "gauge_envs.tools.control.slope_slider:SlopeSliderLimit",
        ("wood", "plastic", "metal"),
    ),
    "Pendulum": ("gauge_envs.tools.control.pendulum:PendulumLimit", ("metal",)),
    "Carry": (
        "gauge_envs.tools.control.carry:CarryLimit",
        ("wood", "plastic", "metal"),
    ),
    "Push": ("gauge_envs.tools.control.push:PushLimit", ("wood", "plastic", "metal")),
    "Throw": ("gauge_envs.tools.control.throw:ThrowLimit", ("rubber",)),
    "Fling": ("gauge_envs.tools.control.fling:FlingLimit", ("satin",)),
}


def control_tasks() -> tuple[ControlTask, ...]:
    """Return all control tasks; `gauge_envs.variants` does not list them."""
    return tuple(
        ControlTask(
            name=f"{family}-Limit-{material}",
            entry_point=entry_point,
            material=material,
            episode_steps=EPISODE_STEPS[family],
        )
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
