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
"""Tags of a kind of element that has several, with that of a URDF."""

SECTIONS = ("actuator", "equality", "tendon")
"""Kinds whose elements have many tags, and stand in a section of that name."""

HOLDERS = ("worldbody", "body", "frame", "contact", "keyframe", "robot")
"""Elements that hold the others."""

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
        parent: The element that holds it; None for the root.
        children: What it holds; what is included follows its `<include>`.
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
        """Yield this element, the one that holds it, and so on."""
        yield self
        if self.parent is not None:
            yield from self.parent.outer()

    def at(self, *tags: str) -> list[Element]:
        """Return elements inside by the tags on the way to them."""
        several = [self]
        for tag in tags:
            several = [
                child for one in several for child in one.children if child.tag == tag
            ]
        return several


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
            found = [*ATTRIBUTE.finditer(text, *mark.span("inside"))]
            places = {one[1]: one.span(2) for one in found}
            values = {one[1]: one[2][1:-1] for one in found}
            one = Element(mark["tag"], file, *mark.span(), places, values, above)
            above.children.append(one)
            if one.tag == "include":
                included = self._read(self.file.parent / values["file"]).children
                for child in included:
                    child.parent = above
                above.children += included
            if mark["end"] == ">":
                above = one
        return top.children[0]

    def line(self, element: Element) -> str:
        """Return file and line of an element, such as `go1.xml:88`."""
        number = self.texts[element.file].count("\n", 0, element.start) + 1
        return f"{element.file.name}:{number}"

    def element(self, model: mujoco.MjModel, kind: str, number: int) -> Element | None:
        """Return an element of the compiled model; None where it is not sure which one it is.

        Args:
            model: The compiled model.
            kind: Kind of the element, such as `joint`.
            number: Its id.
        """
        count = getattr(model, COUNTS.get(kind, f"n{kind}"))
        names = [getattr(model, kind)(index).name for index in range(count)]
        several = self._several(kind)
        texts = [one.values.get("name", "") for one in several]
        if texts == names:
            return several[number]
        name = names[number]
        is_sure = name and texts.count(name) == 1
        return several[texts.index(name)] if is_sure else None

    def _several(self, kind: str) -> list[Element]:
        """Return elements of a kind, those of each body before those of the bodies that it carries."""
        bodies: dict[Element | None, int] = {}
        several: list[tuple[int, int, Element]] = []
        for place, one in enumerate(self.root.inner()):
            if one.tag == "body":
                bodies[one] = len(bodies) + 1
            above = one.parent.tag if one.parent else ""
            is_tagged = one.tag in TAGS.get(kind, (kind,)) and above in HOLDERS
            if is_tagged or above == kind in SECTIONS:
                body = next((bodies[o] for o in one.outer() if o in bodies), 0)
                several.append((body, place, one))
        return [one for *_, one in sorted(several)]


class TextChange:
    """Changes of attributes in the text of a model file.

    Args:
        model: Texts of the model.
    """

    def __init__(self, model: ModelText) -> None:
        self.model = model
        self._values: dict[tuple[Element, str], str] = {}
        self._inserted: list[tuple[int, int, str]] = []

    def state(self, element: Element | None, kind: str, key: str, value: str) -> bool:
        """Give an element an attribute where it takes it from, and return whether anything states it.

        Args:
            element: The element; None for the default of all.
            kind: Its tag in the default of all.
            key: The attribute.
            value: Its new value.
        """
        for one in self._sources(element, kind):
            if key in one.values:
                self._values[one, key] = value
                return True
        return False

    def _sources(self, element: Element | None, kind: str) -> Iterator[Element]:
        """Yield an element and those of its classes, the nearest first, and at last those of the default of all."""
        if element is not None:
            yield element
            names = (
                one.values.get("childclass" if step else "class")
                for step, one in enumerate(element.outer())
            )
            name = next(filter(None, names), None)
            for one in self.model.root.inner():
                if one.tag == "default" and one.values.get("class") == name:
                    for above in one.outer():
                        yield from reversed(above.at(kind))
        yield from reversed(self.model.root.at("default", kind))

    def put(self, tags: tuple[str, ...], values: Mapping[str, str]) -> None:
        """Give a section attributes: in place, or in one that is inserted.

        Args:
            tags: Tags on the way to it, such as `option` and `flag`.
            values: The attributes.
        """
        root, file = self.model.root, self.model.file
        is_default = tags[0] == "default"
        several, left = root.at(*tags), dict(values)
        for key in values:
            stating = [one for one in several if key in one.values]
            # A later section of the options counts; the default of all must stand in front of classes.
            if stating and (stating[-1].file == file or is_default):
                self._values[stating[-1], key] = left.pop(key)
        section = several[0 if is_default else -1] if several else root
        if section is not root and section.file == file:
            self._values |= {(section, key): value for key, value in left.items()}
        elif left:
            self._insert(tags, left, is_behind=not is_default)

    def _insert(
        self, tags: tuple[str, ...], values: Mapping[str, str], *, is_behind: bool
    ) -> None:
        """Insert a section behind the included files, if there are any, or in front of the other sections."""
        file = self.model.file
        inner = [one for one in self.model.root.children if one.file == file]
        includes = [one for one in inner if one.tag == "include"] * is_behind
        others = [one for one in inner if one.tag not in FIRST]
        beside = [*(others or inner)[:1], *includes][-1]
        before = self.model.texts[file][: beside.start].rpartition("\n")[2]
        gap = "\n" + before if before.isspace() else "\n"
        text = "".join(f' {key}="{value}"' for key, value in values.items())
        text = f"<{tags[-1]}{text}/>"
        for tag in tags[-2::-1]:
            text = f"<{tag}>{text}</{tag}>"
        at = beside.stop if includes else beside.start
        self._inserted.append((at, at, gap + text if includes else text + gap))

    def move(self, folder: Path) -> None:
        """State included files and the folders of meshes and textures as seen from another folder."""
        source, target = self.model.file.parent.resolve(), folder.resolve()
        if source == target:
            return
        folders = {"meshdir": "", "texturedir": ""}
        has_files = False
        for one in self.model.root.inner():
            values = one.values
            if one.tag == "compiler":
                shared = values.get("assetdir")
                for key, before in folders.items():
                    folders[key] = values.get(key, shared or before)
            elif one.tag == "include" and one.file == self.model.file:
                path = os.path.relpath(source / values["file"], target)
                self._values[one, "file"] = path
            elif "file" in values:
                has_files = True
        if has_files:
            relative = {
                k: os.path.relpath(source / v, target) for k, v in folders.items()
            }
            self.put(("compiler",), relative)

    @property
    def elsewhere(self) -> list[str]:
        """Changes of included files, in words."""
        return [
            f'{key}="{value}" in {self.model.line(element)}'
            for (element, key), value in self._values.items()
            if element.file != self.model.file
        ]

    def text(self, file: Path) -> str:
        """Return the text of a file with all changes."""
        edits = self._inserted * (file == self.model.file)
        for (one, key), value in self._values.items():
            if one.file == file:
                spans = one.places.values()
                end = max(
                    (stop for _, stop in spans), default=one.start + len(one.tag) + 1
                )
                new = f'"{value}"' if key in one.places else f' {key}="{value}"'
                edits.append((*one.places.get(key, (end, end)), new))
        text = self.model.texts[file]
        for start, stop, new in sorted(edits, key=lambda edit: edit[:2])[::-1]:
            text = text[:start] + new + text[stop:]
        return text

    @property
    def diff(self) -> tuple[str, ...]:
        """Changed lines of all files, which start with `- ` or `+ `."""
        lines: list[str] = []
        for file, before in self.model.texts.items():
            texts = before.splitlines(), self.text(file).splitlines()
            lines += [*difflib.unified_diff(*texts, n=0, lineterm="")][2:]
        return tuple(f"{one[0]} {one[1:].strip()}" for one in lines if one[0] in "+-")

    def short(self, line: str) -> str:
        """Return a line that is not longer than the screen, or only its name, its class and what changes in it."""
        if len(line) <= SCREEN:
            return line
        keys = {"name", "class", *(key for _, key in self._values)}
        shown = ATTRIBUTE.sub(lambda one: one[0] if one[1] in keys else "...", line)
        return re.sub(r"\.\.\.(\s+\.\.\.)+", "...", shown)
