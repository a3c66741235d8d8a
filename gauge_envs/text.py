"""Decode the text of files: CSV, JSON and TOML in the usual encodings."""

import codecs
import io
import json
import re
import tomllib
from collections.abc import Callable
from functools import partial
from typing import Any

MAX_DEPTH = 32
"""Deepest nesting of a document. Files of this package have up to 6 levels."""

LONG_KEY = re.compile(rf"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){{{MAX_DEPTH}}}""")
"""A dotted key of TOML, which takes memory that grows with the square of its length."""


def printable(text: str) -> str:
    """Return the text with escapes for unprintable characters."""
    return "".join(
        char if char.isprintable() else char.encode("unicode_escape").decode()
        for char in text
    )


def text_of(content: bytes) -> str:
    """Return text in UTF-8, with or without a byte-order mark, or in UTF-16 with one.

    Raises:
        ValueError: The content is neither.
    """
    is_wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        return content.decode("utf-16" if is_wide else "utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError("it is not text in UTF-8; save it as UTF-8") from None


def json_document(content: bytes) -> Any:
    """Return the value of a JSON document; see `text_of` for the encoding.

    Raises:
        ValueError: The content is empty, not JSON, nested too deeply, or has a name twice in an object.
    """
    parse = partial(json.loads, object_pairs_hook=_unique)
    return _flat(parse, filled_text(content))


def filled_text(content: bytes) -> str:
    """Return text that is not empty; see `text_of`.

    Raises:
        ValueError: The content is empty or no text.
    """
    text = text_of(content)
    if not text.strip():
        raise ValueError("it is empty")
    return text


def _flat(parse: Callable[[str], Any], text: str) -> Any:
    """Return a parsed document whose nesting no later function can fail on."""
    deep = ValueError(f"it is nested more than {MAX_DEPTH} levels deep")
    try:
        value = parse(text)
    except RecursionError:
        raise deep from None
    level = [value]
    for _ in range(MAX_DEPTH):
        level = [
            entry
            for parent in level
            if isinstance(parent, dict | list)
            for entry in (parent.values() if isinstance(parent, dict) else parent)
        ]
    if level:
        raise deep
    return value


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) == len(pairs):
        return entries
    names = [name for name, _ in pairs]
    doubled = next(name for name in names if names.count(name) > 1)
    raise ValueError(f"the name {doubled!r} occurs twice")


def csv_text(content: bytes) -> io.StringIO:
    """Return CSV with commas; the file may have semicolons, tabs or spaces, and decimal commas with the first two.

    Raises:
        ValueError: The content is empty or no text.
    """
    text = filled_text(content)
    header = next((line for line in text.splitlines() if not line.startswith("#")), "")
    separator = next((mark for mark in ";\t" if mark in header), None)
    if separator is not None:
        text = text.replace(",", ".").replace(separator, ",")
    elif "," not in header:
        text = "\n".join(",".join(line.split()) for line in text.splitlines())
    return io.StringIO(text, newline="")


def toml_document(content: bytes) -> dict[str, Any]:
    """Return the tables of a TOML document; see `text_of` for the encoding.

    Raises:
        ValueError: The content is not TOML, or nested too deeply.
    """
    text = text_of(content)
    if LONG_KEY.search(text):
        raise ValueError(f"it has a key of more than {MAX_DEPTH} parts")
    try:
        document: dict[str, Any] = _flat(tomllib.loads, text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"not a TOML file: {error}") from None
    return document
