"""Find elements of a model in the text of its files."""

from __future__ import annotations

import re
from collections.abc import Iterator
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

    def line(self, element: Element) -> int:
        """Return the line of an element in its file."""
        return self.texts[element.file].count("\n", 0, element.start) + 1

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
        elements = []
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
