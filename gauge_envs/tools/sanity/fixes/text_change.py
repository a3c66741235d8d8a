"""Change attributes in the text of a model, so that a diff shows only these."""

import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gauge_envs.backends.mujoco.options import (
    DISABLE_FLAGS,
    ENABLE_FLAGS,
    NAMED_OPTIONS,
    SAME_NAME_OPTIONS,
)
from gauge_envs.tools.sanity.fixes.change import (
    ELEMENT_FIELDS,
    EQUALITY_FIELDS,
    GEOM_FIELDS,
    changed_model,
    reached_by_default,
)
from gauge_envs.tools.sanity.robot.model_text import ATTRIBUTE, Element, ModelText
from gauge_envs.tools.sanity.robot.robot import Robot
from gauge_envs.tools.sanity.verdict import Settings


def attribute_text(value: Any) -> str:
    """Return a value as an attribute of MJCF: numbers with six digits and spaces."""
    if isinstance(value, str):
        return value
    return " ".join(f"{number:.6g}" for number in np.ravel(value))


class Attribute(NamedTuple):
    """An attribute of MJCF.

    Attributes:
        place: Element that has it.
        key: Its name there.
        text: Function from a value of the setting to its text.
    """

    place: str
    key: str
    text: Callable[[Any], str] = attribute_text


OPTIONS = (*NAMED_OPTIONS, *SAME_NAME_OPTIONS, "jacobian")
"""Settings that are called as in MJCF."""

ATTRIBUTES = {
    "timestep_s": Attribute("option", "timestep"),
    **{name: Attribute("geom", key) for name, key in GEOM_FIELDS.items()},
    **{name: Attribute("equality", key) for name, key in EQUALITY_FIELDS.items()},
    **{name: Attribute("option", name) for name in OPTIONS},
    **{
        name: Attribute("flag", name, lambda is_on: "enable" if is_on else "disable")
        for name in (*DISABLE_FLAGS, *ENABLE_FLAGS)
    },
}
"""Attribute of each setting: of `<option>`, of its `<flag>`, and of the defaults."""


def paste_text(changes: Settings) -> str:
    """Return changes of settings, new values by name, as elements that can be pasted into a model."""
    entries: dict[str, str] = {}
    for name, value in changes.items():
        place, key, text = ATTRIBUTES[name]
        entries[place] = f'{entries.get(place, "")} {key}="{text(value)}"'
    flags = entries.pop("flag", "")
    option = entries.pop("option", "")
    end = f"><flag{flags}/></option>" if flags else "/>"
    parts = [f"<option{option}{end}"] if option or flags else []
    parts += [f"<default><{kind}{entries[kind]}/></default>" for kind in entries]
    return " and ".join(parts)


FIRST = ("compiler", "option", "size", "statistic", "visual")
"""Sections in front of which no other one is inserted."""

SCREEN = 100
"""Longest line that is shown with all of its attributes [characters]."""


SECTION_TAGS = {"option": ("option",), "flag": ("option", "flag")}
"""Tags of the sections of options; all other sections are defaults."""


class TextChange:
    """Changes of attributes in the text of a model file.

    Args:
        model: Texts of the model.
    """

    def __init__(self, model: ModelText) -> None:
        self.model = model
        self._values: dict[tuple[Element, str], str] = {}
        self._inserted: list[tuple[int, int, str]] = []

    def give(self, element: Element | None, kind: str, key: str, value: str) -> bool:
        """Change an attribute where an element, or None for the default of a kind, takes it from; else return False."""
        for source in self._sources(element, kind):
            if key in source.values:
                self._values[source, key] = value
                return True
        return False

    def correct(self, element: Element, key: str, value: str) -> None:
        """Give an element an attribute, or its `<inertial>`, where that has it."""
        inner = (child for child in element.at("inertial") if key in child.values)
        self._values[next(inner, element), key] = value

    def _sources(self, element: Element | None, kind: str) -> Iterator[Element]:
        """Yield an element, those of its classes, the nearest first, and last those of the default of all."""
        if element is not None:
            yield element
            names = (
                outer.values.get("childclass" if step else "class")
                for step, outer in enumerate(element.outer())
            )
            name = next(filter(None, names), None)
            for default in self.model.root.inner():
                if default.tag == "default" and default.values.get("class") == name:
                    for above in default.outer():
                        yield from reversed(above.at(kind))
        yield from reversed(self.model.root.at("default", kind))

    def put(self, tags: tuple[str, ...], values: Mapping[str, str]) -> None:
        """Give a section attributes: in place, or in an inserted section.

        Args:
            tags: Tags of its parents and its own, such as `option` and `flag`.
            values: The attributes.
        """
        root, file = self.model.root, self.model.file
        is_default = tags[0] == "default"
        sections, missing = root.at(*tags), dict(values)
        for key in values:
            present = [section for section in sections if key in section.values]
            # A later section of the options counts; the default of all must stand in front of classes.
            if present and (present[-1].file == file or is_default):
                self._values[present[-1], key] = missing.pop(key)
        section = sections[0 if is_default else -1] if sections else root
        if section is not root and section.file == file:
            self._values |= {(section, key): value for key, value in missing.items()}
        elif missing:
            self.insert(tags, missing, is_behind=not is_default)

    def insert(
        self, tags: tuple[str, ...], values: Mapping[str, str], *, is_behind: bool
    ) -> None:
        """Insert a section behind the included files, if there are any, or in front of the other sections."""
        file = self.model.file
        children = [child for child in self.model.root.children if child.file == file]
        includes = [child for child in children if child.tag == "include"]
        later = [child for child in children if child.tag not in FIRST]
        neighbour = (later or children)[0]
        is_behind &= bool(includes)
        if is_behind:
            neighbour = includes[-1]
        before = self.model.texts[file][: neighbour.start].rpartition("\n")[2]
        gap = "\n" + before if before.isspace() else "\n"
        text = "".join(f' {key}="{value}"' for key, value in values.items())
        text = f"<{tags[-1]}{text}/>"
        for tag in tags[-2::-1]:
            text = f"<{tag}>{text}</{tag}>"
        if is_behind:
            self._inserted.append((neighbour.stop, neighbour.stop, gap + text))
        else:
            self._inserted.append((neighbour.start, neighbour.start, text + gap))

    def move(self, folder: Path) -> None:
        """Write the folders of meshes and textures relative to another folder."""
        source, target = self.model.file.parent.resolve(), folder.resolve()
        if source == target:
            return
        folders = {"meshdir": "", "texturedir": ""}
        has_files = False
        for element in self.model.root.inner():
            values = element.values
            if element.tag == "compiler":
                shared = values.get("assetdir")
                for key, before in folders.items():
                    folders[key] = values.get(key, shared or before)
            elif "file" in values and element.tag != "include":
                has_files = True
        if has_files:
            relative = {
                k: os.path.relpath(source / v, target) for k, v in folders.items()
            }
            self.put(("compiler",), relative)

    def texts(self, file: Path) -> dict[Path, str]:
        """Return the texts of the new file of the model and of changed included files, by their paths beside it.

        A changed included file gets the name of the new file in front of its own.
        """
        names = {self.model.file: file}
        for element in reversed([*self.model.root.inner()]):
            if element.tag != "include":
                continue
            included = self.model.file.parent / element.values["file"]
            if included in {changed.file for changed, _ in self._values}:
                names[included] = file.with_name(f"{file.stem}_{included.name}")
            path = os.path.relpath(names.get(included, included), file.parent)
            if path != element.values["file"]:
                self._values[element, "file"] = path
        return {new: self.text(old) for old, new in names.items()}

    def text(self, file: Path) -> str:
        """Return the text of a file with all changes."""
        edits = [*self._inserted] if file == self.model.file else []
        for element in self._changed():
            if element.file == file:
                edits.append((element.start, element.stop, self._tag(element)))
        return _edited(self.model.texts[file], edits)

    def _changed(self) -> list[Element]:
        """Return the elements with changed attributes, in the order of the text."""
        elements = {element for element, _ in self._values}
        return sorted(elements, key=lambda element: (element.file, element.start))

    def _tag(self, element: Element) -> str:
        """Return the start tag of an element with all changes."""
        spans = element.places.values()
        first = element.start
        last = max((stop for _, stop in spans), default=first + len(element.tag) + 1)
        edits = []
        for (changed, key), value in self._values.items():
            if changed is element:
                new = f'"{value}"' if key in element.places else f' {key}="{value}"'
                start, stop = element.places.get(key, (last, last))
                edits.append((start - first, stop - first, new))
        return _edited(self.model.texts[element.file][first : element.stop], edits)

    @property
    def diff(self) -> list[str]:
        """Changed tags of all files as lines of a diff, and what is inserted."""
        lines = []
        for element in self._changed():
            before = self.model.texts[element.file][element.start : element.stop]
            tags = {"-": before, "+": self._tag(element)}
            lines += [
                self._short(f"{mark} {' '.join(tag.split())}")
                for mark, tag in tags.items()
            ]
        return lines + [f"+ {text.strip()}" for *_, text in self._inserted]

    def _short(self, line: str) -> str:
        """Return a line; of one that is longer than the screen, its name, its class and what changes."""
        if len(line) <= SCREEN:
            return line
        keys = {"name", "class", *(key for _, key in self._values)}

        def shown(attribute: re.Match[str]) -> str:
            return attribute[0] if attribute[1] in keys else "..."

        return re.sub(r"\.\.\.(\s+\.\.\.)+", "...", ATTRIBUTE.sub(shown, line))


def _edited(text: str, edits: list[tuple[int, int, str]]) -> str:
    """Return a text with other texts in place of parts, each from a place to another."""
    for start, stop, new in sorted(edits, key=lambda edit: edit[:2])[::-1]:
        text = text[:start] + new + text[stop:]
    return text


# --- changes of settings ---------------------------------------------------------------------------------------------


def write_change(
    robot: Robot, changes: Settings
) -> tuple[TextChange | None, list[str]]:
    """Return a change in the text of a model, and names of elements whose attributes the text does not show.

    Each attribute is changed where the model gives it; others are added to the default.

    Args:
        robot: The robot before the change; without a text, there is none after it.
        changes: The change, as `changed_model` takes it.
    """
    text = None if robot.text is None else TextChange(robot.text)
    hidden = []
    _, places = changed_model(robot, changes)
    sections: dict[tuple[str, ...], dict[str, str]] = {}
    for name, (place, key, text_of) in ATTRIBUTES.items():
        if name not in changes:
            continue
        value = text_of(changes[name])
        is_missing = name not in ELEMENT_FIELDS
        reached = reached_by_default(robot, name)
        for kind, number in places.get(name, ()):
            element = None
            if robot.text is not None:
                element = robot.text.element(robot.model, kind, number)
            is_default = kind == "geom" and number in reached
            if text is not None and (element is not None or is_default):
                is_missing |= not text.give(element, kind, key, value)
            elif not is_default:
                hidden.append(robot.place_text((kind, number)))
        if is_missing:
            tags = SECTION_TAGS.get(place, ("default", place))
            sections.setdefault(tags, {})[key] = value
    if text is not None:
        for tags, values in sections.items():
            text.put(tags, values)
    return text, hidden
