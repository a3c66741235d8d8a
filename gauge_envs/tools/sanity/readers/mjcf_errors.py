"""Say why MuJoCo cannot load a file in one sentence: file and line, element, and what to do."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

from gauge_envs.text import printable

POINTER = b"version https://git-lfs"
"""First bytes of the pointer that Git leaves in place of a large file."""

Texts = Mapping[Path, str]
"""Text of a model file and of those that it includes."""


def sentence(path: Path, text: str, error: str) -> str:
    """Return what is wrong with a model file.

    Args:
        path: The file.
        text: Its text.
        error: MuJoCo's message.
    """
    if "xmlns:xacro" in text:
        return f"{path}: is a xacro file, which is no model yet: run xacro {path.name} > robot.urdf"
    texts = _with_includes(path, text)
    for file, content in texts.items():
        try:
            ET.fromstring(content)
        except ET.ParseError as fault:
            line, column = fault.position
            cause = str(fault).partition(":")[0]
            return f"{file}:{line}: the XML is not well-formed at column {column}, {cause}: close what is open there"
    if unread := re.search(r"(?:opening|STL|mesh) file '(.*?)'", error):
        return _unread(texts, path, unread[1], error)
    return _placed(texts, path, error)


def _with_includes(path: Path, text: str) -> Texts:
    """Return the text of a file and of those that it includes, whose paths count from its folder."""
    texts, left = {path: text}, [text]
    while left:
        for name in re.findall(r'<include\s[^>]*?file\s*=\s*"(.*?)"', left.pop()):
            file = path.parent / name
            if file.is_file() and file not in texts:
                texts[file] = file.read_text(encoding="utf-8-sig", errors="replace")
                left.append(texts[file])
    return texts


def _element(texts: Texts, form: str) -> tuple[str, str, str] | None:
    """Return file and line, label and text of the first element that a pattern finds behind `<`."""
    for file, text in texts.items():
        if match := re.search(rf"<{form}[^<>]*", text):
            name = re.search(r'\bname\s*=\s*"(.*?)"', match[0])
            tag = re.split(r"\W", match[0], maxsplit=2)[1]
            line = text.count("\n", 0, match.start()) + 1
            label = f'{tag} "{name[1]}"' if name else f"<{tag}>"
            return f"{file}:{line}", label, match[0]
    return None


def _unread(texts: Texts, path: Path, sought: str, error: str) -> str:
    """Return which element needs a file that is not there or cannot be read."""
    name = re.escape(re.split(r"[/\\]", sought)[-1])
    form = rf"""\w+\b[^<>]*?\bfile(name)?\s*=\s*["']([^"'<>]*[/\\])?{name}["']"""
    place, label, text = _element(texts, form) or (path, "it", "")
    start = f"{place}: {label} needs {sought}, which"
    for file in (path.parent / sought, Path(sought)):
        if file.is_file():
            if file.read_bytes().startswith(POINTER):
                return f"{start} is a pointer of Git LFS: run git lfs pull"
            cause = error.split("\n")[0].removeprefix("Error: ")
            return f"{start} cannot be read: {cause}"
    advice = (
        "copy it there" if label == "<include>" else "copy it there, or set meshdir"
    )
    if "package:/" in text:
        advice = "write its path relative to this file, without package://"
    return f"{start} is not there: {advice}"


def _placed(texts: Texts, path: Path, error: str) -> str:
    """Return MuJoCo's own message with the file and line of its element."""
    message, _, rest = error.partition("\nElement")
    message = re.sub(r"((XML )?Error|Schema violation|ParseXML): ", "", message)
    end = printable(" ".join(message.split()))
    match = re.match(r"(?: name)? '(.+?)'", rest)
    line = re.search(r"line ([1-9]\d*)", rest)
    element = None
    if match and rest.startswith(" name"):
        element = _element(texts, rf'\w+\b[^<>]*?\bname\s*=\s*"{re.escape(match[1])}"')
    elif match and not line:
        # MuJoCo gives no line in an included file.
        attribute = re.search("'(.*?)'", message)
        element = _element(
            texts, rf"{match[1]}\b[^<>]*{attribute[1] if attribute else ''}"
        )
    if element:
        return f"{element[0]}: {element[1]}: {end}"
    place = f"{path}:{line[1]}" if line else str(path)
    return f"{place}: <{match[1]}>: {end}" if match else f"{place}: {end}"
