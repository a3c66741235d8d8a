"""Write changes of settings into the text of a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from gauge_envs.errors import first_names
from gauge_envs.tools.sanity.model import Settings
from gauge_envs.tools.sanity.robot.mjcf_text import TextChange
from gauge_envs.tools.sanity.robot.robot import ELEMENT_FIELDS, Robot

MAX_NAMES = 6
"""Most elements that a text names one by one."""

Assignment = tuple[str, str, str]
"""Place of a setting in the text, such as `option`, its key there, and its new value."""


@dataclass(kw_only=True)
class WrittenChange:
    """A change in the text of a model.

    Attributes:
        text: The changed text; None where the model's text is not known.
        in_default: Settings that sections and the default of all state.
        elsewhere: What other elements are to state, in words.
    """

    text: TextChange | None
    in_default: list[str] = field(default_factory=list)
    elsewhere: list[str] = field(default_factory=list)

    @property
    def lines(self) -> tuple[str, ...]:
        """Changed lines, which start with `- ` or `+ `; empty where the text is not known."""
        return () if self.text is None else self.text.diff


def write_change(
    robot: Robot, changes: Settings, assignments: Mapping[str, Assignment]
) -> WrittenChange:
    """Return a change in the text of a model: each attribute where the model states it, or in the default of all.

    Args:
        robot: The robot before the change.
        changes: The change, as `Robot.changed` takes it.
        assignments: Place, key and text of each of its settings.
    """
    text = None if robot.text is None else TextChange(robot.text)
    written = WrittenChange(text=text)
    sections: dict[str, dict[str, str]] = {}
    _, places = robot.changed(changes)
    for name, (place, key, value) in assignments.items():
        if name not in ELEMENT_FIELDS:
            written.in_default.append(name)
            tags = "option flag" if place == "flag" else place
            sections.setdefault(tags, {})[key] = value
            continue
        stated = [_stated(robot, text, name, one, {key: value}) for one in places[name]]
        if None in stated:
            sections.setdefault(f"default {place}", {})[key] = value
        if {None, ""} & {*stated}:
            written.in_default.append(name)
        if named := [*dict.fromkeys(filter(None, stated))]:
            listed = first_names(named, MAX_NAMES)
            written.elsewhere.append(f'{key}="{value}" in {listed}')
    for tags, values in sections.items():
        if text is not None:
            text.put(tuple(tags.split()), values)
    return written


def _stated(
    robot: Robot,
    text: TextChange | None,
    name: str,
    place: tuple[str, int],
    values: Mapping[str, str],
) -> str | None:
    """Write an attribute of an element, and return where; None where the default of all is to state it newly."""
    kind, number = place
    element = None if text is None else text.model.element(robot.model, kind, number)
    is_of_all = kind == "geom" and number in robot.reached_by_default(name)
    if text is not None and (element is not None or is_of_all):
        return text.state(element, kind, values)
    return None if is_of_all else robot.place_text(place)
