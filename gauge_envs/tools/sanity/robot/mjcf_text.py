"""Find elements of a model in the text of its files, and change attributes there, so that a diff shows only these."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import mujoco

MARKUP = re.compile(
    r"<!--.*?-->|<[?!][^>]*>"
    r"""|<(?P<close>/?)(?P<tag>[\w:.-]+)(?P<inside>(?:[^>"'/]|/(?!>)|"[^"]*"|'[^']*')*)(?P<end>/?>)""",
    re.DOTALL,
)
"""Comments and declarations, which are passed over, and tags."""

ATTRIBUTE = re.compile(r"""([\w:.-]+)\s*=\s*("[^"]*"|'[^']*')""")

TAGS = {"joint": ("joint", "freejoint"), "body": ("body", "link")}
"""Tags of kinds of elements that have several tags, with the tag of a URDF."""

SECTIONS = ("actuator", "equality", "tendon")
"""Kinds whose elements have many tags, and stand in a section with the name of the kind."""

PARENTS = ("worldbody", "body", "frame", "contact", "keyframe", "robot")
"""Elements that contain elements of other kinds."""

COUNTS = {"actuator": "nu", "equality": "neq", "joint": "njnt"}
"""Number of elements of a kind in the compiled model, where it is not `n` and the kind."""

FIRST = ("compiler", "option", "size", "statistic", "visual")
"""Sections in front of which no other one is inserted."""

SCREEN = 100
"""Longest line that is shown with all of its attributes [characters]."""


@dataclass(eq=False)
class Element:
    """An element of a model file.

    Attributes:
        tag: Its tag.
        file: Its file.
        start: Place of its start tag in the text of the file.
        stop: Place behind its start tag.
        places: Begin and end of the value of each attribute, with its quotes.
        values: Its attributes.
        parent: Its parent; None for the root.
        children: Its children; included ones follow their `<include>`.
    """

    tag: str
    file: Path
    start: int = 0
    stop: int = 0
    places: dict[str, tuple[int, int]] = field(default_factory=dict)
    values: dict[str, str] = field(default_factory=dict)
    parent: Element | None = None
    children: list[Element] = field(default_factory=list)

    def inner(self) -> Iterator[Element]:
        """Yield all elements inside, in the order of the text."""
        for child in self.children:
            yield child
            yield from child.inner()

    def outer(self) -> Iterator[Element]:
        """Yield this element, its parent, and so on."""
        yield self
        if self.parent is not None:
            yield from self.parent.outer()

    def at(self, *tags: str) -> list[Element]:
        """Return elements inside by the tags of their parents and their own."""
        elements = [self]
        for tag in tags:
            children = [child for element in elements for child in element.children]
            elements = [child for child in children if child.tag == tag]
        return elements


class ModelText:
    """Texts of a model file and of the files that it includes.

    Args:
        file: The model file.

    Raises:
        OSError: A file cannot be read.
        ValueError: A file is not text in UTF-8.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self.texts: dict[Path, str] = {}
        self.root = self._read(file)

    def _read(self, file: Path) -> Element:
        """Return the root of a file, which MuJoCo has compiled."""
        text = self.texts[file] = file.read_bytes().decode("utf-8")
        top = above = Element("", file)
        for mark in MARKUP.finditer(text):
            if mark["tag"] is None:
                continue
            if mark["close"]:
                above = above.parent or top
                continue
            attributes = [*ATTRIBUTE.finditer(text, *mark.span("inside"))]
            places = {match[1]: match.span(2) for match in attributes}
            values = {match[1]: match[2][1:-1] for match in attributes}
            element = Element(mark["tag"], file, *mark.span(), places, values, above)
            above.children.append(element)
            if element.tag == "include":
                included = self._read(self.file.parent / values["file"]).children
                for child in included:
                    child.parent = above
                above.children += included
            if mark["end"] == ">":
                above = element
        return top.children[0]

    def line(self, element: Element) -> str:
        """Return file and line of an element, such as `go1.xml:88`."""
        number = self.texts[element.file].count("\n", 0, element.start) + 1
        return f"{element.file.name}:{number}"

    def element(self, model: mujoco.MjModel, kind: str, number: int) -> Element | None:
        """Return an element of the compiled model; None where it is ambiguous.

        Args:
            model: The compiled model.
            kind: Kind of the element, such as `joint`.
            number: Its id.
        """
        count = getattr(model, COUNTS.get(kind, f"n{kind}"))
        names = [getattr(model, kind)(index).name for index in range(count)]
        elements = self._elements(kind)
        texts = [element.values.get("name", "") for element in elements]
        if texts == names:
            return elements[number]
        name = names[number]
        is_unique = name and texts.count(name) == 1
        return elements[texts.index(name)] if is_unique else None

    def _elements(self, kind: str) -> list[Element]:
        """Return elements of a kind, those of each body before those of its child bodies."""
        bodies: dict[Element, int] = {}
        elements: list[tuple[int, Element]] = []
        for element in self.root.inner():
            if element.tag == "body":
                bodies[element] = len(bodies) + 1
            above = element.parent.tag if element.parent else ""
            is_tagged = element.tag in TAGS.get(kind, (kind,)) and above in PARENTS
            if is_tagged or above == kind in SECTIONS:
                outer = filter(bodies.__contains__, element.outer())
                body = next((bodies[parent] for parent in outer), 0)
                elements.append((body, element))
        return [element for _, element in sorted(elements, key=lambda item: item[0])]


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
        """Change an attribute where an element takes it from, and return whether the text has it.

        Args:
            element: The element; None for the default of all.
            kind: Its tag in the default of all.
            key: The attribute.
            value: Its new value.
        """
        for source in self._sources(element, kind):
            if key in source.values:
                self._values[source, key] = value
                return True
        return False

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
            self._insert(tags, missing, is_behind=not is_default)

    def _insert(
        self, tags: tuple[str, ...], values: Mapping[str, str], *, is_behind: bool
    ) -> None:
        """Insert a section behind the included files, if there are any, or in front of the other sections."""
        file = self.model.file
        children = [child for child in self.model.root.children if child.file == file]
        includes = [child for child in children if child.tag == "include"] * is_behind
        later = [child for child in children if child.tag not in FIRST]
        neighbour = [*(later or children)[:1], *includes][-1]
        before = self.model.texts[file][: neighbour.start].rpartition("\n")[2]
        gap = "\n" + before if before.isspace() else "\n"
        text = "".join(f' {key}="{value}"' for key, value in values.items())
        text = f"<{tags[-1]}{text}/>"
        for tag in tags[-2::-1]:
            text = f"<{tag}>{text}</{tag}>"
        at = neighbour.stop if includes else neighbour.start
        self._inserted.append((at, at, gap + text if includes else text + gap))

    def move(self, folder: Path) -> None:
        """Write included files and the folders of meshes and textures relative to another folder."""
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
            elif element.tag == "include" and element.file == self.model.file:
                path = os.path.relpath(source / values["file"], target)
                self._values[element, "file"] = path
            elif "file" in values:
                has_files = True
        if has_files:
            relative = {
                k: os.path.relpath(source / v, target) for k, v in folders.items()
            }
            self.put(("compiler",), relative)

    @property
    def elsewhere(self) -> list[str]:
        """Changes of included files, as texts."""
        return [
            f'{key}="{value}" in {self.model.line(element)}'
            for (element, key), value in self._values.items()
            if element.file != self.model.file
        ]

    def text(self, file: Path) -> str:
        """Return the text of a file with all changes."""
        edits = self._inserted * (file == self.model.file)
        for (element, key), value in self._values.items():
            if element.file == file:
                spans = element.places.values()
                tag_end = element.start + len(element.tag) + 1
                end = max((stop for _, stop in spans), default=tag_end)
                new = f'"{value}"' if key in element.places else f' {key}="{value}"'
                edits.append((*element.places.get(key, (end, end)), new))
        text = self.model.texts[file]
        for start, stop, new in sorted(edits, key=lambda edit: edit[:2])[::-1]:
            text = text[:start] + new + text[stop:]
        return text

    @property
    def diff(self) -> tuple[str, ...]:
        """Changed lines of all files, which start with `- ` or `+ `."""
        changes: list[str] = []
        for file, before in self.model.texts.items():
            texts = before.splitlines(), self.text(file).splitlines()
            changes += [*difflib.unified_diff(*texts, n=0, lineterm="")][2:]
        return tuple(
            f"{line[0]} {line[1:].strip()}" for line in changes if line[0] in "+-"
        )

    def short(self, line: str) -> str:
        """Return a line; of one that is longer than the screen, its name, its class and what changes."""
        if len(line) <= SCREEN:
            return line
        keys = {"name", "class", *(key for _, key in self._values)}
        shown = ATTRIBUTE.sub(
            lambda match: match[0] if match[1] in keys else "...", line
        )
        return re.sub(r"\.\.\.(\s+\.\.\.)+", "...", shown)
