"""Decode the text of files: CSV, JSON and TOML in the usual encodings."""

import codecs
import io
import json
import tomllib
from typing import Any


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
        ValueError: The content is not JSON, or a name occurs twice in an object.
    """
    return json.loads(text_of(content), object_pairs_hook=_unique)


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
        ValueError: The content is not text.
    """
    text = text_of(content)
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
        ValueError: The content is not TOML.
    """
    return tomllib.loads(text_of(content))
