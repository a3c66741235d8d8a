"""Write changes of settings into the text of a model."""

from __future__ import annotations

from gauge_envs.tools.sanity.model import Settings
from gauge_envs.tools.sanity.robot.mjcf_text import TextChange
from gauge_envs.tools.sanity.robot.robot import ELEMENT_FIELDS, Robot
from gauge_envs.tools.sanity.stacks.dialect import Dialect


def write_change(
    robot: Robot, dialect: Dialect, changes: Settings
) -> tuple[TextChange | None, list[str]]:
    """Return a change in the text of a model, and names of elements whose attributes the text does not show.

    Each attribute is changed where the model gives it; others are added to the default.

    Args:
        robot: The robot before the change; without a text, there is none after it.
        dialect: Dialect of the model.
        changes: The change, as `Robot.changed` takes it.
    """
    text = None if robot.text is None else TextChange(robot.text)
    hidden: list[str] = []
    sections: dict[str, dict[str, str]] = {}
    _, places = robot.changed(changes)
    for setting in dialect.settings:
        name, place, key = setting.name, setting.place, setting.key
        if name not in changes:
            continue
        value = (setting.text or dialect.text)(changes[name])
        tags = {"flag": "option flag", "option": "option"}.get(
            place, f"default {place}"
        )
        is_new = name not in ELEMENT_FIELDS
        reached = robot.reached_by_default(name)
        for kind, number in places.get(name, ()):
            is_default = kind == "geom" and number in reached
            model = robot.text
            element = (
                None if model is None else model.element(robot.model, kind, number)
            )
            if text is not None and (element is not None or is_default):
                is_new |= not text.give(element, kind, key, value)
            elif not is_default:
                hidden.append(robot.place_text((kind, number)))
        if is_new:
            sections.setdefault(tags, {})[key] = value
    for tags, values in sections.items():
        if text is not None:
            text.put(tuple(tags.split()), values)
    return text, hidden
