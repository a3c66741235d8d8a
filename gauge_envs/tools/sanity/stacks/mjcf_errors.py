"""Say why MuJoCo cannot load a file in one sentence: file and line, element, and what to do."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from pathlib import Path

from gauge_envs.files import printable

POINTER = b"version https://git-lfs"
"""Start of what Git leaves in place of a large file that was not fetched."""

ADVICE = {
    "unrecognized": "remove it, correct its name, or use the version of MuJoCo that knows it",
    "mjMINVAL": "give it a geom with mass, or <inertial>",
    "no decoder": "convert the mesh to .stl or .obj",
    "A + B >= C": 'correct <inertial>, or set <compiler balanceinertia="true"/>',
    "model type": "an MJCF file starts with <mujoco>, a URDF with <robot>",
    "unknown": "correct the name",
    "repeated name": "give each its own name",
}
"""What to do, by words of MuJoCo's message."""

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
    if path.read_bytes()[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return f"{path}: is in UTF-16, which MuJoCo does not read: save it as UTF-8"
    texts = dict(_with_includes(path, text))
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


def _with_includes(path: Path, text: str) -> Iterator[tuple[Path, str]]:
    """Yield a file and those that it includes, whose paths count from its folder, each with its text."""
    left, known = [(path, text)], set()
    while left:
        file, text = left.pop()
        yield file, text
        known.add(file)
        for name in re.findall(r'<include\s[^>]*?file\s*=\s*"(.*?)"', text):
            other = path.parent / name
            if other.is_file() and other not in known:
                content = other.read_text(encoding="utf-8-sig", errors="replace")
                left.append((other, content))


def _element(texts: Texts, key: str, value: str) -> tuple[str, str, str] | None:
    """Return file and line, label and whole value of the first element with an attribute of a value.

    The attribute may also be a path that ends with the value.
    """
    form = rf'<(\w+)\b[^<>]*?\b(?:{key})\s*=\s*["\']((?:[^"\'<>]*[/\\])?{re.escape(value)})["\']'
    for file, text in texts.items():
        if match := re.search(form + r"[^<>]*", text):
            name = re.search(r'\bname\s*=\s*"(.*?)"', match[0])
            label = f'{match[1]} "{name[1]}"' if name else f"<{match[1]}>"
            return (
                f"{file}:{text.count(chr(10), 0, match.start()) + 1}",
                label,
                match[2],
            )
    return None


def _unread(texts: Texts, path: Path, sought: str, error: str) -> str:
    """Return which element needs a file that is not there or cannot be read."""
    name = re.split(r"[/\\]", sought)[-1]
    place, label, stated = _element(texts, "file(?:name)?", name) or (
        path,
        "it",
        sought,
    )
    there = path.parent / sought if not Path(sought).is_file() else Path(sought)
    start = f"{place}: {label} needs {sought}, which"
    if there.is_file():
        if there.read_bytes().startswith(POINTER):
            return f"{start} is a pointer of Git LFS: run git lfs pull"
        cause = error.split("\n")[0].removeprefix("Error: ")
        advice = next((text for words, text in ADVICE.items() if words in error), "")
        return f"{start} cannot be read: {cause}" + (f": {advice}" if advice else "")
    if stated.startswith("package:"):
        advice = "write its path relative to this file, without package://"
    elif re.match(r"[/~]|[A-Za-z]:", stated):
        advice = "write its path relative to this file, not one of another machine"
    elif label == "<include>":
        advice = "copy it there"
    else:
        advice = "copy it there, or set meshdir"
    return f"{start} is not there: {advice}"


def _placed(texts: Texts, path: Path, error: str) -> str:
    """Return MuJoCo's own message with the file and line of its element."""
    message, _, rest = error.partition("\nElement")
    message = re.sub(r"((XML )?Error|Schema violation|ParseXML): ", "", message)
    cause = printable(" ".join(message.split()))
    advice = next((text for words, text in ADVICE.items() if words in error), "")
    end = f"{cause}: {advice}" if advice else cause
    match = re.match(r"(?: name)? '(.*?)'", rest)
    if match is None or not match[1]:
        line = re.search(r"line ([1-9]\d*)", rest)
        return f"{path}{f':{line[1]}' if line else ''}: {end}"
    if rest.startswith(" name"):
        place, label, _ = _element(texts, "name", match[1]) or (path, match[1], "")
        return f"{place}: {label}: {end}"
    # MuJoCo states no file, and no line in a file that another one includes.
    line = re.search(r"line ([1-9]\d*)", rest)
    rows = [
        (f"{file}:{number}", row)
        for file, text in texts.items()
        for number, row in enumerate(text.splitlines(), 1)
        if f"<{match[1]}" in row and (not line or number == int(line[1]))
    ]
    words = re.findall(r"'(.*?)'", message)
    named = [place for place, row in rows if all(word in row for word in words)]
    place = next(iter([*named, *(place for place, _ in rows)]), str(path))
    return f"{place}: <{match[1]}>: {end}"
